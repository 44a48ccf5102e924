//! `knob demo`: the firmware on its bench tells a story, with figures measured in that run.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use control::criterion::{Criterion, Sampling};
use plant_sim::hold::State;
use plant_sim::lockstep::Plant;
use plant_sim::preset::{PRESETS, Preset};
use protocol::{Changes, Fields, Law, Message, Refusal, Request, Shape, Subscription};
use serde::Serialize;

use crate::charts::demo::{Curve, curves};
use crate::commands::emulate::{Pace, Port, serve};
use crate::output::say_line;
use crate::output::{Output, publish};
use crate::session::{ImageChoice, Session};
use crate::stop::{self, Stopped};

/// Run the firmware in the emulator through a story, and draw what happened.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  cargo xtask demo   # builds the firmware and calls this\n  knob demo --out demo"
)]
pub struct Args {
    /// The folder for the charts; it is made if it is not there
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
    /// Replace charts that exist
    #[arg(long)]
    force: bool,
    /// Leave the device running on a serial port until Ctrl-C
    #[arg(long)]
    hold: bool,
    /// Print the figures as one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    image: ImageChoice,
}

/// One throw of the knob, as it was measured.
#[derive(Serialize)]
struct Throw {
    stiffness_demanded_nm_rad: f32,
    stiffness_applied_nm_rad: f32,
    start_rad_s: f64,
    ticks: usize,
    peak_angle_rad: f64,
    /// Largest kinetic energy over that of the start.
    energy_ratio: f64,
    at_rest: bool,
    #[serde(skip)]
    trace: Vec<(f64, f64)>,
}

#[derive(Serialize)]
struct Figures {
    firmware: String,
    board: String,
    soft_wall: Throw,
    raw_spring: Throw,
    clamped_spring: Throw,
    coarse_raw: Throw,
    coarse_clamped: Throw,
    refused: String,
    ticks: u32,
    charts: Vec<PathBuf>,
}

pub fn run(args: &Args) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("--out: {}", args.out.display()))?;
    let file = |name: &str| Output::prepare("--out", &args.out.join(name), args.force);
    let (mut hit_chart, mut coarse_chart) = (file("hit.svg")?, file("coarse.svg")?);
    let motor = &PRESETS[0];
    let mut session = args
        .image
        .boot(Plant::new(motor.device, motor.counts_per_rev, 0.0)?, None)?;
    let mut story = Story {
        session: &mut session,
        motor,
        quiet: args.json,
    };
    let mut figures = story.tell()?;
    let title = "Fig. 6(d): a demand of 1 Nm/rad hit at 7 rad/s, on the firmware";
    let hits = [
        Curve::new("clamp off (raw): grows", &figures.raw_spring.trace),
        Curve::new(
            "clamp on (static): does not",
            &figures.clamped_spring.trace[..figures.raw_spring.ticks],
        ),
    ];
    write!(hit_chart, "{}", curves(title, &hits)?)?;
    let title = "Fig. 6(b): an encoder of 20 counts, the last 60 ms, on the firmware";
    let last = |throw: &Throw| throw.trace[throw.trace.len().saturating_sub(60)..].to_vec();
    let (raw, clamped) = (last(&figures.coarse_raw), last(&figures.coarse_clamped));
    let cycles = [
        Curve::new("clamp off (raw): limit cycle", &raw),
        Curve::new("clamp on (static): rest", &clamped),
    ];
    write!(coarse_chart, "{}", curves(title, &cycles)?)?;
    figures.charts = vec![hit_chart.path().to_owned(), coarse_chart.path().to_owned()];
    publish(vec![hit_chart, coarse_chart])?;
    if args.json {
        say_line!("{}", serde_json::to_string(&figures)?);
    } else {
        say_line!("\nCharts of this run:");
        for chart in &figures.charts {
            say_line!("  {}", chart.display());
        }
    }
    if args.hold {
        session.bench.plant.hold_at(0.0);
        session.bench.plant.let_go(0.0);
        let mut port = Port::open(None)?;
        eprintln!(
            "The device goes on at {}: try `knob info` in another terminal; Ctrl-C ends it.",
            port.path.display()
        );
        serve(
            &mut session,
            &mut port,
            Pace::Real,
            stop::requested,
            |_, _, _| Ok(()),
        )?;
    }
    Ok(())
}

struct Story<'a> {
    session: &'a mut Session,
    motor: &'a Preset,
    quiet: bool,
}

impl Story<'_> {
    fn say(&self, text: &str) -> Result<()> {
        if !self.quiet {
            say_line!("{text}");
        }
        Ok(())
    }

    fn tell(&mut self) -> Result<Figures> {
        let (firmware, board) = self.session.ask(
            Request::Hello {
                version: protocol::VERSION,
            },
            |message| match message {
                Message::Hello(hello) => Ok((
                    format!("{} ({})", hello.firmware, hello.git_hash),
                    hello.board.to_owned(),
                )),
                other => bail!("{other:?} in answer to hello"),
            },
        )?;
        let sampling = Sampling {
            period_s: 1e-3,
            count_rad: self.motor.count_rad(),
        };
        let criterion = Criterion::new(self.motor.device, sampling)?;
        self.say(&format!(
            "The firmware {firmware} runs on the {board} board, an STM32F405 in QEMU. Its motor is the paper's Maxon RE35,\n\
             8192 counts, sampled every millisecond, solved exactly. Everything below was set over the serial line.\n\
             \n\
             This device is passive at every speed up to 2b/T = {:.3} Nm/rad.",
            criterion.largest_stiffness()
        ))?;

        let wall = Changes {
            shape: Some(Shape::Wall),
            wall_rad: Some(0.0),
            ..law(Law::Raw, 0.015)
        };
        let soft_wall = self.throw(wall, -0.01, 30.0, 1500)?;
        self.say(&format!(
            "\n1. A wall of 0.015 Nm/rad, region (a), hit at {:.1} rad/s:\n   pressed in by {:.3} rad, thrown out, at rest: {}. Kinetic energy never exceeded {:.2} of the start's.",
            soft_wall.start_rad_s,
            soft_wall.peak_angle_rad,
            yes(soft_wall.at_rest),
            soft_wall.energy_ratio
        ))?;

        let raw_spring = self.throw(law(Law::Raw, 1.0), 0.0, 7.0, 80)?;
        self.say(&format!(
            "\n2. A spring of 1 Nm/rad, {:.0} × that limit, hit at 7 rad/s with the clamp off:\n   after {} ms it moves with {:.0} × the energy it was given. It would go on growing.",
            1.0 / criterion.largest_stiffness(),
            raw_spring.ticks,
            raw_spring.energy_ratio
        ))?;
        let clamped_spring = self.throw(law(Law::Static, 1.0), 0.0, 7.0, 1500)?;
        self.say(&format!(
            "   The same with the clamp on: {:.4} Nm/rad are applied, energy never exceeded {:.2} of the start's, at rest: {}.",
            clamped_spring.stiffness_applied_nm_rad,
            clamped_spring.energy_ratio,
            yes(clamped_spring.at_rest)
        ))?;

        // 8192 by 410: 19.98 counts a revolution.
        let coarse = |which| Changes {
            decimation: Some(410),
            ..law(which, 0.015)
        };
        let coarse_raw = self.throw(coarse(Law::Raw), 0.0, 12.0, 1500)?;
        self.say(&format!(
            "\n3. The encoder decimated to 20 counts, 0.015 Nm/rad, region (c), clamp off: at rest after 1.5 s: {}.\n   A limit cycle of {:.1e} rad: friction c is less than half a count of torque, KΔ/2.",
            yes(coarse_raw.at_rest),
            swing(&coarse_raw.trace)
        ))?;
        let coarse_clamped = self.throw(coarse(Law::Static), 0.0, 12.0, 1500)?;
        self.say(&format!(
            "   With the clamp on: {:.4} Nm/rad, the encoder's limit 2c/Δ, are applied; at rest: {}.",
            coarse_clamped.stiffness_applied_nm_rad,
            yes(coarse_clamped.at_rest)
        ))?;

        self.session.must(Request::Disarm)?;
        let slow = Changes {
            sample_period_s: Some(0.05),
            stiffness_nm_rad: Some(0.5),
            ..Changes::default()
        };
        let refused = self
            .session
            .ask(Request::Set(slow), |message| match message {
                Message::Refused(Refusal::Value {
                    name,
                    given,
                    lowest,
                    highest,
                }) => Ok(format!(
                    "{} is {given}; accepted: {lowest} to {highest}",
                    name.as_str()
                )),
                other => bail!("{other:?} in answer to a period that is too long"),
            })?;
        self.say(&format!("\n4. A sample period of 50 ms is refused, and the stiffness sent with it not taken:\n   {refused}."))?;
        let ticks = self.session.ask(Request::Status, |message| match message {
            Message::Status(status) => Ok(status.tick),
            other => bail!("{other:?} in answer to status"),
        })?;
        Ok(Figures {
            firmware,
            board,
            soft_wall,
            raw_spring,
            clamped_spring,
            coarse_raw,
            coarse_clamped,
            refused,
            ticks,
            charts: Vec::new(),
        })
    }

    /// Sets up over serial, arms, lets the hand throw the knob, and watches.
    fn throw(
        &mut self,
        changes: Changes,
        angle_rad: f64,
        velocity: f64,
        ticks: usize,
    ) -> Result<Throw> {
        if stop::requested() {
            return Err(Stopped.into());
        }
        let session = &mut *self.session;
        session.must(Request::Disarm)?;
        session.bench.plant.hold_at(angle_rad);
        let fresh = Changes {
            decimation: Some(changes.decimation.unwrap_or(1)),
            shape: Some(changes.shape.unwrap_or(Shape::Spring)),
            ..changes
        };
        session.must(Request::Set(fresh))?;
        session.must(Request::Arm)?;
        session.tick()?;
        session.bench.plant.let_go(velocity);
        let mut trace = Vec::with_capacity(ticks);
        let (mut fastest, mut peak) = (0.0_f64, 0.0_f64);
        for tick in 0..ticks {
            let State { position, velocity } = session.bench.plant.state();
            trace.push((tick as f64 * 1e-3, position));
            fastest = fastest.max(velocity.abs());
            peak = peak.max(position);
            session.tick()?;
        }
        let at_rest = session.bench.plant.state().velocity == 0.0;
        // What is applied, from the next tick's telemetry.
        let subscription = |every_ticks| {
            Request::Subscribe(Subscription {
                every_ticks,
                fields: Fields::STIFFNESS,
                clamp_events: false,
            })
        };
        let applied = session.applied(subscription(1), subscription(0))?;
        Ok(Throw {
            stiffness_demanded_nm_rad: changes.stiffness_nm_rad.unwrap_or(0.0),
            stiffness_applied_nm_rad: applied,
            start_rad_s: velocity,
            ticks,
            peak_angle_rad: peak,
            energy_ratio: (fastest / velocity).powi(2),
            at_rest,
            trace,
        })
    }
}

fn law(law: Law, stiffness: f32) -> Changes {
    Changes {
        law: Some(law),
        stiffness_nm_rad: Some(stiffness),
        torque_max_nm: Some(0.5),
        ..Changes::default()
    }
}

fn yes(at_rest: bool) -> &'static str {
    if at_rest { "yes" } else { "no" }
}

/// Peak to peak over the last tenth.
fn swing(trace: &[(f64, f64)]) -> f64 {
    let last = &trace[trace.len() - trace.len() / 10..];
    let high = last.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
    let low = last.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    high - low
}

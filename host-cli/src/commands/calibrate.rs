//! `knob calibrate`: the values of the connected motor.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Error, Result, bail};
use indicatif::ProgressBar;
use plant_sim::identify::Estimate;
use protocol::{Drive, Event, Excitation, MotorChanges, PowerStage, Request};
use serde::Serialize;

use super::identify::EstimateJson;
use crate::calibrate::{self, Bench, Found, Recorded, Step, Told, Winding};
use crate::device::{Device, Identity, Outcome, Unasked};
use crate::number::{self, digits};
use crate::output;
use crate::ports::Connection;
use crate::progress;
use crate::stop::Usage;
use crate::words;

/// Measure the connected motor: offsets of the current converters, resistance, inductance, pole pairs, direction and zero of the encoder, torque constant.
///
/// The knob must be free to turn, at rest and without a hand on it. It turns about two times, and for some seconds as
/// fast as 40 rad/s (a brushed motor up to 60). No phase ever bears more than --current-max; Ctrl-C turns the
/// bridge off at once.
///
/// Each value comes with an interval. What cannot be measured is refused with the reason: an unplugged phase, a
/// slipping encoder, a wrong pole count. A counter that falls while the motor turns forward, as with two swapped
/// wires, is no mistake: it is found, and set as reversed.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob calibrate --drive current --pole-pairs 7 --kv 300 --current-max 5 --apply && knob save\n  knob calibrate --drive brushed --current-max 2"
)]
pub struct Args {
    /// How the motor is driven: three phases by current, three phases of high resistance by voltage, or brushed between B and C
    #[arg(long, value_enum)]
    drive: DriveArg,
    /// The largest current in any phase, A
    #[arg(long, value_name = "A", value_parser = number::positive)]
    current_max: f64,
    /// Pole pairs, to be checked [default: as measured]
    #[arg(long, value_name = "N")]
    pole_pairs: Option<u32>,
    /// Speed constant, rpm per volt; the torque constant is then by it, and checked [default: by back-EMF]
    #[arg(long, value_name = "RPM/V", value_parser = number::positive)]
    kv: Option<f64>,
    /// Set what was found on the device; `knob save` keeps it
    #[arg(long)]
    apply: bool,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum DriveArg {
    Current,
    Voltage,
    Brushed,
}

impl DriveArg {
    fn drive(self) -> Drive {
        match self {
            Self::Current => Drive::Current,
            Self::Voltage => Drive::Voltage,
            Self::Brushed => Drive::Brushed,
        }
    }
}

#[derive(Serialize)]
struct Json {
    offset_codes: [f64; 2],
    noise_a: f64,
    resistance_ohm: EstimateJson,
    d_inductance_h: EstimateJson,
    q_inductance_h: EstimateJson,
    pole_pairs: u32,
    reversed: bool,
    zero_turns: EstimateJson,
    torque_constant_nm_a: EstimateJson,
    /// By back-EMF alone.
    measured_constant_nm_a: EstimateJson,
    current_max_a: f64,
    /// The tick from which it is in force on the device; null without --apply.
    applied_at_tick: Option<u32>,
}

pub fn run(args: &Args) -> Result<()> {
    if args.drive == DriveArg::Brushed && args.pole_pairs.is_some_and(|pairs| pairs != 1) {
        return Err(Usage("--pole-pairs: a brushed motor has none; leave it out".into()).into());
    }
    let (mut device, identity) = args.connection.connect()?;
    let Some(stage) = device.power_stage()? else {
        bail!("this board ({}) drives no motor itself", identity.board);
    };
    let told = Told {
        winding: match args.drive {
            DriveArg::Brushed => Winding::Brushed,
            DriveArg::Current | DriveArg::Voltage => Winding::ThreePhase,
        },
        pole_pairs: args.pole_pairs.filter(|_| args.drive != DriveArg::Brushed),
        kv_rpm_v: args.kv,
        current_max_a: args.current_max,
        counts_per_rev: device.parameters()?.counts_per_rev,
    };
    let bar = progress::bar(STEPS, "");
    let mut line = Line {
        device: &mut device,
        identity: &identity,
        stage,
        bar,
        begun: false,
    };
    let found = calibrate::calibrate(&mut line, &told);
    line.bar.finish_and_clear();
    let begun = line.begun;
    let found = match found {
        Ok(found) => found,
        Err(error) => {
            if begun {
                // What went wrong is told, not that this did too: it ends by itself.
                let _ = device.break_off();
            }
            return Err(error);
        }
    };
    let applied_at_tick = match args.apply {
        true => Some(apply(&mut device, &identity, args, &found)?),
        false => None,
    };
    if args.connection.json {
        let json = Json {
            offset_codes: found.zero_codes,
            noise_a: found.noise_a,
            resistance_ohm: found.resistance_ohm.into(),
            d_inductance_h: found.d_inductance_h.into(),
            q_inductance_h: found.q_inductance_h.into(),
            pole_pairs: found.pole_pairs,
            reversed: found.reversed,
            zero_turns: found.zero_turns.into(),
            torque_constant_nm_a: found.torque_constant_nm_a.into(),
            measured_constant_nm_a: found.measured_constant_nm_a.into(),
            current_max_a: args.current_max,
            applied_at_tick,
        };
        return output::say(&(serde_json::to_string(&json)? + "\n"));
    }
    output::say(&text(args, &found, applied_at_tick)?)
}

/// Steps of the longest calibration.
const STEPS: u64 = 5;

/// So long nothing may come while an excitation is under way: a window, or its rise and settling, takes less.
const SILENCE: Duration = Duration::from_secs(15);

/// A device that runs excitations.
struct Line<'a> {
    device: &'a mut Device,
    identity: &'a Identity,
    stage: PowerStage,
    bar: ProgressBar,
    /// An excitation may be under way.
    begun: bool,
}

impl Bench for Line<'_> {
    type Error = Error;

    fn power_stage(&self) -> PowerStage {
        self.stage
    }

    fn excite(&mut self, excitation: &Excitation) -> Result<Recorded> {
        self.begun = true;
        match self.device.order(Request::Calibrate(*excitation))? {
            Outcome::Done { .. } => {}
            Outcome::Refused(refusal) => {
                self.begun = false;
                bail!(
                    "the device does not measure: {}",
                    words::refusal(&refusal, &self.identity.board, None)
                );
            }
        }
        let mut windows = Vec::new();
        let mut since = Instant::now();
        loop {
            match self.device.unasked(Duration::from_millis(100))? {
                Some((_, Unasked::Event(Event::Measured(sums)))) => {
                    windows.push(sums);
                    since = Instant::now();
                }
                Some((_, Unasked::Event(Event::Calibrated { end }))) => {
                    self.begun = false;
                    return Ok(Recorded { windows, end });
                }
                Some(_) => {}
                None if since.elapsed() > SILENCE => bail!(
                    "{}: the device began to measure, but nothing more came within {} s",
                    self.device.path(),
                    SILENCE.as_secs()
                ),
                None => {}
            }
        }
    }

    fn begin(&mut self, step: Step) {
        self.bar.set_message(step.name());
        if !self.bar.is_hidden() {
            self.bar.inc(u64::from(step != Step::Offsets));
        } else {
            eprintln!("measuring {}", step.name());
        }
    }
}

fn apply(device: &mut Device, identity: &Identity, args: &Args, found: &Found) -> Result<u32> {
    let changes = MotorChanges {
        drive: Some(args.drive.drive()),
        pole_pairs: Some(found.pole_pairs),
        resistance_ohm: Some(found.resistance_ohm.value as f32),
        d_inductance_h: Some(found.d_inductance_h.value as f32),
        q_inductance_h: Some(found.q_inductance_h.value as f32),
        torque_constant_nm_a: Some(found.torque_constant_nm_a.value as f32),
        current_max_a: Some(args.current_max as f32),
        reversed: Some(found.reversed),
        zero_turns: Some(found.zero_turns.value as f32),
        offset_b_codes: Some(found.zero_codes[0] as f32),
        offset_c_codes: Some(found.zero_codes[1] as f32),
    };
    match device.order(Request::SetMotor(changes))? {
        Outcome::Done { tick } => Ok(tick),
        Outcome::Refused(refusal) => bail!(
            "measured, but nothing was set: {}",
            words::refusal(&refusal, &identity.board, None)
        ),
    }
}

fn text(args: &Args, found: &Found, applied_at_tick: Option<u32>) -> Result<String> {
    let mut text = String::new();
    writeln!(text, "{:<28}{:>13}{:>13}{:>13}", "", "value", "low", "high")?;
    let mut rows = vec![("resistance, Ω", found.resistance_ohm)];
    if args.drive == DriveArg::Brushed {
        rows.push(("inductance, H", found.d_inductance_h));
    } else {
        rows.push(("inductance along rotor, H", found.d_inductance_h));
        rows.push(("inductance across rotor, H", found.q_inductance_h));
        rows.push(("zero of the encoder, turns", found.zero_turns));
    }
    rows.push(("torque constant, Nm/A", found.torque_constant_nm_a));
    if args.kv.is_some() {
        rows.push(("  by back-EMF alone, Nm/A", found.measured_constant_nm_a));
    }
    for (name, Estimate { value, low, high }) in rows {
        let [value, low, high] = [value, low, high].map(|it| digits(it, 5));
        writeln!(text, "{name:<28}{value:>13}{low:>13}{high:>13}")?;
    }
    if args.drive != DriveArg::Brushed {
        writeln!(text, "{:<28}{:>13}", "pole pairs", found.pole_pairs)?;
    }
    let [b, c] = found.zero_codes.map(|code| digits(code, 6));
    writeln!(text, "{:<28}{b:>13}{c:>13}", "codes without current, B C")?;
    writeln!(
        text,
        "{:<28}{:>13}",
        "noise of currents, A",
        digits(found.noise_a, 3)
    )?;
    if found.reversed {
        writeln!(
            text,
            "\nThe encoder counts against the motor (two motor wires, or its A and B, swapped): taken into account as reversed."
        )?;
    }
    if args.drive == DriveArg::Current && found.current_of_bus_a < 1.0 {
        writeln!(
            text,
            "\nThe bus drives {} A at most through this motor: --drive voltage suits it better than currents that are measured in steps of 20 mA.",
            digits(found.current_of_bus_a, 2)
        )?;
    }
    match applied_at_tick {
        Some(tick) => writeln!(
            text,
            "\nset on the device, in force from tick {tick}; `knob save` keeps it"
        )?,
        None => writeln!(text, "\nnothing was set; --apply sets it")?,
    }
    Ok(text)
}

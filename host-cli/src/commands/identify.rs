//! `knob identify`: inertia and friction of a knob, from what it did under known torques.

mod pushes;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use control::config::Interval;
use plant_sim::hold::State;
use plant_sim::identify::experiment::{Experiment, Limits, play};
use plant_sim::identify::{Estimate, Identified, Recording, identify};
use plant_sim::knob::Knob;
use protocol::Parameters;
use serde::Serialize;

use super::set;
use crate::device::{Device, Identity};
use crate::number::{self, digits};
use crate::output::{self, Output};
use crate::parameters::{self, Assignment};
use crate::ports::Connection;
use crate::recording;
use crate::scene::{self, Loaded};
use crate::stop::{self, Usage};

/// Find inertia, viscous and Coulomb friction, with the intervals in which they lie.
///
/// It pushes the connected knob: first with a torque that rises until the knob moves, then with steps of several
/// heights in both directions, and lets it coast to rest after each; some 30 seconds in all. Let the knob turn
/// freely, and keep hands off. It must be disarmed, and is disarmed afterwards, however this ends; Ctrl-C stops it.
/// Each push ends by itself within the limits, even where the cable is pulled. Where the sample period is
/// too short for the line, or counts are decimated, that is changed for the time of the pushes.
///
/// Or from a recording: a file with the columns tick, count and torque_nm, as `knob log` writes it, with a row
/// for every tick. It has to begin and end with 0.1 s at rest without torque, and to hold pushes in both
/// directions and of several heights, each followed by a coast-down to rest. Or from the same experiment on
/// the exact plant of a scene, to try it: its device, loop and hand count, and the knob starts at rest.
///
/// The intervals hold all values that explain every count; they widen with what these leave unexplained. A
/// recording that does not support an answer is refused with the reason. What no recording can show:
/// whether counts per turn and torque are right. Torques 2 % too large make all three 2 % too large.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob identify\n  knob identify --speed-max 20 --angle-max 3 --torque-max 0.05 --apply\n  knob identify --scene scenes/fig6c.toml\n  knob identify --recording pushes.csv --sample-period 1e-3 --counts-per-rev 8192 --out believed.toml\n  knob identify --recording pushes.csv --sample-period 1e-3 --counts-per-rev 8192 --apply"
)]
pub struct Args {
    /// A recording (CSV), as `knob log` writes it
    #[arg(long, value_name = "FILE.csv", conflicts_with = "scene", requires_all = ["sample_period", "counts_per_rev"])]
    recording: Option<PathBuf>,
    /// With --recording: from tick to tick, s
    #[arg(long, value_name = "S", value_parser = number::positive, requires = "recording")]
    sample_period: Option<f64>,
    /// With --recording: counts of the file in a turn, after decimation
    #[arg(long, value_name = "N", value_parser = number::positive, requires = "recording")]
    counts_per_rev: Option<f64>,
    /// A scene whose plant is pushed instead (TOML)
    #[arg(long, value_name = "SCENE.toml")]
    scene: Option<PathBuf>,
    /// The fastest that it may turn, rad/s [default: 50, on a device 0.8 of speed_max_rad_s if that is less]
    #[arg(long, value_name = "RAD/S", value_parser = number::positive, conflicts_with = "recording")]
    speed_max: Option<f64>,
    /// The furthest that it may turn from where it stands, either way, rad [default: 10]
    #[arg(long, value_name = "RAD", value_parser = number::positive, conflicts_with = "recording")]
    angle_max: Option<f64>,
    /// The largest torque commanded, Nm [default: 0.2, or torque_max_nm if that is less]
    #[arg(long, value_name = "NM", value_parser = number::positive, conflicts_with = "recording")]
    torque_max: Option<f64>,
    /// Write the table believed of a scene file
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Replace a file that exists
    #[arg(long)]
    force: bool,
    /// Set what was found on the connected knob, for the governor to use
    #[arg(long)]
    apply: bool,
    #[command(flatten)]
    connection: Connection,
}

/// An estimate, for scripts.
#[derive(Serialize)]
pub struct EstimateJson {
    value: f64,
    low: f64,
    high: f64,
}

impl From<Estimate> for EstimateJson {
    fn from(Estimate { value, low, high }: Estimate) -> Self {
        Self { value, low, high }
    }
}

#[derive(Serialize)]
struct Json<'a> {
    inertia_kg_m2: EstimateJson,
    viscous_nm_s_rad: EstimateJson,
    coulomb_nm: EstimateJson,
    /// How far the angle lies outside its count at the worst sample, counts; 0: all are explained.
    misfit_counts: f64,
    pushes: usize,
    samples: usize,
    sample_period_s: f64,
    count_rad: f64,
    /// The command that sets it.
    set: &'a str,
    /// The tick from which it is in force on the device; null without --apply.
    applied_at_tick: Option<u32>,
}

pub fn run(args: &Args) -> Result<()> {
    let mut out = match &args.out {
        Some(path) => Some(Output::prepare("--out", path, args.force)?),
        None => None,
    };
    for input in [&args.recording, &args.scene].into_iter().flatten() {
        if out.as_ref().is_some_and(|out| out.replaces(input)) {
            return Err(Usage("--out: this is what is read; give another name".into()).into());
        }
    }
    let name = |path: &Path| path.display().to_string();
    let mut connected = None;
    let (recording, source) = match (&args.recording, &args.scene) {
        (Some(path), _) => (recorded(args, path)?, name(path)),
        (None, Some(path)) => (simulated(args, path)?, name(path)),
        (None, None) => {
            let (mut device, identity) = args.connection.connect()?;
            let before = device.parameters()?;
            let recording = pushed(args, &mut device, &identity, &before)?;
            let source = format!("port {}", device.path());
            connected = Some((device, identity, before));
            (recording, source)
        }
    };
    stop::check()?;
    let found = identify(&recording).with_context(|| source.clone())?;
    if let Some((_, _, before)) = &connected {
        compare(&found, before);
    }
    let assignments = assignments(&found);
    let set = format!("knob set {}", assignments.join(" "));
    if let Some(out) = &mut out {
        let file = args.recording.as_ref().or(args.scene.as_ref());
        let file = file.and_then(|path| path.file_name());
        let of = file.map_or(source.into(), |name| name.to_string_lossy());
        write!(out, "{}", believed(&found, &of))?;
    }
    output::publish(out.into_iter().collect())?;
    let applied_at_tick = match (args.apply, connected) {
        (false, _) => None,
        (true, Some((device, identity, _))) => Some(apply((device, identity), &assignments)?),
        (true, None) => Some(apply(args.connection.connect()?, &assignments)?),
    };
    if args.connection.json {
        let json = Json {
            inertia_kg_m2: found.inertia_kg_m2.into(),
            viscous_nm_s_rad: found.viscous_nm_s_rad.into(),
            coulomb_nm: found.coulomb_nm.into(),
            misfit_counts: found.misfit_counts,
            pushes: found.pushes,
            samples: recording.samples.len(),
            sample_period_s: recording.period_s,
            count_rad: recording.count_rad,
            set: &set,
            applied_at_tick,
        };
        return output::say(&(serde_json::to_string(&json)? + "\n"));
    }
    output::say(&text(args, &found, &recording, &set, applied_at_tick)?)
}

fn recorded(args: &Args, path: &Path) -> Result<Recording> {
    let (Some(period_s), Some(counts)) = (args.sample_period, args.counts_per_rev) else {
        return Err(Usage("--recording needs --sample-period and --counts-per-rev".into()).into());
    };
    recording::load(path, period_s, std::f64::consts::TAU / counts)
}

/// The largest torque of an experiment, where nothing else is said, Nm.
const TORQUE_NM: f64 = 0.2;

/// The experiment on the plant of a scene.
fn simulated(args: &Args, path: &Path) -> Result<Recording> {
    let loaded = scene::load(path)?;
    if loaded.is_electrical() {
        bail!(
            "{}: [electrical] is not part of the experiment; accepted: a scene without it",
            path.display()
        );
    }
    let Loaded { scene, .. } = loaded;
    let limits = limits(args, scene.config.torque_max_nm);
    let start = State {
        velocity: 0.0,
        ..scene.start
    };
    let period_s = scene.clock.period_s;
    let count_rad = scene.config.count_rad();
    let mut knob = Knob::new(
        &scene.device,
        &scene.motor,
        &scene.hand,
        &scene.drive,
        period_s,
        start,
    )?;
    let most_nm = scene.config.torque_max_nm;
    let mut ticks = scene.clock.ticks(scene.seed);
    let count = |angle_rad: f64| (angle_rad / count_rad).floor() as i32;
    let mut experiment =
        Experiment::new(limits, period_s, count_rad).with_context(|| path.display().to_string())?;
    let mut now = count(start.position);
    while let Some(push) = experiment.push() {
        stop::check()?;
        let played = play(&push, &mut now, |torque_nm| {
            let given_nm = torque_nm.clamp(-most_nm, most_nm);
            let interval_s = ticks.next().unwrap_or(period_s);
            count(knob.hold(given_nm, interval_s).end.position)
        });
        let taken = experiment.take(&push, &played);
        taken.with_context(|| path.display().to_string())?;
    }
    Ok(experiment.into_recording())
}

/// The experiment on the connected knob.
fn pushed(
    args: &Args,
    device: &mut Device,
    identity: &Identity,
    before: &Parameters,
) -> Result<Recording> {
    let most_nm = f64::from(before.torque_max_nm);
    let mut limits = limits(args, most_nm);
    // What moves faster than this is a fault.
    let fastest = f64::from(before.speed_max_rad_s);
    if args.speed_max.is_none() {
        limits.speed_rad_s = limits.speed_rad_s.min(0.8 * fastest);
    }
    if limits.speed_rad_s > fastest {
        bail!(
            "--speed-max: the device takes more than speed_max_rad_s={} for a jump of the encoder; accepted: up to that",
            parameters::short(before.speed_max_rad_s)
        );
    }
    if limits.torque_nm > most_nm || most_nm == 0.0 {
        bail!(
            "the device gives no more than torque_max_nm={}; accepted: --torque-max above 0 up to that",
            parameters::short(before.torque_max_nm)
        );
    }
    eprintln!(
        "pushes the knob: up to {} Nm, {} rad/s, {} rad either way; hands off; Ctrl-C stops it",
        number::short(limits.torque_nm),
        number::short(limits.speed_rad_s),
        number::short(limits.angle_rad)
    );
    pushes::record(device, identity, limits, before)
}

/// What differs more from what was believed than motors of the same build do.
const FAR: f64 = 10.0;

/// Says so where the inertia is far from what the device believed: a wrong count size shows nowhere else.
fn compare(found: &Identified, before: &Parameters) {
    let (now, then) = (&found.inertia_kg_m2, before.inertia_kg_m2);
    if now.low > FAR * f64::from(then.high) || now.high * FAR < f64::from(then.low) {
        eprintln!(
            "the device believed an inertia of {}..{} kg m²; this is far from it. If that surprises, \
             check counts_per_rev={}",
            parameters::short(then.low),
            parameters::short(then.high),
            before.counts_per_rev
        );
    }
}

fn limits(args: &Args, torque_max_nm: f64) -> Limits {
    Limits {
        speed_rad_s: args.speed_max.unwrap_or(50.0),
        angle_rad: args.angle_max.unwrap_or(10.0),
        torque_nm: args.torque_max.unwrap_or(torque_max_nm.min(TORQUE_NM)),
    }
}

/// NAME=LOW..HIGH for each, the ends rounded outwards to what the device holds.
fn assignments(found: &Identified) -> [String; 3] {
    let believed = found.believed();
    [
        ("inertia_kg_m2", believed.inertia_kg_m2),
        ("viscous_nm_s_rad", believed.viscous_nm_s_rad),
        ("coulomb_nm", believed.coulomb_nm),
    ]
    .map(|(name, Interval { low, high })| {
        let (mut least, mut most) = (low as f32, high as f32);
        if f64::from(least) > low {
            least = least.next_down();
        }
        if f64::from(most) < high {
            most = most.next_up();
        }
        format!(
            "{name}={}..{}",
            parameters::short(least),
            parameters::short(most)
        )
    })
}

fn apply((mut device, identity): (Device, Identity), assignments: &[String; 3]) -> Result<u32> {
    let mut all = Vec::new();
    for text in assignments {
        match Assignment::read(text) {
            Ok(assignment) => all.push(assignment),
            Err(wrong) => bail!("{wrong}"),
        }
    }
    let changes = parameters::changes(&all).map_err(Usage)?;
    set::order(&mut device, &identity, &changes)
}

/// The table of a scene file. All digits of an `f64`, so that nothing is rounded inwards.
fn believed(found: &Identified, source: &str) -> String {
    let believed = found.believed();
    // A name with a line break would end the comment.
    let name = source.replace(char::is_control, " ");
    let mut text = format!("[believed] # by knob identify, from {name}\n");
    for (key, Interval { low, high }) in [
        ("inertia_kg_m2", believed.inertia_kg_m2),
        ("viscous_nm_s_rad", believed.viscous_nm_s_rad),
        ("coulomb_nm", believed.coulomb_nm),
    ] {
        text += &format!("{key} = [{low:e}, {high:e}]\n");
    }
    text
}

fn text(
    args: &Args,
    found: &Identified,
    recording: &Recording,
    set: &str,
    applied_at_tick: Option<u32>,
) -> Result<String> {
    let mut text = String::new();
    writeln!(
        text,
        "{:<20}{:>14}{:>14}{:>14}   half width",
        "", "value", "low", "high"
    )?;
    for (name, estimate) in [
        ("inertia, kg m²", found.inertia_kg_m2),
        ("viscous, Nm s/rad", found.viscous_nm_s_rad),
        ("Coulomb, Nm", found.coulomb_nm),
    ] {
        let Estimate { value, low, high } = estimate;
        let [value, low, high] = [value, low, high].map(|it| digits(it, 6));
        let half = match estimate.half_width() {
            width if width < 1.0 => format!("± {} %", number::short(100.0 * width)),
            _ => "open: push faster to narrow it".to_owned(),
        };
        writeln!(text, "{name:<20}{value:>14}{low:>14}{high:>14}   {half}")?;
    }
    writeln!(
        text,
        "\n{} pushes in {} s; {}",
        found.pushes,
        digits(recording.length_s(), 4),
        match found.misfit_counts {
            0.0 => "all counts are explained".to_owned(),
            misfit => format!(
                "the angle is up to {} counts outside its count, so the intervals are wider",
                number::short(misfit)
            ),
        }
    )?;
    if let Some(path) = &args.out {
        writeln!(text, "wrote {}", path.display())?;
    }
    match applied_at_tick {
        Some(tick) => writeln!(text, "set on the device, in force from tick {tick}")?,
        None => writeln!(text, "to set it on a device:\n  {set}")?,
    }
    Ok(text)
}

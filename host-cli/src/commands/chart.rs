//! `knob chart`: speed against accuracy, measured afresh.

pub mod report;
pub mod rungs;

use std::path::{Path, PathBuf};

use anyhow::Result;
use indicatif::ProgressBar;
use plant_sim::compare::{
    Contestant, Plane, Replay, Spread, Times, Trajectory, tick_times, times, wrong,
};
use plant_sim::kernel::InstructionSet;
use plant_sim::methods;
use plant_sim::suite::{self, Contender, Mean, SuiteError};
use plant_sim::trial::abbott_okamura;
use rayon::prelude::*;

use super::map::with_ending;
use crate::charts;
use crate::device_list::{self, Named};
use crate::output::{self, Output};
use crate::progress;
use crate::stop::{self, Stopped};

/// How accurate is each way to simulate a display, and what does it cost? Measured afresh.
///
/// Methods: the exact map, for one display and for a sweep of many; the same closed form as textbooks write it;
/// semi-implicit Euler, implicit midpoint with projected friction and Runge–Kutta of order 4 with n steps per
/// sample; DOPRI5 with events. μ = 50 throughout. Three measures against the nanoseconds per simulated sample:
///
/// Position error after 1, 10, 100, 1000 samples, and energy that the method adds or takes by itself: medians over
/// random displays that keep moving, against arithmetic of 77 digits. Wrong classes: cells of the (β, σ) plane, from 10
/// counts per sample, 8,000 samples, whose outcome (rest, limit cycle, divergence) is not the true one.
///
/// Then the laws: static stiffness over Abbott and Okamura's bound (as `knob stiffness` has it), against nanoseconds per tick
/// on this machine and instructions per tick of the firmware, as counted in the emulator.
///
/// Then the plant in physical units, phenomenon by phenomenon: what each costs and changes, and what --fidelity auto makes of it.
///
/// Times are taken in this run on one thread, all in turn, round by round; medians and quartiles. They
/// are worth most while nothing else runs.
///
/// Without --out a table, and what to conclude. With --out NAME also NAME.svg (methods), NAME-laws.svg (laws), NAME-fidelity.svg (the plant), NAME.csv (one
/// line per figure) and NAME.json (what --json prints).
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob chart --quick\n  knob chart --out speed        writes speed.svg, speed-laws.svg, speed-fidelity.svg, speed.csv, speed.json\n  knob chart --json > speed.json"
)]
pub struct Args {
    /// In seconds instead of minutes: a 20 × 20 map instead of 40 × 40, fewer displays and rounds, n up to 30
    #[arg(long)]
    quick: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Write NAME.svg, NAME-laws.svg, NAME-fidelity.svg, NAME.csv and NAME.json
    #[arg(long, value_name = "NAME")]
    out: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// Methods that differ in one number only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    Vector,
    Exact,
    ClosedForm,
    Euler,
    Midpoint,
    Rk4,
    Rk4Tanh,
    Dopri5,
}

impl Family {
    pub const ALL: [Self; 8] = [
        Self::Vector,
        Self::Exact,
        Self::ClosedForm,
        Self::Euler,
        Self::Midpoint,
        Self::Rk4,
        Self::Rk4Tanh,
        Self::Dopri5,
    ];

    /// As scripts see it.
    pub fn key(self) -> &'static str {
        match self {
            Self::Vector => "exact-vector",
            Self::Exact => "exact",
            Self::ClosedForm => "closed-form",
            Self::Euler => "euler",
            Self::Midpoint => "midpoint",
            Self::Rk4 => "rk4",
            Self::Rk4Tanh => "rk4-tanh",
            Self::Dopri5 => "dopri5",
        }
    }

    /// As a reader knows it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Vector => "exact map, many displays at once (sweep)",
            Self::Exact => "exact map, one display",
            Self::ClosedForm => "the same closed form as textbooks write it",
            Self::Euler => "semi-implicit Euler, n steps",
            Self::Midpoint => "implicit midpoint, friction projected, n steps",
            Self::Rk4 => "Runge–Kutta 4, friction by sign, n steps",
            Self::Rk4Tanh => "Runge–Kutta 4, friction by tanh, n steps",
            Self::Dopri5 => "DOPRI5 with events, by tolerance",
        }
    }

    /// A fixed number of steps per sample, and no events.
    pub fn is_fixed_step(self) -> bool {
        matches!(
            self,
            Self::Euler | Self::Midpoint | Self::Rk4 | Self::Rk4Tanh
        )
    }

    /// Steps or tolerances that are measured.
    fn settings(self, quick: bool) -> &'static [&'static str] {
        match self {
            Self::Vector | Self::Exact | Self::ClosedForm => &[""],
            Self::Dopri5 => &["1e-4", "1e-6", "1e-8", "1e-10", "1e-12"],
            // A tanh is slow, and more steps do not help it.
            Self::Rk4Tanh if quick => &["1", "3", "10"],
            _ if quick => &["1", "3", "10", "30"],
            Self::Euler | Self::Midpoint => &["1", "3", "10", "30", "100", "300"],
            Self::Rk4 => &["1", "3", "10", "30", "100"],
            Self::Rk4Tanh => &["1", "3", "10", "30"],
        }
    }

    /// About how long a sample takes, for the bar; 1 is 5 ns.
    fn work(self, setting: &str) -> u64 {
        let steps = || setting.parse().unwrap_or(1);
        match self {
            Self::Vector => 1,
            Self::Exact => 2,
            Self::ClosedForm => 4,
            Self::Euler | Self::Midpoint => 1 + steps(),
            Self::Rk4 => 5 * steps(),
            Self::Rk4Tanh => 20 * steps(),
            Self::Dopri5 => 60,
        }
    }
}

/// A sample in 77 digits, as [`Family::work`].
const PRECISE_WORK: u64 = 4_000;

/// How much is measured.
struct Extent {
    /// Cells along a side of the map.
    grid: usize,
    /// The same of the map that is checked with 77 digits.
    checked_grid: usize,
    /// Random displays.
    displays: u64,
    /// Rounds of timing.
    rounds: usize,
}

const FULL: Extent = Extent {
    grid: 40,
    checked_grid: 10,
    displays: 64,
    rounds: 15,
};

const QUICK: Extent = Extent {
    grid: 20,
    checked_grid: 4,
    displays: 16,
    rounds: 5,
};

/// Cells along a side of the map whose displays are timed: few, so that a round is short and what
/// disturbs the machine meets all methods alike.
const TIMED_GRID: usize = 4;

/// Rounds of timing ticks: they are short.
const TICK_ROUNDS: usize = 25;

/// β/μ at which the textbook's closed form is tried, besides β up to 1.
const SMALL_RATES: [f64; 2] = [1e-6, 1e-12];

/// What was measured of a method.
pub struct Measured {
    pub family: Family,
    /// Steps or tolerance, as written; empty where there is none.
    pub setting: &'static str,
    /// ns per simulated sample.
    pub times: Times,
    /// Counts, after 1, 10, 100, 1000 samples.
    pub position: [Spread; 4],
    /// K Δ² per sample, in magnitude.
    pub added: Spread,
    /// Cells of a wrong class.
    pub wrong: usize,
    /// The same as a share.
    pub class_error: f64,
}

impl Measured {
    /// As scripts see it.
    pub fn name(&self) -> String {
        name(self.family, self.setting)
    }

    /// As a reader knows it.
    fn words(&self) -> String {
        let setting = self.setting;
        let steps = match setting {
            "1" => "1 step".to_owned(),
            _ => format!("{setting} steps"),
        };
        match self.family {
            Family::Vector => "the exact map in a sweep".into(),
            Family::Exact => "the exact map".into(),
            Family::ClosedForm => "the textbook's closed form".into(),
            Family::Euler => format!("semi-implicit Euler with {steps}"),
            Family::Midpoint => format!("implicit midpoint with {steps}"),
            Family::Rk4 => format!("Runge–Kutta 4 with {steps}"),
            Family::Rk4Tanh => format!("Runge–Kutta 4 with tanh and {steps}"),
            Family::Dopri5 => format!("DOPRI5 at {setting}"),
        }
    }
}

fn name(family: Family, setting: &str) -> String {
    match setting {
        "" => family.key().to_owned(),
        _ => format!("{}:{setting}", family.key()),
    }
}

/// Position errors after 1000 samples where hardly any viscous friction is left.
pub struct SmallRate {
    pub beta_over_mu: f64,
    pub family: Family,
    pub position: Spread,
}

/// What was measured of a law.
pub struct LawMeasured {
    pub law: Contender,
    /// Static stiffness without a bad run over AO, geometric mean over the devices that have one.
    pub static_over_ao: Option<f64>,
    /// ns per tick on this machine.
    pub tick_ns: Spread,
    /// Instructions of a tick of the firmware.
    pub instructions: Option<u64>,
}

/// All figures of a run.
pub struct Figures {
    pub quick: bool,
    pub instruction_set: &'static str,
    pub grid: usize,
    pub timed_cells: usize,
    pub displays: u64,
    pub rounds: usize,
    /// Cells whose class by the exact map was checked with 77 digits, and those that differed.
    pub checked: [usize; 2],
    pub methods: Vec<Measured>,
    pub small_rates: Vec<SmallRate>,
    pub devices: usize,
    pub laws: Vec<LawMeasured>,
    pub ladders: Vec<rungs::Ladder>,
}

pub fn run(args: &Args) -> Result<()> {
    let files = match &args.out {
        Some(name) => {
            let file = |path: &Path| Output::prepare("--out", path, args.force);
            let beside = |ending| {
                let mut path = name.as_os_str().to_owned();
                path.push(ending);
                file(Path::new(&path))
            };
            Some([
                file(&with_ending(name, "svg"))?,
                beside("-laws.svg")?,
                beside("-fidelity.svg")?,
                file(&with_ending(name, "csv"))?,
                file(&with_ending(name, "json"))?,
            ])
        }
        None => None,
    };
    let figures = measure(args.quick)?;
    let json = report::json(&figures).to_string();
    let mut text = report::text(&figures)?;
    match files {
        Some(mut files) => {
            let [methods, laws, fidelity, csv, json_file] = &mut files;
            write!(methods, "{}", charts::speed::picture(&figures)?)?;
            write!(laws, "{}", charts::laws::picture(&figures)?)?;
            write!(fidelity, "{}", charts::rungs::picture(&figures)?)?;
            write!(csv, "{}", report::csv(&figures)?)?;
            writeln!(json_file, "{json}")?;
            for file in &files {
                text += &format!("wrote {}\n", file.path().display());
            }
            output::publish(files.into())?;
        }
        None => {
            text += "add --out NAME to write NAME.svg, NAME-laws.svg, NAME-fidelity.svg, NAME.csv and NAME.json\n";
        }
    }
    stop::check()?;
    output::say(&if args.json { json + "\n" } else { text })
}

/// A method and what its figures are entered under.
struct Entry {
    family: Family,
    setting: &'static str,
    contestant: Contestant,
}

fn entries(quick: bool) -> Result<Vec<Entry>> {
    let mut entries = Vec::new();
    for family in Family::ALL {
        for setting in family.settings(quick) {
            let contestant = match family {
                Family::Vector => Contestant::Vector(InstructionSet::best()),
                _ => Contestant::Scalar(methods::named(&name(family, setting))?),
            };
            entries.push(Entry {
                family,
                setting,
                contestant,
            });
        }
    }
    Ok(entries)
}

impl Extent {
    /// All that [`measure`] does, in cells of [`Family::work`] 1.
    fn work(&self, entries: &[Entry]) -> u64 {
        let cells = |grid: usize| (grid * grid) as u64;
        let once: u64 = entries.iter().map(|e| e.family.work(e.setting)).sum();
        let rounds = self.rounds as u64 + 1;
        once * (cells(self.grid) + rounds * cells(TIMED_GRID))
            + PRECISE_WORK * cells(self.checked_grid)
            + DISPLAY_WORK * self.displays * (entries.len() + SMALL_RATES.len()) as u64
            + LAW_WORK * Contender::ALL.len() as u64
            + RUNG_WORK * rungs::WAYS * rounds
    }
}

/// 100 samples in 77 digits.
const DISPLAY_WORK: u64 = PRECISE_WORK / 80;

/// A rung in a round.
const RUNG_WORK: u64 = 300;

/// A law on all devices.
const LAW_WORK: u64 = 4_000;

fn measure(quick: bool) -> Result<Figures> {
    let extent = if quick { QUICK } else { FULL };
    let entries = entries(quick)?;
    let bar = progress::bar(extent.work(&entries), "chart");
    let figures = measure_all(quick, &extent, entries, &bar);
    bar.finish_and_clear();
    stop::check()?;
    figures
}

fn measure_all(
    quick: bool,
    extent: &Extent,
    entries: Vec<Entry>,
    bar: &ProgressBar,
) -> Result<Figures> {
    let plane = Plane::new(extent.grid)?;
    let (position, added): (Vec<_>, Vec<_>) = along_trajectories(extent.displays, &entries, bar)?
        .into_iter()
        .unzip();
    let small_rates = small_rates(extent.displays, bar)?;
    let mut wrongs = Vec::new();
    for entry in &entries {
        let work = entry.family.work(entry.setting);
        let told = |cells: usize| bar.inc(work * cells as u64);
        let classes = plane.classes_by(&entry.contestant, stop::flag(), &told);
        wrongs.push(wrong(&classes.ok_or(Stopped)?, &plane.classes));
    }
    let part = Plane::new(extent.checked_grid)?;
    let told = |cells: usize| bar.inc(PRECISE_WORK * cells as u64);
    let precise = part.precise_classes(stop::flag(), &told)?.ok_or(Stopped)?;
    let checked = [precise.len(), wrong(&part.classes, &precise)];

    let devices = device_list::built_in()?;
    let (stiffness, replays) = stiffness(&devices, bar)?;

    // From here on one thread, for the times.
    let timed = Plane::new(TIMED_GRID)?;
    let work = entries.iter().map(|entry| entry.family.work(entry.setting));
    let steps: Vec<u64> = work.map(|work| work * timed.runs.len() as u64).collect();
    let next = std::cell::Cell::new(0);
    let told = || {
        bar.inc(steps[next.get() % steps.len()]);
        next.set(next.get() + 1);
    };
    let (families, contestants): (Vec<_>, Vec<_>) = entries
        .into_iter()
        .map(|entry| ((entry.family, entry.setting), entry.contestant))
        .unzip();
    let times = times(&contestants, &timed, extent.rounds, stop::flag(), &told).ok_or(Stopped)?;
    let ticks = tick_times(&replays, TICK_ROUNDS, stop::flag()).map_err(stopped)?;

    let ladders = rungs::measure(extent.rounds, bar, RUNG_WORK)?;

    let mut methods = Vec::new();
    for (number, (family, setting)) in families.into_iter().enumerate() {
        methods.push(Measured {
            family,
            setting,
            times: times[number],
            position: position[number],
            added: added[number],
            wrong: wrongs[number],
            class_error: wrongs[number] as f64 / plane.runs.len() as f64,
        });
    }
    let laws = replays.iter().zip(ticks).map(|(replay, tick_ns)| {
        let law = replay.law();
        let place = Contender::ALL.iter().position(|other| *other == law);
        LawMeasured {
            law,
            static_over_ao: place.and_then(|place| stiffness[place]),
            tick_ns,
            instructions: instructions(law),
        }
    });
    Ok(Figures {
        quick,
        instruction_set: InstructionSet::best().name(),
        grid: extent.grid,
        timed_cells: timed.runs.len(),
        displays: extent.displays,
        rounds: extent.rounds,
        checked,
        methods,
        small_rates,
        devices: devices.len(),
        laws: laws.collect(),
        ladders,
    })
}

/// Position errors and added energy of every entry, over the random displays.
fn along_trajectories(
    displays: u64,
    entries: &[Entry],
    bar: &ProgressBar,
) -> Result<Vec<([Spread; 4], Spread)>> {
    let follow = |number| {
        let trajectory = Trajectory::random(number, None)?;
        let errors = entries.iter().map(|entry| {
            stop::check()?;
            let position = trajectory.position_errors(&entry.contestant);
            let added = trajectory.added_energy(&entry.contestant);
            bar.inc(DISPLAY_WORK);
            Ok((position, added))
        });
        errors.collect()
    };
    let displays: Vec<Vec<([f64; 4], f64)>> = (0..displays)
        .into_par_iter()
        .map(follow)
        .collect::<Result<_>>()?;
    let of_entry = |entry: usize| {
        let own = || displays.iter().map(move |display| display[entry]);
        Ok((
            positions(own().map(|own| own.0))?,
            spread(own().map(|own| own.1))?,
        ))
    };
    (0..entries.len()).map(of_entry).collect()
}

fn positions(errors: impl Iterator<Item = [f64; 4]> + Clone) -> Result<[Spread; 4]> {
    let after = |place: usize| spread(errors.clone().map(|errors| errors[place]));
    Ok([after(0)?, after(1)?, after(2)?, after(3)?])
}

fn spread(values: impl Iterator<Item = f64>) -> Result<Spread> {
    Spread::of(values).ok_or_else(|| anyhow::anyhow!("there is no display to measure on"))
}

/// The exact map and the textbook's closed form as β/μ → 0.
fn small_rates(displays: u64, bar: &ProgressBar) -> Result<Vec<SmallRate>> {
    let mut all = Vec::new();
    for beta_over_mu in SMALL_RATES {
        let trajectory = |number| {
            stop::check()?;
            bar.inc(DISPLAY_WORK);
            Ok(Trajectory::random(number, Some(beta_over_mu))?)
        };
        let trajectories: Vec<Trajectory> = (0..displays)
            .into_par_iter()
            .map(trajectory)
            .collect::<Result<_>>()?;
        for family in [Family::Exact, Family::ClosedForm] {
            let contestant = Contestant::Scalar(methods::named(family.key())?);
            let errors = trajectories
                .iter()
                .map(|t| t.position_errors(&contestant)[3]);
            all.push(SmallRate {
                beta_over_mu,
                family,
                position: spread(errors)?,
            });
        }
    }
    Ok(all)
}

/// Static stiffness over AO of each law, mean over the devices, and what the ticks saw on the first.
fn stiffness(devices: &[Named], bar: &ProgressBar) -> Result<(Vec<Option<f64>>, Vec<Replay>)> {
    let of_law = |law: Contender| {
        let measured = devices
            .par_iter()
            .map(|device| suite::best(law, &device.sampled, false, stop::flag()))
            .collect::<Result<Vec<_>, SuiteError>>()?;
        let mut mean = Mean::default();
        for (device, measured) in devices.iter().zip(&measured) {
            if let Some(measured) = measured {
                mean.enter(measured.static_nm_rad / abbott_okamura(&device.sampled)?);
            }
        }
        let replay = match (devices.first(), measured.first()) {
            (Some(device), Some(Some(measured))) => {
                let demand = measured.demand_nm_rad;
                Some(Replay::record(law, &device.sampled, demand, stop::flag())?)
            }
            _ => None,
        };
        bar.inc(LAW_WORK);
        Ok((mean.value(), replay))
    };
    let laws = Contender::ALL
        .into_iter()
        .map(of_law)
        .collect::<Result<Vec<_>, SuiteError>>()
        .map_err(stopped)?;
    let (means, replays): (Vec<_>, Vec<Option<Replay>>) = laws.into_iter().unzip();
    Ok((means, replays.into_iter().flatten().collect()))
}

/// The user's Ctrl-C as such.
fn stopped(error: SuiteError) -> anyhow::Error {
    match error {
        SuiteError::Stopped => Stopped.into(),
        other => other.into(),
    }
}

/// What the firmware costs, as `cargo xtask size` counts it in the emulator.
const FIRMWARE_COST: &str = include_str!("../../../firmware/size.txt");

/// Instructions of a tick on the Cortex-M4; `None` of a law that is not in the firmware.
fn instructions(law: Contender) -> Option<u64> {
    counted(match law {
        Contender::Static => "tick_static_instructions",
        Contender::Raw => "tick_raw_instructions",
        Contender::Episode => "tick_episode_instructions",
        Contender::Ledger => "tick_ledger_instructions",
        Contender::Auto => "tick_auto_everything_instructions",
        Contender::EnergyBounding | Contender::PassivityControl | Contender::VirtualDamping => {
            return None;
        }
    })
}

/// A figure of [`FIRMWARE_COST`].
fn counted(key: &str) -> Option<u64> {
    let mut lines = FIRMWARE_COST
        .lines()
        .filter_map(|line| line.split_once(' '));
    lines.find(|(name, _)| *name == key)?.1.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_is_a_method_and_has_its_name() {
        for quick in [true, false] {
            for entry in entries(quick).unwrap() {
                assert_eq!(
                    entry.contestant.to_string(),
                    name(entry.family, entry.setting)
                );
            }
        }
    }

    #[test]
    fn the_firmware_has_a_count_of_its_own_laws_only() {
        let counted = Contender::ALL.map(|law| instructions(law).is_some());
        assert_eq!(counted, [true, false, true, true, false, false, true, true]);
        assert!(instructions(Contender::Static) < instructions(Contender::Ledger));
    }
}

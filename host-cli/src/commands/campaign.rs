//! `knob campaign`: random runs of a law, and the search for one that is bad.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, Result, anyhow, bail};
use control::config::Law;
use control::shape::Shape;
use indicatif::ProgressBar;
use plant_sim::campaign::{Bad, Campaign, Draw, Explanation, Kind, Tally, explain};
use plant_sim::closed_loop::Scene;
use plant_sim::search::{self, Goal, Summit};
use plant_sim::trial::Fault;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::number::{self, short};
use crate::output::{self, Output};
use crate::stop::{self, Interrupted, Stopped, Usage};
use crate::{progress, reasons};

/// Run random devices under a law and list every run that gives energy out, grows, or never settles.
///
/// Kinds without a hand: wall, spring, release, detent, loop (delay, lag, DAC steps, jitter, missed ticks, torque
/// limit) and changes (of demand, law, shape and centre). With a hand: push and hand; what a hand does beyond the
/// law's assumptions may end badly, and --explain tells whether it did. A run is known by its seed, kind and number. Exit
/// status 1 if a run without a hand is bad.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob campaign --state campaign.json\n  knob campaign --kind wall,push --runs 20000 --law ledger\n  knob campaign --kind hand --explain 206\n  knob campaign --search 200000"
)]
pub struct Args {
    /// What is run, separated by commas [default: all]
    #[arg(long, value_delimiter = ',', value_parser = kind, value_name = "KIND,…")]
    kind: Vec<Kind>,
    /// The law
    #[arg(long, value_enum, default_value_t = LawName::Auto)]
    law: LawName,
    /// Runs of each kind [default: 250000 of wall, spring, release and detent, 100000 of loop and changes, 60000 of push, 20000 of hand]
    #[arg(long, value_parser = number::count)]
    runs: Option<u64>,
    /// Another seed, other runs
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Keep what is done in FILE, and go on from there if it exists
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
    /// Run one run again, and say why it went as it did
    #[arg(long, value_name = "NUMBER", conflicts_with_all = ["runs", "state", "search"])]
    explain: Option<u64>,
    /// Climb towards a violation instead, with about so many evaluations
    #[arg(long, value_name = "EVALUATIONS", value_parser = number::count, conflicts_with_all = ["runs", "kind"])]
    search: Option<u64>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// The laws that promise to be passive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum LawName {
    Auto,
    Ledger,
    Episode,
    Static,
}

impl LawName {
    fn law(self) -> Law {
        match self {
            Self::Auto => Law::Auto,
            Self::Ledger => Law::Ledger,
            Self::Episode => Law::Episode,
            Self::Static => Law::Static,
        }
    }
}

fn kind(text: &str) -> Result<Kind, String> {
    Kind::named(text.trim()).ok_or_else(|| {
        let all = Kind::ALL.map(Kind::as_str).join(", ");
        format!("`{text}` is no kind of run; accepted: {all}")
    })
}

/// How many are run of a kind unless told otherwise.
fn full(kind: Kind) -> u64 {
    match kind {
        Kind::Wall | Kind::Spring | Kind::Release | Kind::Detent => 250_000,
        Kind::Loop | Kind::Changes => 100_000,
        Kind::Push => 60_000,
        Kind::Hand => 20_000,
    }
}

/// Runs after which the state is kept.
fn chunk(kind: Kind) -> u64 {
    if kind.is_free() { 10_000 } else { 1_000 }
}

/// Climbs after which it is.
const CLIMBS: u64 = 25;

pub fn run(args: &Args) -> Result<()> {
    if let Some(number) = args.explain {
        let [kind] = args.kind[..] else {
            return Err(Usage("--explain: say of which one --kind".into()).into());
        };
        return explain_one(args, kind, number);
    }
    let mut file = StateFile::open(args)?;
    if let Some(evaluations) = args.search {
        return climb(args, &mut file, evaluations);
    }
    let kinds = if args.kind.is_empty() {
        Kind::ALL.to_vec()
    } else {
        Kind::ALL
            .into_iter()
            .filter(|kind| args.kind.contains(kind))
            .collect()
    };
    let wanted: Vec<(Kind, u64)> = kinds
        .into_iter()
        .map(|kind| (kind, args.runs.unwrap_or(full(kind))))
        .collect();
    go(args, &mut file, &wanted)?;
    let tallies = wanted.iter().map(|&(kind, _)| {
        let done = file.state.runs.get(kind.as_str());
        Ok((kind, done.map_or(Ok(Tally::default()), Done::tally)?))
    });
    report(args, &tallies.collect::<Result<Vec<_>>>()?)
}

/// Makes what is missing.
fn go(args: &Args, file: &mut StateFile, wanted: &[(Kind, u64)]) -> Result<()> {
    let done = |file: &StateFile, kind: Kind| {
        let done = file.state.runs.get(kind.as_str());
        done.map_or(Ok(Tally::default()), Done::tally)
    };
    let mut before = 0;
    let mut total = 0;
    let mut bad = 0;
    for &(kind, until) in wanted {
        let tally = done(file, kind)?;
        before += tally.runs.min(until);
        total += until;
        bad += tally.bad.len() as u64;
    }
    let bar = progress::runs(total, before, "campaign");
    let bad = AtomicU64::new(bad);
    let campaign = Campaign::new(args.seed, args.law.law());
    for &(kind, until) in wanted {
        let mut tally = done(file, kind)?;
        while tally.runs < until {
            let next = (tally.runs / chunk(kind) + 1) * chunk(kind);
            let seen = |is_bad: bool| {
                bar.inc(1);
                if is_bad {
                    bad.fetch_add(1, Ordering::Relaxed);
                }
            };
            say_bad(&bar, kind.as_str(), bad.load(Ordering::Relaxed));
            if !campaign.go_on(kind, &mut tally, next.min(until), stop::flag(), &seen)? {
                bar.finish_and_clear();
                return Err(file.stopped());
            }
            file.state
                .runs
                .insert(kind.as_str().to_owned(), Done::of(&tally));
            file.keep()?;
        }
    }
    bar.finish_and_clear();
    Ok(())
}

fn say_bad(bar: &ProgressBar, what: &str, bad: u64) {
    bar.set_message(format!("{what}, {bad} bad"));
}

/// The table, and an error if what must not happen has.
fn report(args: &Args, tallies: &[(Kind, Tally)]) -> Result<()> {
    if args.json {
        let kinds: serde_json::Map<String, Value> = tallies
            .iter()
            .map(|(kind, tally)| (kind.as_str().to_owned(), tally_json(tally)))
            .collect();
        let all = json!({ "law": reasons::law(args.law.law()), "seed": args.seed, "kinds": kinds });
        output::say(&(all.to_string() + "\n"))?;
    } else {
        output::say(&table(args, tallies)?)?;
    }
    let broken: usize = tallies
        .iter()
        .filter(|(kind, _)| kind.is_free())
        .map(|(_, tally)| tally.bad.len())
        .sum();
    if broken > 0 {
        bail!("bad runs without a hand: {broken}; accepted: none");
    }
    Ok(())
}

fn tally_json(tally: &Tally) -> Value {
    let bad = tally
        .bad
        .iter()
        .map(|bad| json!({ "number": bad.number, "fault": bad.fault.as_str() }));
    json!({
        "runs": tally.runs,
        "ticks": tally.ticks,
        "worst_excess": tally.worst_excess,
        "bad": bad.collect::<Vec<_>>(),
    })
}

fn table(args: &Args, tallies: &[(Kind, Tally)]) -> Result<String> {
    let mut text = format!(
        "law {}, seed {}\n\n{:<8} {:>9}",
        reasons::law(args.law.law()),
        args.seed,
        "kind",
        "runs"
    );
    for fault in Fault::ALL {
        write!(text, " {:>11}", fault.as_str())?;
    }
    writeln!(text, " {:>12} {:>15}", "worst excess", "ticks")?;
    for (kind, tally) in tallies {
        write!(text, "{:<8} {:>9}", kind.as_str(), tally.runs)?;
        for fault in Fault::ALL {
            write!(text, " {:>11}", tally.with(fault))?;
        }
        let worst = tally.worst_excess.map_or_else(|| "–".into(), short);
        writeln!(text, " {worst:>12} {:>15}", tally.ticks)?;
    }
    let mut example = None;
    for (kind, tally) in tallies.iter().filter(|(_, tally)| !tally.bad.is_empty()) {
        writeln!(text, "\n{}:", kind.as_str())?;
        for bad in &tally.bad {
            example = Some((kind, bad.number));
            writeln!(text, "  {:>7} {}", bad.number, bad.fault.as_str())?;
        }
    }
    writeln!(
        text,
        "\nworst excess: energy given out over the energy in play"
    )?;
    if let Some((kind, number)) = example {
        writeln!(
            text,
            "why: knob campaign --law {} --seed {} --kind {} --explain {number}",
            reasons::law(args.law.law()),
            args.seed,
            kind.as_str()
        )?;
    }
    Ok(text)
}

/// What is kept of a kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Done {
    runs: u64,
    ticks: u64,
    worst_excess: Option<f64>,
    bad: Vec<(u64, String)>,
}

impl Done {
    fn of(tally: &Tally) -> Self {
        let bad = tally.bad.iter();
        Self {
            runs: tally.runs,
            ticks: tally.ticks,
            worst_excess: tally.worst_excess,
            bad: bad
                .map(|bad| (bad.number, bad.fault.as_str().to_owned()))
                .collect(),
        }
    }

    fn tally(&self) -> Result<Tally> {
        let bad = self.bad.iter().map(|(number, fault)| {
            let fault = Fault::ALL.into_iter().find(|of| of.as_str() == fault);
            Ok(Bad {
                number: *number,
                fault: fault.context("--state: a fault that is none")?,
            })
        });
        Ok(Tally {
            runs: self.runs,
            ticks: self.ticks,
            worst_excess: self.worst_excess,
            bad: bad.collect::<Result<_>>()?,
        })
    }
}

/// What is kept of a search.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Climbed {
    climbs: u64,
    /// The climbs that came closest, and how close, by what they were after.
    energy: Option<(u64, f64)>,
    cycle: Option<(u64, f64)>,
    /// The climbs that found a violation.
    violations: Vec<u64>,
}

/// What is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    version: String,
    law: String,
    seed: u64,
    /// Of the outcome of a few runs: another build whose runs differ is known by it.
    fingerprint: String,
    runs: BTreeMap<String, Done>,
    search: Climbed,
}

/// The state, and where it is kept, if anywhere.
struct StateFile {
    path: Option<PathBuf>,
    state: State,
}

impl StateFile {
    fn open(args: &Args) -> Result<Self> {
        let fresh = State {
            version: env!("CARGO_PKG_VERSION").into(),
            law: reasons::law(args.law.law()).into(),
            seed: args.seed,
            fingerprint: fingerprint(args.seed, args.law.law())?,
            runs: BTreeMap::new(),
            search: Climbed::default(),
        };
        let mut file = Self {
            path: args.state.clone(),
            state: fresh,
        };
        if let Some(path) = &args.state {
            if path.exists() {
                file.state = read(path, &file.state)?;
            } else {
                // Before the work, that it can be written.
                file.keep()?;
            }
        }
        Ok(file)
    }

    fn keep(&self) -> Result<()> {
        let Some(path) = &self.path else {
            return Ok(());
        };
        let mut file = Output::prepare("--state", path, true)?;
        writeln!(file, "{}", serde_json::to_string(&self.state)?)?;
        output::publish_after_stop(vec![file])
    }

    fn stopped(&self) -> anyhow::Error {
        match &self.path {
            Some(path) => Interrupted(path.display().to_string()).into(),
            None => Stopped.into(),
        }
    }
}

/// Reads a state that goes on as `wanted` begins.
fn read(path: &Path, wanted: &State) -> Result<State> {
    let name = format!("--state: {}", path.display());
    let text = std::fs::read_to_string(path).with_context(|| name.clone())?;
    let state: State = serde_json::from_str(&text).map_err(|error| {
        anyhow!(
            "{name} is not a whole state of a campaign ({error}); give another name, or remove it to begin anew"
        )
    })?;
    for (what, have, want) in [
        ("version", &state.version, &wanted.version),
        ("law", &state.law, &wanted.law),
        ("seed", &state.seed.to_string(), &wanted.seed.to_string()),
    ] {
        if have != want {
            bail!(
                "{name} is of {what} {have}, and {want} is asked for; give another name, or remove it to begin anew"
            );
        }
    }
    if state.fingerprint != wanted.fingerprint {
        bail!(
            "{name} was made by a build whose runs end otherwise; give another name, or remove it to begin anew"
        );
    }
    for (kind, done) in &state.runs {
        let tally = done.tally().with_context(|| name.clone())?;
        if Kind::named(kind).is_none() || tally.bad.iter().any(|bad| bad.number >= tally.runs) {
            bail!(
                "{name} is not a state of a campaign; give another name, or remove it to begin anew"
            );
        }
    }
    Ok(state)
}

/// Of the outcome of the first two runs of each kind (FNV-1a).
fn fingerprint(seed: u64, law: Law) -> Result<String> {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for kind in Kind::ALL {
        for number in 0..2 {
            let report = Draw::new(seed, kind, number).run(kind, law)?.report;
            for bits in [
                report.samples,
                report.end.position.to_bits(),
                report.given_out_j.to_bits(),
                report.account_j[1].to_bits(),
            ] {
                for byte in bits.to_le_bytes() {
                    hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
                }
            }
        }
    }
    Ok(format!("{hash:016x}"))
}

fn climb(args: &Args, file: &mut StateFile, evaluations: u64) -> Result<()> {
    let law = args.law.law();
    let climbs = evaluations.div_ceil(search::EVALUATIONS);
    let bar = progress::runs(climbs, file.state.search.climbs.min(climbs), "search");
    while file.state.search.climbs < climbs {
        let done = &mut file.state.search;
        say_bad(&bar, "climbs", done.violations.len() as u64);
        let until = ((done.climbs / CLIMBS + 1) * CLIMBS).min(climbs);
        let summits: Option<Vec<Summit>> = (done.climbs as usize..until as usize)
            .into_par_iter()
            .with_max_len(1)
            .map(|number| {
                if stop::requested() {
                    return Ok(None);
                }
                let summit = search::climb(args.seed, number as u64, law)?;
                bar.inc(1);
                Ok(Some(summit))
            })
            .collect::<Result<_>>()?;
        let Some(summits) = summits else {
            bar.finish_and_clear();
            return Err(file.stopped());
        };
        for summit in &summits {
            done.enter(summit);
        }
        done.climbs = until;
        file.keep()?;
    }
    bar.finish_and_clear();
    report_search(args, &file.state.search)
}

impl Climbed {
    fn enter(&mut self, summit: &Summit) {
        let best = match summit.goal {
            Goal::Energy => &mut self.energy,
            Goal::Cycle => &mut self.cycle,
        };
        if best.is_none_or(|(_, height)| summit.height > height) {
            *best = Some((summit.number, summit.height));
        }
        if summit.verdict.fault.is_some() {
            self.violations.push(summit.number);
        }
    }
}

fn report_search(args: &Args, done: &Climbed) -> Result<()> {
    let again = |number: u64| search::climb(args.seed, number, args.law.law());
    let closest = [done.energy, done.cycle].into_iter().flatten();
    let closest = closest
        .map(|(number, _)| again(number))
        .collect::<Result<Vec<_>, _>>()?;
    let violations = done.violations.iter().take(20);
    let violations = violations
        .map(|number| again(*number))
        .collect::<Result<Vec<_>, _>>()?;
    let summit_json = |summit: &Summit| {
        json!({
            "climb": summit.number,
            "goal": summit.goal.as_str(),
            "height": summit.height,
            "fault": summit.verdict.fault.map(Fault::as_str),
            "excess": summit.verdict.excess(),
            "trial": format!("{:?}", summit.trial),
        })
    };
    if args.json {
        let all = json!({
            "law": reasons::law(args.law.law()),
            "seed": args.seed,
            "climbs": done.climbs,
            "evaluations": done.climbs * search::EVALUATIONS,
            "violations": done.violations.len(),
            "found": violations.iter().map(summit_json).collect::<Vec<_>>(),
            "closest": closest.iter().map(summit_json).collect::<Vec<_>>(),
        });
        output::say(&(all.to_string() + "\n"))?;
    } else {
        let mut text = format!(
            "law {}, seed {}: {} climbs of up to {} evaluations, {} ended in a violation\n",
            reasons::law(args.law.law()),
            args.seed,
            done.climbs,
            search::EVALUATIONS,
            done.violations.len()
        );
        for summit in violations.iter().chain(&closest) {
            let what = match summit.goal {
                Goal::Energy => "of what friction took, the motor gave back",
                Goal::Cycle => "small turns t, as t/(t + 10)",
            };
            let ended = summit.verdict.fault.map_or("not bad", Fault::as_str);
            writeln!(
                text,
                "\nclimb {}, {ended}: {what}: {}",
                summit.number,
                short(summit.height)
            )?;
            text += &describe(&summit.trial.scene)?;
            writeln!(text, "  {:?}", summit.trial)?;
        }
        output::say(&text)?;
    }
    if done.violations.is_empty() {
        Ok(())
    } else {
        bail!("violations: {}; accepted: none", done.violations.len())
    }
}

fn explain_one(args: &Args, kind: Kind, number: u64) -> Result<()> {
    let law = args.law.law();
    let scene = Draw::new(args.seed, kind, number).trial(kind, law).scene;
    let why = explain(args.seed, kind, number, law)?;
    if args.json {
        let verdict = &why.verdict;
        let left = why.left.map(|left| {
            json!({
                "tick": left.number,
                "velocity_rad_s": left.velocity_rad_s,
                "believed_velocity_rad_s": [left.velocity.low, left.velocity.high],
                "position_rad": left.position_rad,
                "believed_position_rad": [left.position.low, left.position.high],
            })
        });
        let all = json!({
            "law": reasons::law(law),
            "seed": args.seed,
            "kind": kind.as_str(),
            "number": number,
            "fault": verdict.fault.map(Fault::as_str),
            "ticks": verdict.report.samples,
            "excess": verdict.excess(),
            "excess_j": verdict.excess_j,
            "given_out_at_tick": why.given_out,
            "left": left,
            "ticks_outside": why.ticks_outside,
            "outside_the_assumptions": why.is_outside_the_assumptions(),
            "trial": format!("{:?}", Draw::new(args.seed, kind, number).trial(kind, law)),
        });
        return output::say(&(all.to_string() + "\n"));
    }
    let mut text = format!(
        "{} {number} of seed {} under {}\n",
        kind.as_str(),
        args.seed,
        reasons::law(law)
    );
    text += &describe(&scene)?;
    text += &in_words(&why)?;
    output::say(&text)
}

/// What a run was, in words.
fn describe(scene: &Scene) -> Result<String> {
    let (device, config, hand) = (&scene.device, &scene.config, &scene.hand);
    let period_s = scene.clock.period_s;
    let mut text = format!(
        "  knob: {} kg m², {} Nm s/rad viscous, {} Nm Coulomb friction; {} counts a turn, {} ms a tick\n",
        short(device.inertia_kg_m2),
        short(device.viscous_nm_s_rad),
        short(device.coulomb_nm),
        short(std::f64::consts::TAU / config.count_rad()),
        short(1e3 * period_s),
    );
    let shape = match config.shape {
        Shape::Wall { edge_rad } => format!("a wall at {} rad", short(edge_rad)),
        Shape::Spring { centre_rad } => format!("a spring about {} rad", short(centre_rad)),
        Shape::Detent {
            centre_rad,
            period_rad,
        } => format!(
            "detents {} rad apart, one at {} rad",
            short(period_rad),
            short(centre_rad)
        ),
    };
    writeln!(
        text,
        "  renders: {shape}, {} Nm/rad demanded; starts at {} rad with {} rad/s",
        short(config.stiffness_nm_rad),
        short(scene.start.position),
        short(scene.start.velocity)
    )?;
    let (drive, clock) = (&scene.drive, &scene.clock);
    let parts = [
        ("delay", drive.delay_s / period_s, "ticks"),
        ("lag", drive.amplifier_tau_s / period_s, "ticks"),
        ("jitter", clock.jitter_s / period_s, "ticks"),
        ("missed", 100.0 * clock.missed_ticks, "%"),
        (
            "torque steps",
            drive.torque_step_nm / device.coulomb_nm,
            "c",
        ),
    ];
    let mut loop_: Vec<String> = parts
        .iter()
        .filter(|(_, value, _)| *value > 0.0)
        .map(|(name, value, unit)| format!("{name} {} {unit}", short(*value)))
        .collect();
    if config.torque_max_nm < f64::from(f32::MAX) {
        let most = short(config.torque_max_nm / device.coulomb_nm);
        loop_.push(format!("torque up to {most} c"));
    }
    if !loop_.is_empty() {
        writeln!(text, "  loop: {}", loop_.join(", "))?;
    }
    let inertia = device.inertia_kg_m2 + hand.inertia_kg_m2;
    if hand.inertia_kg_m2 > 0.0 {
        let omega = (hand.stiffness_nm_rad / inertia).sqrt();
        write!(
            text,
            "  hand: {} kg m² ({} × the knob's), {} Nm s/rad",
            short(hand.inertia_kg_m2),
            short(hand.inertia_kg_m2 / device.inertia_kg_m2),
            short(hand.damping_nm_s_rad)
        )?;
        if omega > 0.0 {
            let damping = hand.damping_nm_s_rad + device.viscous_nm_s_rad;
            writeln!(
                text,
                ", {} Nm/rad; ω·T {}, damping ratio {}",
                short(hand.stiffness_nm_rad),
                short(omega * period_s),
                short(0.5 * damping / (inertia * omega))
            )?;
        } else {
            writeln!(
                text,
                ", pushes with {} c",
                short(hand.push_nm / device.coulomb_nm)
            )?;
        }
    }
    Ok(text)
}

/// How it ended and why.
fn in_words(why: &Explanation) -> Result<String> {
    let verdict = &why.verdict;
    let mut text = String::new();
    match verdict.fault {
        None => writeln!(text, "  not bad, after {} ticks", verdict.report.samples)?,
        Some(fault) => writeln!(
            text,
            "  {} after {} ticks; given out: {} J, {} of the energy in play",
            fault.as_str(),
            verdict.report.samples,
            short(verdict.excess_j),
            short(verdict.excess())
        )?,
    }
    if let Some(left) = &why.left {
        let (what, truth, span, unit) = if left.by_velocity() {
            ("velocity", left.velocity_rad_s, left.velocity, "rad/s")
        } else {
            (
                "place in the count's cell",
                left.position_rad,
                left.position,
                "rad",
            )
        };
        writeln!(
            text,
            "  an assumption was broken: at tick {} the true {what}, {} {unit}, was outside of what the counts say, {} to {}; in {} ticks in all",
            left.number,
            short(truth),
            short(f64::from(span.low)),
            short(f64::from(span.high)),
            why.ticks_outside
        )?;
    } else {
        writeln!(
            text,
            "  no assumption was broken: the truth was within what the counts say at every tick"
        )?;
    }
    match why.given_out {
        Some(tick) if why.is_outside_the_assumptions() => {
            writeln!(
                text,
                "  energy was given out only after that, by tick {tick}"
            )?;
        }
        Some(tick) => writeln!(
            text,
            "  energy was given out within the assumptions, by tick {tick}: that must not be"
        )?,
        None => writeln!(text, "  no energy was given out")?,
    }
    Ok(text)
}

//! `knob stiffness`: how stiff each law gets, measured afresh.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use plant_sim::preset::PRESETS;
use plant_sim::suite::{self, ANY_STIFFNESS, Contender, Feel, Mean, Measured, SuiteError};
use plant_sim::trial::{Sampled, abbott_okamura};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::map::with_ending;
use crate::charts::stiffness::{Panel, Point, StiffnessChart};
use crate::device_list::{self, Named};
use crate::number::{self, digits, short};
use crate::output::{self, Output};
use crate::progress;
use crate::stop::{self, Stopped};

/// How stiff does each law get? Measured afresh on the exact plant.
///
/// Per device and law 240 runs: 96 hits against a wall and 96 flights into a spring at 0.1 to 30
/// rad/s, 48 hands that lean on a wall. A run is bad if it grows, gives energy out, oscillates or
/// never settles. The laws that clamp themselves are asked for 1e6 Nm/rad; of the others (raw,
/// passivity control, virtual damping) the largest stiffness without a bad run is found by bisection.
///
/// Static stiffness: torque over penetration at rest under a push of 30 times the Coulomb friction.
/// Hit stiffness: largest torque over largest penetration of a hit at 3 or 30 rad/s. × AO: over Abbott
/// and Okamura's bound, min(2b/T, 2c/Δ); means are geometric. Torque turns: how often its rise turns into a
/// fall, or back, in a hit at 30 rad/s; 1 where it does not chatter.
///
/// With --out also two sweeps of the RE35, over the sample period and over the counts; each
/// point is the same 240 runs.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob stiffness\n  knob stiffness --out stiffness\n  knob stiffness --devices my-knobs.toml --json\n  knob stiffness --random 50 --seed 1"
)]
pub struct Args {
    /// Devices to measure (TOML): one table `device` each, with name, inertia_kg_m2, viscous_nm_s_rad, coulomb_nm,
    /// counts_per_rev, sample_period_s and decimation (1 if absent) [default: 11 built in]
    #[arg(long, value_name = "FILE")]
    devices: Option<PathBuf>,
    /// Measure N random devices instead, on which nothing was ever chosen
    #[arg(long, value_name = "N", value_parser = number::count, conflicts_with = "devices")]
    random: Option<u64>,
    /// Which random devices
    #[arg(
        long,
        value_name = "S",
        requires = "random",
        default_value_t = 1,
        hide_default_value = true
    )]
    seed: u64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Sweep the RE35 too, and write NAME.svg, NAME.json and NAME.csv
    #[arg(long, value_name = "NAME")]
    out: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// A law as a reader of the table knows it.
pub fn title(law: Contender) -> &'static str {
    match law {
        Contender::Static => "static, AO: min(2b/T, 2c/Δ)",
        Contender::EnergyBounding => "energy bounding",
        Contender::Raw => "raw spring, K found offline",
        Contender::Episode => "episode-peak criterion",
        Contender::PassivityControl => "passivity control, K found offline",
        Contender::VirtualDamping => "virtual damping, K found offline",
        Contender::Ledger => "energy ledger",
        Contender::Auto => "auto",
    }
}

/// A device with a law: `None` where no stiffness is without a bad run.
struct Outcome {
    measured: Option<Measured>,
    /// Of a law whose stiffness is found offline: hits at what the ledger renders.
    at_ledger: Option<[Option<Feel>; 4]>,
    clamps_itself: bool,
}

/// A device, its AO, and the outcomes in the order of [`Contender::ALL`].
struct Row {
    device: Named,
    ao_nm_rad: f64,
    outcomes: Vec<Outcome>,
}

impl Row {
    fn of(&self, law: Contender) -> Option<&Measured> {
        let place = Contender::ALL.iter().position(|other| *other == law)?;
        self.outcomes[place].measured.as_ref()
    }
}

pub fn run(args: &Args) -> Result<()> {
    let files = match &args.out {
        Some(name) => {
            let file = |ending| Output::prepare("--out", &with_ending(name, ending), args.force);
            Some([file("svg")?, file("json")?, file("csv")?])
        }
        None => None,
    };
    let devices = match (&args.devices, args.random) {
        (Some(path), _) => device_list::load(path)?,
        (None, Some(count)) => device_list::random(count, args.seed),
        (None, None) => device_list::built_in()?,
    };
    let began = Instant::now();
    let sweeps = if files.is_some() { sweeps() } else { vec![] };
    let points: usize = sweeps.iter().map(|sweep| sweep.points.len()).sum();
    let laws = Contender::ALL.len();
    let bar = progress::bar(((devices.len() + points) * laws) as u64, "stiffness");
    let rows = devices
        .into_par_iter()
        .map(|device| {
            let row = row(&device, &bar);
            let of = || format!("device `{}`", device.name);
            row.map_err(stopped).with_context(of)
        })
        .collect::<Result<Vec<Row>>>();
    let panels = rows.and_then(|rows| {
        let panels: Result<Vec<Panel>> = sweeps.iter().map(|sweep| sweep.panel(&bar)).collect();
        Ok((rows, panels?))
    });
    bar.finish_and_clear();
    stop::check()?;
    let (rows, panels) = panels?;
    let runs = 2 * 120 * (rows.len() + points) * laws;
    // A log that nobody takes is no failure.
    let _ = writeln!(
        io::stderr(),
        "{}, {points} points of sweeps: {runs} runs and their searches in {:.1} s",
        how_many(rows.len()),
        began.elapsed().as_secs_f64()
    );

    let json = json(args, &rows, &panels).to_string();
    let mut text = describe(&rows)?;
    match files {
        Some(mut files) => {
            let [svg, json_file, csv] = &mut files;
            write!(svg, "{}", StiffnessChart::new(&panels).svg()?)?;
            writeln!(json_file, "{json}")?;
            write_csv(csv, &rows, &panels)?;
            for file in &files {
                writeln!(text, "wrote {}", file.path().display())?;
            }
            output::publish(files.into())?;
        }
        None => {
            text += "add --out NAME to sweep the RE35 and write NAME.svg, NAME.json and NAME.csv\n";
        }
    }
    stop::check()?;
    output::say(&if args.json { json + "\n" } else { text })
}

/// The user's Ctrl-C as such.
fn stopped(error: SuiteError) -> anyhow::Error {
    match error {
        SuiteError::Stopped => Stopped.into(),
        other => other.into(),
    }
}

fn row(device: &Named, bar: &indicatif::ProgressBar) -> Result<Row, SuiteError> {
    let sampled = &device.sampled;
    let stop = stop::flag();
    let ledger = suite::measure(Contender::Ledger, sampled, ANY_STIFFNESS, false, stop)?;
    let outcomes = Contender::ALL
        .into_par_iter()
        .map(|law| {
            let outcome = Outcome {
                measured: suite::best(law, sampled, true, stop)?,
                at_ledger: if law.is_tuned() {
                    Some(suite::feel(law, sampled, ledger.static_nm_rad, stop)?)
                } else {
                    None
                },
                clamps_itself: suite::clamps_itself(law, sampled, stop)?,
            };
            bar.inc(1);
            Ok(outcome)
        })
        .collect::<Result<Vec<Outcome>, SuiteError>>()?;
    Ok(Row {
        device: device.clone(),
        ao_nm_rad: abbott_okamura(sampled)?,
        outcomes,
    })
}

/// One thing about the RE35 that is varied.
struct Sweep {
    /// Key in JSON and CSV.
    key: &'static str,
    title: &'static str,
    axis: &'static str,
    ticks: &'static [(f64, &'static str)],
    /// Its value, and the device with it.
    points: Vec<(f64, Sampled)>,
}

/// The sample period from 0.05 to 5 ms at 8192 counts, and 256 to 65,536 counts at 1 ms.
fn sweeps() -> Vec<Sweep> {
    let re35 = &PRESETS[0];
    let sampled = |counts: f64, period_s| Sampled {
        device: re35.device,
        count_rad: std::f64::consts::TAU / counts,
        period_s,
    };
    let period = |i: u32| {
        let period_s = 5e-5 * 100_f64.powf(f64::from(i) / 16.0);
        (period_s, sampled(re35.counts_per_rev, period_s))
    };
    let counts = |i: u32| {
        let counts = 256.0 * (0.5 * f64::from(i)).exp2();
        (counts, sampled(counts, re35.period_s))
    };
    vec![
        Sweep {
            key: "sample_period_s",
            title: "RE35, 8192 counts/rev",
            axis: "sample period, ms",
            ticks: &[
                (5e-5, "0.05"),
                (1e-4, "0.1"),
                (2e-4, "0.2"),
                (5e-4, "0.5"),
                (1e-3, "1"),
                (2e-3, "2"),
                (5e-3, "5"),
            ],
            points: (0..=16).map(period).collect(),
        },
        Sweep {
            key: "counts_per_rev",
            title: "RE35, sampled every 1 ms",
            axis: "encoder, counts/rev",
            ticks: &[
                (256.0, "256"),
                (1024.0, "1024"),
                (4096.0, "4096"),
                (16384.0, "16,384"),
                (65536.0, "65,536"),
            ],
            points: (0..=16).map(counts).collect(),
        },
    ]
}

impl Sweep {
    fn panel(&self, bar: &indicatif::ProgressBar) -> Result<Panel> {
        let tasks: Vec<_> = Contender::ALL
            .into_iter()
            .flat_map(|law| self.points.iter().map(move |point| (law, point)))
            .collect();
        let points = tasks
            .into_par_iter()
            .map(|(law, (x, sampled))| {
                let measured = suite::best(law, sampled, false, stop::flag());
                bar.inc(1);
                Ok(measured.map_err(stopped)?.map(|measured| Point {
                    law,
                    x: *x,
                    static_nm_rad: measured.static_nm_rad,
                    bad: measured.bad.len(),
                }))
            })
            .collect::<Result<Vec<Option<Point>>>>()?;
        Ok(Panel {
            key: self.key,
            title: self.title,
            axis: self.axis,
            ticks: self.ticks,
            points: points.into_iter().flatten().collect(),
        })
    }
}

/// A law over all devices.
struct Summary {
    law: Contender,
    /// Static, hit at 3 and hit at 30 rad/s over AO, and over how many devices.
    over_ao: [(Option<f64>, usize); 3],
    runs: usize,
    bad: usize,
    clamps_itself: bool,
    /// Turns of the torque in a hit at 30 rad/s.
    turns: Option<f64>,
}

fn summary(rows: &[Row], law: Contender) -> Summary {
    let mut means = [(Mean::default(), 0); 3];
    let (mut runs, mut bad) = (0, 0);
    let (mut turns, mut turning) = (0.0, 0);
    for (row, measured) in rows.iter().filter_map(|row| Some((row, row.of(law)?))) {
        runs += measured.runs;
        bad += measured.bad.len();
        let [static_nm_rad, hit3, hit30] = stiffnesses(measured);
        for ((mean, count), value) in means.iter_mut().zip([static_nm_rad, hit3, hit30]) {
            if let Some(value) = value {
                mean.enter(value / row.ao_nm_rad);
                *count += 1;
            }
        }
        if let Some(feel) = measured.feel[3] {
            turns += feel.turns;
            turning += 1;
        }
    }
    let place = Contender::ALL.iter().position(|other| *other == law);
    let clamps = |row: &Row| place.is_some_and(|place| row.outcomes[place].clamps_itself);
    Summary {
        law,
        over_ao: means.map(|(mean, count)| (mean.value(), count)),
        runs,
        bad,
        clamps_itself: rows.iter().all(clamps),
        turns: (turning > 0).then(|| turns / f64::from(turning)),
    }
}

/// Static, hit at 3 and hit at 30 rad/s, Nm/rad.
fn stiffnesses(measured: &Measured) -> [Option<f64>; 3] {
    let hit = |place: usize| measured.feel[place].map(|feel| feel.stiffness_nm_rad);
    [Some(measured.static_nm_rad), hit(1), hit(3)]
}

fn how_many(count: usize) -> String {
    format!("{count} device{}", if count == 1 { "" } else { "s" })
}

/// A number, or a dash where there is none.
fn answer(number: Option<f64>) -> String {
    number.map_or("–".into(), short)
}

/// Devices that are named one by one in the text.
const NAMED: usize = 16;

fn describe(rows: &[Row]) -> Result<String> {
    let mut text = String::new();
    writeln!(
        text,
        "Stiffness without a bad run, × AO (geometric mean over {})\n",
        how_many(rows.len())
    )?;
    writeln!(
        text,
        "{:<36} {:>7} {:>9} {:>9}  {:>12}  {:<7} {:>13}",
        "law", "static", "hit at 3", "at 30", "bad runs", "clamps", "torque turns"
    )?;
    writeln!(
        text,
        "{:<36} {:>7} {:>9} {:>9}  {:>12}  {:<7} {:>13}",
        "", "", "rad/s", "rad/s", "", "itself", "in a hit"
    )?;
    for law in Contender::ALL {
        let summary = summary(rows, law);
        let [at_rest, hit3, hit30] = summary.over_ao.map(|(mean, _)| answer(mean));
        writeln!(
            text,
            "{:<36} {at_rest:>7} {hit3:>9} {hit30:>9}  {:>12}  {:<7} {:>13}",
            title(law),
            format!("{} of {}", summary.bad, summary.runs),
            if summary.clamps_itself { "yes" } else { "no" },
            answer(summary.turns)
        )?;
    }
    let fewest = |place: usize| summary(rows, Contender::Ledger).over_ao[place].1;
    if fewest(1).min(fewest(2)) < rows.len() {
        writeln!(
            text,
            "\nHits: only devices that friction does not stop before the wall, {} at 3 and {} at 30 rad/s.",
            fewest(1),
            fewest(2)
        )?;
    }
    let failed: Vec<String> = Contender::ALL
        .into_iter()
        .filter_map(|law| {
            let none = rows.iter().filter(|row| row.of(law).is_none()).count();
            (none > 0).then(|| format!("{} on {}", law.as_str(), how_many(none)))
        })
        .collect();
    if !failed.is_empty() {
        writeln!(
            text,
            "\nLeft out, as no stiffness is without a bad run: {}.",
            failed.join(", ")
        )?;
    }
    write_bad(&mut text, rows)?;

    let shown = [
        Contender::Static,
        Contender::Episode,
        Contender::VirtualDamping,
        Contender::Ledger,
        Contender::Auto,
    ];
    writeln!(text, "\nStatic stiffness, Nm/rad\n")?;
    let width = rows.iter().map(|row| row.device.name.chars().count());
    let width = width.max().unwrap_or(0).max("device".len());
    write!(text, "{:<width$}", "device")?;
    for head in ["AO", "episode", "damping*", "ledger", "auto"] {
        write!(text, " {head:>9}")?;
    }
    writeln!(text)?;
    for row in rows.iter().take(NAMED) {
        write!(text, "{:<width$}", row.device.name)?;
        for law in shown {
            let static_nm_rad = row.of(law).map(|measured| measured.static_nm_rad);
            write!(text, " {:>9}", answer(static_nm_rad))?;
        }
        writeln!(text)?;
    }
    if rows.len() > NAMED {
        writeln!(text, "… {} more: --json names all", rows.len() - NAMED)?;
    }
    writeln!(text, "* virtual damping, K found offline")?;
    if let Some(row) = rows.first() {
        write_feel(&mut text, row)?;
    }
    text.push('\n');
    Ok(text)
}

fn write_bad(text: &mut String, rows: &[Row]) -> Result<()> {
    let mut lines = vec![];
    for row in rows {
        for measured in row.outcomes.iter().filter_map(|it| it.measured.as_ref()) {
            for bad in &measured.bad {
                lines.push(format!(
                    "  {} on {}: {} run {}, {:?}",
                    measured.contender.as_str(),
                    row.device.name,
                    bad.kind.as_str(),
                    bad.number,
                    bad.fault
                ));
            }
        }
    }
    if lines.is_empty() {
        return Ok(());
    }
    writeln!(text, "\nBad runs")?;
    for line in lines.iter().take(20) {
        writeln!(text, "{line}")?;
    }
    if lines.len() > 20 {
        writeln!(text, "  … {} more: --json names all", lines.len() - 20)?;
    }
    Ok(())
}

/// What hits on a device feel like.
fn write_feel(text: &mut String, row: &Row) -> Result<()> {
    writeln!(
        text,
        "\nHits on {} at 1 / 3 / 10 / 30 rad/s; the ideal is unsampled, min(m/T², 2c/Δ)\n",
        row.device.name
    )?;
    writeln!(
        text,
        "{:<35} {:<27} {:<25} torque variation",
        "law", "speed out / in", "depth / ideal"
    )?;
    for (law, outcome) in Contender::ALL.into_iter().zip(&row.outcomes) {
        if let Some(measured) = &outcome.measured {
            write_felt(text, title(law), &measured.feel)?;
        }
        if let (Contender::VirtualDamping, Some(feel)) = (law, &outcome.at_ledger) {
            write_felt(text, "virtual damping, K of the ledger", feel)?;
        }
    }
    Ok(())
}

fn write_felt(text: &mut String, name: &str, feel: &[Option<Feel>; 4]) -> Result<()> {
    let all = |value: fn(&Feel) -> f64| {
        let each = feel.iter().map(|feel| match feel {
            Some(feel) if value(feel).is_finite() => {
                digits((value(feel) * 100.0).round() / 100.0, 3)
            }
            Some(_) => "∞".into(),
            None => "–".into(),
        });
        each.collect::<Vec<String>>().join(" / ")
    };
    writeln!(
        text,
        "{name:<35} {:<27} {:<25} {}",
        all(|feel| feel.restitution),
        all(|feel| feel.penetration),
        all(|feel| feel.torque_variation)
    )?;
    Ok(())
}

fn feel_json(feel: &[Option<Feel>; 4]) -> Value {
    feel.iter()
        .flatten()
        .map(|feel| {
            json!({
                "speed_rad_s": feel.speed_rad_s,
                "hits": feel.hits,
                "stiffness_nm_rad": feel.stiffness_nm_rad,
                "penetration": feel.penetration,
                "restitution": feel.restitution,
                "torque_variation": feel.torque_variation,
                "turns": feel.turns,
            })
        })
        .collect()
}

fn json(args: &Args, rows: &[Row], panels: &[Panel]) -> Value {
    let devices: Vec<Value> = rows
        .iter()
        .map(|row| {
            let Sampled {
                device,
                count_rad,
                period_s,
            } = row.device.sampled;
            json!({
                "name": row.device.name,
                "inertia_kg_m2": device.inertia_kg_m2,
                "viscous_nm_s_rad": device.viscous_nm_s_rad,
                "coulomb_nm": device.coulomb_nm,
                "count_rad": count_rad,
                "sample_period_s": period_s,
                "ao_nm_rad": row.ao_nm_rad,
            })
        })
        .collect();
    let laws: Vec<Value> = Contender::ALL
        .into_iter()
        .map(|law| {
            let summary = summary(rows, law);
            let [at_rest, hit3, hit30] = summary.over_ao;
            json!({
                "law": summary.law.as_str(),
                "clamps_itself": summary.clamps_itself,
                "runs": summary.runs,
                "bad": summary.bad,
                "devices": at_rest.1,
                "static_over_ao": at_rest.0,
                "hit3_over_ao": hit3.0,
                "hit3_devices": hit3.1,
                "hit30_over_ao": hit30.0,
                "hit30_devices": hit30.1,
            })
        })
        .collect();
    let mut measured = vec![];
    for row in rows {
        for (law, outcome) in Contender::ALL.into_iter().zip(&row.outcomes) {
            measured.push(measured_json(row, law, outcome));
        }
    }
    let sweeps: Vec<Value> = panels
        .iter()
        .map(|panel| {
            let points: Vec<Value> = panel
                .points
                .iter()
                .map(|point| {
                    json!({
                        "law": point.law.as_str(),
                        panel.key: point.x,
                        "static_nm_rad": point.static_nm_rad,
                        "bad": point.bad,
                    })
                })
                .collect();
            json!({ "over": panel.key, "points": points })
        })
        .collect();
    let random = args
        .random
        .map(|count| json!({ "count": count, "seed": args.seed }));
    json!({
        "devices": devices,
        "laws": laws,
        "measured": measured,
        "random": random,
        "sweeps": sweeps,
    })
}

fn measured_json(row: &Row, law: Contender, outcome: &Outcome) -> Value {
    let measured = outcome.measured.as_ref();
    let stiffness = measured.map_or([None; 3], stiffnesses);
    let over_ao = stiffness.map(|it| it.map(|it| it / row.ao_nm_rad));
    let bad_runs: Vec<Value> = measured
        .iter()
        .flat_map(|measured| &measured.bad)
        .map(|bad| {
            json!({
                "kind": bad.kind.as_str(),
                "number": bad.number,
                "fault": fault(bad.fault),
            })
        })
        .collect();
    json!({
        "device": row.device.name,
        "law": law.as_str(),
        "clamps_itself": outcome.clamps_itself,
        "demand_nm_rad": measured.map(|it| it.demand_nm_rad),
        "static_nm_rad": stiffness[0],
        "static_over_ao": over_ao[0],
        "hit3_nm_rad": stiffness[1],
        "hit3_over_ao": over_ao[1],
        "hit30_nm_rad": stiffness[2],
        "hit30_over_ao": over_ao[2],
        "runs": measured.map(|it| it.runs),
        "bad": measured.map(|it| it.bad.len()),
        "bad_runs": bad_runs,
        "feel": measured.map(|it| feel_json(&it.feel)),
        "feel_at_ledger_stiffness": outcome.at_ledger.as_ref().map(feel_json),
    })
}

fn fault(fault: plant_sim::trial::Fault) -> &'static str {
    use plant_sim::trial::Fault;
    match fault {
        Fault::Growth => "growth",
        Fault::GivenOut => "given-out",
        Fault::LimitCycle => "limit-cycle",
        Fault::Unsettled => "unsettled",
    }
}

/// One line per device and law, then one per point of a sweep.
fn write_csv(file: &mut Output, rows: &[Row], panels: &[Panel]) -> Result<()> {
    writeln!(
        file,
        "device,law,sample_period_s,counts_per_rev,ao_nm_rad,static_nm_rad,hit3_nm_rad,hit30_nm_rad,bad"
    )?;
    let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    for row in rows {
        let sampled = &row.device.sampled;
        // A name may hold a comma.
        let name = row.device.name.replace('"', "\"\"");
        for (law, outcome) in Contender::ALL.into_iter().zip(&row.outcomes) {
            let measured = outcome.measured.as_ref();
            let [at_rest, hit3, hit30] = measured.map_or([None; 3], stiffnesses).map(number);
            writeln!(
                file,
                "\"{name}\",{},{},{},{},{at_rest},{hit3},{hit30},{}",
                law.as_str(),
                sampled.period_s,
                std::f64::consts::TAU / sampled.count_rad,
                row.ao_nm_rad,
                number(measured.map(|it| it.bad.len() as f64)),
            )?;
        }
    }
    let re35 = &PRESETS[0];
    for panel in panels {
        for point in &panel.points {
            let (period_s, counts) = match panel.key {
                "sample_period_s" => (point.x, re35.counts_per_rev),
                _ => (re35.period_s, point.x),
            };
            let sampled = Sampled {
                device: re35.device,
                count_rad: std::f64::consts::TAU / counts,
                period_s,
            };
            writeln!(
                file,
                "sweep of {},{},{period_s},{counts},{},{},,,{}",
                panel.key,
                point.law.as_str(),
                abbott_okamura(&sampled)?,
                point.static_nm_rad,
                point.bad,
            )?;
        }
    }
    Ok(())
}

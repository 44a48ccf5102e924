//! How fast the exact map is: one display, many displays at once, the whole map of
//! Fig. 5, and beside them DOPRI5 with events (crate `ode_solvers`).
//!
//! `cargo bench -p plant-sim --bench speed` measures with criterion and then prints, from
//! the medians of that run, the time per sample and its ratio to the scalar map on the
//! same runs. Times are printed, never asserted.

use std::env;
use std::fs;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::{Duration, SystemTime};

use control::criterion::Dimensionless;
use criterion::{Criterion, SamplingMode};
use plant_sim::display::{Display, quantised_force};
use plant_sim::hold::{Hold, State};
use plant_sim::kernel::{self, InstructionSet};
use plant_sim::map::{Map, Shard, Span};
use plant_sim::methods::{Dopri5, Method};
use serde_json::Value;

/// Samples of each run, but for the map of Fig. 5 and the recorded runs.
const SAMPLES: u64 = 5_000;

/// Displays that the vector kernel gets at a time, as in a sweep.
const PIECE: usize = 512;

/// Relative and absolute tolerances at which DOPRI5 is run. Above the first it errs a
/// hundred times more than the exact map, or worse; below the last its error does not
/// shrink any more.
const TOLERANCES: [f64; 4] = [1e-11, 1e-12, 1e-13, 1e-14];

/// Trajectories of the acceptance tests, computed with 80 digits or more.
const RECORDED: [&str; 2] = [
    include_str!("../../tests/data/exact-map.json"),
    include_str!("../../tests/data/exact-map-further.json"),
];

fn main() {
    let mut bench = Bench::new();
    large_oscillation(&mut bench);
    limit_cycle(&mut bench);
    grid(&mut bench);
    figure_5(&mut bench);
    recorded(&mut bench, "recorded oscillations", "mu50");
    recorded(&mut bench, "recorded limit cycles", "reverses_often");
    bench.criterion.final_summary();
    bench.print_tables();
}

/// An oscillation over hundreds of counts that reverses once in 25 samples or so, and
/// does not end within [`SAMPLES`].
fn large_oscillation(bench: &mut Bench) {
    let runs: Vec<_> = (0..PIECE)
        .map(|i| moving(50.0, 0.499 + 1e-7 * i as f64, 0.6, 300.0))
        .collect();
    measure_scalar_and_batched(bench, "large oscillation", &runs);
}

/// A limit cycle about one count edge that reverses every other sample.
fn limit_cycle(bench: &mut Bench) {
    let runs: Vec<_> = (0..PIECE)
        .map(|i| moving(50.0, 0.6 + 1e-7 * i as f64, 0.42, 0.1))
        .collect();
    measure_scalar_and_batched(bench, "limit cycle", &runs);
}

/// One panel of Fig. 5, v₀ = 10: rest, limit cycles and divergence side by side.
fn grid(bench: &mut Bench) {
    let map = Map::new(50.0, SAMPLES, 100, Span::UNIT, Span::UNIT, vec![10.0])
        .expect("a map that can be swept");
    let runs: Vec<_> = (0..map.cells())
        .map(|cell| {
            let (Dimensionless { mu, beta, sigma }, v0) = map.point(cell);
            moving(mu, beta, sigma, v0)
        })
        .collect();
    measure_scalar_and_batched(bench, "100 x 100 grid", &runs);
}

/// The whole map of Fig. 5, all four panels, on every core.
fn figure_5(bench: &mut Bench) {
    let v0 = vec![2.0, 10.0, 30.0, 100.0];
    let map =
        Map::new(50.0, 50_000, 100, Span::UNIT, Span::UNIT, v0).expect("a map that can be swept");
    let set = InstructionSet::best();
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let name = format!("{}, {threads} threads", set.name());
    bench.measure("Figure 5", &name, PerRun::Whole, None, || {
        map.sweep(Shard::WHOLE, set, &AtomicBool::new(false), &|_| ())
    });
}

/// DOPRI5 against the exact map on recorded trajectories of one kind (those whose tag
/// starts with `tag`): both on the same runs, each with its error against the record.
fn recorded(bench: &mut Bench, group: &'static str, tag: &str) {
    let records = records(tag);
    measure_recorded(bench, group, SCALAR, &records, exact_step);
    for tolerance in TOLERANCES {
        let name = format!("DOPRI5 {tolerance:e}");
        let dopri5 = Dopri5 { tolerance };
        measure_recorded(bench, group, &name, &records, |hold, start| {
            dopri5.sample(hold, start, quantised_force(start.position))
        });
    }
}

fn measure_recorded(
    bench: &mut Bench,
    group: &'static str,
    name: &str,
    records: &[Record],
    step: impl Fn(&Hold, State) -> State,
) {
    let samples = PerRun::Samples(records.iter().map(|record| record.samples).sum());
    let error = Errors::of(records, &step);
    bench.measure(group, name, samples, Some(error), || {
        for record in records {
            black_box(record.follow(&step));
        }
    });
}

/// The scalar map, and the vector kernel with every instruction set, on the same runs.
/// The samples counted are those that the scalar map runs: none after a display rests.
fn measure_scalar_and_batched(bench: &mut Bench, group: &'static str, runs: &[(Display, State)]) {
    let run_all = || -> u64 {
        let lengths = runs.iter().map(|(display, start)| {
            let run = display.run(black_box(*start), SAMPLES, |_, _| true);
            black_box(run).samples
        });
        lengths.sum()
    };
    let samples = PerRun::Samples(run_all());
    bench.measure(group, SCALAR, samples, None, run_all);
    for set in InstructionSet::available() {
        bench.measure(group, set.name(), samples, None, || {
            for piece in runs.chunks(PIECE) {
                black_box(kernel::classify(set, black_box(piece), SAMPLES, |_| true));
            }
        });
    }
}

/// A display, and its start at ξ = 0 with the velocity v0 (counts per sample).
fn moving(mu: f64, beta: f64, sigma: f64, v0: f64) -> (Display, State) {
    let display = Display::new(Dimensionless { mu, beta, sigma }).expect("a display that can be");
    let start = State {
        position: 0.0,
        velocity: v0,
    };
    (display, start)
}

// --- Recorded trajectories ---------------------------------------------------------

/// A trajectory whose end is known to 30 digits.
struct Record {
    hold: Hold,
    start: State,
    samples: u64,
    end: State,
    /// The magnitude that errors are relative to: at least 1.
    scale: f64,
}

impl Record {
    /// The state after all samples, one `step` each.
    fn follow(&self, step: impl Fn(&Hold, State) -> State) -> State {
        let mut state = black_box(self.start);
        for _ in 0..self.samples {
            state = step(&self.hold, state);
        }
        state
    }

    /// How far `step` ends from the recorded end, relative.
    fn error(&self, step: impl Fn(&Hold, State) -> State) -> f64 {
        let end = self.follow(step);
        let position = (end.position - self.end.position).abs();
        let velocity = (end.velocity - self.end.velocity).abs();
        position.max(velocity) / self.scale
    }
}

/// Relative errors over a set of records.
#[derive(Clone, Copy)]
struct Errors {
    median: f64,
    worst: f64,
}

impl Errors {
    fn of(records: &[Record], step: impl Fn(&Hold, State) -> State) -> Self {
        let mut errors: Vec<f64> = records.iter().map(|record| record.error(&step)).collect();
        errors.sort_by(f64::total_cmp);
        Self {
            median: errors[errors.len() / 2],
            worst: errors[errors.len() - 1],
        }
    }
}

/// The recorded trajectories whose tag starts with `tag`, without those that come to
/// rest: a display at rest would be free for both methods.
fn records(tag: &str) -> Vec<Record> {
    let mut records = Vec::new();
    for text in RECORDED {
        let file: Value = serde_json::from_str(text).expect("recorded trajectories in JSON");
        let cases = file["cases"].as_array().expect("a list of cases");
        let wanted = cases.iter().filter(|case| {
            case["tag"].as_str().is_some_and(|own| own.starts_with(tag)) && case["v"] != "0.0"
        });
        records.extend(wanted.map(record));
    }
    records
}

fn record(case: &Value) -> Record {
    let number = |key: &str| case[key].as_f64();
    let given = |key: &str| number(key).expect("a number");
    // Numbers with more digits than an f64 are recorded as strings.
    let long = |key: &str| -> f64 { case[key].as_str().unwrap_or("").parse().expect("digits") };
    let end = State {
        position: long("xi"),
        velocity: long("v"),
    };
    let largest = number("largest").unwrap_or(end.position.abs().max(end.velocity.abs()));
    Record {
        hold: Hold::dimensionless(given("mu"), given("beta"), given("sigma"))
            .expect("a display that can be"),
        start: State {
            position: number("xi0").unwrap_or(0.0),
            velocity: given("v0"),
        },
        samples: case["n"].as_u64().expect("a number of samples"),
        end,
        scale: largest.max(1.0),
    }
}

// --- One sample, exactly and by DOPRI5 -----------------------------------------------

/// One sample in closed form.
fn exact_step(hold: &Hold, start: State) -> State {
    hold.step(start, quantised_force(start.position)).end
}

// --- Measuring and printing ----------------------------------------------------------

/// What the ratios of a group are relative to.
const SCALAR: &str = "exact scalar";

/// What one iteration of a routine runs.
#[derive(Clone, Copy)]
enum PerRun {
    /// So many display-samples.
    Samples(u64),
    /// Something told as a whole, in seconds.
    Whole,
}

/// One measured routine.
struct Row {
    group: &'static str,
    name: String,
    per_run: PerRun,
    error: Option<Errors>,
}

struct Bench {
    criterion: Criterion,
    began: SystemTime,
    rows: Vec<Row>,
}

impl Bench {
    fn new() -> Self {
        Self {
            criterion: Criterion::default()
                .sample_size(10)
                .nresamples(10_000)
                .warm_up_time(Duration::from_millis(200))
                .measurement_time(Duration::from_millis(500))
                .configure_from_args(),
            began: SystemTime::now(),
            rows: Vec::new(),
        }
    }

    /// Times a routine. Names must be fit for a file's.
    fn measure<R>(
        &mut self,
        group: &'static str,
        name: &str,
        per_run: PerRun,
        error: Option<Errors>,
        mut routine: impl FnMut() -> R,
    ) {
        let mut timed = self.criterion.benchmark_group(group);
        timed.sampling_mode(SamplingMode::Flat);
        timed.bench_function(name, |bencher| bencher.iter(&mut routine));
        timed.finish();
        self.rows.push(Row {
            group,
            name: name.to_owned(),
            per_run,
            error,
        });
    }

    /// Prints a line for every routine measured in this run: what criterion kept of
    /// earlier runs is left out.
    fn print_tables(&self) {
        let directory = criterion_directory();
        let measured = self.rows.iter().filter_map(|row| {
            let seconds = median_s(&directory, row, self.began)?;
            Some((row, seconds))
        });
        let mut scalar = None;
        let mut group = "";
        for (row, seconds) in measured {
            if row.group != group {
                group = row.group;
                scalar = None;
                print_heading(row);
            }
            let PerRun::Samples(samples) = row.per_run else {
                println!("{:24} {seconds:10.3}", row.name);
                continue;
            };
            let ns = seconds * 1e9 / samples as f64;
            if row.name == SCALAR {
                scalar = Some(ns);
            }
            let ratio = scalar.map_or("-".to_owned(), |scalar| format!("{:.3}", ns / scalar));
            print!("{:24} {ns:10.3} {ratio:>10}", row.name);
            match row.error {
                Some(Errors { median, worst }) => println!(" {median:>12.1e} {worst:>12.1e}"),
                None => println!(),
            }
        }
        if group.is_empty() {
            eprintln!("nothing was measured in this run, so there is no table");
        }
    }
}

fn print_heading(row: &Row) {
    let unit = match row.per_run {
        PerRun::Samples(_) => "ns/sample",
        PerRun::Whole => "s",
    };
    print!("\n{:24} {unit:>10}", row.group);
    if let PerRun::Samples(_) = row.per_run {
        print!(" {:>10}", "ratio");
    }
    if row.error.is_some() {
        print!(" {:>12} {:>12}", "median error", "worst error");
    }
    println!();
}

/// Where criterion keeps its estimates: where it was told to, or beside the directory
/// that this program was built in.
fn criterion_directory() -> PathBuf {
    if let Some(told) = env::var_os("CRITERION_HOME") {
        return told.into();
    }
    if let Some(target) = env::var_os("CARGO_TARGET_DIR") {
        return Path::new(&target).join("criterion");
    }
    let program = env::current_exe().unwrap_or_default();
    let mut beside = program.ancestors().map(|above| above.join("criterion"));
    beside
        .find(|directory| directory.is_dir())
        .unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/criterion"))
}

/// The median time of a routine in seconds, if it was measured since `began`.
fn median_s(directory: &Path, row: &Row, began: SystemTime) -> Option<f64> {
    let path = directory
        .join(row.group)
        .join(&row.name)
        .join("new/estimates.json");
    if fs::metadata(&path).ok()?.modified().ok()? < began {
        return None;
    }
    let estimates: Value = serde_json::from_str(&fs::read_to_string(path).ok()?).ok()?;
    Some(estimates["median"]["point_estimate"].as_f64()? * 1e-9)
}

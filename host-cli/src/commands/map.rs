//! `knob map`: the outcome over the (β, σ) plane, Fig. 5 of the paper.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use plant_sim::kernel::InstructionSet;
use plant_sim::map::{Map, MapError, Shard, Span, describing_function};
use plant_sim::outcome::{Class, Classes};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Map as Object, Value, json};

use crate::charts;
use crate::output::{self, Output};
use crate::stop::{self, Stopped, Usage};
use crate::{number, progress};

/// Map where a display comes to rest, oscillates or diverges, over the (β, σ) plane.
///
/// From ξ(0) = 0 with each initial velocity, one panel per velocity. Writes NAME.svg, NAME.csv
/// and NAME.json. Both rules are computed; --rule picks the one that is drawn and
/// stands under `classes`, in codes: 0 rest, 1 limit cycle, 2 unstable, and 3 undecided, which
/// only the window rule says, of a run of fewer than 8000 samples.
#[derive(clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  knob map --mu 50 --v0 2,10,30,100 --grid 100 --samples 50000 --out fig5\n  knob map --mu 50 --v0 10 --grid 400 --samples 50000 --shard 3/16 --out part-3\n  knob map --merge part-*.json --out fig5"
)]
pub struct Args {
    /// μ = m/(K T²)
    #[arg(long, value_parser = number::positive, required_unless_present = "merge")]
    mu: Option<f64>,
    /// Initial velocities, counts per sample, separated by commas
    #[arg(long, allow_hyphen_values = true,
        value_delimiter = ',', value_parser = velocity, required_unless_present = "merge", value_name = "V1,V2,…")]
    v0: Vec<String>,
    /// Cells along each side
    #[arg(long, value_parser = number::count, required_unless_present = "merge")]
    grid: Option<u64>,
    /// Samples per run; the window rule needs 8000, and says 3 (undecided) of fewer
    #[arg(long, value_parser = number::count, required_unless_present = "merge")]
    samples: Option<u64>,
    /// The rule that is drawn and stands under `classes`
    #[arg(long, value_enum, default_value_t = Rule::Window)]
    rule: Rule,
    /// Range of β [default: 0..1]
    #[arg(long, allow_hyphen_values = true, value_parser = span, value_name = "A..B")]
    beta: Option<Span>,
    /// Range of σ [default: 0..1]
    #[arg(long, allow_hyphen_values = true, value_parser = span, value_name = "A..B")]
    sigma: Option<Span>,
    /// Write NAME.svg, NAME.csv and NAME.json (with --shard only NAME.json)
    #[arg(long, value_name = "NAME")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Compute part I of N, counted from 1, for --merge
    #[arg(long, value_parser = shard, value_name = "I/N")]
    shard: Option<Shard>,
    /// Join the parts that --shard wrote
    #[arg(long, num_args = 1.., value_name = "PART", conflicts_with_all = ["mu", "v0", "grid", "samples", "beta", "sigma", "shard"])]
    merge: Vec<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// Which rule names the classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Rule {
    /// Peak speeds of three windows compared
    Window,
    /// |ξ̇(N)| < 0.01 at the last sample alone
    Paper,
}

impl Rule {
    fn name(self) -> &'static str {
        match self {
            Self::Window => "window",
            Self::Paper => "paper",
        }
    }

    /// The class by this rule.
    pub fn of(self, classes: Classes) -> Class {
        match self {
            Self::Window => classes.window,
            Self::Paper => classes.paper,
        }
    }
}

/// An initial velocity, checked, as the user wrote it.
fn velocity(text: &str) -> Result<String, String> {
    number::finite(text).map(|_| text.trim().to_owned())
}

fn span(text: &str) -> Result<Span, String> {
    let wrong = || format!("`{text}` is not a range; accepted: A..B with 0 ≤ A < B, such as 0..1");
    let (from, to) = text.split_once("..").ok_or_else(wrong)?;
    let (from, to) = (number::finite(from)?, number::not_negative(to)?);
    Span::new(from, to).ok_or_else(wrong)
}

fn shard(text: &str) -> Result<Shard, String> {
    let read = || {
        let (number, of) = text.split_once('/')?;
        Shard::new(number.trim().parse().ok()?, of.trim().parse().ok()?)
    };
    read().ok_or_else(|| {
        format!("`{text}` is not a part; accepted: I/N with 1 ≤ I ≤ N, such as 3/16")
    })
}

/// A swept map: what was asked, and the classes of all its cells.
pub struct Swept {
    pub map: Map,
    /// The initial velocities as written.
    pub v0: Vec<String>,
    pub rule: Rule,
    pub classes: Vec<Classes>,
}

pub fn run(args: &Args) -> Result<()> {
    if !args.merge.is_empty() {
        let files = prepare_whole(args)?;
        let (plan, classes) = merge(&args.merge)?;
        return finish(args, files, &plan.swept(classes, args.rule)?);
    }
    let (Some(mu), Some(grid), Some(samples)) = (args.mu, args.grid, args.samples) else {
        return Err(
            Usage("give all of --mu --v0 --grid --samples, or --merge PART…".into()).into(),
        );
    };
    let beta = args.beta.unwrap_or(Span::UNIT);
    let sigma = args.sigma.unwrap_or(Span::UNIT);
    let v0 = args.v0.clone();
    if let Some(twice) = v0
        .iter()
        .enumerate()
        .find_map(|(i, v)| v0[..i].contains(v).then_some(v))
    {
        return Err(Usage(format!(
            "--v0: {twice} is given twice; accepted: each velocity once"
        ))
        .into());
    }
    let plan = Plan {
        mu,
        samples,
        grid: usize::try_from(grid).unwrap_or(usize::MAX),
        beta: [beta.from(), beta.to()],
        sigma: [sigma.from(), sigma.to()],
        v0,
    };
    let map = plan.map().map_err(|error| {
        let flags = match error.downcast_ref() {
            Some(MapError::Grid(_)) => "--grid",
            Some(MapError::Samples) => "--samples",
            Some(MapError::NoVelocity | MapError::Velocity(_)) => "--v0",
            Some(MapError::Display(_)) | None => "--mu, --beta, --sigma",
        };
        Usage(format!("{flags}: {error:#}"))
    })?;
    if let Some(shard) = args.shard {
        return run_shard(args, &plan, &map, shard);
    }
    let files = prepare_whole(args)?;
    let classes = sweep(&map, Shard::WHOLE)?;
    finish(args, files, &plan.swept(classes, args.rule)?)
}

/// Sweeps with a bar, and says how long it took.
pub fn sweep(map: &Map, shard: Shard) -> Result<Vec<Classes>> {
    let cells = shard.cells(map.cells()).count();
    let bar = progress::bar((cells as u64).saturating_mul(map.samples()), "map");
    let set = InstructionSet::best();
    let began = Instant::now();
    let classes = map.sweep(shard, set, stop::flag(), &|settled| bar.inc(settled));
    bar.finish_and_clear();
    let classes = classes.ok_or(Stopped)?;
    // A log that nobody takes is no failure.
    let _ = writeln!(
        io::stderr(),
        "{cells} runs in {:.2} s ({})",
        began.elapsed().as_secs_f64(),
        set.name()
    );
    Ok(classes)
}

/// What a map was asked for, as it stands in a part's file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    mu: f64,
    samples: u64,
    grid: usize,
    beta: [f64; 2],
    sigma: [f64; 2],
    v0: Vec<String>,
}

impl Plan {
    fn map(&self) -> Result<Map> {
        let range = |[from, to]: [f64; 2]| Span::new(from, to).context("a range that is none");
        let v0 = self
            .v0
            .iter()
            .map(|text| number::finite(text).map_err(anyhow::Error::msg));
        let v0 = v0.collect::<Result<Vec<f64>>>()?;
        Ok(Map::new(
            self.mu,
            self.samples,
            self.grid,
            range(self.beta)?,
            range(self.sigma)?,
            v0,
        )?)
    }

    fn swept(self, classes: Vec<Classes>, rule: Rule) -> Result<Swept> {
        Ok(Swept {
            map: self.map()?,
            v0: self.v0,
            rule,
            classes,
        })
    }
}

/// A part's file: one digit per cell and rule, in the order of the shard's cells.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Part {
    shard: [usize; 2],
    map: Plan,
    window: String,
    paper: String,
}

fn code(class: Class) -> u8 {
    match class {
        Class::Rest => 0,
        Class::LimitCycle => 1,
        Class::Unstable => 2,
        Class::Undecided => 3,
    }
}

fn class(digit: u8) -> Option<Class> {
    [
        Class::Rest,
        Class::LimitCycle,
        Class::Unstable,
        Class::Undecided,
    ]
    .into_iter()
    .find(|class| code(*class) + b'0' == digit)
}

fn run_shard(args: &Args, plan: &Plan, map: &Map, shard: Shard) -> Result<()> {
    fits(shard, map).map_err(|error| Usage(format!("--shard: {error}")))?;
    let mut file = match &args.out {
        Some(name) => Some(Output::prepare(
            "--out",
            &with_ending(name, "json"),
            args.force,
        )?),
        None if args.json => None,
        None => {
            return Err(
                Usage("--shard: its result goes nowhere; add --out NAME or --json".into()).into(),
            );
        }
    };
    let classes = sweep(map, shard)?;
    let digits = |rule: Rule| {
        classes
            .iter()
            .map(|c| char::from(b'0' + code(rule.of(*c))))
            .collect()
    };
    let part = Part {
        shard: [shard.number(), shard.of()],
        map: plan.clone(),
        window: digits(Rule::Window),
        paper: digits(Rule::Paper),
    };
    let text = serde_json::to_string(&part)?;
    let mut said = text.clone() + "\n";
    if let Some(file) = &mut file {
        write!(file, "{text}")?;
        if !args.json {
            said = format!(
                "wrote {}: part {} of {}\n",
                file.path().display(),
                shard.number(),
                shard.of()
            );
        }
    }
    output::publish(file.into_iter().collect())?;
    output::say(&said)
}

/// Every part of a map holds a cell.
fn fits(shard: Shard, map: &Map) -> Result<(), String> {
    let (number, of, cells) = (shard.number(), shard.of(), map.cells());
    if of <= cells {
        Ok(())
    } else {
        Err(format!(
            "{number}/{of}: more parts than the map's {cells} cells; accepted: I/N with N up to {cells}"
        ))
    }
}

/// Reads the parts, makes sure that they are all parts of one map, and puts them together.
fn merge(paths: &[PathBuf]) -> Result<(Plan, Vec<Classes>)> {
    let mut whole: Option<(Plan, usize, Vec<Option<Classes>>)> = None;
    for path in paths {
        stop::check()?;
        let place = || format!("--merge: {}", path.display());
        let text = std::fs::read_to_string(path).with_context(place)?;
        let part: Part = serde_json::from_str(&text).with_context(place)?;
        let (shard, classes) = part.read().with_context(place)?;
        let (plan, of, cells) = match &mut whole {
            Some(whole) => whole,
            None => {
                let cells = vec![None; part.map.map().with_context(place)?.cells()];
                whole.insert((part.map.clone(), shard.of(), cells))
            }
        };
        if (&part.map, shard.of()) != (plan, *of) {
            bail!(
                "{}: a part of another map than {}",
                place(),
                paths[0].display()
            );
        }
        for (cell, class) in shard.cells(cells.len()).zip(classes) {
            if cells[cell].replace(class).is_some() {
                bail!(
                    "{}: part {} of {} came before",
                    place(),
                    shard.number(),
                    shard.of()
                );
            }
        }
    }
    let Some((plan, of, cells)) = whole else {
        bail!("--merge: no parts");
    };
    let empty = cells.iter().enumerate().filter(|(_, c)| c.is_none());
    let missing: BTreeSet<usize> = empty.map(|(cell, _)| cell % of + 1).collect();
    if !missing.is_empty() {
        let first: Vec<String> = missing.iter().take(20).map(usize::to_string).collect();
        let more = match missing.len() - first.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        bail!(
            "--merge: of {of} parts these are missing: {}{more}",
            first.join(", ")
        );
    }
    Ok((plan, cells.into_iter().flatten().collect()))
}

impl Part {
    fn read(&self) -> Result<(Shard, Vec<Classes>)> {
        let [number, of] = self.shard;
        let shard =
            Shard::new(number, of).with_context(|| format!("shard {number}/{of} is none"))?;
        let map = self.map.map()?;
        fits(shard, &map).map_err(anyhow::Error::msg)?;
        let cells = shard.cells(map.cells()).count();
        if (self.window.len(), self.paper.len()) != (cells, cells) {
            bail!(
                "{} and {} cells where {cells} belong",
                self.window.len(),
                self.paper.len()
            );
        }
        let pairs = self.window.bytes().zip(self.paper.bytes());
        let classes = pairs.map(|(window, paper)| {
            Some(Classes {
                window: class(window)?,
                paper: class(paper)?,
            })
        });
        let classes = classes
            .collect::<Option<_>>()
            .context("a class that is none of 0, 1, 2, 3")?;
        Ok((shard, classes))
    }
}

/// The three files of a whole map.
struct Files {
    svg: Output,
    csv: Output,
    json: Output,
}

fn prepare_whole(args: &Args) -> Result<Option<Files>> {
    let Some(name) = &args.out else {
        return Ok(None);
    };
    let file = |ending| Output::prepare("--out", &with_ending(name, ending), args.force);
    Ok(Some(Files {
        svg: file("svg")?,
        csv: file("csv")?,
        json: file("json")?,
    }))
}

pub fn with_ending(name: &Path, ending: &str) -> PathBuf {
    let mut path = name.as_os_str().to_owned();
    path.push(".");
    path.push(ending);
    path.into()
}

fn finish(args: &Args, files: Option<Files>, swept: &Swept) -> Result<()> {
    let panels = (0..swept.v0.len()).map(|panel| swept.counts(panel));
    let panels = panels.collect::<Result<Vec<Counts>, Stopped>>()?;
    let json = swept.json(&panels)?;
    let mut text = swept.describe(&panels)?;
    match files {
        Some(mut files) => {
            write!(files.svg, "{}", charts::map::panels(swept)?)?;
            swept.write_csv(&mut files.csv)?;
            write!(files.json, "{json}")?;
            let files = vec![files.svg, files.csv, files.json];
            for file in &files {
                writeln!(text, "wrote {}", file.path().display())?;
            }
            output::publish(files)?;
        }
        None => text += "add --out NAME to write NAME.svg, NAME.csv and NAME.json\n",
    }
    stop::check()?;
    output::say(&if args.json { json + "\n" } else { text })
}

/// How many cells of a panel went which way.
#[derive(Default, Serialize)]
struct Tally {
    rest: usize,
    limit_cycle: usize,
    unstable: usize,
    undecided: usize,
}

/// How a panel compares with what was predicted, in cells.
#[derive(Default, Serialize)]
struct Predictions {
    /// Satisfies (10) and is unstable: must be 0.
    criterion_missed: usize,
    /// Violates (10) and is not unstable: the criterion is sufficient, not necessary.
    criterion_false: usize,
    /// Unstable on the stable side of the describing-function line.
    describing_function_missed: usize,
    /// Not unstable on the unstable side of it.
    describing_function_false: usize,
}

/// What is counted in a panel.
#[derive(Default)]
struct Counts {
    window: Tally,
    paper: Tally,
    predictions: Predictions,
}

impl Tally {
    fn enter(&mut self, class: Class) {
        *match class {
            Class::Rest => &mut self.rest,
            Class::LimitCycle => &mut self.limit_cycle,
            Class::Unstable => &mut self.unstable,
            Class::Undecided => &mut self.undecided,
        } += 1;
    }
}

/// The codes of one panel, row by row.
struct Rows<'a> {
    swept: &'a Swept,
    panel: usize,
}

impl Serialize for Rows<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.swept.rows(self.panel).map(|(_, row)| {
            let codes = row.iter().map(|c| code(self.swept.rule.of(*c)));
            codes.collect::<Vec<u8>>()
        }))
    }
}

impl Swept {
    /// The rows of a panel: the number of the first cell of each, and the classes. They end
    /// early where the user asks to stop.
    fn rows(&self, panel: usize) -> impl Iterator<Item = (usize, &[Classes])> {
        let grid = self.map.grid();
        let rows = self.classes.chunks(grid).enumerate();
        rows.skip(panel * grid)
            .take(grid)
            .take_while(|_| !stop::requested())
            .map(move |(row, classes)| (row * grid, classes))
    }

    fn counts(&self, panel: usize) -> Result<Counts, Stopped> {
        let mut counts = Counts::default();
        for (first, row) in self.rows(panel) {
            for (cell, classes) in (first..).zip(row) {
                counts.window.enter(classes.window);
                counts.paper.enter(classes.paper);
                self.compare(cell, *classes, &mut counts.predictions);
            }
        }
        stop::check()?;
        Ok(counts)
    }

    fn compare(&self, cell: usize, classes: Classes, predictions: &mut Predictions) {
        let (point, v0) = self.map.point(cell);
        let unstable = classes.window == Class::Unstable;
        match (point.holds_at(v0), unstable) {
            (true, true) => predictions.criterion_missed += 1,
            (false, false) => predictions.criterion_false += 1,
            _ => {}
        }
        let growth = describing_function(point.beta, point.sigma, v0) < 0.5;
        match (growth, unstable) {
            (false, true) => predictions.describing_function_missed += 1,
            (true, false) => predictions.describing_function_false += 1,
            _ => {}
        }
    }

    fn json(&self, panels: &[Counts]) -> Result<String> {
        let map = &self.map;
        // As numbers, whole ones without a point, so that they read as they were written.
        let written = self.v0.iter().zip(map.v0());
        let v0: Vec<Value> = written
            .map(|(text, value)| match text.parse::<i64>() {
                Ok(whole) => json!(whole),
                Err(_) => json!(value),
            })
            .collect();
        let named = || self.v0.iter().zip(panels);
        let cells: Object<String, Value> = named()
            .map(|(text, c)| {
                let both = json!({ "window": c.window, "paper": c.paper });
                (text.clone(), both)
            })
            .collect();
        let predictions: Object<String, Value> = named()
            .map(|(text, c)| (text.clone(), json!(c.predictions)))
            .collect();
        let head = json!({
            "mu": map.point(0).0.mu,
            "samples": map.samples(),
            "grid": map.grid(),
            "rule": self.rule.name(),
            "beta": [map.beta().from(), map.beta().to()],
            "sigma": [map.sigma().from(), map.sigma().to()],
            "v0": v0,
            "cells": cells,
            "predictions": predictions,
        });
        let classes: BTreeMap<&str, Rows<'_>> = (self.v0.iter().enumerate())
            .map(|(panel, text)| (text.as_str(), Rows { swept: self, panel }))
            .collect();
        let whole = Whole { head, classes };
        let text = serde_json::to_string(&whole)?;
        stop::check()?;
        Ok(text)
    }

    fn write_csv(&self, csv: &mut Output) -> Result<()> {
        writeln!(csv, "v0,beta,sigma,class_window,class_paper")?;
        for (panel, text) in self.v0.iter().enumerate() {
            for (first, row) in self.rows(panel) {
                for (cell, classes) in (first..).zip(row) {
                    let (point, _) = self.map.point(cell);
                    writeln!(
                        csv,
                        "{text},{},{},{},{}",
                        point.beta, point.sigma, classes.window, classes.paper
                    )?;
                }
            }
        }
        Ok(stop::check()?)
    }

    fn describe(&self, panels: &[Counts]) -> Result<String> {
        let mut text = String::from(
            "           window rule                      paper's rule                     of the unstable, missed by\n      \
             v₀   rest   cycle  unstable  unclear  rest   cycle  unstable  unclear  (10)  describing function\n",
        );
        let row = |t: &Tally| {
            format!(
                "{:<6} {:<6} {:<9} {:<8}",
                t.rest, t.limit_cycle, t.unstable, t.undecided
            )
        };
        for (v0, counts) in self.v0.iter().zip(panels) {
            writeln!(
                text,
                "{v0:>8}   {} {} {:<5} {}",
                row(&counts.window),
                row(&counts.paper),
                counts.predictions.criterion_missed,
                counts.predictions.describing_function_missed
            )?;
        }
        let needed = plant_sim::outcome::WINDOW_RULE_SAMPLES;
        if self.rule == Rule::Window && self.map.samples() < needed {
            writeln!(text, "the window rule needs {needed} samples")?;
        }
        Ok(text)
    }
}

/// What `--json` prints: the classes, which may be many, beside the rest.
#[derive(Serialize)]
struct Whole<'a> {
    #[serde(flatten)]
    head: Value,
    classes: BTreeMap<&'a str, Rows<'a>>,
}

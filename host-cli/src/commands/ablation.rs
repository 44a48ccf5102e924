//! `knob ablation`: the energy ledger without each of its parts in turn.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Result;
use plant_sim::ablation::{self, Outcome, Variant};

use crate::device_list;
use plant_sim::campaign::Kind;
use serde_json::{Value, json};

use super::map::with_ending;
use crate::number::{self, short};
use crate::output::{self, Output};
use crate::progress;
use crate::stop::{self, Stopped};

/// Take each part out of the energy ledger in turn: how stiff it is, and what breaks.
///
/// Over the systematic suite of 11 devices and random runs of each kind. A kind that has shown a hundred
/// bad runs is not run further.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob ablation --runs 5000\n  knob ablation --out docs/ablation --force"
)]
pub struct Args {
    /// Random runs of each kind
    #[arg(long, default_value_t = 600, value_parser = number::count)]
    runs: u64,
    /// Another seed, other runs
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write NAME.md, NAME.csv and NAME.json
    #[arg(long, value_name = "NAME")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

pub fn run(args: &Args) -> Result<()> {
    let files = args
        .out
        .as_ref()
        .map(|name| {
            ["md", "csv", "json"]
                .into_iter()
                .map(|ending| Output::prepare("--out", &with_ending(name, ending), args.force))
                .collect::<Result<Vec<_>>>()
        })
        .transpose()?;
    let measured = measure(args)?;
    let json = json!({
        "runs": args.runs,
        "seed": args.seed,
        "variants": measured.iter().map(|(v, o)| as_json(v, o)).collect::<Vec<_>>(),
    });
    let mut said = if args.json {
        json.to_string() + "\n"
    } else {
        table(&measured)?
    };
    if let Some(mut files) = files {
        for (file, text) in files.iter_mut().zip([
            document(args, &measured)?,
            csv(&measured)?,
            json.to_string() + "\n",
        ]) {
            write!(file, "{text}")?;
            if !args.json {
                writeln!(said, "wrote {}", file.path().display())?;
            }
        }
        output::publish(files)?;
    }
    output::say(&said)
}

fn measure(args: &Args) -> Result<Vec<(Variant, Outcome)>> {
    let devices: Vec<_> = device_list::built_in()?
        .iter()
        .map(|named| named.sampled)
        .collect();
    let variants = ablation::variants();
    let bar = progress::bar(variants.len() as u64, "ablation");
    let measured = variants.into_iter().map(|variant| {
        bar.set_message(variant.name);
        let outcome = ablation::measure(
            &variant,
            &devices,
            args.runs,
            args.seed,
            stop::flag(),
            &|| {},
        )?;
        bar.inc(1);
        Ok((variant, outcome.ok_or(Stopped)?))
    });
    let measured = measured.collect::<Result<Vec<_>>>();
    bar.finish_and_clear();
    measured
}

/// Bad runs of a kind, and of how many where that is not all.
fn cell(outcome: &Outcome, kind: Kind, most: u64) -> String {
    let of = outcome.random.iter().find(|(of, _)| *of == kind);
    of.map_or_else(String::new, |(_, tally)| {
        if tally.runs < most {
            format!("{}/{}", tally.bad.len(), tally.runs)
        } else {
            tally.bad.len().to_string()
        }
    })
}

/// Random runs of a kind where none was cut short.
fn most(measured: &[(Variant, Outcome)]) -> u64 {
    let runs = measured.iter().flat_map(|(_, outcome)| &outcome.random);
    runs.map(|(_, tally)| tally.runs).max().unwrap_or(0)
}

fn table(measured: &[(Variant, Outcome)]) -> Result<String> {
    let most = most(measured);
    let mut text = format!(
        "{:<24} {:>9} {:>5} {:>6} {:>5}",
        "", "stiffness", "wall", "spring", "lean"
    );
    for kind in Kind::ALL {
        write!(text, " {:>9}", kind.as_str())?;
    }
    text.push('\n');
    for (variant, outcome) in measured {
        let [wall, spring, lean] = outcome.suite_bad;
        write!(
            text,
            "{:<24} {:>9} {wall:>5} {spring:>6} {lean:>5}",
            variant.name,
            short(outcome.stiffness)
        )?;
        for kind in Kind::ALL {
            write!(text, " {:>9}", cell(outcome, kind, most))?;
        }
        text.push('\n');
    }
    writeln!(
        text,
        "\nstiffness: × Abbott and Okamura's; bad runs of the suite (wall, spring, lean) and of {most} random runs of each kind"
    )?;
    Ok(text)
}

fn document(args: &Args, measured: &[(Variant, Outcome)]) -> Result<String> {
    let most = most(measured);
    let suite = measured.first().map_or(0, |(_, o)| o.suite_runs);
    let mut text = format!(
        "# The energy ledger without one of its parts\n\n\
         Written by `cargo xtask ablation` (`knob ablation --runs {} --seed {}`); do not edit.\n\n\
         Each row is the ledger with one part taken out or one constant changed, everything else as built. *Stiffness*: static, \
         under a push of 30 c, over min(2b/T, 2c/Δ) (Abbott and Okamura), geometric mean over 11 devices. *Suite*: bad runs of \
         {suite}: on each device 96 wall hits, 96 flights into a spring and 48 leaning hands. *Random*: bad runs of {most} of each kind of `knob campaign`; \
         n/N where N runs had shown enough. Bad is energy given out, growth, a limit cycle, or no rest within a million ticks and \
         more (suite: 256,000).\n\n",
        args.runs, args.seed
    );
    text += "| | stiffness | suite: wall | spring | lean |";
    for kind in Kind::ALL {
        write!(text, " {} |", kind.as_str())?;
    }
    text += "\n|---|---|---|---|---|";
    text += &"---|".repeat(Kind::ALL.len());
    text.push('\n');
    for (variant, outcome) in measured {
        let [wall, spring, lean] = outcome.suite_bad;
        write!(
            text,
            "| {} | {:.1} | {wall} | {spring} | {lean} |",
            variant.name, outcome.stiffness
        )?;
        for kind in Kind::ALL {
            write!(text, " {} |", cell(outcome, kind, most))?;
        }
        text.push('\n');
    }
    text += "\nWhat each is for, and what is lost without it:\n\n";
    let Some((_, built)) = measured.first() else {
        return Ok(text);
    };
    for (variant, outcome) in &measured[1..] {
        writeln!(
            text,
            "- *{}*: {}. {}",
            variant.name,
            variant.purpose,
            lost(built, outcome)
        )?;
    }
    Ok(text)
}

/// What a variant loses against the ledger as built.
fn lost(built: &Outcome, outcome: &Outcome) -> String {
    let mut parts = Vec::new();
    let stiffness = outcome.stiffness / built.stiffness;
    if !(0.99..1.01).contains(&stiffness) {
        parts.push(format!("{} × the stiffness", short(stiffness)));
    }
    let sum = |outcome: &Outcome| outcome.suite_bad.iter().sum::<usize>();
    if sum(outcome) > sum(built) {
        parts.push(format!("{} runs of the suite", sum(outcome)));
    }
    for kind in Kind::ALL {
        let (now, before) = (outcome.rate(kind), built.rate(kind));
        if now > before {
            parts.push(format!(
                "{} % of {} (built: {} %)",
                short(100.0 * now),
                kind.as_str(),
                short(100.0 * before)
            ));
        }
    }
    if parts.is_empty() {
        "Nothing measured here.".into()
    } else {
        parts.join(", ") + "."
    }
}

fn csv(measured: &[(Variant, Outcome)]) -> Result<String> {
    let mut text = String::from("variant,stiffness_over_ao,suite_wall,suite_spring,suite_lean");
    for kind in Kind::ALL {
        write!(text, ",{0}_bad,{0}_runs", kind.as_str())?;
    }
    text.push('\n');
    for (variant, outcome) in measured {
        let [wall, spring, lean] = outcome.suite_bad;
        write!(
            text,
            "\"{}\",{},{wall},{spring},{lean}",
            variant.name, outcome.stiffness
        )?;
        for (_, tally) in &outcome.random {
            write!(text, ",{},{}", tally.bad.len(), tally.runs)?;
        }
        text.push('\n');
    }
    Ok(text)
}

fn as_json(variant: &Variant, outcome: &Outcome) -> Value {
    let [wall, spring, lean] = outcome.suite_bad;
    let random: serde_json::Map<String, Value> = outcome
        .random
        .iter()
        .map(|(kind, tally)| {
            let faults = tally.bad.iter().fold(
                serde_json::Map::new(),
                |mut all: serde_json::Map<String, Value>, bad| {
                    let name = bad.fault.as_str();
                    let before = all.get(name).and_then(Value::as_u64).unwrap_or(0);
                    all.insert(name.into(), json!(before + 1));
                    all
                },
            );
            let value = json!({ "runs": tally.runs, "bad": tally.bad.len(), "faults": faults });
            (kind.as_str().to_owned(), value)
        })
        .collect();
    json!({
        "variant": variant.name,
        "purpose": variant.purpose,
        "stiffness_over_ao": outcome.stiffness,
        "suite": { "runs": outcome.suite_runs, "wall": wall, "spring": spring, "lean": lean },
        "random": random,
    })
}

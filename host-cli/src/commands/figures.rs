//! `knob figures`: the paper's figures, computed afresh.

use std::path::PathBuf;

use anyhow::{Context, Result};
use plant_sim::map::{Map, Shard, Span};
use serde::Serialize;
use serde_json::json;

use super::map::{Rule, Swept, sweep};
use crate::charts;
use crate::charts::run::{Envelope, RunChart};
use crate::output::{self, Output};
use crate::{scene, stop};

/// Draw the paper's Figs. 3 to 6, computed afresh.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  knob figures --out figures")]
pub struct Args {
    /// The folder to write to; it is made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON object: the files and what they show
    #[arg(long)]
    json: bool,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// The scenes of Fig. 6, as they stand in the repository.
const FIG_6: [(&str, &str); 4] = [
    ("fig6a", include_str!("../../../scenes/fig6a.toml")),
    ("fig6b", include_str!("../../../scenes/fig6b.toml")),
    ("fig6c", include_str!("../../../scenes/fig6c.toml")),
    ("fig6d", include_str!("../../../scenes/fig6d.toml")),
];

/// The initial velocities of Fig. 5, counts per sample.
const FIG_5_V0: [f64; 4] = [2.0, 10.0, 30.0, 100.0];

/// A figure that was drawn.
#[derive(Serialize)]
struct Figure {
    file: PathBuf,
    shows: String,
}

pub fn run(args: &Args) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("--out: {}", args.out.display()))?;
    let names = ["fig3", "fig4", "fig5a", "fig5b", "fig5-panels"].into_iter();
    let mut outputs = names
        .chain(FIG_6.map(|(name, _)| name))
        .map(|name| Output::prepare("--out", &args.out.join(format!("{name}.svg")), args.force))
        .collect::<Result<Vec<_>>>()?;

    let drawings = draw()?;
    let mut figures = Vec::new();
    for (output, (svg, shows)) in outputs.iter_mut().zip(drawings) {
        write!(output, "{svg}")?;
        let file = output.path().to_owned();
        figures.push(Figure { file, shows });
    }
    output::publish(outputs)?;
    if args.json {
        return output::say(&(json!({ "figures": figures }).to_string() + "\n"));
    }
    let lines = figures.iter().map(|figure| {
        format!(
            "{:<40} {}\n",
            figure.file.display().to_string(),
            figure.shows
        )
    });
    output::say(&lines.collect::<String>())
}

/// All figures and what they show.
fn draw() -> Result<Vec<(String, String)>> {
    let map = Map::new(50.0, 50_000, 100, Span::UNIT, Span::UNIT, FIG_5_V0.into())?;
    let swept = Swept {
        classes: sweep(&map, Shard::WHOLE)?,
        map,
        v0: FIG_5_V0.iter().map(f64::to_string).collect(),
        rule: Rule::Window,
    };
    let mut drawings = vec![
        (charts::figures::regions()?, "the four regions".into()),
        (charts::figures::arrows()?, "effect of K, T and Δ".into()),
        (
            charts::figures::unstable(&swept)?,
            "unstable displays, predicted and computed".into(),
        ),
        (
            charts::figures::oscillating(&swept)?,
            "oscillating displays, by both rules".into(),
        ),
        (
            charts::map::panels(&swept)?,
            "all classes, one panel per initial velocity".into(),
        ),
    ];
    for (name, text) in FIG_6 {
        let scene = scene::parse(text).with_context(|| format!("scenes/{name}.toml"))?;
        let mut envelope = Envelope::new();
        let report = scene.run(|sample| {
            envelope.enter(
                sample.number as f64 * scene.config.timing.period_s,
                sample.state.position,
            );
            !stop::requested()
        })?;
        stop::check()?;
        let chart = RunChart::new(name, &scene, &report, &envelope)?;
        let shows = format!("testbed: {} after {} samples", report.class, report.samples);
        drawings.push((chart.svg()?, shows));
    }
    Ok(drawings)
}

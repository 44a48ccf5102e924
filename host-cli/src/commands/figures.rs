//! `knob figures`: the paper's figures, computed afresh.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use plant_sim::map::{Map, Shard, Span};

use super::map::{Rule, Swept, sweep};
use crate::charts;
use crate::charts::run::{Envelope, RunChart};
use crate::output::Output;
use crate::scene;

/// Draw the paper's Figs. 3 to 6, computed afresh.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  knob figures --out figures")]
pub struct Args {
    /// The folder to write to; it is made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
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

pub fn run(args: &Args) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("--out: {}", args.out.display()))?;
    let file =
        |name: &str| Output::prepare("--out", &args.out.join(format!("{name}.svg")), args.force);
    let (regions, arrows) = (file("fig3")?, file("fig4")?);
    let (unstable, oscillating, panels) = (file("fig5a")?, file("fig5b")?, file("fig5-panels")?);
    let runs = FIG_6.map(|(name, _)| file(name));

    let write = |output: &Output, svg: String, what: &str| {
        output.write(svg.as_bytes())?;
        println!("{:<40} {what}", output.path().display().to_string());
        anyhow::Ok(())
    };
    write(&regions, charts::figures::regions()?, "the four regions")?;
    write(&arrows, charts::figures::arrows()?, "effect of K, T and Δ")?;

    let map = Map::new(50.0, 50_000, 100, Span::UNIT, Span::UNIT, FIG_5_V0.into())?;
    let swept = Swept {
        classes: sweep(&map, Shard::WHOLE)?,
        map,
        v0: FIG_5_V0.iter().map(f64::to_string).collect(),
        rule: Rule::Window,
    };
    write(
        &unstable,
        charts::figures::unstable(&swept)?,
        "unstable displays, predicted and computed",
    )?;
    write(
        &oscillating,
        charts::figures::oscillating(&swept)?,
        "oscillating displays, by both rules",
    )?;
    write(
        &panels,
        charts::map::panels(&swept)?,
        "all classes, one panel per initial velocity",
    )?;

    for ((name, text), output) in FIG_6.into_iter().zip(runs) {
        let scene = scene::parse(text).with_context(|| format!("scenes/{name}.toml"))?;
        let mut envelope = Envelope::new();
        let report = scene.run(|sample| {
            envelope.enter(
                sample.number as f64 * scene.config.period_s,
                sample.state.position,
            );
            true
        })?;
        if report.samples == 0 {
            bail!("scenes/{name}.toml runs no sample");
        }
        let chart = RunChart::new(name, &scene, &report, &envelope)?;
        let what = format!("testbed: {} after {} samples", report.class, report.samples);
        write(&output?, chart.svg()?, &what)?;
    }
    Ok(())
}

//! `knob simulate`: one run on the exact plant.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use control::criterion::{Criterion, Dimensionless, Sampling};
use plant_sim::closed_loop::{Report, Scene};
use plant_sim::display::Display;
use plant_sim::energy::Ledger;
use plant_sim::hold::State;
use plant_sim::outcome::{Class, DIVERGED_COUNTS};
use serde::Serialize;

use crate::charts::run::{Envelope, RunChart};
use crate::output::{Draft, Output};
use crate::stop::{self, Stopped, Usage};
use crate::{number, scene};

/// Run one scene, or one dimensionless display, on the exact plant.
///
/// Either a scene file, or all of --mu --beta --sigma --v0 --samples for the display (6).
#[derive(clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  knob simulate scenes/fig6c.toml --plot run.svg\n  knob simulate --mu 50 --beta 0.3 --sigma 0.7 --v0 10 --samples 50000 --json"
)]
pub struct Args {
    /// The scene file (TOML)
    #[arg(conflicts_with_all = ["mu", "beta", "sigma", "v0", "xi0", "samples"])]
    scene: Option<PathBuf>,

    /// μ = m/(K T²)
    #[arg(long, value_parser = number::positive, requires_all = ["beta", "sigma", "v0", "samples"])]
    mu: Option<f64>,
    /// β = b/(K T)
    #[arg(long, value_parser = number::not_negative, requires = "mu")]
    beta: Option<f64>,
    /// σ = c/(K Δ)
    #[arg(long, value_parser = number::not_negative, requires = "mu")]
    sigma: Option<f64>,
    /// Initial velocity, counts per sample
    #[arg(long, value_parser = in_reach, requires = "mu")]
    v0: Option<f64>,
    /// Initial position, counts [default: 0]
    #[arg(long, value_parser = in_reach, requires = "mu")]
    xi0: Option<f64>,
    /// Samples to run; fewer if it comes to rest
    #[arg(long, value_parser = number::count, requires = "mu")]
    samples: Option<u64>,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Write every sample of the scene as CSV
    #[arg(long, value_name = "OUT.csv", requires = "scene")]
    trace: Option<PathBuf>,
    /// Draw the scene: point and critical line in the plane, angle against time
    #[arg(long, value_name = "OUT.svg", requires = "scene")]
    plot: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// A finite number of at most 1e9 counts, beyond which a run has diverged.
fn in_reach(text: &str) -> Result<f64, String> {
    let number = number::finite(text)?;
    if number.abs() <= DIVERGED_COUNTS {
        Ok(number)
    } else {
        Err(format!(
            "{text} is beyond {DIVERGED_COUNTS:e}; accepted: a finite number within ±1e9"
        ))
    }
}

pub fn run(args: &Args) -> Result<()> {
    match (
        &args.scene,
        args.mu,
        args.beta,
        args.sigma,
        args.v0,
        args.samples,
    ) {
        (Some(path), ..) => run_scene(args, path),
        (None, Some(mu), Some(beta), Some(sigma), Some(v0), Some(samples)) => {
            let start = State {
                position: args.xi0.unwrap_or(0.0),
                velocity: v0,
            };
            run_display(args, Dimensionless { mu, beta, sigma }, start, samples)
        }
        _ => Err(
            Usage("give a scene file, or all of --mu --beta --sigma --v0 --samples".into()).into(),
        ),
    }
}

#[derive(Serialize)]
struct DisplayJson {
    xi: f64,
    v: f64,
    samples: u64,
    class: String,
    class_paper: String,
    region: char,
    criterion_holds_at_start: bool,
    energy_generated: f64,
    energy_dissipated: f64,
    energy_given_out: f64,
}

fn run_display(
    args: &Args,
    parameters: Dimensionless<f64>,
    start: State,
    samples: u64,
) -> Result<()> {
    let display = Display::new(parameters)
        .map_err(|error| Usage(format!("--mu, --beta, --sigma: {error}")))?;
    let run = display.run(start, samples, |sample, _| {
        sample % 4096 != 0 || !stop::requested()
    });
    let mut ledger = Ledger::default();
    let mut state = start;
    for sample in 0..run.samples {
        let (next, exchange) = display.audited_step(state, 0.0);
        state = next;
        ledger.enter(exchange);
        if sample % 4096 == 0 && stop::requested() {
            break;
        }
    }
    if stop::requested() {
        return Err(Stopped.into());
    }
    let json = DisplayJson {
        xi: run.end.position,
        v: run.end.velocity,
        samples: run.samples,
        class: run.classes.window.to_string(),
        class_paper: run.classes.paper.to_string(),
        region: parameters.region().letter(),
        criterion_holds_at_start: parameters.holds_at(start.velocity),
        energy_generated: ledger.generated,
        energy_dissipated: ledger.dissipated,
        energy_given_out: ledger.given_out,
    };
    if args.json {
        println!("{}", serde_json::to_string(&json)?);
        return Ok(());
    }
    let Dimensionless { mu, beta, sigma } = parameters;
    println!(
        "display      μ {mu}  β {beta}  σ {sigma}: region ({})",
        json.region
    );
    println!(
        "criterion    (10) {} at {} counts per sample",
        if json.criterion_holds_at_start {
            "holds"
        } else {
            "does not hold"
        },
        start.velocity
    );
    println!(
        "after        {} samples: ξ = {}, ξ̇ = {}",
        json.samples, json.xi, json.v
    );
    println!(
        "class        {} (by the paper's rule: {})",
        json.class, json.class_paper
    );
    println!(
        "energy       generated {:.6}, dissipated {:.6}, given out at most {:.6} (units of K Δ²)",
        json.energy_generated, json.energy_dissipated, json.energy_given_out
    );
    Ok(())
}

#[derive(Serialize)]
struct SceneJson {
    class: String,
    samples: u64,
    angle_rad: f64,
    velocity_rad_s: f64,
    peak_angle_rad: f64,
    peak_torque_nm: f64,
    min_margin_nm: f64,
    min_stiffness_nm_rad: f64,
    max_stiffness_nm_rad: f64,
    energy_start_j: f64,
    energy_excess_j: f64,
    energy_generated_j: f64,
    energy_dissipated_j: f64,
    energy_given_out_j: f64,
    reversals_last_eighth: u64,
}

fn run_scene(args: &Args, path: &Path) -> Result<()> {
    let scene = scene::load(path)?;
    let trace = prepare("--trace", args.trace.as_deref(), args.force)?;
    let plot = prepare("--plot", args.plot.as_deref(), args.force)?;
    let mut draft = match &trace {
        Some(output) => Some(output.draft()?),
        None => None,
    };
    if let Some(draft) = &mut draft {
        write_row(
            draft,
            format_args!(
                "time_s,angle_rad,velocity_rad_s,count,torque_nm,stiffness_nm_rad,margin_nm"
            ),
        )?;
    }
    let mut envelope = Envelope::new();
    let mut trouble = None;
    let report = scene.run(|sample| {
        let time_s = sample.number as f64 * scene.config.period_s;
        let State { position, velocity } = sample.state;
        let tick = &sample.tick;
        if plot.is_some() {
            envelope.enter(time_s, position);
        }
        if let Some(draft) = &mut draft {
            let row = write_row(
                draft,
                format_args!(
                    "{time_s},{position},{velocity},{},{},{},{}",
                    tick.count, tick.torque_nm, tick.stiffness_nm_rad, tick.margin_nm
                ),
            );
            trouble = row.err();
        }
        trouble.is_none() && !(sample.number % 4096 == 0 && stop::requested())
    });
    let report = report.with_context(|| path.display().to_string())?;
    if let Some(trouble) = trouble {
        return Err(trouble.context("--trace"));
    }
    if stop::requested() {
        return Err(Stopped.into());
    }
    if let Some(draft) = draft {
        draft.publish()?;
    }
    if let Some(output) = &plot {
        envelope.enter(
            report.samples as f64 * scene.config.period_s,
            report.end.position,
        );
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let chart = RunChart::new(&name, &scene, &report, &envelope)?;
        output.write(chart.svg()?.as_bytes())?;
    }
    if args.json {
        println!("{}", serde_json::to_string(&json(&report))?);
    } else {
        print_scene(&scene, &report)?;
        for output in [&trace, &plot].into_iter().flatten() {
            println!("wrote        {}", output.path().display());
        }
    }
    Ok(())
}

fn prepare(flag: &str, path: Option<&Path>, force: bool) -> Result<Option<Output>> {
    path.map(|path| Output::prepare(flag, path, force))
        .transpose()
}

fn write_row(draft: &mut Draft, row: std::fmt::Arguments<'_>) -> Result<()> {
    writeln!(draft, "{row}").context("cannot write the trace")
}

fn json(report: &Report) -> SceneJson {
    SceneJson {
        class: report.class.to_string(),
        samples: report.samples,
        angle_rad: report.end.position,
        velocity_rad_s: report.end.velocity,
        peak_angle_rad: report.peak_angle_rad,
        peak_torque_nm: report.peak_torque_nm,
        min_margin_nm: report.min_margin_nm,
        min_stiffness_nm_rad: report.min_stiffness_nm_rad,
        max_stiffness_nm_rad: report.max_stiffness_nm_rad,
        energy_start_j: report.energy_start_j,
        energy_excess_j: report.energy_excess_j,
        energy_generated_j: report.ledger.generated,
        energy_dissipated_j: report.ledger.dissipated,
        energy_given_out_j: report.ledger.given_out,
        reversals_last_eighth: report.reversals_last_eighth,
    }
}

fn print_scene(scene: &Scene, report: &Report) -> Result<()> {
    let config = &scene.config;
    let sampling = Sampling {
        period_s: config.period_s,
        count_rad: config.count_rad(),
    };
    let criterion = Criterion::new(scene.device, sampling)?;
    println!(
        "demand       K = {} Nm/rad; passive at every speed up to {:.4} Nm/rad, at the start's {} rad/s up to {:.4}",
        config.stiffness_nm_rad,
        criterion.largest_stiffness(),
        scene.start.velocity,
        criterion.largest_stiffness_at(scene.start.velocity)
    );
    println!(
        "applied      K = {:.4} to {:.4} Nm/rad; smallest margin {:.3e} Nm",
        report.min_stiffness_nm_rad, report.max_stiffness_nm_rad, report.min_margin_nm
    );
    println!(
        "after        {} samples ({:.4} s): {} rad, {} rad/s",
        report.samples,
        report.samples as f64 * config.period_s,
        report.end.position,
        report.end.velocity
    );
    println!(
        "class        {}{}",
        report.class,
        match report.class {
            Class::Undecided => ": let it run longer (run.samples)",
            _ => "",
        }
    );
    println!(
        "peaks        {:.6} rad, {:.6} Nm",
        report.peak_angle_rad, report.peak_torque_nm
    );
    println!(
        "energy       start {:.4e} J, excess {:.3e} J, given out at most {:.3e} J",
        report.energy_start_j, report.energy_excess_j, report.ledger.given_out
    );
    Ok(())
}

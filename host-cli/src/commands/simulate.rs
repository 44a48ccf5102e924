//! `knob simulate`: one run on the exact plant.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use control::criterion::{Criterion, Dimensionless, Sampling};
use plant_sim::closed_loop::{Report, Scene};
use plant_sim::display::Display;
use plant_sim::energy::reachable_speed;
use plant_sim::hold::State;
use plant_sim::outcome::{Class, DIVERGED_COUNTS};
use serde::Serialize;

use crate::charts::run::{Envelope, RunChart};
use crate::number::{self, digits};
use crate::output::{self, Output};
use crate::scene;
use crate::stop::{self, Usage};

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
    #[arg(long, value_name = "OUT.csv")]
    trace: Option<PathBuf>,
    /// Draw the scene: point and critical line in the plane, angle against time
    #[arg(long, value_name = "OUT.svg")]
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
            // clap drops a `requires` where the flag it asks for conflicts with another.
            for (flag, file) in [("--trace", &args.trace), ("--plot", &args.plot)] {
                if let Some(path) = file {
                    let path = path.display();
                    return Err(Usage(format!(
                        "{flag} {path}: the dimensionless display has none; accepted: with a scene file"
                    ))
                    .into());
                }
            }
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
    /// (10), with the speed that the start can turn into.
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
    let (run, ledger) = display.run_audited(start, samples, |sample| {
        sample % 4096 != 0 || !stop::requested()
    });
    stop::check()?;
    let speed = reachable_speed(start, 1.0, parameters.mu);
    let json = DisplayJson {
        xi: run.end.position,
        v: run.end.velocity,
        samples: run.samples,
        class: run.classes.window.to_string(),
        class_paper: run.classes.paper.to_string(),
        region: parameters.region().letter(),
        criterion_holds_at_start: parameters.holds_at(speed),
        energy_generated: ledger.generated,
        energy_dissipated: ledger.dissipated,
        energy_given_out: ledger.given_out,
    };
    if args.json {
        return output::say(&(serde_json::to_string(&json)? + "\n"));
    }
    let Dimensionless { mu, beta, sigma } = parameters;
    output::say(&format!(
        "display      μ {mu}  β {beta}  σ {sigma}: region ({})\n\
         criterion    (10) {} at {} counts per sample, {}\n\
         after        {} samples: ξ = {}, ξ̇ = {}\n\
         class        {} (by the paper's rule: {})\n\
         energy       generated {}, dissipated {}, given out at most {} (units of K Δ²)\n",
        json.region,
        if json.criterion_holds_at_start {
            "holds"
        } else {
            "does not hold"
        },
        digits(speed, 6),
        if start.position == 0.0 {
            "the initial speed"
        } else {
            "the speed that this start can turn into"
        },
        json.samples,
        json.xi,
        json.v,
        json.class,
        json.class_paper,
        digits(json.energy_generated, 7),
        digits(json.energy_dissipated, 7),
        digits(json.energy_given_out, 7),
    ))
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
    /// (10) for the demanded stiffness, with the speed that the start can turn into.
    criterion_holds_at_start: bool,
}

fn run_scene(args: &Args, path: &Path) -> Result<()> {
    let scene = scene::load(path)?;
    let mut trace = prepare("--trace", args.trace.as_deref(), args.force)?;
    let mut plot = prepare("--plot", args.plot.as_deref(), args.force)?;
    for (flag, output, others) in [
        ("--trace", &trace, [Some(path), args.plot.as_deref()]),
        ("--plot", &plot, [Some(path), args.trace.as_deref()]),
    ] {
        let Some(output) = output else { continue };
        if let Some(other) = others.into_iter().flatten().find(|p| output.replaces(p)) {
            return Err(Usage(format!(
                "{flag} {}: the same file as {}; accepted: a file of its own",
                output.path().display(),
                other.display()
            ))
            .into());
        }
    }
    if let Some(trace) = &mut trace {
        writeln!(
            trace,
            "time_s,angle_rad,velocity_rad_s,count,torque_nm,stiffness_nm_rad,margin_nm"
        )?;
    }
    let mut envelope = Envelope::new();
    let mut trouble = None;
    let report = scene.run(|sample| {
        let time_s = sample.number as f64 * scene.config.timing.period_s;
        let State { position, velocity } = sample.state;
        let tick = &sample.tick;
        if plot.is_some() {
            envelope.enter(time_s, position);
        }
        if let Some(trace) = &mut trace {
            let row = writeln!(
                trace,
                "{time_s},{position},{velocity},{},{},{},{}",
                tick.count, tick.torque_nm, tick.stiffness_nm_rad, tick.margin_nm
            );
            trouble = row.err();
        }
        trouble.is_none() && !(sample.number % 4096 == 0 && stop::requested())
    });
    let report = report.with_context(|| path.display().to_string())?;
    if let Some(trouble) = trouble {
        return Err(trouble);
    }
    stop::check()?;
    if let Some(plot) = &mut plot {
        envelope.enter(
            report.samples as f64 * scene.config.timing.period_s,
            report.end.position,
        );
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let chart = RunChart::new(&name, &scene, &report, &envelope)?;
        write!(plot, "{}", chart.svg()?)?;
    }
    output::publish([trace, plot].into_iter().flatten().collect())?;
    if args.json {
        return output::say(&(serde_json::to_string(&json(&scene, &report)?)? + "\n"));
    }
    let mut text = describe(&scene, &report)?;
    for path in [&args.trace, &args.plot].into_iter().flatten() {
        writeln!(text, "wrote        {}", path.display())?;
    }
    output::say(&text)
}

fn prepare(flag: &str, path: Option<&Path>, force: bool) -> Result<Option<Output>> {
    path.map(|path| Output::prepare(flag, path, force))
        .transpose()
}

fn criterion(scene: &Scene) -> Result<Criterion<f64>> {
    let sampling = Sampling {
        period_s: scene.config.timing.period_s,
        count_rad: scene.config.count_rad(),
    };
    Ok(Criterion::new(scene.device, sampling)?)
}

fn json(scene: &Scene, report: &Report) -> Result<SceneJson> {
    let demand = scene.config.stiffness_nm_rad;
    let speed = scene.reachable_speed_rad_s(demand);
    Ok(SceneJson {
        criterion_holds_at_start: criterion(scene)?.power_margin_nm(demand, speed) >= 0.0,
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
    })
}

fn describe(scene: &Scene, report: &Report) -> Result<String> {
    let config = &scene.config;
    let criterion = criterion(scene)?;
    let speed = scene.reachable_speed_rad_s(config.stiffness_nm_rad);
    Ok(format!(
        "demand       K = {} Nm/rad; passive at every speed up to {} Nm/rad, at the {} rad/s that the start can reach up to {}\n\
         applied      K = {} to {} Nm/rad; smallest margin {:.3e} Nm\n\
         after        {} samples ({} s): {} rad, {} rad/s\n\
         class        {}{}\n\
         peaks        {:.6} rad, {:.6} Nm\n\
         energy       start {:.4e} J, excess {:.3e} J, given out at most {:.3e} J\n",
        config.stiffness_nm_rad,
        digits(criterion.largest_stiffness(), 4),
        digits(speed, 4),
        digits(criterion.largest_stiffness_at(speed), 4),
        digits(report.min_stiffness_nm_rad, 4),
        digits(report.max_stiffness_nm_rad, 4),
        report.min_margin_nm,
        report.samples,
        digits(report.samples as f64 * config.timing.period_s, 6),
        report.end.position,
        report.end.velocity,
        report.class,
        match report.class {
            Class::Undecided => ": let it run longer (run.samples)",
            _ => "",
        },
        report.peak_angle_rad,
        report.peak_torque_nm,
        report.energy_start_j,
        report.energy_excess_j,
        report.ledger.given_out
    ))
}

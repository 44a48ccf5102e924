//! `knob simulate`: one run on the exact plant.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use control::config::Law;
use control::criterion::Dimensionless;
use control::tick::Tick;
use plant_sim::closed_loop::{Report, Sample};
use plant_sim::display::Display;
use plant_sim::energy::reachable_speed;
use plant_sim::fidelity::{self, Answer, Phenomena, Phenomenon};
use plant_sim::hold::State;
use plant_sim::methods;
use plant_sim::outcome::{Class, DIVERGED_COUNTS};
use serde::Serialize;

use crate::charts::run::{Curves, RunChart};
use crate::number::{self, digits};
use crate::output::{self, Output};
use crate::reasons;
use crate::scene::{self, Loaded, Windings};
use crate::stop::{self, Usage};

/// Run one scene, or one dimensionless display, on the exact plant.
///
/// Either a scene file, or all of --mu --beta --sigma --v0 --samples for the display (6).
#[derive(clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  knob simulate scenes/fig6c.toml --plot run.svg\n  knob simulate scenes/ledger-push.toml --trace run.csv\n  knob simulate scenes/fast-amplifier.toml --fidelity auto --tolerance 1e-6\n  knob simulate --mu 50 --beta 0.3 --sigma 0.7 --v0 10 --samples 50000 --json\n  knob simulate scenes/fail/euler-hides.toml --method euler:1"
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

    /// What of the scene's plant to keep: all of it, or no more than the answer needs
    #[arg(long, value_enum, default_value_t = Fidelity::Full)]
    fidelity: Fidelity,
    /// With --fidelity auto: how far the angle may be from the full scene's at any sample, rad [default: 1e-6]
    #[arg(long, value_name = "RAD", value_parser = number::positive, requires = "scene")]
    tolerance: Option<f64>,
    /// Move the display by another method than the exact map, to see where it fails; of a scene, only a raw
    /// spring on a bare knob: euler:N, midpoint:N, rk4:N, rk4-tanh:N (N steps per sample), dopri5:TOL, closed-form, exact
    #[arg(long, value_parser = method_name, conflicts_with_all = ["trace", "plot", "fidelity", "tolerance"])]
    method: Option<String>,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Write every sample of the scene as CSV
    #[arg(long, value_name = "OUT.csv")]
    trace: Option<PathBuf>,
    /// Draw the scene: angle against time, beside it point and critical line in the plane, or torque and account
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq)]
enum Fidelity {
    /// Everything that the scene has
    Full,
    /// Without delay, lag, torque steps, cogging, stiction or hand where they provably cannot change
    /// the angle by more than the tolerance
    Auto,
}

/// The tolerance where none is given, rad: a thousandth of a count of 8192 per turn.
const TOLERANCE_RAD: f64 = 1e-6;

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

fn method_name(text: &str) -> Result<String, String> {
    match methods::named(text) {
        Ok(_) => Ok(text.to_owned()),
        Err(error) => Err(error.to_string()),
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
        (Some(path), ..) => match &args.method {
            Some(method) => {
                let loaded = scene::load(path)?;
                let (display, start) = loaded.display().map_err(|error| {
                    Usage(format!("--method {method}: {}: {error}", path.display()))
                })?;
                run_by_method(args, method, &display, start, loaded.scene.samples)
            }
            None => run_scene(args, path),
        },
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
            if args.fidelity == Fidelity::Auto {
                return Err(Usage(
                    "--fidelity auto: the dimensionless display has nothing to leave out; accepted: with a SCENE file"
                        .into(),
                )
                .into());
            }
            let start = State {
                position: args.xi0.unwrap_or(0.0),
                velocity: v0,
            };
            let parameters = Dimensionless { mu, beta, sigma };
            let display = Display::new(parameters)
                .map_err(|error| Usage(format!("--mu, --beta, --sigma: {error}")))?;
            match &args.method {
                Some(method) => run_by_method(args, method, &display, start, samples),
                None => run_display(args, &display, start, samples),
            }
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

#[derive(Serialize)]
struct MethodJson<'a> {
    method: &'a str,
    /// Null where the method gives no number.
    xi: f64,
    v: f64,
    samples: u64,
    class: String,
    class_paper: String,
}

/// A display moved by another method than the exact map.
fn run_by_method(
    args: &Args,
    method: &str,
    display: &Display,
    start: State,
    samples: u64,
) -> Result<()> {
    let run = methods::named(method)?
        .run_observed(display, start, samples, &mut |_, _| !stop::requested());
    stop::check()?;
    let json = MethodJson {
        method,
        xi: run.end.position,
        v: run.end.velocity,
        samples: run.samples,
        class: run.classes.window.to_string(),
        class_paper: run.classes.paper.to_string(),
    };
    if args.json {
        return output::say(&(serde_json::to_string(&json)? + "\n"));
    }
    let Dimensionless { mu, beta, sigma } = display.parameters();
    output::say(&format!(
        "display      μ {mu}  β {beta}  σ {sigma}, by {method}\n\
         after        {} samples: ξ = {}, ξ̇ = {}\n\
         class        {} (by the paper's rule: {})\n",
        json.samples, json.xi, json.v, json.class, json.class_paper,
    ))
}

fn run_display(args: &Args, display: &Display, start: State, samples: u64) -> Result<()> {
    let parameters = display.parameters();
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
    /// (10) for the demanded stiffness, with the speed that the start can turn into, delay, lag and
    /// all.
    criterion_holds_at_start: bool,
    /// The law in force at the end; of auto one of static, episode, ledger.
    law_end: &'static str,
    /// Why less than the demand was applied at the end, in words.
    reason_end: &'static str,
    /// The last torque commanded.
    torque_end_nm: f32,
    /// The stiffness applied at the end.
    stiffness_end_nm_rad: f32,
    /// What the ledger's account held; 0 under other laws.
    min_account_j: f64,
    max_account_j: f64,
    /// full or auto.
    fidelity: &'static str,
    /// What of the scene's plant was left out, and what was kept.
    dropped: Vec<&'static str>,
    kept: Vec<&'static str>,
    /// Every angle is within this of the full scene's; 0 where nothing was left out.
    error_bound_rad: f64,
    /// Of a scene with `[electrical]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    electrical: Option<ElectricalJson>,
}

#[derive(Serialize)]
struct ElectricalJson {
    /// What the drive says of its torque, and what the controller was told of its delay and lag.
    delay_s: f64,
    tau_s: f64,
    torque_step_nm: f64,
    torque_max_nm: f64,
    told_delay_s: f64,
    told_tau_s: f64,
    min_bus_v: f64,
    max_bus_v: f64,
    /// The largest of a phase, in magnitude.
    peak_current_a: f64,
    /// From the bus.
    drawn_j: f64,
}

impl From<&Windings> for ElectricalJson {
    fn from(windings: &Windings) -> Self {
        let Windings {
            delivery,
            told,
            passed,
        } = windings;
        Self {
            delay_s: delivery.delay_s,
            tau_s: delivery.tau_s,
            torque_step_nm: delivery.torque_step_nm,
            torque_max_nm: delivery.torque_max_nm,
            told_delay_s: told.delay_s,
            told_tau_s: told.amplifier_tau_s,
            min_bus_v: passed.bus_v[0],
            max_bus_v: passed.bus_v[1],
            peak_current_a: passed.current_a,
            drawn_j: passed.drawn_j,
        }
    }
}

fn run_scene(args: &Args, path: &Path) -> Result<()> {
    if args.tolerance.is_some() && args.fidelity == Fidelity::Full {
        return Err(Usage(
            "--tolerance is given, but --fidelity full drops nothing; accepted: with --fidelity auto"
                .into(),
        )
        .into());
    }
    let loaded = scene::load(path)?;
    if loaded.is_electrical() && args.fidelity == Fidelity::Auto {
        return Err(Usage(format!(
            "--fidelity auto: {} has [electrical], of which nothing can be left out; accepted: --fidelity full",
            path.display()
        ))
        .into());
    }
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
            "time_s,angle_rad,velocity_rad_s,count,torque_nm,stiffness_nm_rad,margin_nm,account_j,law,reason"
        )?;
    }
    let mut curves = Curves::new();
    let mut trouble = None;
    let mut last = None;
    let simpler = simpler(args, &loaded).with_context(|| path.display().to_string())?;
    let mut observe = |sample: &Sample| {
        let time_s = loaded.time_s(sample);
        let State { position, velocity } = sample.state;
        let tick = &sample.tick;
        last = Some((time_s, *tick));
        if plot.is_some() {
            curves.enter(time_s, sample);
        }
        if let Some(trace) = &mut trace {
            let row = writeln!(
                trace,
                "{time_s},{position},{velocity},{},{},{},{},{},{},{}",
                tick.count,
                tick.torque_nm,
                tick.stiffness_nm_rad,
                tick.margin_nm,
                tick.account_j,
                reasons::law(tick.law),
                reasons::code(tick.reason)
            );
            trouble = row.err();
        }
        trouble.is_none() && !(sample.number.is_multiple_of(4096) && stop::requested())
    };
    let (report, windings) = match &simpler {
        Some(answer) => (answer.simplified.run_under(loaded.control(), observe), None),
        None => loaded
            .run_telling(&mut observe)
            .with_context(|| path.display().to_string())?,
    };
    if let Some(trouble) = trouble {
        return Err(trouble);
    }
    stop::check()?;
    let (last_s, last) = last.context("a run of no samples")?;
    let end_s = last_s + loaded.scene.clock.period_s;
    if let Some(plot) = &mut plot {
        curves.end(end_s, report.end.position);
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let chart = RunChart::new(&name, &loaded, &report, &curves)?;
        write!(plot, "{}", chart.svg()?)?;
    }
    output::publish([trace, plot].into_iter().flatten().collect())?;
    if args.json {
        let json = json(&loaded, &report, &last, simpler.as_ref(), windings.as_ref())?;
        return output::say(&(serde_json::to_string(&json)? + "\n"));
    }
    let mut text = describe(&loaded, &report, &last, end_s)?;
    if let Some(windings) = &windings {
        text += &of_the_windings(windings);
    }
    if let Some(answer) = &simpler {
        text += &left_out(answer);
    }
    for path in [&args.trace, &args.plot].into_iter().flatten() {
        writeln!(text, "wrote        {}", path.display())?;
    }
    output::say(&text)
}

fn prepare(flag: &str, path: Option<&Path>, force: bool) -> Result<Option<Output>> {
    path.map(|path| Output::prepare(flag, path, force))
        .transpose()
}

/// The scene without what it can do without, if that was asked for. Where the user stops it, the run that
/// follows ends at once.
fn simpler(args: &Args, loaded: &Loaded) -> Result<Option<Answer>> {
    if args.fidelity == Fidelity::Full {
        return Ok(None);
    }
    let tolerance_rad = args.tolerance.unwrap_or(TOLERANCE_RAD);
    let go_on = |number: u64| !(number.is_multiple_of(4096) && stop::requested());
    let control = || loaded.control();
    Ok(Some(fidelity::simplest(
        &loaded.scene,
        tolerance_rad,
        control,
        go_on,
    )?))
}

/// How the torque came, and what the windings went through.
fn of_the_windings(windings: &Windings) -> String {
    let it = ElectricalJson::from(windings);
    format!(
        "torque       {} s late, then {} s of lag, in steps of {} Nm, up to {} Nm; the controller was told {} s and {} s\n\
         bus          {} to {} V; up to {} A in a phase, {:.3e} J taken\n",
        digits(it.delay_s, 4),
        digits(it.tau_s, 4),
        digits(it.torque_step_nm, 3),
        digits(it.torque_max_nm, 3),
        digits(it.told_delay_s, 4),
        digits(it.told_tau_s, 4),
        digits(it.min_bus_v, 4),
        digits(it.max_bus_v, 4),
        digits(it.peak_current_a, 4),
        it.drawn_j
    )
}

/// What was left out, what was kept and what that may have changed.
fn left_out(answer: &Answer) -> String {
    let names = |phenomena: Phenomena| {
        let names: Vec<_> = phenomena.iter().map(Phenomenon::as_str).collect();
        match names.is_empty() {
            true => "nothing".to_owned(),
            false => names.join(", "),
        }
    };
    format!(
        "left out     {}; kept {}; every angle within {:.3e} rad of the full scene's\n",
        names(answer.simplified.dropped()),
        names(answer.kept),
        answer.bound_rad
    )
}

fn json(
    loaded: &Loaded,
    report: &Report,
    last: &Tick,
    simpler: Option<&Answer>,
    windings: Option<&Windings>,
) -> Result<SceneJson> {
    let scene = &loaded.scene;
    let names = |phenomena: Phenomena| phenomena.iter().map(Phenomenon::as_str).collect();
    let dropped = simpler.map_or(Phenomena::default(), |answer| answer.simplified.dropped());
    let demand = scene.config.stiffness_nm_rad;
    let speed = scene.reachable_speed_rad_s(demand);
    Ok(SceneJson {
        fidelity: if simpler.is_some() { "auto" } else { "full" },
        dropped: names(dropped),
        kept: names(Phenomena::of(scene).without(dropped)),
        error_bound_rad: simpler.map_or(0.0, |answer| answer.bound_rad),
        criterion_holds_at_start: loaded.criterion()?.power_margin_nm(demand, speed) >= 0.0,
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
        law_end: reasons::law(last.law),
        reason_end: reasons::words(last.reason),
        torque_end_nm: last.torque_nm,
        stiffness_end_nm_rad: last.stiffness_nm_rad,
        min_account_j: report.account_j[0],
        max_account_j: report.account_j[1],
        electrical: windings.map(ElectricalJson::from),
    })
}

fn describe(loaded: &Loaded, report: &Report, last: &Tick, end_s: f64) -> Result<String> {
    let scene = &loaded.scene;
    let config = &scene.config;
    let criterion = loaded.criterion()?;
    let account = match config.law {
        Law::Ledger | Law::Auto => format!(
            "\naccount      {:.3e} J at the end; {:.3e} to {:.3e} J",
            last.account_j, report.account_j[0], report.account_j[1]
        ),
        Law::Raw | Law::Static | Law::Episode => String::new(),
    };
    let speed = scene.reachable_speed_rad_s(config.stiffness_nm_rad);
    Ok(format!(
        "demand       K = {} Nm/rad; passive at every speed up to {} Nm/rad, at the {} rad/s that the start can reach up to {}\n\
         applied      K = {} to {} Nm/rad, {} at the end, with {} Nm; smallest margin {:.3e} Nm\n\
         law          {} in force at the end: {}{account}\n\
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
        digits(f64::from(last.stiffness_nm_rad), 4),
        digits(f64::from(last.torque_nm), 4),
        report.min_margin_nm,
        reasons::law(last.law),
        reasons::words(last.reason),
        report.samples,
        digits(end_s, 6),
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

//! `knob plan`: how stiff can this device be, and what would a wanted stiffness need.
//!
//! The paper's conclusion as a tool: "the criterion can be used as a guideline in the
//! dimensioning of the components of a haptic device, establishing the motor
//! parameters, encoder resolution, and servo rate necessary to achieve the desired
//! stiffness" (Sec. VI).

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::path::PathBuf;

use anyhow::{Context, Result};
use control::config::Timing;
use control::criterion::{Criterion, Dimensionless, Region, Sampling};
use plant_sim::preset::{PRESETS, Preset, preset};
use serde::Serialize;

use crate::charts::plan::PlanChart;
use crate::number::{self, digits, short};
use crate::output::{self, Output};
use crate::scene;
use crate::stop::Usage;

/// How stiff can this device be, and what would a wanted stiffness need?
///
/// The device comes from --motor or from a file with the tables device and loop of a
/// scene; without either it is the paper's RE35.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob plan --motor re35 --stiffness 1\n  knob plan my-knob.toml --plot plan.svg"
)]
pub struct Args {
    /// A device file (TOML): the tables device and loop, as in a scene
    #[arg(value_name = "DEVICE.toml", conflicts_with = "motor")]
    device: Option<PathBuf>,
    /// A known device
    #[arg(long, value_name = "NAME", value_parser = motor)]
    motor: Option<&'static Preset>,
    /// A wanted stiffness, Nm/rad
    #[arg(long, value_name = "K", value_parser = number::positive)]
    stiffness: Option<f64>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Draw stiffness against speed, and the device in the (β, σ) plane
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

fn motor(name: &str) -> Result<&'static Preset, String> {
    let known: Vec<&str> = PRESETS.iter().map(|preset| preset.name).collect();
    preset(name).ok_or_else(|| {
        format!(
            "no motor is called `{name}`; accepted: {}",
            known.join(", ")
        )
    })
}

/// Speeds that a hand makes, from a slow turn to a flick, rad/s.
const SPEEDS_RAD_S: [f64; 6] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0];

#[derive(Serialize)]
pub struct Plan {
    name: String,
    source: String,
    inertia_kg_m2: f64,
    viscous_nm_s_rad: f64,
    coulomb_nm: f64,
    counts_per_rev: f64,
    count_rad: f64,
    sample_period_s: f64,
    /// Te = T_max + 2·delay + 2τ: what stands for T where the loop is not ideal.
    effective_period_s: f64,
    /// 2b/Te.
    viscous_limit_nm_rad: f64,
    /// 2c/Δ.
    coulomb_limit_nm_rad: f64,
    /// The smaller of the two: passive at every speed.
    largest_stiffness_nm_rad: f64,
    /// What the energy ledger applies at most: max(min(m/Te², 3c/Δ), the same).
    ledger_cap_nm_rad: f64,
    at_speed: Vec<AtSpeed>,
    wanted: Option<Wanted>,
    #[serde(skip)]
    criterion: Criterion<f64>,
    #[serde(skip)]
    timing: Timing,
}

/// How stiff at one speed.
#[derive(Serialize)]
struct AtSpeed {
    speed_rad_s: f64,
    /// By (11); also at most 2c/Δ, or it never comes to rest. Null where no stiffness is.
    largest_stiffness_nm_rad: Option<f64>,
    /// Where oscillation is expected to grow; an estimate, not a guarantee. Null where its
    /// assumptions do not hold.
    describing_function_nm_rad: Option<f64>,
}

/// A wanted stiffness against this device.
#[derive(Serialize)]
struct Wanted {
    stiffness_nm_rad: f64,
    mu: f64,
    beta: f64,
    sigma: f64,
    region: char,
    passive_at_every_speed: bool,
    /// Up to which speed (11) holds; null: at every speed, or at none (region b, c).
    passive_up_to_rad_s: Option<f64>,
    /// What passivity at every speed asks for, all of it together.
    every_speed: Everything,
    /// What each speed asks for if one thing alone is changed.
    one_change: Vec<OneChange>,
}

/// Null where that one cannot do it.
#[derive(Serialize)]
struct Everything {
    sample_period_s_at_most: Option<f64>,
    counts_per_rev_at_least: Option<f64>,
    viscous_nm_s_rad_at_least: f64,
    coulomb_nm_at_least: f64,
}

/// What would do, changed alone, at one speed; null where it alone cannot.
#[derive(Serialize)]
struct OneChange {
    speed_rad_s: f64,
    passive_as_it_is: bool,
    sample_period_s_at_most: Option<f64>,
    counts_per_rev_at_least: Option<f64>,
    viscous_nm_s_rad_at_least: Option<f64>,
    coulomb_nm_at_least: f64,
}

pub fn run(args: &Args) -> Result<()> {
    let mut plot = match &args.plot {
        Some(path) => Some(Output::prepare("--plot", path, args.force)?),
        None => None,
    };
    if let (Some(plot), Some(device)) = (&plot, &args.device)
        && plot.replaces(device)
    {
        return Err(Usage("--plot: this is the device file; give another name".into()).into());
    }
    let plan = match &args.device {
        Some(path) => {
            let file = scene::load_device(path)?;
            let name = path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let sampling = Sampling {
                period_s: file.timing.effective_s(),
                count_rad: file.count_rad(),
            };
            let source = path.display().to_string();
            let criterion =
                Criterion::new(file.device, sampling).with_context(|| source.clone())?;
            Plan::new(name, source, criterion, file.timing, args.stiffness)
        }
        None => {
            let known = args.motor.unwrap_or(&PRESETS[0]);
            let sampling = Sampling {
                period_s: known.period_s,
                count_rad: known.count_rad(),
            };
            let criterion = Criterion::new(known.device, sampling)?;
            Plan::new(
                known.name.into(),
                known.source.into(),
                criterion,
                Timing::ideal(known.period_s),
                args.stiffness,
            )
        }
    };
    if let Some(output) = &mut plot {
        let chart = PlanChart::new(&plan.name, plan.criterion, args.stiffness);
        write!(output, "{}", chart.svg()?)?;
    }
    output::publish(plot.into_iter().collect())?;
    if args.json {
        return output::say(&(serde_json::to_string(&plan)? + "\n"));
    }
    let mut text = plan.to_string();
    if let Some(path) = &args.plot {
        text += &format!("\nwrote {}\n", path.display());
    }
    output::say(&text)
}

/// The stiffness at which the describing function expects growth at a speed:
/// β + 4σ/(π v₀) = ½ solved for K, (2/T)(b + 4c/(π v)), Nm/rad.
///
/// None where that is no estimate: the oscillation must be larger than a count, K ≤ 2c/Δ,
/// and slower than the sampling, μ ≥ 1/π².
pub fn describing_function_stiffness(criterion: &Criterion<f64>, speed_rad_s: f64) -> Option<f64> {
    let device = criterion.device();
    let period = criterion.sampling().period_s;
    let stiffness =
        2.0 / period * (device.viscous_nm_s_rad + 4.0 * device.coulomb_nm / (PI * speed_rad_s));
    let slow_enough = criterion.dimensionless(stiffness).mu >= 1.0 / (PI * PI);
    (stiffness > 0.0 && stiffness <= criterion.coulomb_limit() && slow_enough).then_some(stiffness)
}

impl Plan {
    fn new(
        name: String,
        source: String,
        criterion: Criterion<f64>,
        timing: Timing,
        wanted: Option<f64>,
    ) -> Self {
        let device = criterion.device();
        let sampling = criterion.sampling();
        let at_speed = SPEEDS_RAD_S.map(|speed_rad_s| AtSpeed {
            speed_rad_s,
            largest_stiffness_nm_rad: above_zero(
                criterion
                    .largest_stiffness_at(speed_rad_s)
                    .min(criterion.coulomb_limit()),
            ),
            describing_function_nm_rad: describing_function_stiffness(&criterion, speed_rad_s),
        });
        Self {
            name,
            source,
            inertia_kg_m2: device.inertia_kg_m2,
            viscous_nm_s_rad: device.viscous_nm_s_rad,
            coulomb_nm: device.coulomb_nm,
            counts_per_rev: TAU / sampling.count_rad,
            count_rad: sampling.count_rad,
            sample_period_s: timing.period_s,
            effective_period_s: sampling.period_s,
            viscous_limit_nm_rad: criterion.viscous_limit(),
            coulomb_limit_nm_rad: criterion.coulomb_limit(),
            largest_stiffness_nm_rad: criterion.largest_stiffness(),
            ledger_cap_nm_rad: (device.inertia_kg_m2 / sampling.period_s.powi(2))
                .min(3.0 * device.coulomb_nm / sampling.count_rad)
                .max(criterion.largest_stiffness()),
            at_speed: at_speed.into(),
            wanted: wanted.map(|stiffness| Wanted::new(&criterion, &timing, stiffness)),
            criterion,
            timing,
        }
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.name, self.source)?;
        writeln!(
            f,
            "  inertia {} kg m², viscous friction {} Nm s/rad, Coulomb friction {} Nm",
            short(self.inertia_kg_m2),
            short(self.viscous_nm_s_rad),
            short(self.coulomb_nm)
        )?;
        writeln!(
            f,
            "  {} counts/rev (Δ = {} rad), sample period {} s",
            digits(self.counts_per_rev, 6),
            short(self.count_rad),
            digits(self.sample_period_s, 6)
        )?;
        let period = if self.timing == Timing::ideal(self.sample_period_s) {
            "T"
        } else {
            let te = digits(self.effective_period_s, 4);
            writeln!(
                f,
                "  with jitter, missed ticks, delay and lag as good as Te = {te} s"
            )?;
            "Te"
        };
        writeln!(f, "\nHow stiff can it be, Nm/rad?")?;
        let limit = |k: f64| answer((k > 0.0).then_some(k));
        for (what, k) in [
            (
                format!("sampling and viscous friction, 2b/{period}:"),
                self.viscous_limit_nm_rad,
            ),
            (
                "encoder and Coulomb friction, 2c/Δ:".into(),
                self.coulomb_limit_nm_rad,
            ),
            (
                "passive at every speed (the smaller):".into(),
                self.largest_stiffness_nm_rad,
            ),
            (
                format!("ledger, at most min(m/{period}², 3c/Δ):"),
                self.ledger_cap_nm_rad,
            ),
        ] {
            writeln!(f, "  {what:<38} {:>10}", limit(k))?;
        }
        writeln!(
            f,
            "  at a speed:      passive, by (11)   grows from about (an estimate)"
        )?;
        for at in &self.at_speed {
            writeln!(
                f,
                "  {:>6} rad/s        {:>10}          {:>10}",
                at.speed_rad_s,
                answer(at.largest_stiffness_nm_rad),
                answer(at.describing_function_nm_rad)
            )?;
        }
        match &self.wanted {
            Some(wanted) => wanted.write(f, self),
            None => Ok(()),
        }
    }
}

/// A number, or a dash where there is no answer.
fn answer(number: Option<f64>) -> String {
    number.map_or("–".into(), |number| digits(number, 4))
}

/// The number, if it is an answer: neither zero, nor beyond all bounds.
fn above_zero(number: f64) -> Option<f64> {
    (number > 0.0 && number.is_finite()).then_some(number)
}

impl Wanted {
    fn new(criterion: &Criterion<f64>, timing: &Timing, stiffness: f64) -> Self {
        let device = criterion.device();
        let (b, c) = (device.viscous_nm_s_rad, device.coulomb_nm);
        let sampling = criterion.sampling();
        let (period, count) = (sampling.period_s, sampling.count_rad);
        // The sample period whose Te is this one, the rest of the loop being as it is.
        let ticks = if timing.may_miss { 2.0 } else { 1.0 };
        let period_of =
            |effective_s: f64| timing.period_s + (effective_s - timing.effective_s()) / ticks;
        let point: Dimensionless<f64> = criterion.dimensionless(stiffness);
        let passive = stiffness <= criterion.largest_stiffness();
        let threshold = criterion.power_margin_nm(stiffness, 0.0) / (0.5 * stiffness * period - b);
        // Beyond 2c/Δ it never comes to rest, whatever the period and the viscous friction.
        let can_rest = stiffness <= criterion.coulomb_limit();
        let one_change = SPEEDS_RAD_S.map(|v| {
            let period_left = 2.0 * (b * v + c - 0.5 * stiffness * count) / (stiffness * v);
            let count_left = 2.0 * (b * v + c - 0.5 * stiffness * period * v) / stiffness;
            OneChange {
                speed_rad_s: v,
                passive_as_it_is: criterion.power_margin_nm(stiffness, v) >= 0.0 && can_rest,
                sample_period_s_at_most: above_zero(period_of(period_left)).filter(|_| can_rest),
                counts_per_rev_at_least: above_zero(
                    TAU / count_left.min(2.0 * c / stiffness).max(0.0),
                ),
                viscous_nm_s_rad_at_least: above_zero(
                    0.5 * stiffness * period - (c - 0.5 * stiffness * count) / v,
                )
                .filter(|_| can_rest),
                coulomb_nm_at_least: (0.5 * stiffness * count + (0.5 * stiffness * period - b) * v)
                    .max(0.5 * stiffness * count),
            }
        });
        Self {
            stiffness_nm_rad: stiffness,
            mu: point.mu,
            beta: point.beta,
            sigma: point.sigma,
            region: point.region().letter(),
            passive_at_every_speed: passive,
            passive_up_to_rad_s: above_zero(threshold)
                .filter(|_| point.region() == Region::LocallyPassive),
            every_speed: Everything {
                sample_period_s_at_most: above_zero(period_of(2.0 * b / stiffness)),
                counts_per_rev_at_least: above_zero(PI * stiffness / c),
                viscous_nm_s_rad_at_least: 0.5 * stiffness * period,
                coulomb_nm_at_least: 0.5 * stiffness * count,
            },
            one_change: one_change.into(),
        }
    }

    fn write(&self, f: &mut fmt::Formatter<'_>, plan: &Plan) -> fmt::Result {
        writeln!(f, "\nWhat would {} Nm/rad need?", self.stiffness_nm_rad)?;
        writeln!(
            f,
            "  β = {}, σ = {}, μ = {}: region ({})",
            digits(self.beta, 4),
            digits(self.sigma, 4),
            digits(self.mu, 4),
            self.region
        )?;
        if self.mu < 1.0 / (PI * PI) {
            writeln!(
                f,
                "  μ is below 1/π²: the spring's own frequency is beyond the Nyquist limit of this sample period"
            )?;
        }
        if self.passive_at_every_speed {
            return writeln!(
                f,
                "  nothing: this device renders it passively at every speed"
            );
        }
        match self.passive_up_to_rad_s {
            Some(speed) => writeln!(
                f,
                "  as it is, passive up to {} rad/s only",
                digits(speed, 4)
            )?,
            None => writeln!(
                f,
                "  as it is, passive at no start that has to come to rest"
            )?,
        }
        let every = &self.every_speed;
        let period = every.sample_period_s_at_most;
        let counts = every.counts_per_rev_at_least.map(f64::ceil);
        writeln!(
            f,
            "  for every speed:  {}b ≥ {} Nm s/rad;  and  {}c ≥ {} Nm",
            period.map_or(String::new(), |t| format!("T ≤ {} s or ", digits(t, 4))),
            digits(every.viscous_nm_s_rad_at_least, 4),
            counts.map_or(String::new(), |n| format!("{n} counts/rev or more, or ")),
            digits(every.coulomb_nm_at_least, 4)
        )?;
        writeln!(
            f,
            "  up to a speed, changing one thing alone (– where that alone cannot do it):"
        )?;
        writeln!(
            f,
            "    speed        sample period    counts/rev      viscous friction  Coulomb friction"
        )?;
        for row in &self.one_change {
            if row.passive_as_it_is {
                writeln!(f, "    {:>5} rad/s  passive as it is", row.speed_rad_s)?;
                continue;
            }
            let need = |sign: &str, number: Option<f64>, unit: &str| {
                number.map_or("–".into(), |n| format!("{sign} {}{unit}", digits(n, 4)))
            };
            writeln!(
                f,
                "    {:>5} rad/s  {:<15}  {:<14}  {:<16}  {}",
                row.speed_rad_s,
                need("≤", row.sample_period_s_at_most, " s"),
                need("≥", row.counts_per_rev_at_least.map(f64::ceil), ""),
                need("≥", row.viscous_nm_s_rad_at_least, ""),
                need("≥", Some(row.coulomb_nm_at_least), " Nm")
            )?;
        }
        writeln!(
            f,
            "  ({} has T = {} s, {} counts/rev, b = {} Nm s/rad, c = {} Nm)",
            plan.name,
            digits(plan.sample_period_s, 6),
            digits(plan.counts_per_rev, 6),
            short(plan.viscous_nm_s_rad),
            short(plan.coulomb_nm)
        )
    }
}

//! Where digits are lost, and where one bit decides.

use anyhow::Result;
use control::criterion::Dimensionless;
use plant_sim::display::Display;
use plant_sim::hold::State;
use plant_sim::map::describing_function;
use plant_sim::methods::{self, Exact, Method};
use plant_sim::outcome::Class;
use plant_sim::precise::{PreciseDisplay, PreciseState, double, number};

use super::forms::{
    SinglePrecision, error_after_a_sample, first_wrong_count, holds_by_division, in_eighths,
};
use super::trace::{dots, dotted, level, line, outcome, over_samples, run_rows, states};
use super::{Evidence, says, truth};
use crate::charts::failure::{Axis, Figure, Series, Whose};
use crate::number::{digits, short};
use crate::scene;

/// The textbook's closed form as β/μ → 0.
pub(crate) fn lost_digits(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let samples = loaded.scene.samples;
    let mut rows = run_rows(&["closed-form", "exact"], &display, start, samples)?;
    let run = Exact.run(&display, start, samples);
    let precise = PreciseDisplay::new(display.parameters())?.follow(start, run.samples);
    rows.push(truth(
        "77 digits",
        format!(
            "|ξ| = {} after {} samples",
            digits(double(&precise.position).abs(), 8),
            run.samples
        ),
    ));
    let naive = methods::named("closed-form")?;
    let slide = State {
        position: 0.3,
        velocity: 2.7,
    };
    let with_beta = |beta: f64| {
        Display::new(Dimensionless {
            beta,
            ..display.parameters()
        })
    };
    let (mut lost, mut kept) = (Vec::new(), Vec::new());
    for exponent in 1..=12 {
        let ratio = 10_f64.powi(-exponent);
        let display = with_beta(ratio * display.parameters().mu)?;
        lost.push((ratio, error_after_a_sample(&*naive, &display, slide)?));
        // An error of nothing is drawn as a tenth of a last digit.
        kept.push((
            ratio,
            error_after_a_sample(&Exact, &display, slide)?.max(1e-17),
        ));
    }
    for (ratio, error) in lost
        .iter()
        .filter(|(ratio, _)| [1e-6, 1e-12].contains(ratio))
    {
        rows.push(says(
            format!("closed-form, β/μ = {ratio:e}"),
            format!("error of {} counts after one sample", digits(*error, 2)),
        ));
    }
    let still = naive.sample(with_beta(0.0)?.hold(), slide, -0.5);
    rows.push(says(
        "closed-form, β = 0",
        if still.position.is_nan() {
            "no number"
        } else {
            "a number"
        },
    ));
    let worst = kept.iter().map(|point| point.1).fold(0.0, f64::max);
    rows.push(truth(
        "exact map, β/μ = 0.1 to 1e-12",
        format!("error of at most {} counts", digits(worst, 2)),
    ));
    let figure = Figure {
        title: "Error after one sample, against 77 digits, μ = 50, σ = 0.6".into(),
        x: Axis::logarithmic("β/μ"),
        y: Axis::logarithmic("|ξ − truth|, counts"),
        series: vec![
            dotted("closed-form", Whose::Naive, lost),
            dotted("exact map", Whose::Truth, kept),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// Samples that land on count edges.
pub(crate) fn count_edges(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let mut rows = Vec::new();
    for name in ["euler:1", "midpoint:10", "rk4:10", "dopri5:1e-12", "exact"] {
        let method = methods::named(name)?;
        let said = match first_wrong_count(&*method, &display, start, 200) {
            None => "right count for 200 samples".into(),
            Some((sample, position)) => {
                format!("wrong count at sample {sample}, ξ = {position}")
            }
        };
        let by = if name == "exact" { "exact map" } else { name };
        rows.push(says(by, said));
    }
    let precise = PreciseDisplay::new(display.parameters())?;
    let mut state = PreciseState::from(start);
    let mut wrong = None;
    for (sample, (x, _)) in in_eighths(start).enumerate().take(200) {
        if double(&state.position.floor()) != x.div_euclid(8) as f64 {
            wrong = Some((sample, x));
            break;
        }
        state = precise.sample(&state);
    }
    rows.push(says(
        "77 digits",
        match wrong {
            Some((sample, x)) => {
                let off = double(&(&state.position - number(x as f64 / 8.0)));
                format!(
                    "wrong count at sample {sample}, {} beside the edge",
                    digits(off, 1)
                )
            }
            None => "right count for 200 samples".into(),
        },
    ));
    let edges = in_eighths(start).take(90).filter(|(x, _)| x % 8 == 0);
    rows.push(truth(
        "whole numbers",
        format!(
            "{} of the first 90 samples are on a count edge, ξ = 7 at sample 2 the first beyond 0",
            edges.count()
        ),
    ));
    let errors = |name: &str, whose| -> Result<Series> {
        let states = states(&*methods::named(name)?, &display, start, 100);
        let pairs = states.iter().zip(in_eighths(start)).enumerate();
        let errors = pairs.map(|(sample, (state, (x, _)))| {
            (sample as f64, (state.position - x as f64 / 8.0).abs())
        });
        Ok(dots(name, whose, errors.collect()))
    };
    let figure = Figure {
        title: "Error of a display that lands on count edges, μ = 2, no friction".into(),
        x: Axis::linear("sample"),
        y: Axis::logarithmic("|ξ − whole numbers|, counts"),
        series: vec![
            errors("rk4:10", Whose::Naive)?,
            level("one count", 0.0, 100.0, 1.0),
            errors("exact", Whose::Truth)?,
        ],
    };
    Ok(Evidence { rows, figure })
}

/// The scene of [`sigma_half`] in decimals, for a controller in single precision.
pub const SIGMA_HALF_DECIMAL: &str = include_str!("../../../scenes/fail/sigma-half-decimal.toml");

/// Friction that just holds.
pub(crate) fn sigma_half(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let samples = loaded.scene.samples;
    let mut rows = run_rows(
        &["euler:10", "rk4:10", "midpoint:10", "exact"],
        &display,
        start,
        samples,
    )?;
    let sigma = display.parameters().sigma.next_down();
    let below = Display::new(Dimensionless {
        sigma,
        ..display.parameters()
    })?;
    let run = Exact.run(&below, start, samples);
    rows.push(truth("exact map, σ one bit below ½", outcome(&below, &run)));
    let decimal = scene::parse(SIGMA_HALF_DECIMAL)?;
    let mut single = Vec::new();
    let report = decimal.run(|sample| {
        if sample.number % 10 == 0 && sample.number <= 3000 {
            single.push((sample.number as f64, sample.state.velocity.abs()));
        }
        true
    })?;
    rows.push(says(
        "the same in decimals, torque in f32",
        format!(
            "never at rest ({} counts per sample after {} samples)",
            short(report.end.velocity.abs()),
            report.samples
        ),
    ));
    let speed = |method: &dyn Method, display: &Display| {
        let states = states(method, display, start, 3000);
        let points = over_samples(&states, |state| state.velocity.abs());
        points.into_iter().step_by(10).collect::<Vec<_>>()
    };
    let naive = methods::named("euler:10")?;
    let figure = Figure {
        title: "Speed where friction just holds, μ = 50, β = 0.6, σ = ½".into(),
        x: Axis::linear("sample"),
        y: Axis::logarithmic("|ξ̇|, counts per sample"),
        series: vec![
            line("euler:10", Whose::Naive, speed(&*naive, &display)),
            line("K = 0.1, c = 0.05, torque in f32", Whose::Second, single),
            line(
                "exact map, σ one bit below ½",
                Whose::Third,
                speed(&Exact, &below),
            ),
            line(
                "exact map, σ = ½, at rest after 923",
                Whose::Truth,
                speed(&Exact, &display),
            ),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// Points on (9).
pub(crate) fn critical_line(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let parameters = display.parameters();
    let holds = |holds: bool| if holds { "holds" } else { "does not hold" };
    let run = |velocity: f64| {
        let start = State { velocity, ..start };
        Exact.run(&display, start, loaded.scene.samples)
    };
    let beyond = start.velocity.next_up();
    let mut rows = vec![
        says(
            "(10) on the line, v₀ = 2",
            format!(
                "{}, margin {}",
                holds(parameters.holds_at(2.0)),
                parameters.power_margin(2.0)
            ),
        ),
        says(
            "(10) one bit beyond, v₀ = 2.0000000000000004",
            holds(parameters.holds_at(beyond)),
        ),
        says(
            "(10) in f32, v₀ = 2.00000001",
            holds(
                Dimensionless {
                    mu: 50.0_f32,
                    beta: 0.25,
                    sigma: 1.0,
                }
                .holds_at(2.000_000_01),
            ),
        ),
        says(
            "(10), β = 0.3, σ = 0.7, v₀ = 1: on the line in decimals",
            holds(
                Dimensionless {
                    beta: 0.3,
                    sigma: 0.7,
                    ..parameters
                }
                .holds_at(1.0),
            ),
        ),
    ];
    let corner = Dimensionless {
        beta: 0.3,
        sigma: 0.5,
        ..parameters
    };
    rows.push(says(
        "(8) as printed, σ = ½ at speed 0: 0/0",
        holds(holds_by_division(&corner, 0.0)),
    ));
    rows.push(truth(
        "(8) times the speed, σ = ½ at speed 0",
        holds(corner.holds_at(0.0)),
    ));
    for (name, velocity) in [("v₀ = 2", 2.0), ("one bit beyond", beyond), ("v₀ = 6", 6.0)] {
        rows.push(truth(
            format!("exact map, {name}"),
            outcome(&display, &run(velocity)),
        ));
    }
    let speeds: Vec<f64> = (4..=32).map(|quarter| f64::from(quarter) * 0.25).collect();
    let margin = |speed: &f64| (*speed, parameters.power_margin(*speed));
    let by_describing_function = |speed: &f64| {
        let value = describing_function(parameters.beta, parameters.sigma, *speed);
        (*speed, value - 0.5)
    };
    let outcome_at = |grows: bool, height: f64| {
        let of = speeds
            .iter()
            .filter(move |speed| (run(**speed).classes.window == Class::Unstable) == grows);
        of.map(move |speed| (*speed, height)).collect::<Vec<_>>()
    };
    let figure = Figure {
        title: "Across the critical line, μ = 50, β = ¼, σ = 1".into(),
        x: Axis::linear("v₀, counts per sample"),
        y: Axis::linear("margin, K Δ"),
        series: vec![
            line(
                "margin of (10), |v₀|(β − ½) + σ − ½",
                Whose::Naive,
                speeds.iter().map(margin).collect(),
            ),
            line(
                "β + 4σ/(πv₀) − ½",
                Whose::Third,
                speeds.iter().map(by_describing_function).collect(),
            ),
            dots("exact map: rests", Whose::Truth, outcome_at(false, 0.0)),
            dots("exact map: grows", Whose::Second, outcome_at(true, 0.0)),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// Far out, and fast.
pub(crate) fn million_counts(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let samples = 1000;
    let precise = PreciseDisplay::new(display.parameters())?;
    let truths: Vec<_> = std::iter::successors(Some(PreciseState::from(start)), |state| {
        Some(precise.sample(state))
    })
    .take(samples as usize + 1)
    .collect();
    let errors = |method: &dyn Method| -> Vec<(f64, f64)> {
        let states = states(method, &display, start, samples);
        let pairs = states.iter().zip(&truths).enumerate();
        pairs
            .map(|(sample, (state, truth))| {
                let off = double(&(number(state.position) - &truth.position)).abs();
                (sample as f64, off)
            })
            .collect()
    };
    let worst = |errors: &[(f64, f64)]| errors.iter().map(|point| point.1).fold(0.0, f64::max);
    let (single, exact) = (errors(&SinglePrecision), errors(&Exact));
    let peak = truths
        .iter()
        .map(|state| double(&state.position).abs())
        .fold(0.0, f64::max);
    let wraps = (start.velocity as i64) as i16;
    let rows = vec![
        says(
            "state in f32, moved exactly",
            format!("off by up to {} counts", digits(worst(&single), 2)),
        ),
        says(
            "16-bit counter, 1,000,000 counts in a sample",
            format!("reads {wraps}"),
        ),
        truth(
            "exact map",
            format!(
                "off by at most {} counts; every count as in 77 digits",
                digits(worst(&exact), 1)
            ),
        ),
        truth("77 digits", format!("reaches {} counts", digits(peak, 3))),
        truth(
            "exact map",
            outcome(&display, &Exact.run(&display, start, loaded.scene.samples)),
        ),
    ];
    let figure = Figure {
        title: "Error against 77 digits, from a million counts per sample".into(),
        x: Axis::linear("sample"),
        y: Axis::logarithmic("|ξ − truth|, counts"),
        series: vec![
            line("state in f32", Whose::Naive, single),
            level("half a count", 0.0, samples as f64, 0.5),
            line("exact map", Whose::Truth, exact),
        ],
    };
    Ok(Evidence { rows, figure })
}

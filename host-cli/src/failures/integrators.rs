//! Integrators that fail on the dimensionless display (6).

use anyhow::Result;
use control::criterion::Dimensionless;
use plant_sim::display::{Display, quantised_force};
use plant_sim::hold::{Hold, State};
use plant_sim::methods::{self, Exact, Method};
use plant_sim::precise::{PreciseDisplay, double};

use super::forms::{edge, error_after_a_sample, slide_error};
use super::trace::{dotted, level, line, over_samples, run_rows, states};
use super::{Evidence, adaptive, says, truth};
use crate::charts::failure::{Axis, Figure, Mark, Series, Whose};
use crate::number::digits;
use crate::scene;

/// Semi-implicit Euler takes away the instability under study.
pub(crate) fn euler_hides(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let mut rows = run_rows(
        &["euler:1", "euler:2", "euler:10", "exact"],
        &display,
        start,
        loaded.scene.samples,
    )?;
    let run = Exact.run(&display, start, loaded.scene.samples);
    let precise = PreciseDisplay::new(display.parameters())?.follow(start, run.samples);
    rows.push(truth(
        "77 digits",
        format!(
            "ξ = {} after {} samples; the exact map {}",
            digits(double(&precise.position), 12),
            run.samples,
            digits(run.end.position, 12)
        ),
    ));
    let steps = [1_u32, 2, 3, 4, 6, 10, 20, 50];
    let true_edge = edge(&Exact, &display, start)?;
    let mut edges = Vec::new();
    for n in steps {
        let euler = methods::named(&format!("euler:{n}"))?;
        edges.push((f64::from(n), edge(&*euler, &display, start)?));
    }
    for (n, at) in edges
        .iter()
        .filter(|(n, _)| [1.0, 2.0, 4.0, 10.0].contains(n))
    {
        rows.push(says(
            format!("euler:{n}"),
            format!("edge of growth at β = {}", digits(*at, 3)),
        ));
    }
    rows.push(truth(
        "exact map",
        format!("edge of growth at β = {}", digits(true_edge, 3)),
    ));
    let rule = steps.map(|n| (1.0 / f64::from(n), 0.5 - 0.5 / f64::from(n)));
    let edges = edges.into_iter().map(|(n, at)| (1.0 / n, at)).collect();
    let figure = Figure {
        title: "Where a display stops growing, μ = 50, σ = 0.6, v₀ = 40".into(),
        x: Axis::linear("length of a step 1/n, samples"),
        y: Axis::linear("β at the edge"),
        series: vec![
            dotted(
                "euler:n, n = 1, 2, 3, 4, 6, 10, 20, 50",
                Whose::Naive,
                edges,
            ),
            Series {
                mark: Mark::Dashed,
                ..line("½ − 1/(2n)", Whose::Second, rule.to_vec())
            },
            line(
                "exact map",
                Whose::Truth,
                vec![(0.0, true_edge), (1.0, true_edge)],
            ),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// Friction as c·sgn v flips with every step about zero velocity.
pub(crate) fn chatter(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let names = [
        "euler:1",
        "euler:10",
        "rk4:1",
        "rk4:10",
        "midpoint:1",
        "exact",
    ];
    let rows = run_rows(&names, &display, start, loaded.scene.samples)?;
    let drawn = [
        ("euler:1", Whose::Naive),
        ("rk4:10", Whose::Second),
        ("midpoint:1, at rest after 19", Whose::Fourth),
        ("exact, at rest after 16", Whose::Truth),
    ];
    let mut series = Vec::new();
    for (name, whose) in drawn {
        let method = methods::named(name.split(',').next().unwrap_or(name))?;
        let states = states(&*method, &display, start, 60);
        let points = over_samples(&states, |state| state.velocity.abs());
        series.push(line(name, whose, points));
    }
    let figure = Figure {
        title: "Speed of a display that comes to rest, μ = 1, β = σ = 0.6, v₀ = 10".into(),
        x: Axis::linear("sample"),
        y: Axis::logarithmic("|ξ̇|, counts per sample"),
        series,
    };
    Ok(Evidence { rows, figure })
}

/// The steps of an adaptive solver where sgn v jumps.
pub(crate) fn adaptive_chatter(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let force = quantised_force(start.position);
    let tolerances = (3..=10).map(|digits| 10_f64.powi(-digits));
    let efforts = |solve: fn(&Hold, State, f64, f64) -> adaptive::Effort| {
        let efforts = tolerances.clone().map(move |tolerance| {
            let effort = solve(display.hold(), start, force, tolerance);
            (tolerance, effort)
        });
        efforts.collect::<Vec<_>>()
    };
    let without = efforts(adaptive::effort_without_events);
    let with = efforts(adaptive::effort_with_event);
    let mut rows = Vec::new();
    for (tolerance, effort) in &without {
        if [1e-4, 1e-6, 1e-10].contains(tolerance) {
            let ended = if effort.finished {
                ""
            } else {
                ", then it gives up"
            };
            rows.push(says(
                format!("DOPRI5, sgn v, tolerance {tolerance:e}"),
                format!("{} evaluations for one sample{ended}", effort.evaluations),
            ));
        }
    }
    let most = with.iter().map(|(_, effort)| effort.evaluations).max();
    rows.push(says(
        "DOPRI5 with an event at zero velocity",
        format!("at most {} evaluations", most.unwrap_or(0)),
    ));
    let stop = Exact.sample(display.hold(), start, force);
    rows.push(truth(
        "exact map",
        format!(
            "stops within the sample, at ξ = {}, and sticks",
            digits(stop.position, 7)
        ),
    ));
    let points = |efforts: &[(f64, adaptive::Effort)]| {
        let pairs = efforts.iter();
        pairs
            .map(|(tolerance, effort)| (*tolerance, effort.evaluations as f64))
            .collect()
    };
    let figure = Figure {
        title: "Work for one sample in which the display stops and sticks".into(),
        x: Axis::logarithmic("tolerance of the solver"),
        y: Axis::logarithmic("evaluations of the right-hand side"),
        series: vec![
            dotted("DOPRI5, friction σ sgn ξ̇", Whose::Naive, points(&without)),
            dotted(
                "DOPRI5, event at zero velocity",
                Whose::Truth,
                points(&with),
            ),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// tanh for sgn has no dead band.
pub(crate) fn tanh_creep(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let mut rows = run_rows(
        &["rk4-tanh:10", "rk4-tanh:100", "midpoint:10", "exact"],
        &display,
        start,
        loaded.scene.samples,
    )?;
    let after = |name: &str| -> Result<String> {
        let end = methods::named(name)?.follow(&display, start, 500);
        Ok(format!("ξ = {} after 500 samples", digits(end.position, 4)))
    };
    rows.push(says("rk4-tanh:10", after("rk4-tanh:10")?));
    rows.push(truth("exact map", after("exact")?));
    let path = |name: &str, whose| -> Result<Series> {
        let states = states(&*methods::named(name)?, &display, start, 500);
        Ok(line(
            name,
            whose,
            over_samples(&states, |state| state.position),
        ))
    };
    let figure = Figure {
        title: "A display that sticks for ever, μ = 50, β = 0.6, σ = 1.6".into(),
        x: Axis::linear("sample"),
        y: Axis::linear("ξ, counts"),
        series: vec![
            path("rk4-tanh:10", Whose::Naive)?,
            path("exact", Whose::Truth)?,
        ],
    };
    Ok(Evidence { rows, figure })
}

/// 1/π²: at a smaller μ the natural frequency is beyond half the sampling frequency.
const NYQUIST_MU: f64 = 1.0 / (std::f64::consts::PI * std::f64::consts::PI);

/// Light displays, of a natural period of two samples to π.
pub(crate) fn nyquist(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let names = ["euler:1", "midpoint:1", "midpoint:10", "exact"];
    let mut rows = run_rows(&names, &display, start, loaded.scene.samples)?;
    let fast = State {
        position: 0.0,
        velocity: 40.0,
    };
    let mus = [
        NYQUIST_MU, 0.12, 0.15, 0.18, 0.21, 0.25, 0.35, 0.5, 0.7, 1.0, 2.0, 5.0,
    ];
    let edges = |name: &str| -> Result<Vec<(f64, f64)>> {
        let method = methods::named(name)?;
        let edges = mus.into_iter().map(|mu| {
            let parameters = Dimensionless {
                mu,
                ..display.parameters()
            };
            Ok((mu, edge(&*method, &Display::new(parameters)?, fast)?))
        });
        edges.collect()
    };
    let (midpoint, exact) = (edges("midpoint:1")?, edges("exact")?);
    // Beyond it the velocity turns round with every step, and grows.
    let euler = (0..=20).map(|i| f64::from(i) * 0.025);
    let euler = euler.map(|beta| (0.25 + 0.5 * beta, beta)).collect();
    let predicted = 0.5 - 4.0 * display.parameters().sigma / (std::f64::consts::PI * fast.velocity);
    for (mu, name) in [(NYQUIST_MU, "1/π²"), (0.25, "¼"), (5.0, "5")] {
        let at = |edges: &[(f64, f64)]| {
            let found = edges.iter().find(|(of, _)| *of == mu);
            digits(found.map_or(f64::NAN, |(_, edge)| *edge), 3)
        };
        rows.push(says(
            format!("midpoint:1, μ = {name}"),
            format!("from v₀ = 40 grows up to β = {}", at(&midpoint)),
        ));
        rows.push(truth(
            format!("exact map, μ = {name}"),
            format!("from v₀ = 40 grows up to β = {}", at(&exact)),
        ));
    }
    rows.push(says(
        "describing function",
        format!("grows up to β = {}, whatever μ", digits(predicted, 3)),
    ));
    let figure = Figure {
        title: "Where light displays stop growing, σ = 0.6, v₀ = 40".into(),
        x: Axis::logarithmic("μ, from the Nyquist edge 1/π²"),
        y: Axis::linear("β at the edge"),
        series: vec![
            line("euler:1 grows above β = 2μ − ½", Whose::Naive, euler),
            dotted("midpoint:1", Whose::Second, midpoint),
            level(
                "describing function β + 4σ/(πv₀) = ½",
                NYQUIST_MU,
                5.0,
                predicted,
            ),
            dotted("exact map", Whose::Truth, exact),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// Interpolation over a step that spans the interval.
pub(crate) fn dense_output(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let errors = |dense| {
        let tolerances = (3..=13).map(|digits| 10_f64.powi(-digits));
        let errors = tolerances.map(move |tolerance| {
            let error = slide_error(&display, start, tolerance, dense);
            (tolerance, error.unwrap_or(f64::NAN).max(1e-17))
        });
        errors.collect::<Vec<_>>()
    };
    let (dense, sparse) = (errors(true), errors(false));
    let mut rows = Vec::new();
    for (name, errors) in [("dense", &dense), ("sparse", &sparse)] {
        for (tolerance, error) in errors.iter() {
            if [1e-6, 1e-12].contains(tolerance) {
                rows.push(says(
                    format!("DOPRI5, {name} output, tolerance {tolerance:e}"),
                    format!("off by {} counts", digits(*error, 2)),
                ));
            }
        }
    }
    let precise = error_after_a_sample(&Exact, &display, start)?;
    rows.push(truth(
        "exact map against 77 digits",
        format!("off by {} counts", digits(precise, 1)),
    ));
    let figure = Figure {
        title: "Error of DOPRI5 over one sample without a reversal".into(),
        x: Axis::logarithmic("tolerance of the solver"),
        y: Axis::logarithmic("|ξ − truth|, counts"),
        series: vec![
            dotted("dense output at the end", Whose::Naive, dense),
            dotted(
                "sparse output, the solver's own steps",
                Whose::Truth,
                sparse,
            ),
        ],
    };
    Ok(Evidence { rows, figure })
}

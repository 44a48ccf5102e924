//! Rules and bounds that say more than they know.

use anyhow::Result;
use plant_sim::display::Run;
use plant_sim::energy;
use plant_sim::methods::{Exact, Method};
use plant_sim::precise::{PreciseDisplay, double};

use super::trace::{dots, dotted, level, line, outcome, over_samples, states};
use super::{Evidence, says, truth};
use crate::charts::failure::{Axis, Figure, Series, Whose};
use crate::number::{digits, short};
use crate::scene;

/// (10) reads the speed at the start.
pub(crate) fn start_under_load(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let parameters = display.parameters();
    let reached = energy::reachable_speed(start, 1.0, parameters.mu);
    let run = Exact.run(&display, start, loaded.scene.samples);
    let precise = PreciseDisplay::new(parameters)?.follow(start, run.samples);
    let margin = |speed| digits(parameters.power_margin(speed), 3);
    let rows = vec![
        says(
            "(10) at the initial speed 0.328",
            format!("holds, margin {} K Δ: passive", margin(start.velocity)),
        ),
        truth(
            format!("(8) at the speed √(v² + ξ²/μ) = {}", short(reached)),
            format!("does not hold, margin {} K Δ", margin(reached)),
        ),
        truth("exact map", outcome(&display, &run)),
        truth(
            "77 digits",
            format!(
                "ξ = {} after {} samples; the exact map {}",
                digits(double(&precise.position), 12),
                run.samples,
                digits(run.end.position, 12)
            ),
        ),
    ];
    let trajectory = states(&Exact, &display, start, 24);
    let speeds = over_samples(&trajectory, |state| state.velocity.abs());
    // The largest speed at which (8) holds.
    let allowed = (parameters.sigma - 0.5) / (0.5 - parameters.beta);
    let figure = Figure {
        title: "Satisfies (10), not (8): ξ₀ = 0.994, v₀ = 0.328".into(),
        x: Axis::linear("sample"),
        y: Axis::logarithmic("|ξ̇|, counts per sample"),
        series: vec![
            level(
                format!("(8) holds below {}", digits(allowed, 3)),
                0.0,
                24.0,
                allowed,
            ),
            Series {
                whose: Whose::Third,
                ..level(
                    format!("the start can reach {}", short(reached)),
                    0.0,
                    24.0,
                    reached,
                )
            },
            line("exact map", Whose::Truth, speeds),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// Slower than 0.01 at one sample.
pub(crate) fn papers_rule(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let samples = loaded.scene.samples;
    let run = |samples| Exact.run(&display, start, samples);
    let (last, next) = (run(samples), run(samples + 1));
    let states = states(&Exact, &display, start, samples + 1);
    let ending = &states[samples as usize - 2000..];
    let peak = ending
        .iter()
        .map(|state| state.velocity.abs())
        .fold(0.0, f64::max);
    let slow = ending.iter().filter(|state| state.velocity.abs() < 0.01);
    let slow = slow.count();
    let says_at = |run: &Run| {
        format!(
            "{}, |ξ̇| = {}",
            run.classes.paper,
            short(run.end.velocity.abs())
        )
    };
    let rows = vec![
        says(format!("the paper's rule at N = {samples}"), says_at(&last)),
        says(
            format!("the paper's rule at N = {}", samples + 1),
            says_at(&next),
        ),
        truth(
            "the window rule at both",
            format!(
                "{}; peak speed of the last 2,000 samples {}, {slow} of them slow",
                last.classes.window,
                short(peak)
            ),
        ),
    ];
    let from = states.len() - 40;
    let tail = over_samples(&states[from..], |state| state.velocity);
    let shown = |x: f64| x + from as f64 - samples as f64;
    let tail: Vec<_> = tail.into_iter().map(|(x, v)| (shown(x), v)).collect();
    let (first, end) = (tail[0].0, tail[tail.len() - 1].0);
    let figure = Figure {
        title: "A limit cycle read at one sample, μ = 5, β = 0.6, σ = 0.1".into(),
        x: Axis::linear("sample, N = 0"),
        y: Axis::linear("ξ̇, counts per sample"),
        series: vec![
            level("0.01, the paper's rule", first, end, 0.01),
            level("−0.01", first, end, -0.01),
            dotted("exact map", Whose::Truth, tail),
            dots(
                "read at N: rest",
                Whose::Naive,
                vec![(0.0, last.end.velocity)],
            ),
        ],
    };
    Ok(Evidence { rows, figure })
}

/// (22) between whole counts.
pub(crate) fn bound_hole(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let (display, start) = loaded.display()?;
    let (end, exchange) = display.audited_step(start, 0.0);
    let moved = end.position - start.position;
    let rows = vec![
        says(
            "the paper's (22), ½d² + ½|d|",
            format!(
                "at most {} K Δ² for d = {}",
                digits(energy::generated_bound_of_the_paper(moved), 4),
                digits(moved, 4)
            ),
        ),
        truth(
            "exact map, (18)",
            format!("{} K Δ² generated", digits(exchange.generated, 4)),
        ),
        truth(
            "the exact supremum",
            format!("{} K Δ²", digits(energy::generated_supremum(moved), 4)),
        ),
    ];
    let distances = || (0..=150).map(|i| f64::from(i) / 50.0);
    let largest = |d: f64| {
        let starts = (0..400).map(|k| f64::from(k) / 400.0 + 1e-9);
        starts
            .chain([1.0 - 1e-9])
            .map(|from| energy::generated(from, from + d))
            .fold(f64::NEG_INFINITY, f64::max)
    };
    let curve = |of: &dyn Fn(f64) -> f64| distances().map(|d| (d, of(d))).collect::<Vec<_>>();
    let found = distances().step_by(5).map(|d| (d, largest(d)));
    let figure = Figure {
        title: "Energy that a sampled spring can make within one sample".into(),
        x: Axis::linear("displacement d, counts"),
        y: Axis::linear("energy, K Δ²"),
        series: vec![
            line(
                "the paper's bound (22)",
                Whose::Naive,
                curve(&energy::generated_bound_of_the_paper),
            ),
            line(
                "n(n + 1)/2 + (|d| − n)(n + 1), n = ⌊|d|⌋",
                Whose::Truth,
                curve(&energy::generated_supremum),
            ),
            dots("largest of 401 starts", Whose::Fourth, found.collect()),
            dots(
                "from 0.99 to 1.49",
                Whose::Second,
                vec![(moved, exchange.generated)],
            ),
        ],
    };
    Ok(Evidence { rows, figure })
}

//! The naive forms themselves, and what is true in whole numbers: for the catalogue and its tests.

use std::fmt;

use anyhow::Result;
use control::config::Law;
use control::criterion::{Criterion, Dimensionless};
use control::shape::Profile;
use control::tick::{Reason, Tick};
use plant_sim::closed_loop::{Report, Sample, Scene};
use plant_sim::display::{Display, quantised_force};
use plant_sim::hold::{Hold, State};
use plant_sim::methods::{Exact, Method};
use plant_sim::outcome::Class;
use plant_sim::precise::{PreciseDisplay, double, number};

use super::adaptive;
use super::trace::states;
use crate::scene::{self, Loaded};
use crate::stop;

/// A state kept in single precision between samples, moved exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SinglePrecision;

impl Method for SinglePrecision {
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        let end = Exact.sample(hold, start, force);
        State {
            position: f64::from(end.position as f32),
            velocity: f64::from(end.velocity as f32),
        }
    }
}

impl fmt::Display for SinglePrecision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("exact, state in f32")
    }
}

/// β below which a display grows, from `start` with every other parameter as in `display`: by
/// bisection of 0 to 1, to 1e-4; 0 if nothing grows.
///
/// # Errors
/// If the user asks to stop.
pub fn edge(method: &dyn Method, display: &Display, start: State) -> Result<f64> {
    let (mut grows, mut holds) = (0.0, 1.0);
    while holds - grows > 1e-4 {
        stop::check()?;
        let beta = 0.5 * (grows + holds);
        let parameters = Dimensionless {
            beta,
            ..display.parameters()
        };
        let run = method.run(&Display::new(parameters)?, start, 10_000);
        if run.classes.window == Class::Unstable {
            grows = beta;
        } else {
            holds = beta;
        }
    }
    Ok(if grows == 0.0 {
        0.0
    } else {
        0.5 * (grows + holds)
    })
}

/// The display of μ = 2 without friction in whole numbers: twice its positions and velocities, times
/// four, by x += v − (2n + 1), v −= 2(2n + 1), n = ⌊x/8⌋, in eighths of a count. True to the last
/// digit, up to 2⁶² eighths.
///
/// # Panics
/// If `start` is no whole number of eighths.
pub fn in_eighths(start: State) -> impl Iterator<Item = (i64, i64)> {
    let eighths = |value: f64| {
        let eighths = 8.0 * value;
        assert!(eighths.fract() == 0.0, "{value} is no multiple of 1/8");
        eighths as i64
    };
    let first = (eighths(start.position), eighths(start.velocity));
    std::iter::successors(Some(first), |(x, v)| {
        let force = 2 * x.div_euclid(8) + 1;
        Some((x + v - force, v - 2 * force))
    })
}

/// The first sample at which a method is in another count than the whole numbers say, and where it is.
pub fn first_wrong_count(
    method: &dyn Method,
    display: &Display,
    start: State,
    samples: u64,
) -> Option<(u64, f64)> {
    let states = states(method, display, start, samples);
    let pairs = states.into_iter().zip(in_eighths(start)).enumerate();
    pairs
        .map(|(sample, (state, (x, _)))| (sample as u64, state.position, x.div_euclid(8)))
        .find(|(_, position, count)| position.floor() != *count as f64)
        .map(|(sample, position, _)| (sample, position))
}

/// Inequality (8) as it is printed, with its division by the speed.
#[must_use]
pub fn holds_by_division(display: &Dimensionless<f64>, speed: f64) -> bool {
    (display.beta - 0.5) + (display.sigma - 0.5) / speed >= 0.0
}

/// Error of a solver's output over a slide without a reversal, counts.
pub fn slide_error(display: &Display, start: State, tolerance: f64, dense: bool) -> Option<f64> {
    let force = quantised_force(start.position);
    let end = adaptive::end_of_slide(display.hold(), start, force, tolerance, dense)?;
    let exact = Exact.sample(display.hold(), start, force);
    Some((end.position - exact.position).abs())
}

/// A scene's text with one line for another.
///
/// # Errors
/// If the line is not there once.
pub fn mended(scene: &str, line: &str, by: &str) -> Result<Loaded> {
    let there = scene.lines().filter(|text| *text == line).count();
    anyhow::ensure!(there == 1, "`{line}` stands {there} times in the scene");
    let lines = scene
        .lines()
        .map(|text| if text == line { by } else { text });
    scene::parse(&lines.collect::<Vec<_>>().join("\n"))
}

/// A scene under a spring or detent whose stiffness is chosen afresh in every tick, from the
/// counts moved and the deflection (rad): what the laws of [`control`] never do.
///
/// # Errors
/// See [`plant_sim::closed_loop::SceneError`].
pub fn run_choosing(
    scene: &Scene,
    mut stiffness: impl FnMut(i32, f64) -> f64,
    observe: impl FnMut(&Sample) -> bool,
) -> Result<Report> {
    let config = &scene.config;
    let profile = Profile::new(&config.shape, config.count_rad())?;
    let before_rad = scene.start.position - scene.start.velocity * config.timing.period_s;
    let mut before = before_rad.div_euclid(config.count_rad()) as i32;
    let control = |counter: u32, _| {
        let count = counter as i32;
        let moved = count - before;
        before = count;
        let reading = profile.read(count);
        let stiffness = stiffness(moved, f64::from(reading.deflection_rad)) as f32;
        Tick {
            count,
            moved,
            torque_nm: stiffness * reading.pull_rad,
            stiffness_nm_rad: stiffness,
            margin_nm: 0.0,
            account_j: 0.0,
            law: Law::Raw,
            reason: Reason::None,
        }
    };
    Ok(scene.run_under(control, observe)?)
}

/// The stiffness that (11) allows at the speed of the last tick, which falls and rises with it.
pub fn following_the_speed(
    criterion: Criterion<f64>,
    demand_nm_rad: f64,
) -> impl FnMut(i32, f64) -> f64 {
    let sampling = *criterion.sampling();
    move |moved, _| {
        let speed = f64::from(moved.abs()) * sampling.count_rad / sampling.period_s;
        criterion.largest_stiffness_at(speed).min(demand_nm_rad)
    }
}

/// The stiffness of a detent limited by its slope where the knob is, K·cos(2πq/p), not by the steepest.
pub fn by_the_local_slope(
    criterion: Criterion<f64>,
    period_rad: f64,
    demand_nm_rad: f64,
) -> impl FnMut(i32, f64) -> f64 {
    let most = criterion.largest_stiffness();
    move |_, deflection_rad| {
        let slope = (std::f64::consts::TAU * deflection_rad / period_rad)
            .cos()
            .abs();
        (most / slope).min(demand_nm_rad)
    }
}

/// |ξ − truth in 77 digits| after one sample, counts; NaN where the method gives no number.
///
/// # Errors
/// None for a display that is one.
pub fn error_after_a_sample(method: &dyn Method, display: &Display, start: State) -> Result<f64> {
    let precise = PreciseDisplay::new(display.parameters())?.follow(start, 1);
    let end = method.sample(display.hold(), start, quantised_force(start.position));
    if !end.position.is_finite() {
        return Ok(f64::NAN);
    }
    Ok(double(&(number(end.position) - precise.position)).abs())
}

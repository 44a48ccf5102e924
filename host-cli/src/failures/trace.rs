//! Runs of a display in words and as lines of a figure.

use anyhow::Result;
use plant_sim::display::{Display, Run, quantised_force};
use plant_sim::hold::State;
use plant_sim::methods::{self, Method};
use plant_sim::outcome::Class;

use super::{Row, says, truth};
use crate::charts::failure::{Mark, Series, Whose};
use crate::number::short;
use crate::stop;

/// The states of the first `samples` samples, the start first.
pub fn states(method: &dyn Method, display: &Display, start: State, samples: u64) -> Vec<State> {
    let next = |state: &State| {
        let force = quantised_force(state.position);
        Some(method.sample(display.hold(), *state, force))
    };
    std::iter::successors(Some(start), next)
        .take(samples as usize + 1)
        .collect()
}

/// A quantity of states against the sample.
pub fn over_samples(states: &[State], quantity: impl Fn(&State) -> f64) -> Vec<(f64, f64)> {
    let numbered = states.iter().enumerate();
    numbered
        .map(|(sample, state)| (sample as f64, quantity(state)))
        .collect()
}

/// What became of a run, in words.
pub fn outcome(display: &Display, run: &Run) -> String {
    let samples = match run.samples {
        1 => "1 sample".into(),
        more => format!("{more} samples"),
    };
    match run.classes.window {
        Class::Rest if display.rests(run.end) => format!("rest after {samples}"),
        Class::Rest => format!(
            "slower than 0.01 counts per sample, but never at rest ({} after {samples})",
            short(run.end.velocity.abs())
        ),
        Class::LimitCycle if run.classes.paper == Class::Rest => {
            "limit cycle; rest by the paper's rule".into()
        }
        Class::LimitCycle => "limit cycle".into(),
        Class::Unstable if run.end.position.is_nan() => "no number".into(),
        Class::Unstable => format!("grows without bound (1e9 counts after {samples})"),
        Class::Undecided => "too short to tell".into(),
    }
}

/// What methods say of a display, the last of them the truth.
pub fn run_rows(
    methods: &[&str],
    display: &Display,
    start: State,
    samples: u64,
) -> Result<Vec<Row>> {
    let rows = methods.iter().map(|name| {
        stop::check()?;
        let run = methods::named(name)?.run(display, start, samples);
        let said = outcome(display, &run);
        Ok(if *name == "exact" {
            truth("exact map", said)
        } else {
            says(*name, said)
        })
    });
    rows.collect()
}

pub fn line(name: impl Into<String>, whose: Whose, points: Vec<(f64, f64)>) -> Series {
    Series {
        name: name.into(),
        whose,
        mark: Mark::Line,
        points,
    }
}

/// A dashed level to compare with.
pub fn level(name: impl Into<String>, from: f64, to: f64, value: f64) -> Series {
    Series {
        name: name.into(),
        whose: Whose::Level,
        mark: Mark::Dashed,
        points: vec![(from, value), (to, value)],
    }
}

/// Dots on a line.
pub fn dotted(name: impl Into<String>, whose: Whose, points: Vec<(f64, f64)>) -> Series {
    Series {
        mark: Mark::DotsOnLine,
        ..line(name, whose, points)
    }
}

/// Dots alone.
pub fn dots(name: impl Into<String>, whose: Whose, points: Vec<(f64, f64)>) -> Series {
    Series {
        mark: Mark::Dots,
        ..line(name, whose, points)
    }
}

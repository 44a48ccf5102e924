//! Adaptive solvers used as they should not be: Dormand and Prince's method (crate `ode_solvers`) with
//! friction as sgn v and no events, and with dense output.

use std::cell::Cell;

use ode_solvers::{Dopri5, OutputType, System, Vector2};
use plant_sim::hold::{Hold, State};

/// (1) under a held force; counts its evaluations.
struct Display<'a> {
    hold: Hold,
    force: f64,
    /// The sign of the motion, if the solution ends where it changes; else friction is c·sgn v.
    until_reversal: Option<f64>,
    evaluations: &'a Cell<u64>,
}

impl System<f64, Vector2<f64>> for Display<'_> {
    fn system(&self, _time: f64, y: &Vector2<f64>, dy: &mut Vector2<f64>) {
        self.evaluations.set(self.evaluations.get() + 1);
        let direction = match self.until_reversal {
            Some(direction) => direction,
            None if y[1] == 0.0 => 0.0,
            None => y[1].signum(),
        };
        let friction = self.hold.coulomb() * direction;
        dy[0] = y[1];
        dy[1] = (self.force - self.hold.viscous() * y[1] - friction) / self.hold.inertia();
    }

    fn solout(&mut self, _time: f64, y: &Vector2<f64>, _dy: &Vector2<f64>) -> bool {
        self.until_reversal
            .is_some_and(|direction| y[1] * direction < 0.0)
    }
}

/// What an integration of one interval came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Evaluations of the right-hand side.
    pub evaluations: u64,
    /// Whether the solver reached the end of the interval, or the reversal.
    pub finished: bool,
}

fn solve(system: Display<'_>, start: State, tolerance: f64, output: OutputType) -> Option<State> {
    let span = system.hold.duration();
    // The crate's own defaults, but for the first step (the interval) and the output.
    let mut solver = Dopri5::from_param(
        system,
        0.0,
        span,
        span,
        Vector2::new(start.position, start.velocity),
        tolerance,
        tolerance,
        0.9,
        0.04,
        0.2,
        10.0,
        span,
        span,
        100_000,
        1_000,
        output,
    );
    solver.integrate().ok()?;
    let last = solver.y_out().last()?;
    Some(State {
        position: last[0],
        velocity: last[1],
    })
}

/// One interval with friction c·sgn v and nothing that tells the solver of its jump.
#[must_use]
pub fn effort_without_events(hold: &Hold, start: State, force: f64, tolerance: f64) -> Effort {
    effort(hold, start, force, tolerance, None)
}

/// One interval up to the reversal, friction of the sign that the motion has at the start.
#[must_use]
pub fn effort_with_event(hold: &Hold, start: State, force: f64, tolerance: f64) -> Effort {
    effort(hold, start, force, tolerance, Some(start.velocity.signum()))
}

fn effort(
    hold: &Hold,
    start: State,
    force: f64,
    tolerance: f64,
    until_reversal: Option<f64>,
) -> Effort {
    let evaluations = Cell::new(0);
    let system = Display {
        hold: *hold,
        force,
        until_reversal,
        evaluations: &evaluations,
    };
    let end = solve(system, start, tolerance, OutputType::Sparse);
    Effort {
        evaluations: evaluations.get(),
        finished: end.is_some(),
    }
}

/// The state after one interval without a reversal, by the solver's sparse output, its own
/// steps; or by its dense output of one point at the end of the interval. None where the solver
/// gives up.
#[must_use]
pub fn end_of_slide(
    hold: &Hold,
    start: State,
    force: f64,
    tolerance: f64,
    dense: bool,
) -> Option<State> {
    let system = Display {
        hold: *hold,
        force,
        until_reversal: Some(start.velocity.signum()),
        evaluations: &Cell::new(0),
    };
    let output = if dense {
        OutputType::Dense
    } else {
        OutputType::Sparse
    };
    solve(system, start, tolerance, output)
}

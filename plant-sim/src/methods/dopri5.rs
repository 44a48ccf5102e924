//! Dormand and Prince's method with step control and events, by the crate `ode_solvers`.

use std::fmt;

use ode_solvers::{OutputType, System, Vector2};

use super::Method;
use crate::hold::{Hold, State};

/// DOPRI5 with events: friction keeps its sign until the velocity reaches zero; then the
/// display sticks, or goes on with friction turned round.
///
/// As fast as the crate allows: the first step that it tries spans the whole rest of the
/// interval, and a reversal costs one more integration, over velocity, not a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dopri5 {
    /// Relative and absolute tolerance of a step.
    pub tolerance: f64,
}

impl Method for Dopri5 {
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        const LOST: State = State {
            position: f64::NAN,
            velocity: f64::NAN,
        };
        self.solve(hold, start, force).unwrap_or(LOST)
    }
}

impl Dopri5 {
    fn solve(self, hold: &Hold, start: State, force: f64) -> Option<State> {
        let (mut time, mut state) = (0.0, start);
        while time < hold.duration() {
            let direction = if state.velocity == 0.0 {
                hold.breakaway(force)
            } else {
                state.velocity
            };
            if direction == 0.0 {
                break;
            }
            let motion = Motion {
                inertia: hold.inertia(),
                viscous: hold.viscous(),
                drive: force - hold.coulomb().copysign(direction),
                direction,
            };
            let start = Vector2::new(state.position, state.velocity);
            let over_time = OverTime(motion);
            let [before, end] = integrate(over_time, time, hold.duration(), start, self.tolerance)?;
            if end.y[1] * direction >= 0.0 {
                return Some(State {
                    position: end.y[0],
                    velocity: end.y[1],
                });
            }
            let start = Vector2::new(before.y[0], before.x);
            let over_velocity = OverVelocity(motion);
            let [_, turn] = integrate(over_velocity, before.y[1], 0.0, start, self.tolerance)?;
            time = turn.y[1];
            state = State {
                position: turn.y[0],
                velocity: 0.0,
            };
        }
        Some(state)
    }
}

impl fmt::Display for Dopri5 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "dopri5:{:e}", self.tolerance)
    }
}

/// A mass under a constant force and friction of one sign.
#[derive(Clone, Copy)]
struct Motion {
    inertia: f64,
    viscous: f64,
    /// Force less Coulomb friction.
    drive: f64,
    /// Has the sign of the motion.
    direction: f64,
}

impl Motion {
    fn acceleration(&self, velocity: f64) -> f64 {
        (self.drive - self.viscous * velocity) / self.inertia
    }
}

/// Position and velocity over time, to the first step that ends beyond a reversal.
struct OverTime(Motion);

impl System<f64, Vector2<f64>> for OverTime {
    fn system(&self, _time: f64, y: &Vector2<f64>, dy: &mut Vector2<f64>) {
        dy[0] = y[1];
        dy[1] = self.0.acceleration(y[1]);
    }

    fn solout(&mut self, _time: f64, y: &Vector2<f64>, _dy: &Vector2<f64>) -> bool {
        y[1] * self.0.direction < 0.0
    }
}

/// Position and time over velocity: at velocity 0 they are those of the reversal (Hénon).
struct OverVelocity(Motion);

impl System<f64, Vector2<f64>> for OverVelocity {
    fn system(&self, velocity: f64, _y: &Vector2<f64>, dy: &mut Vector2<f64>) {
        let time_per_velocity = 1.0 / self.0.acceleration(velocity);
        dy[0] = velocity * time_per_velocity;
        dy[1] = time_per_velocity;
    }
}

/// A solution's value.
struct Point {
    x: f64,
    y: Vector2<f64>,
}

/// The last two points of the solution from `x` to `x_end`, or None where the crate gives up.
/// Sparse output: the crate's dense output is wrong where a step spans the interval.
fn integrate(
    system: impl System<f64, Vector2<f64>>,
    x: f64,
    x_end: f64,
    y: Vector2<f64>,
    tolerance: f64,
) -> Option<[Point; 2]> {
    let span = x_end - x;
    // The crate's own defaults, but for the first step (`span`) and the output.
    let (safety, beta, shrink_most, grow_most) = (0.9, 0.04, 0.2, 10.0);
    let (most_steps, stiffness_test_every) = (100_000, 1_000);
    let mut solver = ode_solvers::Dopri5::from_param(
        system,
        x,
        x_end,
        span,
        y,
        tolerance,
        tolerance,
        safety,
        beta,
        shrink_most,
        grow_most,
        span,
        span,
        most_steps,
        stiffness_test_every,
        OutputType::Sparse,
    );
    solver.integrate().ok()?;
    let (xs, ys) = solver.results().get();
    let point = |from_end: usize| {
        let i = xs.len().checked_sub(from_end)?;
        Some(Point { x: xs[i], y: ys[i] })
    };
    Some([point(2)?, point(1)?])
}

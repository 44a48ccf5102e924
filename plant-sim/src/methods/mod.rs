//! Other ways to move a display over one held interval, to compare with and to learn from.
//!
//! All solve μ ξ̈ + β ξ̇ + σ sgn ξ̇ = φ (6), or (1), for a held force and stand behind one trait,
//! [`Method`]. Everywhere else the plant is the exact map, [`Exact`]; the truth that all are measured
//! against is [`crate::precise`].
//!
//! | method | written | what it is |
//! |---|---|---|
//! | [`Exact`] | `exact` | the closed form of [`crate::hold`] |
//! | [`ClosedForm`] | `closed-form` | the same solution as textbooks write it; loses digits as β/μ → 0 |
//! | [`Euler`] | `euler:N` | semi-implicit Euler, friction c·sgn v, N steps an interval |
//! | [`Midpoint`] | `midpoint:N` | implicit midpoint, friction projected, N steps an interval |
//! | [`Rk4`] | `rk4:N`, `rk4-tanh:N` | Runge–Kutta of order 4, friction c·sgn v or c·tanh(v/w) |
//! | [`Dopri5`] | `dopri5:TOL` | Dormand–Prince with step control and events, crate `ode_solvers` |

mod closed_form;
mod dopri5;
mod fixed_step;

use std::fmt;
use std::num::NonZeroU32;
use std::str::FromStr;

use crate::display::{Display, Run, quantised_force};
use crate::hold::{Hold, State};

pub use closed_form::ClosedForm;
pub use dopri5::Dopri5;
pub use fixed_step::{Euler, Friction, Midpoint, Rk4};

/// A way to move a display over one interval.
pub trait Method: fmt::Display + Send + Sync {
    /// The state after one interval of `hold` under a held force. What cannot be computed is
    /// NaN.
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State;

    /// The state after `samples` intervals of a display, whatever becomes of it.
    fn follow(&self, display: &Display, start: State, samples: u64) -> State {
        let mut state = start;
        for _ in 0..samples {
            state = self.sample(display.hold(), state, quantised_force(state.position));
        }
        state
    }

    /// [`Display::run`] by this method: the same rules for what became of it.
    fn run(&self, display: &Display, start: State, samples: u64) -> Run {
        self.run_observed(display, start, samples, &mut |_, _| true)
    }

    /// The same; `observe` sees every sample, the start as sample 0, and may end the run by
    /// returning false.
    fn run_observed(
        &self,
        display: &Display,
        start: State,
        samples: u64,
        observe: &mut dyn FnMut(u64, State) -> bool,
    ) -> Run {
        let hold = display.hold();
        display.run_by(
            |state, force| self.sample(hold, state, force),
            start,
            samples,
            observe,
        )
    }
}

/// The closed form of [`Hold::step`]: no error but rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exact;

impl Method for Exact {
    #[inline]
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        hold.step(start, force).end
    }
}

impl fmt::Display for Exact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("exact")
    }
}

/// The width w of [`Friction::Tanh`] that `rk4-tanh:N` has, in counts per sample.
pub const TANH_WIDTH: f64 = 1e-2;

/// Why a text names no method.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "method {0}; accepted: exact, closed-form, euler:N, midpoint:N, rk4:N, rk4-tanh:N, \
     N a whole number from 1 to 1000000, or dopri5:TOL, TOL from 1e-14 to 0.1"
)]
pub struct NoMethod(String);

/// The method that a text such as `euler:10` names.
///
/// ```
/// use plant_sim::methods;
/// assert_eq!(methods::named("rk4:10")?.to_string(), "rk4:10");
/// assert!(methods::named("rk4:0").is_err());
/// # Ok::<(), methods::NoMethod>(())
/// ```
///
/// # Errors
/// Refuses a name that is none, no steps, more than a million, and tolerances that make no sense.
pub fn named(text: &str) -> Result<Box<dyn Method>, NoMethod> {
    let refused = || NoMethod(text.to_owned());
    let (name, setting) = text.split_once(':').unwrap_or((text, ""));
    let steps = || {
        let steps = NonZeroU32::from_str(setting).map_err(|_| refused())?;
        (steps.get() <= 1_000_000)
            .then_some(steps)
            .ok_or_else(refused)
    };
    Ok(match (name, setting) {
        ("exact", "") => Box::new(Exact),
        ("closed-form", "") => Box::new(ClosedForm),
        ("euler", _) => Box::new(Euler { steps: steps()? }),
        ("midpoint", _) => Box::new(Midpoint { steps: steps()? }),
        ("rk4", _) => Box::new(Rk4 {
            steps: steps()?,
            friction: Friction::Sign,
        }),
        ("rk4-tanh", _) => Box::new(Rk4 {
            steps: steps()?,
            friction: Friction::Tanh { width: TANH_WIDTH },
        }),
        ("dopri5", _) => {
            let tolerance = setting.parse().map_err(|_| refused())?;
            if !(1e-14..=0.1).contains(&tolerance) {
                return Err(refused());
            }
            Box::new(Dopri5 { tolerance })
        }
        _ => return Err(refused()),
    })
}

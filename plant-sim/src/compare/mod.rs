//! Speed against accuracy: every method of [`crate::methods`], and the exact map in the vector
//! [`kernel`], by the same measures; and what a tick of each law costs.
//!
//! - [`Trajectory`]: position after 1, 10, 100 and 1,000 samples and energy added by the method
//!   itself, both against arithmetic of 77 digits ([`crate::precise`]), of displays that keep moving;
//! - [`Plane`]: the classes of the (β, σ) plane, μ = 50, from 10 counts per sample, against the
//!   exact map's, and those, for a part of the cells, against 77 digits;
//! - [`times`]: nanoseconds per simulated sample, on one thread, interleaved;
//! - [`tick_times`]: nanoseconds per tick of a law on counters that it has met before;
//! - [`rungs`]: the plant in physical units with more and more of its phenomena, and with no more than
//!   the answer needs ([`crate::fidelity`]).
//!
//! Accuracy uses every core, times use one: measure them one after the other.

mod accuracy;
mod laws;
mod rungs;
mod speed;

use std::fmt;

use crate::display::Display;
use crate::hold::{Hold, State};
use crate::kernel::{self, InstructionSet};
use crate::methods::Method;

pub use accuracy::{ADDED_OVER, AFTER, Plane, Trajectory, wrong};
pub use laws::{Replay, tick_times};
pub use rungs::{RUNGS, Rung, rungs, scenes};
pub use speed::{CLASSES, Times, times};

/// The median of some values and their quartiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// A quarter of the values lie below.
    pub low: f64,
    /// Half of them do.
    pub median: f64,
    /// Three quarters do.
    pub high: f64,
}

impl Spread {
    /// Of values in any order; NaN, a result that is lost, counts as infinite. `None` of none.
    ///
    /// Between two values the quartiles are interpolated, which keeps an infinite one infinite.
    ///
    /// ```
    /// use plant_sim::compare::Spread;
    /// let spread = Spread::of([4.0, 1.0, 3.0, 2.0, 5.0]).unwrap();
    /// assert_eq!((spread.low, spread.median, spread.high), (2.0, 3.0, 4.0));
    /// ```
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let known = |value: f64| if value.is_nan() { f64::INFINITY } else { value };
        let mut sorted: Vec<f64> = values.into_iter().map(known).collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        let at = |quarters: usize| {
            let (place, rest) = (last * quarters / 4, last * quarters % 4);
            match rest {
                0 => sorted[place],
                _ => {
                    let share = rest as f64 / 4.0;
                    (1.0 - share) * sorted[place] + share * sorted[place + 1]
                }
            }
        };
        Some(Self {
            low: at(1),
            median: at(2),
            high: at(3),
        })
    }
}

/// What is compared.
pub enum Contestant {
    /// One display at a time.
    Scalar(Box<dyn Method>),
    /// The exact map, many displays at once, with an instruction set.
    Vector(InstructionSet),
}

impl Contestant {
    /// As a method, one display and one sample at a time.
    fn method(&self) -> &dyn Method {
        match self {
            Self::Scalar(method) => &**method,
            Self::Vector(set) => set,
        }
    }
}

impl fmt::Display for Contestant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.method().fmt(f)
    }
}

/// The vector kernel with one lane in use: its results are those of a lane in any company.
///
/// # Assumes
/// [`kernel::serves`] holds, and an interval of 1.
impl Method for InstructionSet {
    fn sample(&self, hold: &Hold, start: State, _force: f64) -> State {
        kernel::follow(*self, &[(Display::of(*hold), start)], 1)[0]
    }
}

impl fmt::Display for InstructionSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("exact-vector")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_interpolated_and_a_lost_result_is_infinitely_wrong() {
        assert_eq!(Spread::of([]), None);
        let spread = |values: &[f64]| {
            let Spread { low, median, high } = Spread::of(values.iter().copied()).unwrap();
            [low, median, high]
        };
        assert_eq!(spread(&[7.0]), [7.0; 3]);
        assert_eq!(spread(&[2.0, 1.0]), [1.25, 1.5, 1.75]);
        assert_eq!(spread(&[4.0, 3.0, 2.0, 1.0]), [1.75, 2.5, 3.25]);
        assert_eq!(
            spread(&[1.0, f64::NAN, 2.0, f64::NAN, 3.0]),
            [2.0, 3.0, f64::INFINITY]
        );
        assert_eq!(spread(&[1.0, f64::INFINITY]), [f64::INFINITY; 3]);
    }
}

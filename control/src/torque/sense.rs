//! Phase currents, from the codes of their converters.

use super::TorqueError;
use crate::error::positive;

/// Currents out of the bridge into the motor, A.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhaseCurrents {
    /// Of phase B.
    pub b_a: f32,
    /// Of phase C.
    pub c_a: f32,
}

/// The converters of two phases: current = (code − offset) · step. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurrentSense {
    step_a: f32,
    /// Of B and C, codes.
    offsets: [f32; 2],
}

impl CurrentSense {
    /// Of `step_a` (A) a code, and the mean codes of B and C while no current flows.
    ///
    /// ```
    /// use control::torque::sense::CurrentSense;
    /// let sense = CurrentSense::new(0.020_14, [2051.5, 2040.0])?;
    /// let currents = sense.currents([2151, 2040]);
    /// assert!((currents.b_a - 99.5 * 0.020_14).abs() < 1e-6 && currents.c_a == 0.0);
    /// # Ok::<(), control::torque::TorqueError>(())
    /// ```
    ///
    /// # Errors
    /// Refuses a step that is not finite and above 0, and offsets that are not finite.
    pub fn new(step_a: f64, offsets: [f64; 2]) -> Result<Self, TorqueError> {
        for value in offsets {
            if !(value as f32).is_finite() {
                let name = "current offset (codes)";
                return Err(TorqueError::NotFinite { name, value });
            }
        }
        Ok(Self {
            step_a: positive("current step (A)", step_a as f32)?,
            offsets: offsets.map(|offset| offset as f32),
        })
    }

    /// The currents of codes of B and C.
    #[must_use]
    #[inline]
    pub fn currents(&self, [b, c]: [u16; 2]) -> PhaseCurrents {
        PhaseCurrents {
            b_a: (f32::from(b) - self.offsets[0]) * self.step_a,
            c_a: (f32::from(c) - self.offsets[1]) * self.step_a,
        }
    }
}

//! A torque that undoes cogging.

use super::TorqueError;
use super::angle::{EncoderOnMotor, RotorAngle};
use crate::error::not_negative;
use crate::sine::sine_of_turns;

/// The torque +A sin(N x + φ) that makes up for a motor's cogging of −A sin(N x + φ), by the count.
/// Valid by construction.
///
/// ```
/// use control::torque::angle::EncoderOnMotor;
/// use control::torque::cogging::CoggingFeedForward;
/// let encoder = EncoderOnMotor { counts_per_rev: 4200, zero_turns: 0.0 };
/// // 42 periods in a turn, 100 counts each: the most after 25.
/// let cogging = CoggingFeedForward::new(2e-3, 42, &encoder)?;
/// assert!((cogging.torque_nm(25) - 2e-3).abs() < 1e-8);
/// assert!((cogging.torque_nm(-25) + 2e-3).abs() < 1e-8);
/// # Ok::<(), control::torque::TorqueError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoggingFeedForward {
    amplitude_nm: f32,
    angle: RotorAngle,
}

impl CoggingFeedForward {
    /// For A (Nm) and N; the encoder's `zero_turns` is φ, in turns, at the middle of count 0.
    ///
    /// # Errors
    /// Refuses an amplitude that is negative or not finite, and as [`RotorAngle::new`].
    pub fn new(
        amplitude_nm: f64,
        periods_per_rev: u32,
        encoder: &EncoderOnMotor,
    ) -> Result<Self, TorqueError> {
        Ok(Self {
            amplitude_nm: not_negative("cogging (Nm)", amplitude_nm as f32)?,
            angle: RotorAngle::new(encoder, periods_per_rev)?,
        })
    }

    /// The torque at a count, Nm.
    #[must_use]
    #[inline]
    pub fn torque_nm(&self, count: i32) -> f32 {
        self.amplitude_nm * sine_of_turns(self.angle.at(count).turns())
    }
}

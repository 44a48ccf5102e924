//! A hand that holds the knob.

use std::f64::consts::TAU;

use control::ConfigError;

use crate::drive::Halves;
use crate::knob::KnobError;

/// A hand that moves rigidly with the knob: its mass and damping add to the knob's, its
/// spring holds on to a place, and it pushes.
///
/// (m + M) ẍ + (b + B) ẋ + K_h (x − rest) + c sgn ẋ = F_motor + push + shake·sin(2πft),
///
/// t from the start of the run. The default is no hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Hand {
    /// M, kg m².
    pub inertia_kg_m2: f64,
    /// B, Nm s/rad.
    pub damping_nm_s_rad: f64,
    /// K_h, Nm/rad.
    pub stiffness_nm_rad: f64,
    /// Where the hand's spring is slack, rad.
    pub rest_rad: f64,
    /// A constant torque, Nm.
    pub push_nm: f64,
    /// Amplitude of a sinusoidal torque, Nm.
    pub shake_nm: f64,
    /// Its frequency f, Hz.
    pub shake_hz: f64,
}

impl Hand {
    /// Refuses what is not finite and negatives where none make sense.
    pub(crate) fn check(&self) -> Result<(), KnobError> {
        for (name, value) in [
            ("hand inertia (kg m²)", self.inertia_kg_m2),
            ("hand damping (Nm s/rad)", self.damping_nm_s_rad),
            ("hand stiffness (Nm/rad)", self.stiffness_nm_rad),
            ("hand shake frequency (Hz)", self.shake_hz),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(ConfigError::Negative { name, value }.into());
            }
        }
        for (name, value) in [
            ("hand rest angle (rad)", self.rest_rad),
            ("hand push (Nm)", self.push_nm),
            ("hand shake (Nm)", self.shake_nm),
        ] {
            if !value.is_finite() {
                return Err(KnobError::NotFinite { name, value });
            }
        }
        Ok(())
    }

    /// Whether it leaves the knob alone.
    pub(crate) fn is_absent(&self) -> bool {
        let Self {
            inertia_kg_m2,
            damping_nm_s_rad,
            stiffness_nm_rad,
            push_nm,
            ..
        } = *self;
        let alone = [inertia_kg_m2, damping_nm_s_rad, stiffness_nm_rad, push_nm]
            .iter()
            .all(|&value| value == 0.0);
        alone && !self.shakes()
    }

    /// The same hand, steady.
    pub(crate) fn without_shake(&self) -> Self {
        Self {
            shake_nm: 0.0,
            ..*self
        }
    }

    /// Whether its torque varies.
    pub(crate) fn shakes(&self) -> bool {
        self.shake_nm != 0.0 && self.shake_hz != 0.0
    }

    /// Push and shake at a phase of the shake (turns), Nm.
    pub(crate) fn torque(&self, phase: f64) -> f64 {
        if self.shakes() {
            self.push_nm + self.shake_nm * (TAU * phase).sin()
        } else {
            self.push_nm
        }
    }

    /// The torque over `length` seconds from `phase` on, in [`Halves`]. With θ = πf·length
    /// and φ the phase in the middle: mean A sin φ·sin θ/θ, lean 2A cos φ·(sin θ − θ cos θ)/θ².
    pub(crate) fn halves(&self, phase: f64, length: f64) -> Halves {
        /// Below this θ the lean's factor is θ/3 within 1e-17.
        const SMALL: f64 = 1e-8;
        if !self.shakes() {
            return Halves::even(self.push_nm);
        }
        let theta = 0.5 * TAU * self.shake_hz * length;
        let middle = TAU * phase + theta;
        let (mean, lean) = if theta < SMALL {
            (1.0, theta / 3.0)
        } else {
            let (sin, cos) = theta.sin_cos();
            (sin / theta, (sin - theta * cos) / theta / theta)
        };
        Halves {
            mean: self.push_nm + self.shake_nm * middle.sin() * mean,
            lean: 2.0 * self.shake_nm * middle.cos() * lean,
        }
    }
}

//! Coordinates of a three-phase quantity without a common part: Clarke's and Park's transforms.
//!
//! All keep amplitudes: a phase that swings by ±1 is a vector of length 1, and the power of
//! voltage and current is 3/2 of their product.

/// 1/√3.
const THIRD_ROOT: f32 = 0.577_350_26;

/// √3/2.
const HALF_ROOT_THREE: f32 = 0.866_025_4;

/// A quantity in the frame of the windings, α along phase A.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stationary {
    /// Along phase A.
    pub alpha: f32,
    /// A quarter of an electrical turn ahead of it.
    pub beta: f32,
}

/// A quantity in the frame of the rotor, d along its magnets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotating {
    /// Along the magnets' flux.
    pub d: f32,
    /// A quarter of an electrical turn ahead of it: what gives torque.
    pub q: f32,
}

/// Where the rotor's frame lies in that of the windings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    /// sin θ of the electrical angle θ.
    pub sine: f32,
    /// cos θ.
    pub cosine: f32,
}

impl Stationary {
    /// Clarke's transform of phases B and C, where A = −B − C:
    /// α = −(B + C), β = (B − C)/√3.
    #[must_use]
    #[inline]
    pub fn from_two_phases(b: f32, c: f32) -> Self {
        Self {
            alpha: -(b + c),
            beta: (b - c) * THIRD_ROOT,
        }
    }

    /// Clarke's transform turned round: A = α, B, C = −α/2 ± β√3/2.
    #[must_use]
    #[inline]
    pub fn phases(self) -> [f32; 3] {
        let (half, side) = (-0.5 * self.alpha, HALF_ROOT_THREE * self.beta);
        [self.alpha, half + side, half - side]
    }

    /// Park's transform: d = α cos θ + β sin θ, q = −α sin θ + β cos θ.
    ///
    /// ```
    /// use control::torque::frames::{Rotation, Stationary};
    /// // The rotor is a quarter turn ahead: what lies along phase A lags its q axis.
    /// let ahead = Rotation { sine: 1.0, cosine: 0.0 };
    /// let seen = Stationary { alpha: 2.0, beta: 0.0 }.seen_from(ahead);
    /// assert_eq!((seen.d, seen.q), (0.0, -2.0));
    /// ```
    #[must_use]
    #[inline]
    pub fn seen_from(self, rotor: Rotation) -> Rotating {
        Rotating {
            d: self.alpha * rotor.cosine + self.beta * rotor.sine,
            q: self.beta * rotor.cosine - self.alpha * rotor.sine,
        }
    }
}

impl Rotating {
    /// Park's transform turned round: α = d cos θ − q sin θ, β = d sin θ + q cos θ.
    #[must_use]
    #[inline]
    pub fn turned(self, rotor: Rotation) -> Stationary {
        Stationary {
            alpha: self.d * rotor.cosine - self.q * rotor.sine,
            beta: self.d * rotor.sine + self.q * rotor.cosine,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::torque::angle::Phase;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn clarke_and_its_inverse_undo_each_other(b in -40.0..40.0f32, c in -40.0..40.0f32) {
            let [a, again_b, again_c] = Stationary::from_two_phases(b, c).phases();
            prop_assert!((a + b + c).abs() < 1e-5);
            prop_assert!((again_b - b).abs() < 2e-5 && (again_c - c).abs() < 2e-5);
        }

        #[test]
        fn park_and_its_inverse_undo_each_other_and_keep_lengths(
            d in -40.0..40.0f32, q in -40.0..40.0f32, angle in any::<u32>(),
        ) {
            let rotor = Phase::from_bits(angle).rotation();
            let there = Rotating { d, q }.turned(rotor);
            let back = there.seen_from(rotor);
            prop_assert!((back.d - d).abs() < 4e-5 && (back.q - q).abs() < 4e-5);
            let (before, after) = (d.hypot(q), there.alpha.hypot(there.beta));
            prop_assert!((before - after).abs() < 4e-5);
        }

        /// Phase currents of I cos(θ − k·120°) lie on the d axis of a rotor at θ.
        #[test]
        fn three_cosines_are_a_vector_that_turns(turns in -0.5..0.5f64, amplitude in 0.1..40.0f64) {
            let phase = |k: f64| {
                let angle = core::f64::consts::TAU * (turns - k / 3.0);
                (amplitude * angle.cos()) as f32
            };
            let rotor = Phase::from_turns(turns).rotation();
            let seen = Stationary::from_two_phases(phase(1.0), phase(2.0)).seen_from(rotor);
            prop_assert!((f64::from(seen.d) - amplitude).abs() < 1e-6 * amplitude);
            prop_assert!(f64::from(seen.q).abs() < 1e-6 * amplitude);
        }
    }
}

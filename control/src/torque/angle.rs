//! The electrical angle, from the encoder's count.

use core::num::NonZeroU32;

use super::TorqueError;
use super::frames::Rotation;
use crate::sine::sine_and_cosine_of_turns;

/// 2³², of which a turn is made.
const TURN: f64 = 4_294_967_296.0;

/// 2⁻³².
const TURN_INVERSE: f32 = (1.0 / TURN) as f32;

/// The most counts in a turn of the shaft: rounding of one count's angle then adds up to less than
/// 1.3e-4 electrical turns over the turn.
pub const MOST_COUNTS_PER_REV: u32 = 1 << 20;

/// The most pole pairs.
pub const MOST_POLE_PAIRS: u32 = 1 << 10;

/// An angle in units of 2⁻³² turns: it wraps where the integer does, so that no angle is out of
/// range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Phase(u32);

impl Phase {
    /// So many 2⁻³² turns.
    #[must_use]
    pub fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// The nearest to so many turns, 0 if that is not a number.
    ///
    /// ```
    /// use control::torque::angle::Phase;
    /// assert_eq!(Phase::from_turns(-1.25), Phase::from_turns(0.75));
    /// ```
    #[must_use]
    pub fn from_turns(turns: f64) -> Self {
        // The part within ±1 turn, exactly; it then fits an i64 with room to spare.
        Self(((turns % 1.0) * TURN) as i64 as u32)
    }

    /// The angle, −½ to ½ turn, to 3e-8.
    #[must_use]
    #[inline]
    pub fn turns(self) -> f32 {
        self.0.cast_signed() as f32 * TURN_INVERSE
    }

    /// The same and so many turns more, of up to half a turn either way; beyond, half a turn.
    #[must_use]
    #[inline]
    pub fn advanced(self, turns: f32) -> Self {
        let bits = (turns * (TURN as f32)) as i32;
        Self(self.0.wrapping_add(bits.cast_unsigned()))
    }

    /// Its sine and cosine, to 4e-7.
    #[must_use]
    #[inline]
    pub fn rotation(self) -> Rotation {
        let (sine, cosine) = sine_and_cosine_of_turns(self.turns());
        Rotation { sine, cosine }
    }
}

/// How the encoder sits on the motor's shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderOnMotor {
    /// Counts in a turn of the shaft. They grow while the phases follow each other as A, B, C; a
    /// board whose counter falls then hands on the negative of it.
    pub counts_per_rev: u32,
    /// The electrical angle at the middle of count 0, turns.
    pub zero_turns: f64,
}

/// The electrical angle of any count: θ = p·(count mod counts per turn)/(counts per turn) + θ₀, to
/// half a unit of [`Phase`] per count from the turn's start. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotorAngle {
    counts_per_rev: NonZeroU32,
    per_count: u32,
    zero: Phase,
}

impl RotorAngle {
    /// # Errors
    /// Refuses less than 2 counts or more than [`MOST_COUNTS_PER_REV`], 0 pole pairs or more than
    /// [`MOST_POLE_PAIRS`], and an angle that is not finite.
    pub fn new(encoder: &EncoderOnMotor, pole_pairs: u32) -> Result<Self, TorqueError> {
        let counts = encoder.counts_per_rev;
        if !(1..=MOST_POLE_PAIRS).contains(&pole_pairs) {
            return Err(TorqueError::PolePairs(pole_pairs));
        }
        let counts_per_rev = NonZeroU32::new(counts)
            .filter(|_| (2..=MOST_COUNTS_PER_REV).contains(&counts))
            .ok_or(TorqueError::CountsPerRev(counts))?;
        if !encoder.zero_turns.is_finite() {
            return Err(TorqueError::NotFinite {
                name: "electrical angle at count 0 (turns)",
                value: encoder.zero_turns,
            });
        }
        Ok(Self {
            counts_per_rev,
            per_count: (f64::from(pole_pairs) / f64::from(counts) * TURN + 0.5) as u64 as u32,
            zero: Phase::from_turns(encoder.zero_turns),
        })
    }

    /// The angle at a count, however many turns away.
    #[must_use]
    #[inline]
    pub fn at(&self, count: i32) -> Phase {
        let per_rev = self.counts_per_rev;
        // −1 − c for a count c below 0 is its distance from −1: no negative is divided.
        let within = if count >= 0 {
            count.cast_unsigned() % per_rev
        } else {
            per_rev.get() - 1 - (!count).cast_unsigned() % per_rev
        };
        Phase(
            within
                .wrapping_mul(self.per_count)
                .wrapping_add(self.zero.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;
    use proptest::prelude::*;

    #[test]
    fn sine_and_cosine_err_by_less_than_one_in_a_million_over_the_circle() {
        let mut worst = 0.0_f64;
        for i in 0..(1_u64 << 20) {
            let bits = (i << 12 | (i * 2_654_435_761) & 0xFFF) as u32;
            let (sine, cosine) = (f64::from(bits) / TURN * TAU).sin_cos();
            let rotation = Phase(bits).rotation();
            worst = worst
                .max((f64::from(rotation.sine) - sine).abs())
                .max((f64::from(rotation.cosine) - cosine).abs());
        }
        assert!(worst < 4e-7, "{worst:e}");
    }

    proptest! {
        #[test]
        fn any_count_has_the_angle_of_the_shaft(
            count in any::<i32>(),
            counts_per_rev in 2..=65_536_u32,
            pole_pairs in 1..=50_u32,
            zero_turns in -3.0..3.0f64,
        ) {
            let encoder = EncoderOnMotor { counts_per_rev, zero_turns };
            let angle = RotorAngle::new(&encoder, pole_pairs).unwrap().at(count);
            let within = i64::from(count).rem_euclid(i64::from(counts_per_rev));
            let exact = f64::from(pole_pairs) * within as f64 / f64::from(counts_per_rev) + zero_turns;
            let error = (f64::from(angle.0) / TURN - exact + 0.5).rem_euclid(1.0) - 0.5;
            prop_assert!(error.abs() < 8e-6, "{error:e}");
        }

        #[test]
        fn advancing_adds_turns(bits in any::<u32>(), turns in -0.4999..0.4999f32) {
            let moved = Phase(bits).advanced(turns).0.wrapping_sub(bits).cast_signed();
            prop_assert!((f64::from(moved) / TURN - f64::from(turns)).abs() < 1e-9);
        }
    }

    #[test]
    fn no_encoder_is_accepted_that_has_no_angle() {
        let encoder = EncoderOnMotor {
            counts_per_rev: 8192,
            zero_turns: 0.0,
        };
        assert_eq!(RotorAngle::new(&encoder, 0), Err(TorqueError::PolePairs(0)));
        let none = EncoderOnMotor {
            counts_per_rev: 0,
            ..encoder
        };
        assert_eq!(RotorAngle::new(&none, 7), Err(TorqueError::CountsPerRev(0)));
        let lost = EncoderOnMotor {
            zero_turns: f64::NAN,
            ..encoder
        };
        assert!(RotorAngle::new(&lost, 7).is_err());
        assert_eq!(Phase::from_turns(f64::INFINITY), Phase(0));
    }
}

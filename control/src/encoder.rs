//! The encoder as the controller sees it: a hardware counter that wraps, divided
//! by an integer.
//!
//! A decimated count is n = ⌊x/Δ⌋ with Δ = (decimation) × (size of a hardware
//! count), floor and not truncation, so that the cell of every count has the same
//! width, also below zero. This is the coarse encoder that the paper's testbed
//! makes in software (Sec. V).

use core::num::NonZeroU32;

use crate::error::ConfigError;

/// How a hardware counter becomes counts. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EncoderConfig {
    /// 32 − (width of the hardware counter): shifting by it puts the counter's sign
    /// bit where an `i32` has its own.
    shift: u32,
    decimation: NonZeroU32,
}

impl EncoderConfig {
    /// A counter of `bits` bits (2 to 32) that wraps, decimated by `decimation`, 1 to 2³¹ − 1.
    ///
    /// # Errors
    /// Refuses any other width, and any other decimation.
    pub fn new(bits: u32, decimation: u32) -> Result<Self, ConfigError> {
        if !(2..=32).contains(&bits) {
            return Err(ConfigError::CounterBits(bits));
        }
        let decimation = NonZeroU32::new(decimation)
            .filter(|decimation| decimation.get() <= i32::MAX as u32)
            .ok_or(ConfigError::Decimation(decimation))?;
        Ok(Self {
            shift: 32 - bits,
            decimation,
        })
    }

    /// Hardware counts per count.
    #[must_use]
    pub fn decimation(self) -> u32 {
        self.decimation.get()
    }
}

impl Default for EncoderConfig {
    /// A counter of 32 bits, not decimated.
    fn default() -> Self {
        Self {
            shift: 0,
            decimation: NonZeroU32::MIN,
        }
    }
}

/// Follows a wrapping hardware counter and divides it, rounding down.
///
/// The count itself wraps after 2³² counts; whatever is measured from it is a
/// difference of two counts and does not notice.
///
/// ```
/// use control::encoder::{Encoder, EncoderConfig};
/// // A 16-bit counter, divided by 4, that starts at hardware count −1: cell −1, not 0.
/// let mut encoder = Encoder::new(EncoderConfig::new(16, 4)?, -1);
/// assert_eq!(encoder.count(), -1);
/// assert_eq!(encoder.update(0), 0);
/// assert_eq!(encoder.update(0xFFFB), -2); // −5 ⁄ 4 rounds down to −2
/// # Ok::<(), control::ConfigError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Encoder {
    config: EncoderConfig,
    raw: u32,
    count: i32,
    /// Hardware counts above the lower edge of the present cell, 0 ≤ residue < decimation.
    residue: u32,
}

impl Encoder {
    /// An encoder that stands at `hardware_count` hardware counts from zero now.
    #[must_use]
    pub fn new(config: EncoderConfig, hardware_count: i32) -> Self {
        let (count, residue) = divide_down(hardware_count, config.decimation);
        Self {
            config,
            raw: hardware_count as u32,
            count,
            residue,
        }
    }

    /// Takes the counter as it reads now (higher bits are ignored) and returns the
    /// decimated count. Right as long as the knob moves by less than half the
    /// counter's range between two updates.
    #[inline]
    pub fn update(&mut self, raw: u32) -> i32 {
        let shift = self.config.shift;
        let moved = (raw.wrapping_sub(self.raw) << shift) as i32 >> shift;
        self.raw = raw;
        let decimation = self.config.decimation;
        if decimation == NonZeroU32::MIN {
            self.count = self.count.wrapping_add(moved);
            return self.count;
        }
        // From the lower edge of the present cell. A move so far that this does not fit in
        // 31 bits is divided in two parts.
        let from_edge = match moved.checked_add(self.residue as i32) {
            Some(sum) => sum,
            None => {
                let (counts, residue) = divide_down(moved, decimation);
                self.count = self.count.wrapping_add(counts);
                let room = decimation.get() - self.residue;
                if residue < room {
                    self.residue += residue;
                    return self.count;
                }
                self.residue = residue - room;
                self.count = self.count.wrapping_add(1);
                return self.count;
            }
        };
        let (counts, residue) = divide_down(from_edge, decimation);
        self.residue = residue;
        self.count = self.count.wrapping_add(counts);
        self.count
    }

    /// Hardware counts from zero at the last update, wrapped to 32 bits.
    #[must_use]
    pub fn hardware_count(&self) -> i32 {
        self.count
            .wrapping_mul(self.config.decimation.get() as i32)
            .wrapping_add(self.residue as i32)
    }

    /// The decimated count at the last update.
    #[must_use]
    pub fn count(&self) -> i32 {
        self.count
    }
}

/// ⌊n/d⌋ and n − d⌊n/d⌋. For n < 0, ⌊n/d⌋ is the complement of the complement of n divided by d:
/// no branch, and nothing to overflow.
#[inline]
fn divide_down(n: i32, d: NonZeroU32) -> (i32, u32) {
    let sign = n >> 31;
    let size = (n ^ sign) as u32;
    let quotient = size / d;
    let rest = size - quotient * d.get();
    let sign_bits = sign as u32;
    (
        quotient as i32 ^ sign,
        (rest ^ sign_bits).wrapping_add(d.get() & sign_bits),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn counts_are_the_floor_of_the_hardware_position_divided(
            bits in 2u32..=32,
            decimation in prop_oneof![1u32..10, 1u32..5000, 1..=i32::MAX as u32],
            start in -1_000_000i32..1_000_000,
            moves in prop::collection::vec(any::<i32>(), 1..50),
        ) {
            let config = EncoderConfig::new(bits, decimation).unwrap();
            let mut encoder = Encoder::new(config, start);
            let mut position = i64::from(start);
            prop_assert_eq!(i64::from(encoder.count()), position.div_euclid(i64::from(decimation)));
            for wish in moves {
                // Any move that the counter can tell from its complement.
                let half = 1i64 << (bits - 1);
                position += i64::from(wish).rem_euclid(2 * half) - half;
                let count = encoder.update(position as u32);
                let expected = position.div_euclid(i64::from(decimation));
                prop_assert_eq!(count, expected as i32);
                prop_assert_eq!(encoder.hardware_count(), position as i32);
            }
        }
    }

    #[test]
    fn widths_and_decimations_that_do_not_exist_are_refused() {
        assert_eq!(EncoderConfig::new(1, 1), Err(ConfigError::CounterBits(1)));
        assert_eq!(EncoderConfig::new(33, 1), Err(ConfigError::CounterBits(33)));
        assert_eq!(EncoderConfig::new(16, 0), Err(ConfigError::Decimation(0)));
        let most = i32::MAX as u32;
        assert!(EncoderConfig::new(16, most).is_ok());
        assert!(EncoderConfig::new(16, most + 1).is_err());
    }
}

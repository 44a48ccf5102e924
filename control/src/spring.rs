//! The sampled, quantised spring (2), on both sides of its zero or on one.

use crate::error::{ConfigError, positive};

/// On which side of its zero the spring acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// A spring: both sides of its centre.
    Both,
    /// A wall: only above its edge.
    Above,
}

/// Where a spring is: what turns a count into a deflection. Its torque is −K·q (2), on
/// the free side of a wall 0; the stiffness K comes with every tick. Valid by construction.
///
/// The sensed deflection of count n is q = (n + ½)Δ − zero: the +½ of (2) makes the
/// force symmetric about a zero on a count edge and bounds the error of the position by Δ/2.
///
/// The zero is kept as a whole number of counts and a rest, so that no precision is
/// lost far from it: n − zero is an integer difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampledSpring {
    side: Side,
    count_rad: f32,
    zero_count: i32,
    /// Zero above the lower edge of cell `zero_count`, less the half count of (2), rad.
    offset_rad: f32,
}

/// Counts further from zero than this are refused for a centre or a wall.
const FURTHEST_COUNT: f64 = (1_u32 << 30) as f64;

impl SampledSpring {
    /// A spring about `zero_rad`, or a wall at it, sensed in counts of `count_rad` rad.
    ///
    /// # Errors
    /// Refuses a count size that is not above zero, and a zero that is not finite or
    /// lies more than 2³⁰ counts away.
    pub fn new(side: Side, zero_rad: f64, count_rad: f64) -> Result<Self, ConfigError> {
        let count_rad = positive("count size (rad)", count_rad)?;
        let counts = zero_rad / count_rad;
        if !(counts.is_finite() && -FURTHEST_COUNT < counts && counts < FURTHEST_COUNT) {
            return Err(ConfigError::OutOfCounts {
                name: "centre or wall",
                value: zero_rad,
                limit: FURTHEST_COUNT * count_rad,
            });
        }
        let mut zero_count = counts as i32; // towards zero; the floor is wanted
        if f64::from(zero_count) > counts {
            zero_count -= 1;
        }
        let offset_rad = zero_rad - (f64::from(zero_count) + 0.5) * count_rad;
        Ok(Self {
            side,
            count_rad: count_rad as f32,
            zero_count,
            offset_rad: offset_rad as f32,
        })
    }

    /// q of a count, rad.
    ///
    /// ```
    /// use control::spring::{SampledSpring, Side};
    /// let spring = SampledSpring::new(Side::Both, 0.0, 0.5)?;
    /// assert_eq!(spring.deflection_rad(0), 0.25); // Δ/2: the middle of the cell
    /// assert_eq!(spring.deflection_rad(-1), -0.25);
    /// # Ok::<(), control::ConfigError>(())
    /// ```
    #[must_use]
    pub fn deflection_rad(&self, count: i32) -> f32 {
        count.wrapping_sub(self.zero_count) as f32 * self.count_rad - self.offset_rad
    }

    /// On which side of its zero it acts.
    #[must_use]
    pub fn side(&self) -> Side {
        self.side
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn the_deflection_keeps_its_digits_for_a_zero_anywhere(
            zero in -1e3..1e3f64, count_rad in (-10.0..0.0f64).prop_map(f64::exp), near in -1000i32..1000,
        ) {
            let n = (zero / count_rad).floor() as i32 + near;
            let q = (f64::from(n) + 0.5) * count_rad - zero;
            // q loses no digit to the distance from zero, only to its own size.
            let tolerance = 2.0 * f64::from(f32::EPSILON) * (q.abs() + count_rad) + 1e-11;
            let spring = SampledSpring::new(Side::Both, zero, count_rad).unwrap();
            prop_assert!((f64::from(spring.deflection_rad(n)) - q).abs() <= tolerance);
        }

        #[test]
        fn a_spring_on_a_count_edge_is_symmetric(n in 0i32..1_000_000, edge in -1000i32..1000) {
            let count_rad = core::f64::consts::TAU / 8192.0;
            let spring = SampledSpring::new(Side::Both, f64::from(edge) * count_rad, count_rad).unwrap();
            let (above, below) = (spring.deflection_rad(edge + n), spring.deflection_rad(edge - 1 - n));
            prop_assert!((above + below).abs() <= 2.0 * f32::EPSILON * above.abs() + 1e-10);
        }
    }

    #[test]
    fn a_zero_that_counts_cannot_reach_is_refused() {
        for bad in [f64::NAN, f64::INFINITY, 1e30, -1e30] {
            assert!(SampledSpring::new(Side::Both, bad, 1e-3).is_err());
        }
        assert!(SampledSpring::new(Side::Both, 0.0, 0.0).is_err());
    }
}

//! What is rendered: a spring, a wall or a detent, as the controller senses it.
//!
//! The sensed deflection of count n is q = (n + ½)Δ − zero: the +½ of (2) makes the
//! torque symmetric about a zero on a count edge and bounds the error of the position by Δ/2.
//!
//! | shape | torque | slope |
//! |---|---|---|
//! | spring | −K·q (2) | K |
//! | wall | −K·q where q > 0, else 0 | K |
//! | detent of period p | −K·(p/2π)·sin(2πq/p) | at most K, at the minima |

use crate::error::{ConfigError, positive};
use crate::sine::sine_of_turns;

/// What is rendered, and where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Pulls to its centre from both sides.
    Spring {
        /// The centre, rad.
        centre_rad: f64,
    },
    /// Pushes back above its edge.
    Wall {
        /// The edge, rad.
        edge_rad: f64,
    },
    /// Pulls to the nearest of many minima, a period apart.
    Detent {
        /// One of the minima, rad.
        centre_rad: f64,
        /// From one minimum to the next, rad; two counts or more.
        period_rad: f64,
    },
}

impl Shape {
    /// The spring's centre, the wall's edge or a detent's minimum, rad.
    #[must_use]
    pub fn zero_rad(&self) -> f64 {
        match *self {
            Self::Spring { centre_rad } | Self::Detent { centre_rad, .. } => centre_rad,
            Self::Wall { edge_rad } => edge_rad,
        }
    }
}

/// What a profile says of a count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// The torque per stiffness, rad; 0 on the free side of a wall.
    pub pull_rad: f32,
    /// The deflection from the zero, of a detent from the nearest minimum, rad.
    pub deflection_rad: f32,
    /// On the free side of a wall.
    pub free: bool,
}

/// A shape that was checked, in the form that the tick uses: what turns a count into a
/// torque per stiffness. Valid by construction.
///
/// The zero is kept as a whole number of counts and a rest, and the phase of a detent as a
/// 64-bit fraction of its period that wraps, so that no precision is lost far from zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    kind: Kind,
    count_rad: f32,
    zero_count: i32,
    /// Zero above the lower edge of cell `zero_count`, less the half count of (2), rad.
    offset_rad: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Spring,
    Wall,
    Detent {
        /// A count, in 2⁻⁶⁴ periods.
        step: u64,
        /// The phase of cell `zero_count`, in 2⁻⁶⁴ periods.
        phase: u64,
        /// p/2³², rad.
        unit_rad: f32,
        /// p/2π, rad.
        amplitude_rad: f32,
    },
}

/// Counts further from zero than this are refused for a centre or a wall.
const FURTHEST_COUNT: f64 = (1_u32 << 30) as f64;

/// 2⁶⁴.
const TURN: f64 = (1_u64 << 32) as f64 * (1_u64 << 32) as f64;

/// 2⁻³²: a signed 32-bit phase in periods.
const PART: f32 = 1.0 / (1_u64 << 32) as f32;

impl Profile {
    /// A shape sensed in counts of `count_rad` rad.
    ///
    /// # Errors
    /// Refuses a count size that is not above zero, a zero that is not finite or lies more
    /// than 2³⁰ counts away, and a period of fewer than two counts or more than 2³⁰.
    pub fn new(shape: &Shape, count_rad: f64) -> Result<Self, ConfigError> {
        let count_rad = positive("count size (rad)", count_rad)?;
        let zero_rad = shape.zero_rad();
        let counts = zero_rad / count_rad;
        if !(-FURTHEST_COUNT < counts && counts < FURTHEST_COUNT) {
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
        let kind = match *shape {
            Shape::Spring { .. } => Kind::Spring,
            Shape::Wall { .. } => Kind::Wall,
            Shape::Detent { period_rad, .. } => {
                let counts = period_rad / count_rad;
                if !(2.0..=FURTHEST_COUNT).contains(&counts) {
                    return Err(ConfigError::Period {
                        value: period_rad,
                        least: 2.0 * count_rad,
                        most: FURTHEST_COUNT * count_rad,
                    });
                }
                Kind::Detent {
                    step: (TURN / counts) as u64,
                    phase: (-offset_rad / period_rad * TURN) as i64 as u64,
                    unit_rad: (period_rad / (1_u64 << 32) as f64) as f32,
                    amplitude_rad: (period_rad / core::f64::consts::TAU) as f32,
                }
            }
        };
        Ok(Self {
            kind,
            count_rad: count_rad as f32,
            zero_count,
            offset_rad: offset_rad as f32,
        })
    }

    /// What the shape says of a count.
    ///
    /// ```
    /// use control::shape::{Profile, Shape};
    /// let spring = Profile::new(&Shape::Spring { centre_rad: 0.0 }, 0.5)?;
    /// assert_eq!(spring.read(0).pull_rad, -0.25); // Δ/2: the middle of the cell
    /// assert_eq!(spring.read(-1).pull_rad, 0.25);
    /// let wall = Profile::new(&Shape::Wall { edge_rad: 0.0 }, 0.5)?;
    /// assert!(wall.read(-1).free && wall.read(-1).pull_rad == 0.0);
    /// # Ok::<(), control::ConfigError>(())
    /// ```
    #[must_use]
    #[inline(always)]
    pub fn read(&self, count: i32) -> Reading {
        let counts = count.wrapping_sub(self.zero_count);
        match self.kind {
            Kind::Spring => {
                let deflection_rad = counts as f32 * self.count_rad - self.offset_rad;
                Reading {
                    pull_rad: -deflection_rad,
                    deflection_rad,
                    free: false,
                }
            }
            Kind::Wall => {
                let deflection_rad = counts as f32 * self.count_rad - self.offset_rad;
                let free = deflection_rad <= 0.0;
                Reading {
                    pull_rad: if free { 0.0 } else { -deflection_rad },
                    deflection_rad,
                    free,
                }
            }
            Kind::Detent {
                step,
                phase,
                unit_rad,
                amplitude_rad,
            } => {
                let phase = (i64::from(counts) as u64)
                    .wrapping_mul(step)
                    .wrapping_add(phase);
                // The upper half, as a signed part of the period: within ±½.
                let part = (phase >> 32) as i32 as f32;
                Reading {
                    pull_rad: -amplitude_rad * sine_of_turns(part * PART),
                    deflection_rad: part * unit_rad,
                    free: false,
                }
            }
        }
    }

    /// The potential of a reading over stiffness, rad²: ½q², of a detent
    /// (p/2π)²·(1 − cos(2πq/p)) = 2(p/2π)²·sin²(πq/p).
    #[must_use]
    pub fn potential_rad2(&self, reading: &Reading) -> f32 {
        match self.kind {
            Kind::Spring | Kind::Wall => 0.5 * reading.pull_rad * reading.pull_rad,
            Kind::Detent {
                unit_rad,
                amplitude_rad,
                ..
            } => {
                let half_turns = 0.5 * (reading.deflection_rad / unit_rad) * PART;
                let height = amplitude_rad * sine_of_turns(half_turns);
                2.0 * height * height
            }
        }
    }

    /// The largest step of the torque from one count to the next, over stiffness, in counts:
    /// 1, but for a wall off a count edge the torque of its first cell where that is more
    /// than ½: twice max(ρ₁, ½), where ρ₁Δ is the first deflection above zero.
    #[must_use]
    pub fn step_counts(&self) -> f64 {
        if self.kind != Kind::Wall {
            return 1.0;
        }
        // Cell zero_count has the deflection −offset, within ±½ count; if that is not above
        // zero, the next one is the first.
        let share = -f64::from(self.offset_rad) / f64::from(self.count_rad);
        let first = if share > 0.0 { share } else { 1.0 + share };
        if first > 0.5 { 2.0 * first } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn spring(centre_rad: f64, count_rad: f64) -> Profile {
        Profile::new(&Shape::Spring { centre_rad }, count_rad).unwrap()
    }

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
            let reading = spring(zero, count_rad).read(n);
            prop_assert!((f64::from(reading.deflection_rad) - q).abs() <= tolerance);
            prop_assert_eq!(reading.pull_rad, -reading.deflection_rad);
        }

        #[test]
        fn a_spring_on_a_count_edge_is_symmetric(n in 0i32..1_000_000, edge in -1000i32..1000) {
            let count_rad = core::f64::consts::TAU / 8192.0;
            let spring = spring(f64::from(edge) * count_rad, count_rad);
            let (above, below) = (spring.read(edge + n).pull_rad, spring.read(edge - 1 - n).pull_rad);
            prop_assert!((above + below).abs() <= 2.0 * f32::EPSILON * above.abs() + 1e-10);
        }

        #[test]
        fn a_detent_is_the_sine_also_after_a_thousand_turns(
            centre_rad in -3.0..3.0f64, period_rad in 0.05..0.55f64, counts in 256.0..65_536.0f64,
            n in -60_000_000i32..60_000_000,
        ) {
            let count_rad = core::f64::consts::TAU / counts;
            prop_assume!(period_rad >= 2.0 * count_rad);
            let q = (f64::from(n) + 0.5) * count_rad - centre_rad;
            let turns = q / period_rad;
            let amplitude = period_rad / core::f64::consts::TAU;
            let profile = Profile::new(&Shape::Detent { centre_rad, period_rad }, count_rad).unwrap();
            let reading = profile.read(n);
            let want = -amplitude * (core::f64::consts::TAU * turns).sin();
            // f64 itself loses digits of q this far out: 1e-16 of q, in parts of the period.
            let lost = 4e-16 * turns.abs() * period_rad;
            prop_assert!((f64::from(reading.pull_rad) - want).abs() <= 1e-6 * amplitude + 7.0 * lost);
            let nearest = (turns - turns.round()) * period_rad;
            let off = (f64::from(reading.deflection_rad) - nearest).abs();
            prop_assert!(off.min(period_rad - off) <= 1e-6 * period_rad + lost);
            let potential = amplitude * amplitude * (1.0 - (core::f64::consts::TAU * turns).cos());
            prop_assert!((f64::from(profile.potential_rad2(&reading)) - potential).abs() <= 1e-5 * amplitude * amplitude);
        }

        #[test]
        fn the_first_step_of_a_wall_is_what_it_says(edge in -50.0..50.0f64) {
            let wall = Profile::new(&Shape::Wall { edge_rad: edge * 0.01 }, 0.01).unwrap();
            let first = (-60..60).map(|n| wall.read(n)).find(|reading| !reading.free).unwrap();
            let counts = f64::from(-first.pull_rad) / 0.01;
            prop_assert!((wall.step_counts() - 2.0 * counts.max(0.5)).abs() < 1e-4);
        }
    }

    #[test]
    fn a_zero_that_counts_cannot_reach_is_refused() {
        for bad in [f64::NAN, f64::INFINITY, 1e30, -1e30] {
            assert!(Profile::new(&Shape::Spring { centre_rad: bad }, 1e-3).is_err());
            assert!(Profile::new(&Shape::Wall { edge_rad: bad }, 1e-3).is_err());
            let detent = Shape::Detent {
                centre_rad: 0.0,
                period_rad: bad,
            };
            assert!(Profile::new(&detent, 1e-3).is_err());
        }
        assert!(Profile::new(&Shape::Spring { centre_rad: 0.0 }, 0.0).is_err());
        let fine = Shape::Detent {
            centre_rad: 0.0,
            period_rad: 1.9e-3,
        };
        assert_eq!(
            Profile::new(&fine, 1e-3).unwrap_err().to_string(),
            "detent period is 0.0019 rad; accepted: 0.002 to 1073741.824 rad, two counts to 2^30"
        );
    }
}

//! Where the knob can be and how fast, from the counts alone: intervals by set membership.
//!
//! *Velocity.* Over the last j ticks, a time W, the counts moved by N; so the mean velocity lies
//! in (N ∓ 1)·Δ/W. The velocity now is that mean plus the acceleration, each tick's weighted
//! with the share wᵢ of the window that has passed in its middle:
//!
//! v ∈ ⋂ over j = 1, 2, 4 … J of [ (N ∓ 1)·Δ/W + Σᵢ aᵢ·dtᵢ·wᵢ ], aᵢ ∈ hull{0, (F ± (c + b|v|))/m} ± a_hand.
//!
//! Every j is an implication, so the intersection is sound; those between the powers of two
//! add nothing that could be measured. The 0 in the hull covers
//! any inertia that a hand adds to the knob and nobody told; a_hand, what else a hand does.
//!
//! *Position.* x ∈ (x₋₁ + v·dt − ½·a·dt²) ∩ the cell of the count.
//!
//! *The hand.* Where an intersection is empty a hand has done more than a_hand: it grows,
//! and fades when nothing contradicts it any more.
//!
//! Assumed: inertia no less, friction no more than believed, and within a tick the
//! accelerations of the hull. Computed in `f32`; an interval that rounding empties counts as a
//! hand, which is the safe side.

use crate::plan::Mechanics;
use crate::tuning::{TICKS_BACK, Tuning};

/// Two ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// The lower.
    pub low: f32,
    /// The upper.
    pub high: f32,
}

impl Span {
    /// The middle.
    #[must_use]
    pub fn middle(&self) -> f32 {
        0.5 * (self.low + self.high)
    }

    /// What it has in common with another.
    #[inline(always)]
    fn narrow(&mut self, other: &Self) {
        if other.low > self.low {
            self.low = other.low;
        }
        if other.high < self.high {
            self.high = other.high;
        }
    }

    /// The width.
    #[must_use]
    pub fn width(&self) -> f32 {
        self.high - self.low
    }
}

/// The time from one tick to the next, as the counts tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Counts moved.
    pub counts: f32,
    /// Its length, s.
    pub duration_s: f32,
    /// 1 over its length, 1/s.
    pub rate: f32,
    /// The fastest mean speed that the counts allow, rad/s.
    pub fast: f32,
}

/// One or more ticks in a row, as the velocity interval needs them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Window {
    /// How far the counts moved, N·Δ, rad.
    moved_rad: f32,
    /// W, s.
    duration_s: f32,
    /// Σ aᵢ·dtᵢ: the change of velocity, rad/s.
    gained: Span,
    /// Σ aᵢ·dtᵢ·(time from the middle of tick i to the end), rad.
    late: Span,
}

impl Window {
    /// A tick that nobody saw: it may have changed the velocity by anything.
    const UNSEEN: Self = Self {
        moved_rad: 0.0,
        duration_s: 1.0,
        gained: UNKNOWN_VELOCITY,
        late: Span {
            low: 0.5 * UNKNOWN_VELOCITY.low,
            high: 0.5 * UNKNOWN_VELOCITY.high,
        },
    };

    /// This window and the one before it.
    #[inline(always)]
    fn after(&self, older: &Self) -> Self {
        Self {
            moved_rad: self.moved_rad + older.moved_rad,
            duration_s: self.duration_s + older.duration_s,
            gained: Span {
                low: self.gained.low + older.gained.low,
                high: self.gained.high + older.gained.high,
            },
            late: Span {
                low: self.late.low + older.late.low + older.gained.low * self.duration_s,
                high: self.late.high + older.late.high + older.gained.high * self.duration_s,
            },
        }
    }

    /// The velocity at its end; `rate` is 1/W.
    #[inline(always)]
    fn velocity(&self, rate: f32, count_rad: f32) -> Span {
        Span {
            low: self.gained.low + (self.moved_rad - count_rad - self.late.low) * rate,
            high: self.gained.high + (self.moved_rad + count_rad - self.late.high) * rate,
        }
    }
}

/// Faster than any knob, rad/s; its square is finite.
pub(crate) const UNKNOWN_VELOCITY: Span = Span {
    low: -1e9,
    high: 1e9,
};

/// What the counts say of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Ticks entered, wrapping.
    ticks: usize,
    /// The last tick; then windows of two and four ticks, each as it ended two and four ticks ago
    /// or less, in a ring. Two of a length that follow each other make the next longer one.
    one: Window,
    two: [Window; 2],
    four: [Window; 4],
    /// a_hand, rad/s².
    hand_rad_s2: f32,
    /// The position relative to the middle of the count's cell, rad.
    position: Span,
    /// The velocity, rad/s.
    velocity: Span,
    /// The counts contradicted what was believed of the hand.
    contradicted: bool,
}

impl Motion {
    /// Nothing is known but the cell.
    #[must_use]
    pub fn unknown(mechanics: &Mechanics) -> Self {
        let half = mechanics.half_count_rad;
        Self {
            ticks: 0,
            one: Window::UNSEEN,
            two: [Window::UNSEEN; 2],
            four: [Window::UNSEEN; 4],
            hand_rad_s2: 0.0,
            position: Span {
                low: -half,
                high: half,
            },
            velocity: UNKNOWN_VELOCITY,
            contradicted: false,
        }
    }

    /// It is known to be at rest.
    pub fn rest(&mut self) {
        self.velocity = Span {
            low: 0.0,
            high: 0.0,
        };
    }

    /// The position relative to the middle of the count's cell, rad.
    #[must_use]
    pub fn position(&self) -> Span {
        self.position
    }

    /// The velocity, rad/s.
    #[must_use]
    pub fn velocity(&self) -> Span {
        self.velocity
    }

    /// a_hand, rad/s².
    #[must_use]
    pub fn hand_rad_s2(&self) -> f32 {
        self.hand_rad_s2
    }

    /// The last tick contradicted what was believed of the hand.
    #[must_use]
    pub fn contradicted(&self) -> bool {
        self.contradicted
    }

    /// The intervals after one of time, under torques within `torque`, at most
    /// `strongest` in magnitude, Nm. Returns the acceleration in it, rad/s².
    #[inline(always)]
    pub fn follow(
        &mut self,
        mechanics: &Mechanics,
        tuning: &Tuning,
        interval: &Interval,
        torque: Span,
        strongest: f32,
    ) -> Span {
        let duration_s = interval.duration_s;
        // The most that friction can be: at the mean speed, and what the torque can add to it.
        let speed =
            interval.fast + (strongest + mechanics.coulomb_high) * duration_s * mechanics.mobility;
        let friction = mechanics.coulomb_high + mechanics.viscous_high * speed;
        let slowing = (torque.low - friction) * mechanics.mobility;
        let speeding = (torque.high + friction) * mechanics.mobility;
        let acceleration = Span {
            low: if slowing < 0.0 { slowing } else { 0.0 } - self.hand_rad_s2,
            high: if speeding > 0.0 { speeding } else { 0.0 } + self.hand_rad_s2,
        };
        let gained = Span {
            low: acceleration.low * duration_s,
            high: acceleration.high * duration_s,
        };
        let half_s = 0.5 * duration_s;
        let newest = Window {
            moved_rad: interval.counts * mechanics.count_rad,
            duration_s,
            gained,
            late: Span {
                low: gained.low * half_s,
                high: gained.high * half_s,
            },
        };
        let hand = self.hand_rad_s2;
        self.hand_rad_s2 = tuning.hand_decay * hand;
        self.contradicted = false;
        let gap = self.find_velocity(&newest, interval.rate, mechanics.count_rad, tuning);
        if gap > 0.0 && tuning.hand {
            self.raise_hand(
                tuning.hand_growth * hand,
                2.0 * gap * interval.rate,
                mechanics,
            );
        }
        let half = mechanics.half_count_rad;
        let dt = newest.duration_s;
        let shift = newest.moved_rad;
        let mut low =
            self.position.low - shift + (self.velocity.low - 0.5 * newest.gained.high) * dt;
        let mut high =
            self.position.high - shift + (self.velocity.high - 0.5 * newest.gained.low) * dt;
        if low < -half {
            low = -half;
        }
        if high > half {
            high = half;
        }
        if low > high {
            low = -half;
            high = half;
            if tuning.hand {
                self.raise_hand(tuning.hand_growth * hand, 0.0, mechanics);
            }
        }
        if !tuning.position {
            low = -half;
            high = half;
        }
        self.position = Span { low, high };
        acceleration
    }

    /// a_hand = the largest of itself, `grown`, `seen` and c/2m.
    #[cold]
    #[inline(never)]
    fn raise_hand(&mut self, grown: f32, seen: f32, mechanics: &Mechanics) {
        let least = 0.5 * mechanics.coulomb_high * mechanics.mobility;
        let mut hand = self.hand_rad_s2;
        for other in [grown, seen, least] {
            if other > hand {
                hand = other;
            }
        }
        self.hand_rad_s2 = hand;
        self.contradicted = true;
    }

    /// Takes the last tick into the windows and sets the velocity interval; returns by how much it
    /// would be empty, rad/s.
    #[inline(always)]
    fn find_velocity(&mut self, one: &Window, rate: f32, count_rad: f32, tuning: &Tuning) -> f32 {
        let last_tick = one.velocity(rate, count_rad);
        let mut all = last_tick;
        let ticks = self.ticks.wrapping_add(1);
        self.ticks = ticks;

        let two = one.after(&self.one);
        self.one = *one;
        if tuning.ticks_back >= 2 {
            all.narrow(&two.velocity(1.0 / two.duration_s, count_rad));
        }
        let earlier = &mut self.two[ticks % 2];
        let four = two.after(earlier);
        *earlier = two;
        if tuning.ticks_back >= 4 {
            all.narrow(&four.velocity(1.0 / four.duration_s, count_rad));
        }
        if TICKS_BACK >= 8 {
            let earlier = &mut self.four[ticks % 4];
            let eight = four.after(earlier);
            *earlier = four;
            if tuning.ticks_back >= 8 {
                all.narrow(&eight.velocity(1.0 / eight.duration_s, count_rad));
            }
        }
        let gap = all.low - all.high;
        self.velocity = if gap > 0.0 { last_tick } else { all };
        gap
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RE35: Mechanics = Mechanics {
        count_rad: 7.67e-4,
        half_count_rad: 3.835e-4,
        mobility: 1.0 / 6.28e-6,
        viscous_high: 1.05 * 9e-6,
        coulomb_low: 2e-3,
        coulomb_high: 2e-3,
    };

    /// A tick as the module's equations want it.
    struct Known {
        counts: f64,
        duration_s: f64,
        slowest: f64,
        fastest: f64,
    }

    /// The interval over the last ticks, newest first, summed as it stands in the module.
    fn over(known: &[Known]) -> (f64, f64) {
        let window: f64 = known.iter().map(|tick| tick.duration_s).sum();
        let counts: f64 = known.iter().map(|tick| tick.counts).sum();
        let (mut low, mut high) = ((counts - 1.0), (counts + 1.0));
        (low, high) = (
            low * f64::from(RE35.count_rad) / window,
            high * f64::from(RE35.count_rad) / window,
        );
        let mut since = 0.0;
        for tick in known {
            let share = (window - since - 0.5 * tick.duration_s) / window;
            since += tick.duration_s;
            low += tick.slowest * tick.duration_s * share;
            high += tick.fastest * tick.duration_s * share;
        }
        (low, high)
    }

    proptest! {
        #[test]
        fn the_velocity_is_the_intersection_of_the_windows(
            ticks in prop::collection::vec((-3i32..4, 0.5e-3..2e-3f64, -5e-3..5e-3f64), 8..40),
        ) {
            let mut motion = Motion::unknown(&RE35);
            let mut known: Vec<Known> = Vec::new();
            for (counts, duration_s, torque) in ticks {
                let hand = f64::from(motion.hand_rad_s2());
                let duration = duration_s as f32;
                let rate = 1.0 / duration;
                let interval = Interval {
                    counts: counts as f32,
                    duration_s: duration,
                    rate,
                    fast: (counts.abs() + 1) as f32 * RE35.count_rad * rate,
                };
                let held = torque as f32;
                let span = Span { low: held, high: held };
                motion.follow(&RE35, &Tuning::DEFAULT, &interval, span, held.abs());
                let (c, mobility) = (f64::from(RE35.coulomb_high), f64::from(RE35.mobility));
                let speed = f64::from(interval.fast) + (torque.abs() + c) * duration_s * mobility;
                let friction = c + f64::from(RE35.viscous_high) * speed;
                known.insert(0, Known {
                    counts: f64::from(counts),
                    duration_s,
                    slowest: (mobility * (torque - friction)).min(0.0) - hand,
                    fastest: (mobility * (torque + friction)).max(0.0) + hand,
                });
                let newest = over(&known[..1]);
                let (mut low, mut high) = newest;
                for length in [2, 4, TICKS_BACK] {
                    if let Some(known) = known.get(..length) {
                        let window = over(known);
                        (low, high) = (low.max(window.0), high.min(window.1));
                    }
                }
                let scale = 1e-5 * (low.abs() + high.abs() + 10.0);
                if (low - high).abs() < scale {
                    continue; // empty or not: rounding decides
                }
                let empty = low > high;
                let (low, high) = if empty { newest } else { (low, high) };
                let have = motion.velocity();
                prop_assert!((f64::from(have.low) - low).abs() < scale, "{have:?}, not {low}");
                prop_assert!((f64::from(have.high) - high).abs() < scale, "{have:?}, not {high}");
                // Contradicted, it allows a hand for more; else that fades.
                prop_assert!(!empty || motion.contradicted());
                let grown = f64::from(motion.hand_rad_s2()) > hand;
                prop_assert_eq!(grown, motion.contradicted());
                let position = motion.position();
                prop_assert!(position.low <= position.high);
                prop_assert!(position.high.abs().max(position.low.abs()) <= RE35.half_count_rad);
            }
        }
    }

    #[test]
    fn where_nobody_has_looked_it_may_be_anywhere_and_as_fast_as_you_like() {
        let motion = Motion::unknown(&RE35);
        assert_eq!(motion.position().width(), RE35.count_rad);
        assert!(motion.velocity().width() > 1e8);
        let mut resting = motion;
        resting.rest();
        assert_eq!(resting.velocity().width(), 0.0);
    }
}

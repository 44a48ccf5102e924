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

    /// The width.
    #[must_use]
    pub fn width(&self) -> f32 {
        self.high - self.low
    }
}

/// One tick of the past.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Past {
    /// How far the counts moved, rad.
    moved_rad: f32,
    /// Its length, s.
    duration_s: f32,
    /// The change of velocity in it, rad/s.
    gained: Span,
}

/// A tick that nobody saw: it may have changed the velocity by anything.
const UNSEEN: Past = Past {
    moved_rad: 0.0,
    duration_s: 1.0,
    gained: UNKNOWN_VELOCITY,
};

/// Faster than any knob, rad/s; its square is finite.
pub(crate) const UNKNOWN_VELOCITY: Span = Span {
    low: -1e9,
    high: 1e9,
};

/// What the counts say of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// A ring, written twice over, so that the last ticks always lie in a row.
    past: [Past; 2 * TICKS_BACK],
    /// Where the last tick lies in its first half.
    last: usize,
    /// a_hand, rad/s².
    hand_rad_s2: f32,
    /// The position relative to the middle of the count's cell, rad.
    position: Span,
    /// The velocity, rad/s.
    velocity: Span,
    /// The acceleration in the last tick, rad/s².
    acceleration: Span,
    /// The counts contradicted what was believed of the hand.
    contradicted: bool,
}

impl Motion {
    /// Nothing is known but the cell.
    #[must_use]
    pub fn unknown(mechanics: &Mechanics) -> Self {
        let half = mechanics.half_count_rad;
        Self {
            past: [UNSEEN; 2 * TICKS_BACK],
            last: 0,
            hand_rad_s2: 0.0,
            position: Span {
                low: -half,
                high: half,
            },
            velocity: UNKNOWN_VELOCITY,
            acceleration: Span {
                low: 0.0,
                high: 0.0,
            },
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

    /// The acceleration in the last tick, rad/s².
    #[must_use]
    pub fn acceleration(&self) -> Span {
        self.acceleration
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

    /// The whole cell: all that is known where nobody followed.
    pub fn forget_position(&mut self, mechanics: &Mechanics) {
        self.position = Span {
            low: -mechanics.half_count_rad,
            high: mechanics.half_count_rad,
        };
    }

    /// Enters a tick of `duration_s` in which the counts moved by `moved` under torques within
    /// `torque`, Nm.
    #[inline]
    pub fn enter(&mut self, mechanics: &Mechanics, moved: f32, duration_s: f32, torque: Span) {
        let strongest = if -torque.low > torque.high {
            -torque.low
        } else {
            torque.high
        };
        // The most that friction can be: at the mean speed, and what the torque can add to it.
        let speed = (moved.abs() + 1.0) * mechanics.count_rad / duration_s
            + (strongest + mechanics.coulomb_high) * duration_s * mechanics.mobility;
        let friction = mechanics.coulomb_high + 1.05 * mechanics.viscous_high * speed;
        let slowing = (torque.low - friction) * mechanics.mobility;
        let speeding = (torque.high + friction) * mechanics.mobility;
        self.acceleration = Span {
            low: if slowing < 0.0 { slowing } else { 0.0 } - self.hand_rad_s2,
            high: if speeding > 0.0 { speeding } else { 0.0 } + self.hand_rad_s2,
        };
        let past = Past {
            moved_rad: moved * mechanics.count_rad,
            duration_s,
            gained: Span {
                low: self.acceleration.low * duration_s,
                high: self.acceleration.high * duration_s,
            },
        };
        self.last = (self.last + 1) % TICKS_BACK;
        self.past[self.last] = past;
        self.past[self.last + TICKS_BACK] = past;
    }

    /// The intervals after the tick entered last.
    #[inline]
    pub fn follow(&mut self, mechanics: &Mechanics, tuning: &Tuning) {
        let hand = self.hand_rad_s2;
        self.hand_rad_s2 = tuning.hand_decay * hand;
        self.contradicted = false;
        let newest = self.past[self.last % TICKS_BACK];
        let gap = self.find_velocity(mechanics, tuning);
        if gap > 0.0 && tuning.hand {
            self.raise_hand(
                tuning.hand_growth * hand,
                2.0 * gap / newest.duration_s,
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
    }

    /// a_hand = the largest of itself, `grown`, `seen` and c/2m.
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

    /// Sets the velocity interval; returns by how much it would be empty, rad/s.
    #[inline]
    fn find_velocity(&mut self, mechanics: &Mechanics, tuning: &Tuning) -> f32 {
        let newest = self.last % TICKS_BACK + TICKS_BACK;
        let mut window_s = 0.0;
        let mut gained = Span {
            low: 0.0,
            high: 0.0,
        };
        // N·Δ ∓ Δ − Σ aᵢ·dtᵢ·(time from the middle of tick i to now).
        let mut way = Span {
            low: -mechanics.count_rad,
            high: mechanics.count_rad,
        };
        let mut all = UNKNOWN_VELOCITY;
        let mut last_tick = UNKNOWN_VELOCITY;
        for j in 0..TICKS_BACK {
            let past = &self.past[newest - j];
            let age = window_s + 0.5 * past.duration_s;
            window_s += past.duration_s;
            gained.low += past.gained.low;
            gained.high += past.gained.high;
            way.low += past.moved_rad - past.gained.low * age;
            way.high += past.moved_rad - past.gained.high * age;
            if !(j + 1).is_power_of_two() || j >= tuning.ticks_back {
                continue;
            }
            let rate = 1.0 / window_s;
            let span = Span {
                low: gained.low + way.low * rate,
                high: gained.high + way.high * rate,
            };
            if j == 0 {
                last_tick = span;
                all = span;
                continue;
            }
            if span.low > all.low {
                all.low = span.low;
            }
            if span.high < all.high {
                all.high = span.high;
            }
        }
        let gap = all.low - all.high;
        self.velocity = if gap > 0.0 { last_tick } else { all };
        gap
    }
}

//! A push: a torque without a spring, and the coast after it, played tick by tick.
//!
//! What identification is made of: a torque rises evenly, is held, ends for good as soon as one of its limits is
//! reached, and then the knob is watched until it rests. The firmware plays it on the device, and the plant's side plays
//! the same on a simulated knob.

/// What is to be played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Torque of the first tick, Nm.
    pub from_nm: f32,
    /// Torque of tick `rise_ticks` and after, Nm.
    pub to_nm: f32,
    /// In so many ticks it rises from the one to the other; 0 for a step.
    pub rise_ticks: u32,
    /// The torque ends after so many ticks.
    pub most_ticks: u32,
    /// It ends when the count is so far from where it was in the first tick, either way.
    pub way_counts: u32,
    /// It ends when a tick found the count moved by so many, either way.
    pub speed_counts: u32,
    /// With the torque off, the push is over when so many ticks in a row found the count where it was,
    pub rest_ticks: u32,
    /// or after so many ticks, at rest or not.
    pub coast_ticks: u32,
    /// Further from where it was in the first tick than this, either way, it must not go, counts.
    pub guard_counts: u32,
}

impl Push {
    /// The torque of this tick, counted from 0, as long as no limit is reached, Nm:
    /// F₀ + (F₁ − F₀)·k/N. Between F₀ and F₁ to the last bit.
    #[must_use]
    pub fn torque_nm(&self, tick: u32) -> f32 {
        if tick >= self.rise_ticks {
            return self.to_nm;
        }
        // Above 0: there is a tick below it.
        let share = tick as f32 / self.rise_ticks as f32;
        let torque_nm = self.from_nm + (self.to_nm - self.from_nm) * share;
        // Rounding must not lead past the end.
        let past = if self.from_nm < self.to_nm {
            torque_nm > self.to_nm
        } else {
            torque_nm < self.to_nm
        };
        if past { self.to_nm } else { torque_nm }
    }
}

/// What a tick of a push does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// It gives this torque, Nm.
    Torque(f32),
    /// It gives none; the knob is watched.
    Coast,
    /// It gives none, and was the last: the knob rests.
    Rest,
    /// It gives none, and was the last, though the knob has not come to rest.
    InMotion,
    /// It gives none, and was the last: the knob is further than [`Push::guard_counts`].
    Beyond,
}

/// A push under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pushing {
    push: Push,
    /// Ticks that were played.
    ticks: u32,
    /// The first tick without torque.
    released: Option<u32>,
    /// Where the count is, from where it was in the first tick.
    way: i32,
    /// Ticks in a row without torque that found the count where it was.
    still: u32,
}

impl Pushing {
    /// Before its first tick.
    #[must_use]
    pub fn new(push: Push) -> Self {
        Self {
            push,
            ticks: 0,
            released: None,
            way: 0,
            still: 0,
        }
    }

    /// The number of the first tick without torque, where there was one.
    #[must_use]
    pub fn released(&self) -> Option<u32> {
        self.released
    }

    /// The next tick, which found the count moved by so many since the tick before.
    pub fn tick(&mut self, moved: i32) -> Step {
        let tick = self.ticks;
        self.ticks = tick.wrapping_add(1);
        // What it moved before the first tick is not the push's doing.
        if tick > 0 {
            self.way = self.way.wrapping_add(moved);
        }
        let (way, push) = (self.way.unsigned_abs(), &self.push);
        if way > push.guard_counts {
            self.released.get_or_insert(tick);
            return Step::Beyond;
        }
        let Some(released) = self.released else {
            let over = tick >= push.most_ticks
                || way >= push.way_counts
                || moved.unsigned_abs() >= push.speed_counts;
            if over {
                self.released = Some(tick);
                return Step::Coast;
            }
            return Step::Torque(push.torque_nm(tick));
        };
        self.still = if moved == 0 { self.still + 1 } else { 0 };
        if self.still >= push.rest_ticks {
            Step::Rest
        } else if tick.wrapping_sub(released) >= push.coast_ticks {
            Step::InMotion
        } else {
            Step::Coast
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PUSH: Push = Push {
        from_nm: 0.25,
        to_nm: 0.5,
        rise_ticks: 4,
        most_ticks: 6,
        way_counts: 1000,
        speed_counts: 100,
        rest_ticks: 3,
        coast_ticks: 10,
        guard_counts: 2000,
    };

    fn play(push: Push, moves: &[i32]) -> (Vec<Step>, Option<u32>) {
        let mut pushing = Pushing::new(push);
        let mut steps = Vec::new();
        for moved in moves {
            steps.push(pushing.tick(*moved));
            if !matches!(steps.last(), Some(Step::Torque(_) | Step::Coast)) {
                break;
            }
        }
        (steps, pushing.released())
    }

    #[test]
    fn it_rises_is_held_is_released_and_ends_at_rest() {
        use Step::{Coast, Rest, Torque};
        let (steps, released) = play(PUSH, &[0, 0, 1, 1, 2, 2, 2, 1, 0, 1, 0, 0, 0]);
        let torques = [0.25, 0.3125, 0.375, 0.4375, 0.5, 0.5].map(Torque);
        let coast = [Coast, Coast, Coast, Coast, Coast, Coast, Rest];
        assert_eq!(steps, [&torques[..], &coast].concat());
        assert_eq!(released, Some(6));
    }

    #[test]
    fn each_limit_ends_the_torque_in_the_tick_that_finds_it() {
        let far = Push {
            way_counts: 5,
            ..PUSH
        };
        // The first move was before the push.
        assert_eq!(play(far, &[50, 4, 1, 0]).1, Some(2));
        assert_eq!(play(far, &[50, -4, 0, -1]).1, Some(3));
        let fast = Push {
            speed_counts: 5,
            ..PUSH
        };
        assert_eq!(play(fast, &[0, 4, -5]).1, Some(2));
        let none = Push {
            most_ticks: 0,
            ..PUSH
        };
        assert_eq!(play(none, &[0, 0, 0, 0]).1, Some(0));
        let restless = [0; 6].iter().chain(&[1; 20]).copied();
        let (steps, _) = play(PUSH, &restless.collect::<Vec<_>>());
        assert_eq!((steps.len(), steps.last()), (17, Some(&Step::InMotion)));
        let guarded = Push {
            guard_counts: 6,
            ..PUSH
        };
        let (steps, released) = play(guarded, &[9, 3, 3, 1, 0]);
        assert_eq!((steps.last(), released), (Some(&Step::Beyond), Some(3)));
    }

    proptest! {
        #[test]
        fn a_rising_torque_never_leaves_its_ends_and_reaches_them(
            from_nm in -1.0..1.0_f32, to_nm in -1.0..1.0_f32, rise_ticks in prop_oneof![0..50_u32, any::<u32>()], share in 0.0..1.0,
        ) {
            let push = Push { from_nm, to_nm, rise_ticks, ..PUSH };
            let (low, high) = (from_nm.min(to_nm), from_nm.max(to_nm));
            for tick in [0, (share * f64::from(rise_ticks)) as u32, rise_ticks.saturating_sub(1), rise_ticks, u32::MAX] {
                let torque_nm = push.torque_nm(tick);
                prop_assert!((low..=high).contains(&torque_nm), "{tick}: {torque_nm}");
            }
            prop_assert_eq!(push.torque_nm(rise_ticks), to_nm);
            if rise_ticks > 0 {
                prop_assert_eq!(push.torque_nm(0), from_nm);
            }
        }
    }
}

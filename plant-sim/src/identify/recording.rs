//! What was commanded and what the encoder said, and where in it the knob was at rest.

use std::ops::Range;

use super::refusal::Refusal;

/// What one tick read and decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// The encoder's count at the tick.
    pub count: i32,
    /// The torque held from this tick to the next, Nm, as commanded.
    pub torque_nm: f64,
}

/// Samples of every tick of a knob, evenly spaced in time.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// From one tick to the next, s.
    pub period_s: f64,
    /// Δ, the size of the counts that are recorded, rad.
    pub count_rad: f64,
    /// One for every tick.
    pub samples: Vec<Sample>,
}

/// Counts and torque have to stand still so long for the knob to be at rest, s. A knob that
/// does not leave its count within that time stands if c/m ≥ 2Δ/(0.1 s)²: 0.3 rad/s² at 4096 counts
/// in a turn.
pub const REST_S: f64 = 0.1;

/// A motion of fewer counts tells nothing.
const LEAST_COUNTS: i32 = 20;

/// Steps of torque count as different in height from this ratio on.
const LEAST_RATIO: f64 = 1.2;

/// A torque below this share of the largest is none.
const NO_TORQUE: f64 = 1e-6;

/// From one rest to the next: the first sample is at rest, and the last ones are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Push {
    /// Which samples of the recording.
    pub range: Range<usize>,
    /// Counts from the first of them on.
    pub counts: Vec<f64>,
    /// Torques, Nm.
    pub torques: Vec<f64>,
}

impl Push {
    /// The furthest from the start, counts, with its sign.
    pub fn furthest(&self) -> f64 {
        let further = |far: f64, &count: &f64| if count.abs() > far.abs() { count } else { far };
        self.counts.iter().fold(0.0, further)
    }

    /// Whether it goes far enough to tell something.
    pub fn moves(&self) -> bool {
        self.furthest().abs() >= f64::from(LEAST_COUNTS)
    }

    /// The largest torque, Nm, with its sign.
    pub fn height_nm(&self) -> f64 {
        let higher = |high: f64, &torque: &f64| {
            if torque.abs() > high.abs() {
                torque
            } else {
                high
            }
        };
        self.torques.iter().fold(0.0, higher)
    }

    /// Counts travelled without torque after the last torque, with their sign.
    fn coasted(&self) -> f64 {
        let last = self.torques.iter().rposition(|&torque| torque != 0.0);
        let from = last.map_or(0, |last| last + 1);
        match (self.counts.get(from), self.counts.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        }
    }
}

impl Recording {
    /// How long it is, s.
    #[must_use]
    pub fn length_s(&self) -> f64 {
        self.samples.len() as f64 * self.period_s
    }

    fn largest_torque_nm(&self) -> f64 {
        let torques = self.samples.iter().map(|sample| sample.torque_nm.abs());
        torques.fold(0.0, f64::max)
    }

    /// Samples in a rest of [`REST_S`].
    fn rest_samples(&self) -> usize {
        ((REST_S / self.period_s).ceil() as usize).max(10)
    }

    /// Numbers that make sense.
    fn check(&self) -> Result<(), Refusal> {
        for (name, value) in [
            ("sample period (s)", self.period_s),
            ("count size (rad)", self.count_rad),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Refusal::NotPositive { name, value });
            }
        }
        for (row, sample) in self.samples.iter().enumerate() {
            if !sample.torque_nm.is_finite() {
                let value = sample.torque_nm;
                return Err(Refusal::NotFinite { row, value });
            }
        }
        let least = 4 * self.rest_samples();
        if self.samples.len() < least {
            return Err(Refusal::TooShort {
                samples: self.samples.len(),
                least,
                least_s: least as f64 * self.period_s,
            });
        }
        Ok(())
    }

    /// Stretches of rest: no torque, and one count.
    fn rests(&self) -> Vec<Range<usize>> {
        let none = NO_TORQUE * self.largest_torque_nm();
        let least = self.rest_samples();
        let mut rests = Vec::new();
        let mut start = 0;
        for (place, sample) in self.samples.iter().enumerate() {
            let torque = sample.torque_nm.abs() > none;
            let moved = self
                .samples
                .get(start)
                .is_some_and(|first| first.count != sample.count);
            if torque || moved {
                if place - start >= least {
                    rests.push(start..place);
                }
                // A sample that has torque is in no rest; one that moved may begin the next.
                start = if torque { place + 1 } else { place };
            }
        }
        if self.samples.len().saturating_sub(start) >= least {
            rests.push(start..self.samples.len());
        }
        rests
    }

    /// What happened from rest to rest, if it can tell m, b and c.
    ///
    /// # Errors
    /// What is missing.
    pub(super) fn pushes(&self) -> Result<Vec<Push>, Refusal> {
        self.check()?;
        let none = NO_TORQUE * self.largest_torque_nm();
        let rests = self.rests();
        let counts = self.samples.iter().map(|sample| sample.count);
        let travelled = match (counts.clone().min(), counts.max()) {
            (Some(least), Some(most)) => most.abs_diff(least),
            _ => 0,
        };
        if travelled < LEAST_COUNTS.unsigned_abs() {
            return Err(Refusal::NeverMoved {
                counts: travelled,
                torque_nm: self.largest_torque_nm(),
                least: LEAST_COUNTS,
            });
        }
        if rests.first().is_none_or(|rest| rest.start != 0) {
            return Err(Refusal::StartsInMotion);
        }
        if rests
            .last()
            .is_none_or(|rest| rest.end != self.samples.len())
        {
            return Err(Refusal::EndsInMotion {
                time_s: self.length_s(),
            });
        }
        let mut pushes = Vec::new();
        for pair in rests.windows(2) {
            let [before, after] = pair else { continue };
            let range = before.end - 1..after.start + self.rest_samples();
            let Some(samples) = self.samples.get(range.clone()) else {
                continue;
            };
            let first = samples.first().map_or(0, |sample| sample.count);
            let torque = |sample: &Sample| match sample.torque_nm.abs() > none {
                true => sample.torque_nm,
                false => 0.0,
            };
            pushes.push(Push {
                range,
                counts: samples
                    .iter()
                    .map(|sample| f64::from(sample.count) - f64::from(first))
                    .collect(),
                torques: samples.iter().map(torque).collect(),
            });
        }
        self.supports(&pushes)?;
        Ok(pushes)
    }

    /// When a sample was, s.
    pub(super) fn time_s(&self, place: usize) -> f64 {
        place as f64 * self.period_s
    }

    /// Whether steps in both directions and of several heights are there, and coast-downs.
    fn supports(&self, pushes: &[Push]) -> Result<(), Refusal> {
        let least = f64::from(LEAST_COUNTS);
        let (mut along, mut against) = (0, 0);
        for push in pushes {
            if push.furthest().abs() < 3.0 {
                continue;
            }
            let moved = push.counts.iter().position(|count| count.abs() > 1.0);
            let pushed = push.torques.iter().position(|&torque| torque != 0.0);
            match (moved, pushed) {
                (Some(moved), Some(pushed)) if pushed <= moved => {}
                (moved, _) => {
                    return Err(Refusal::MovedWithoutTorque {
                        time_s: self.time_s(push.range.start + moved.unwrap_or_default()),
                    });
                }
            }
            if push.furthest() * push.height_nm() > 0.0 {
                along += 1;
            } else {
                against += 1;
            }
        }
        if against > along {
            return Err(Refusal::Reversed { against, along });
        }
        let moving: Vec<&Push> = pushes.iter().filter(|push| push.moves()).collect();
        for (sign, missing) in [(1.0, "counts upwards"), (-1.0, "counts downwards")] {
            let those = || moving.iter().filter(|push| push.furthest() * sign > 0.0);
            if those().next().is_none() {
                return Err(Refusal::OneDirection { missing });
            }
            if !those().any(|push| push.coasted() * sign >= least / 2.0) {
                return Err(Refusal::NoCoastDown { missing });
            }
        }
        let heights = moving.iter().map(|push| push.height_nm().abs());
        let least_nm = heights.clone().fold(f64::INFINITY, f64::min);
        let most_nm = heights.fold(0.0, f64::max);
        if most_nm < LEAST_RATIO * least_nm {
            return Err(Refusal::OneHeight { least_nm, most_nm });
        }
        Ok(())
    }
}

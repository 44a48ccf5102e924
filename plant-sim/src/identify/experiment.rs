//! Which pushes to play, one after the other, so that m, b and c show in the counts.
//!
//! Nothing about the knob has to be known before. First it must stand still. In either direction a torque that
//! rises slowly, by a factor of two in each push, finds where the knob breaks away; then come steps of
//! [several heights](HEIGHTS), each up to a speed, and after each the knob coasts to rest. From each push the next is
//! planned: with d₁ travelled under the torque F for a time t, and d₂ without it, c ≈ F·d₁/(d₁ + d₂) and
//! m ≈ (F − c)·t²/2d₁ (viscous friction is in this c).
//!
//! A device plays a push by itself, within the push's own limits; [`Experiment::record`] plays them on anything
//! that holds a torque and counts. The plan is the same.

use control::push::{Push, Pushing, Step};

use super::recording::{REST_S, Recording, Sample};
use super::refusal::Refusal;

/// What the knob must not exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Speed, rad/s; seen to two counts in a tick.
    pub speed_rad_s: f64,
    /// Angle from where it starts, either way, rad.
    pub angle_rad: f64,
    /// Torque, Nm.
    pub torque_nm: f64,
}

/// Steps: torque in units of Coulomb friction, and the speed in units of the limit at which it ends.
pub const HEIGHTS: [(f64, f64); 6] = [
    (1.6, 0.25),
    (2.0, 0.5),
    (3.0, 0.85),
    (1.6, 0.6),
    (4.5, 0.4),
    (2.5, 0.85),
];

/// Torques that rise begin at this share of the limit.
const RAMP_FROM: f64 = 1e-3;
/// One doubles in this time, s,
const RISE_S: f64 = 0.3;
/// and is held for this time, s.
const HOLD_S: f64 = 0.1;

/// So many counts are a motion.
const MOVED_COUNTS: u32 = 3;

/// Of the way that is left, pushes plan to use this share.
const WAY: f64 = 0.5;

/// A step lasts so many ticks or more, by choice of its height,
const LEAST_TICKS: f64 = 4.0;

/// and no longer than this, s.
const LONGEST_STEP_S: f64 = 5.0;

/// So long a knob has time to come to rest before it is pushed, s.
const LONGEST_WAIT_S: f64 = 10.0;

/// A knob that has not stopped after so long never does, s.
const LONGEST_COAST_S: f64 = 30.0;

/// Counts within the angle limit, at least: with fewer nothing can be planned.
const LEAST_COUNTS: f64 = 200.0;

/// What is being done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The knob has to stand still.
    Rest,
    /// A torque rises until the knob moves, upwards or downwards.
    BreakAway {
        /// Whether counts are to rise.
        upwards: bool,
    },
    /// A step of torque, and the coast after it.
    Step {
        /// Which, from 1.
        number: usize,
    },
    /// Nothing more.
    Over,
}

/// Steps of an experiment.
pub const STEPS: usize = 2 * HEIGHTS.len();

/// What came of a push.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Played {
    /// The count before its first tick.
    pub from: i32,
    /// By how much each tick found the count moved.
    pub moves: Vec<i32>,
    /// The first tick without torque.
    pub released: usize,
}

impl Played {
    /// The sum of the moves of these ticks.
    fn way(&self, ticks: std::ops::Range<usize>) -> i32 {
        let moves = self.moves.get(ticks).unwrap_or_default();
        moves.iter().fold(0, |way, moved| way.wrapping_add(*moved))
    }

    /// Whether its last `ticks` ticks found the count where it was.
    fn rested(&self, ticks: u32) -> bool {
        let first = self.moves.len().checked_sub(ticks as usize);
        let last = first.and_then(|first| self.moves.get(first..));
        last.is_some_and(|last| last.iter().all(|moved| *moved == 0))
    }
}

/// Plays a push on what `hold` is: it is given a torque (Nm), holds it for a period, and returns the count then. `count`
/// is where it stands, before and after.
pub fn play(push: &Push, count: &mut i32, mut hold: impl FnMut(f64) -> i32) -> Played {
    let mut pushing = Pushing::new(*push);
    let (from, mut before) = (*count, *count);
    let mut moves = Vec::new();
    loop {
        let moved = count.wrapping_sub(before);
        before = *count;
        let step = pushing.tick(moved);
        moves.push(moved);
        let torque_nm = match step {
            Step::Torque(torque_nm) => torque_nm,
            _ => 0.0,
        };
        *count = hold(f64::from(torque_nm));
        if !matches!(step, Step::Torque(_) | Step::Coast) {
            let released = pushing.released().map_or(moves.len(), |it| it as usize);
            return Played {
                from,
                moves,
                released,
            };
        }
    }
}

/// An experiment under way: it is asked for a push, and told what came of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    limits: Limits,
    stage: Stage,
    /// The torque at which the next torque that rises begins, Nm.
    level_nm: f64,
    /// c and 1/m as far as they are known.
    coulomb_nm: f64,
    mobility: f64,
    /// The count where it began, once it did, and the last that is known.
    origin: Option<i32>,
    count: i32,
    /// The count is sure to be where the knob still stands.
    sure: bool,
    recording: Recording,
}

impl Experiment {
    /// For a knob whose ticks are `period_s` (s) apart and whose counts are `count_rad` (rad).
    ///
    /// # Errors
    /// Refuses what is not finite and above 0, and counts of which too few lie within the angle limit.
    pub fn new(limits: Limits, period_s: f64, count_rad: f64) -> Result<Self, Refusal> {
        for (name, value) in [
            ("speed limit (rad/s)", limits.speed_rad_s),
            ("angle limit (rad)", limits.angle_rad),
            ("torque limit (Nm)", limits.torque_nm),
            ("sample period (s)", period_s),
            ("count size (rad)", count_rad),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Refusal::NotPositive { name, value });
            }
        }
        let counts = limits.angle_rad / count_rad;
        if counts < LEAST_COUNTS {
            return Err(Refusal::TooCoarse {
                angle_rad: limits.angle_rad,
                counts,
                least: LEAST_COUNTS,
            });
        }
        Ok(Self {
            limits,
            stage: Stage::Rest,
            level_nm: RAMP_FROM * limits.torque_nm,
            coulomb_nm: 0.0,
            mobility: 0.0,
            origin: None,
            count: 0,
            sure: false,
            recording: Recording {
                period_s,
                count_rad,
                samples: Vec::new(),
            },
        })
    }

    /// The whole of it: `hold` is given a torque (Nm), holds it for a period, and returns the count then.
    ///
    /// # Errors
    /// See [`Experiment::new`] and [`Experiment::take`].
    pub fn record(
        limits: Limits,
        period_s: f64,
        count_rad: f64,
        first: i32,
        mut hold: impl FnMut(f64) -> i32,
    ) -> Result<Recording, Refusal> {
        let mut experiment = Self::new(limits, period_s, count_rad)?;
        let mut count = first;
        while let Some(push) = experiment.push() {
            experiment.take(&push, &play(&push, &mut count, &mut hold))?;
        }
        Ok(experiment.into_recording())
    }

    /// What was recorded so far: from rest to rest, push after push, without the time between them.
    #[must_use]
    pub fn into_recording(self) -> Recording {
        self.recording
    }

    /// What is done next.
    #[must_use]
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The next push; none once it is over.
    #[must_use]
    pub fn push(&self) -> Option<Push> {
        match self.stage {
            Stage::Over => None,
            // No torque, so no guard.
            Stage::Rest => Some(Push {
                most_ticks: 0,
                coast_ticks: self.ticks(LONGEST_WAIT_S),
                guard_counts: u32::MAX,
                ..self.step(0.0, 0.0, 0.0, 0.0)
            }),
            Stage::BreakAway { upwards } => {
                let to_nm = (2.0 * self.level_nm).min(self.limits.torque_nm);
                let sign = if upwards { 1.0 } else { -1.0 };
                Some(Push {
                    from_nm: (sign * self.level_nm) as f32,
                    rise_ticks: self.ticks(RISE_S),
                    most_ticks: self.ticks(RISE_S + HOLD_S),
                    way_counts: MOVED_COUNTS,
                    ..self.step(sign * to_nm, self.limits.speed_rad_s, 0.0, self.left(sign))
                })
            }
            Stage::Step { number } => {
                let (height, share) = *HEIGHTS.get((number - 1) / 2)?;
                let sign = if number % 2 == 1 { 1.0 } else { -1.0 };
                let speed_rad_s = share * self.limits.speed_rad_s;
                let mut height_nm = (height * self.coulomb_nm).min(self.limits.torque_nm);
                if self.mobility > 0.0 {
                    let gentle =
                        speed_rad_s / (LEAST_TICKS * self.recording.period_s * self.mobility);
                    height_nm =
                        height_nm.min((self.coulomb_nm + gentle).max(1.3 * self.coulomb_nm));
                }
                let left = self.left(sign);
                // Of all that it will travel, the way under torque is the share c/F.
                let way_rad = WAY * left * self.coulomb_nm / height_nm;
                // What the last pushes say of this one.
                let net_nm = (height_nm - 0.9 * self.coulomb_nm).max(0.0);
                let planned_s = match net_nm * self.mobility {
                    0.0 => LONGEST_STEP_S,
                    acceleration => (speed_rad_s / acceleration).min(LONGEST_STEP_S),
                };
                Some(Push {
                    most_ticks: (planned_s / self.recording.period_s) as u32 + 1,
                    ..self.step(sign * height_nm, speed_rad_s, way_rad, left)
                })
            }
        }
    }

    /// A step of torque, up to a speed and a way, with so much way left.
    fn step(&self, torque_nm: f64, speed_rad_s: f64, way_rad: f64, left_rad: f64) -> Push {
        let Recording {
            period_s,
            count_rad,
            ..
        } = self.recording;
        let counts = |speed_rad_s: f64| (speed_rad_s * period_s / count_rad) as u32;
        let most = counts(self.limits.speed_rad_s).max(2);
        Push {
            from_nm: torque_nm as f32,
            to_nm: torque_nm as f32,
            rise_ticks: 0,
            most_ticks: self.ticks(LONGEST_STEP_S),
            way_counts: ((way_rad / count_rad).ceil() as u32).max(1),
            // A tick may find one count more than its mean speed makes.
            speed_counts: (counts(speed_rad_s) + 2).min(most),
            rest_ticks: self.rest_ticks(),
            coast_ticks: self.ticks(LONGEST_COAST_S),
            guard_counts: ((left_rad / count_rad) as u32).max(1),
        }
    }

    fn ticks(&self, seconds: f64) -> u32 {
        ((seconds / self.recording.period_s).ceil() as u32).max(1)
    }

    /// The rest that a recording asks for fits into it.
    fn rest_ticks(&self) -> u32 {
        self.ticks(1.5 * REST_S).max(20)
    }

    /// How far it may still turn this way, rad.
    fn left(&self, sign: f64) -> f64 {
        let from = self.origin.unwrap_or(self.count);
        let angle = f64::from(self.count.wrapping_sub(from)) * self.recording.count_rad;
        (self.limits.angle_rad - sign * angle).max(0.0)
    }

    /// A push was played of which something is not known; the knob stands near `count`. It is planned again.
    pub fn forget(&mut self, count: i32) {
        self.count = count;
        self.sure = false;
    }

    /// Takes what came of [`Experiment::push`].
    ///
    /// # Errors
    /// A knob that does not stand still to begin with, that something else moved between two pushes, or that breaks away
    /// against the torque.
    pub fn take(&mut self, push: &Push, played: &Played) -> Result<(), Refusal> {
        let time_s = self.recording.length_s();
        // Where it rests at the end of a count, one more or less is no motion.
        if self.sure && played.from.wrapping_sub(self.count).unsigned_abs() > 1 {
            return Err(Refusal::MovedWithoutTorque { time_s });
        }
        let all = played.moves.len();
        self.count = played.from.wrapping_add(played.way(0..all));
        self.sure = true;
        let rested = played.rested(push.rest_ticks);
        if self.stage == Stage::Rest {
            if !rested {
                return Err(Refusal::StartsInMotion);
            }
            // It may have come to rest only now.
            let rest = Sample {
                count: self.count,
                torque_nm: 0.0,
            };
            self.recording.samples = vec![rest; push.rest_ticks as usize];
            self.origin = Some(self.count);
            self.stage = Stage::BreakAway { upwards: true };
            return Ok(());
        }
        let mut count = self.recording.samples.last().map_or(0, |last| last.count);
        for (place, (tick, moved)) in (0..).zip(&played.moves).enumerate() {
            count = count.wrapping_add(*moved);
            let torque_nm = match place < played.released {
                true => f64::from(push.torque_nm(tick)),
                false => 0.0,
            };
            self.recording.samples.push(Sample { count, torque_nm });
        }
        self.stage = match self.stage {
            // What was recorded says so.
            _ if !rested => Stage::Over,
            Stage::BreakAway { upwards } => self.break_away(push, played, upwards)?,
            Stage::Step { number } => {
                self.learn(push, played);
                match number {
                    STEPS => Stage::Over,
                    _ => Stage::Step { number: number + 1 },
                }
            }
            stage => stage,
        };
        Ok(())
    }

    /// What comes after a torque that rose.
    fn break_away(
        &mut self,
        push: &Push,
        played: &Played,
        upwards: bool,
    ) -> Result<Stage, Refusal> {
        let moved = played.way(1..played.released + 1);
        if moved.unsigned_abs() < MOVED_COUNTS {
            self.level_nm = f64::from(push.to_nm.abs());
            return Ok(match self.level_nm < 0.999 * self.limits.torque_nm {
                true => Stage::BreakAway { upwards },
                // It does not move: what was recorded says so.
                false => Stage::Over,
            });
        }
        if (moved > 0) != upwards {
            let along = usize::from(!upwards);
            return Err(Refusal::Reversed { against: 1, along });
        }
        let last = played.released.saturating_sub(1) as u32;
        let torque_nm = f64::from(push.torque_nm(last).abs());
        self.coulomb_nm = self.coulomb_nm.max(torque_nm);
        self.level_nm = (0.25 * torque_nm).max(RAMP_FROM * self.limits.torque_nm);
        Ok(match upwards {
            true => Stage::BreakAway { upwards: false },
            false => Stage::Step { number: 1 },
        })
    }

    /// c and 1/m from a step that came to rest.
    fn learn(&mut self, push: &Push, played: &Played) {
        let Recording {
            period_s,
            count_rad,
            ..
        } = self.recording;
        let (released, all) = (played.released, played.moves.len());
        let way = |ticks| f64::from(played.way(ticks).unsigned_abs()) * count_rad;
        let (pushed, coasted) = (way(1..released + 1), way(released + 1..all));
        if pushed < 5.0 * count_rad {
            return;
        }
        let height_nm = f64::from(push.to_nm.abs());
        self.coulomb_nm = height_nm * pushed / (pushed + coasted);
        let time_s = released as f64 * period_s;
        let net_nm = (height_nm - self.coulomb_nm).max(0.05 * height_nm);
        self.mobility = 2.0 * pushed / (time_s * time_s * net_nm);
    }
}

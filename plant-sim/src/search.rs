//! Hill climbing towards a violation: random runs, changed by small steps, that keep what comes closer.
//!
//! A climb is drawn from its number alone, as a random run is. It starts from a run without a
//! hand and follows one of two goals:
//!
//! - *energy*: the largest share of what friction has taken so far that the motor has given
//!   back, (work of the motor − stored at the start) / taken by friction; above 1 energy is given out;
//! - *cycle*: turns t made while no swing between two turns held more than 2cΔ, what friction takes in two
//!   counts, as t/(t + 10); 1 for a run that never ends.

use std::f64::consts::TAU;

use control::config::Law;
use control::shape::Shape;

use crate::campaign::{Draw, Kind};
use crate::closed_loop::{Sample, SceneError};
use crate::hold::State;
use crate::trial::{Fault, Sampled, Trial, Verdict};

/// Evaluations of one climb.
pub const EVALUATIONS: u64 = 200;

/// What a climb starts from, in turn.
pub const KINDS: [Kind; 5] = [
    Kind::Wall,
    Kind::Spring,
    Kind::Release,
    Kind::Detent,
    Kind::Loop,
];

/// What a climb is after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Goal {
    /// Energy given out.
    Energy,
    /// An oscillation that does not end.
    Cycle,
}

impl Goal {
    /// In a word.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Energy => "energy",
            Self::Cycle => "cycle",
        }
    }
}

/// The top of a climb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summit {
    /// The climb.
    pub number: u64,
    /// What it was after.
    pub goal: Goal,
    /// How close it came; 1 is there.
    pub height: f64,
    /// The run.
    pub trial: Trial,
    /// What became of it.
    pub verdict: Verdict,
}

/// Climbs climb `number` of a seed: the summit, or the first violation. At most [`EVALUATIONS`] runs.
///
/// # Errors
/// See [`SceneError`]; none of what is drawn is refused.
pub fn climb(seed: u64, number: u64, law: Law) -> Result<Summit, SceneError> {
    let kind = KINDS[(number % KINDS.len() as u64) as usize];
    let goal = if (number / KINDS.len() as u64).is_multiple_of(2) {
        Goal::Energy
    } else {
        Goal::Cycle
    };
    // Not the numbers of the campaign.
    let mut draw = Draw::new(!seed, kind, number);
    let look = |trial: Trial| {
        let (height, verdict) = height(&trial, goal)?;
        Ok::<_, SceneError>(Summit {
            number,
            goal,
            height,
            trial,
            verdict,
        })
    };
    let mut best = look(draw.trial(kind, law))?;
    for _ in 1..EVALUATIONS {
        if best.verdict.fault.is_some() {
            break;
        }
        let next = look(draw.step(&best.trial, law))?;
        // Sideways too, or a plateau would hold it.
        if next.height >= best.height || next.verdict.fault.is_some() {
            best = next;
        }
    }
    Ok(best)
}

/// Runs a trial and says how close it came.
fn height(trial: &Trial, goal: Goal) -> Result<(f64, Verdict), SceneError> {
    let plan = control::plan::Plan::new(&trial.scene.config)?;
    let stored_j = trial.stored_j(&plan);
    let device = &trial.scene.device;
    let small_j = 2.0 * device.coulomb_nm * trial.scene.config.count_rad();
    let mut returned = 0.0_f64;
    let mut turns = 0_u64;
    let mut direction = 0.0;
    // The most kinetic energy since the last turn.
    let mut swing_j = f64::INFINITY;
    let verdict = trial.watch(plan, |sample: &Sample, _| {
        if sample.friction_j > 0.0 {
            returned = returned.max((sample.motor_work_j - stored_j) / sample.friction_j);
        }
        let velocity = sample.state.velocity;
        if velocity * direction < 0.0 {
            if swing_j < small_j {
                turns += 1;
            } else {
                turns = 0;
            }
            swing_j = 0.0;
        }
        if velocity != 0.0 {
            direction = velocity.signum();
        }
        swing_j = swing_j.max(0.5 * device.inertia_kg_m2 * velocity * velocity);
        true
    })?;
    let height = match (goal, verdict.fault) {
        (Goal::Energy, Some(Fault::GivenOut | Fault::Growth)) => returned.max(1.0),
        (_, Some(_)) => 1.0,
        (Goal::Energy, None) => returned,
        (Goal::Cycle, None) => turns as f64 / (turns as f64 + 10.0),
    };
    Ok((height, verdict))
}

impl Draw {
    /// Standard normal, by Box and Muller.
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    /// A trial near `trial`, within what is drawn at random: some of its quantities times e^(σ·normal), places
    /// by as much of a count, σ from 0.01 to 1.
    fn step(&mut self, trial: &Trial, law: Law) -> Trial {
        let old = &trial.scene;
        let sigma = self.log(0.01, 1.0);
        let period_s = old.clock.period_s;
        let mut sampled = Sampled {
            device: old.device,
            count_rad: old.config.hardware_count_rad,
            period_s,
        };
        let mut factor = |value: &mut f64, low: f64, high: f64| {
            if *value > 0.0 && self.chance(0.3) {
                *value = (*value * (sigma * self.normal()).exp()).clamp(low, high);
            }
        };
        factor(&mut sampled.device.inertia_kg_m2, 2e-6, 5e-5);
        factor(&mut sampled.device.viscous_nm_s_rad, 1e-6, 1e-4);
        factor(&mut sampled.device.coulomb_nm, 3e-4, 1.5e-2);
        factor(&mut sampled.count_rad, TAU / 65_536.0, TAU / 256.0);
        factor(&mut sampled.period_s, 5e-5, 5e-3);
        let mut demand = old.config.stiffness_nm_rad;
        factor(&mut demand, 1e-2, 1e4);
        let mut velocity = old.start.velocity;
        factor(&mut velocity, 0.05, 60.0);
        // What the loop has, in periods and in c.
        let timing = &old.config.timing;
        let mut jitter = timing.jitter_s / period_s;
        factor(&mut jitter, 0.0, 0.3);
        let mut delay = timing.delay_s / timing.shortest_s();
        factor(&mut delay, 0.0, 0.999);
        let mut lag = timing.amplifier_tau_s / period_s;
        factor(&mut lag, 0.02, 2.0);
        let mut missed = old.clock.missed_ticks;
        factor(&mut missed, 1e-3, 0.2);
        let mut step = old.drive.torque_step_nm / old.device.coulomb_nm;
        factor(&mut step, 1e-2, 2.0);
        let limited = old.config.torque_max_nm < f64::from(f32::MAX);
        let mut most = old.config.torque_max_nm / old.device.coulomb_nm;
        if limited {
            factor(&mut most, 0.5, 100.0);
        }
        let mut detent_rad = match old.config.shape {
            Shape::Detent { period_rad, .. } => period_rad,
            _ => 0.0,
        };
        factor(&mut detent_rad, 0.05, 0.55);
        // Places, in counts; the start first.
        let count = sampled.count_rad;
        let mut place = |value: f64| {
            let counts = value / old.config.hardware_count_rad;
            let by = if self.chance(0.3) {
                sigma * self.normal()
            } else {
                0.0
            };
            count * (counts + by)
        };
        let position = place(old.start.position);
        let apart = place(old.config.shape.zero_rad() - old.start.position);
        let there = position + apart;
        let shape = match old.config.shape {
            Shape::Wall { .. } => Shape::Wall {
                edge_rad: position + apart.clamp(0.0, 2.0 * count),
            },
            Shape::Spring { .. } => Shape::Spring { centre_rad: there },
            Shape::Detent { .. } => Shape::Detent {
                centre_rad: there,
                period_rad: detent_rad.max(2.0 * count),
            },
        };
        let start = State { position, velocity };
        let mut scene = sampled.scene(sampled.config(law, shape, demand), start, old.samples);
        scene.seed = old.seed;
        scene.clock.jitter_s = jitter * sampled.period_s;
        scene.clock.missed_ticks = missed;
        let coulomb_nm = sampled.device.coulomb_nm;
        scene.drive.torque_step_nm = step * coulomb_nm;
        scene.drive.amplifier_tau_s = lag * sampled.period_s;
        let config = &mut scene.config;
        config.timing.jitter_s = scene.clock.jitter_s;
        config.timing.may_miss = missed > 0.0;
        config.timing.amplifier_tau_s = scene.drive.amplifier_tau_s;
        config.timing.delay_s = delay * config.timing.shortest_s();
        scene.drive.delay_s = config.timing.delay_s;
        config.torque_step_nm = scene.drive.torque_step_nm;
        if limited {
            config.torque_max_nm = most * coulomb_nm;
        }
        Trial { scene, ..*trial }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_climb_is_its_number_and_stays_within_what_is_drawn() {
        for number in 0..10 {
            let one = climb(3, number, Law::Ledger).unwrap();
            assert_eq!(one, climb(3, number, Law::Ledger).unwrap());
            assert_ne!(
                one.trial,
                climb(4, number, Law::Ledger).unwrap().trial,
                "{number}"
            );
            let device = one.trial.scene.device;
            assert!((2e-6..=5e-5).contains(&device.inertia_kg_m2));
            assert!(one.height.is_finite() && one.height >= 0.0);
        }
    }

    #[test]
    fn it_finds_what_there_is_to_find() {
        // The plain spring gives energy out: every climb says so.
        for number in [0, 1, 6] {
            let summit = climb(1, number, Law::Raw).unwrap();
            assert!(summit.verdict.fault.is_some(), "{summit:?}");
        }
    }

    #[test]
    fn it_gains_height() {
        let first = |number| {
            let kind = KINDS[number as usize % 5];
            let trial = Draw::new(!1, kind, number).trial(kind, Law::Ledger);
            height(&trial, Goal::Energy).unwrap().0
        };
        let gained = (0..5)
            .filter(|&number| climb(1, number, Law::Ledger).unwrap().height > first(number) + 0.05);
        assert!(gained.count() >= 3);
    }
}

use std::hint::black_box;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use control::config::Law;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::{Controller, Tick};

use super::Spread;
use crate::closed_loop::{Scene, SceneError};
use crate::drive::Drive;
use crate::fidelity::{Phenomena, Phenomenon, Simplified, simplest};
use crate::hand::Hand;
use crate::hold::State;
use crate::motor::Motor;
use crate::preset::PRESETS;
use crate::trial::Sampled;

/// A rung of the ladder from the plain plant to the full one: what it has more than the one below.
pub const RUNGS: [&[Phenomenon]; 7] = [
    &[],
    &[Phenomenon::TorqueStep],
    &[Phenomenon::Hand],
    &[Phenomenon::Delay, Phenomenon::AmplifierLag],
    &[Phenomenon::HandShake],
    &[Phenomenon::Cogging],
    &[Phenomenon::Stiction],
];

/// A way to run the scenes, measured.
#[derive(Debug, Clone)]
pub struct Rung {
    /// What it has more than the one below; empty for the plain plant and for `auto`.
    pub adds: &'static [Phenomenon],
    /// Of `auto`, what it was asked for, rad.
    pub tolerance_rad: Option<f64>,
    /// ns per sample: controller, plant and what decides, all attempts.
    pub tick_ns: Spread,
    /// Over all samples of all scenes, how far its angle is from the full plant's at most, rad.
    pub error_rad: f64,
    /// Of `auto`, the largest bound that it promised, rad.
    pub bound_rad: f64,
    /// Of `auto`, how much it left out of how much there was, over all scenes.
    pub left_out: [usize; 2],
}

/// The RE35 under the energy ledger: walls and springs hit at 1, 3, 10 and 30 rad/s, detents crossed at 10 and 30,
/// with all that a real drive, motor and hand add, `strength` times as strong as that: at 1 late by
/// 20 µs, an amplifier of 50 µs, torque steps of 0.12 mNm, cogging of 0.1 mNm 14 times a turn, stiction
/// of 0.2 mNm below 0.2 rad/s, a finger of 1e-5 kg m² and 1e-4 Nm s/rad that leans with 1 mNm and
/// trembles with 0.2 mNm at 8 Hz. The controller knows of delay and lag.
#[must_use]
pub fn scenes(strength: f64) -> Vec<Scene> {
    let re35 = &PRESETS[0];
    let sampled = Sampled {
        device: re35.device,
        count_rad: re35.count_rad(),
        period_s: re35.period_s,
    };
    let wall = Shape::Wall { edge_rad: 0.0 };
    let spring = Shape::Spring { centre_rad: 0.0 };
    let detent = Shape::Detent {
        centre_rad: 0.0,
        period_rad: std::f64::consts::TAU / 20.0,
    };
    let speeds = |shape, speeds: &'static [f64]| speeds.iter().map(move |speed| (shape, *speed));
    let hits = speeds(wall, &[1.0, 3.0, 10.0, 30.0])
        .chain(speeds(spring, &[1.0, 3.0, 10.0, 30.0]))
        .chain(speeds(detent, &[10.0, 30.0]));
    let scene = |(shape, velocity)| {
        let start = State {
            // Neither on an edge nor in the middle of a count.
            position: -1.371 * sampled.count_rad,
            velocity,
        };
        let mut config = sampled.config(Law::Ledger, shape, 1e6);
        config.timing.delay_s = 20e-6 * strength;
        config.timing.amplifier_tau_s = 50e-6 * strength;
        config.torque_step_nm = 1.2e-4 * strength;
        let scene = sampled.scene(config, start, 1_000);
        Scene {
            drive: Drive {
                delay_s: config.timing.delay_s,
                amplifier_tau_s: config.timing.amplifier_tau_s,
                torque_step_nm: config.torque_step_nm,
            },
            motor: Motor {
                cogging_nm: 1e-4 * strength,
                cogging_per_rev: 14.0,
                stiction_nm: 2e-4 * strength,
                stribeck_rad_s: 0.2,
            },
            hand: Hand {
                inertia_kg_m2: 1e-5 * strength,
                damping_nm_s_rad: 1e-4 * strength,
                push_nm: 1e-3 * strength,
                shake_nm: 2e-4 * strength,
                shake_hz: 8.0,
                ..Hand::default()
            },
            ..scene
        }
    };
    hits.map(scene).collect()
}

/// How one way runs a scene.
enum Way {
    Without(Box<Simplified>),
    Auto(f64),
}

impl Way {
    /// Runs a scene to its end: how many samples that took.
    fn run(&self, scene: &Scene, plan: Plan) -> Result<u64, SceneError> {
        match self {
            Self::Without(simplified) => {
                let report = simplified.run_under(control(scene, plan), |_| true);
                Ok(black_box(report).samples)
            }
            Self::Auto(tolerance_rad) => {
                let answer = simplest(scene, *tolerance_rad, || control(scene, plan), |_| true)?;
                Ok(black_box(answer).report.samples)
            }
        }
    }
}

fn control(scene: &Scene, plan: Plan) -> impl FnMut(u32, f32) -> Tick + use<> {
    let mut controller = Controller::new(plan, scene.start_count());
    move |counter, duration_s| controller.tick(counter, duration_s)
}

/// Every rung of [`RUNGS`] and `auto` at every tolerance, on the same scenes.
///
/// One thread; `rounds` rounds of all ways in turn, each of all scenes. `None` if `stop` was raised.
///
/// # Errors
/// See [`SceneError`].
pub fn rungs(
    scenes: &[Scene],
    tolerances_rad: &[f64],
    rounds: usize,
    stop: &AtomicBool,
    progress: &dyn Fn(),
) -> Result<Option<Vec<Rung>>, SceneError> {
    let plans = scenes
        .iter()
        .map(|scene| Ok(Plan::new(&scene.config)?))
        .collect::<Result<Vec<Plan>, SceneError>>()?;
    let full = angles(scenes, &plans, |_| Phenomena::default())?;
    let mut measured = Vec::new();
    let mut ways: Vec<Vec<Way>> = Vec::new();
    let mut kept = Phenomena::default();
    for adds in RUNGS {
        for phenomenon in adds {
            kept = kept.with(*phenomenon);
        }
        let without = |scene: &Scene| Phenomena::of(scene).without(kept);
        let error_rad = apart(&full, &angles(scenes, &plans, without)?);
        let simplified = scenes.iter().map(|scene| {
            Ok(Way::Without(Box::new(Simplified::new(
                scene,
                without(scene),
            )?)))
        });
        ways.push(simplified.collect::<Result<_, SceneError>>()?);
        measured.push((adds, None, error_rad, 0.0, [0, 0]));
    }
    for tolerance_rad in tolerances_rad {
        let (mut bound_rad, mut left_out) = (0.0_f64, [0, 0]);
        let mut dropped = Vec::new();
        for (scene, plan) in scenes.iter().zip(&plans) {
            let answer = simplest(scene, *tolerance_rad, || control(scene, *plan), |_| true)?;
            bound_rad = bound_rad.max(answer.bound_rad);
            left_out[0] += answer.simplified.dropped().iter().count();
            left_out[1] += Phenomena::of(scene).iter().count();
            dropped.push(answer.simplified.dropped());
        }
        let mut dropped = dropped.into_iter();
        let simple = angles(scenes, &plans, |_| dropped.next().unwrap_or_default())?;
        ways.push(scenes.iter().map(|_| Way::Auto(*tolerance_rad)).collect());
        let adds: &[Phenomenon] = &[];
        let error_rad = apart(&full, &simple);
        measured.push((adds, Some(*tolerance_rad), error_rad, bound_rad, left_out));
    }
    let mut ns = vec![Vec::new(); ways.len()];
    for round in 0..=rounds {
        for (way, ns) in ways.iter().zip(&mut ns) {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let (mut samples, began) = (0, Instant::now());
            for _ in 0..REPEATS {
                for ((scene, plan), way) in scenes.iter().zip(&plans).zip(way) {
                    samples += way.run(scene, *plan)?;
                }
            }
            // The first only warms up.
            if round > 0 {
                ns.push(1e9 * began.elapsed().as_secs_f64() / samples as f64);
            }
            progress();
        }
    }
    let rungs = measured.into_iter().zip(ns);
    Ok(rungs
        .map(
            |((adds, tolerance_rad, error_rad, bound_rad, left_out), ns)| {
                Some(Rung {
                    adds,
                    tolerance_rad,
                    tick_ns: Spread::of(ns)?,
                    error_rad,
                    bound_rad,
                    left_out,
                })
            },
        )
        .collect())
}

/// All scenes so many times in a round, so that it takes milliseconds.
const REPEATS: usize = 5;

/// The angles at all samples, and at the end, of each scene without some phenomena.
fn angles(
    scenes: &[Scene],
    plans: &[Plan],
    mut without: impl FnMut(&Scene) -> Phenomena,
) -> Result<Vec<Vec<f64>>, SceneError> {
    let all = scenes.iter().zip(plans).map(|(scene, plan)| {
        let simplified = Simplified::new(scene, without(scene))?;
        let mut angles = Vec::new();
        let report = simplified.run_under(control(scene, *plan), |sample| {
            angles.push(sample.state.position);
            true
        });
        angles.push(report.end.position);
        Ok(angles)
    });
    all.collect()
}

/// How far runs are apart, at most: at the samples that both have, and at their ends.
fn apart(ones: &[Vec<f64>], others: &[Vec<f64>]) -> f64 {
    let mut worst = 0.0_f64;
    for (one, other) in ones.iter().zip(others) {
        let ends = one.last().zip(other.last());
        let common = one.len().min(other.len()) - 1;
        let pairs = one[..common].iter().zip(&other[..common]).chain(ends);
        worst = pairs.fold(worst, |worst, (a, b)| worst.max((a - b).abs()));
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;

    /// More of the plant comes nearer to the full one, which is the full one; `auto` keeps its promise.
    #[test]
    fn the_last_rung_is_the_full_plant_and_auto_keeps_its_bound() {
        let scenes = scenes(1e-4);
        let tolerances = [1e-9, 1e-6, 1e-4];
        let stop = AtomicBool::new(false);
        let rungs = rungs(&scenes, &tolerances, 1, &stop, &|| ())
            .unwrap()
            .unwrap();
        let (ladder, autos) = rungs.split_at(RUNGS.len());
        assert_eq!(ladder[RUNGS.len() - 1].error_rad, 0.0);
        assert!(ladder[0].error_rad > 0.0);
        for (auto, tolerance_rad) in autos.iter().zip(tolerances) {
            assert!(
                auto.error_rad <= auto.bound_rad && auto.bound_rad <= tolerance_rad,
                "{auto:?}"
            );
        }
        // Most can be dropped where a tenth of a count may be missed, little where nothing may.
        assert!(autos[2].left_out[0] * 2 > autos[2].left_out[1], "{autos:?}");
        assert!(autos[0].left_out[0] < autos[2].left_out[0], "{autos:?}");
    }
}

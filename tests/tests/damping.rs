//! Virtual damping: as much as the law leaves room for, whatever is demanded, and no energy.

use std::f64::consts::TAU;

use acceptance::systematic::Tally;
use control::config::Law;
use control::criterion::{Criterion, Sampling};
use control::shape::{Profile, Shape};
use control::tick::{Reason, Tick};
use plant_sim::campaign::{Draw, Kind};
use plant_sim::hold::State;
use plant_sim::outcome::Class;
use plant_sim::preset::preset;
use plant_sim::trial::{EXTENSION, Fault, Sampled, Trial, Verdict};
use rayon::prelude::*;

const SEED: u64 = 1;

fn re35() -> Sampled {
    let preset = preset("re35").unwrap();
    Sampled {
        device: preset.device,
        count_rad: TAU / preset.counts_per_rev,
        period_s: preset.period_s,
    }
}

/// 24,000 random runs with 1e-7 to 1 Nm s/rad demanded, half of them of shapes a tenth to 1e-5 as stiff,
/// where the damping decides.
#[test]
fn demanded_damping_gives_no_energy_out_and_settles() {
    const RUNS: u64 = 2_000;
    for law in [Law::Static, Law::Episode, Law::Ledger, Law::Auto] {
        for kind in [Kind::Wall, Kind::Spring, Kind::Detent] {
            let tally: Tally = (0..RUNS)
                .into_par_iter()
                .map(|number| {
                    let mut draw = Draw::new(SEED, kind, number);
                    let mut trial = draw.trial(kind, law);
                    trial.scene.config.damping_nm_s_rad = draw.log(1e-7, 1.0);
                    if number % 2 == 1 {
                        trial.scene.config.stiffness_nm_rad *= draw.log(1e-5, 0.1);
                    }
                    trial.run().unwrap().fault
                })
                .collect::<Vec<_>>()
                .into_iter()
                .collect();
            let expected = (RUNS as usize, 0);
            assert_eq!(
                (tally.runs, tally.total()),
                expected,
                "{law:?} {kind:?}: {tally:?}"
            );
        }
    }
}

/// The static spring with damping that is not limited.
fn unlimited(trial: &Trial, stiffness: f64, damping: f64) -> Verdict {
    let count_rad = trial.scene.config.count_rad();
    let profile = Profile::new(&trial.scene.config.shape, count_rad).unwrap();
    let mut before = trial.scene.start_count();
    let verdict = trial.run_under(
        |counter, duration_s| {
            let count = counter as i32;
            let moved = count - before;
            before = count;
            let velocity = moved as f32 * count_rad as f32 / duration_s;
            Tick {
                count,
                moved,
                torque_nm: stiffness as f32 * profile.read(count).pull_rad
                    - damping as f32 * velocity,
                stiffness_nm_rad: stiffness as f32,
                margin_nm: 0.0,
                account_j: 0.0,
                law: Law::Static,
                reason: Reason::None,
            }
        },
        0.0,
    );
    verdict.unwrap()
}

/// B ≤ b − K·Te/2, B ≤ (c − K·Δ/2)·T/Δ under static and the episode: without them, a damping of 3 m/T
/// overshoots the velocity in every tick, and half a m/T with coarse counts pushes by a whole count's speed
/// where the knob hardly moves.
#[test]
fn damping_that_is_not_limited_makes_energy_and_limited_does_not() {
    for (counts_per_rev, share, naive) in
        [(8192.0, 3.0, Fault::Growth), (256.0, 0.5, Fault::GivenOut)]
    {
        let device = Sampled {
            count_rad: TAU / counts_per_rev,
            ..re35()
        };
        let sampling = Sampling {
            period_s: device.period_s,
            count_rad: device.count_rad,
        };
        let criterion = Criterion::new(device.device, sampling).unwrap();
        let stiffness = 0.5 * criterion.largest_stiffness();
        let damping = share * device.device.inertia_kg_m2 / device.period_s;
        for place in 0..16 {
            let start = State {
                position: -(f64::from(place) + 0.5) / 16.0 * device.count_rad,
                velocity: 10.0,
            };
            let spring = |law| {
                let shape = Shape::Spring { centre_rad: 0.0 };
                let mut config = device.config(law, shape, stiffness);
                config.damping_nm_s_rad = damping;
                Trial {
                    extension: EXTENSION,
                    hasty: false,
                    scene: device.scene(config, start, 500),
                    history: 9,
                }
            };
            let verdict = unlimited(&spring(Law::Raw), stiffness, damping);
            assert_eq!(
                verdict.fault,
                Some(naive),
                "{counts_per_rev} counts, place {place}"
            );
            for law in [Law::Static, Law::Episode, Law::Ledger, Law::Auto] {
                let mended = spring(law).run().unwrap();
                assert_eq!(mended.fault, None, "{law:?} {place}: {mended:?}");
                assert_eq!(mended.report.class, Class::Rest);
            }
        }
    }
}

/// The share of the speed with which a knob leaves a wall of the ledger, from 16 places.
fn returned(stiffness: f64, velocity: f64, damping: f64) -> Vec<f64> {
    let device = re35();
    let from = |place: i32| {
        let wall = Shape::Wall {
            edge_rad: 3.0 * device.count_rad,
        };
        let mut config = device.config(Law::Ledger, wall, stiffness);
        config.damping_nm_s_rad = damping;
        let start = State {
            position: -(f64::from(place) + 0.5) / 16.0 * velocity * device.period_s,
            velocity,
        };
        let trial = Trial {
            extension: EXTENSION,
            hasty: false,
            scene: device.scene(config, start, 4_000),
            history: 9,
        };
        let verdict = trial.run().unwrap();
        assert_eq!(verdict.fault, None);
        -verdict.report.end.velocity / velocity
    };
    (0..16).map(from).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The knob leaves a damped wall with less, where the account pays for the whole wall.
#[test]
fn a_damped_wall_returns_less() {
    for velocity in [10.0, 30.0] {
        let bare = returned(0.1, velocity, 0.0);
        let damped = returned(0.1, velocity, 3e-4);
        for (bare, damped) in bare.iter().zip(&damped) {
            assert!(*damped < 0.9 * bare, "{velocity} rad/s: {bare}, {damped}");
        }
    }
}

/// At a demand beyond what the account pays for, the torque is at its limit anyway: damping takes a
/// few hundredths in the mean, and a hit may even return a little more.
#[test]
fn at_the_limit_of_the_account_damping_takes_little() {
    for velocity in [10.0, 30.0] {
        let bare = mean(&returned(1e3, velocity, 0.0));
        let damped = mean(&returned(1e3, velocity, 1e-3));
        assert!(
            bare - 0.15 < damped && damped < bare,
            "{velocity} rad/s: {bare}, {damped}"
        );
    }
}

//! The systematic runs: 240 of each of 11 devices, walls and springs hit at six speeds and hands
//! that lean, as `plant_sim::suite` has them, under any belief.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use control::config::{Config, Law};
use control::criterion::Device;
use control::plan::Plan;
use control::tick::Controller;
use control::tuning::Tuning;
use plant_sim::hold::State;
use plant_sim::suite::{ANY_STIFFNESS, runs};
use plant_sim::trial::{Fault, Sampled, Trial, Verdict};
use rayon::prelude::*;

/// A run is extended to 256 times as many; all of a control that was told the truth settle long before.
const SAMPLES: u64 = 64;

/// How many runs were bad, by what was wrong with them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    /// Runs.
    pub runs: usize,
    /// Bad ones.
    pub bad: BTreeMap<Fault, usize>,
}

impl Tally {
    /// How many were bad.
    #[must_use]
    pub fn total(&self) -> usize {
        self.bad.values().sum()
    }

    /// How many were bad in this way.
    #[must_use]
    pub fn of(&self, fault: Fault) -> usize {
        self.bad.get(&fault).copied().unwrap_or(0)
    }
}

impl FromIterator<Option<Fault>> for Tally {
    fn from_iter<I: IntoIterator<Item = Option<Fault>>>(faults: I) -> Self {
        let mut tally = Self::default();
        for fault in faults {
            tally.runs += 1;
            if let Some(fault) = fault {
                *tally.bad.entry(fault).or_insert(0) += 1;
            }
        }
        tally
    }
}

/// The paper's motor at 0.1, 1 and 5 ms and with coarser encoders, and gimbal knobs of assumed values.
#[must_use]
pub fn devices() -> [Sampled; 11] {
    let sampled = |m, b, c, counts_per_rev: f64, period_s| Sampled {
        device: Device {
            inertia_kg_m2: m,
            viscous_nm_s_rad: b,
            coulomb_nm: c,
        },
        count_rad: TAU / counts_per_rev,
        period_s,
    };
    let re35 = |counts, period_s| sampled(6.28e-6, 9e-6, 2e-3, counts, period_s);
    let knob = |m, b, c, period_s| sampled(m, b, c, 16_384.0, period_s);
    [
        re35(8192.0, 1e-3),
        re35(8192.0, 1e-4),
        re35(8192.0, 5e-3),
        re35(4096.0, 1e-3),
        re35(1024.0, 1e-3),
        re35(256.0, 1e-3),
        knob(5e-6, 1e-5, 1e-3, 1.25e-4),
        knob(5e-6, 1e-5, 1e-3, 1e-3),
        knob(2e-5, 1e-4, 1e-2, 1.25e-4),
        knob(2e-5, 1e-4, 1e-2, 1e-3),
        knob(1e-5, 3e-5, 3e-3, 2.5e-4),
    ]
}

/// The runs of a device, which demand more than it can render.
#[must_use]
pub fn trials(sampled: &Sampled, law: Law) -> Vec<Trial> {
    let mut trials: Vec<Trial> = runs(sampled, law, ANY_STIFFNESS)
        .into_iter()
        .map(|run| run.trial)
        .collect();
    for trial in &mut trials {
        let scene = &mut trial.scene;
        scene.samples = SAMPLES;
        // Other ticks are missed in every run.
        let State { position, velocity } = scene.start;
        scene.seed = ((position / sampled.count_rad).to_bits() ^ velocity.to_bits()) >> 8;
    }
    trials
}

/// The trial's controller after the free motion that it has seen. `told` is what it believes;
/// the scene is what is true.
#[must_use]
pub fn controller(trial: &Trial, told: &Config, tuning: Tuning) -> Controller {
    let scene = &trial.scene;
    let plan = Plan::with_tuning(told, tuning).expect("a configuration that is accepted");
    if trial.history == 0 {
        return scene.controller(plan);
    }
    let idle = Config {
        stiffness_nm_rad: 0.0,
        damping_nm_s_rad: 0.0,
        ..*told
    };
    let idle = Plan::with_tuning(&idle, tuning).expect("a configuration that is accepted");
    let count = |tick: u32| {
        let past = f64::from(tick) * scene.clock.period_s * scene.start.velocity;
        ((scene.start.position - past) / scene.config.hardware_count_rad).floor() as i64 as i32
    };
    let mut controller = Controller::new(idle, count(trial.history + 1));
    for tick in (1..=trial.history).rev() {
        let _ = controller.tick(count(tick) as u32, scene.clock.period_s as f32);
    }
    controller.adopt(plan);
    controller
}

/// The faults of all runs of a law on all devices.
#[must_use]
pub fn suite(law: Law, verdict: impl Fn(Trial) -> Verdict + Sync) -> Tally {
    let runs: Vec<Trial> = devices()
        .iter()
        .flat_map(|sampled| trials(sampled, law))
        .collect();
    let faults: Vec<_> = runs
        .into_par_iter()
        .map(|trial| verdict(trial).fault)
        .collect();
    faults.into_iter().collect()
}

//! Random runs of a law: which are drawn, and what became of them.
//!
//! Every run is drawn from its kind and its number alone, so any can be run again, and a
//! campaign goes on where it was stopped.

use std::f64::consts::TAU;

use control::config::Law;
use control::criterion::Device;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::Controller;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use crate::closed_loop::SceneError;
use crate::drive::Drive;
use crate::hand::Hand;
use crate::hold::State;
use crate::trial::{Sampled, Trial, Verdict};

/// What is drawn. Ranges are log-uniform but where they begin at 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// A knob hits a wall anywhere in a count.
    Wall,
    /// A knob flies into a spring.
    Spring,
    /// A knob is let go at rest from a loaded spring.
    Release,
    /// A knob turns over detents 0.05 to 0.55 rad apart.
    Detent,
    /// The four above, with one or more of delay, amplifier lag, DAC steps, jitter, missed
    /// ticks and a torque limit, which the controller is told of.
    Loop,
    /// The four above; demand, law, shape and centre change at random times.
    Changes,
    /// A hand of 1e-6 to 1e-4 kg m² and 1e-5 to 1e-2 Nm s/rad leans on a wall with 0.3 c to 60 c.
    Push,
    /// Such a hand of up to 1e-3 kg m² with a spring of 1e-3 to 2 Nm/rad, in contact with any shape.
    Hand,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Wall,
        Self::Spring,
        Self::Release,
        Self::Detent,
        Self::Loop,
        Self::Changes,
        Self::Push,
        Self::Hand,
    ];

    /// As a user writes it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Wall => "wall",
            Self::Spring => "spring",
            Self::Release => "release",
            Self::Detent => "detent",
            Self::Loop => "loop",
            Self::Changes => "changes",
            Self::Push => "push",
            Self::Hand => "hand",
        }
    }
}

/// Random numbers of one run.
pub struct Draw {
    random: Pcg64,
}

impl Draw {
    /// Those of run `number` of a kind in the campaign `seed`.
    #[must_use]
    pub fn new(seed: u64, kind: Kind, number: u64) -> Self {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&seed.to_le_bytes());
        bytes[8..16].copy_from_slice(&number.to_le_bytes());
        bytes[16] = kind as u8;
        let mut random = Pcg64::from_seed(bytes);
        // Neighbouring seeds begin alike.
        for _ in 0..4 {
            let _ = random.next_u64();
        }
        Self { random }
    }

    /// Uniform in 0 (included) to 1 (not).
    pub fn uniform(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.random.next_u64() >> 11) as f64 * STEP
    }

    /// Uniform between two.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Log-uniform between two.
    pub fn log(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// A random device and sampling.
    pub fn sampled(&mut self) -> Sampled {
        Sampled {
            device: Device {
                inertia_kg_m2: self.log(2e-6, 5e-5),
                viscous_nm_s_rad: self.log(1e-6, 1e-4),
                coulomb_nm: self.log(3e-4, 1.5e-2),
            },
            count_rad: TAU / self.log(256.0, 65_536.0),
            period_s: self.log(5e-5, 5e-3),
        }
    }

    /// A hand with up to so much inertia.
    fn hand(&mut self, inertia_kg_m2: f64) -> Hand {
        Hand {
            inertia_kg_m2: self.log(1e-6, inertia_kg_m2),
            damping_nm_s_rad: self.log(1e-5, 1e-2),
            ..Hand::default()
        }
    }

    fn shape(&mut self, kind: Kind, sampled: &Sampled, start: f64) -> Shape {
        let count = sampled.count_rad;
        match kind {
            // As far away as the knob comes in two ticks.
            Kind::Wall => Shape::Wall {
                edge_rad: start + self.between(0.0, 2.0) * count,
            },
            Kind::Spring | Kind::Release => Shape::Spring {
                centre_rad: start + self.between(-1.0, 1.0) * count,
            },
            _ => Shape::Detent {
                centre_rad: start + self.between(-1.0, 1.0) * count,
                period_rad: self.log(0.05, 0.55).max(2.0 * count),
            },
        }
    }

    /// A random trial of a kind under a law.
    pub fn trial(&mut self, kind: Kind, law: Law) -> Trial {
        let sampled = self.sampled();
        let shape_kind = match kind {
            Kind::Push => Kind::Wall,
            Kind::Loop | Kind::Changes | Kind::Hand => {
                [Kind::Wall, Kind::Spring, Kind::Release, Kind::Detent]
                    [(self.uniform() * 4.0) as usize % 4]
            }
            kind => kind,
        };
        let position = self.between(-1.0, 1.0) * sampled.count_rad;
        let mut start = State {
            position,
            velocity: self.log(0.05, 60.0),
        };
        let shape = self.shape(shape_kind, &sampled, position);
        let config = sampled.config(law, shape, self.log(1e-2, 1e4));
        if shape_kind == Kind::Release {
            // As far out as turns into that speed.
            let stiffness = config.stiffness_nm_rad.min(sampled.holding_nm_rad());
            let out = start.velocity * (sampled.device.inertia_kg_m2 / stiffness).sqrt();
            start.position += out.max(0.5 * sampled.count_rad);
            start.velocity = 0.0;
        }
        let mut scene = sampled.scene(config, start, 4_000);
        match kind {
            Kind::Loop => self.imperfections(&mut scene),
            Kind::Push => {
                scene.hand = self.hand(1e-4);
                scene.hand.push_nm = self.log(0.3, 60.0) * sampled.device.coulomb_nm;
            }
            Kind::Hand => {
                scene.hand = self.hand(1e-3);
                scene.hand.stiffness_nm_rad = self.log(1e-3, 2.0);
                scene.hand.rest_rad = start.position;
            }
            _ => {}
        }
        let history = if shape_kind == Kind::Release { 0 } else { 9 };
        Trial { scene, history }
    }

    /// Some of what a real loop has, and the controller's knowledge of it.
    fn imperfections(&mut self, scene: &mut crate::closed_loop::Scene) {
        let period_s = scene.clock.period_s;
        let coulomb_nm = scene.device.coulomb_nm;
        let timing = &mut scene.config.timing;
        let mut drive = Drive::default();
        if self.chance(0.4) {
            scene.clock.jitter_s = self.between(0.0, 0.3) * period_s;
            timing.jitter_s = scene.clock.jitter_s;
        }
        if self.chance(0.4) {
            drive.delay_s = self.uniform() * timing.shortest_s();
            timing.delay_s = drive.delay_s;
        }
        if self.chance(0.4) {
            drive.amplifier_tau_s = self.log(0.02, 2.0) * period_s;
            timing.amplifier_tau_s = drive.amplifier_tau_s;
        }
        if self.chance(0.3) {
            scene.clock.missed_ticks = self.log(1e-3, 0.2);
            timing.may_miss = true;
        }
        if self.chance(0.4) {
            drive.torque_step_nm = self.log(1e-2, 2.0) * coulomb_nm;
            scene.config.torque_step_nm = drive.torque_step_nm;
        }
        if self.chance(0.3) {
            scene.config.torque_max_nm = self.log(0.5, 100.0) * coulomb_nm;
        }
        scene.drive = drive;
        scene.seed = self.random.next_u64();
    }

    /// Runs a trial whose demand, law, shape and centre change, on average every 40 ticks.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_with_changes(&mut self, trial: &Trial) -> Result<Verdict, SceneError> {
        let scene = &trial.scene;
        let plan = Plan::new(&scene.config)?;
        let sampled = Sampled {
            device: scene.device,
            count_rad: scene.config.hardware_count_rad,
            period_s: scene.clock.period_s,
        };
        let mut controller = Controller::new(plan, scene.start_count());
        controller.release();
        let mut config = scene.config;
        let mut changes = 40;
        trial.run_under(
            |counter, duration_s| {
                if changes > 0 && self.chance(1.0 / 40.0) {
                    changes -= 1;
                    let here = f64::from(counter as i32) * sampled.count_rad;
                    match (self.uniform() * 4.0) as u32 {
                        0 => config.stiffness_nm_rad = self.log(1e-2, 1e4),
                        1 => {
                            config.law = [Law::Static, Law::Episode, Law::Ledger, Law::Auto]
                                [(self.uniform() * 4.0) as usize % 4];
                        }
                        _ => {
                            let kind = [Kind::Wall, Kind::Spring, Kind::Detent]
                                [(self.uniform() * 3.0) as usize % 3];
                            let there = here + self.between(-30.0, 30.0) * sampled.count_rad;
                            config.shape = self.shape(kind, &sampled, there);
                        }
                    }
                    if let Ok(plan) = Plan::new(&config) {
                        controller.adopt(plan);
                    }
                }
                controller.tick(counter, duration_s)
            },
            0.0,
        )
    }

    /// Runs a random trial of a kind.
    ///
    /// # Errors
    /// See [`SceneError`]; none of what is drawn is refused.
    pub fn run(&mut self, kind: Kind, law: Law) -> Result<Verdict, SceneError> {
        let trial = self.trial(kind, law);
        if kind == Kind::Changes {
            self.run_with_changes(&trial)
        } else {
            trial.run()
        }
    }
}

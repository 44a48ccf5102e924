//! Random and systematic runs of a law, and what counts as bad.

use control::ConfigError;
use control::config::{Believed, Config, Law, Timing};
use control::criterion::Device;
use control::encoder::EncoderConfig;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::{Controller, Tick};

use crate::clock::Clock;
use crate::closed_loop::{Potential, Report, Scene, SceneError};
use crate::drive::Drive;
use crate::hand::Hand;
use crate::hold::State;
use crate::outcome::Class;

/// A device and how it is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampled {
    /// Inertia and friction.
    pub device: Device<f64>,
    /// Δ, rad.
    pub count_rad: f64,
    /// T, s.
    pub period_s: f64,
}

impl Sampled {
    /// What a controller is told of it: the truth.
    #[must_use]
    pub fn config(&self, law: Law, shape: Shape, stiffness_nm_rad: f64) -> Config {
        Config {
            believed: Believed::exactly(&self.device),
            timing: Timing::ideal(self.period_s),
            torque_step_nm: 0.0,
            hardware_count_rad: self.count_rad,
            encoder: EncoderConfig::default(),
            shape,
            stiffness_nm_rad,
            damping_nm_s_rad: 0.0,
            law,
            torque_max_nm: f64::from(f32::MAX),
        }
    }

    /// m/T², Nm/rad: a stiffer spring throws the knob past its zero within a tick.
    #[must_use]
    pub fn holding_nm_rad(&self) -> f64 {
        self.device.inertia_kg_m2 / (self.period_s * self.period_s)
    }

    /// A run of it without hand, drive and jitter.
    #[must_use]
    pub fn scene(&self, config: Config, start: State, samples: u64) -> Scene {
        Scene {
            device: self.device,
            drive: Drive::default(),
            clock: Clock::even(self.period_s),
            hand: Hand::default(),
            config,
            start,
            samples,
            seed: 1,
        }
    }
}

/// A scene, and how much of the past the controller has seen when it begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// What is run; its samples are extended where they do not suffice.
    pub scene: Scene,
    /// Ticks of free motion at the start's velocity that the controller has seen before.
    pub history: u32,
}

/// What is wrong with a run of a law that ought to be passive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Fault {
    /// Diverges.
    Growth,
    /// Gives energy out.
    GivenOut,
    /// A sustained oscillation.
    LimitCycle,
    /// Has not settled, however long it was run.
    Unsettled,
}

/// How a trial ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// The run.
    pub report: Report,
    /// Motor work less friction at its most, less what was stored at the start, J.
    pub excess_j: f64,
    /// The energy that it is measured against, J.
    pub scale_j: f64,
    /// Torque at the end, Nm.
    pub end_torque_nm: f64,
    /// What is wrong, if anything is.
    pub fault: Option<Fault>,
}

/// Rounding of the account in `f32`, as a part of the energy in play.
const ROUNDING: f64 = 1e-6;

/// A run is extended up to this many times its samples.
const EXTENSION: u64 = 256;

impl Trial {
    /// Runs the trial under the controller of its configuration.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run(&self) -> Result<Verdict, SceneError> {
        self.run_plan(Plan::new(&self.scene.config)?)
    }

    /// The same with a plan made elsewhere, for studies.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_plan(&self, plan: Plan) -> Result<Verdict, SceneError> {
        let scene = &self.scene;
        let mut controller = self.controller(plan)?;
        let at_rest = self.history == 0 && scene.start.velocity == 0.0;
        let stored_j = if at_rest {
            let potential = Potential::new(&scene.config.shape, scene.config.count_rad());
            plan.applied_limit_nm_rad() * potential.per_stiffness(scene.start.position)
        } else {
            0.0
        };
        self.run_under(
            |counter, duration_s| controller.tick(counter, duration_s),
            stored_j,
        )
    }

    /// The controller at the first sample, with the past that it has seen.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn controller(&self, plan: Plan) -> Result<Controller, SceneError> {
        let scene = &self.scene;
        let count = |tick: u32| {
            let past = f64::from(tick) * scene.clock.period_s * scene.start.velocity;
            ((scene.start.position - past) / scene.config.hardware_count_rad).floor() as i64 as i32
        };
        let mut controller = scene.controller(plan);
        if self.history > 0 {
            // Nothing demanded, so the torque is off.
            let idle = Config {
                stiffness_nm_rad: 0.0,
                damping_nm_s_rad: 0.0,
                ..scene.config
            };
            controller = Controller::new(Plan::new(&idle)?, count(self.history + 1));
            for tick in (1..=self.history).rev() {
                let _ = controller.tick(count(tick) as u32, scene.clock.period_s as f32);
            }
            controller.adopt(plan);
        }
        Ok(controller)
    }

    /// Runs the trial under any control that has `stored_j` in its spring at the start.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_under(
        &self,
        control: impl FnMut(u32, f32) -> Tick,
        stored_j: f64,
    ) -> Result<Verdict, SceneError> {
        let mut scene = self.scene;
        let samples = scene.samples;
        scene.samples = samples * EXTENSION;
        let edge = match scene.config.shape {
            Shape::Wall { edge_rad } if scene.hand == Hand::default() => edge_rad,
            _ => f64::NEG_INFINITY,
        };
        let away = edge - 2.0 * scene.config.count_rad();
        let mut end_torque_nm = 0.0;
        let mut left = false;
        // Reversals in each run of `samples`, to tell a cycle long before the end.
        let report = scene.run_under(control, |sample| {
            end_torque_nm = f64::from(sample.tick.torque_nm);
            let State { position, velocity } = sample.state;
            left = position < away
                && velocity <= 0.0
                && sample.tick.torque_nm == 0.0
                && sample.number > 0;
            !left
        })?;
        let kinetic = 0.5 * scene.device.inertia_kg_m2 * scene.start.velocity.powi(2);
        let excess_j = report.given_out_j - stored_j;
        let scale_j = kinetic
            + stored_j
            + scene.device.coulomb_nm * scene.config.count_rad()
            + scene.hand.push_nm.abs() * (report.peak_angle_rad + scene.start.position.abs());
        let fault = if report.class == Class::Unstable {
            Some(Fault::Growth)
        } else if excess_j > ROUNDING * scale_j {
            Some(Fault::GivenOut)
        } else if report.class == Class::LimitCycle {
            Some(Fault::LimitCycle)
        } else if report.class == Class::Undecided && !left {
            Some(Fault::Unsettled)
        } else {
            None
        };
        Ok(Verdict {
            report,
            excess_j,
            scale_j,
            end_torque_nm,
            fault,
        })
    }
}

/// The largest stiffness that Abbott and Okamura (2005) allow: min(2b/T, 2c/Δ), Nm/rad.
///
/// # Errors
/// Refuses what is no device.
pub fn abbott_okamura(sampled: &Sampled) -> Result<f64, ConfigError> {
    let sampling = control::criterion::Sampling {
        period_s: sampled.period_s,
        count_rad: sampled.count_rad,
    };
    Ok(control::criterion::Criterion::new(sampled.device, sampling)?.largest_stiffness())
}

//! Random and systematic runs of a law, and what counts as bad.

use std::cell::Cell;

use control::ConfigError;
use control::config::{Believed, Config, Law, Timing};
use control::criterion::Device;
use control::encoder::EncoderConfig;
use control::motion::Motion;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::{Controller, Tick};
use control::tuning::Tuning;

use crate::clock::Clock;
use crate::closed_loop::{Potential, Report, Sample, Scene, SceneError};
use crate::drive::Drive;
use crate::hand::Hand;
use crate::hold::State;
use crate::knob::Interval;
use crate::motor::Motor;
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
            motor: Motor::default(),
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
    /// A run is extended up to this many times its samples.
    pub extension: u64,
    /// A run ends when it has given out a good part of the energy in play, so that growth is not told apart.
    pub hasty: bool,
}

/// As much of the energy in play, given out, is no rounding.
const PLAINLY: f64 = 1e-3;

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

impl Verdict {
    /// Energy given out as a share of the energy in play; above [`ROUNDING`] it is a violation.
    #[must_use]
    pub fn excess(&self) -> f64 {
        self.excess_j / self.scale_j
    }
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Growth,
        Self::GivenOut,
        Self::LimitCycle,
        Self::Unsettled,
    ];

    /// As scripts see it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Growth => "growth",
            Self::GivenOut => "given-out",
            Self::LimitCycle => "limit-cycle",
            Self::Unsettled => "unsettled",
        }
    }
}

/// Rounding of the account in `f32`, as a part of the energy in play.
pub const ROUNDING: f64 = 1e-6;

/// As far as a run is extended, unless told otherwise.
pub const EXTENSION: u64 = 256;

/// A motion whose peaks fall to this part in half the run fades: a heavy hand that
/// bounces with hardly any damping, for instance, is no cycle of the law's.
const FADING: f64 = 0.9;

/// A knob that creeps by less than this, counts per tick, under a torque that does not change for
/// [`SETTLED_TICKS`], stands: of a hand's spring it would never come to rest in floating point.
const CREEPING_COUNTS: f64 = 1e-9;

/// Ticks that tell that it stands.
const SETTLED_TICKS: u32 = 100;

impl Trial {
    /// Runs the trial under the controller of its configuration.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run(&self) -> Result<Verdict, SceneError> {
        self.run_plan(Plan::new(&self.scene.config)?)
    }

    /// The same with other constants of the ledger, for studies.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_tuned(&self, tuning: Tuning) -> Result<Verdict, SceneError> {
        self.run_plan(Plan::with_tuning(&self.scene.config, tuning)?)
    }

    /// The same with a plan made elsewhere, for studies.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_plan(&self, plan: Plan) -> Result<Verdict, SceneError> {
        let mut controller = self.controller(plan)?;
        self.run_under(
            |counter, duration_s| controller.tick(counter, duration_s),
            self.stored_j(&plan),
        )
    }

    /// The same; `observe` sees every sample and what the controller believed of the motion in it,
    /// and may end the run by returning false.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn watch(
        &self,
        plan: Plan,
        mut observe: impl FnMut(&Sample, Option<&Motion>) -> bool,
    ) -> Result<Verdict, SceneError> {
        let mut controller = self.controller(plan)?;
        let believed = Cell::new(None);
        self.watch_under(
            |counter, duration_s| {
                let tick = controller.tick(counter, duration_s);
                believed.set(controller.motion().copied());
                tick
            },
            self.stored_j(&plan),
            |sample| observe(sample, believed.get().as_ref()),
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
        if self.history == 0 {
            return Ok(scene.controller(plan));
        }
        // Nothing demanded, so the torque is off.
        let idle = Config {
            stiffness_nm_rad: 0.0,
            damping_nm_s_rad: 0.0,
            ..scene.config
        };
        let mut controller = Controller::new(Plan::new(&idle)?, count(self.history + 1));
        for tick in (1..=self.history).rev() {
            let _ = controller.tick(count(tick) as u32, scene.clock.period_s as f32);
        }
        controller.adopt(plan);
        Ok(controller)
    }

    /// What the spring stores at the start, as far as the controller may know of it.
    pub(crate) fn stored_j(&self, plan: &Plan) -> f64 {
        let scene = &self.scene;
        if self.history > 0 || scene.start.velocity != 0.0 {
            return 0.0;
        }
        let potential = Potential::new(&scene.config.shape, scene.config.count_rad());
        plan.applied_limit_nm_rad() * potential.per_stiffness(scene.start.position)
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
        self.watch_under(control, stored_j, |_| true)
    }

    /// The same; `observe` sees every sample and may end the run by returning false.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn watch_under(
        &self,
        control: impl FnMut(u32, f32) -> Tick,
        stored_j: f64,
        observe: impl FnMut(&Sample) -> bool,
    ) -> Result<Verdict, SceneError> {
        self.scene.check()?;
        let mut knob = self.scene.knob()?;
        let hold = |torque_nm: f64, duration_s: f64| knob.hold(torque_nm, duration_s);
        self.watch_on(hold, control, stored_j, observe)
    }

    /// Runs the trial under the controller of its configuration on another plant: see [`Scene::run_on`].
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_on(&self, hold: impl FnMut(f64, f64) -> Interval) -> Result<Verdict, SceneError> {
        let plan = Plan::new(&self.scene.config)?;
        let mut controller = self.controller(plan)?;
        self.watch_on(
            hold,
            |counter, duration_s| controller.tick(counter, duration_s),
            self.stored_j(&plan),
            |_| true,
        )
    }

    fn watch_on(
        &self,
        hold: impl FnMut(f64, f64) -> Interval,
        control: impl FnMut(u32, f32) -> Tick,
        stored_j: f64,
        mut observe: impl FnMut(&Sample) -> bool,
    ) -> Result<Verdict, SceneError> {
        let mut scene = self.scene;
        scene.samples *= self.extension;
        let edge = match scene.config.shape {
            Shape::Wall { edge_rad } if scene.hand == Hand::default() => edge_rad,
            _ => f64::NEG_INFINITY,
        };
        let away = edge - 2.0 * scene.config.count_rad();
        let creeping = CREEPING_COUNTS * scene.config.count_rad() / scene.clock.period_s;
        let mut end_torque_nm = 0.0;
        let mut touched = 0;
        let mut settled = false;
        let mut standing = 0;
        let mut furthest = 0.0_f64;
        let scale_j = |furthest_rad: f64| {
            0.5 * scene.device.inertia_kg_m2 * scene.start.velocity.powi(2)
                + stored_j
                + scene.device.coulomb_nm * scene.config.count_rad()
                + scene.hand.push_nm.abs() * (furthest_rad + scene.start.position.abs())
        };
        let report = scene.run_on(hold, control, |sample| {
            let torque_nm = f64::from(sample.tick.torque_nm);
            let State { position, velocity } = sample.state;
            if torque_nm != 0.0 {
                touched = sample.number;
            }
            if velocity.abs() < creeping && torque_nm == end_torque_nm {
                standing += 1;
            } else {
                standing = 0;
            }
            end_torque_nm = torque_nm;
            let left = position < away && velocity <= 0.0 && torque_nm == 0.0 && sample.number > 0;
            settled = left || standing == SETTLED_TICKS;
            furthest = furthest.max(position.abs());
            let given_j = sample.motor_work_j - sample.friction_j - stored_j;
            let plainly = self.hasty && given_j > PLAINLY * scale_j(furthest);
            observe(sample) && !settled && !plainly
        })?;
        let excess_j = report.given_out_j - stored_j;
        let scale_j = scale_j(report.peak_angle_rad);
        let fault = if report.class == Class::Unstable {
            Some(Fault::Growth)
        } else if excess_j > ROUNDING * scale_j {
            Some(Fault::GivenOut)
        } else if report.late_growth < FADING || touched < scene.samples / 8 * 7 {
            None // it settles, however slowly, or flies where nothing is rendered
        } else if report.class == Class::LimitCycle {
            Some(Fault::LimitCycle)
        } else if report.class == Class::Undecided && !settled {
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

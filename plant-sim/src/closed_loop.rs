//! A knob in physical units: the exact plant (`f64`) turned by the controller that a
//! board runs ([`control::tick`], `f32`).

use control::ConfigError;
use control::config::Config;
use control::criterion::Device;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::{Controller, Tick};

use crate::clock::{Clock, ClockError};
use crate::drive::Drive;
use crate::energy::{self, Exchange, Ledger};
use crate::hand::Hand;
use crate::hold::State;
use crate::knob::{Interval, Knob, KnobError};
use crate::motor::Motor;
use crate::outcome::{Class, DIVERGED_COUNTS, Peaks};

/// A knob at rest for this many samples has come to rest.
const REST_SAMPLES: u64 = 100;

/// Kinetic energy beyond this many times the energy at the start is divergence.
const DIVERGED_ENERGY: f64 = 30.0;

/// Velocity reversals in the last eighth of a run that make an oscillation.
const OSCILLATION_REVERSALS: u64 = 6;

/// A knob, what controls it, and how it starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// The plant as it truly is.
    pub device: Device<f64>,
    /// Its cogging and stiction.
    pub motor: Motor,
    /// What the torque goes through, as it truly is.
    pub drive: Drive,
    /// When ticks truly run.
    pub clock: Clock,
    /// The hand on the knob.
    pub hand: Hand,
    /// What the controller is told.
    pub config: Config,
    /// Angle (rad) and velocity (rad/s) at the first sample.
    pub start: State,
    /// The longest run, samples.
    pub samples: u64,
    /// For what is random.
    pub seed: u64,
}

/// One sample of a run: the state it found and what the controller decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Its number.
    pub number: u64,
    /// When it is, s; k·T without jitter.
    pub time_s: f64,
    /// Angle and velocity, as they truly are.
    pub state: State,
    /// The controller's answer.
    pub tick: Tick,
    /// Work of the motor until now, J.
    pub motor_work_j: f64,
    /// What the knob's friction has taken until now, J.
    pub friction_j: f64,
}

/// What a run did. Energies in J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Rest: stood still for 100 samples. Unstable: kinetic energy beyond 30 times the
    /// start's (plus K Δ²), more than 1e9 counts away, or growing by the window rule. Limit
    /// cycle: 6 or more reversals in the last eighth. Else undecided.
    pub class: Class,
    /// Samples run.
    pub samples: u64,
    /// Angle and velocity at the end.
    pub end: State,
    /// The largest angle reached, in magnitude; between samples too, rad.
    pub peak_angle_rad: f64,
    /// The largest torque commanded, in magnitude, Nm.
    pub peak_torque_nm: f64,
    /// The smallest passivity margin of any tick, Nm.
    pub min_margin_nm: f64,
    /// The smallest stiffness applied, Nm/rad.
    pub min_stiffness_nm_rad: f64,
    /// The largest stiffness applied, Nm/rad.
    pub max_stiffness_nm_rad: f64,
    /// Kinetic energy plus the potential (16) of the demanded profile at the start.
    pub energy_start_j: f64,
    /// Largest kinetic energy − `energy_start_j` − work of the hand over the run; at most 0
    /// if passive.
    pub energy_excess_j: f64,
    /// Largest work of the motor − what the knob's friction took over the run: what was given
    /// out, whatever the springs store.
    pub given_out_j: f64,
    /// Work of the hand on the knob, J.
    pub hand_work_j: f64,
    /// Generated, dissipated and given out beyond the potential of the applied profile.
    pub ledger: Ledger,
    /// The least and the most that the ledger's account held, J.
    pub account_j: [f64; 2],
    /// Changes of the direction of motion in the last eighth of `Scene::samples`.
    pub reversals_last_eighth: u64,
    /// Peak speed in the last eighth of `Scene::samples` over that in the fourth: below 1 the
    /// motion fades.
    pub late_growth: f64,
}

/// Why a scene cannot be run.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// The configuration is not one.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The device, the hand or the drive is not one.
    #[error(transparent)]
    Knob(#[from] KnobError),
    /// The clock is not one.
    #[error(transparent)]
    Clock(#[from] ClockError),
    /// The start is not finite or out of the counts' reach.
    #[error(
        "start.angle_rad is {angle_rad}; accepted: a finite angle within ±{limit_rad} rad, 2^31 hardware counts"
    )]
    Angle {
        /// What was given.
        angle_rad: f64,
        /// The largest magnitude accepted.
        limit_rad: f64,
    },
    /// The start's velocity is not finite or too fast to count.
    #[error(
        "start.velocity_rad_s is {velocity_rad_s}; accepted: a finite velocity within ±{limit_rad_s} rad/s, \
         2^30 hardware counts per sample"
    )]
    Velocity {
        /// What was given.
        velocity_rad_s: f64,
        /// The largest magnitude accepted.
        limit_rad_s: f64,
    },
}

impl Scene {
    /// Runs the scene. `observe` sees every sample and may end the run by returning false.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run(&self, observe: impl FnMut(&Sample) -> bool) -> Result<Report, SceneError> {
        let plan = Plan::new(&self.config)?;
        let mut controller = self.controller(plan);
        self.run_under(
            |counter, duration_s| controller.tick(counter, duration_s),
            observe,
        )
    }

    /// A controller for the start, which knows of a start at rest.
    #[must_use]
    pub fn controller(&self, plan: Plan) -> Controller {
        if self.start.velocity == 0.0 {
            Controller::at_rest(plan, self.start_count())
        } else {
            Controller::new(plan, self.start_count())
        }
    }

    /// The hardware count at the start, wrapped to 32 bits.
    #[must_use]
    pub fn start_count(&self) -> i32 {
        (self.start.position / self.config.hardware_count_rad).floor() as i64 as i32
    }

    /// Runs the scene under any control: `control` takes the hardware counter and the time since
    /// the last sample. The configuration says what is rendered, and how energy is reckoned.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_under(
        &self,
        control: impl FnMut(u32, f32) -> Tick,
        observe: impl FnMut(&Sample) -> bool,
    ) -> Result<Report, SceneError> {
        self.check()?;
        let mut knob = self.knob()?;
        let hold = |torque_nm: f64, duration_s: f64| knob.hold(torque_nm, duration_s);
        Ok(self.run_plant(hold, control, observe))
    }

    /// The same on another plant: `hold` moves the scene's device, from its start, under a commanded torque
    /// (Nm) for a time (s). See [`crate::driven`].
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn run_on(
        &self,
        hold: impl FnMut(f64, f64) -> Interval,
        control: impl FnMut(u32, f32) -> Tick,
        observe: impl FnMut(&Sample) -> bool,
    ) -> Result<Report, SceneError> {
        self.check()?;
        Ok(self.run_plant(hold, control, observe))
    }

    /// Refuses a clock that is none, and a start that cannot be counted.
    pub(crate) fn check(&self) -> Result<(), SceneError> {
        self.clock.check()?;
        self.check_start()
    }

    /// The knob at its start.
    pub(crate) fn knob(&self) -> Result<Knob, KnobError> {
        Knob::new(
            &self.device,
            &self.motor,
            &self.hand,
            &self.drive,
            self.clock.period_s,
            self.start,
        )
    }

    /// [`Scene::run_on`] of a scene that was checked.
    pub(crate) fn run_plant(
        &self,
        mut hold: impl FnMut(f64, f64) -> Interval,
        mut control: impl FnMut(u32, f32) -> Tick,
        mut observe: impl FnMut(&Sample) -> bool,
    ) -> Report {
        let config = &self.config;
        let count_rad = config.count_rad();
        let hardware_count = |angle: f64| (angle / config.hardware_count_rad).floor() as i64;
        let potential = Potential::new(&config.shape, count_rad);
        let kinetic = |state: State| energy::kinetic(self.device.inertia_kg_m2, state.velocity);
        let energy_start_j = kinetic(self.start)
            + config.stiffness_nm_rad * potential.per_stiffness(self.start.position);
        let speed_counts = config.timing.period_s / count_rad;

        let mut state = self.start;
        let mut report = Report {
            class: Class::Undecided,
            samples: 0,
            end: state,
            peak_angle_rad: state.position.abs(),
            peak_torque_nm: 0.0,
            min_margin_nm: f64::INFINITY,
            min_stiffness_nm_rad: f64::INFINITY,
            max_stiffness_nm_rad: 0.0,
            energy_start_j,
            energy_excess_j: kinetic(state) - energy_start_j,
            given_out_j: 0.0,
            hand_work_j: 0.0,
            ledger: Ledger::default(),
            account_j: [f64::INFINITY, f64::NEG_INFINITY],
            reversals_last_eighth: 0,
            late_growth: 0.0,
        };
        // Motor work less friction: kinetic energy less the start's and less the hand's work.
        let mut given_j = 0.0;
        let (mut motor_work_j, mut friction_j) = (0.0, 0.0);
        let mut ticks = self.clock.ticks(self.seed);
        let mut duration_s = self.clock.period_s;
        let mut time_s = 0.0;
        let mut peaks = Peaks::new(self.samples);
        let eighth = self.samples / 8;
        let (mut fourth_peak, mut last_peak) = (0.0_f64, 0.0_f64);
        let mut at_rest = 0;
        let mut direction = state.velocity;
        let decided = loop {
            let number = report.samples;
            if number >= 7 * eighth {
                last_peak = last_peak.max(state.velocity.abs());
            } else if number >= 3 * eighth && number < 4 * eighth {
                fourth_peak = fourth_peak.max(state.velocity.abs());
            }
            peaks.enter(number, state.velocity.abs() * speed_counts);
            if at_rest == REST_SAMPLES {
                break Some(Class::Rest);
            }
            // Of the start's energy and what a count of the spring stores.
            let scale_j = energy_start_j + report.max_stiffness_nm_rad * count_rad * count_rad;
            if given_j + kinetic(self.start) > DIVERGED_ENERGY * scale_j
                || (state.position / count_rad).abs() > DIVERGED_COUNTS
            {
                break Some(Class::Unstable);
            }
            if number == self.samples {
                break None;
            }
            let tick = control(hardware_count(state.position) as u32, duration_s as f32);
            let stiffness = f64::from(tick.stiffness_nm_rad);
            let torque = f64::from(tick.torque_nm);
            let account_j = f64::from(tick.account_j);
            report.peak_torque_nm = report.peak_torque_nm.max(torque.abs());
            report.min_margin_nm = report.min_margin_nm.min(f64::from(tick.margin_nm));
            report.min_stiffness_nm_rad = report.min_stiffness_nm_rad.min(stiffness);
            report.max_stiffness_nm_rad = report.max_stiffness_nm_rad.max(stiffness);
            report.account_j = [
                report.account_j[0].min(account_j),
                report.account_j[1].max(account_j),
            ];
            if !observe(&Sample {
                number,
                time_s,
                state,
                tick,
                motor_work_j,
                friction_j,
            }) {
                break None;
            }

            duration_s = ticks.next().unwrap_or(self.clock.period_s);
            time_s += duration_s;
            let interval = hold(torque, duration_s);
            let potential_change = potential.per_stiffness(interval.end.position)
                - potential.per_stiffness(state.position);
            report.ledger.enter(Exchange {
                generated: interval.motor_work_j + stiffness * potential_change,
                dissipated: interval.friction_j,
            });
            given_j += interval.motor_work_j - interval.friction_j;
            motor_work_j += interval.motor_work_j;
            friction_j += interval.friction_j;
            report.given_out_j = report.given_out_j.max(given_j);
            report.hand_work_j += interval.hand_work_j;
            report.peak_angle_rad = report.peak_angle_rad.max(interval.furthest_rad);
            state = interval.end;
            report.samples = number + 1;
            report.energy_excess_j = report
                .energy_excess_j
                .max(given_j + kinetic(self.start) - energy_start_j);
            at_rest = if state.velocity == 0.0 {
                at_rest + 1
            } else {
                0
            };
            if state.velocity * direction < 0.0 && report.samples > self.samples - self.samples / 8
            {
                report.reversals_last_eighth += 1;
            }
            if state.velocity != 0.0 {
                direction = state.velocity.signum();
            }
        };
        report.end = state;
        report.late_growth = if fourth_peak > 0.0 {
            last_peak / fourth_peak
        } else {
            0.0
        };
        report.class = decided.unwrap_or_else(|| {
            let by_windows = peaks.classes(state.velocity.abs() * speed_counts).window;
            if report.samples < self.samples {
                Class::Undecided
            } else if by_windows == Class::Unstable {
                Class::Unstable
            } else if report.reversals_last_eighth >= OSCILLATION_REVERSALS {
                Class::LimitCycle
            } else if by_windows == Class::Rest {
                Class::Rest
            } else {
                Class::Undecided
            }
        });
        report
    }

    /// The largest speed that the start can turn into under a spring of `stiffness_nm_rad`:
    /// see [`energy::reachable_speed`]. rad/s.
    #[must_use]
    pub fn reachable_speed_rad_s(&self, stiffness_nm_rad: f64) -> f64 {
        let potential = Potential::new(&self.config.shape, self.config.count_rad());
        let position = (2.0 * potential.smooth(self.start.position)).sqrt();
        let start = State {
            position,
            ..self.start
        };
        energy::reachable_speed(start, stiffness_nm_rad, self.device.inertia_kg_m2)
    }

    fn check_start(&self) -> Result<(), SceneError> {
        let State { position, velocity } = self.start;
        let count = self.config.hardware_count_rad;
        let limit_rad = count * f64::from(1_u32 << 31);
        if position.is_nan() || position.abs() >= limit_rad {
            return Err(SceneError::Angle {
                angle_rad: position,
                limit_rad,
            });
        }
        let limit_rad_s = count / self.clock.period_s * f64::from(1_u32 << 30);
        if velocity.is_nan() || velocity.abs() > limit_rad_s {
            return Err(SceneError::Velocity {
                velocity_rad_s: velocity,
                limit_rad_s,
            });
        }
        Ok(())
    }
}

/// The potential (16) of a quantised profile with its zero anywhere, over stiffness.
///
/// In every cell the torque is constant, so the potential is linear. For a detent of period p
/// the sum of the cells' sines is closed: at a count edge x it is
/// A·(1 − cos(2π(x − centre)/p)), A = (p/2π)·Δ/(2 sin(πΔ/p)).
pub(crate) struct Potential {
    shape: Shape,
    /// Centre or wall, counts.
    zero: f64,
    count_rad: f64,
}

impl Potential {
    pub(crate) fn new(shape: &Shape, count_rad: f64) -> Self {
        Self {
            shape: *shape,
            zero: shape.zero_rad() / count_rad,
            count_rad,
        }
    }

    /// Potential over stiffness at an angle, rad²; 0 where the torque changes its sign, of a
    /// detent at a minimum on a count edge.
    pub(crate) fn per_stiffness(&self, angle_rad: f64) -> f64 {
        let xi = angle_rad / self.count_rad;
        if let Shape::Detent {
            centre_rad,
            period_rad,
        } = self.shape
        {
            let turn = std::f64::consts::TAU / period_rad;
            let amplitude = 1.0 / turn;
            let edge = xi.floor() * self.count_rad - centre_rad;
            let height = amplitude * self.count_rad / (2.0 * (0.5 * turn * self.count_rad).sin());
            let slope = amplitude * (turn * (edge + 0.5 * self.count_rad)).sin();
            return height * (1.0 - (turn * edge).cos())
                + slope * (xi - xi.floor()) * self.count_rad;
        }
        // The lower edge of the first cell whose middle lies above the zero.
        let edge = (self.zero + 0.5).floor();
        if matches!(self.shape, Shape::Wall { .. }) && xi < edge {
            return 0.0;
        }
        let counts2 = energy::quantised_potential(xi)
            - energy::quantised_potential(edge)
            - self.zero * (xi - edge);
        counts2 * self.count_rad * self.count_rad
    }

    /// The same of the profile before quantisation: ½q², of a detent (p/2π)²(1 − cos(2πq/p)).
    fn smooth(&self, angle_rad: f64) -> f64 {
        let deflection = angle_rad - self.shape.zero_rad();
        match self.shape {
            Shape::Spring { .. } => 0.5 * deflection * deflection,
            Shape::Wall { .. } => 0.5 * deflection.max(0.0).powi(2),
            Shape::Detent { period_rad, .. } => {
                let turn = std::f64::consts::TAU / period_rad;
                (1.0 - (turn * deflection).cos()) / (turn * turn)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_potential_is_the_integral_of_the_torque() {
        for zero in [0.0, 0.3, 0.5, 0.8, -2.7, -0.2, 7.5] {
            let zero_rad: f64 = zero * 0.1;
            for shape in [
                Shape::Spring {
                    centre_rad: zero_rad,
                },
                Shape::Wall { edge_rad: zero_rad },
                Shape::Detent {
                    centre_rad: zero_rad,
                    period_rad: 0.77,
                },
            ] {
                let potential = Potential::new(&shape, 0.1);
                let mut sum = potential.per_stiffness(-1.5);
                // 1000 steps a count, none across an edge: the torque is constant in each.
                for i in -15_000..15_000 {
                    let middle = (f64::from(i) + 0.5) * 1e-4;
                    let q = ((middle / 0.1_f64).floor() + 0.5) * 0.1 - zero_rad;
                    sum += 1e-4
                        * match shape {
                            Shape::Spring { .. } => q,
                            Shape::Wall { .. } => {
                                if q > 1e-12 {
                                    q
                                } else {
                                    0.0
                                }
                            }
                            Shape::Detent { period_rad, .. } => {
                                let turn = std::f64::consts::TAU / period_rad;
                                (turn * q).sin() / turn
                            }
                        };
                    let have = potential.per_stiffness(f64::from(i + 1) * 1e-4);
                    assert!(
                        (have - sum).abs() < 1e-11,
                        "{shape:?} at {i}: {have}, not {sum}"
                    );
                    assert!(have >= -3e-3);
                }
            }
        }
    }
}

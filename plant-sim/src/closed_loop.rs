//! A knob in physical units: the exact plant (`f64`) turned by the controller that a
//! board runs ([`control::tick`], `f32`).

use control::ConfigError;
use control::criterion::Device;
use control::spring::Side;
use control::tick::{Config, Controller, Plan, Tick};

use crate::energy::{self, Exchange, Ledger};
use crate::hold::{Hold, State};
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
    /// What the controller is told.
    pub config: Config,
    /// Angle (rad) and velocity (rad/s) at the first sample.
    pub start: State,
    /// The longest run, samples.
    pub samples: u64,
}

/// One sample of a run: the state it found and what the controller decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Its number; sample k is at k·T.
    pub number: u64,
    /// Angle and velocity, as they truly are.
    pub state: State,
    /// The controller's answer.
    pub tick: Tick,
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
    /// Kinetic energy plus the potential (16) of the demanded spring at the start.
    pub energy_start_j: f64,
    /// Largest kinetic energy − `energy_start_j` over the run; at most 0 if passive.
    pub energy_excess_j: f64,
    /// Generated, dissipated and given out beyond the potential of the applied spring.
    pub ledger: Ledger,
    /// Changes of the direction of motion in the last eighth of `Scene::samples`.
    pub reversals_last_eighth: u64,
}

/// Why a scene cannot be run.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// The device or the configuration is not one.
    #[error(transparent)]
    Config(#[from] ConfigError),
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
    pub fn run(&self, mut observe: impl FnMut(&Sample) -> bool) -> Result<Report, SceneError> {
        let config = &self.config;
        let count_rad = config.count_rad();
        let hold = Hold::new(&self.device, config.period_s)?;
        let hardware_count = |angle: f64| (angle / config.hardware_count_rad).floor() as i64;
        let mut controller = Controller::new(
            Plan::new(config)?,
            hardware_count(self.start.position) as i32,
        );
        self.check_start()?;
        let potential = Potential {
            side: config.side,
            zero: config.zero_rad / count_rad,
            count_rad,
        };

        let energy_start_j = kinetic(&hold, self.start)
            + config.stiffness_nm_rad * potential.per_stiffness(self.start.position);
        let diverged_j =
            DIVERGED_ENERGY * (energy_start_j + config.stiffness_nm_rad * count_rad * count_rad);
        let speed_counts = config.period_s / count_rad;

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
            energy_excess_j: kinetic(&hold, state) - energy_start_j,
            ledger: Ledger::default(),
            reversals_last_eighth: 0,
        };
        let mut peaks = Peaks::new(self.samples);
        let mut at_rest = 0;
        let mut direction = state.velocity;
        let decided = loop {
            let number = report.samples;
            peaks.enter(number, state.velocity.abs() * speed_counts);
            if at_rest == REST_SAMPLES {
                break Some(Class::Rest);
            }
            if kinetic(&hold, state) > diverged_j
                || (state.position / count_rad).abs() > DIVERGED_COUNTS
            {
                break Some(Class::Unstable);
            }
            if number == self.samples {
                break None;
            }
            let tick = controller.tick(hardware_count(state.position) as u32);
            let stiffness = f64::from(tick.stiffness_nm_rad);
            let torque = f64::from(tick.torque_nm);
            report.peak_torque_nm = report.peak_torque_nm.max(torque.abs());
            report.min_margin_nm = report.min_margin_nm.min(f64::from(tick.margin_nm));
            report.min_stiffness_nm_rad = report.min_stiffness_nm_rad.min(stiffness);
            report.max_stiffness_nm_rad = report.max_stiffness_nm_rad.max(stiffness);
            if !observe(&Sample {
                number,
                state,
                tick,
            }) {
                break None;
            }

            let step = hold.step(state, torque);
            let potential_change = potential.per_stiffness(step.end.position)
                - potential.per_stiffness(state.position);
            let generated =
                torque * (step.end.position - state.position) + stiffness * potential_change;
            report.ledger.enter(Exchange {
                generated,
                dissipated: energy::dissipated(&hold, state, torque, &step),
            });
            let furthest = step.turn.map_or(step.end.position, |turn| turn.position);
            report.peak_angle_rad = report
                .peak_angle_rad
                .max(furthest.abs())
                .max(step.end.position.abs());
            state = step.end;
            report.samples = number + 1;
            report.energy_excess_j = report
                .energy_excess_j
                .max(kinetic(&hold, state) - energy_start_j);
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
        Ok(report)
    }

    /// The largest speed that the start can turn into under a spring of `stiffness_nm_rad`:
    /// see [`energy::reachable_speed`]. rad/s.
    #[must_use]
    pub fn reachable_speed_rad_s(&self, stiffness_nm_rad: f64) -> f64 {
        let deflection = self.start.position - self.config.zero_rad;
        let start = State {
            position: match self.config.side {
                Side::Both => deflection,
                Side::Above => deflection.max(0.0),
            },
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
        let limit_rad_s = count / self.config.period_s * f64::from(1_u32 << 30);
        if velocity.is_nan() || velocity.abs() > limit_rad_s {
            return Err(SceneError::Velocity {
                velocity_rad_s: velocity,
                limit_rad_s,
            });
        }
        Ok(())
    }
}

fn kinetic(hold: &Hold, state: State) -> f64 {
    energy::kinetic(hold.inertia(), state.velocity)
}

/// The potential (16) of a quantised spring or wall with its zero anywhere.
struct Potential {
    side: Side,
    /// Centre or wall, counts.
    zero: f64,
    count_rad: f64,
}

impl Potential {
    /// Potential over stiffness at an angle, rad²; 0 where the force changes its sign.
    fn per_stiffness(&self, angle_rad: f64) -> f64 {
        let xi = angle_rad / self.count_rad;
        // The lower edge of the first cell whose middle lies above the zero.
        let edge = (self.zero + 0.5).floor();
        if self.side == Side::Above && xi < edge {
            return 0.0;
        }
        let counts2 = energy::quantised_potential(xi)
            - energy::quantised_potential(edge)
            - self.zero * (xi - edge);
        counts2 * self.count_rad * self.count_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_potential_is_the_integral_of_the_torque() {
        for side in [Side::Both, Side::Above] {
            for zero in [0.0, 0.3, 0.5, 0.8, -2.7, -0.2, 7.5] {
                let potential = Potential {
                    side,
                    zero,
                    count_rad: 0.1,
                };
                let mut sum = potential.per_stiffness(-1.5);
                // 1000 steps a count, none across an edge: the torque is constant in each.
                for i in -15_000..15_000 {
                    let middle = (f64::from(i) + 0.5) * 1e-4;
                    let q = ((middle / 0.1_f64).floor() + 0.5 - zero) * 0.1;
                    if side == Side::Both || q > 0.0 {
                        sum += q * 1e-4;
                    }
                    let have = potential.per_stiffness(f64::from(i + 1) * 1e-4);
                    assert!(
                        (have - sum).abs() < 1e-12,
                        "{side:?} {zero} at {i}: {have}, not {sum}"
                    );
                    assert!(have >= -1e-15);
                }
            }
        }
    }
}

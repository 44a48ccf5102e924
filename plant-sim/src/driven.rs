//! A powered knob under a drive of [`control::torque`]: it brings the torque that a controller holds, for as many
//! PWM periods as a sample has.
//!
//! At the start of each period the currents, the bus and the encoder are read, the drive runs, and its duties act in the
//! next period (with [`Inverter::late`](crate::electrical::Inverter)). A controller's tick runs before the drive
//! at the start of a sample's first period: its torque begins to change one period later.
//!
//! The drive's speed is, as in the firmware, the way of the counts over the last 16 periods, or 32 under voltage control,
//! over their time: wrong by up to a count in it. What that makes of a voltage drive's torque is added to the step
//! that a governor is told; a current loop takes it back within its time constant.
//!
//! The drive is told its motor, its encoder and the dead time by who makes it; the codes of no current are
//! [`ZERO_CODE`], so that an offset of the sensing is one that calibration has left.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use control::torque::brushed::BrushedLoop;
use control::torque::current::CurrentLoop;
use control::torque::modulation::Duties;
use control::torque::sense::CurrentSense;
use control::torque::voltage::VoltageDrive;
use control::torque::{Delivery, Measured, TorqueError};

use crate::electrical::Winding;
use crate::knob::{Interval, KnobError};
use crate::powered::{Powered, Setup, ZERO_CODE};

/// What turns a torque into duties.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TorqueDrive {
    /// Field-oriented current control.
    Current(CurrentLoop),
    /// Voltage control of a gimbal motor.
    Voltage(VoltageDrive),
    /// Current control of a brushed motor.
    Brushed(BrushedLoop),
}

impl TorqueDrive {
    /// What a governor must know of it on windings (Ω, Nm/A as believed), with an encoder and a PWM period (s).
    #[must_use]
    pub fn delivery(&self, believed: &Winding, counts_per_rev: u32, pwm_period_s: f64) -> Delivery {
        let mut delivery = match self {
            Self::Current(drive) => drive.delivery(),
            Self::Voltage(drive) => drive.delivery(),
            Self::Brushed(drive) => drive.delivery(),
        };
        if let (Self::Voltage(_), Winding::ThreePhase(motor)) = (self, believed) {
            // k·(p ψ)/R of a speed that is wrong by a count.
            let constant = motor.torque_constant_nm_a();
            let flux = f64::from(motor.pole_pairs) * motor.flux_wb;
            delivery.torque_step_nm += constant * flux / motor.resistance_ohm
                * self.count_speed_rad_s(counts_per_rev, pwm_period_s);
        }
        delivery
    }

    /// Over how many periods the speed is taken.
    fn window(&self) -> usize {
        match self {
            Self::Current(_) | Self::Brushed(_) => 16,
            Self::Voltage(_) => 32,
        }
    }

    fn count_speed_rad_s(&self, counts_per_rev: u32, pwm_period_s: f64) -> f64 {
        TAU / f64::from(counts_per_rev) / (self.window() as f64 * pwm_period_s)
    }

    fn tick(&mut self, torque_nm: f32, measured: &Measured) -> Duties {
        match self {
            Self::Current(drive) => drive.tick(torque_nm, measured),
            Self::Voltage(drive) => drive.tick(torque_nm, measured),
            Self::Brushed(drive) => drive.tick(torque_nm, measured),
        }
    }
}

/// What the windings went through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed {
    /// The least and the largest bus voltage, V.
    pub bus_v: [f64; 2],
    /// The largest current of a phase at the end of a period, in magnitude, A.
    pub current_a: f64,
    /// The energy taken from the bus, J.
    pub drawn_j: f64,
}

/// Why there is none.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum DrivenError {
    /// The powered knob is none.
    #[error(transparent)]
    Knob(#[from] KnobError),
    /// The sensing is none.
    #[error(transparent)]
    Torque(#[from] TorqueError),
}

/// A powered knob and its drive between two samples.
#[derive(Debug, Clone)]
pub struct Driven {
    knob: Powered,
    drive: TorqueDrive,
    sense: CurrentSense,
    pwm_period_s: f64,
    /// −1 where the counter falls as the angle grows.
    direction: i32,
    /// The last counts, one a period; the oldest first.
    counts: VecDeque<i32>,
    /// The speed of one count over all of them, rad/s.
    count_speed_rad_s: f64,
    passed: Passed,
}

impl Driven {
    /// At its start, all switches off, after a rest.
    ///
    /// # Errors
    /// See [`Powered::new`].
    pub fn new(setup: &Setup, drive: TorqueDrive) -> Result<Self, DrivenError> {
        let mut knob = Powered::new(setup)?;
        let bus_v = knob.electrical().bus_v();
        let direction = if setup.encoder.reversed { -1 } else { 1 };
        let count = counted(direction, knob.sensed().counter);
        let pwm_period_s = setup.inverter.pwm_period_s;
        let counts_per_rev = setup.encoder.counts_per_rev;
        Ok(Self {
            knob,
            drive,
            sense: CurrentSense::new(setup.sensing.step_a, [ZERO_CODE; 2])?,
            pwm_period_s,
            direction,
            counts: VecDeque::from(vec![count; drive.window()]),
            count_speed_rad_s: drive.count_speed_rad_s(counts_per_rev, pwm_period_s),
            passed: Passed {
                bus_v: [bus_v; 2],
                current_a: 0.0,
                drawn_j: 0.0,
            },
        })
    }

    /// What the windings have gone through until now.
    #[must_use]
    pub fn passed(&self) -> Passed {
        self.passed
    }

    /// A tick commands a torque (Nm), and the next one comes after `duration_s`: the nearest whole number of PWM
    /// periods, at least one.
    pub fn hold(&mut self, torque_nm: f64, duration_s: f64) -> Interval {
        let periods = (duration_s / self.pwm_period_s).round().max(1.0) as u64;
        let mut whole: Option<Interval> = None;
        for _ in 0..periods {
            let sensed = self.knob.sensed();
            let count = counted(self.direction, sensed.counter);
            self.counts.push_back(count);
            let before = self.counts.pop_front().unwrap_or(count);
            let speed_rad_s = f64::from(count.wrapping_sub(before)) * self.count_speed_rad_s;
            let measured = Measured {
                currents: self.sense.currents(sensed.codes),
                count,
                speed_rad_s: speed_rad_s as f32,
                bus_v: sensed.bus_v as f32,
            };
            let duties = self.drive.tick(torque_nm as f32, &measured);
            let turned = self.knob.period(Some(duties.parts().map(f64::from)));
            self.pass(turned.electrical.drawn_j);
            let part = turned.mechanical;
            whole = Some(match whole {
                None => part,
                Some(before) => Interval {
                    end: part.end,
                    furthest_rad: before.furthest_rad.max(part.furthest_rad),
                    motor_work_j: before.motor_work_j + part.motor_work_j,
                    friction_j: before.friction_j + part.friction_j,
                    hand_work_j: before.hand_work_j + part.hand_work_j,
                },
            });
        }
        whole.expect("at least one period")
    }

    fn pass(&mut self, drawn_j: f64) {
        let bus_v = self.knob.electrical().bus_v();
        let [least, most] = self.passed.bus_v;
        self.passed.bus_v = [least.min(bus_v), most.max(bus_v)];
        for current in self.knob.phase_currents() {
            self.passed.current_a = self.passed.current_a.max(current.abs());
        }
        self.passed.drawn_j += drawn_j;
    }
}

fn counted(direction: i32, counter: u32) -> i32 {
    counter.cast_signed().wrapping_mul(direction)
}

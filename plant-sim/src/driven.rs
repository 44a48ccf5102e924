//! A powered knob under a drive of [`control::torque`]: it brings the torque that a controller holds, for as many
//! PWM periods as a sample has.
//!
//! At the start of each period the currents, the bus and the encoder are read, the drive runs, and its duties act in the
//! next period (with [`Inverter::late`](crate::electrical::Inverter)). A controller's tick runs before the drive
//! at the start of a sample's first period: its torque begins to change one period later. The drive's speed is the
//! way of the counts over the last sample: wrong by up to a count in it, right in the mean.
//!
//! The drive is told its motor, its encoder and the dead time by who makes it; the codes of no current are
//! [`ZERO_CODE`], so that an offset of the sensing is one that calibration has left.

use control::torque::brushed::BrushedLoop;
use control::torque::current::CurrentLoop;
use control::torque::modulation::Duties;
use control::torque::sense::CurrentSense;
use control::torque::voltage::VoltageDrive;
use control::torque::{Delivery, Measured, TorqueError};

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
    /// What a governor must know.
    #[must_use]
    pub fn delivery(&self) -> Delivery {
        match self {
            Self::Current(drive) => drive.delivery(),
            Self::Voltage(drive) => drive.delivery(),
            Self::Brushed(drive) => drive.delivery(),
        }
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
    count_rad: f64,
    /// −1 where the counter falls as the angle grows.
    direction: i32,
    /// At the last sample's start: the count, and how long it lasted, s.
    before: Option<(i32, f64)>,
    passed: Passed,
}

impl Driven {
    /// At its start, all switches off.
    ///
    /// # Errors
    /// See [`Powered::new`].
    pub fn new(setup: &Setup, drive: TorqueDrive) -> Result<Self, DrivenError> {
        let knob = Powered::new(setup)?;
        let bus_v = knob.electrical().bus_v();
        Ok(Self {
            knob,
            drive,
            sense: CurrentSense::new(setup.sensing.step_a, [ZERO_CODE; 2])?,
            pwm_period_s: setup.inverter.pwm_period_s,
            count_rad: std::f64::consts::TAU / f64::from(setup.encoder.counts_per_rev),
            direction: if setup.encoder.reversed { -1 } else { 1 },
            before: None,
            passed: Passed {
                bus_v: [bus_v; 2],
                current_a: 0.0,
                drawn_j: 0.0,
            },
        })
    }

    /// What a governor must know.
    #[must_use]
    pub fn delivery(&self) -> Delivery {
        self.drive.delivery()
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
        let mut sensed = self.knob.sensed();
        let count = self.count(sensed.counter);
        let speed_rad_s = self.before.map_or(0.0, |(before, lasted_s)| {
            f64::from(count.wrapping_sub(before)) * self.count_rad / lasted_s
        });
        self.before = Some((count, periods as f64 * self.pwm_period_s));
        let mut whole: Option<Interval> = None;
        for period in 0..periods {
            if period > 0 {
                sensed = self.knob.sensed();
            }
            let measured = Measured {
                currents: self.sense.currents(sensed.codes),
                count: self.count(sensed.counter),
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

    fn count(&self, counter: u32) -> i32 {
        counter.cast_signed().wrapping_mul(self.direction)
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

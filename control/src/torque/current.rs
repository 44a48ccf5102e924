//! Field-oriented current control of a three-phase motor.

use super::angle::{EncoderOnMotor, RotorAngle};
use super::frames::{Rotating, Stationary};
use super::modulation::{Duties, Modulator};
use super::regulator::{Gains, Regulator};
use super::{Delivery, InverterConfig, LoopConfig, Measured, ThreePhaseMotor, TorqueError};
use super::{unexplained_v, within};
use crate::error::positive;

/// From the measurement to the middle of the period in which its duties are in force, periods.
const AHEAD: f64 = 1.5;

/// A current step of the vector: two phases wrong by half a step each, alike, are an α that is wrong by a
/// whole one.
const VECTOR_STEPS: f64 = 2.0;

/// The current loop of a three-phase motor.
///
/// The current for the torque lies along q, i_q* = torque/(3/2 p ψ), and i_d* = 0. In each period
///
/// v_d = PI(−i_d) − ω L_q i_q,  v_q = PI(i_q* − i_q) + ω (L_d i_d + ψ),
///
/// are cut to what the bus can give, turned to where the rotor will be in the middle of the
/// period of their effect, 1½ periods on, and modulated. Dead time is compensated by the sign of
/// the currents wanted, which carry no noise.
///
/// # Assumes
/// As i_d* = 0, the torque of a rotor with L_d ≠ L_q is that of the magnets alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurrentLoop {
    modulator: Modulator,
    rotor: RotorAngle,
    d: Regulator,
    q: Regulator,
    current_per_torque_a_nm: f32,
    current_max_a: f32,
    pole_pairs: f32,
    d_inductance_h: f32,
    q_inductance_h: f32,
    flux_wb: f32,
    resistance_ohm: f32,
    /// Measured last, A.
    measured: Rotating,
    /// Turns ahead, per rad/s of the electrical speed.
    ahead_turns_s_rad: f32,
    delivery: Delivery,
}

impl CurrentLoop {
    /// At rest, without current.
    ///
    /// ```
    /// use control::torque::angle::EncoderOnMotor;
    /// use control::torque::current::CurrentLoop;
    /// use control::torque::{FASTEST, InverterConfig, LoopConfig, ThreePhaseMotor};
    /// let motor = ThreePhaseMotor {
    ///     resistance_ohm: 0.5,
    ///     d_inductance_h: 3e-4,
    ///     q_inductance_h: 3e-4,
    ///     flux_wb: 5e-3,
    ///     pole_pairs: 7,
    /// };
    /// let inverter = InverterConfig {
    ///     pwm_period_s: 1.0 / 24e3,
    ///     pwm_steps: 3500,
    ///     dead_time_s: 223e-9,
    ///     dead_time_edge_a: 0.2,
    ///     duty_max: 0.85,
    ///     bus_least_v: 8.0,
    ///     bus_most_v: 25.0,
    ///     current_step_a: 0.020_14,
    /// };
    /// let asked = LoopConfig { bandwidth_rad_s: FASTEST * 24e3, current_max_a: 20.0, tolerance: 0.3 };
    /// let encoder = EncoderOnMotor { counts_per_rev: 8192, zero_turns: 0.0 };
    /// let drive = CurrentLoop::new(&motor, &encoder, &inverter, &asked)?;
    /// // 52.5 mNm/A: a step of 2.1 mNm, a period of delay, then 124 µs.
    /// assert!((drive.delivery().torque_step_nm - 2.1e-3).abs() < 2e-5);
    /// assert!((drive.delivery().tau_s - 124e-6).abs() < 1e-6);
    /// # Ok::<(), control::torque::TorqueError>(())
    /// ```
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, by name and value, and a bandwidth beyond
    /// [`LIVELIEST`](super::LIVELIEST).
    pub fn new(
        motor: &ThreePhaseMotor,
        encoder: &EncoderOnMotor,
        inverter: &InverterConfig,
        asked: &LoopConfig,
    ) -> Result<Self, TorqueError> {
        motor.check()?;
        let modulator = Modulator::new(inverter)?;
        asked.check(inverter.pwm_period_s)?;
        let gains = |inductance_h| {
            Gains::new(
                motor.resistance_ohm,
                inductance_h,
                asked.bandwidth_rad_s,
                inverter.pwm_period_s,
            )
        };
        let constant = motor.torque_constant_nm_a();
        Ok(Self {
            modulator,
            rotor: RotorAngle::new(encoder, motor.pole_pairs)?,
            d: Regulator::new(gains(motor.d_inductance_h)?, inverter.bus_most_v)?,
            q: Regulator::new(gains(motor.q_inductance_h)?, inverter.bus_most_v)?,
            current_per_torque_a_nm: positive(
                "current per torque (A/Nm)",
                (1.0 / constant) as f32,
            )?,
            current_max_a: asked.current_max_a as f32,
            pole_pairs: motor.pole_pairs as f32,
            d_inductance_h: motor.d_inductance_h as f32,
            q_inductance_h: motor.q_inductance_h as f32,
            flux_wb: motor.flux_wb as f32,
            resistance_ohm: motor.resistance_ohm as f32,
            measured: Rotating { d: 0.0, q: 0.0 },
            ahead_turns_s_rad: ahead_turns_s_rad(inverter),
            delivery: asked.delivery(
                constant,
                VECTOR_STEPS * inverter.current_step_a,
                inverter.pwm_period_s,
            ),
        })
    }

    /// What a governor must know.
    #[must_use]
    pub fn delivery(&self) -> Delivery {
        self.delivery
    }

    /// One period: the duties that bring a torque (Nm).
    #[must_use]
    #[inline]
    pub fn tick(&mut self, torque_nm: f32, measured: &Measured) -> Duties {
        let bus = self.modulator.bus(measured.bus_v);
        let angle = self.rotor.at(measured.count);
        let speed = measured.speed_rad_s * self.pole_pairs;
        let i = Stationary::from_two_phases(measured.currents.b_a, measured.currents.c_a)
            .seen_from(angle.rotation());
        let wanted_a = within(torque_nm * self.current_per_torque_a_nm, self.current_max_a);
        let forward = Rotating {
            d: -speed * self.q_inductance_h * i.q,
            q: speed * (self.d_inductance_h * i.d + self.flux_wb),
        };
        let volts = self.modulator.limited(
            Rotating {
                d: self.d.volts(-i.d) + forward.d,
                q: self.q.volts(wanted_a - i.q) + forward.q,
            },
            bus,
        );
        self.d.follow(volts.d - forward.d);
        self.q.follow(volts.q - forward.q);
        self.measured = i;
        let then = angle.advanced(speed * self.ahead_turns_s_rad).rotation();
        let wanted = Rotating {
            d: 0.0,
            q: wanted_a,
        };
        self.modulator
            .three_phase(volts.turned(then), wanted.turned(then), bus)
    }

    /// The voltage that it takes to bring the currents, beyond that of the motor's equations and of a resistance
    /// that is half as much again, V: |I_d − R i_d| + |I_q − R i_q| − R (|i_d| + |i_q|)/2 with the integrals I. A count
    /// that does not follow the rotor leaves its back-EMF here.
    #[must_use]
    #[inline]
    pub fn unexplained_v(&self) -> f32 {
        unexplained_v(self.d.integral_v(), self.resistance_ohm * self.measured.d)
            + unexplained_v(self.q.integral_v(), self.resistance_ohm * self.measured.q)
    }

    /// Forgets the past: to be called where the bridge was off.
    pub fn clear(&mut self) {
        self.d.clear();
        self.q.clear();
    }
}

/// Turns from the measurement to the middle of the effect, per rad/s of the electrical speed.
pub(super) fn ahead_turns_s_rad(inverter: &InverterConfig) -> f32 {
    (AHEAD * inverter.pwm_period_s / core::f64::consts::TAU) as f32
}

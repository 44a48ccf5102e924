//! Voltage control of a high-resistance gimbal motor.

use super::angle::{EncoderOnMotor, RotorAngle};
use super::current::ahead_turns_s_rad;
use super::frames::Rotating;
use super::modulation::{Duties, Modulator};
use super::{
    Delivery, InverterConfig, Measured, ThreePhaseMotor, TorqueError, check_tolerance, within,
};
use crate::error::{not_negative, positive};

/// The step of a voltage vector, in steps of a duty times the bus voltage: three duties wrong by half a step,
/// one of them the other way, make a vector wrong by 2/3.
const VECTOR_STEPS: f64 = 4.0 / 3.0;

/// The voltage for a torque, by the motor's equations with i_d = 0 and i_q = torque/(3/2 p ψ):
///
/// v_d = −ω L_q i_q,  v_q = R i_q + ω ψ.
///
/// Currents are not looked at: the torque is as good as R, and as fast as L_q/R, some
/// tenths of a millisecond in a gimbal motor. It has no step of the current converter, and no noise of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoltageDrive {
    modulator: Modulator,
    rotor: RotorAngle,
    current_per_torque_a_nm: f32,
    current_max_a: f32,
    pole_pairs: f32,
    resistance_ohm: f32,
    q_inductance_h: f32,
    flux_wb: f32,
    ahead_turns_s_rad: f32,
    delivery: Delivery,
}

impl VoltageDrive {
    /// For currents up to `current_max_a` (A), which is a limit of what is asked for, not of what flows;
    /// resistance and inductance may be off by the part `tolerance`, and the torque is off with the resistance.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, by name and value, and a tolerance
    /// beyond 0.9.
    pub fn new(
        motor: &ThreePhaseMotor,
        encoder: &EncoderOnMotor,
        inverter: &InverterConfig,
        current_max_a: f64,
        tolerance: f64,
    ) -> Result<Self, TorqueError> {
        motor.check()?;
        let modulator = Modulator::new(inverter)?;
        not_negative("current limit (A)", current_max_a as f32)?;
        check_tolerance(tolerance)?;
        let constant = motor.torque_constant_nm_a();
        let step_v = VECTOR_STEPS * inverter.bus_most_v / f64::from(inverter.pwm_steps);
        let time_constant_s = motor.q_inductance_h / motor.resistance_ohm;
        Ok(Self {
            modulator,
            rotor: RotorAngle::new(encoder, motor.pole_pairs)?,
            current_per_torque_a_nm: positive(
                "current per torque (A/Nm)",
                (1.0 / constant) as f32,
            )?,
            current_max_a: current_max_a as f32,
            pole_pairs: motor.pole_pairs as f32,
            resistance_ohm: motor.resistance_ohm as f32,
            q_inductance_h: motor.q_inductance_h as f32,
            flux_wb: motor.flux_wb as f32,
            ahead_turns_s_rad: ahead_turns_s_rad(inverter),
            delivery: Delivery {
                torque_step_nm: constant * step_v / motor.resistance_ohm,
                torque_max_nm: constant * current_max_a,
                delay_s: inverter.pwm_period_s,
                tau_s: time_constant_s * (1.0 + tolerance) / (1.0 - tolerance),
            },
        })
    }

    /// What a governor must know.
    #[must_use]
    pub fn delivery(&self) -> Delivery {
        self.delivery
    }

    /// One period: the duties for a torque (Nm). Only count, speed and bus voltage are looked at.
    #[must_use]
    #[inline]
    pub fn tick(&self, torque_nm: f32, measured: &Measured) -> Duties {
        let bus = self.modulator.bus(measured.bus_v);
        let speed = measured.speed_rad_s * self.pole_pairs;
        let q = within(torque_nm * self.current_per_torque_a_nm, self.current_max_a);
        let volts = self.modulator.limited(
            Rotating {
                d: -speed * self.q_inductance_h * q,
                q: self.resistance_ohm * q + speed * self.flux_wb,
            },
            bus,
        );
        let then = self
            .rotor
            .at(measured.count)
            .advanced(speed * self.ahead_turns_s_rad)
            .rotation();
        let currents = Rotating { d: 0.0, q };
        self.modulator
            .three_phase(volts.turned(then), currents.turned(then), bus)
    }
}

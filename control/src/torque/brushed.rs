//! Current control of a brushed motor between phases B and C.

use super::modulation::{Duties, Modulator};
use super::regulator::{Gains, Regulator};
use super::{BrushedMotor, Delivery, InverterConfig, LoopConfig, Measured, TorqueError};
use super::{unexplained_v, within};
use crate::error::positive;

/// Steps of the converter: between two codes the loop hunts, a little beyond the half of one.
const CURRENT_STEPS: f64 = 1.25;

/// The current loop of a brushed motor between B and C: v = PI(i* − i) + k · speed, i* = torque/k.
///
/// Both ends are measured, i = (B − C)/2: what both converters have in common cancels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrushedLoop {
    modulator: Modulator,
    regulator: Regulator,
    current_per_torque_a_nm: f32,
    current_max_a: f32,
    torque_constant_nm_a: f32,
    resistance_ohm: f32,
    /// Measured last, A.
    measured_a: f32,
    delivery: Delivery,
}

impl BrushedLoop {
    /// At rest, without current.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, by name and value, and a bandwidth beyond
    /// [`LIVELIEST`](super::LIVELIEST).
    pub fn new(
        motor: &BrushedMotor,
        inverter: &InverterConfig,
        asked: &LoopConfig,
    ) -> Result<Self, TorqueError> {
        let modulator = Modulator::new(inverter)?;
        asked.check(inverter.pwm_period_s)?;
        let constant = motor.torque_constant_nm_a;
        positive("torque constant (Nm/A)", constant as f32)?;
        Ok(Self {
            modulator,
            regulator: Regulator::new(
                Gains::new(
                    motor.resistance_ohm,
                    motor.inductance_h,
                    asked.bandwidth_rad_s,
                    inverter.pwm_period_s,
                )?,
                inverter.bus_most_v,
            )?,
            current_per_torque_a_nm: positive(
                "current per torque (A/Nm)",
                (1.0 / constant) as f32,
            )?,
            current_max_a: asked.current_max_a as f32,
            torque_constant_nm_a: constant as f32,
            resistance_ohm: motor.resistance_ohm as f32,
            measured_a: 0.0,
            delivery: asked.delivery(
                constant,
                CURRENT_STEPS * inverter.current_step_a,
                inverter.pwm_period_s,
            ),
        })
    }

    /// What a governor must know.
    #[must_use]
    pub fn delivery(&self) -> Delivery {
        self.delivery
    }

    /// One period: the duties that bring a torque (Nm). The count is not looked at.
    #[must_use]
    #[inline]
    pub fn tick(&mut self, torque_nm: f32, measured: &Measured) -> Duties {
        let bus = self.modulator.bus(measured.bus_v);
        let current_a = 0.5 * (measured.currents.b_a - measured.currents.c_a);
        let wanted_a = within(torque_nm * self.current_per_torque_a_nm, self.current_max_a);
        let forward_v = self.torque_constant_nm_a * measured.speed_rad_s;
        let volts = self
            .modulator
            .limited_line(self.regulator.volts(wanted_a - current_a) + forward_v, bus);
        self.regulator.follow(volts - forward_v);
        self.measured_a = current_a;
        self.modulator.two_phase(volts, wanted_a, bus)
    }

    /// The voltage that it takes to bring the current, beyond that of the motor's equation and of a resistance that is
    /// half as much again, V: |I − R i| − R |i|/2 with the integral I. A count that does not follow the rotor
    /// leaves its back-EMF here.
    #[must_use]
    #[inline]
    pub fn unexplained_v(&self) -> f32 {
        unexplained_v(
            self.regulator.integral_v(),
            self.resistance_ohm * self.measured_a,
        )
    }

    /// Forgets the past: to be called where the bridge was off.
    pub fn clear(&mut self) {
        self.regulator.clear();
    }
}

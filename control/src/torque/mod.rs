//! From a commanded torque to the duties of a three-phase inverter, by one of three drives:
//!
//! - [`current`]: field-oriented current control of a three-phase motor;
//! - [`voltage`]: voltage control of a high-resistance gimbal motor, whose currents are too small to
//!   be measured well;
//! - [`brushed`]: current control of a brushed motor between phases B and C.
//!
//! They are made of [`frames`] (Clarke's and Park's transforms), [`angle`] (the electrical angle of a
//! count), [`regulator`] (a PI controller that cannot wind up), [`modulation`] (space-vector modulation,
//! dead-time compensation, voltage limit), [`sense`] (converter codes to amperes) and [`cogging`] (a torque
//! that undoes it).
//!
//! # When
//! A drive is run once in a PWM period, on currents measured at the period's start; its duties
//! are in force for the whole of the next period. Every delay below follows from that.
//!
//! # What a governor must know
//! A [`Delivery`]: how coarse and how late the torque is. It enters [`Config`](crate::config::Config) as
//! `torque_step_nm`, `torque_max_nm`, `timing.delay_s` (with the delay of the haptic tick before it) and
//! `timing.amplifier_tau_s`.
//!
//! # Trust
//! A drive is made from checked numbers and cannot be invalid. Its tick has no error path: a
//! torque that is not a number counts as 0, a bus voltage below the least believed counts as
//! that; a measurement that is not a number gives duties of 0, and an absurd one leaves at most the
//! voltage of the bus in an integral.
//!
//! # Assumed
//! Motor values are the believed ones, of windings at the temperature at which they were measured:
//! copper gains 0.39 % of resistance per kelvin, magnets lose 0.1 to 0.2 % of flux. `tolerance`
//! says how far off resistance and inductance may be.
//!
//! Sources: N. Mohan, *Advanced Electric Drives* (2014), for frames and decoupling; L. Harnefors, H.-P. Nee,
//! "Model-based current control of AC machines using the internal model control method", IEEE
//! Trans. Ind. Appl. 34(1), 1998, for the gains; K. J. Åström, T. Hägglund, *PID Controllers* (1995), Sec. 3.5, for
//! anti-windup.

pub mod angle;
pub mod brushed;
pub mod cogging;
pub mod current;
mod error;
pub mod frames;
pub mod modulation;
pub mod regulator;
pub mod sense;
pub mod voltage;

pub use error::TorqueError;

use crate::error::{not_negative, positive};
use sense::PhaseCurrents;

/// A three-phase motor with magnets on its rotor, by its equations in the rotor's frame,
///
/// v_d = R i_d + L_d i_d' − ω L_q i_q,  v_q = R i_q + L_q i_q' + ω (L_d i_d + ψ),
/// torque = 3/2 p (ψ i_q + (L_d − L_q) i_d i_q), ω = p · speed of the shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThreePhaseMotor {
    /// R of one phase, half of what is measured between two, Ω.
    pub resistance_ohm: f64,
    /// L_d, H.
    pub d_inductance_h: f64,
    /// L_q, H.
    pub q_inductance_h: f64,
    /// ψ, the magnets' flux through a phase, Wb: 60/(2π√3 p Kv) for Kv in rpm per volt between phases.
    pub flux_wb: f64,
    /// p.
    pub pole_pairs: u32,
}

impl ThreePhaseMotor {
    /// 3/2 p ψ, Nm/A: the torque of one ampere along q.
    #[must_use]
    pub fn torque_constant_nm_a(&self) -> f64 {
        1.5 * f64::from(self.pole_pairs) * self.flux_wb
    }

    fn check(&self) -> Result<(), TorqueError> {
        positive("phase resistance (Ω)", self.resistance_ohm as f32)?;
        positive("d inductance (H)", self.d_inductance_h as f32)?;
        positive("q inductance (H)", self.q_inductance_h as f32)?;
        positive("flux (Wb)", self.flux_wb as f32)?;
        Ok(())
    }
}

/// A brushed motor: v = R i + L i' + k · speed, torque = k i.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrushedMotor {
    /// R between its two ends, Ω.
    pub resistance_ohm: f64,
    /// L, H.
    pub inductance_h: f64,
    /// k, Nm/A, which is also V s/rad.
    pub torque_constant_nm_a: f64,
}

/// The inverter, its modulation and its current sensing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverterConfig {
    /// T, the PWM period, s.
    pub pwm_period_s: f64,
    /// Steps of a duty from 0 to 1.
    pub pwm_steps: u16,
    /// How long both switches of a phase are off when it changes over, the gate driver's share
    /// included, s. 0 turns compensation off.
    pub dead_time_s: f64,
    /// From this current on, either way, a phase loses the whole dead time, A; below in
    /// proportion. About half the current ripple.
    pub dead_time_edge_a: f64,
    /// The largest duty: what leaves the low side on for long enough to measure its current.
    pub duty_max: f64,
    /// The least bus voltage to reckon with, V.
    pub bus_least_v: f64,
    /// The most, V: at it the steps of a duty are the coarsest.
    pub bus_most_v: f64,
    /// The step of the current converter, A.
    pub current_step_a: f64,
}

/// What is asked of a current loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopConfig {
    /// ω_c, rad/s: the loop's bandwidth where resistance and inductance are as believed.
    pub bandwidth_rad_s: f64,
    /// The largest current commanded, in magnitude, A.
    pub current_max_a: f64,
    /// The part by which resistance and inductance may be off, either way: 0.3 is ±30 %.
    pub tolerance: f64,
}

/// ω_c·T of the fastest loop that overshoots by less than 1 % where the motor is as believed.
pub const FASTEST: f64 = 0.29;

/// The most that ω_c·T/(1 − tolerance) may be, which is ω_c·T of a motor of the least
/// inductance: it then overshoots by a quarter; from 1 on it would be unstable.
pub const LIVELIEST: f64 = 0.5;

impl LoopConfig {
    fn check(&self, period_s: f64) -> Result<(), TorqueError> {
        positive("bandwidth (rad/s)", self.bandwidth_rad_s as f32)?;
        not_negative("current limit (A)", self.current_max_a as f32)?;
        check_tolerance(self.tolerance)?;
        at_most(
            "bandwidth × PWM period / (1 − tolerance)",
            self.bandwidth_rad_s * period_s / (1.0 - self.tolerance),
            LIVELIEST,
        )
    }

    /// Of a loop on an inverter of period T: ∫(1 − y) dt of its answer y to a step is R/(R̂ω_c) − T/2 with
    /// R̂ believed and R true. Of that, T passes before anything moves.
    fn delivery(&self, torque_constant_nm_a: f64, step_a: f64, period_s: f64) -> Delivery {
        Delivery {
            torque_step_nm: torque_constant_nm_a * step_a,
            torque_max_nm: torque_constant_nm_a * self.current_max_a,
            delay_s: period_s,
            tau_s: (1.0 + self.tolerance) / self.bandwidth_rad_s - 1.5 * period_s,
        }
    }
}

fn check_tolerance(tolerance: f64) -> Result<(), TorqueError> {
    not_negative("tolerance", tolerance)?;
    at_most("tolerance", tolerance, 0.9)
}

fn at_most(name: &'static str, value: f64, limit: f64) -> Result<(), TorqueError> {
    if value <= limit {
        Ok(())
    } else {
        Err(TorqueError::Above { name, value, limit })
    }
}

/// What is measured at the start of a PWM period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The currents of phases B and C.
    pub currents: PhaseCurrents,
    /// The encoder's count.
    pub count: i32,
    /// The speed of the shaft as estimated, rad/s.
    pub speed_rad_s: f32,
    /// The bus voltage, V.
    pub bus_v: f32,
}

/// What a governor must know of the torque that a drive delivers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delivery {
    /// q, Nm: the torque is as commanded to ± half of this, where the motor is as believed.
    pub torque_step_nm: f64,
    /// The largest torque, Nm, while the voltage suffices.
    pub torque_max_nm: f64,
    /// From the measurement to the first change of torque, s.
    pub delay_s: f64,
    /// The time constant of what follows, s, at the worst end of the tolerance: the area between a
    /// step commanded and the torque is delay + this.
    pub tau_s: f64,
}

/// By how much an integral differs from a resistance's voltage by more than half of that, V.
#[inline(always)]
fn unexplained_v(integral_v: f32, resistive_v: f32) -> f32 {
    (integral_v - resistive_v).abs() - 0.5 * resistive_v.abs()
}

/// `x`, or the end of ±`most` that it lies beyond; 0 for what is not a number.
#[inline(always)]
fn within(x: f32, most: f32) -> f32 {
    if x.abs() <= most {
        x
    } else if x > 0.0 {
        most
    } else if x < 0.0 {
        -most
    } else {
        0.0
    }
}

//! A motor's values, by voltages that the device puts on it and sums that it tells.
//!
//! [`calibrate`] is the whole of it; it knows no serial port and no plant, only a [`Bench`] that runs an
//! [`Excitation`]. `docs/calibrate.md` has the equations. Every value comes with an interval, and what the
//! sums do not support is a [`Refusal`] with the reason.

mod brushed;
mod flux;
mod refusal;
mod shared;
mod sums;
mod three_phase;

use plant_sim::identify::Estimate;
use protocol::{Excitation, ExcitationEnd, PowerStage, Sums};

pub use refusal::{Phase, Refusal};
use shared::Calibration;

/// What is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Winding {
    /// Three phases.
    ThreePhase,
    /// A brushed motor between B and C.
    Brushed,
}

/// What the user knows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// The kind of motor.
    pub winding: Winding,
    /// p, if known.
    pub pole_pairs: Option<u32>,
    /// Kv, rpm per volt (between two phases), if known.
    pub kv_rpm_v: Option<f64>,
    /// The largest current, in any phase and at any moment, A.
    pub current_max_a: f64,
    /// Hardware counts of the encoder in a turn.
    pub counts_per_rev: u32,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Mean codes of B and C without current.
    pub zero_codes: [f64; 2],
    /// Standard deviation of the currents' noise, A.
    pub noise_a: f64,
    /// R of a phase, or between the ends of a brushed motor, Ω.
    pub resistance_ohm: Estimate,
    /// L_d, or L of a brushed motor, H.
    pub d_inductance_h: Estimate,
    /// L_q, or L of a brushed motor, H.
    pub q_inductance_h: Estimate,
    /// p; 1 of a brushed motor.
    pub pole_pairs: u32,
    /// The counter falls while the field turns from A over B to C, or while a current from B to C turns
    /// a brushed motor.
    pub reversed: bool,
    /// The electrical angle in the middle of count 0, turns; 0 of a brushed motor.
    pub zero_turns: Estimate,
    /// Torque per ampere (along q), Nm/A: from Kv where it was told, within what back-EMF says.
    pub torque_constant_nm_a: Estimate,
    /// The same from back-EMF alone.
    pub measured_constant_nm_a: Estimate,
    /// The largest current that the bus can drive through the resistance, A.
    pub current_of_bus_a: f64,
}

impl Found {
    /// ψ of a three-phase motor, Wb: torque constant/(3/2 p).
    #[must_use]
    pub fn flux_wb(&self) -> Estimate {
        let per = 1.0 / (1.5 * f64::from(self.pole_pairs));
        let Estimate { value, low, high } = self.torque_constant_nm_a;
        Estimate {
            value: per * value,
            low: per * low,
            high: per * high,
        }
    }
}

/// A step of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Codes without current.
    Offsets,
    /// Resistance, and whether everything is connected.
    Resistance,
    /// Pole pairs, direction and zero.
    Turn,
    /// Inductance.
    Inductance,
    /// Torque constant.
    BackEmf,
}

impl Step {
    /// In a few words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Offsets => "current offsets",
            Self::Resistance => "resistance",
            Self::Turn => "the turn of the field",
            Self::Inductance => "inductance",
            Self::BackEmf => "back-EMF",
        }
    }
}

/// What an excitation brought.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// All windows that came.
    pub windows: Vec<Sums>,
    /// How it ended.
    pub end: ExcitationEnd,
}

/// What runs excitations.
pub trait Bench {
    /// Why it cannot.
    type Error: From<Refusal>;

    /// The power stage.
    fn power_stage(&self) -> PowerStage;

    /// Runs one to its end.
    ///
    /// # Errors
    /// Whatever keeps it from that.
    fn excite(&mut self, excitation: &Excitation) -> Result<Recorded, Self::Error>;

    /// A step begins.
    fn begin(&mut self, step: Step);
}

/// Measures a motor.
///
/// # Errors
/// A [`Refusal`], or what the bench says.
pub fn calibrate<B: Bench>(bench: &mut B, told: &Told) -> Result<Found, B::Error> {
    let mut calibration = Calibration::new(bench, told)?;
    calibration.offsets()?;
    match told.winding {
        Winding::ThreePhase => three_phase::measure(&mut calibration),
        Winding::Brushed => brushed::measure(&mut calibration),
    }
}

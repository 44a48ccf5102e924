//! What a controller is told: plain data, in `f64` and SI units, checked once, by
//! [`crate::plan::Plan::new`].

use crate::criterion::Device;
use crate::encoder::EncoderConfig;
use crate::shape::Shape;

/// What decides the torque that is applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Law {
    /// The demanded stiffness, whatever it does.
    Raw,
    /// At most what the [margin](crate::margin) allows at every speed.
    Static,
    /// At most what the margin allows at the worst speed seen in this contact, and at rest, or
    /// it would never rest. Within a contact the stiffness only falls; it is released at
    /// zero force. Until a speed has been seen, as [`Law::Static`].
    Episode,
    /// The [energy ledger](crate::ledger): pays for sampling with energy that was measured.
    Ledger,
    /// The cheapest of the plain spring, the episode and the ledger that applies the whole
    /// demand, or the ledger.
    Auto,
}

/// A quantity that is known to lie between two values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The least it may be.
    pub low: f64,
    /// The most it may be.
    pub high: f64,
}

impl Interval {
    /// A quantity that is believed to be known exactly.
    #[must_use]
    pub fn exactly(value: f64) -> Self {
        Self {
            low: value,
            high: value,
        }
    }
}

/// A device as it is believed to be, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Believed {
    /// m, kg m².
    pub inertia_kg_m2: Interval,
    /// b, Nm s/rad.
    pub viscous_nm_s_rad: Interval,
    /// c, Nm.
    pub coulomb_nm: Interval,
}

impl Believed {
    /// A device whose values are believed to be known exactly.
    #[must_use]
    pub fn exactly(device: &Device<f64>) -> Self {
        Self {
            inertia_kg_m2: Interval::exactly(device.inertia_kg_m2),
            viscous_nm_s_rad: Interval::exactly(device.viscous_nm_s_rad),
            coulomb_nm: Interval::exactly(device.coulomb_nm),
        }
    }
}

/// When ticks run and when their torque acts, as it is believed to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// T, the nominal sample period, s.
    pub period_s: f64,
    /// The period varies by up to this, either way, s.
    pub jitter_s: f64,
    /// A tick may be missed, but not two in a row.
    pub may_miss: bool,
    /// From reading the encoder to the torque's change, s.
    pub delay_s: f64,
    /// τ, the time constant of the amplifier, s.
    pub amplifier_tau_s: f64,
}

impl Timing {
    /// Every `period_s`, at once.
    #[must_use]
    pub fn ideal(period_s: f64) -> Self {
        Self {
            period_s,
            jitter_s: 0.0,
            may_miss: false,
            delay_s: 0.0,
            amplifier_tau_s: 0.0,
        }
    }

    /// T_max, the longest interval between two ticks, s.
    #[must_use]
    pub fn longest_s(&self) -> f64 {
        let ticks = if self.may_miss { 2.0 } else { 1.0 };
        ticks * (self.period_s + self.jitter_s)
    }

    /// The shortest interval between two ticks, s.
    #[must_use]
    pub fn shortest_s(&self) -> f64 {
        self.period_s - self.jitter_s
    }

    /// Te = T_max + 2·delay + 2τ, s: the period that the margin reckons with.
    #[must_use]
    pub fn effective_s(&self) -> f64 {
        self.longest_s() + 2.0 * self.delay_s + 2.0 * self.amplifier_tau_s
    }
}

/// Everything a controller is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// The device as it is believed to be; its worse ends count.
    pub believed: Believed,
    /// When ticks run and torques act.
    pub timing: Timing,
    /// The step of the torque's DAC, Nm; 0 is none.
    pub torque_step_nm: f64,
    /// The size of one hardware count, before decimation, rad.
    pub hardware_count_rad: f64,
    /// How the hardware counter is read.
    pub encoder: EncoderConfig,
    /// What is rendered.
    pub shape: Shape,
    /// The demanded stiffness K, Nm/rad.
    pub stiffness_nm_rad: f64,
    /// The demanded virtual damping, Nm s/rad.
    pub damping_nm_s_rad: f64,
    /// The law that decides how much of it is applied.
    pub law: Law,
    /// The largest torque commanded, in magnitude, Nm.
    pub torque_max_nm: f64,
}

impl Config {
    /// Δ: the size of a count after decimation, rad.
    #[must_use]
    pub fn count_rad(&self) -> f64 {
        self.hardware_count_rad * f64::from(self.encoder.decimation())
    }
}

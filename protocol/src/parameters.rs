use serde::{Deserialize, Serialize};

/// A quantity that is known to lie between two values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The least it may be.
    pub low: f32,
    /// The most it may be.
    pub high: f32,
}

/// What decides the torque that is applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Law {
    /// The demanded stiffness, whatever it does.
    Raw,
    /// What is passive at every speed.
    Static,
    /// What is passive at the worst speed of this contact.
    Episode,
    /// What an account of measured energy pays for.
    Ledger,
    /// The cheapest of static, episode and ledger that applies the whole demand, or the ledger.
    Auto,
}

/// What is rendered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// A spring about `centre_rad`.
    Spring,
    /// A wall at `wall_rad`, felt above it.
    Wall,
    /// Minima `period_rad` apart, one of them at `centre_rad`.
    Detent,
}

/// Declares the parameters once: the set that a device holds, the changes that a message
/// carries, and their names.
macro_rules! parameters {
    ($($(#[$doc:meta])* $field:ident / $name:ident: $type:ty,)*) => {
        /// Everything that can be set, in SI units.
        #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
        pub struct Parameters {
            $($(#[$doc])* pub $field: $type,)*
        }

        /// Parameters to change; None stays. A set is taken whole or not at all.
        #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
        pub struct Changes {
            $($(#[$doc])* pub $field: Option<$type>,)*
        }

        /// The name of a parameter.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        pub enum Name {
            $($(#[$doc])* $name,)*
        }

        impl Name {
            /// All names, in the order of the wire.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// As a user writes it.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => stringify!($field),)*
                }
            }
        }

        impl Parameters {
            /// These parameters with the changes made.
            #[must_use]
            pub fn with(&self, changes: &Changes) -> Self {
                Self {
                    $($field: changes.$field.unwrap_or(self.$field),)*
                }
            }
        }
    };
}

parameters! {
    /// The sample period T, s. Only while disarmed.
    sample_period_s / SamplePeriodS: f32,
    /// Hardware counts per count. Only while disarmed.
    decimation / Decimation: u32,
    /// Hardware counts per revolution of the encoder. Only while disarmed.
    counts_per_rev / CountsPerRev: u32,
    /// The law that decides how much of the demand is applied.
    law / Law: Law,
    /// What is rendered.
    shape / Shape: Shape,
    /// The demanded stiffness K, Nm/rad.
    stiffness_nm_rad / StiffnessNmRad: f32,
    /// The demanded virtual damping B, Nm s/rad.
    damping_nm_s_rad / DampingNmSRad: f32,
    /// The centre of the spring, or a minimum of the detents, rad.
    centre_rad / CentreRad: f32,
    /// The edge of the wall, rad.
    wall_rad / WallRad: f32,
    /// From one minimum of the detents to the next, rad; two counts or more.
    period_rad / PeriodRad: f32,
    /// The largest torque commanded, Nm.
    torque_max_nm / TorqueMaxNm: f32,
    /// The fastest that the knob can turn, rad/s; a count that moved further is a fault.
    speed_max_rad_s / SpeedMaxRadS: f32,
    /// The inertia m as it is believed to be, kg m².
    inertia_kg_m2 / InertiaKgM2: Interval,
    /// The viscous friction b as it is believed to be, Nm s/rad.
    viscous_nm_s_rad / ViscousNmSRad: Interval,
    /// The Coulomb friction c as it is believed to be, Nm.
    coulomb_nm / CoulombNm: Interval,
    /// The delay from the encoder's reading to the torque's change as it is believed to be, s.
    delay_s / DelayS: f32,
    /// The time constant of the amplifier as it is believed to be, s.
    amplifier_tau_s / AmplifierTauS: f32,
    /// By how much the sample period is believed to vary, either way, s.
    jitter_s / JitterS: f32,
    /// The step of the torque's DAC as it is believed to be, Nm; 0: none.
    torque_step_nm / TorqueStepNm: f32,
}

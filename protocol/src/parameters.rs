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

/// How the bridge drives the motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Drive {
    /// Not said yet: nothing is driven.
    None,
    /// Three phases, by their currents.
    Current,
    /// Three phases of high resistance, by voltage.
    Voltage,
    /// Brushed, between phases B and C, by its current.
    Brushed,
}

/// Declares a set of values once: the set that a device holds, the changes that a message
/// carries, and their names.
macro_rules! values {
    ($(#[$of_set:meta])* $Set:ident, $(#[$of_changes:meta])* $Changes:ident, $(#[$of_name:meta])* $Name:ident:
     $($(#[$doc:meta])* $field:ident / $name:ident: $type:ty,)*) => {
        $(#[$of_set])*
        #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
        pub struct $Set {
            $($(#[$doc])* pub $field: $type,)*
        }

        $(#[$of_changes])*
        #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
        pub struct $Changes {
            $($(#[$doc])* pub $field: Option<$type>,)*
        }

        $(#[$of_name])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        pub enum $Name {
            $($(#[$doc])* $name,)*
        }

        impl $Name {
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

        impl $Set {
            /// These with the changes made.
            #[must_use]
            pub fn with(&self, changes: &$Changes) -> Self {
                Self {
                    $($field: changes.$field.unwrap_or(self.$field),)*
                }
            }
        }
    };
}

values! {
    /// Everything that can be set of the rendering and of what is believed, in SI units.
    Parameters,
    /// Parameters to change; None stays. A set is taken whole or not at all.
    Changes,
    /// The name of a parameter.
    Name:
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

values! {
    /// The motor at the bridge and how its encoder sits, as `knob calibrate` finds them, in SI units. Only a board with
    /// a power stage looks at it.
    Motor,
    /// What to change of a motor; None stays. Only while disarmed, whole or not at all.
    MotorChanges,
    /// The name of a motor's value.
    MotorName:
    /// How it is driven.
    drive / Drive: Drive,
    /// p; 1 of a brushed motor.
    pole_pairs / PolePairs: u32,
    /// R of one phase, or between the ends of a brushed motor, Ω.
    resistance_ohm / ResistanceOhm: f32,
    /// L_d, or L of a brushed motor, H.
    d_inductance_h / DInductanceH: f32,
    /// L_q, H; as L_d of a brushed motor.
    q_inductance_h / QInductanceH: f32,
    /// Torque of one ampere, along q where there are three phases, Nm/A: 3/2 p ψ, or k of a brushed motor.
    torque_constant_nm_a / TorqueConstantNmA: f32,
    /// The largest current commanded, A.
    current_max_a / CurrentMaxA: f32,
    /// The counter falls while the phases follow each other as A, B, C; of a brushed motor, while current
    /// flows from B to C.
    reversed / Reversed: bool,
    /// The electrical angle in the middle of count 0, turns.
    zero_turns / ZeroTurns: f32,
    /// Mean code of B's converter without current.
    offset_b_codes / OffsetBCodes: f32,
    /// Mean code of C's converter without current.
    offset_c_codes / OffsetCCodes: f32,
}

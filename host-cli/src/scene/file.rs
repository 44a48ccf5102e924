//! The tables of a scene file as they are written: every key this version reads, and no
//! other; an unknown key is refused by name.

use serde::Deserialize;
use serde::de::IgnoredAny;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    pub device: DeviceTable,
    #[serde(rename = "loop")]
    pub sampling: LoopTable,
    pub electrical: Option<ElectricalTable>,
    #[serde(default)]
    pub believed: BelievedTable,
    pub render: RenderTable,
    #[serde(default)]
    pub start: StartTable,
    #[serde(default)]
    pub hand: HandTable,
    #[serde(default)]
    pub run: RunTable,
}

/// A device file: the tables of a scene file that say what is controlled. The others may be there.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceFile {
    pub device: DeviceTable,
    #[serde(rename = "loop")]
    pub sampling: LoopTable,
    pub electrical: Option<ElectricalTable>,
    #[serde(rename = "believed")]
    _believed: Option<IgnoredAny>,
    #[serde(rename = "render")]
    _render: Option<IgnoredAny>,
    #[serde(rename = "start")]
    _start: Option<IgnoredAny>,
    #[serde(rename = "hand")]
    _hand: Option<IgnoredAny>,
    #[serde(rename = "run")]
    _run: Option<IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceTable {
    pub inertia_kg_m2: f64,
    pub viscous_nm_s_rad: f64,
    pub coulomb_nm: f64,
    pub counts_per_rev: Option<f64>,
    pub count_rad: Option<f64>,
    #[serde(default)]
    pub cogging_nm: f64,
    #[serde(default)]
    pub cogging_per_rev: f64,
    #[serde(default)]
    pub stiction_nm: f64,
    #[serde(default)]
    pub stribeck_rad_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopTable {
    pub sample_period_s: f64,
    #[serde(default = "one")]
    pub decimation: u32,
    #[serde(default)]
    pub delay_s: f64,
    #[serde(default)]
    pub amplifier_tau_s: f64,
    #[serde(default)]
    pub torque_step_nm: f64,
    /// No limit where it is not given.
    #[serde(default = "unlimited")]
    pub torque_max_nm: f64,
    #[serde(default)]
    pub jitter_s: f64,
    #[serde(default)]
    pub missed_ticks: f64,
}

/// Windings behind an inverter, in place of delay, lag and steps of the torque.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElectricalTable {
    pub drive: DriveName,
    pub resistance_ohm: f64,
    /// Of three phases.
    pub d_inductance_h: Option<f64>,
    /// L_d where it is not given.
    pub q_inductance_h: Option<f64>,
    /// Of a brushed motor.
    pub inductance_h: Option<f64>,
    pub flux_wb: Option<f64>,
    pub torque_constant_nm_a: Option<f64>,
    pub pole_pairs: Option<u32>,
    pub pwm_period_s: f64,
    #[serde(default)]
    pub pwm_steps: u16,
    #[serde(default)]
    pub dead_time_s: f64,
    #[serde(default = "fifth")]
    pub dead_time_edge_a: f64,
    #[serde(default = "yes")]
    pub late: bool,
    pub current_step_a: Option<f64>,
    #[serde(default)]
    pub current_noise_a: f64,
    /// Of phases B and C.
    #[serde(default)]
    pub current_offset_a: [f64; 2],
    pub source_v: f64,
    #[serde(default)]
    pub source_ohm: f64,
    #[serde(default)]
    pub capacitance_f: f64,
    #[serde(default = "yes")]
    pub takes_back: bool,
    pub bandwidth_rad_s: Option<f64>,
    pub current_max_a: f64,
    #[serde(default)]
    pub tolerance: f64,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
pub enum DriveName {
    Current,
    Voltage,
    Brushed,
}

fn fifth() -> f64 {
    0.2
}

fn yes() -> bool {
    true
}

fn one() -> u32 {
    1
}

pub fn unlimited() -> f64 {
    f64::from(f32::MAX)
}

/// What the controller is told where that is not what is true.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct BelievedTable {
    pub inertia_kg_m2: Option<Belief>,
    pub viscous_nm_s_rad: Option<Belief>,
    pub coulomb_nm: Option<Belief>,
    pub counts_per_rev: Option<f64>,
    pub count_rad: Option<f64>,
    pub sample_period_s: Option<f64>,
    pub delay_s: Option<f64>,
    pub amplifier_tau_s: Option<f64>,
    pub torque_step_nm: Option<f64>,
    pub jitter_s: Option<f64>,
    pub missed_ticks: Option<f64>,
    /// The next four are what a drive is told.
    pub resistance_ohm: Option<f64>,
    pub d_inductance_h: Option<f64>,
    pub q_inductance_h: Option<f64>,
    pub inductance_h: Option<f64>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(untagged, expecting = "expected a number, or [low, high]")]
pub enum Belief {
    Exactly(f64),
    Between([f64; 2]),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderTable {
    pub law: LawName,
    pub shape: ShapeName,
    pub stiffness_nm_rad: f64,
    #[serde(default)]
    pub damping_nm_s_rad: f64,
    pub centre_rad: Option<f64>,
    pub wall_rad: Option<f64>,
    pub period_rad: Option<f64>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
pub enum LawName {
    Raw,
    Static,
    Episode,
    Ledger,
    Auto,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
pub enum ShapeName {
    Spring,
    Wall,
    Detent,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct StartTable {
    pub angle_rad: f64,
    pub velocity_rad_s: f64,
}

/// No hand where it is absent.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct HandTable {
    pub inertia_kg_m2: f64,
    pub damping_nm_s_rad: f64,
    pub stiffness_nm_rad: f64,
    pub rest_rad: f64,
    pub push_nm: f64,
    pub shake_nm: f64,
    pub shake_hz: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunTable {
    pub samples: u64,
    pub seed: u64,
}

impl Default for RunTable {
    fn default() -> Self {
        Self {
            samples: 50_000,
            seed: 0,
        }
    }
}

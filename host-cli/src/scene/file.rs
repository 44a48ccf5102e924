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

/// A device file: the first two tables of a scene file. The others may be there.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceFile {
    pub device: DeviceTable,
    #[serde(rename = "loop")]
    pub sampling: LoopTable,
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

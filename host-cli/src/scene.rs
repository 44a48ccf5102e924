//! The scene file: a device, how it is sampled, what is rendered, and how it starts.
//!
//! The file is read into plain data that knows every key this version reads and no
//! other; an unknown key is refused by name. [`load`] turns it into a
//! [`Scene`] that can be run.

use std::f64::consts::TAU;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use control::config::{Believed, Config, Interval, Law, Timing};
use control::criterion::Device;
use control::encoder::EncoderConfig;
use control::shape::Shape;
use plant_sim::clock::Clock;
use plant_sim::closed_loop::Scene;
use plant_sim::drive::Drive;
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::number::digits;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    device: DeviceTable,
    #[serde(rename = "loop")]
    sampling: LoopTable,
    #[serde(default)]
    believed: BelievedTable,
    render: RenderTable,
    #[serde(default)]
    start: StartTable,
    #[serde(default)]
    run: RunTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DeviceTable {
    inertia_kg_m2: f64,
    viscous_nm_s_rad: f64,
    coulomb_nm: f64,
    counts_per_rev: Option<f64>,
    count_rad: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LoopTable {
    sample_period_s: f64,
    #[serde(default = "one")]
    decimation: u32,
    /// No limit where it is not given.
    #[serde(default = "unlimited")]
    torque_max_nm: f64,
}

/// What the controller is told where that is not what is true.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct BelievedTable {
    inertia_kg_m2: Option<Belief>,
    viscous_nm_s_rad: Option<Belief>,
    coulomb_nm: Option<Belief>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(untagged, expecting = "expected a number, or [low, high]")]
enum Belief {
    Exactly(f64),
    Between([f64; 2]),
}

impl Belief {
    /// The interval of a key: what is believed, or else the truth.
    fn interval(key: &str, belief: Option<Self>, truth: f64) -> Result<Interval> {
        let [low, high] = match belief {
            None => [truth; 2],
            Some(Self::Exactly(value)) => [value; 2],
            Some(Self::Between(ends)) => ends,
        };
        if !(0.0 <= low && low <= high && high <= MOST) {
            bail!(
                "{key} is [{}, {}]; accepted: finite, 0 or more, up to {MOST:e}, the lower end first",
                plain(low),
                plain(high)
            );
        }
        Ok(Interval { low, high })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RenderTable {
    law: LawName,
    shape: ShapeName,
    stiffness_nm_rad: f64,
    centre_rad: Option<f64>,
    wall_rad: Option<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum LawName {
    Raw,
    Static,
    Episode,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum ShapeName {
    Spring,
    Wall,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct StartTable {
    #[serde(default)]
    angle_rad: f64,
    #[serde(default)]
    velocity_rad_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RunTable {
    samples: u64,
    /// Taken, so that a file with a seed can be run; nothing here is random.
    #[serde(rename = "seed")]
    _seed: u64,
}

impl Default for RunTable {
    fn default() -> Self {
        Self {
            samples: 50_000,
            _seed: 0,
        }
    }
}

/// A device file: the first two tables of a scene file. The others may be there.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DeviceFile {
    device: DeviceTable,
    #[serde(rename = "loop")]
    sampling: LoopTable,
    #[serde(rename = "believed")]
    _believed: Option<IgnoredAny>,
    #[serde(rename = "render")]
    _render: Option<IgnoredAny>,
    #[serde(rename = "start")]
    _start: Option<IgnoredAny>,
    #[serde(rename = "run")]
    _run: Option<IgnoredAny>,
}

/// A device and how it is sampled, from a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampledDevice {
    pub device: Device<f64>,
    /// Size of a count before decimation, rad.
    pub hardware_count_rad: f64,
    pub decimation: u32,
    pub period_s: f64,
}

impl SampledDevice {
    /// Δ, rad.
    pub fn count_rad(&self) -> f64 {
        self.hardware_count_rad * f64::from(self.decimation)
    }
}

fn one() -> u32 {
    1
}

fn unlimited() -> f64 {
    f64::from(f32::MAX)
}

/// Reads and checks a scene file.
pub fn load(path: &Path) -> Result<Scene> {
    let text = read(path)?;
    parse(&text).with_context(|| path.display().to_string())
}

/// Reads and checks a device file: `[device]` and `[loop]`; a whole scene file will do.
pub fn load_device(path: &Path) -> Result<SampledDevice> {
    let text = read(path)?;
    let parsed = toml::from_str(&text).map_err(anyhow::Error::from);
    parsed
        .and_then(|file: DeviceFile| sampled_device(&file.device, &file.sampling))
        .with_context(|| path.display().to_string())
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Checks the text of a scene file.
pub fn parse(text: &str) -> Result<Scene> {
    let file: SceneFile = toml::from_str(text)?;
    let sampled = sampled_device(&file.device, &file.sampling)?;
    let render = &file.render;
    not_negative("render.stiffness_nm_rad", render.stiffness_nm_rad)?;
    let (wall, zero_key, zero) = match render.shape {
        ShapeName::Spring => {
            if render.wall_rad.is_some() {
                bail!("render.wall_rad is given, but shape = \"spring\" reads centre_rad");
            }
            (false, "render.centre_rad", render.centre_rad)
        }
        ShapeName::Wall => {
            if render.centre_rad.is_some() {
                bail!("render.centre_rad is given, but shape = \"wall\" reads wall_rad");
            }
            (true, "render.wall_rad", render.wall_rad)
        }
    };
    let zero_rad = zero.unwrap_or(0.0);
    finite(zero_key, zero_rad)?;
    let furthest_rad = sampled.count_rad() * f64::from(1_u32 << 30);
    if zero_rad.abs() >= furthest_rad {
        bail!(
            "{zero_key} is {}, 2^30 counts or more from zero; accepted: less than {} rad either way",
            plain(zero_rad),
            digits(furthest_rad, 6)
        );
    }
    finite("start.angle_rad", file.start.angle_rad)?;
    finite("start.velocity_rad_s", file.start.velocity_rad_s)?;
    if file.run.samples == 0 {
        bail!("run.samples is 0; accepted: a whole number from 1");
    }
    let (told, device) = (&file.believed, &sampled.device);
    let believed = Believed {
        inertia_kg_m2: Belief::interval(
            "believed.inertia_kg_m2",
            told.inertia_kg_m2,
            device.inertia_kg_m2,
        )?,
        viscous_nm_s_rad: Belief::interval(
            "believed.viscous_nm_s_rad",
            told.viscous_nm_s_rad,
            device.viscous_nm_s_rad,
        )?,
        coulomb_nm: Belief::interval("believed.coulomb_nm", told.coulomb_nm, device.coulomb_nm)?,
    };
    positive("believed.inertia_kg_m2", believed.inertia_kg_m2.low)?;
    let torque_max_nm = file.sampling.torque_max_nm;
    if !(0.0..=unlimited()).contains(&torque_max_nm) {
        let accepted = "0 or more, up to 3.4e38; without the key there is no limit";
        return Err(refuse("loop.torque_max_nm", torque_max_nm, accepted));
    }
    let scene = Scene {
        device: sampled.device,
        drive: Drive::default(),
        clock: Clock {
            period_s: sampled.period_s,
            jitter_s: 0.0,
            missed_ticks: 0.0,
        },
        hand: Hand::default(),
        seed: 0,
        config: Config {
            believed,
            timing: Timing::ideal(sampled.period_s),
            torque_step_nm: 0.0,
            damping_nm_s_rad: 0.0,
            hardware_count_rad: sampled.hardware_count_rad,
            encoder: EncoderConfig::new(32, sampled.decimation)?,
            shape: if wall {
                Shape::Wall { edge_rad: zero_rad }
            } else {
                Shape::Spring {
                    centre_rad: zero_rad,
                }
            },
            stiffness_nm_rad: render.stiffness_nm_rad,
            law: match render.law {
                LawName::Raw => Law::Raw,
                LawName::Static => Law::Static,
                LawName::Episode => Law::Episode,
            },
            torque_max_nm,
        },
        start: State {
            position: file.start.angle_rad,
            velocity: file.start.velocity_rad_s,
        },
        samples: file.run.samples,
    };
    Ok(scene)
}

fn sampled_device(device: &DeviceTable, sampling: &LoopTable) -> Result<SampledDevice> {
    positive("device.inertia_kg_m2", device.inertia_kg_m2)?;
    not_negative("device.viscous_nm_s_rad", device.viscous_nm_s_rad)?;
    not_negative("device.coulomb_nm", device.coulomb_nm)?;
    positive("loop.sample_period_s", sampling.sample_period_s)?;
    if sampling.decimation == 0 {
        bail!("loop.decimation is 0; accepted: a whole number from 1");
    }
    let hardware_count_rad = match (device.counts_per_rev, device.count_rad) {
        (Some(counts), None) => TAU / positive("device.counts_per_rev", counts)?,
        (None, Some(count)) => positive("device.count_rad", count)?,
        (Some(_), Some(_)) => bail!(
            "device.counts_per_rev and device.count_rad are both given; accepted: one of them"
        ),
        (None, None) => {
            bail!("device.counts_per_rev is missing; accepted: it, or device.count_rad")
        }
    };
    Ok(SampledDevice {
        device: Device {
            inertia_kg_m2: device.inertia_kg_m2,
            viscous_nm_s_rad: device.viscous_nm_s_rad,
            coulomb_nm: device.coulomb_nm,
        },
        hardware_count_rad,
        decimation: sampling.decimation,
        period_s: sampling.sample_period_s,
    })
}

/// The smallest and the largest quantity of a device or a spring: the controller computes
/// in f32, which must hold them and their ratios.
const LEAST: f64 = 1e-15;
const MOST: f64 = 1e15;

/// A number as a user would write it.
fn plain(value: f64) -> String {
    if value == 0.0 || !value.is_finite() || (1e-6..1e16).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

fn refuse(key: &str, value: f64, accepted: &str) -> anyhow::Error {
    anyhow!("{key} is {}; accepted: {accepted}", plain(value))
}

fn finite(key: &str, value: f64) -> Result<f64> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(refuse(key, value, "a finite number"))
    }
}

fn positive(key: &str, value: f64) -> Result<f64> {
    if (LEAST..=MOST).contains(&value) {
        Ok(value)
    } else {
        let accepted = format!("a finite number above 0, from {LEAST:e} to {MOST:e}");
        Err(refuse(key, value, &accepted))
    }
}

fn not_negative(key: &str, value: f64) -> Result<f64> {
    if (0.0..=MOST).contains(&value) {
        Ok(value)
    } else {
        let accepted = format!("a finite number, 0 or more, up to {MOST:e}");
        Err(refuse(key, value, &accepted))
    }
}

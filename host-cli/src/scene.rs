//! The scene file: a device, how it is sampled, what is rendered, who holds it, and how it
//! starts.
//!
//! [`load`] reads the tables of `file`, refuses every value that makes no sense by its key,
//! and gives a [`Loaded`] that runs.

pub(crate) mod accepted;
mod electrical;
mod file;

use std::f64::consts::TAU;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use control::ConfigError;
use control::config::{Believed, Config, Interval, Law, Timing};
use control::criterion::{Criterion, Device, Sampling};
use control::encoder::EncoderConfig;
use control::plan::Plan;
use control::shape::{Profile, Shape};
use control::tick::{Controller, Tick};
use control::torque::Delivery;
use plant_sim::clock::Clock;
use plant_sim::closed_loop::{Report, Sample, Scene};
use plant_sim::display::Display;
use plant_sim::drive::Drive;
use plant_sim::driven::Passed;
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::knob::{Knob, KnobError};
use plant_sim::motor::{MOST_PERIODS, Motor};
use plant_sim::powered::Setup;

use accepted::{MOST, bound, finite, not_negative, plain, positive, refuse, share, signed};
use electrical::Electrical;
use file::{
    Belief, BelievedTable, DeviceFile, DeviceTable, HandTable, LawName, LoopTable, RenderTable,
    SceneFile, ShapeName, unlimited,
};

/// A scene that was checked.
pub struct Loaded {
    /// The truth; its configuration has the true count size and timing.
    pub scene: Scene,
    /// What the controller believes and does.
    plan: Plan,
    /// Of it, the timing.
    told: Timing,
    /// The windings of `[electrical]`; the scene's drive is then what stands for them in the plan.
    electrical: Option<Electrical>,
}

/// What the windings were taken for, and what they went through.
#[derive(Debug, Clone, Copy)]
pub struct Windings {
    /// What the drive says of itself.
    pub delivery: Delivery,
    /// What the controller was told.
    pub told: Timing,
    /// What the windings went through.
    pub passed: Passed,
}

impl Loaded {
    /// Runs it. `observe` sees every sample and may end the run by returning false.
    ///
    /// # Errors
    /// A start out of the counts' reach.
    pub fn run(&self, observe: impl FnMut(&Sample) -> bool) -> Result<Report> {
        Ok(self.run_telling(observe)?.0)
    }

    /// The same; a scene that has windings tells of them.
    ///
    /// # Errors
    /// A start out of the counts' reach.
    pub fn run_telling(
        &self,
        observe: impl FnMut(&Sample) -> bool,
    ) -> Result<(Report, Option<Windings>)> {
        let Some(electrical) = &self.electrical else {
            return Ok((self.scene.run_under(self.control(), observe)?, None));
        };
        let mut driven = electrical.driven(&self.scene)?;
        let hold = |torque_nm: f64, duration_s: f64| driven.hold(torque_nm, duration_s);
        let report = self.scene.run_on(hold, self.control(), observe)?;
        let windings = Windings {
            delivery: electrical.delivery,
            told: self.told,
            passed: driven.passed(),
        };
        Ok((report, Some(windings)))
    }

    /// The knob with its windings, if it has any.
    pub fn powered(&self) -> Option<Setup> {
        let electrical = self.electrical.as_ref()?;
        Some(electrical.setup(&self.scene))
    }

    /// Whether it has windings.
    pub fn is_electrical(&self) -> bool {
        self.electrical.is_some()
    }

    /// What its controller does at the start and from then on.
    pub fn control(&self) -> impl FnMut(u32, f32) -> Tick + use<> {
        let mut controller = Controller::new(self.plan, self.scene.start_count());
        move |counter, duration_s| controller.tick(counter, duration_s)
    }

    /// When a sample is, s: k·T to the last digit where ticks are even.
    pub fn time_s(&self, sample: &Sample) -> f64 {
        let clock = &self.scene.clock;
        if clock.jitter_s == 0.0 && clock.missed_ticks == 0.0 {
            sample.number as f64 * clock.period_s
        } else {
            sample.time_s
        }
    }

    /// (10) and (11) for what is true, with the terms of [`control::margin`]: Te for T, a wall's
    /// first step for Δ, and under raw, which neither limits damping nor cuts to the DAC's
    /// steps, less friction for both.
    ///
    /// # Errors
    /// See [`Criterion::new`].
    pub fn criterion(&self) -> Result<Criterion<f64>> {
        let scene = &self.scene;
        let config = &scene.config;
        let steps = Profile::new(&config.shape, config.count_rad())?.step_counts();
        let mut device = scene.device;
        if config.law == Law::Raw {
            let damping = config.damping_nm_s_rad;
            let wrong_nm = 0.5 * scene.drive.torque_step_nm
                + damping * config.count_rad() / config.timing.shortest_s();
            device.viscous_nm_s_rad = (device.viscous_nm_s_rad - damping).max(0.0);
            device.coulomb_nm = (device.coulomb_nm - wrong_nm).max(0.0);
        }
        let sampling = Sampling {
            period_s: config.timing.effective_s(),
            count_rad: config.count_rad() * steps,
        };
        Ok(Criterion::new(device, sampling)?)
    }

    /// The dimensionless display (6) that this scene is, and its start in counts and counts per
    /// sample (7).
    ///
    /// # Errors
    /// Refuses a scene that is more than a raw spring about zero on a bare knob, sampled evenly and
    /// without delay, lag, steps or limit of the torque; says what is too much.
    pub fn display(&self) -> Result<(Display, State)> {
        let scene = &self.scene;
        let config = &scene.config;
        let more = [
            ("another law than raw", config.law != Law::Raw),
            (
                "another shape than a spring about 0 rad",
                config.shape != Shape::Spring { centre_rad: 0.0 },
            ),
            ("no stiffness", config.stiffness_nm_rad == 0.0),
            ("damping", config.damping_nm_s_rad != 0.0),
            ("a hand", self.has_hand()),
            ("windings", self.is_electrical()),
            ("cogging or stiction", scene.motor != Motor::default()),
            (
                "delay, lag or steps of the torque",
                scene.drive != Drive::default(),
            ),
            (
                "jitter or missed ticks",
                scene.clock.jitter_s != 0.0 || scene.clock.missed_ticks != 0.0,
            ),
            ("a limit of the torque", config.torque_max_nm < unlimited()),
            (
                "a controller that was told otherwise",
                self.plan != Plan::new(config)?,
            ),
        ];
        if let Some((what, _)) = more.into_iter().find(|(_, is)| *is) {
            bail!("the scene has {what}; accepted: a raw spring about 0 rad on a bare knob");
        }
        let criterion = self.criterion()?;
        let count_rad = config.count_rad();
        let start = State {
            position: scene.start.position / count_rad,
            velocity: scene.start.velocity * config.timing.period_s / count_rad,
        };
        let display = Display::new(criterion.dimensionless(config.stiffness_nm_rad))?;
        Ok((display, start))
    }

    /// Whether a hand is on the knob.
    pub fn has_hand(&self) -> bool {
        self.scene.hand != Hand::default()
    }
}

/// A device and how it is sampled, from a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SampledDevice {
    pub device: Device<f64>,
    /// Size of a count before decimation, rad.
    pub hardware_count_rad: f64,
    pub decimation: u32,
    pub timing: Timing,
}

impl SampledDevice {
    /// Δ, rad.
    pub fn count_rad(&self) -> f64 {
        self.hardware_count_rad * f64::from(self.decimation)
    }
}

/// Reads and checks a scene file.
pub fn load(path: &Path) -> Result<Loaded> {
    let text = read(path)?;
    parse(&text).with_context(|| path.display().to_string())
}

/// Reads and checks a device file: `[device]` and `[loop]`; a whole scene file will do.
pub(crate) fn load_device(path: &Path) -> Result<SampledDevice> {
    let text = read(path)?;
    let parsed = toml::from_str(&text).map_err(anyhow::Error::from);
    parsed
        .and_then(|mut file: DeviceFile| {
            if let Some(table) = &file.electrical {
                let believed = BelievedTable::default();
                electrical::read(table, &believed, &file.device, &mut file.sampling)?;
            }
            sampled_device(&file.device, &file.sampling)
        })
        .with_context(|| path.display().to_string())
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Checks the text of a scene file.
pub fn parse(text: &str) -> Result<Loaded> {
    let mut file: SceneFile = toml::from_str(text)?;
    let electrical = match &file.electrical {
        Some(table) => Some(electrical::read(
            table,
            &file.believed,
            &file.device,
            &mut file.sampling,
        )?),
        None => no_windings(&file.believed)?,
    };
    let sampled = sampled_device(&file.device, &file.sampling)?;
    let sampling = &file.sampling;
    let clock = Clock {
        period_s: sampling.sample_period_s,
        jitter_s: sampling.jitter_s,
        missed_ticks: sampling.missed_ticks,
    };
    let drive = Drive {
        delay_s: sampling.delay_s,
        amplifier_tau_s: sampling.amplifier_tau_s,
        torque_step_nm: sampling.torque_step_nm,
    };
    let motor = motor(&file.device)?;
    let hand = hand(&file.hand)?;
    let told = told(&file.believed, &sampled, sampling)?;
    let render = &file.render;
    not_negative("render.stiffness_nm_rad", render.stiffness_nm_rad)?;
    not_negative("render.damping_nm_s_rad", render.damping_nm_s_rad)?;
    let count_rad = told.hardware_count_rad * f64::from(sampled.decimation);
    let shape = shape(render, count_rad)?;
    finite("start.angle_rad", file.start.angle_rad)?;
    finite("start.velocity_rad_s", file.start.velocity_rad_s)?;
    if file.run.samples == 0 {
        bail!("run.samples is 0; accepted: a whole number from 1");
    }
    let config = Config {
        believed: told.device,
        timing: told.timing,
        torque_step_nm: told.torque_step_nm,
        hardware_count_rad: told.hardware_count_rad,
        encoder: EncoderConfig::new(32, sampled.decimation)
            .map_err(|error| named(error, &told, render))?,
        shape,
        stiffness_nm_rad: render.stiffness_nm_rad,
        damping_nm_s_rad: render.damping_nm_s_rad,
        law: match render.law {
            LawName::Raw => Law::Raw,
            LawName::Static => Law::Static,
            LawName::Episode => Law::Episode,
            LawName::Ledger => Law::Ledger,
            LawName::Auto => Law::Auto,
        },
        torque_max_nm: sampling.torque_max_nm,
    };
    let plan = Plan::new(&config).map_err(|error| named(error, &told, render))?;
    let start = State {
        position: file.start.angle_rad,
        velocity: file.start.velocity_rad_s,
    };
    Knob::new(
        &sampled.device,
        &motor,
        &hand,
        &drive,
        clock.period_s,
        start,
    )
    .map_err(|error| knob_named(error, &sampled.device, &hand))?;
    let scene = Scene {
        device: sampled.device,
        motor,
        drive,
        clock,
        hand,
        config: Config {
            timing: sampled.timing,
            hardware_count_rad: sampled.hardware_count_rad,
            ..config
        },
        start,
        samples: file.run.samples,
        seed: file.run.seed,
    };
    Ok(Loaded {
        scene,
        plan,
        told: config.timing,
        electrical,
    })
}

/// Refuses what only a drive is told.
fn no_windings(believed: &BelievedTable) -> Result<Option<Electrical>> {
    for (key, value) in [
        ("resistance_ohm", believed.resistance_ohm),
        ("d_inductance_h", believed.d_inductance_h),
        ("q_inductance_h", believed.q_inductance_h),
        ("inductance_h", believed.inductance_h),
    ] {
        if value.is_some() {
            bail!(
                "believed.{key} is given, but there are no windings; accepted: with [electrical]"
            );
        }
    }
    Ok(None)
}

fn sampled_device(device: &DeviceTable, sampling: &LoopTable) -> Result<SampledDevice> {
    positive("device.inertia_kg_m2", device.inertia_kg_m2)?;
    not_negative("device.viscous_nm_s_rad", device.viscous_nm_s_rad)?;
    not_negative("device.coulomb_nm", device.coulomb_nm)?;
    let hardware_count_rad = count_rad("device", device.counts_per_rev, device.count_rad)?
        .context("device.counts_per_rev is missing; accepted: it, or device.count_rad")?;
    let period_s = positive("loop.sample_period_s", sampling.sample_period_s)?;
    if sampling.decimation == 0 {
        bail!("loop.decimation is 0; accepted: a whole number from 1");
    }
    not_negative("loop.torque_step_nm", sampling.torque_step_nm)?;
    let torque_max_nm = sampling.torque_max_nm;
    if !(0.0..=unlimited()).contains(&torque_max_nm) {
        let accepted = "0 or more, up to 3.4e38; without the key there is no limit";
        return Err(refuse("loop.torque_max_nm", torque_max_nm, accepted));
    }
    Ok(SampledDevice {
        device: Device {
            inertia_kg_m2: device.inertia_kg_m2,
            viscous_nm_s_rad: device.viscous_nm_s_rad,
            coulomb_nm: device.coulomb_nm,
        },
        hardware_count_rad,
        decimation: sampling.decimation,
        timing: Timing {
            period_s,
            delay_s: not_negative("loop.delay_s", sampling.delay_s)?,
            amplifier_tau_s: not_negative("loop.amplifier_tau_s", sampling.amplifier_tau_s)?,
            may_miss: share("loop.missed_ticks", sampling.missed_ticks)? > 0.0,
            jitter_s: jitter("loop.jitter_s", sampling.jitter_s, period_s)?,
        },
    })
}

/// A jitter that leaves something of every period.
fn jitter(key: &str, jitter_s: f64, period_s: f64) -> Result<f64> {
    not_negative(key, jitter_s)?;
    if jitter_s < period_s {
        return Ok(jitter_s);
    }
    let accepted = format!("less than the sample period, {} s", bound(period_s));
    Err(refuse(key, jitter_s, &accepted))
}

/// The size of a hardware count in a table, rad, if it is there in one of the two ways.
fn count_rad(table: &str, per_rev: Option<f64>, count_rad: Option<f64>) -> Result<Option<f64>> {
    match (per_rev, count_rad) {
        (Some(counts), None) => {
            let counts = positive(&format!("{table}.counts_per_rev"), counts)?;
            Ok(Some(TAU / counts))
        }
        (None, Some(count)) => positive(&format!("{table}.count_rad"), count).map(Some),
        (Some(_), Some(_)) => bail!(
            "{table}.counts_per_rev and {table}.count_rad are both given; accepted: one of them"
        ),
        (None, None) => Ok(None),
    }
}

/// What the controller is told, and under which key it stands.
struct Told {
    device: Believed,
    inertia_key: &'static str,
    timing: Timing,
    period_key: &'static str,
    delay_key: &'static str,
    torque_step_nm: f64,
    hardware_count_rad: f64,
}

/// What is believed where it is given, else what is true.
fn told(believed: &BelievedTable, sampled: &SampledDevice, sampling: &LoopTable) -> Result<Told> {
    let truth = &sampled.device;
    let device = Believed {
        inertia_kg_m2: interval(
            "believed.inertia_kg_m2",
            believed.inertia_kg_m2,
            truth.inertia_kg_m2,
        )?,
        viscous_nm_s_rad: interval(
            "believed.viscous_nm_s_rad",
            believed.viscous_nm_s_rad,
            truth.viscous_nm_s_rad,
        )?,
        coulomb_nm: interval("believed.coulomb_nm", believed.coulomb_nm, truth.coulomb_nm)?,
    };
    positive("believed.inertia_kg_m2", device.inertia_kg_m2.low)?;
    let key = |given: bool, believed: &'static str, truth: &'static str| {
        if given { believed } else { truth }
    };
    let or_true = |belief: Option<f64>, truth: f64| belief.unwrap_or(truth);
    let timing = &sampled.timing;
    let period_s = positive(
        "believed.sample_period_s",
        or_true(believed.sample_period_s, timing.period_s),
    )?;
    let jitter_key = key(
        believed.jitter_s.is_some(),
        "believed.jitter_s",
        "loop.jitter_s",
    );
    let missed_ticks = or_true(believed.missed_ticks, sampling.missed_ticks);
    Ok(Told {
        device,
        inertia_key: key(
            believed.inertia_kg_m2.is_some(),
            "believed.inertia_kg_m2",
            "device.inertia_kg_m2",
        ),
        timing: Timing {
            period_s,
            jitter_s: jitter(
                jitter_key,
                or_true(believed.jitter_s, timing.jitter_s),
                period_s,
            )?,
            may_miss: share("believed.missed_ticks", missed_ticks)? > 0.0,
            delay_s: not_negative(
                "believed.delay_s",
                or_true(believed.delay_s, timing.delay_s),
            )?,
            amplifier_tau_s: not_negative(
                "believed.amplifier_tau_s",
                or_true(believed.amplifier_tau_s, timing.amplifier_tau_s),
            )?,
        },
        period_key: key(
            believed.sample_period_s.is_some(),
            "believed.sample_period_s",
            "loop.sample_period_s",
        ),
        delay_key: key(
            believed.delay_s.is_some(),
            "believed.delay_s",
            "loop.delay_s",
        ),
        torque_step_nm: not_negative(
            "believed.torque_step_nm",
            or_true(believed.torque_step_nm, sampling.torque_step_nm),
        )?,
        hardware_count_rad: count_rad("believed", believed.counts_per_rev, believed.count_rad)?
            .unwrap_or(sampled.hardware_count_rad),
    })
}

/// The interval of a key: what is believed, or else the truth.
fn interval(key: &str, belief: Option<Belief>, truth: f64) -> Result<Interval> {
    let [low, high] = match belief {
        None => [truth; 2],
        Some(Belief::Exactly(value)) => [value; 2],
        Some(Belief::Between(ends)) => ends,
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

/// What is rendered, sensed in counts of `count_rad`.
fn shape(render: &RenderTable, count_rad: f64) -> Result<Shape> {
    let (name, reads) = match render.shape {
        ShapeName::Spring => ("spring", &["centre_rad"][..]),
        ShapeName::Wall => ("wall", &["wall_rad"][..]),
        ShapeName::Detent => ("detent", &["period_rad", "centre_rad"][..]),
    };
    let mut zero = ("render.centre_rad", 0.0);
    for (key, value) in [
        ("centre_rad", render.centre_rad),
        ("wall_rad", render.wall_rad),
        ("period_rad", render.period_rad),
    ] {
        let Some(value) = value else { continue };
        if !reads.contains(&key) {
            let reads = reads.join(" and ");
            bail!("render.{key} is given, but shape = \"{name}\" reads {reads}");
        }
        match key {
            "centre_rad" => zero = ("render.centre_rad", value),
            "wall_rad" => zero = ("render.wall_rad", value),
            _ => {}
        }
    }
    let (zero_key, zero_rad) = zero;
    finite(zero_key, zero_rad)?;
    let furthest_rad = count_rad * f64::from(1_u32 << 30);
    if zero_rad.abs() >= furthest_rad {
        bail!(
            "{zero_key} is {}, 2^30 counts or more from zero; accepted: less than {} rad either way",
            plain(zero_rad),
            bound(furthest_rad)
        );
    }
    Ok(match render.shape {
        ShapeName::Spring => Shape::Spring {
            centre_rad: zero_rad,
        },
        ShapeName::Wall => Shape::Wall { edge_rad: zero_rad },
        ShapeName::Detent => Shape::Detent {
            centre_rad: zero_rad,
            period_rad: render
                .period_rad
                .context("render.period_rad is missing; accepted: it, with shape = \"detent\"")?,
        },
    })
}

/// Cogging and stiction; each needs the key that says where it is felt.
fn motor(table: &DeviceTable) -> Result<Motor> {
    for (key, value, with, needed) in [
        (
            "device.cogging_nm",
            table.cogging_nm,
            table.cogging_per_rev,
            "device.cogging_per_rev",
        ),
        (
            "device.stiction_nm",
            table.stiction_nm,
            table.stribeck_rad_s,
            "device.stribeck_rad_s",
        ),
    ] {
        not_negative(key, value)?;
        not_negative(needed, with)?;
        if value > 0.0 && with == 0.0 {
            bail!(
                "{key} is {}, but {needed} is missing; accepted: both",
                plain(value)
            );
        }
    }
    if table.cogging_per_rev > MOST_PERIODS {
        let accepted = format!("up to {MOST_PERIODS} periods in a turn");
        return Err(refuse(
            "device.cogging_per_rev",
            table.cogging_per_rev,
            &accepted,
        ));
    }
    Ok(Motor {
        cogging_nm: table.cogging_nm,
        cogging_per_rev: table.cogging_per_rev,
        stiction_nm: table.stiction_nm,
        stribeck_rad_s: table.stribeck_rad_s,
    })
}

fn hand(table: &HandTable) -> Result<Hand> {
    Ok(Hand {
        inertia_kg_m2: not_negative("hand.inertia_kg_m2", table.inertia_kg_m2)?,
        damping_nm_s_rad: not_negative("hand.damping_nm_s_rad", table.damping_nm_s_rad)?,
        stiffness_nm_rad: not_negative("hand.stiffness_nm_rad", table.stiffness_nm_rad)?,
        rest_rad: signed("hand.rest_rad", table.rest_rad)?,
        push_nm: signed("hand.push_nm", table.push_nm)?,
        shake_nm: signed("hand.shake_nm", table.shake_nm)?,
        shake_hz: not_negative("hand.shake_hz", table.shake_hz)?,
    })
}

/// What no controller can be told, under the file's names. What could be seen in one value alone
/// was refused before.
fn named(error: ConfigError, told: &Told, render: &RenderTable) -> anyhow::Error {
    match error {
        ConfigError::Delay { delay, limit } => {
            let law = match render.law {
                LawName::Auto => "auto",
                _ => "ledger",
            };
            let accepted = format!(
                "up to {} s by law = \"{law}\", the shortest interval between ticks",
                bound(limit)
            );
            refuse(told.delay_key, delay, &accepted)
        }
        ConfigError::Period { value, least, most } => {
            let accepted = format!(
                "{} to {} rad, two counts to 2^30",
                bound(least),
                bound(most)
            );
            refuse("render.period_rad", value, &accepted)
        }
        ConfigError::Decimation(decimation) => {
            anyhow!(
                "loop.decimation is {decimation}; accepted: a whole number from 1 to 2147483647"
            )
        }
        // A ratio that an f32 takes for nothing or for infinite.
        other => anyhow!(
            "{other}; it comes from {} = {}, {} = {} and the count size, {} rad",
            told.inertia_key,
            plain(told.device.inertia_kg_m2.low),
            told.period_key,
            plain(told.timing.period_s),
            plain(told.hardware_count_rad)
        ),
    }
}

/// The same for the plant.
fn knob_named(error: KnobError, device: &Device<f64>, hand: &Hand) -> anyhow::Error {
    let KnobError::Above {
        name,
        value,
        limit,
        reason,
    } = error
    else {
        return error.into();
    };
    if name.starts_with("delay") {
        let accepted = format!("up to {} s, {reason}", bound(limit));
        refuse("loop.delay_s", value, &accepted)
    } else if name.starts_with("hand shake") {
        let accepted = format!("up to {} Hz, {reason}", bound(limit));
        refuse("hand.shake_hz", value, &accepted)
    } else {
        let inertia = device.inertia_kg_m2 + hand.inertia_kg_m2;
        let accepted = format!(
            "up to {} Nm/rad, √(stiffness / inertia of hand and knob) of {reason}",
            bound(limit * limit * inertia)
        );
        refuse("hand.stiffness_nm_rad", hand.stiffness_nm_rad, &accepted)
    }
}

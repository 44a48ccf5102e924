//! How stiff a law gets: the same systematic runs for every law and device, on the exact plant.
//!
//! # The runs of a device
//! - [`Kind::Hit`], 96: 0.1, 0.3, 1, 3, 10, 30 rad/s into a wall with its edge at ⅜ of a count, from 16
//!   places (p = 1/32, 3/32, … 31/32) p·v·T before angle 0;
//! - [`Kind::Spring`], 96: the same speeds into a spring with its centre at 0, from −p·Δ;
//! - [`Kind::Lean`], 48: a hand of 3e-5 kg m², 1e-3 Nm s/rad and one of 1e-5, 1e-4, which moves with the
//!   knob and pushes with 2.5 c, 10 c, 30 c, comes to the same wall at 0.5 rad/s from p·T·0.5 rad/s before
//!   it, at 8 of the places.
//!
//! The controller has seen 9 ticks of free motion. 4000 samples, extended until the run is decided.
//! A run is bad by [`Trial`]'s rules: growth, energy given out, limit cycle, unsettled.
//!
//! # What is measured
//! - *Static stiffness*: torque over the penetration from the wall's edge where the run ends, under
//!   the 30 c push; geometric mean over both hands and the 8 places.
//! - [`Feel`] of a hit, at 1, 3, 10 and 30 rad/s.
//!
//! AO is [`abbott_okamura`]: min(2b/T, 2c/Δ).

use std::sync::atomic::{AtomicBool, Ordering};

use control::ConfigError;
use control::config::Law;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::Tick;
use rayon::prelude::*;

use crate::closed_loop::SceneError;
use crate::hand::Hand;
use crate::hold::{Hold, State};
use crate::outcome::Class;
use crate::rivals::{EnergyBounding, PassivityControl, Rendered, Rival, VirtualDamping};
use crate::trial::{EXTENSION, Fault, Sampled, Trial, Verdict, abbott_okamura};

/// Start speeds of hits and springs, rad/s.
pub const SPEEDS_RAD_S: [f64; 6] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0];

/// Speeds at which [`Feel`] is measured, rad/s.
pub const FELT_RAD_S: [f64; 4] = [1.0, 3.0, 10.0, 30.0];

/// More than any device can render: a law that clamps itself may be asked for it, Nm/rad.
pub const ANY_STIFFNESS: f64 = 1e6;

/// Mass (kg m²) and damping (Nm s/rad) of the leaning hands.
const HANDS: [(f64, f64); 2] = [(3e-5, 1e-3), (1e-5, 1e-4)];

/// What they push with, over c; the static stiffness is taken under the last.
const PUSHES: [f64; 3] = [2.5, 10.0, 30.0];

/// The wall's edge, counts.
const EDGE: f64 = 0.375;

const SAMPLES: u64 = 4_000;

/// Ticks of free motion that the controller has seen.
const HISTORY: u32 = 9;

/// A hit that is not over then, in samples, is left there.
const HIT_SAMPLES: u64 = 40_000;

/// A start in the middle of part `number` of `parts`.
fn place(number: u32, parts: u32) -> f64 {
    (f64::from(number) + 0.5) / f64::from(parts)
}

/// A law that is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Contender {
    /// [`Law::Static`]: at most AO.
    Static,
    /// [`EnergyBounding`].
    EnergyBounding,
    /// [`Law::Raw`], K found offline.
    Raw,
    /// [`Law::Episode`].
    Episode,
    /// [`PassivityControl`], K found offline.
    PassivityControl,
    /// [`VirtualDamping`], K found offline.
    VirtualDamping,
    /// [`Law::Ledger`].
    Ledger,
    /// [`Law::Auto`].
    Auto,
}

impl Contender {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Static,
        Self::EnergyBounding,
        Self::Raw,
        Self::Episode,
        Self::PassivityControl,
        Self::VirtualDamping,
        Self::Ledger,
        Self::Auto,
    ];

    /// In one word.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Static => "static",
            Self::EnergyBounding => "energy-bounding",
            Self::Raw => "raw",
            Self::Episode => "episode",
            Self::PassivityControl => "passivity-control",
            Self::VirtualDamping => "virtual-damping",
            Self::Ledger => "ledger",
            Self::Auto => "auto",
        }
    }

    /// Its stiffness has to be found offline, since it renders any that is demanded.
    #[must_use]
    pub fn is_tuned(self) -> bool {
        matches!(
            self,
            Self::Raw | Self::PassivityControl | Self::VirtualDamping
        )
    }

    /// The law of the controller; of a rival, which configures no controller, raw.
    pub(crate) fn law(self) -> Law {
        match self {
            Self::Static => Law::Static,
            Self::Episode => Law::Episode,
            Self::Ledger => Law::Ledger,
            Self::Auto => Law::Auto,
            _ => Law::Raw,
        }
    }

    /// Its control of a trial whose configuration is for [`Contender::law`].
    pub(crate) fn control(self, trial: &Trial, sampled: &Sampled) -> Result<Control, SceneError> {
        let demand = trial.scene.config.stiffness_nm_rad;
        Ok(match self {
            Self::EnergyBounding => rendered(EnergyBounding::new(sampled, demand)?, trial),
            Self::PassivityControl => rendered(PassivityControl::new(sampled, demand), trial),
            Self::VirtualDamping => rendered(VirtualDamping::new(sampled, demand), trial),
            _ => {
                let mut controller = trial.controller(Plan::new(&trial.scene.config)?)?;
                Box::new(move |counter, duration_s| controller.tick(counter, duration_s))
            }
        })
    }

    /// Runs a trial of [`runs`] for this law.
    fn run(self, trial: &Trial, sampled: &Sampled) -> Result<Verdict, SceneError> {
        trial.run_under(self.control(trial, sampled)?, 0.0)
    }
}

/// What a tick does: from a counter and the ticks' distance (s) to a torque.
pub(crate) type Control = Box<dyn FnMut(u32, f32) -> Tick>;

fn rendered(rival: impl Rival + 'static, trial: &Trial) -> Control {
    let scene = &trial.scene;
    let count_rad = scene.config.count_rad();
    let before = scene.start.position - scene.start.velocity * scene.clock.period_s;
    let count = (before / count_rad).floor() as i64 as i32;
    let mut rendered = Rendered::new(rival, scene.config.shape, count_rad, count);
    Box::new(move |counter, _| rendered.tick(counter))
}

/// The three kinds of runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// A bare knob hits a wall.
    Hit,
    /// A bare knob flies into a spring.
    Spring,
    /// A hand leans on a wall.
    Lean,
}

impl Kind {
    /// As a user reads it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Hit => "hit",
            Self::Spring => "spring",
            Self::Lean => "lean",
        }
    }
}

/// One of the runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// What it is.
    pub kind: Kind,
    /// Where it starts, and how.
    pub trial: Trial,
    /// The static stiffness is taken at its end.
    pub leans_hardest: bool,
}

/// The wall.
fn wall(sampled: &Sampled) -> Shape {
    Shape::Wall {
        edge_rad: EDGE * sampled.count_rad,
    }
}

fn trial(sampled: &Sampled, law: Law, demand: f64, shape: Shape, start: State) -> Trial {
    let config = sampled.config(law, shape, demand);
    Trial {
        scene: sampled.scene(config, start, SAMPLES),
        extension: EXTENSION,
        hasty: false,
        history: HISTORY,
    }
}

fn hit(sampled: &Sampled, law: Law, demand: f64, velocity: f64, place: f64) -> Trial {
    let position = -place * velocity * sampled.period_s;
    let start = State { position, velocity };
    trial(sampled, law, demand, wall(sampled), start)
}

/// All runs of a device, in the order of the module's list.
#[must_use]
pub fn runs(sampled: &Sampled, law: Law, demand: f64) -> Vec<Run> {
    let mut runs = Vec::new();
    let free = |kind, trial| Run {
        kind,
        trial,
        leans_hardest: false,
    };
    for velocity in SPEEDS_RAD_S {
        for number in 0..16 {
            let place = place(number, 16);
            runs.push(free(Kind::Hit, hit(sampled, law, demand, velocity, place)));
            let start = State {
                position: -place * sampled.count_rad,
                velocity,
            };
            let spring = Shape::Spring { centre_rad: 0.0 };
            runs.push(free(
                Kind::Spring,
                trial(sampled, law, demand, spring, start),
            ));
        }
    }
    for (inertia_kg_m2, damping_nm_s_rad) in HANDS {
        for (number_of_push, push) in PUSHES.into_iter().enumerate() {
            for number in 0..8 {
                let mut trial = hit(sampled, law, demand, 0.5, place(number, 8));
                trial.scene.hand = Hand {
                    inertia_kg_m2,
                    damping_nm_s_rad,
                    push_nm: push * sampled.device.coulomb_nm,
                    ..Hand::default()
                };
                runs.push(Run {
                    kind: Kind::Lean,
                    trial,
                    leans_hardest: number_of_push == PUSHES.len() - 1,
                });
            }
        }
    }
    runs
}

/// What hits at one speed feel like. From the 16 places of [`Kind::Hit`]; those that friction
/// stops before the wall is sensed or its edge reached are left out.
///
/// The *ideal* is the rotor with m and c against an unsampled spring of K = min(m/T², 2c/Δ) that begins at
/// the wall's edge, e after the count of angle 0 in which the torque begins. Of a speed v there
/// its depth x is that of ½Kx² + c(x + e) = ½mv². Then it turns, and leaves if Kx ≥ 2c; else it stops under
/// 2c − Kx, or at once if Kx ≤ c. Its torque has varied by 2Kx, 3Kx − 2c or Kx.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feel {
    /// Speed at the start, rad/s.
    pub speed_rad_s: f64,
    /// How many of the 16 hits are in the means.
    pub hits: u32,
    /// Hit stiffness: largest |torque| over largest penetration from the edge; geometric mean, Nm/rad.
    pub stiffness_nm_rad: f64,
    /// Largest penetration over the ideal's; geometric mean.
    pub penetration: f64,
    /// Speed out over speed in, both where the count begins in which the torque begins; 0 where it
    /// stays in; arithmetic mean.
    pub restitution: f64,
    /// Σ|F − F₋₁| from the first torque to exit or rest, over the ideal's; arithmetic mean.
    pub torque_variation: f64,
    /// How often a rise of the torque is followed by a fall or a fall by a rise; mean. A clean
    /// hit that leaves has 1.
    pub turns: f64,
}

/// What the ideal of [`Feel`] does.
struct Ideal {
    depth_rad: f64,
    variation_nm: f64,
}

impl Ideal {
    /// From a speed at `lead_rad` before the edge; `None` if friction stops it before that.
    fn new(sampled: &Sampled, speed_rad_s: f64, lead_rad: f64) -> Option<Self> {
        let (m, c) = (sampled.device.inertia_kg_m2, sampled.device.coulomb_nm);
        let stiffness = sampled.holding_nm_rad().min(2.0 * c / sampled.count_rad);
        let energy2 = m * speed_rad_s * speed_rad_s - 2.0 * c * lead_rad;
        // x = (√(c² + KE) − c)/K, without cancellation.
        let depth_rad = energy2 / (c + (c * c + stiffness * energy2).sqrt());
        let torque = stiffness * depth_rad;
        (energy2 > 0.0).then_some(Self {
            depth_rad,
            variation_nm: if torque >= 2.0 * c {
                2.0 * torque
            } else if torque > c {
                3.0 * torque - 2.0 * c
            } else {
                torque
            },
        })
    }
}

/// One hit.
struct Hit {
    stiffness_nm_rad: f64,
    penetration: f64,
    restitution: f64,
    torque_variation: f64,
    turns: u32,
}

/// A run that was bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bad {
    /// Of which kind.
    pub kind: Kind,
    /// Its number in the suite, 0 to 239.
    pub number: usize,
    /// What was wrong.
    pub fault: Fault,
}

/// A law on a device.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The law.
    pub contender: Contender,
    /// The stiffness demanded: what [`tune`] found, or [`ANY_STIFFNESS`], Nm/rad.
    pub demand_nm_rad: f64,
    /// Runs in the suite.
    pub runs: usize,
    /// Those that were bad.
    pub bad: Vec<Bad>,
    /// Torque over penetration at rest, Nm/rad.
    pub static_nm_rad: f64,
    /// Hits at [`FELT_RAD_S`]; `None` where friction stops all of them before the wall is
    /// sensed, or where they were not asked for.
    pub feel: [Option<Feel>; 4],
}

/// Why nothing was measured.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SuiteError {
    /// The device is not one.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The flag to stop was raised.
    #[error("stopped")]
    Stopped,
}

impl From<ConfigError> for SuiteError {
    fn from(error: ConfigError) -> Self {
        Self::Scene(error.into())
    }
}

fn check(stop: &AtomicBool) -> Result<(), SuiteError> {
    if stop.load(Ordering::Relaxed) {
        Err(SuiteError::Stopped)
    } else {
        Ok(())
    }
}

/// Runs the suite of a law on a device. With `felt` the hits are measured too. `stop` is
/// looked at before every run.
///
/// # Errors
/// Refuses what is no device, and ends when `stop` is raised.
pub fn measure(
    contender: Contender,
    sampled: &Sampled,
    demand_nm_rad: f64,
    felt: bool,
    stop: &AtomicBool,
) -> Result<Measured, SuiteError> {
    let runs = runs(sampled, contender.law(), demand_nm_rad);
    let verdicts = runs
        .par_iter()
        .map(|run| {
            check(stop)?;
            Ok(contender.run(&run.trial, sampled)?)
        })
        .collect::<Result<Vec<Verdict>, SuiteError>>()?;
    let edge_rad = wall(sampled).zero_rad();
    let mut bad = Vec::new();
    let mut stiffness = Mean::default();
    for (number, (run, verdict)) in runs.iter().zip(&verdicts).enumerate() {
        if let Some(fault) = verdict.fault {
            bad.push(Bad {
                kind: run.kind,
                number,
                fault,
            });
        }
        if run.leans_hardest {
            let penetration = verdict.report.end.position - edge_rad;
            // A knob that was thrown out of the wall has no stiffness.
            stiffness.enter((verdict.end_torque_nm.abs() / penetration).max(1e-9));
        }
    }
    let feel = if felt {
        feel(contender, sampled, demand_nm_rad, stop)?
    } else {
        [None; 4]
    };
    Ok(Measured {
        contender,
        demand_nm_rad,
        runs: runs.len(),
        bad,
        static_nm_rad: stiffness.value().unwrap_or(0.0),
        feel,
    })
}

/// Whether no run of the suite is bad.
///
/// # Errors
/// As [`measure`].
pub fn is_clean(
    contender: Contender,
    sampled: &Sampled,
    demand_nm_rad: f64,
    stop: &AtomicBool,
) -> Result<bool, SuiteError> {
    let found = runs(sampled, contender.law(), demand_nm_rad)
        .par_iter()
        .map(|run| {
            check(stop)?;
            let fault = contender.run(&run.trial, sampled)?.fault;
            Ok(fault.map(|_| ()))
        })
        .find_map_any(Result::transpose);
    match found {
        None => Ok(true),
        Some(Ok(())) => Ok(false),
        Some(Err(error)) => Err(error),
    }
}

/// The step of the search for a stiffness.
const SEARCH_STEP: f64 = 1.25;

/// Halvings of the last step: to 0.4 %.
const SEARCH_HALVINGS: u32 = 6;

/// How far from AO the search goes.
const SEARCH_RANGE: f64 = 1e4;

/// The largest stiffness without a bad run: from AO upwards in steps of 25 % to the first with
/// one (or downwards to the first without), and bisection, to 0.4 %. `None` if the stiffest of AO to
/// AO/10,000 all have one. Nm/rad.
///
/// # Errors
/// As [`measure`].
pub fn tune(
    contender: Contender,
    sampled: &Sampled,
    stop: &AtomicBool,
) -> Result<Option<f64>, SuiteError> {
    let ao = abbott_okamura(sampled)?;
    let clean = |stiffness| is_clean(contender, sampled, stiffness, stop);
    let (mut good, mut bad);
    if clean(ao)? {
        good = ao;
        loop {
            bad = good * SEARCH_STEP;
            if bad > ao * SEARCH_RANGE {
                return Ok(Some(good));
            }
            if !clean(bad)? {
                break;
            }
            good = bad;
        }
    } else {
        bad = ao;
        loop {
            good = bad / SEARCH_STEP;
            if good < ao / SEARCH_RANGE {
                return Ok(None);
            }
            if clean(good)? {
                break;
            }
            bad = good;
        }
    }
    for _ in 0..SEARCH_HALVINGS {
        let middle = (good * bad).sqrt();
        if clean(middle)? {
            good = middle;
        } else {
            bad = middle;
        }
    }
    Ok(Some(good))
}

/// [`measure`] at what [`tune`] finds where the law [has to be tuned](Contender::is_tuned), else
/// at [`ANY_STIFFNESS`]. `None` if no stiffness is without bad runs.
///
/// # Errors
/// As [`measure`].
pub fn best(
    contender: Contender,
    sampled: &Sampled,
    felt: bool,
    stop: &AtomicBool,
) -> Result<Option<Measured>, SuiteError> {
    let demand = if contender.is_tuned() {
        tune(contender, sampled, stop)?
    } else {
        Some(ANY_STIFFNESS)
    };
    demand
        .map(|demand| measure(contender, sampled, demand, felt, stop))
        .transpose()
}

/// Whether a law is clean on a device whatever is demanded: 10 AO, 1000 AO, [`ANY_STIFFNESS`].
///
/// # Errors
/// As [`measure`].
pub fn clamps_itself(
    contender: Contender,
    sampled: &Sampled,
    stop: &AtomicBool,
) -> Result<bool, SuiteError> {
    let ao = abbott_okamura(sampled)?;
    for demand in [10.0 * ao, 1e3 * ao, ANY_STIFFNESS] {
        if !is_clean(contender, sampled, demand, stop)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Hits at [`FELT_RAD_S`] under a demanded stiffness: see [`Measured::feel`].
///
/// # Errors
/// As [`measure`].
pub fn feel(
    contender: Contender,
    sampled: &Sampled,
    demand_nm_rad: f64,
    stop: &AtomicBool,
) -> Result<[Option<Feel>; 4], SuiteError> {
    let mut all = [None; 4];
    for (feel, speed_rad_s) in all.iter_mut().zip(FELT_RAD_S) {
        *feel = feel_of(contender, sampled, demand_nm_rad, speed_rad_s, stop)?;
    }
    Ok(all)
}

fn feel_of(
    contender: Contender,
    sampled: &Sampled,
    demand_nm_rad: f64,
    speed_rad_s: f64,
    stop: &AtomicBool,
) -> Result<Option<Feel>, SuiteError> {
    let hits = (0..16_u32)
        .into_par_iter()
        .map(|number| {
            check(stop)?;
            let place = place(number, 16);
            let trial = hit(sampled, contender.law(), demand_nm_rad, speed_rad_s, place);
            Ok(one_hit(contender, sampled, &trial)?)
        })
        .collect::<Result<Vec<_>, SuiteError>>()?;
    let (mut stiffness, mut depth) = (Mean::default(), Mean::default());
    let (mut restitution, mut variation, mut turns) = (0.0, 0.0, 0.0);
    let mut sensed = 0;
    for hit in hits.into_iter().flatten() {
        sensed += 1;
        stiffness.enter(hit.stiffness_nm_rad);
        depth.enter(hit.penetration);
        restitution += hit.restitution;
        variation += hit.torque_variation;
        turns += f64::from(hit.turns);
    }
    let all = f64::from(sensed);
    Ok(stiffness
        .value()
        .zip(depth.value())
        .map(|(stiffness, depth)| Feel {
            speed_rad_s,
            hits: sensed,
            stiffness_nm_rad: stiffness,
            penetration: depth,
            restitution: restitution / all,
            torque_variation: variation / all,
            turns: turns / all,
        }))
}

/// A hit from start to exit or rest; `None` if the knob is never sensed in the wall.
fn one_hit(
    contender: Contender,
    sampled: &Sampled,
    trial: &Trial,
) -> Result<Option<Hit>, SceneError> {
    let mut scene = trial.scene;
    scene.samples = HIT_SAMPLES;
    let control = contender.control(trial, sampled)?;
    let hold = Hold::new(&sampled.device, sampled.period_s)?;
    let edge_rad = scene.config.shape.zero_rad();
    // Where the first count begins whose middle lies beyond the edge.
    let first_rad = (edge_rad / sampled.count_rad + 0.5).floor() * sampled.count_rad;

    let (mut sensed, mut furthest_rad) = (false, f64::NEG_INFINITY);
    let (mut speed_in, mut speed_out) = (None, None);
    let (mut peak_nm, mut variation_nm, mut before_nm) = (0.0_f64, 0.0, 0.0);
    let (mut way, mut turns) = (0.0, 0);
    let report = scene.run_under(control, |sample| {
        let torque = f64::from(sample.tick.torque_nm);
        let change: f64 = torque - before_nm;
        variation_nm += change.abs();
        if change != 0.0 {
            turns += u32::from(way * change < 0.0);
            way = change;
        }
        before_nm = torque;
        peak_nm = peak_nm.max(torque.abs());
        sensed |= sample.state.position >= first_rad;
        // Outside again: nothing acts on it any more.
        if speed_out.is_some() {
            return false;
        }
        let step = hold.step(sample.state, torque);
        let mut from = sample.state;
        let turn = step.turn.map(|turn| State {
            position: turn.position,
            velocity: 0.0,
        });
        for to in turn.into_iter().chain([step.end]) {
            furthest_rad = furthest_rad.max(to.position);
            let crossed = |a: State, b: State| a.position < first_rad && b.position >= first_rad;
            if crossed(from, to) {
                speed_in.get_or_insert(speed_at(first_rad, from, to));
            } else if crossed(to, from) && speed_in.is_some() {
                speed_out = Some(speed_at(first_rad, from, to));
            }
            from = to;
        }
        true
    })?;
    let penetration_rad = furthest_rad - edge_rad;
    let Some(speed_in) = speed_in.filter(|_| sensed && penetration_rad > 0.0) else {
        return Ok(None);
    };
    if report.class == Class::Unstable {
        speed_out = speed_out.or(Some(f64::INFINITY));
    }
    let ideal = Ideal::new(sampled, speed_in, edge_rad - first_rad);
    Ok(ideal.map(|ideal| Hit {
        stiffness_nm_rad: peak_nm / penetration_rad,
        penetration: penetration_rad / ideal.depth_rad,
        restitution: speed_out.unwrap_or(0.0) / speed_in,
        torque_variation: variation_nm / ideal.variation_nm,
        turns,
    }))
}

/// The speed at a place between two states under a constant torque: v² is linear in x but for
/// viscous friction.
fn speed_at(position: f64, from: State, to: State) -> f64 {
    let (v0, v1) = (from.velocity.powi(2), to.velocity.powi(2));
    let share = (position - from.position) / (to.position - from.position);
    (v0 + (v1 - v0) * share).max(0.0).sqrt()
}

/// A geometric mean.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mean {
    logarithms: f64,
    count: u32,
}

impl Mean {
    /// Enters a value, 0 or more.
    pub fn enter(&mut self, value: f64) {
        self.logarithms += value.ln();
        self.count += 1;
    }

    /// The mean of what was entered, if anything was.
    #[must_use]
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.logarithms / f64::from(self.count)).exp())
    }
}

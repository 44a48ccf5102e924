//! No more than a scene needs: what cannot change the answer by more than a tolerance is left out of
//! the plant, with a bound on the error that this makes.
//!
//! The answer is the knob's angle at every sample, and so at the end. [`simplest`] runs a scene without
//! whatever it can do without and follows, tick by tick, how far the true knob can be from the simple
//! one: e_x in angle, e_v in velocity. That is a proof, not a guess:
//!
//! - **The same commands.** As long as no count edge lies within e_x of the simple knob's angle at a sample,
//!   the true encoder shows the same count, and the controller, which sees counts alone, commands the
//!   same torque to the last bit. A sample of which this is not sure ends the attempt.
//! - **Friction brings them together.** Under the same torque, b·v + c·sgn v never drives two velocities
//!   apart. What is left out is a torque of at most P: over a tick, e_v grows by P·dt/m and e_x by
//!   e_v·dt. A spring of stiffness k that is kept (the hand's, cogging's) adds k·e_x to P.
//! - **A knob at rest stays.** While the simple one sticks and |F| + P < c, the true one is braked by the
//!   rest of c, and e_v falls to 0.
//! - **Delay and lag** become an impulse at the tick, after which a knob that slides on moves exactly as if
//!   the torque had come late (see the source of `drive`). Only where it may come to a stop or turn before
//!   the old torque is over does e_v grow, by twice the impulse that is then left, over m.
//!
//! What a phenomenon may do at most, P: torque steps, what they take from or add to this torque; cogging, A; a shaking hand, its
//! amplitude; stiction, s·e^(−(v/v_s)²) at the lowest speed in the tick; a hand, M·|a| + B·|v| + K|x − rest| +
//! |push|. If an attempt fails, what has contributed most is kept, and the scene runs again. Where
//! stiction is kept all is kept: it lets velocities drift apart; and delay and lag are kept beside a spring.
//!
//! Coulomb and viscous friction, hold and quantisation are never dropped: they are the closed form itself
//! and cost nothing; the torque limit is a comparison in the controller. A scene that diverges keeps all.
//!
//! # Assumes
//! The plant as [`crate::knob`] integrates it in full, to the accuracy stated there, which the bound
//! includes: a millionth of what varies between ticks, per tick.

use std::fmt;

use control::tick::Tick;

use crate::closed_loop::{Report, Sample, Scene, SceneError};
use crate::drive::{Drive, Impulse};
use crate::hand::Hand;
use crate::hold::State;
use crate::knob::{Knob, joined};
use crate::motor::Motor;
use crate::outcome::Class;

/// What a scene can have beyond mass, friction and a held torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Phenomenon {
    /// From the sample to the torque.
    Delay,
    /// The amplifier's time constant.
    AmplifierLag,
    /// The converter's steps.
    TorqueStep,
    /// The motor's cogging.
    Cogging,
    /// The bearing's stiction.
    Stiction,
    /// The sinusoidal torque of the hand.
    HandShake,
    /// The rest of the hand: its mass, damping, spring and push.
    Hand,
}

impl Phenomenon {
    /// All of them, those first that cost most.
    pub const ALL: [Self; 7] = [
        Self::Stiction,
        Self::Cogging,
        Self::HandShake,
        Self::AmplifierLag,
        Self::Delay,
        Self::Hand,
        Self::TorqueStep,
    ];

    /// As scripts see it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Delay => "delay",
            Self::AmplifierLag => "amplifier-lag",
            Self::TorqueStep => "torque-step",
            Self::Cogging => "cogging",
            Self::Stiction => "stiction",
            Self::HandShake => "hand-shake",
            Self::Hand => "hand",
        }
    }

    /// Whether a scene has it.
    fn is_in(self, scene: &Scene) -> bool {
        let Scene {
            drive, motor, hand, ..
        } = scene;
        match self {
            Self::Delay => drive.delay_s > 0.0,
            Self::AmplifierLag => drive.amplifier_tau_s > 0.0,
            Self::TorqueStep => drive.torque_step_nm > 0.0,
            Self::Cogging => motor.cogging_nm > 0.0,
            Self::Stiction => motor.stiction_nm > 0.0,
            Self::HandShake => hand.shakes(),
            Self::Hand => !hand.without_shake().is_absent(),
        }
    }
}

impl fmt::Display for Phenomenon {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Some of the phenomena.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Phenomena([bool; Phenomenon::ALL.len()]);

impl Phenomena {
    /// Those that a scene has.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        Self(Phenomenon::ALL.map(|phenomenon| phenomenon.is_in(scene)))
    }

    /// Whether it is one of them.
    #[must_use]
    pub fn has(self, phenomenon: Phenomenon) -> bool {
        self.iter().any(|own| own == phenomenon)
    }

    /// Each of them, those first that cost most.
    pub fn iter(self) -> impl Iterator<Item = Phenomenon> {
        let all = Phenomenon::ALL.into_iter().zip(self.0);
        all.filter_map(|(phenomenon, is_there)| is_there.then_some(phenomenon))
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self == Self::default()
    }

    /// These but not those.
    #[must_use]
    pub fn without(self, others: Self) -> Self {
        let mut these = self;
        for (own, other) in these.0.iter_mut().zip(others.0) {
            *own &= !other;
        }
        these
    }

    /// These and one more.
    #[must_use]
    pub fn with(self, phenomenon: Phenomenon) -> Self {
        let one = Self(Phenomenon::ALL.map(|own| own == phenomenon));
        Self(std::array::from_fn(|i| self.0[i] || one.0[i]))
    }
}

/// A scene without some of its phenomena.
#[derive(Debug, Clone)]
pub struct Simplified {
    scene: Scene,
    dropped: Phenomena,
    knob: Knob,
}

impl Simplified {
    /// Leaves `dropped` out of a scene.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn new(full: &Scene, dropped: Phenomena) -> Result<Self, SceneError> {
        let mut scene = *full;
        let Scene {
            drive, motor, hand, ..
        } = &mut scene;
        for phenomenon in dropped.iter() {
            match phenomenon {
                Phenomenon::Delay => drive.delay_s = 0.0,
                Phenomenon::AmplifierLag => drive.amplifier_tau_s = 0.0,
                Phenomenon::TorqueStep => drive.torque_step_nm = 0.0,
                Phenomenon::Cogging => motor.cogging_nm = 0.0,
                Phenomenon::Stiction => motor.stiction_nm = 0.0,
                Phenomenon::HandShake => hand.shake_nm = 0.0,
                Phenomenon::Hand => {
                    *hand = Hand {
                        shake_nm: hand.shake_nm,
                        shake_hz: hand.shake_hz,
                        ..Hand::default()
                    }
                }
            }
        }
        let mut knob = scene.knob()?;
        if let Some(late) = Late::of(full, dropped) {
            knob = knob.with_impulses(&late.drive);
        }
        Ok(Self {
            scene,
            dropped,
            knob,
        })
    }

    /// What is left out.
    #[must_use]
    pub fn dropped(&self) -> Phenomena {
        self.dropped
    }

    /// Runs it under any control: see [`Scene::run_under`].
    pub fn run_under(
        &self,
        control: impl FnMut(u32, f32) -> Tick,
        observe: impl FnMut(&Sample) -> bool,
    ) -> Report {
        let mut knob = self.knob.clone();
        let hold = |torque_nm: f64, duration_s: f64| knob.hold(torque_nm, duration_s);
        self.scene.run_plant(hold, control, observe)
    }
}

/// The delay and the lag that are left out, where there are any.
struct Late {
    drive: Drive,
    /// How long the old torque lasts on average, t_d + τ, s.
    lasts_s: f64,
}

impl Late {
    fn of(full: &Scene, dropped: Phenomena) -> Option<Self> {
        if !dropped.has(Phenomenon::Delay) && !dropped.has(Phenomenon::AmplifierLag) {
            return None;
        }
        let drive = Drive {
            torque_step_nm: 0.0,
            ..full.drive
        };
        let lasts_s = drive.delay_s + drive.amplifier_tau_s;
        Some(Self { drive, lasts_s })
    }

    /// What is left after `time_s` of ∫ of an old torque of 1 Nm, s.
    fn left_s(&self, time_s: f64) -> f64 {
        let Drive {
            delay_s,
            amplifier_tau_s: tau,
            ..
        } = self.drive;
        let late = time_s - delay_s;
        if late < 0.0 {
            tau - late
        } else if late < OVER_TAUS * tau {
            tau * (-late / tau).exp()
        } else {
            0.0
        }
    }
}

/// After so many time constants a lag is over: e⁻⁴⁰ is 4e-18.
const OVER_TAUS: f64 = 40.0;

/// The full plant's integration errs by less than this part of what varies between ticks, F·dt/m in
/// velocity and F·dt²/m in angle: see [`crate::knob`].
const INTEGRATION: f64 = 1e-6;

/// The same of a lag, but for what viscous friction and springs make of it: the impulse of every piece is exact.
const LAG_INTEGRATION: f64 = 1e-9;

/// Rounding of a tick, of the magnitudes in play.
const ROUNDING: f64 = 2e-15;

/// A knob that rests so many samples has come to rest, and its run ends.
const REST_SAMPLES: u32 = 100;

/// How a scene was run.
#[derive(Debug, Clone)]
pub struct Answer {
    /// What it did.
    pub report: Report,
    /// What was left out of it.
    pub simplified: Simplified,
    /// What was kept.
    pub kept: Phenomena,
    /// The angle at every sample, and at the end, is at most this far from that of the full scene, rad.
    pub bound_rad: f64,
    /// Attempts, the last one included.
    pub attempts: u32,
}

/// Runs a scene without whatever cannot change its angle, at any sample, by more than `tolerance_rad`.
///
/// `controller` gives a controller at the start, once for every attempt; `go_on` is asked at every sample,
/// and ends the run where it says false.
///
/// # Errors
/// See [`SceneError`].
pub fn simplest<C: FnMut(u32, f32) -> Tick>(
    scene: &Scene,
    tolerance_rad: f64,
    mut controller: impl FnMut() -> C,
    mut go_on: impl FnMut(u64) -> bool,
) -> Result<Answer, SceneError> {
    scene.check()?;
    let all = Phenomena::of(scene);
    let mut dropped = droppable(scene, tolerance_rad);
    let mut attempts = 0;
    loop {
        attempts += 1;
        let simplified = Simplified::new(scene, dropped)?;
        let mut tube = Tube::new(scene, &simplified);
        let (mut stopped, mut sure) = (false, true);
        let report = simplified.run_under(controller(), |sample| {
            stopped = !go_on(sample.number);
            sure = dropped.is_empty() || tube.enter(sample, tolerance_rad);
            sure && !stopped
        });
        let ended = dropped.is_empty() || tube.close(&report, tolerance_rad);
        if stopped || (sure && ended) {
            return Ok(Answer {
                report,
                kept: all.without(dropped),
                bound_rad: tube.angle_rad,
                simplified,
                attempts,
            });
        }
        dropped = consistent(scene, dropped.without(tube.culprit()));
    }
}

/// What may be tried: what a single tick does not rule out.
fn droppable(scene: &Scene, tolerance_rad: f64) -> Phenomena {
    let all = Phenomena::of(scene);
    let shortest_s = scene.clock.period_s - scene.clock.jitter_s;
    let m = scene.device.inertia_kg_m2;
    let shift_rad = |torque_nm: f64| torque_nm * shortest_s * shortest_s / m;
    let mut kept = Phenomena::default();
    let Scene {
        drive, motor, hand, ..
    } = scene;
    for (phenomenon, torque_nm) in [
        (Phenomenon::Cogging, motor.cogging_nm),
        (Phenomenon::HandShake, hand.shake_nm.abs()),
        (Phenomenon::Hand, hand.push_nm.abs()),
    ] {
        if shift_rad(torque_nm) > tolerance_rad {
            kept = kept.with(phenomenon);
        }
    }
    // The old torque is over before the next tick, and the impulse is that of a sliding knob.
    let over_s = drive.delay_s + OVER_TAUS * drive.amplifier_tau_s;
    let rate = (scene.device.viscous_nm_s_rad + hand.damping_nm_s_rad) / m;
    if over_s > shortest_s || rate * over_s > 0.5 {
        kept = kept.with(Phenomenon::Delay).with(Phenomenon::AmplifierLag);
    }
    consistent(scene, all.without(kept))
}

/// What of `dropped` can be dropped together: nothing beside stiction; delay and lag only both, and not
/// beside a spring.
fn consistent(scene: &Scene, dropped: Phenomena) -> Phenomena {
    let kept = Phenomena::of(scene).without(dropped);
    if kept.has(Phenomenon::Stiction) {
        return Phenomena::default();
    }
    let sprung = kept.has(Phenomenon::Cogging)
        || (kept.has(Phenomenon::Hand) && scene.hand.stiffness_nm_rad > 0.0);
    let mut dropped = dropped;
    if sprung || kept.has(Phenomenon::Delay) || kept.has(Phenomenon::AmplifierLag) {
        dropped = dropped.without(
            Phenomena::default()
                .with(Phenomenon::Delay)
                .with(Phenomenon::AmplifierLag),
        );
    }
    dropped
}

/// How far the true knob can be from the simple one.
struct Tube {
    /// Knob and what is kept of the hand.
    inertia: f64,
    viscous: f64,
    coulomb: f64,
    /// Of the springs that are kept, Nm/rad.
    stiffness: f64,
    /// The most that a kept cogging and a kept shake add to the torque, Nm.
    kept_nm: f64,
    /// The hand that is kept.
    hand: Hand,
    /// How long a torque lasts in the simple plant after the next one was commanded, s.
    follows_s: f64,
    drive: Drive,
    /// What is left out.
    late: Option<(Late, Impulse)>,
    steps: Drive,
    step_nm: f64,
    cogging_nm: f64,
    shake_nm: f64,
    stiction: Option<Motor>,
    lost_hand: Option<Hand>,
    /// What varies between ticks in the full plant, Nm, and the lag's part of it for 1 Nm of change.
    varying_nm: f64,
    lagging: f64,
    count_rad: f64,
    longest_s: f64,
    /// e_x, rad.
    angle_rad: f64,
    /// e_v, rad/s.
    velocity_rad_s: f64,
    /// What each phenomenon has added to e_v, rad/s.
    added: [f64; Phenomenon::ALL.len()],
    dropped: Phenomena,
    last: Option<Last>,
    /// The torque before the last one, Nm.
    before_nm: f64,
    /// How long the torque has been the same, s.
    same_s: f64,
    /// Samples in a row at which the true knob may be at rest.
    idle: u32,
    /// Nothing can be left out.
    hopeless: bool,
}

/// A sample and what was commanded in it.
#[derive(Clone, Copy)]
struct Last {
    state: State,
    time_s: f64,
    torque_nm: f64,
}

impl Tube {
    fn new(full: &Scene, simplified: &Simplified) -> Self {
        let Simplified { scene, dropped, .. } = simplified;
        let dropped = *dropped;
        let if_dropped = |phenomenon, value| if dropped.has(phenomenon) { value } else { 0.0 };
        let joined = joined(&scene.device, &scene.hand);
        let rate = (full.device.viscous_nm_s_rad + full.hand.damping_nm_s_rad)
            / (full.device.inertia_kg_m2 + full.hand.inertia_kg_m2);
        let (motor, hand) = (&full.motor, &full.hand);
        let shake_nm = if hand.shakes() {
            hand.shake_nm.abs()
        } else {
            0.0
        };
        let kept_shake_nm = if scene.hand.shakes() {
            scene.hand.shake_nm.abs()
        } else {
            0.0
        };
        let coupled = (rate * scene.clock.longest_s()).powi(2).min(1.0);
        Self {
            inertia: joined.inertia_kg_m2,
            viscous: joined.viscous_nm_s_rad,
            coulomb: joined.coulomb_nm,
            stiffness: scene.hand.stiffness_nm_rad
                + scene.motor.cogging_nm * scene.motor.cogging_per_rev,
            kept_nm: scene.motor.cogging_nm + kept_shake_nm,
            hand: scene.hand,
            follows_s: scene.drive.delay_s + OVER_TAUS * scene.drive.amplifier_tau_s,
            drive: scene.drive,
            late: Late::of(full, dropped).map(|late| {
                let impulse = Impulse::new(&late.drive, &joined);
                (late, impulse)
            }),
            steps: Drive {
                torque_step_nm: if_dropped(Phenomenon::TorqueStep, full.drive.torque_step_nm),
                ..Drive::default()
            },
            step_nm: if_dropped(Phenomenon::TorqueStep, 0.5 * full.drive.torque_step_nm),
            cogging_nm: if_dropped(Phenomenon::Cogging, motor.cogging_nm),
            shake_nm: if_dropped(Phenomenon::HandShake, shake_nm),
            stiction: dropped.has(Phenomenon::Stiction).then_some(*motor),
            lost_hand: dropped
                .has(Phenomenon::Hand)
                .then_some(hand.without_shake()),
            varying_nm: 2.0 * INTEGRATION * (motor.cogging_nm + motor.stiction_nm + 2.0 * shake_nm),
            lagging: if full.drive.amplifier_tau_s > 0.0 {
                2.0 * (LAG_INTEGRATION + INTEGRATION * coupled)
            } else {
                0.0
            },
            count_rad: full.config.count_rad(),
            longest_s: full.clock.longest_s(),
            angle_rad: 0.0,
            velocity_rad_s: 0.0,
            added: [0.0; Phenomenon::ALL.len()],
            dropped,
            last: None,
            before_nm: 0.0,
            same_s: 0.0,
            idle: 0,
            hopeless: false,
        }
    }

    /// Goes to the next sample; false if the true knob may be too far away there, or its count
    /// another.
    fn enter(&mut self, sample: &Sample, tolerance_rad: f64) -> bool {
        let torque_nm = self.drive.rounded(f64::from(sample.tick.torque_nm));
        if let Some(last) = self.last {
            self.advance(&last, sample.state, sample.time_s - last.time_s);
            self.before_nm = last.torque_nm;
            if torque_nm == last.torque_nm {
                self.same_s += sample.time_s - last.time_s;
            } else {
                self.same_s = 0.0;
            }
        }
        self.last = Some(Last {
            state: sample.state,
            time_s: sample.time_s,
            torque_nm,
        });
        self.is_sure(sample.state, tolerance_rad)
    }

    /// Whether the true knob is within the tolerance, its count is known, and it has not come to rest
    /// unseen.
    fn is_sure(&mut self, state: State, tolerance_rad: f64) -> bool {
        let moves = state.velocity != 0.0;
        if moves && self.idle >= REST_SAMPLES {
            return false;
        }
        if state.velocity.abs() <= self.velocity_rad_s || !moves {
            self.idle += 1;
        } else {
            self.idle = 0;
        }
        let counts = state.position / self.count_rad;
        let edge_rad = (counts - counts.round()).abs() * self.count_rad;
        self.angle_rad <= tolerance_rad && (self.angle_rad == 0.0 || edge_rad > self.angle_rad)
    }

    /// Goes to the end of the run; false if the true knob may be too far away there, or may not
    /// have ended with it.
    fn close(&mut self, report: &Report, tolerance_rad: f64) -> bool {
        if report.class == Class::Unstable {
            self.hopeless = true;
            return false;
        }
        if let Some(last) = self.last {
            self.advance(&last, report.end, self.longest_s);
        }
        let ended = if report.class == Class::Rest {
            self.velocity_rad_s == 0.0
        } else {
            self.idle < REST_SAMPLES
        };
        ended && self.angle_rad <= tolerance_rad
    }

    /// What is to be kept in the next attempt.
    fn culprit(&self) -> Phenomena {
        if self.hopeless {
            return self.dropped;
        }
        let added = Phenomenon::ALL.into_iter().zip(self.added);
        let worst = added
            .filter(|(phenomenon, _)| self.dropped.has(*phenomenon))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        worst.map_or(self.dropped, |(phenomenon, _)| {
            Phenomena::default().with(phenomenon)
        })
    }

    /// A tick of `dt` seconds, from the last sample to `end`.
    fn advance(&mut self, last: &Last, end: State, dt: f64) {
        let start = last.state;
        let stuck = start.velocity == 0.0 && end == start;
        let change_nm = self.before_nm - last.torque_nm;
        let held_nm = [self.before_nm, last.torque_nm].map(|torque_nm| self.net(start, torque_nm));
        // A torque between both: the old one may not be over.
        let most_nm = held_nm[0].abs().max(held_nm[1].abs()) + self.kept_nm;

        let mut from = start.velocity;
        let mut velocity = self.velocity_rad_s;
        if change_nm != 0.0 {
            let (kicked, missed_s, moved_rad) = self.late(start, change_nm, held_nm, dt);
            from = kicked;
            let missed = missed_s / self.inertia;
            velocity += missed;
            self.angle_rad += moved_rad;
            self.add(Phenomenon::AmplifierLag, missed);
            self.add(Phenomenon::Delay, missed);
        }

        // The lowest and the highest speed in the tick: in between it is monotone.
        let [low, high] = {
            let (a, b) = (from.abs(), end.velocity.abs());
            let low = if from * end.velocity > 0.0 {
                a.min(b)
            } else {
                0.0
            };
            [low, a.max(b).max(start.velocity.abs())]
        };
        let per_nm = dt / self.inertia;
        let mut torque_nm = 0.0;
        for (phenomenon, part_nm) in [
            (Phenomenon::TorqueStep, self.of_the_steps(last.torque_nm)),
            (Phenomenon::Cogging, self.cogging_nm),
            (Phenomenon::HandShake, self.shake_nm),
            (
                Phenomenon::Hand,
                self.of_the_hand(start, end, high, most_nm, dt),
            ),
        ] {
            torque_nm += part_nm;
            self.add(phenomenon, part_nm * per_nm);
        }
        let stiction_nm = self.of_stiction(low - velocity - torque_nm * per_nm, per_nm);
        self.add(Phenomenon::Stiction, stiction_nm * per_nm);

        let spring = self.stiffness * dt * per_nm;
        let pulled_nm = torque_nm + self.stiffness * self.angle_rad;
        let fastest = if spring < 0.5 {
            (velocity + (pulled_nm + stiction_nm) * per_nm) / (1.0 - spring)
        } else {
            f64::INFINITY
        };
        let settled = self.late.is_some() || self.same_s >= self.follows_s;
        let braking_nm = self.coulomb - most_nm - pulled_nm - self.stiffness * fastest * dt;
        if stuck && settled && braking_nm > 0.0 {
            self.angle_rad += velocity * dt;
            self.velocity_rad_s = (velocity - braking_nm * per_nm).max(0.0);
            return;
        }
        let integration = (self.varying_nm + self.lagging * change_nm.abs()) * per_nm;
        let rounding = ROUNDING * (high + most_nm * per_nm);
        self.velocity_rad_s = fastest + integration + rounding;
        let reach = ROUNDING * (start.position.abs() + end.position.abs());
        self.angle_rad += self.velocity_rad_s * dt + reach;
    }

    /// The torque on a knob at rest, but for what varies, Nm.
    fn net(&self, state: State, torque_nm: f64) -> f64 {
        let hand = &self.hand;
        torque_nm + hand.push_nm - hand.stiffness_nm_rad * (state.position - hand.rest_rad)
    }

    /// A torque that has changed by −`change_nm` late: the velocity from which the simple knob starts, and what
    /// that misses of momentum (kg m²/s) and of angle (rad).
    fn late(&self, start: State, change_nm: f64, held_nm: [f64; 2], dt: f64) -> (f64, f64, f64) {
        let v = start.velocity;
        let Some((late, impulse)) = &self.late else {
            return (v, 0.0, 0.0);
        };
        let change = change_nm.abs();
        let whole = change * late.lasts_s;
        if v == 0.0 {
            // Friction holds it all the while, or lets go at some time.
            let holds = held_nm
                .iter()
                .all(|held| held.abs() + self.kept_nm <= self.coulomb);
            let missed = if holds { 0.0 } else { whole };
            return (v, missed, missed * late.lasts_s / self.inertia);
        }
        let kicked = v + change_nm * impulse.velocity;
        let speed = if kicked * v > 0.0 {
            v.abs().min(kicked.abs())
        } else {
            0.0
        };
        let against = held_nm.map(|held| -held * v.signum());
        let lost_nm = self.step_nm
            + self.cogging_nm
            + self.shake_nm
            + self.stiction_most()
            + self.lost_hand.map_or(0.0, |hand| hand.push_nm.abs());
        let braked_nm = against[0].max(against[1]).max(0.0)
            + self.kept_nm
            + lost_nm
            + self.coulomb
            + self.viscous * (v.abs().max(kicked.abs()) + self.velocity_rad_s);
        let reserve = speed - self.velocity_rad_s - whole / self.inertia;
        let stands_s = (reserve * self.inertia / braked_nm).max(0.0);
        if stands_s >= dt {
            return (kicked, 0.0, 0.0);
        }
        // Never NaN: without any brake the quotient is infinite, or 0/0 and then 0.
        let missed = 2.0 * change * late.left_s(stands_s);
        (kicked, missed, missed * late.lasts_s / self.inertia)
    }

    /// What the steps that are left out would do at most to the torque of a tick, Nm: to the old and
    /// the new one, or, where older ones may last, to any.
    fn of_the_steps(&self, torque_nm: f64) -> f64 {
        if self.follows_s > 0.0 {
            return self.step_nm;
        }
        let wrong = |torque_nm: f64| (self.steps.rounded(torque_nm) - torque_nm).abs();
        wrong(self.before_nm).max(wrong(torque_nm))
    }

    fn stiction_most(&self) -> f64 {
        self.stiction.map_or(0.0, |motor| motor.stiction_nm)
    }

    /// The most stiction that the true knob feels, which without it would be no slower than `speed`, Nm.
    ///
    /// While it is faster than half of that, it feels no more than at half; and so it stays faster.
    fn of_stiction(&self, speed: f64, per_nm: f64) -> f64 {
        let Some(motor) = &self.stiction else {
            return 0.0;
        };
        let half = 0.5 * speed;
        let felt_nm = motor.stiction(half.max(0.0));
        if half > 0.0 && felt_nm * per_nm <= half {
            felt_nm
        } else {
            motor.stiction_nm
        }
    }

    /// The most that the hand does to a knob that is no faster than twice `high` + e_v, Nm; infinite
    /// if it may become faster.
    fn of_the_hand(&self, start: State, end: State, high: f64, most_nm: f64, dt: f64) -> f64 {
        let Some(hand) = &self.lost_hand else {
            return 0.0;
        };
        let fastest = 2.0 * (high + self.velocity_rad_s);
        let reach = (start.position - hand.rest_rad)
            .abs()
            .max((end.position - hand.rest_rad).abs())
            + self.angle_rad
            + fastest * dt;
        let steady_nm =
            hand.push_nm.abs() + hand.stiffness_nm_rad * reach + hand.damping_nm_s_rad * fastest;
        let accelerating_nm = most_nm
            + steady_nm
            + self.coulomb
            + self.viscous * fastest
            + self.cogging_nm
            + self.shake_nm
            + self.step_nm
            + self.stiction_most();
        let mass = hand.inertia_kg_m2 / (hand.inertia_kg_m2 + self.inertia);
        let torque_nm = steady_nm + mass * accelerating_nm;
        let all_nm =
            torque_nm + self.cogging_nm + self.shake_nm + self.step_nm + self.stiction_most();
        let faster = high + self.velocity_rad_s + all_nm * dt / self.inertia;
        let rests = high == 0.0 && most_nm + all_nm < self.coulomb;
        if faster <= fastest || rests {
            torque_nm
        } else {
            f64::INFINITY
        }
    }

    fn add(&mut self, phenomenon: Phenomenon, velocity_rad_s: f64) {
        for (own, added) in Phenomenon::ALL.into_iter().zip(&mut self.added) {
            if own == phenomenon {
                *added += velocity_rad_s;
            }
        }
    }
}

//! A knob with what a real one adds: the plant of [`Hold`], a [`Hand`] that holds it, a
//! [`Drive`] between command and motor and a [`Motor`] that cogs and sticks.
//!
//! (m + M) ẍ + (b + B) ẋ + K_h (x − rest) + (c + s·e^(−(ẋ/v_s)²)) sgn ẋ
//!   = F_motor − A sin(N x) + push + shake·sin(2πft)
//!
//! With an amplifier without lag and a hand that does not shake, all torques are constant
//! between the moments at which commands take effect: every interval is cut there and solved
//! in closed form, without error but rounding.
//!
//! # A torque that varies
//! A lag or a shake is held constant over the halves of short pieces, so that each piece has
//! the exact impulse and the exact first moment of the torque. A piece in which the motion
//! turns, stops or breaks loose, or may, is halved, ten times at most. With δ the length of
//! a piece:
//!
//! - a mass without viscous friction and spring has no error at the ends of pieces;
//! - else the error is of fourth order in δ, and pieces are so short that it stays below
//!   1e-6 of F·h²/(m + M) (position) and F·h/(m + M) (velocity), F what the lag has to
//!   make up plus twice the amplitude of the shake, h the length of the interval;
//! - a turn or a break inside a piece is of second order in δ/1024: also within that bound.
//!
//! Cogging and stiction vary with the motion itself: what they are at the start, in the middle
//! and at the end of a piece is found by iteration, and taken as a parabola through these. Pieces are
//! at most a twentieth of the time in which they vary; fourth order again, and the same bound, with F the sum
//! of all torques.
//!
//! Pieces are at most ¼ of τ and of 1/(2πf) and ½ of the plant's time, the shorter of
//! (m + M)/(b + B) and √((m + M)/K_h); as the lag decays they grow, so that an
//! amplifier much faster than the interval takes some 35 of them. Energies are those of the
//! held torques, and balance to rounding.

use control::ConfigError;
use control::criterion::Device;

use crate::drive::{Actuator, Drive, Halves, Impulse};
use crate::electrical::Wiring;
use crate::hand::Hand;
use crate::hold::{Hold, State};
use crate::motor::Motor;
use crate::sprung::{Moved, Sprung};

/// What [`Knob::hold`] did. Energies in J: ½ m v² of the knob changes by
/// `motor_work_j` − `friction_j` + `hand_work_j`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The state at the end.
    pub end: State,
    /// The largest |angle| within, rad.
    pub furthest_rad: f64,
    /// ∫F_motor dx, the motor's cogging included.
    pub motor_work_j: f64,
    /// ∫(b v² + c|v|) dt of the knob alone, with its stiction, ≥ 0.
    pub friction_j: f64,
    /// The work of all the hand's forces on the knob, those that move and brake its own mass
    /// included.
    pub hand_work_j: f64,
}

/// Why there is no such knob.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum KnobError {
    /// A quantity has the wrong sign or is not one.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A quantity that may have either sign is not finite.
    #[error("{name} is {value}; accepted: a finite number")]
    NotFinite {
        /// Which quantity, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// Phases are not each connected to a terminal of their own.
    #[error(
        "wiring is {0:?}; accepted: terminals 0, 1, 2 in any order, and a phase from 0 to 2 open, or none"
    )]
    Wiring(Wiring),
    /// A quantity is larger than can be followed.
    #[error("{name} is {value}; accepted: up to {limit}, {reason}")]
    Above {
        /// Which quantity, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
        /// The largest value accepted.
        limit: f64,
        /// Where that comes from.
        reason: &'static str,
    },
}

/// The fastest shake, in turns per period.
const FASTEST_SHAKE: f64 = 10.0;

/// The fastest hand, √(K_h/(m + M)) times the period.
const FASTEST_HAND: f64 = 1000.0;

/// A command due this close to the end of an interval, in units of the interval, falls on it.
const SAME_TIME: f64 = 1e-9;

/// Pieces per unit of the fastest rate at which the torque varies (1/τ or 2πf).
const PIECES: f64 = 4.0;

/// Pieces per √(that rate × the plant's): fourth order, 1.4e-3·(plant rate·h)²·(torque rate·h)²/n⁴
/// of F·h²/m is 2e-8.
const PIECES_OF_BOTH: f64 = 16.0;

/// Pieces per unit of the plant's rate: the orders above hold for pieces shorter than it.
const PIECES_OF_PLANT: f64 = 2.0;

/// Pieces per unit of the rate at which cogging and stiction vary.
const PIECES_OF_MOTION: f64 = 20.0;

/// The fastest cogging and stiction that are followed, per period: beyond, a knob passes 80 periods of
/// cogging within one of sampling, and pieces would become too many.
const FASTEST_MOTION: f64 = 500.0;

/// Cogging and stiction along a piece are found by iteration, each of which gains a digit or two:
/// until they change by this part.
const CLOSE: f64 = 1e-12;

/// At most so many times.
const ITERATIONS: u32 = 12;

/// A piece with a turn is halved so many times.
const HALVINGS: u32 = 10;

/// A knob, the hand on it and the drive behind it, at a tick.
///
/// ```
/// use control::criterion::Device;
/// use plant_sim::drive::Drive;
/// use plant_sim::hand::Hand;
/// use plant_sim::hold::State;
/// use plant_sim::knob::Knob;
/// use plant_sim::motor::Motor;
/// let device = Device { inertia_kg_m2: 1.0, viscous_nm_s_rad: 0.0, coulomb_nm: 1.0 };
/// // Half a period late: 3 Nm against 1 Nm of friction, for half a second.
/// let drive = Drive { delay_s: 0.5, ..Drive::default() };
/// let rest = State { position: 0.0, velocity: 0.0 };
/// let mut knob = Knob::new(&device, &Motor::default(), &Hand::default(), &drive, 1.0, rest)?;
/// let interval = knob.hold(3.0, 1.0);
/// assert_eq!(interval.end, State { position: 0.25, velocity: 1.0 });
/// assert_eq!((interval.motor_work_j, interval.friction_j), (0.75, 0.25));
/// # Ok::<(), plant_sim::knob::KnobError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Knob {
    state: State,
    /// Knob and hand together, for one period.
    hold: Hold,
    /// Nothing but the knob, and a torque that changes at ticks only.
    plain: bool,
    /// What stands for delay and lag, where they are not followed.
    impulse: Option<Impulse>,
    drive: Drive,
    motor: Motor,
    /// The knob's own m, b.
    inertia: f64,
    viscous: f64,
    /// Knob and hand together.
    joined: Device<f64>,
    spring: Option<Sprung>,
    hand: Hand,
    has_hand: bool,
    actuator: Actuator,
    /// Of the shake, in turns.
    phase: f64,
    /// How fast the plant answers, 1/s: the larger of (b + B)/(m + M) and √(K_h/(m + M)), up to
    /// 1000 per period, so that pieces stay below some 4000 in a period.
    plant_rate: f64,
}

impl Knob {
    /// A knob in state `start`, its motor without torque, to be held for about `period_s`
    /// at a time.
    ///
    /// # Errors
    /// Refuses what is not finite, an inertia or period not above zero, negative friction,
    /// mass, damping, stiffness, times and steps; a delay beyond 1000 periods, a shake of more
    /// than 10 turns in a period, a hand with √(K_h/(m + M)) beyond 1000 in a period.
    pub fn new(
        device: &Device<f64>,
        motor: &Motor,
        hand: &Hand,
        drive: &Drive,
        period_s: f64,
        start: State,
    ) -> Result<Self, KnobError> {
        // The knob's own numbers are refused under their own names.
        Hold::new(device, period_s)?;
        motor.check()?;
        hand.check()?;
        drive.check(period_s)?;
        let joined = joined(device, hand);
        let hold = Hold::new(&joined, period_s)?;
        for (name, value) in [
            ("start angle (rad)", start.position),
            ("start velocity (rad/s)", start.velocity),
        ] {
            if !value.is_finite() {
                return Err(KnobError::NotFinite { name, value });
            }
        }
        let omega0 = (hand.stiffness_nm_rad / joined.inertia_kg_m2).sqrt();
        for (name, value, limit, reason) in [
            (
                "hand shake frequency (Hz)",
                hand.shake_hz,
                FASTEST_SHAKE / period_s,
                "10 turns in a sample period",
            ),
            (
                "√(hand stiffness / inertia of hand and knob) (rad/s)",
                omega0,
                FASTEST_HAND / period_s,
                "1000 in a sample period",
            ),
        ] {
            if value > limit {
                return Err(KnobError::Above {
                    name,
                    value,
                    limit,
                    reason,
                });
            }
        }
        Ok(Self {
            state: start,
            hold,
            plain: hand.is_absent() && drive.is_prompt() && motor.is_even(),
            impulse: None,
            drive: *drive,
            motor: *motor,
            inertia: device.inertia_kg_m2,
            viscous: device.viscous_nm_s_rad,
            joined,
            spring: (hand.stiffness_nm_rad > 0.0)
                .then(|| Sprung::new(&joined, hand.stiffness_nm_rad, hand.rest_rad)),
            hand: *hand,
            has_hand: !hand.is_absent(),
            actuator: Actuator::new(*drive),
            phase: 0.0,
            plant_rate: omega0
                .max(joined.viscous_nm_s_rad / joined.inertia_kg_m2)
                .min(FASTEST_HAND / period_s),
        })
    }

    /// The same knob with an impulse at each change of the torque, which stands for the delay and the
    /// lag of `drive` ([`Impulse`]). See [`crate::fidelity`].
    pub(crate) fn with_impulses(mut self, drive: &Drive) -> Self {
        self.impulse = Some(Impulse::new(drive, &self.joined));
        self.plain = false;
        self
    }

    /// Angle (rad) and velocity (rad/s) now.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// A tick commands `command_nm`, and the next one comes after `duration_s`.
    ///
    /// # Assumes
    /// A finite command.
    ///
    /// # Panics
    /// If the duration is not finite and above zero, or so far beyond the period that
    /// squares overflow.
    #[inline]
    pub fn hold(&mut self, command_nm: f64, duration_s: f64) -> Interval {
        if !self.plain || duration_s != self.hold.duration() {
            return self.hold_any(command_nm, duration_s);
        }
        self.hold_plain(command_nm)
    }

    /// [`Knob::hold`] for a period, where there is nothing but the knob.
    #[inline]
    fn hold_plain(&mut self, command_nm: f64) -> Interval {
        let start = self.state;
        let torque = self.drive.rounded(command_nm);
        let step = self.hold.step(start, torque);
        let end = step.end;
        let turn = step.turn.map_or(end.position, |turn| turn.position);
        let motor_work_j = torque * (end.position - start.position);
        self.state = end;
        Interval {
            end,
            furthest_rad: start.position.abs().max(turn.abs()).max(end.position.abs()),
            motor_work_j,
            friction_j: (motor_work_j - gained(self.inertia, start, end)).max(0.0),
            hand_work_j: 0.0,
        }
    }

    /// [`Knob::hold`], whatever there is.
    #[inline(never)]
    fn hold_any(&mut self, command_nm: f64, duration_s: f64) -> Interval {
        let start = self.state;
        let mut kick_j = 0.0;
        if let Some(impulse) = &mut self.impulse {
            self.state = impulse.kick(self.state, self.drive.rounded(command_nm));
            kick_j = gained(self.inertia, start, self.state);
            let even = !self.has_hand && self.motor.is_even();
            if even && duration_s == self.hold.duration() {
                let mut interval = self.hold_plain(command_nm);
                interval.motor_work_j += kick_j;
                return interval;
            }
        }
        let mut interval = Interval {
            end: start,
            furthest_rad: start.position.abs(),
            motor_work_j: kick_j,
            friction_j: 0.0,
            hand_work_j: 0.0,
        };
        self.actuator.command(command_nm);
        let margin = SAME_TIME * duration_s;
        let mut left = duration_s;
        loop {
            let change = self.actuator.take_due(margin);
            let length = match change {
                Some(due) if due < left - margin => due,
                _ => left,
            };
            self.span(length, &mut interval);
            self.actuator.wait(length);
            if length == left {
                break;
            }
            left -= length;
        }
        interval.end = self.state;
        if self.has_hand {
            interval.hand_work_j = gained(self.inertia, start, self.state) - interval.motor_work_j
                + interval.friction_j;
        }
        interval
    }

    /// A time in which no command takes effect.
    fn span(&mut self, length: f64, interval: &mut Interval) {
        let mut left = length;
        loop {
            let longest = self.longest_piece(length - left);
            if longest == f64::INFINITY {
                let start = self.state;
                let hand = self.hand.push_nm;
                let motor = self.actuator.torque() + self.motor.cogging(start.position);
                let coulomb = self.coulomb_at(start.velocity);
                let moved = self.half(&self.hold_for(left), start, motor + hand, coulomb);
                self.enter(&moved, motor, hand, coulomb, interval);
                self.pass(left);
                return;
            }
            let pieces = (left / longest).ceil();
            if pieces <= 1.0 {
                self.piece(left, HALVINGS, interval);
                return;
            }
            let piece = left / pieces;
            self.piece(piece, HALVINGS, interval);
            left -= piece;
        }
    }

    /// The longest piece that keeps the error small, `age` seconds after a change.
    fn longest_piece(&self, age: f64) -> f64 {
        let longest = |rate: f64| {
            let both = (rate * self.plant_rate).sqrt();
            (PIECES * rate)
                .max(PIECES_OF_BOTH * both)
                .max(PIECES_OF_PLANT * self.plant_rate)
                .recip()
        };
        let mut piece = f64::INFINITY;
        if self.actuator.is_lagging() {
            let tau = self.drive.amplifier_tau_s;
            // Twice as long every 4τ, in which what is left of the lag falls to a fiftieth.
            piece = longest(tau.recip()) * (0.25 * age / tau).floor().exp2();
        }
        if self.hand.shakes() {
            piece = piece.min(longest(std::f64::consts::TAU * self.hand.shake_hz));
        }
        if !self.motor.is_even() {
            piece = piece.min(self.longest_even_piece(piece));
        }
        piece
    }

    /// The longest piece over which cogging and stiction vary by little, where other torques vary
    /// over `piece`.
    fn longest_even_piece(&self, piece: f64) -> f64 {
        let State { position, velocity } = self.state;
        let torque = self.actuator.torque() + self.hand.torque(self.phase);
        let net = self.net(self.state, torque + self.motor.cogging(position));
        let coulomb = self.coulomb_at(velocity);
        if velocity == 0.0 && net.abs() <= coulomb && piece == f64::INFINITY {
            return piece; // it sticks
        }
        let inertia = self.joined.inertia_kg_m2;
        let braked = coulomb + self.joined.viscous_nm_s_rad * velocity.abs();
        let varying = self.motor.cogging_nm + self.motor.stiction_nm;
        let acceleration = (net.abs() + braked + varying) / inertia;
        let rate = self.motor.rate(velocity.abs(), acceleration);
        if rate == 0.0 {
            return f64::INFINITY; // nothing accelerates it
        }
        let rate = rate.min(FASTEST_MOTION / self.hold.duration());
        (PIECES_OF_MOTION * rate)
            .max(PIECES_OF_PLANT * self.plant_rate)
            .recip()
    }

    /// Coulomb friction and stiction at a velocity, Nm.
    fn coulomb_at(&self, velocity: f64) -> f64 {
        self.joined.coulomb_nm + self.motor.stiction(velocity)
    }

    /// What the hand's spring leaves of a torque, Nm.
    fn net(&self, state: State, torque: f64) -> f64 {
        match &self.spring {
            Some(spring) => spring.net(state.position, torque),
            None => torque,
        }
    }

    /// A piece of a varying torque, in its two halves, or in smaller pieces around a turn.
    fn piece(&mut self, length: f64, halvings: u32, interval: &mut Interval) {
        let start = self.state;
        let half = 0.5 * length;
        let hold = self.hold_for(half);
        let drive = self.actuator.halves(length);
        let hand = self.hand.halves(self.phase, length);
        let (hand1, hand2) = (hand.mean - hand.lean, hand.mean + hand.lean);
        let mut cogging = Halves::even(self.motor.cogging(start.position));
        let mut coulomb = Halves::even(self.coulomb_at(start.velocity));
        let mut iteration = 0;
        let [first, second] = loop {
            let motor1 = drive.mean - drive.lean + cogging.mean - cogging.lean;
            let motor2 = drive.mean + drive.lean + cogging.mean + cogging.lean;
            let coulomb1 = (coulomb.mean - coulomb.lean).max(0.0);
            let coulomb2 = (coulomb.mean + coulomb.lean).max(0.0);
            let first = self.half(&hold, start, motor1 + hand1, coulomb1);
            let second = self.half(&hold, first.end, motor2 + hand2, coulomb2);
            let parts = [
                (first, motor1, hand1, coulomb1),
                (second, motor2, hand2, coulomb2),
            ];
            iteration += 1;
            if self.motor.is_even() || first.turned || second.turned || iteration == ITERATIONS {
                break parts;
            }
            // The halves take the knob to the place of the varying torque in the middle, but too
            // late: there a torque of this slope has done a quarter of the lean more.
            let direction = (second.end.velocity + start.velocity).signum();
            let lean = drive.lean + hand.lean + cogging.lean - direction * coulomb.lean;
            let late = 0.25 * lean * half / self.joined.inertia_kg_m2;
            let middle = State {
                velocity: first.end.velocity + late,
                ..first.end
            };
            let states = [start, middle, second.end];
            let before = (cogging.mean, coulomb.mean);
            cogging = Halves::parabola(states.map(|state| self.motor.cogging(state.position)));
            coulomb = Halves::parabola(states.map(|state| self.coulomb_at(state.velocity)));
            let close = CLOSE * (self.motor.cogging_nm + self.motor.stiction_nm);
            if (cogging.mean - before.0).abs() + (coulomb.mean - before.1).abs() <= close {
                break parts;
            }
        };

        let turns = first.0.turned || second.0.turned;
        if halvings > 0 && (turns || self.may_turn_unseen(start, second.0.end, length)) {
            self.piece(half, halvings - 1, interval);
            self.piece(half, halvings - 1, interval);
            return;
        }
        for (moved, motor, hand, coulomb) in [first, second] {
            self.enter(&moved, motor, hand, coulomb, interval);
        }
        self.pass(length);
    }

    /// Whether a motion from `start` to `end` that turns nowhere under the held torques may
    /// do so under the varying one.
    ///
    /// From rest: if the torque at the end of the piece would take the knob elsewhere than that
    /// at its start. Else: if it is braked at first, so that it would stand within the piece,
    /// and driven on at the end.
    fn may_turn_unseen(&self, start: State, end: State, length: f64) -> bool {
        let now = self.actuator.torque() + self.hand.torque(self.phase);
        let later = self.actuator.torque_after(length) + self.hand.torque(self.phase_after(length));
        let net = |state: State, torque: f64| {
            self.net(state, torque + self.motor.cogging(state.position))
        };
        if start.velocity == 0.0 {
            let stuck = self.hold.with_coulomb(self.coulomb_at(0.0));
            let driving = |torque| stuck.breakaway(net(start, torque));
            let (now, later) = (driving(now), driving(later));
            return (now > 0.0) != (later > 0.0) || (now < 0.0) != (later < 0.0);
        }
        let along = |state: State, torque: f64| {
            let torque = net(state, torque) - self.joined.viscous_nm_s_rad * state.velocity;
            torque * start.velocity.signum() - self.coulomb_at(state.velocity)
        };
        let (now, later) = (along(start, now), along(end, later));
        let momentum = self.joined.inertia_kg_m2 * start.velocity.abs();
        now < 0.0 && later > 0.0 && momentum + now * length < 0.0
    }

    fn phase_after(&self, time: f64) -> f64 {
        (self.phase + self.hand.shake_hz * time).fract()
    }

    /// Time passes for the torques.
    fn pass(&mut self, time: f64) {
        self.actuator.follow(time);
        self.phase = self.phase_after(time);
    }

    fn hold_for(&self, duration: f64) -> Hold {
        if duration == self.hold.duration() {
            self.hold
        } else {
            Hold::new(&self.joined, duration)
                .expect("an interval is finite, above zero and near the sample period")
        }
    }

    /// The motion of knob and hand under a constant force and friction for the time of `hold`.
    fn half(&self, hold: &Hold, start: State, force: f64, coulomb: f64) -> Moved {
        if let Some(spring) = &self.spring {
            let spring = spring.with_coulomb(coulomb);
            return spring.advance(start, force, hold.duration());
        }
        // From zero, as the displacement then keeps its digits.
        let step = hold.with_coulomb(coulomb).step(
            State {
                position: 0.0,
                ..start
            },
            force,
        );
        let displacement = step.end.position;
        let end = State {
            position: start.position + displacement,
            ..step.end
        };
        let furthest = start.position.abs().max(end.position.abs());
        match step.turn {
            None => Moved {
                end,
                displacement,
                path: displacement.abs(),
                furthest,
                turned: false,
            },
            Some(turn) => Moved {
                end,
                displacement,
                path: turn.position.abs() + (displacement - turn.position).abs(),
                furthest: furthest.max((start.position + turn.position).abs()),
                turned: true,
            },
        }
    }

    /// Goes to the end of a motion under constant torques, and accounts for it.
    ///
    /// What all friction takes comes from the balance of knob, hand and spring; the path
    /// tells the part of Coulomb friction; the rest is viscous and shared as b to b + B.
    fn enter(
        &mut self,
        moved: &Moved,
        motor: f64,
        hand: f64,
        coulomb: f64,
        interval: &mut Interval,
    ) {
        let dx = moved.displacement;
        let (start, end) = (self.state, moved.end);
        let stored = match &self.spring {
            Some(_) => {
                let stretch = (start.position - self.hand.rest_rad) + 0.5 * dx;
                self.hand.stiffness_nm_rad * stretch * dx
            }
            None => 0.0,
        };
        let taken = (motor + hand) * dx - stored - gained(self.joined.inertia_kg_m2, start, end);
        let coulomb = coulomb * moved.path;
        let viscous = (taken - coulomb).max(0.0);
        let share = if self.viscous > 0.0 {
            self.viscous / self.joined.viscous_nm_s_rad
        } else {
            0.0
        };
        interval.motor_work_j += motor * dx;
        interval.friction_j += coulomb + share * viscous;
        interval.furthest_rad = interval.furthest_rad.max(moved.furthest);
        self.state = end;
    }
}

/// Knob and hand as one mass with friction.
pub(crate) fn joined(device: &Device<f64>, hand: &Hand) -> Device<f64> {
    Device {
        inertia_kg_m2: device.inertia_kg_m2 + hand.inertia_kg_m2,
        viscous_nm_s_rad: device.viscous_nm_s_rad + hand.damping_nm_s_rad,
        coulomb_nm: device.coulomb_nm,
    }
}

/// The change of ½ m v², J.
#[inline]
fn gained(inertia: f64, start: State, end: State) -> f64 {
    0.5 * inertia * (end.velocity - start.velocity) * (end.velocity + start.velocity)
}

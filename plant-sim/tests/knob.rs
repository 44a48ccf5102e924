//! Laws of [`plant_sim::knob`]: it is the core where nothing is added, agrees with closed
//! forms and with a Runge–Kutta integration where something is, and its energies balance.

use std::f64::consts::TAU;

use control::criterion::Device;
use plant_sim::drive::Drive;
use plant_sim::energy;
use plant_sim::hand::Hand;
use plant_sim::hold::{Hold, State};
use plant_sim::knob::{Interval, Knob};
use plant_sim::motor::Motor;
use proptest::prelude::*;

/// In units in which m and the period are 1.
fn device(b: f64, c: f64) -> Device<f64> {
    Device {
        inertia_kg_m2: 1.0,
        viscous_nm_s_rad: b,
        coulomb_nm: c,
    }
}

fn at(position: f64, velocity: f64) -> State {
    State { position, velocity }
}

fn knob(device: &Device<f64>, hand: &Hand, drive: &Drive, start: State) -> Knob {
    Knob::new(device, &Motor::default(), hand, drive, 1.0, start).unwrap()
}

/// Motors that cog, stick, or both.
fn motors() -> impl Strategy<Value = Motor> {
    (
        none_or(0.01..1.0_f64),
        0.5..20.0_f64,
        none_or(0.01..1.0_f64),
        0.01..2.0_f64,
    )
        .prop_map(
            |(cogging_nm, cogging_per_rev, stiction_nm, stribeck_rad_s)| Motor {
                cogging_nm,
                cogging_per_rev,
                stiction_nm,
                stribeck_rad_s,
            },
        )
}

fn none_or(values: impl Strategy<Value = f64>) -> impl Strategy<Value = f64> {
    prop_oneof![1 => Just(0.0), 2 => values]
}

fn devices() -> impl Strategy<Value = Device<f64>> {
    (none_or(1e-3..2.0_f64), none_or(1e-3..1.0_f64)).prop_map(|(b, c)| device(b, c))
}

fn starts() -> impl Strategy<Value = State> {
    (-2.0..2.0_f64, none_or(-2.0..2.0_f64)).prop_map(|(x, v)| at(x, v))
}

/// Hands whose torque is constant.
fn steady_hands() -> impl Strategy<Value = Hand> {
    (
        none_or(0.01..3.0_f64),
        none_or(0.01..1.0_f64),
        none_or(0.01..60.0_f64),
        -1.0..1.0_f64,
        none_or(-2.0..2.0_f64),
    )
        .prop_map(|(m, b, k, rest, push)| Hand {
            inertia_kg_m2: m,
            damping_nm_s_rad: b,
            stiffness_nm_rad: k,
            rest_rad: rest,
            push_nm: push,
            ..Hand::default()
        })
}

fn shaking_hands() -> impl Strategy<Value = Hand> {
    (steady_hands(), -2.0..2.0_f64, 0.01..1.0_f64).prop_map(|(hand, shake_nm, shake_hz)| Hand {
        shake_nm,
        shake_hz,
        ..hand
    })
}

fn lags() -> impl Strategy<Value = Drive> {
    (none_or(0.0..3.0_f64), 0.02..5.0_f64).prop_map(|(delay_s, amplifier_tau_s)| Drive {
        delay_s,
        amplifier_tau_s,
        torque_step_nm: 0.0,
    })
}

fn commands() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-2.0..2.0_f64, 1..6)
}

/// The energies in play, for tolerances.
fn energies(device: &Device<f64>, hand: &Hand, start: State, interval: &Interval) -> f64 {
    let mass = device.inertia_kg_m2 + hand.inertia_kg_m2;
    let stretch = |x: f64| 0.5 * hand.stiffness_nm_rad * (x - hand.rest_rad).powi(2);
    energy::kinetic(mass, start.velocity)
        + energy::kinetic(mass, interval.end.velocity)
        + stretch(start.position)
        + stretch(interval.end.position)
        + interval.motor_work_j.abs()
        + interval.friction_j
        + (hand.push_nm.abs() + hand.shake_nm.abs())
            * (interval.furthest_rad + start.position.abs())
}

/// Knob, motor and hand by Runge–Kutta: an independent way.
#[derive(Clone, Copy)]
struct Rk {
    device: Device<f64>,
    motor: Motor,
    hand: Hand,
    tau: f64,
    target: f64,
    time: f64,
    /// x, v, F_motor, ∫F_motor dx, ∫(b v² + c|v|), work of the hand but for its inertia.
    y: [f64; 6],
}

impl Rk {
    fn net(&self, time: f64, y: &[f64; 6]) -> f64 {
        let motor = if self.tau > 0.0 { y[2] } else { self.target };
        motor + self.cogging(y[0]) + self.pull(time, y[0])
    }

    fn cogging(&self, x: f64) -> f64 {
        -self.motor.cogging_nm * (self.motor.cogging_per_rev * x).sin()
    }

    /// Friction but the viscous, at a speed.
    fn coulomb(&self, v: f64) -> f64 {
        let Motor {
            stiction_nm,
            stribeck_rad_s,
            ..
        } = self.motor;
        if stiction_nm == 0.0 {
            return self.device.coulomb_nm;
        }
        self.device.coulomb_nm + stiction_nm * (-(v / stribeck_rad_s).powi(2)).exp()
    }

    fn pull(&self, time: f64, x: f64) -> f64 {
        let h = &self.hand;
        h.push_nm + h.shake_nm * (TAU * h.shake_hz * time).sin()
            - h.stiffness_nm_rad * (x - h.rest_rad)
    }

    fn rates(&self, sign: f64, time: f64, y: &[f64; 6]) -> [f64; 6] {
        let (d, h) = (&self.device, &self.hand);
        let v = y[1];
        let motor = if self.tau > 0.0 { y[2] } else { self.target };
        let motor_rate = if self.tau > 0.0 {
            (self.target - y[2]) / self.tau
        } else {
            0.0
        };
        if sign == 0.0 {
            return [0.0, 0.0, motor_rate, 0.0, 0.0, 0.0];
        }
        let braked = (d.viscous_nm_s_rad + h.damping_nm_s_rad) * v + self.coulomb(v) * sign;
        let a = (self.net(time, y) - braked) / (d.inertia_kg_m2 + h.inertia_kg_m2);
        [
            v,
            a,
            motor_rate,
            (motor + self.cogging(y[0])) * v,
            (d.viscous_nm_s_rad * v + self.coulomb(v) * sign) * v,
            (self.pull(time, y[0]) - h.damping_nm_s_rad * v - h.inertia_kg_m2 * a) * v,
        ]
    }

    fn stepped(&self, sign: f64, dt: f64) -> Self {
        let add = |k: &[f64; 6], w: f64| std::array::from_fn(|i| self.y[i] + w * k[i]);
        let k1 = self.rates(sign, self.time, &self.y);
        let k2 = self.rates(sign, self.time + 0.5 * dt, &add(&k1, 0.5 * dt));
        let k3 = self.rates(sign, self.time + 0.5 * dt, &add(&k2, 0.5 * dt));
        let k4 = self.rates(sign, self.time + dt, &add(&k3, dt));
        let sum = std::array::from_fn(|i| k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
        Self {
            time: self.time + dt,
            y: add(&sum, dt / 6.0),
            ..*self
        }
    }

    /// Over `dt`, events bisected to the last bit.
    fn step(&mut self, mut dt: f64) {
        while dt > 0.0 {
            let c = self.coulomb(0.0);
            let net = self.net(self.time, &self.y);
            let v = self.y[1];
            let sign = if v != 0.0 {
                v.signum()
            } else if net.abs() > c {
                net.signum()
            } else {
                0.0
            };
            let over = |next: &Self| {
                if sign == 0.0 {
                    next.net(next.time, &next.y).abs() > c
                } else {
                    next.y[1] * sign < 0.0
                }
            };
            let whole = self.stepped(sign, dt);
            if !over(&whole) {
                *self = whole;
                return;
            }
            let (mut low, mut high) = (0.0, dt);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if over(&self.stepped(sign, middle)) {
                    high = middle;
                } else {
                    low = middle;
                }
            }
            *self = self.stepped(sign, high);
            if sign != 0.0 {
                self.y[1] = 0.0;
            }
            dt -= high;
        }
    }

    /// One period from a tick with `command`, effective after `delay` < 1.
    fn hold(&mut self, command: f64, delay: f64) {
        const STEPS: u32 = 2000;
        for (target, time) in [(self.target, delay), (command, 1.0 - delay)] {
            self.target = target;
            for _ in 0..STEPS {
                self.step(time / f64::from(STEPS));
            }
        }
    }
}

/// Runs both ways, and the largest differences: of position, velocity, energies.
fn against_rk(
    device: &Device<f64>,
    motor: &Motor,
    hand: &Hand,
    drive: &Drive,
    start: State,
    commands: &[f64],
) -> [f64; 3] {
    let mut knob = Knob::new(device, motor, hand, drive, 1.0, start).unwrap();
    let mut rk = Rk {
        device: *device,
        motor: *motor,
        hand: *hand,
        tau: drive.amplifier_tau_s,
        target: 0.0,
        time: 0.0,
        y: [start.position, start.velocity, 0.0, 0.0, 0.0, 0.0],
    };
    let mut worst = [0.0_f64; 3];
    let mut sums = [0.0; 3];
    for &command in commands {
        let interval = knob.hold(command, 1.0);
        sums[0] += interval.motor_work_j;
        sums[1] += interval.friction_j;
        sums[2] += interval.hand_work_j;
        rk.hold(command, drive.delay_s);
        worst[0] = worst[0].max((interval.end.position - rk.y[0]).abs());
        worst[1] = worst[1].max((interval.end.velocity - rk.y[1]).abs());
        for (sum, y) in sums.iter().zip(&rk.y[3..]) {
            worst[2] = worst[2].max((sum - y).abs());
        }
    }
    worst
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// Nothing added: the core to the bit, friction as its closed form has it.
    #[test]
    fn a_plain_knob_is_the_core(device in devices(), start in starts(), commands in commands()) {
        let hold = Hold::new(&device, 1.0).unwrap();
        let mut knob = knob(&device, &Hand::default(), &Drive::default(), start);
        let mut state = start;
        for command in commands {
            let step = hold.step(state, command);
            let interval = knob.hold(command, 1.0);
            prop_assert_eq!(interval.end, step.end);
            prop_assert_eq!(knob.state(), step.end);
            prop_assert_eq!(interval.hand_work_j, 0.0);
            let scale = energies(&device, &Hand::default(), state, &interval)
                + (command.abs() + device.coulomb_nm) * interval.furthest_rad;
            let dissipated = energy::dissipated(&hold, state, command, &step);
            prop_assert!((interval.friction_j - dissipated).abs() <= 1e-14 * scale);
            let turn = step.turn.map_or(0.0, |turn| turn.position.abs());
            let furthest = state.position.abs().max(step.end.position.abs()).max(turn);
            prop_assert_eq!(interval.furthest_rad, furthest);
            state = step.end;
        }
    }

    /// An interval of another length than the period is exact too, and one may be cut.
    #[test]
    fn intervals_may_be_cut_anywhere(
        device in devices(),
        hand in prop_oneof![Just(Hand::default()), steady_hands()],
        delay_s in none_or(0.0..2.5_f64),
        torque_step_nm in none_or(0.01..0.5_f64),
        start in starts(),
        commands in commands(),
        cut in 0.01..0.99_f64,
    ) {
        let drive = Drive { delay_s, torque_step_nm, ..Drive::default() };
        let mut whole = knob(&device, &hand, &drive, start);
        let mut parts = whole.clone();
        for command in commands {
            let before = whole.state();
            let one = whole.hold(command, 1.0);
            let [a, b] = [cut, 1.0 - cut].map(|time| parts.hold(command, time));
            let scale = one.furthest_rad + 4.0;
            prop_assert!((one.end.position - b.end.position).abs() <= 1e-12 * scale);
            prop_assert!((one.end.velocity - b.end.velocity).abs() <= 1e-11 * scale);
            prop_assert!((one.furthest_rad - a.furthest_rad.max(b.furthest_rad)).abs() <= 1e-12 * scale);
            let scale = 10.0 * (1.0 + energies(&device, &hand, before, &one));
            prop_assert!((one.friction_j - a.friction_j - b.friction_j).abs() <= 1e-12 * scale);
            prop_assert!((one.motor_work_j - a.motor_work_j - b.motor_work_j).abs() <= 1e-12 * scale);
            prop_assert!((one.hand_work_j - a.hand_work_j - b.hand_work_j).abs() <= 1e-12 * scale);
        }
    }

    /// Δ(½ m v²) = motor − friction + hand, whatever there is; without a hand this is no
    /// definition, and with one of mass and push alone its work is known.
    #[test]
    fn energies_balance(
        device in devices(),
        motor in prop_oneof![Just(Motor::default()), motors()],
        hand in prop_oneof![Just(Hand::default()), shaking_hands(), steady_hands()],
        drive in prop_oneof![Just(Drive::default()), lags()],
        start in starts(),
        commands in commands(),
    ) {
        let mut knob = Knob::new(&device, &motor, &hand, &drive, 1.0, start).unwrap();
        for command in commands {
            let before = knob.state();
            let interval = knob.hold(command, 1.0);
            let gained = 0.5 * (interval.end.velocity.powi(2) - before.velocity.powi(2));
            let balance = interval.motor_work_j - interval.friction_j + interval.hand_work_j;
            let scale = energies(&device, &hand, before, &interval);
            prop_assert!((gained - balance).abs() <= 1e-12 * scale, "{gained} {balance} {interval:?}");
            prop_assert!(interval.friction_j >= 0.0);
            prop_assert!(interval.furthest_rad >= interval.end.position.abs());
            prop_assert!(interval.furthest_rad >= before.position.abs());
            if hand == Hand::default() {
                prop_assert_eq!(interval.hand_work_j, 0.0);
            }
            if hand.damping_nm_s_rad == 0.0 && hand.shake_nm == 0.0 {
                let middle = 0.5 * (before.position + interval.end.position) - hand.rest_rad;
                let pull = hand.push_nm - hand.stiffness_nm_rad * middle;
                let work = pull * (interval.end.position - before.position) - hand.inertia_kg_m2 * gained;
                prop_assert!((interval.hand_work_j - work).abs() <= 1e-12 * scale, "{work} {interval:?}");
            }
        }
    }

    /// A delay of whole periods shifts the commands; one inside a period cuts it.
    #[test]
    fn a_delay_only_delays(
        device in devices(),
        hand in prop_oneof![Just(Hand::default()), steady_hands()],
        start in starts(),
        commands in prop::collection::vec(-2.0..2.0_f64, 6),
        whole in 0..4_usize,
        part in prop_oneof![Just(0.0), 0.01..0.99_f64],
    ) {
        let drive = Drive { delay_s: whole as f64 + part, ..Drive::default() };
        let mut late = knob(&device, &hand, &drive, start);
        let mut prompt = knob(&device, &hand, &Drive::default(), start);
        let sent = |i: usize| i.checked_sub(whole).map_or(0.0, |i| commands[i]);
        for (i, &command) in commands.iter().enumerate() {
            let got = late.hold(command, 1.0).end;
            if part > 0.0 {
                prompt.hold(if i == 0 { 0.0 } else { sent(i - 1) }, part);
            }
            let expected = prompt.hold(sent(i), 1.0 - part).end;
            let scale = 1e-11 * (4.0 + got.position.abs());
            prop_assert!((got.position - expected.position).abs() <= scale, "{got:?} {expected:?}");
            prop_assert!((got.velocity - expected.velocity).abs() <= scale, "{got:?} {expected:?}");
        }
    }

    /// The command is the nearest multiple, in the plain case and in any other.
    #[test]
    fn commands_are_rounded(step in 1e-3..1.0_f64, command in -3.0..3.0_f64, start in starts()) {
        let drive = Drive { torque_step_nm: step, ..Drive::default() };
        let device = device(0.1, 0.1);
        let rounded = (command / step + 0.5).floor() * step;
        for duration in [1.0, 0.7] {
            let got = knob(&device, &Hand::default(), &drive, start).hold(command, duration);
            let expected = knob(&device, &Hand::default(), &Drive::default(), start).hold(rounded, duration);
            prop_assert!((got.end.position - expected.end.position).abs() < 1e-12);
        }
    }

    /// At rest within friction's hold nothing moves at all.
    #[test]
    fn what_sticks_stays(
        push in -0.3..0.3_f64,
        shake_nm in -0.3..0.3_f64,
        command in -0.3..0.3_f64,
        stiffness_nm_rad in none_or(0.1..1.0_f64),
        tau in none_or(0.1..2.0_f64),
    ) {
        let hand = Hand { push_nm: push, shake_nm, shake_hz: 0.4, stiffness_nm_rad, rest_rad: 0.4, ..Hand::default() };
        let drive = Drive { amplifier_tau_s: tau, ..Drive::default() };
        let start = at(0.5, 0.0);
        let mut knob = knob(&device(0.1, 1.0), &hand, &drive, start);
        for _ in 0..20 {
            let interval = knob.hold(command, 1.0);
            let expected = Interval { end: start, furthest_rad: 0.5, motor_work_j: 0.0, friction_j: 0.0, hand_work_j: 0.0 };
            prop_assert_eq!(interval, expected);
        }
    }

    /// Constant torques, springs and delays: Runge–Kutta errs, not the closed form.
    #[test]
    fn steady_torques_agree_with_runge_kutta(
        device in devices(),
        hand in steady_hands(),
        delay_s in none_or(0.01..0.99_f64),
        start in starts(),
        commands in commands(),
    ) {
        let drive = Drive { delay_s, ..Drive::default() };
        let worst = against_rk(&device, &Motor::default(), &hand, &drive, start, &commands);
        prop_assert!(worst.iter().all(|&error| error < 1e-8), "{worst:?}");
    }

    /// Lag, shake, spring, friction and delay at once: within the error that is stated.
    #[test]
    fn varying_torques_agree_with_runge_kutta(
        device in devices(),
        hand in prop_oneof![shaking_hands(), steady_hands(), Just(Hand::default())],
        drive in lags(),
        start in starts(),
        commands in commands(),
    ) {
        let drive = Drive { delay_s: drive.delay_s.fract(), ..drive };
        let worst = against_rk(&device, &Motor::default(), &hand, &drive, start, &commands);
        // In every interval torques range over 8 Nm at most.
        prop_assert!(worst.iter().all(|&error| error < 2e-5), "{worst:?}");

        let worst = against_rk(&device, &Motor::default(), &hand, &drive, start, &commands[..1]);
        let range = (commands[0].abs() + 2.0 * hand.shake_nm.abs()) / (1.0 + hand.inertia_kg_m2);
        prop_assert!(worst[0] < 1e-6 * range + 1e-9, "{worst:?}, range {range}");
        prop_assert!(worst[1] < 1e-6 * range + 1e-9, "{worst:?}, range {range}");
    }

    /// Cogging and stiction, alone and with all the rest.
    #[test]
    fn cogging_and_stiction_agree_with_runge_kutta(
        device in devices(),
        motor in motors(),
        hand in prop_oneof![3 => Just(Hand::default()), 1 => steady_hands(), 1 => shaking_hands()],
        drive in prop_oneof![2 => Just(Drive::default()), 1 => lags()],
        start in starts(),
        commands in commands(),
    ) {
        let drive = Drive { delay_s: drive.delay_s.fract(), ..drive };
        let worst = against_rk(&device, &motor, &hand, &drive, start, &commands[..1]);
        let stretch = (start.position - hand.rest_rad).abs();
        let swing = hand.stiffness_nm_rad.sqrt() * start.velocity.abs();
        let torques = commands[0].abs() + 2.0 * hand.shake_nm.abs() + hand.push_nm.abs()
            + hand.stiffness_nm_rad * stretch + swing
            + motor.cogging_nm + motor.stiction_nm;
        let range = torques / (1.0 + hand.inertia_kg_m2);
        prop_assert!(worst[0] < 1e-6 * range + 1e-9, "{worst:?}, range {range}");
        prop_assert!(worst[1] < 1e-6 * range + 1e-9, "{worst:?}, range {range}");
        prop_assert!(worst[2] < 1e-5 * (1.0 + range), "{worst:?}, range {range}");
    }

    /// An interval in one, and in a thousand parts with as many times more pieces: fast lags,
    /// fast shakes, stiff springs and strong friction keep the error that is stated.
    #[test]
    fn pieces_are_small_enough(
        b in none_or((-3.0..4.0_f64).prop_map(|e| 10_f64.powf(e))),
        c in none_or(0.01..2.0_f64),
        k in none_or((-3.0..4.0_f64).prop_map(|e| 10_f64.powf(e))),
        tau in none_or((-5.0..1.0_f64).prop_map(|e| 10_f64.powf(e))),
        shake_nm in none_or(-2.0..2.0_f64),
        shake_hz in (-3.0..1.0_f64).prop_map(|e| 10_f64.powf(e)),
        start in starts(),
        command in -2.0..2.0_f64,
    ) {
        const PARTS: u32 = 1000;
        let device = device(b, c);
        let hand = Hand { stiffness_nm_rad: k, shake_nm, shake_hz, ..Hand::default() };
        let drive = Drive { amplifier_tau_s: tau, ..Drive::default() };
        let mut whole = knob(&device, &hand, &drive, start);
        let mut parts = whole.clone();
        let one = whole.hold(command, 1.0);
        let mut friction = 0.0;
        for _ in 0..PARTS {
            friction += parts.hold(command, 1.0 / f64::from(PARTS)).friction_j;
        }
        let end = parts.state();
        let range = command.abs() + 2.0 * shake_nm.abs();
        // Rounding, of a start that a stiff spring drives.
        let rounding = 1e-12 * (1.0 + k);
        let worst = (one.end.position - end.position).abs();
        prop_assert!(worst < 1e-6 * range + rounding, "x: {}", worst / range);
        let worst = (one.end.velocity - end.velocity).abs();
        prop_assert!(worst < 1e-6 * range + rounding, "v: {}", worst / range);
        let worst = (one.friction_j - friction).abs();
        let scale = range * (one.furthest_rad + start.position.abs()) + one.friction_j;
        prop_assert!(worst < 1e-5 * scale + rounding, "friction: {worst} of {scale}");
    }
}

/// A knob that cogs swings about a detent of its own, ω = √(A N/m), and one that sticks needs more
/// to break loose than to go on.
#[test]
fn cogging_holds_and_stiction_sticks() {
    let motor = |cogging_nm, stiction_nm| Motor {
        cogging_nm,
        cogging_per_rev: 4.0,
        stiction_nm,
        stribeck_rad_s: 0.1,
    };
    let run = |motor, c, start, command, periods: u32| {
        let drive = Drive::default();
        let mut knob = Knob::new(
            &device(0.0, c),
            &motor,
            &Hand::default(),
            &drive,
            1.0,
            start,
        )
        .unwrap();
        for _ in 0..periods {
            knob.hold(command, 1.0);
        }
        knob.state()
    };
    // A small swing of ω = 2: a whole turn of it in π s, 3 s are 6 rad.
    let end = run(motor(1.0, 0.0), 0.0, at(1e-4, 0.0), 0.0, 3);
    assert!(
        (end.position - 1e-4 * 6.0_f64.cos()).abs() < 1e-9,
        "{end:?}"
    );
    // Held by its cogging up to A, not beyond.
    assert!(run(motor(1.0, 0.0), 0.1, at(0.0, 0.0), 0.6, 50).position < 0.4);
    assert!(run(motor(1.0, 0.0), 0.0, at(0.0, 0.0), 1.5, 50).position > 10.0);
    // 0.5 + 0.2 to break loose, 0.5 to go on.
    assert_eq!(
        run(motor(0.0, 0.2), 0.5, at(0.0, 0.0), 0.69, 10),
        at(0.0, 0.0)
    );
    assert!(run(motor(0.0, 0.2), 0.5, at(0.0, 0.0), 0.71, 10).velocity > 1.5);
    assert!(run(motor(0.0, 0.2), 0.5, at(0.0, 1.0), 0.51, 10).velocity > 1.0);
}

/// Commands that take effect at once, through a lag, without friction:
/// v = F(t − τ(1 − e^(−t/τ)))/m.
#[test]
fn a_lag_without_friction_is_exact() {
    for tau in [1e-3, 0.03, 0.5, 4.0] {
        let drive = Drive {
            amplifier_tau_s: tau,
            ..Drive::default()
        };
        let mut knob = knob(&device(0.0, 0.0), &Hand::default(), &drive, at(0.0, 0.0));
        for t in 1..=5 {
            let State { position, velocity } = knob.hold(3.0, 1.0).end;
            let t = f64::from(t);
            let gone = -(-t / tau).exp_m1();
            let v = 3.0 * (t - tau * gone);
            let x = 3.0 * (0.5 * t * t - tau * t + tau * tau * gone);
            assert!(
                (velocity - v).abs() < 1e-13 * t,
                "{tau}: {velocity}, not {v}"
            );
            assert!(
                (position - x).abs() < 1e-13 * t * t,
                "{tau}: {position}, not {x}"
            );
        }
    }
}

/// v = A(1 − cos ωt)/(mω).
#[test]
fn a_shake_without_friction_is_exact() {
    for hz in [1e-12, 0.01, 0.3, 4.0, 10.0] {
        let hand = Hand {
            inertia_kg_m2: 1.0,
            push_nm: 1.0,
            shake_nm: 6.0,
            shake_hz: hz,
            ..Hand::default()
        };
        let start = at(0.0, 0.0);
        let mut knob = knob(&device(0.0, 0.0), &hand, &Drive::default(), start);
        let omega = TAU * hz;
        for t in 1..=5 {
            let State { position, velocity } = knob.hold(0.0, 1.0).end;
            let t = f64::from(t);
            let half = (0.5 * omega * t).sin();
            let v = 0.5 * t + 3.0 * 2.0 * half * half / omega;
            let y = omega * t;
            let swing = if y < 1e-3 {
                y * t * t / 6.0 * (1.0 - y * y / 20.0)
            } else {
                (t - y.sin() / omega) / omega
            };
            let x = 0.25 * t * t + 3.0 * swing;
            assert!((velocity - v).abs() < 1e-12, "{hz}: {velocity}, not {v}");
            assert!((position - x).abs() < 1e-11, "{hz}: {position}, not {x}");
        }
    }
}

/// Every number is refused for what it is, with its value and what would do.
#[test]
fn what_is_no_knob_is_refused() {
    let good = device(0.1, 0.1);
    let no_hand = Hand::default();
    let ideal = Drive::default();
    let start = at(0.0, 0.0);
    let refused = |device: &Device<f64>, hand: &Hand, drive: &Drive, period: f64, start| {
        Knob::new(device, &Motor::default(), hand, drive, period, start)
            .unwrap_err()
            .to_string()
    };
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        for (field, name) in [
            "hand inertia (kg m²)",
            "hand damping (Nm s/rad)",
            "hand stiffness (Nm/rad)",
            "hand shake frequency (Hz)",
            "delay (s)",
            "amplifier time constant (s)",
            "torque step (Nm)",
        ]
        .into_iter()
        .enumerate()
        {
            let value = |i| if i == field { bad } else { 0.0 };
            let hand = Hand {
                inertia_kg_m2: value(0),
                damping_nm_s_rad: value(1),
                stiffness_nm_rad: value(2),
                shake_hz: value(3),
                ..no_hand
            };
            let drive = Drive {
                delay_s: value(4),
                amplifier_tau_s: value(5),
                torque_step_nm: value(6),
            };
            assert_eq!(
                refused(&good, &hand, &drive, 1.0, start),
                format!("{name} is {bad}; accepted: a finite number, 0 or more")
            );
        }
    }
    for bad in [f64::NAN, f64::NEG_INFINITY] {
        let finite = |name: &str| format!("{name} is {bad}; accepted: a finite number");
        for (rest_rad, push_nm, shake_nm, name) in [
            (bad, 0.0, 0.0, "hand rest angle (rad)"),
            (0.0, bad, 0.0, "hand push (Nm)"),
            (0.0, 0.0, bad, "hand shake (Nm)"),
        ] {
            let hand = Hand {
                rest_rad,
                push_nm,
                shake_nm,
                ..no_hand
            };
            assert_eq!(refused(&good, &hand, &ideal, 1.0, start), finite(name));
        }
        assert_eq!(
            refused(&good, &no_hand, &ideal, 1.0, at(bad, 0.0)),
            finite("start angle (rad)")
        );
        assert_eq!(
            refused(&good, &no_hand, &ideal, 1.0, at(0.0, bad)),
            finite("start velocity (rad/s)")
        );
    }
    assert_eq!(
        refused(&good, &no_hand, &ideal, 0.0, start),
        "sample period (s) is 0; accepted: a finite number above 0"
    );
    let uneven = |cogging_nm, cogging_per_rev, stiction_nm, stribeck_rad_s| {
        let motor = Motor {
            cogging_nm,
            cogging_per_rev,
            stiction_nm,
            stribeck_rad_s,
        };
        Knob::new(&good, &motor, &no_hand, &ideal, 1.0, start)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        uneven(-1.0, 0.0, 0.0, 0.0),
        "cogging (Nm) is -1; accepted: a finite number, 0 or more"
    );
    assert_eq!(
        uneven(0.0, 0.0, f64::NAN, 0.0),
        "stiction (Nm) is NaN; accepted: a finite number, 0 or more"
    );
    assert_eq!(
        uneven(0.1, 0.0, 0.0, 0.0),
        "cogging periods in a turn is 0; accepted: a finite number above 0"
    );
    assert_eq!(
        uneven(0.0, 0.0, 0.1, 0.0),
        "Stribeck velocity (rad/s) is 0; accepted: a finite number above 0"
    );
    assert_eq!(
        uneven(0.1, 2e4, 0.0, 0.0),
        "cogging periods in a turn is 20000; accepted: up to 10000, far beyond any motor"
    );
    let late = Drive {
        delay_s: 1.5,
        ..ideal
    };
    assert_eq!(
        refused(&good, &no_hand, &late, 1e-3, start),
        "delay (s) is 1.5; accepted: up to 1, 1000 sample periods"
    );
    let fast = Hand {
        shake_hz: 10.5,
        ..no_hand
    };
    assert_eq!(
        refused(&good, &fast, &ideal, 1.0, start),
        "hand shake frequency (Hz) is 10.5; accepted: up to 10, 10 turns in a sample period"
    );
    let stiff = Hand {
        stiffness_nm_rad: 4e6,
        ..no_hand
    };
    assert_eq!(
        refused(&good, &stiff, &ideal, 1.0, start),
        "√(hand stiffness / inertia of hand and knob) (rad/s) is 2000; accepted: up to 1000, \
         1000 in a sample period"
    );
}

/// The largest of everything that is accepted still ends, and stays finite.
#[test]
fn extremes_end() {
    let hand = Hand {
        stiffness_nm_rad: 1e6,
        shake_nm: 5.0,
        shake_hz: 10.0,
        ..Hand::default()
    };
    for tau in [1e-300, 1e-6, 0.1, 1.0, 1e6, 1e300] {
        let drive = Drive {
            delay_s: 0.5,
            amplifier_tau_s: tau,
            torque_step_nm: 1e-300,
        };
        let mut knob = knob(&device(0.0, 1e-3), &hand, &drive, at(0.1, 0.0));
        for i in 0..3 {
            let end = knob.hold(f64::from(i), 1.0).end;
            assert!(end.position.is_finite() && end.velocity.is_finite());
        }
    }
}

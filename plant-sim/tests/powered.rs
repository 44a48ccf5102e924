//! Laws of [`plant_sim::powered`]: knob and windings together agree with a fine Runge–Kutta integration and
//! keep energy; switches that are off make none; what can be broken breaks as stated.

use std::f64::consts::TAU;

use control::criterion::Device;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding, Wiring};
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::motor::Motor;
use plant_sim::powered::{EncoderFault, EncoderSetup, Powered, Setup};
use proptest::prelude::*;

const PERIOD_S: f64 = 1.0 / 24e3;
const BUS_V: f64 = 24.0;

fn setup(winding: Winding) -> Setup {
    Setup {
        device: Device {
            inertia_kg_m2: 1e-5,
            viscous_nm_s_rad: 1e-5,
            coulomb_nm: 0.0,
        },
        motor: Motor::default(),
        hand: Hand::default(),
        winding,
        inverter: Inverter::ideal(PERIOD_S),
        sensing: CurrentSensing {
            step_a: 0.02,
            ..CurrentSensing::default()
        },
        supply: Supply::stiff(BUS_V),
        encoder: EncoderSetup {
            counts_per_rev: 8192,
            reversed: false,
            zero_turns: 0.0,
        },
        start: State {
            position: 0.3,
            velocity: 0.0,
        },
    }
}

fn powered(setup: &Setup) -> Powered {
    Powered::new(setup).unwrap()
}

/// Motors for knobs: L/R of 0.1 to 4 ms, 5 mNm/A to 1 Nm/A.
fn motors() -> impl Strategy<Value = ThreePhaseMotor> {
    (
        0.1..15.0f64,
        1e-4..4e-3f64,
        0.5..2.0f64,
        1e-3..3e-2f64,
        1..15_u32,
    )
        .prop_map(
            |(resistance_ohm, time_constant_s, saliency, flux_wb, pole_pairs)| ThreePhaseMotor {
                resistance_ohm,
                d_inductance_h: resistance_ohm * time_constant_s,
                q_inductance_h: saliency * resistance_ohm * time_constant_s,
                flux_wb,
                pole_pairs,
            },
        )
}

fn brushed_motors() -> impl Strategy<Value = BrushedMotor> {
    (0.1..20.0f64, 1e-4..4e-3f64, 5e-3..0.2f64).prop_map(|(resistance_ohm, time_constant_s, k)| {
        BrushedMotor {
            resistance_ohm,
            inductance_h: resistance_ohm * time_constant_s,
            torque_constant_nm_a: k,
        }
    })
}

fn duties() -> impl Strategy<Value = [f64; 3]> {
    [0.3..0.7f64, 0.3..0.7f64, 0.3..0.7f64]
}

fn stored_j(winding: &Winding, [d, q]: [f64; 2]) -> f64 {
    match winding {
        Winding::ThreePhase(motor) => {
            0.75 * (motor.d_inductance_h * d * d + motor.q_inductance_h * q * q)
        }
        Winding::Brushed(motor) => 0.5 * motor.inductance_h * d * d,
    }
}

/// The mean loss in copper while currents go straight from one value to another.
fn copper_w(winding: &Winding, from: [f64; 2], to: [f64; 2]) -> f64 {
    let ohm = match winding {
        Winding::ThreePhase(motor) => 1.5 * motor.resistance_ohm,
        Winding::Brushed(motor) => motor.resistance_ohm,
    };
    let squares = from.iter().zip(to).map(|(a, b)| a * a + a * b + b * b);
    ohm * squares.sum::<f64>() / 3.0
}

/// Knob and windings in one, by classical Runge–Kutta in the rotor's frame: angle, velocity, i_d, i_q.
fn reference(setup: &Setup, duties: [f64; 3], seconds: f64) -> [f64; 4] {
    let Winding::ThreePhase(motor) = setup.winding else {
        panic!("three phases")
    };
    let p = f64::from(motor.pole_pairs);
    let count = TAU / f64::from(setup.encoder.counts_per_rev);
    let [a, b, c] = duties.map(|duty| duty * BUS_V);
    let (alpha, beta) = ((2.0 * a - b - c) / 3.0, (b - c) / 3.0_f64.sqrt());
    let (l_d, l_q) = (motor.d_inductance_h, motor.q_inductance_h);
    let slope = |[x, v, d, q]: [f64; 4]| {
        let theta = p * (x - 0.5 * count) + TAU * setup.encoder.zero_turns;
        let (s, c) = theta.sin_cos();
        let (u_d, u_q) = (alpha * c + beta * s, beta * c - alpha * s);
        let torque = 1.5 * p * (motor.flux_wb + (l_d - l_q) * d) * q;
        [
            v,
            (torque - setup.device.viscous_nm_s_rad * v) / setup.device.inertia_kg_m2,
            (u_d - motor.resistance_ohm * d + p * v * l_q * q) / l_d,
            (u_q - motor.resistance_ohm * q - p * v * (l_d * d + motor.flux_wb)) / l_q,
        ]
    };
    let steps = (seconds / PERIOD_S * 60.0).round();
    let h = seconds / steps;
    let mut y = [setup.start.position, setup.start.velocity, 0.0, 0.0];
    let add = |y: [f64; 4], k: [f64; 4], f: f64| std::array::from_fn(|i| y[i] + f * k[i]);
    for _ in 0..steps as u64 {
        let k1 = slope(y);
        let k2 = slope(add(y, k1, h / 2.0));
        let k3 = slope(add(y, k2, h / 2.0));
        let k4 = slope(add(y, k3, h));
        for i in 0..4 {
            y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
        }
    }
    y
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Half the period, half the error; at 24 kHz it is below 1 % of the way after 5 ms, in which a motor that
    /// is let go swings to a standing field.
    #[test]
    fn it_goes_to_the_motion_of_the_whole_system_in_proportion_to_the_period(
        motor in motors(), duties in duties(), zero_turns in -1.0..1.0f64, position in -3.0..3.0f64,
    ) {
        let mut setup = setup(Winding::ThreePhase(motor));
        setup.encoder.zero_turns = zero_turns;
        setup.start.position = position;
        // Not faster than 2000 rad/s², and it stays well within a period of the field.
        let most_nm = motor.torque_constant_nm_a() * BUS_V / motor.resistance_ohm;
        setup.device.inertia_kg_m2 = 1e-5 + most_nm / 2e4;
        let exact = reference(&setup, duties, 120.0 * PERIOD_S);
        let error = |parts: u32| {
            let mut setup = setup;
            setup.inverter.pwm_period_s = PERIOD_S / f64::from(parts);
            let mut knob = powered(&setup);
            for _ in 0..120 * parts {
                knob.period(Some(duties));
            }
            knob.state().position - exact[0]
        };
        let way = (exact[0] - position).abs().max(exact[1].abs() * 120.0 * PERIOD_S);
        let [whole, half, quarter] = [1, 2, 4].map(error);
        prop_assert!(whole.abs() < 0.01 * way + 1e-9, "{whole} of {way}");
        // Richardson's: of first order.
        prop_assert!(((whole - half) - 2.0 * (half - quarter)).abs() < 2e-4 * way + 1e-12, "{whole} {half} {quarter} of {way}");
        prop_assert!((2.0 * quarter - half).abs() < 2e-4 * way + 1e-12, "{whole} {half} {quarter} of {way}");
    }

    /// Bus, copper, inductance and shaft: what is drawn is all there. The shaft gets what the windings give at the
    /// speed of a period's start, but for the speed that it gains in it.
    #[test]
    fn energy_is_kept_on_its_way_from_the_bus_to_the_shaft(
        motor in motors(), duties in prop::collection::vec(prop::option::weighted(0.7, duties()), 1..30),
        open in prop::option::of(0..3_usize), velocity in -30.0..30.0f64,
    ) {
        let winding = Winding::ThreePhase(motor);
        let mut setup = setup(winding);
        // 200 periods in the least time constant: currents go nearly straight.
        setup.inverter.pwm_period_s = 5e-3 * motor.d_inductance_h.min(motor.q_inductance_h) / motor.resistance_ohm;
        setup.start.velocity = velocity;
        setup.device.inertia_kg_m2 = 1e-4;
        let mut knob = powered(&setup);
        knob.wire(Wiring { open, ..Wiring::default() }).unwrap();
        let (mut drawn, mut work, mut copper, mut turnover) = (0.0, 0.0, 0.0, 0.0);
        // Of currents that do not go straight, in periods within which a current ends.
        let mut unsure = 0.0;
        let carrying = |knob: &Powered| knob.phase_currents().map(|current| current != 0.0);
        for bridge in duties {
            for _ in 0..60 {
                let before = knob.electrical().rotor_currents();
                let (start, carried) = (knob.state().velocity, carrying(&knob));
                let turned = knob.period(bridge);
                let given = turned.electrical.torque_nm * start * setup.inverter.pwm_period_s;
                let gained = (knob.state().velocity - start).abs() * setup.inverter.pwm_period_s;
                let off = (turned.mechanical.motor_work_j - given).abs();
                prop_assert!(off <= turned.electrical.torque_nm.abs() * gained * 1.001 + 1e-12, "{off}");
                let after = knob.electrical().rotor_currents();
                copper += copper_w(&winding, before, after) * setup.inverter.pwm_period_s;
                if bridge.is_none() && carrying(&knob) != carried {
                    unsure += copper_w(&winding, before, before) * setup.inverter.pwm_period_s;
                }
                drawn += turned.electrical.drawn_j;
                work += given;
                turnover += turned.electrical.drawn_j.abs() + given.abs();
            }
        }
        let stored = stored_j(&winding, knob.electrical().rotor_currents());
        let missing = drawn - work - copper - stored;
        prop_assert!(missing.abs() <= 2e-4 * (turnover + copper) + unsure, "{missing}: {drawn} {work} {copper} {stored}");
    }

    /// Switches that are off: nothing is drawn from the bus, no phase's current reverses or comes back, and
    /// when they have ended there is exactly none.
    #[test]
    fn off_makes_no_energy_and_turns_no_current_round(
        motor in motors(), duties in duties(), position in -3.0..3.0f64, speed in -0.9..0.9f64,
        open in prop::option::of(0..3_usize), periods in 1..200_u32,
    ) {
        let winding = Winding::ThreePhase(motor);
        let mut setup = setup(winding);
        // Between two phases the back-EMF is below the bus.
        let fastest = BUS_V / 3.0_f64.sqrt() / (motor.flux_wb * f64::from(motor.pole_pairs));
        setup.start = State { position, velocity: speed * fastest.min(300.0) };
        setup.device.inertia_kg_m2 = 10.0;
        let mut knob = powered(&setup);
        knob.wire(Wiring { open, ..Wiring::default() }).unwrap();
        for _ in 0..periods {
            knob.period(Some(duties));
        }
        let mut before = knob.phase_currents();
        let mut stored = stored_j(&winding, knob.electrical().rotor_currents());
        let mut ended = 0;
        for _ in 0..4_000 {
            let turned = knob.period(None);
            let after = knob.phase_currents();
            prop_assert!(turned.electrical.drawn_j <= 0.0, "{turned:?}");
            for (before, after) in before.iter().zip(after) {
                prop_assert!(before * after >= 0.0, "{before} {after}");
                prop_assert!(*before != 0.0 || after == 0.0, "{after}");
            }
            let now = stored_j(&winding, knob.electrical().rotor_currents());
            let lost = stored - now + turned.electrical.drawn_j
                - turned.electrical.torque_nm * setup.start.velocity * PERIOD_S;
            // The speed varies by little under ten kg m².
            prop_assert!(lost >= -1e-5 * (stored + turned.electrical.drawn_j.abs()) - 1e-15, "{lost} of {stored}");
            (before, stored) = (after, now);
            if after == [0.0; 3] {
                ended += 1;
                prop_assert!(ended < 2 || turned.electrical.torque_nm == 0.0 && turned.electrical.drawn_j == 0.0);
            }
        }
        prop_assert!(ended > 0, "{before:?}");
    }

    /// An open phase carries nothing, whatever the bridge does and however the phases are swapped.
    #[test]
    fn an_open_phase_carries_exactly_nothing(
        motor in motors(), bridges in prop::collection::vec(prop::option::of(duties()), 1..30),
        open in 0..3_usize, order in Just([0, 1, 2_usize]).prop_shuffle(), velocity in -100.0..100.0f64, cut_at in 0..20_usize,
    ) {
        let mut setup = setup(Winding::ThreePhase(motor));
        setup.start.velocity = velocity;
        let mut knob = powered(&setup);
        for (k, bridge) in bridges.into_iter().enumerate() {
            if k == cut_at {
                knob.wire(Wiring { terminals: order, open: Some(open) }).unwrap();
            }
            knob.period(bridge);
            let currents = knob.phase_currents();
            if k >= cut_at {
                prop_assert!(currents[open] == 0.0, "{currents:?}");
            }
            let sum: f64 = currents.iter().sum();
            prop_assert!(sum.abs() < 1e-9 * (1.0 + currents[1].abs()), "{currents:?}");
        }
    }

    /// Without saliency each phase is L i' = u − u_neutral − e − R i: the same by Euler's rule in tiny steps,
    /// with a phase open, and with all switches off.
    #[test]
    fn open_and_off_agree_with_the_phases_own_equations(
        motor in motors(), duties in duties(), open in prop::option::of(0..3_usize), speed in -0.5..0.5f64,
        on in 1..8_u32,
    ) {
        let inductance = motor.d_inductance_h;
        let motor = ThreePhaseMotor { q_inductance_h: inductance, ..motor };
        let p = f64::from(motor.pole_pairs);
        // A third of the bus between neutral and phase at most: no phase conducts again.
        let fastest = (BUS_V / 3.0 / (motor.flux_wb * p)).min(300.0);
        let mut setup = setup(Winding::ThreePhase(motor));
        setup.start.velocity = speed * fastest;
        setup.device.inertia_kg_m2 = 1e3;
        setup.device.viscous_nm_s_rad = 0.0;
        let mut knob = powered(&setup);
        knob.wire(Wiring { open, ..Wiring::default() }).unwrap();
        let omega = p * setup.start.velocity;
        let mut angle = p * (setup.start.position - 0.5 * TAU / 8192.0);
        let mut currents = [0.0_f64; 3];
        let steps = 4_000;
        let h = PERIOD_S / f64::from(steps);
        let scale = BUS_V * PERIOD_S / inductance;
        for k in 0..on + 3 {
            let bridge = (k < on).then_some(duties);
            knob.period(bridge);
            let was = currents;
            for _ in 0..steps {
                let carries: [bool; 3] = std::array::from_fn(|k| match bridge {
                    Some(_) => open != Some(k),
                    None => currents[k] != 0.0,
                });
                let driven: [f64; 3] = std::array::from_fn(|k| {
                    let volts = match bridge {
                        Some(duties) => duties[k] * BUS_V,
                        None => if currents[k] < 0.0 { BUS_V } else { 0.0 },
                    };
                    // The flux of phase k is ψ cos(θ − k·120°).
                    volts + omega * motor.flux_wb * (angle - k as f64 * TAU / 3.0).sin()
                });
                let count = carries.iter().filter(|&&is| is).count().max(1) as f64;
                let neutral = (0..3).filter(|&k| carries[k]).map(|k| driven[k]).sum::<f64>() / count;
                let before = currents;
                for k in (0..3).filter(|&k| carries[k]) {
                    currents[k] += h / inductance * (driven[k] - neutral - motor.resistance_ohm * currents[k]);
                    if bridge.is_none() && before[k] * currents[k] <= 0.0 {
                        currents[k] = 0.0;
                    }
                }
                // The others share what a phase that ended had left.
                let left: Vec<usize> = (0..3).filter(|&k| currents[k] != 0.0).collect();
                let rest = currents.iter().sum::<f64>() / left.len().max(1) as f64;
                for &k in &left {
                    currents[k] -= rest;
                }
                if left.len() < 2 {
                    currents = [0.0; 3];
                }
                angle += omega * h;
            }
            for (ours, theirs) in knob.phase_currents().iter().zip(currents) {
                prop_assert!((ours - theirs).abs() < 3e-3 * scale, "{ours} {theirs} of {scale}, {was:?}");
            }
        }
    }

    /// A brushed motor's current ends at L/R·ln(1 + R i/(bus + k·speed)).
    #[test]
    fn a_brushed_motor_that_is_let_go_stops_its_current_when_it_should(
        motor in brushed_motors(), b in 0.5..0.9f64, speed in -0.5..0.5f64,
    ) {
        let mut setup = setup(Winding::Brushed(motor));
        setup.start.velocity = speed * (BUS_V / motor.torque_constant_nm_a).min(300.0);
        setup.device = Device { inertia_kg_m2: 1e9, viscous_nm_s_rad: 0.0, coulomb_nm: 0.0 };
        let mut knob = powered(&setup);
        for _ in 0..40 {
            knob.period(Some([0.5, b, 1.0 - b]));
        }
        let start = knob.phase_currents()[1];
        let emf = motor.torque_constant_nm_a * setup.start.velocity * start.signum();
        let (r, l) = (motor.resistance_ohm, motor.inductance_h);
        let ends_s = l / r * (r * start.abs() / (BUS_V + emf)).ln_1p();
        let charge = (l * start.abs() - ends_s * (BUS_V + emf)) / r;
        let periods = (ends_s / PERIOD_S).ceil() as usize;
        let mut impulse = 0.0;
        for k in 0..periods + 2 {
            let torque = knob.period(None).electrical.torque_nm;
            impulse += torque * PERIOD_S;
            prop_assert!(k < periods || torque == 0.0);
            let elapsed = (k as f64 + 1.0) * PERIOD_S;
            let exact = if elapsed < ends_s {
                (start.abs() + (BUS_V + emf) / r) * (-elapsed * r / l).exp() - (BUS_V + emf) / r
            } else { 0.0 };
            prop_assert!((knob.phase_currents()[1].abs() - exact).abs() < 1e-9 * start.abs());
        }
        let exact = motor.torque_constant_nm_a * charge * start.signum();
        prop_assert!((impulse - exact).abs() < 1e-5 * motor.torque_constant_nm_a * start.abs() * ends_s, "{impulse} {exact}");
    }

    /// Swapped phases are swapped: what the bridge does to them in the other order comes to the same.
    #[test]
    fn swapped_phases_are_swapped(
        motor in motors(), bridges in prop::collection::vec(duties(), 1..20), order in Just([0, 1, 2_usize]).prop_shuffle(),
    ) {
        let setup = setup(Winding::ThreePhase(motor));
        let (mut straight, mut swapped) = (powered(&setup), powered(&setup));
        swapped.wire(Wiring { terminals: [order[0], order[1], order[2]], open: None }).unwrap();
        for duties in bridges {
            straight.period(Some(duties));
            swapped.period(Some(std::array::from_fn(|phase| duties[order[phase]])));
            prop_assert_eq!(straight.state(), swapped.state());
            let (ours, theirs) = (swapped.phase_currents(), straight.phase_currents());
            prop_assert_eq!(ours, std::array::from_fn(|phase| theirs[order[phase]]));
        }
    }

    /// Under a standing field along phase A the rotor comes to rest at electrical angle 0, which is where the
    /// encoder says.
    #[test]
    fn the_encoder_sits_where_it_was_set(
        motor in motors(), zero_turns in -1.0..1.0f64, position in -3.0..3.0f64, reversed in any::<bool>(),
    ) {
        // Saliency and a large current would hold it the other way round too.
        let motor = ThreePhaseMotor { q_inductance_h: motor.d_inductance_h, ..motor };
        let mut setup = setup(Winding::ThreePhase(motor));
        setup.encoder = EncoderSetup { counts_per_rev: 65_536, reversed, zero_turns };
        setup.start.position = position;
        let p = f64::from(motor.pole_pairs);
        // Damped as much as the field's spring asks for.
        let volts = 4.0;
        let spring = motor.torque_constant_nm_a() * volts / motor.resistance_ohm * p;
        setup.device.inertia_kg_m2 = spring / 1e4;
        setup.device.viscous_nm_s_rad = 2.0 * spring / 100.0;
        let mut knob = powered(&setup);
        let duty = 0.5 + volts / BUS_V;
        for _ in 0..12_000 {
            knob.period(Some([duty, 0.5 - 0.5 * volts / BUS_V, 0.5 - 0.5 * volts / BUS_V]));
        }
        let counter = f64::from(knob.sensed().counter.cast_signed());
        let count = if reversed { -counter } else { counter };
        let angle = p * count / 65_536.0 + zero_turns;
        let off = (angle + 0.5).rem_euclid(1.0) - 0.5;
        // A start on top of the hill takes long.
        let start = p * (position / TAU - 0.5 / 65_536.0) + zero_turns;
        prop_assume!(((start + 0.5).rem_euclid(1.0) - 0.5).abs() < 0.45);
        prop_assert!(off.abs() < 0.51 * p / 65_536.0 + 1e-4, "{off}");
    }
}

const RE35: BrushedMotor = BrushedMotor {
    resistance_ohm: 2.0,
    inductance_h: 6e-4,
    torque_constant_nm_a: 0.052,
};

/// A brushed motor between A and B is one between B and C for a bridge that is shifted.
#[test]
fn a_brushed_motor_on_the_wrong_terminals_is_measured_on_one_converter() {
    let setup = setup(Winding::Brushed(RE35));
    let (mut right, mut wrong) = (powered(&setup), powered(&setup));
    let wiring = Wiring {
        terminals: [1, 2, 0],
        open: None,
    };
    wrong.wire(wiring).unwrap();
    for _ in 0..100 {
        right.period(Some([0.5, 0.6, 0.4]));
        wrong.period(Some([0.6, 0.4, 0.5]));
    }
    let current = right.phase_currents()[1];
    assert!(current > 0.5);
    assert_eq!(right.phase_currents(), [0.0, current, -current]);
    assert_eq!(wrong.phase_currents(), [current, -current, 0.0]);
    assert_eq!(right.state(), wrong.state());
    let codes = wrong.sensed().codes;
    assert!(codes[0] < 2_048 - 20 && codes[1] == 2_048, "{codes:?}");
}

#[test]
fn a_brushed_motor_needs_both_its_ends_and_not_a() {
    let setup = setup(Winding::Brushed(RE35));
    for (open, moves) in [(0, true), (1, false), (2, false)] {
        let mut knob = powered(&setup);
        let wiring = Wiring {
            open: Some(open),
            ..Wiring::default()
        };
        knob.wire(wiring).unwrap();
        for _ in 0..100 {
            knob.period(Some([0.5, 0.6, 0.4]));
        }
        assert_eq!(knob.state().velocity != 0.0, moves);
        assert_eq!(knob.phase_currents() != [0.0; 3], moves);
    }
}

#[test]
fn a_wiring_that_is_none_is_refused() {
    let mut knob = powered(&setup(Winding::Brushed(RE35)));
    for (terminals, open) in [([0, 0, 1], None), ([0, 1, 3], None), ([0, 1, 2], Some(3))] {
        assert!(knob.wire(Wiring { terminals, open }).is_err());
    }
}

#[test]
fn what_was_decided_acts_a_period_later_unless_it_is_cut() {
    let mut setup = setup(Winding::Brushed(RE35));
    setup.inverter.late = true;
    let on = Some([0.5, 0.8, 0.2]);
    let mut knob = powered(&setup);
    assert_eq!(knob.period(on).electrical.torque_nm, 0.0);
    assert!(knob.period(None).electrical.torque_nm > 0.0);
    let rising = knob.electrical().torque_nm();
    knob.period(None);
    assert!(knob.electrical().torque_nm() < rising);
    knob.period(on);
    knob.cut();
    let left = knob.electrical().torque_nm();
    knob.period(on);
    assert!(knob.electrical().torque_nm() <= left);
}

#[test]
fn codes_count_from_the_middle_saturate_and_stick() {
    let mut setup = setup(Winding::Brushed(RE35));
    setup.sensing.offset_a = [0.2, -0.1];
    let mut knob = powered(&setup);
    assert_eq!(knob.sensed().codes, [2_058, 2_043]);
    // 24 V on 2 Ω, held.
    setup.device.inertia_kg_m2 = 1e6;
    let mut knob = powered(&setup);
    for _ in 0..2_000 {
        knob.period(Some([0.0, 1.0, 0.0]));
    }
    assert_eq!(knob.sensed().codes, [2_048 + 610, 2_048 - 605]);
    knob.stick([None, Some(17)]);
    assert_eq!(knob.sensed().codes, [2_048 + 610, 17]);
    setup.sensing.step_a = 1e-3;
    let mut knob = powered(&setup);
    for _ in 0..2_000 {
        knob.period(Some([0.0, 1.0, 0.0]));
    }
    assert_eq!(knob.sensed().codes, [4_095, 0]);
}

/// A knob at 20 rad/s and its counter after every period.
fn counters(setup: &Setup, spoil: impl Fn(&mut Powered, u32)) -> Vec<i64> {
    let mut knob = powered(setup);
    (0..3_000)
        .map(|k| {
            spoil(&mut knob, k);
            knob.period(None);
            i64::from(knob.sensed().counter.cast_signed())
        })
        .collect()
}

#[test]
fn an_encoder_fails_as_stated_and_goes_on_from_where_it_stands() {
    let mut setup = setup(Winding::Brushed(RE35));
    setup.device.viscous_nm_s_rad = 0.0;
    setup.start.velocity = 20.0;
    let counts_per_period = 20.0 * PERIOD_S / TAU * 8192.0;
    let good = counters(&setup, |_, _| {});
    assert_eq!(good[0], ((0.3 + 20.0 * PERIOD_S) / TAU * 8192.0) as i64);
    let between = |from: i64, to: i64, share: f64, periods: f64| {
        let counts = share * counts_per_period * periods;
        assert!(
            ((to - from) as f64 - counts).abs() < 1.5,
            "{from} {to} {counts}"
        );
    };
    between(good[0], good[2_999], 1.0, 2_999.0);

    for fault in [
        EncoderFault::Stuck,
        EncoderFault::DeadChannel,
        EncoderFault::Slipping { follows: 0.25 },
    ] {
        let bad = counters(&setup, |knob, k| match k {
            1_000 => knob.fault_encoder(Some(fault)),
            2_000 => knob.fault_encoder(None),
            _ => (),
        });
        assert_eq!(bad[..1_000], good[..1_000]);
        let during = &bad[1_000..2_000];
        let (least, most) = (during.iter().min().unwrap(), during.iter().max().unwrap());
        match fault {
            EncoderFault::Stuck => assert!(most == least && *most == bad[999]),
            EncoderFault::DeadChannel => {
                assert_eq!(most - least, 1);
                let toggles = during.windows(2).filter(|two| two[0] != two[1]).count();
                // Every other count is an edge of A.
                let edges = 0.5 * counts_per_period * 1_000.0;
                assert!((toggles as f64 - edges).abs() < 3.0, "{toggles} {edges}");
            }
            EncoderFault::Slipping { follows } => {
                between(bad[1_000], bad[1_999], follows, 999.0);
            }
        }
        between(bad[1_999], bad[2_999], 1.0, 1_000.0);
    }

    let slipped = counters(&setup, |knob, k| {
        if k == 500 {
            knob.slip(-37);
        }
    });
    assert_eq!(slipped[..500], good[..500]);
    assert!(
        slipped
            .iter()
            .zip(&good)
            .skip(500)
            .all(|(bad, good)| bad + 37 == *good)
    );

    setup.encoder.reversed = true;
    let reversed = counters(&setup, |_, _| {});
    assert!(reversed.iter().zip(&good).all(|(bad, good)| -bad == *good));
}

#[test]
fn a_setup_that_is_none_is_refused() {
    let good = setup(Winding::Brushed(RE35));
    let mut bad = [good; 4];
    bad[0].sensing.step_a = 0.0;
    bad[1].encoder.counts_per_rev = 0;
    bad[2].encoder.zero_turns = f64::NAN;
    bad[3].inverter.pwm_period_s = 0.0;
    for setup in bad {
        assert!(Powered::new(&setup).is_err(), "{setup:?}");
    }
}

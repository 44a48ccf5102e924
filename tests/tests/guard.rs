//! The supervision by itself: each limit where it is said to be, and each count in a row; and what the current tick
//! does around it.

use acceptance::powered_twin::{NativeBench, all_of, example_motor, knob, sensed};
use control::criterion::Device;
use control::torque::sense::PhaseCurrents;
use firmware::guard::{Guard, Limits, OFF_PERIODS, OFFSET_A, Seen};
use firmware::power::{Bridge, ODRIVE_V3_24V};
use plant_sim::hold::State;
use proptest::prelude::*;
use protocol::{Changes, Drive, Fault, Law, Motor, Request};

/// The name of a fault.
fn kind(fault: Option<Fault>) -> &'static str {
    match fault {
        None => "none",
        Some(Fault::OverCurrent { .. }) => "over-current",
        Some(Fault::CurrentSense) => "current-sense",
        Some(Fault::OverVoltage { .. }) => "over-voltage",
        Some(Fault::UnderVoltage { .. }) => "under-voltage",
        Some(Fault::EncoderJump { .. }) => "encoder-jump",
        Some(Fault::OverSpeed { .. }) => "over-speed",
        Some(Fault::Encoder) => "encoder",
        Some(other) => panic!("not the guard's: {other:?}"),
    }
}

fn motors() -> impl Strategy<Value = Motor> {
    (
        prop_oneof![
            Just(Drive::Current),
            Just(Drive::Voltage),
            Just(Drive::Brushed)
        ],
        0.5..15.0f32,
        0.1..10.0f32,
        0.01..0.2f32,
    )
        .prop_map(|(drive, current, resistance, constant)| Motor {
            current_max_a: current,
            resistance_ohm: resistance,
            torque_constant_nm_a: constant,
            ..example_motor(drive)
        })
}

/// What is seen of a healthy motor.
const WELL: Seen = Seen {
    currents: PhaseCurrents { b_a: 0.0, c_a: 0.0 },
    bus_v: 24.0,
    moved: 0,
    speed_rad_s: 0.0,
    unexplained_v: 0.0,
    active: true,
};

/// One value that is a part above its limit, or below where the part is negative; the fault, and in how many periods in a
/// row.
fn beyond(motor: &Motor, which: u32, part: f32) -> Option<(Seen, &'static str, u32)> {
    let brushed = motor.drive == Drive::Brushed;
    let scale = 1.0 + part;
    let trip_a = (1.5 * motor.current_max_a + 2.0) * scale;
    let currents = |b_a, c_a| Seen {
        currents: PhaseCurrents { b_a, c_a },
        ..WELL
    };
    let bus = |bus_v| Seen { bus_v, ..WELL };
    let way = 300.0 / 24e3 * 8192.0 / std::f32::consts::TAU;
    let most = (2.0 * way) as i32 + 2;
    let emf = if brushed { 1.0 } else { 1.0 / 1.5 } * motor.torque_constant_nm_a;
    let speed_rad_s = 100.0;
    let needed_v = 0.5 + motor.resistance_ohm + 0.3 * emf * speed_rad_s;
    Some(match which {
        0 => (currents(trip_a, -trip_a), "over-current", 2),
        1 => (currents(-trip_a, trip_a), "over-current", 2),
        2 if !brushed => (currents(trip_a, 0.0), "over-current", 2),
        3 if !brushed => (currents(0.5 * trip_a, 0.5 * trip_a), "over-current", 2),
        2 | 3 => {
            let sum_a = (2.0 + 0.15 * (1.5 * motor.current_max_a + 2.0)) * scale;
            let at_b = if which == 2 { 1.0 } else { 0.5 };
            let seen = currents(at_b * sum_a, (1.0 - at_b) * sum_a);
            (seen, "current-sense", 4)
        }
        4 => (bus(25.68 * scale), "over-voltage", 4),
        5 => (bus(8.0 * (1.0 - part)), "under-voltage", 24),
        6 => {
            let moved = if part > 0.0 { most + 1 } else { most };
            (Seen { moved, ..WELL }, "encoder-jump", 1)
        }
        7 => {
            let speed_rad_s = -300.0 * scale;
            (
                Seen {
                    speed_rad_s,
                    ..WELL
                },
                "over-speed",
                1,
            )
        }
        8 => {
            let unexplained_v = needed_v * scale;
            let seen = Seen {
                unexplained_v,
                speed_rad_s,
                ..WELL
            };
            (seen, "encoder", 96)
        }
        _ => return None,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3_000))]

    /// A thousandth below its limit nothing is ever found; a thousandth above, after exactly so many periods in a row.
    #[test]
    fn each_limit_trips_after_exactly_so_many_periods_in_a_row(motor in motors(), which in 0..9_u32, rounds in 1..5_u32) {
        let limits = Limits::new(&motor, 8192, 300.0, &ODRIVE_V3_24V);
        let (below, ..) = beyond(&motor, which, -1e-3).unwrap();
        let (above, fault, periods) = beyond(&motor, which, 1e-3).unwrap();
        let mut guard = Guard::new();
        for _ in 0..300 {
            prop_assert_eq!(kind(guard.look(&limits, &below)), "none", "below");
        }
        for _ in 0..rounds {
            for _ in 1..periods {
                prop_assert_eq!(kind(guard.look(&limits, &above)), "none", "too soon");
            }
            // What is counted in a row begins anew; what is counted down goes down as far.
            let between = if which == 8 { periods - 1 } else { 1 };
            for _ in 0..between {
                prop_assert_eq!(kind(guard.look(&limits, &below)), "none");
            }
        }
        for _ in 1..periods {
            prop_assert_eq!(kind(guard.look(&limits, &above)), "none");
        }
        prop_assert_eq!(kind(guard.look(&limits, &above)), fault);
    }

    /// A bus that is bad bars clearing and arming, as soon as it counts and no longer than it is.
    #[test]
    fn a_bad_bus_bars_clearing_while_it_stands(motor in motors(), way in 0..3_u32, active in any::<bool>(), measuring in any::<bool>()) {
        let limits = Limits::new(&motor, 8192, 300.0, &ODRIVE_V3_24V);
        let (bus_v, periods, fault) = [(25.7, 4, "over-voltage"), (f32::NAN, 4, "over-voltage"), (7.9, 24, "under-voltage")][way as usize];
        let mut guard = Guard::new();
        let look = |guard: &mut Guard, bus_v| if measuring {
            guard.look_at_bus(&limits, bus_v)
        } else {
            guard.look(&limits, &Seen { bus_v, active, ..WELL })
        };
        for period in 1..100 {
            let found = look(&mut guard, bus_v);
            let stands = if period >= periods { fault } else { "none" };
            prop_assert_eq!(kind(guard.against_clearing()), stands);
            prop_assert_eq!(kind(guard.against_arming(&limits)), stands);
            prop_assert_eq!(kind(found), if active || measuring { stands } else { "none" });
        }
        look(&mut guard, 24.0);
        prop_assert_eq!(kind(guard.against_clearing()), "none");
        prop_assert_eq!(kind(guard.against_arming(&limits)), "none");
    }

    /// The mean of a current that flows while the bridge is off bars arming, either way, in either converter.
    #[test]
    fn a_moved_offset_bars_arming_once_the_bridge_was_off_for_a_while(motor in motors(), share in 0.0..2.0f32, sign in any::<bool>(), at_b in any::<bool>()) {
        prop_assume!((share - 1.0).abs() > 0.01);
        let limits = Limits::new(&motor, 8192, 300.0, &ODRIVE_V3_24V);
        let current = if sign { OFFSET_A } else { -OFFSET_A } * share;
        let currents = if at_b { PhaseCurrents { b_a: current, c_a: 0.0 } } else { PhaseCurrents { b_a: 0.0, c_a: current } };
        let mut guard = Guard::new();
        for _ in 0..3 {
            for _ in 0..OFF_PERIODS {
                prop_assert_eq!(guard.look(&limits, &Seen { active: false, currents, ..WELL }), None);
                prop_assert_eq!(guard.against_arming(&limits), None);
            }
            for _ in 0..3_000 {
                let _ = guard.look(&limits, &Seen { active: false, currents, ..WELL });
            }
            let bars = guard.against_arming(&limits) == Some(Fault::CurrentSense);
            prop_assert_eq!(bars, share > 1.0);
            prop_assert_eq!(guard.against_clearing(), None);
            let _ = guard.look(&limits, &WELL);
            prop_assert_eq!(guard.look(&limits, &Seen { active: false, ..WELL }), None);
        }
    }
}

/// What is held, whatever the motor does.
const STUCK: Device<f64> = Device {
    inertia_kg_m2: 0.8,
    viscous_nm_s_rad: 0.0,
    coulomb_nm: 10.0,
};

/// At rest, thrown slowly enough to pass its zero where torque begins.
fn held(drive: Drive) -> NativeBench {
    let motor = example_motor(drive);
    let start = State {
        position: 0.0,
        velocity: -1.1,
    };
    let mut bench = NativeBench::new(&knob(&motor, 8192, STUCK, start));
    bench.must(Request::SetMotor(all_of(&motor)));
    bench.must(Request::Set(Changes {
        law: Some(Law::Raw),
        stiffness_nm_rad: Some(10.0),
        torque_max_nm: Some(10.0),
        centre_rad: Some(-44e-3),
        ..Changes::default()
    }));
    bench
}

/// Duties of the next period; a `step` of the count is added for it alone.
fn next(bench: &mut NativeBench, step: u32) -> Option<[f32; 3]> {
    let mut read = sensed(&bench.knob.sensed());
    read.counter = read.counter.wrapping_add(step) & 0xFFFF;
    let bridge = bench.twin.period(&read, false, false);
    let duties = match bridge {
        Bridge::Off => None,
        Bridge::On(duties) => Some(duties.parts()),
    };
    bench.knob.period(duties.map(|parts| parts.map(f64::from)));
    duties
}

/// What is put on the windings, in parts of the bus: a motor with brushes has nothing at A.
fn spread(drive: Drive, [a, b, c]: [f32; 3]) -> f32 {
    if drive == Drive::Brushed {
        return (b - c).abs();
    }
    a.max(b).max(c) - a.min(b).min(c)
}

/// What a loop had gathered is not let loose when it is armed anew, with a limit of 0 at first.
#[test]
fn a_drive_that_was_off_begins_from_nothing() {
    for drive in [Drive::Current, Drive::Brushed] {
        let mut bench = held(drive);
        bench.must(Request::Arm);
        let mut loudest = 0.0_f32;
        for _ in 0..8_000 {
            loudest = loudest.max(spread(drive, next(&mut bench, 0).expect("on")));
        }
        assert!(loudest > 0.05, "{drive:?}: {loudest}");
        bench.must(Request::Disarm);
        for _ in 0..1_000 {
            assert_eq!(next(&mut bench, 0), None);
        }
        bench.must(Request::Arm);
        let first = spread(drive, next(&mut bench, 0).expect("on"));
        assert!(first < 0.01, "{drive:?}: {first}, {loudest} before");
    }
}

/// A knob that creeps from one count to the next has no speed yet: no back-EMF is made up for.
#[test]
fn a_single_count_is_no_speed() {
    let mut bench = held(Drive::Voltage);
    bench.must(Request::Set(Changes {
        torque_max_nm: Some(0.0),
        ..Changes::default()
    }));
    for _ in 0..6_000 {
        next(&mut bench, 0);
    }
    bench.must(Request::Arm);
    for _ in 0..1_000 {
        let [a, b, c] = next(&mut bench, 0).expect("on");
        assert!(a == b && b == c);
    }
    for (step, speed) in [(1, false), (u32::MAX, false), (3, true)] {
        let [a, b, c] = next(&mut bench, step).expect("on");
        assert_eq!(a != b || b != c, speed, "{step} counts: {a} {b} {c}");
        for _ in 0..200 {
            next(&mut bench, 0);
        }
    }
}

//! Every fault of `docs/safety.md`, injected into a powered knob that renders: torque is zero no later than the page
//! says, the fault stays with how things stood, and only the command clears it.

mod powered_rig;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use plant_sim::powered::EncoderFault;
use powered_rig::{Knob, Rig, Told};
use protocol::{
    Changes, Drive, Excitation, ExcitationEnd, Fault, Refusal, Request, ResetReason, Snapshot,
    State,
};

/// PWM periods of the page's `n`: those of a haptic tick.
fn periods(expression: &str, n: u32) -> u32 {
    expression
        .split('+')
        .map(|term| match term.trim() {
            "n" => n,
            number => number.parse().expect("a sum of numbers and n"),
        })
        .sum()
}

/// As `knob info` tells it.
fn fault_code(fault: Fault) -> &'static str {
    match fault {
        Fault::Overrun => "overrun",
        Fault::EncoderJump { .. } => "encoder-jump",
        Fault::TorqueNotFinite => "torque-not-finite",
        Fault::CurrentOverrun => "current-overrun",
        Fault::GateDriver => "gate-driver",
        Fault::OverCurrent { .. } => "over-current",
        Fault::CurrentSense => "current-sense",
        Fault::OverVoltage { .. } => "over-voltage",
        Fault::UnderVoltage { .. } => "under-voltage",
        Fault::OverTemperature { .. } => "over-temperature",
        Fault::OverSpeed { .. } => "over-speed",
        Fault::Encoder => "encoder",
        Fault::Guard => "guard",
    }
}

/// A row of the page's table.
#[derive(Debug)]
struct Row {
    fault: String,
    off_within: String,
    tests: Vec<String>,
}

fn page() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/safety.md");
    std::fs::read_to_string(path).expect("docs/safety.md")
}

/// The words between backticks.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(Into::into).collect()
}

/// The table of faults, by the name of what is wrong.
fn table() -> BTreeMap<String, Row> {
    let page = page();
    let rows = page
        .lines()
        .skip_while(|line| !line.starts_with("| what is wrong "))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    rows.map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [what, _, off_within, _, fault, _, tests] = cells[..] else {
            panic!("seven cells, not {}: {line}", cells.len());
        };
        let row = Row {
            fault: quoted(fault).concat(),
            off_within: off_within.into(),
            tests: quoted(tests),
        };
        (quoted(what).concat(), row)
    })
    .collect()
}

/// One way to go wrong.
struct Injection {
    /// As the page names it.
    name: &'static str,
    drives: &'static [Drive],
    fault: fn(Fault) -> bool,
    inject: fn(&mut Rig),
    mend: fn(&mut Rig),
    /// The cause can be seen while the bridge is off, so that it bars the way out.
    bars: bool,
}

const ALL: &[Drive] = &[Drive::Current, Drive::Voltage, Drive::Brushed];
const THREE_PHASES: &[Drive] = &[Drive::Current, Drive::Voltage];
const BRUSHED: &[Drive] = &[Drive::Brushed];

const INJECTIONS: &[Injection] = &[
    Injection {
        name: "current-tick-late",
        drives: ALL,
        fault: |fault| fault == Fault::CurrentOverrun,
        inject: |rig| rig.overran = true,
        mend: |rig| rig.overran = false,
        bars: false,
    },
    Injection {
        name: "gate-driver-line",
        drives: ALL,
        fault: |fault| fault == Fault::GateDriver,
        inject: |rig| {
            rig.gate_line_falls();
            rig.board.gate_driver = Err([0x0422, 0x0001]);
        },
        mend: |rig| rig.board.restart = Ok(()),
        bars: true,
    },
    Injection {
        name: "gate-driver-lost",
        drives: ALL,
        fault: |fault| fault == Fault::GateDriver,
        inject: |rig| rig.board.gate_driver = Err([0, 0]),
        mend: |rig| rig.board.restart = Ok(()),
        bars: true,
    },
    Injection {
        name: "over-current",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverCurrent { current_a } if current_a > 3.0),
        inject: |rig| rig.add_codes = [1500, -1500],
        mend: |rig| rig.add_codes = [0, 0],
        bars: false,
    },
    Injection {
        name: "converter-at-an-end",
        drives: THREE_PHASES,
        fault: |fault| matches!(fault, Fault::OverCurrent { .. }),
        inject: |rig| rig.plant.stick([None, Some(4095)]),
        mend: |rig| rig.plant.stick([None, None]),
        bars: false,
    },
    Injection {
        name: "currents-do-not-add-up",
        drives: BRUSHED,
        fault: |fault| fault == Fault::CurrentSense,
        inject: |rig| rig.plant.stick([None, Some(0)]),
        mend: |rig| rig.plant.stick([None, None]),
        bars: false,
    },
    Injection {
        name: "bus-too-high",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverVoltage { bus_v } if bus_v == 26.5),
        inject: |rig| rig.bus_v = Some(26.5),
        mend: |rig| rig.bus_v = None,
        bars: true,
    },
    Injection {
        name: "bus-no-number",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverVoltage { bus_v } if bus_v.is_nan()),
        inject: |rig| rig.bus_v = Some(f32::NAN),
        mend: |rig| rig.bus_v = None,
        bars: true,
    },
    Injection {
        name: "bus-too-low",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::UnderVoltage { bus_v } if bus_v == 7.5),
        inject: |rig| rig.bus_v = Some(7.5),
        mend: |rig| rig.bus_v = None,
        bars: true,
    },
    Injection {
        name: "too-hot",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverTemperature { temperature_c } if temperature_c == 104.0),
        inject: |rig| rig.board.temperature_c = 104.0,
        mend: |rig| rig.board.temperature_c = 40.0,
        bars: true,
    },
    Injection {
        name: "temperature-unknown",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverTemperature { .. }),
        inject: |rig| {
            rig.board.temperature_c = if rig.random.chance(0.5) {
                f32::NAN
            } else {
                -27.7
            };
        },
        mend: |rig| rig.board.temperature_c = 40.0,
        bars: true,
    },
    Injection {
        name: "slow-task-dead",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverTemperature { temperature_c } if temperature_c.is_nan()),
        inject: |rig| rig.slow_runs = false,
        mend: |rig| rig.slow_runs = true,
        bars: true,
    },
    Injection {
        name: "count-jumps",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::EncoderJump { counts } if counts.abs() > 100),
        inject: |rig| {
            let way = if rig.random.chance(0.5) { 1 } else { -1 };
            rig.plant
                .slip(way * rig.random.between(400.0, 10_000.0) as i32);
        },
        mend: |_| {},
        bars: false,
    },
    Injection {
        name: "too-fast",
        drives: ALL,
        fault: |fault| matches!(fault, Fault::OverSpeed { speed_rad_s } if speed_rad_s.abs() > 300.0),
        inject: |rig| rig.run_away(1.5),
        mend: |rig| rig.add_counts_a_period = 0,
        bars: false,
    },
];

#[test]
fn each_fault_is_off_in_time_and_stays() {
    const MOTORS: u64 = 12;
    let table = table();
    for injection in INJECTIONS {
        let row = &table[injection.name];
        for drive in injection.drives {
            for seed in 0..MOTORS {
                inject(injection, row, *drive, seed);
            }
        }
    }
}

fn inject(injection: &Injection, row: &Row, drive: Drive, seed: u64) {
    let what = format!("{} {drive:?} {seed}", injection.name);
    let mut rig = Rig::armed(drive, seed);
    let moment = rig.random.between(200.0, 6_000.0) as u32;
    rig.run(moment);
    assert_eq!(
        rig.state(),
        State::Armed,
        "{what}: before anything is wrong"
    );
    (injection.inject)(&mut rig);
    let most = periods(&row.off_within, rig.every);
    let took = rig.run_until_off(most + 10);
    assert!(took <= most, "{what}: {took} periods, the page says {most}");
    // The current goes through the diodes against the whole bus.
    let decay = rig.decay_periods();
    let took = rig.run_until_no_torque(1_000);
    assert!(
        took <= decay,
        "{what}: torque for {took} periods, the page says {decay}"
    );
    rig.run(2 * rig.every + 5);

    // Latched, with how things stood.
    let State::Fault(fault) = rig.state() else {
        panic!("{what}: {:?}", rig.state());
    };
    assert!((injection.fault)(fault), "{what}: {fault:?}");
    assert_eq!(fault_code(fault), row.fault, "{what}");
    let snapshot = rig.snapshot().expect("a snapshot");
    // A number that is none differs from itself.
    assert_eq!(
        format!("{:?}", snapshot.fault),
        format!("{fault:?}"),
        "{what}"
    );
    check_snapshot(&rig, &snapshot, &what);

    // Nothing but the command leaves it.
    for request in [Request::Arm, Request::Disarm] {
        let refused = rig.ask(request);
        assert!(
            matches!(refused, Told::Refused(Refusal::State(State::Fault(_)))),
            "{what}: {refused:?}"
        );
    }
    rig.ask(Request::Set(Changes {
        stiffness_nm_rad: Some(0.1),
        ..Changes::default()
    }));
    rig.run(3_000);
    assert!(matches!(rig.state(), State::Fault(_)), "{what}");
    let words = rig.board.gate_driver.err().unwrap_or([0, 0]);
    let later = rig.snapshot().expect("a snapshot");
    assert_eq!(later.gate_driver, words, "{what}");
    assert_eq!(
        (later.tick, later.count),
        (snapshot.tick, snapshot.count),
        "{what}"
    );
    assert_eq!(rig.on_since_off, 0, "{what}: the bridge was on again");
    let cleared = rig.ask(Request::Clear);
    if injection.bars {
        assert!(
            matches!(cleared, Told::Refused(Refusal::State(State::Fault(_)))),
            "{what}: cleared while it stands: {cleared:?}"
        );
        (injection.mend)(&mut rig);
        rig.run(1_500);
        let cleared = rig.ask(Request::Clear);
        assert!(cleared == Told::Done, "{what}: {cleared:?}");
    } else {
        assert!(cleared == Told::Done, "{what}: {cleared:?}");
        (injection.mend)(&mut rig);
    }
    assert_eq!(rig.state(), State::Disarmed, "{what}");
    // It is told on.
    assert!(rig.snapshot().is_some(), "{what}");
    rig.run(1_500);
    let armed = rig.ask(Request::Arm);
    assert!(armed == Told::Done, "{what}: {armed:?}");
}

fn check_snapshot(rig: &Rig, snapshot: &Snapshot, what: &str) {
    let seen = rig.first_off.expect("it went off");
    let [b_a, c_a] = seen.currents_a;
    assert!(
        (f64::from(snapshot.current_b_a) - b_a).abs() < 1e-3,
        "{what}: B {snapshot:?}, {b_a}"
    );
    assert!(
        (f64::from(snapshot.current_c_a) - c_a).abs() < 1e-3,
        "{what}: C {snapshot:?}, {c_a}"
    );
    assert!(
        snapshot.bus_v == seen.bus_v || (snapshot.bus_v.is_nan() && seen.bus_v.is_nan()),
        "{what}: bus {snapshot:?}, {}",
        seen.bus_v
    );
    // The tick that tells of it is the next haptic one.
    let late = snapshot.tick.wrapping_sub(seen.tick);
    assert!(late <= 1, "{what}: told {late} ticks later");
}

/// What a fault leads to while a motor is being measured, beside those of the bus, current and count, which end the
/// measurement and are no fault.
const WHILE_CALIBRATING: &[&str] = &[
    "current-tick-late",
    "gate-driver-line",
    "gate-driver-lost",
    "too-hot",
    "temperature-unknown",
    "slow-task-dead",
];

#[test]
fn each_fault_ends_a_calibration_in_time_and_stays() {
    let table = table();
    for injection in INJECTIONS {
        if !WHILE_CALIBRATING.contains(&injection.name) {
            continue;
        }
        let row = &table[injection.name];
        for drive in ALL {
            for seed in 0..6 {
                let what = format!("{} {drive:?} {seed}", injection.name);
                let mut rig = Rig::calibrating(*drive, seed);
                let moment = rig.random.between(1.0, 2_000.0) as u32;
                rig.run(moment);
                assert_eq!(rig.state(), State::Calibrating, "{what}");
                (injection.inject)(&mut rig);
                let most = periods(&row.off_within, rig.every);
                let took = rig.run_until_off(most + 10);
                assert!(took <= most, "{what}: {took} periods, the page says {most}");
                rig.run(2 * rig.every + 1_500);
                let State::Fault(fault) = rig.state() else {
                    panic!("{what}: {:?}", rig.state());
                };
                assert!((injection.fault)(fault), "{what}: {fault:?}");
                assert_eq!(rig.excitation_end(), Some(ExcitationEnd::Fault), "{what}");
                let snapshot = rig.snapshot().expect("a snapshot");
                check_snapshot(&rig, &snapshot, &what);
                for request in [
                    Request::Arm,
                    Request::Disarm,
                    Request::Calibrate(rig.excitation()),
                ] {
                    let refused = rig.ask(request);
                    assert!(
                        matches!(refused, Told::Refused(Refusal::State(State::Fault(_)))),
                        "{what}: {refused:?}"
                    );
                }
                rig.run(3_000);
                assert_eq!(rig.on_since_off, 0, "{what}: the bridge was on again");
                (injection.mend)(&mut rig);
                rig.run(1_500);
                // The first asks the gate driver to start anew.
                rig.ask(Request::Clear);
                rig.run(1_500);
                rig.ask(Request::Clear);
                assert_eq!(rig.state(), State::Disarmed, "{what}");
                let again = rig.ask(Request::Calibrate(rig.excitation()));
                assert!(again == Told::Done, "{what}: {again:?}");
            }
        }
    }
}

#[test]
fn each_fault_ends_a_push_in_time_and_stays() {
    let table = table();
    for injection in INJECTIONS {
        let row = &table[injection.name];
        for drive in injection.drives {
            for seed in 0..4 {
                let what = format!("{} {drive:?} {seed}", injection.name);
                let mut rig = Rig::pushing(*drive, seed);
                let moment = rig.random.between(1.0, 2_000.0) as u32;
                rig.run(moment);
                assert_eq!(rig.state(), State::Pushing, "{what}");
                (injection.inject)(&mut rig);
                let most = periods(&row.off_within, rig.every);
                let took = rig.run_until_off(most + 10);
                assert!(took <= most, "{what}: {took} periods, the page says {most}");
                rig.run(2 * rig.every + 3_000);
                let State::Fault(fault) = rig.state() else {
                    panic!("{what}: {:?}", rig.state());
                };
                assert!((injection.fault)(fault), "{what}: {fault:?}");
                let snapshot = rig.snapshot().expect("a snapshot");
                check_snapshot(&rig, &snapshot, &what);
                assert_eq!(rig.on_since_off, 0, "{what}: the bridge was on again");
            }
        }
    }
}

/// What ends an excitation without a fault: by the page's name.
struct Limit {
    name: &'static str,
    end: ExcitationEnd,
    inject: fn(&mut Rig),
    /// It bars any further one for as long as it stands.
    bars: Option<fn(Fault) -> bool>,
}

const LIMITS: &[Limit] = &[
    Limit {
        name: "calibration-current",
        end: ExcitationEnd::Current,
        inject: |rig| rig.add_codes = [1500, 0],
        bars: None,
    },
    Limit {
        name: "calibration-current",
        end: ExcitationEnd::Current,
        inject: |rig| rig.add_codes = [-700, -700],
        bars: None,
    },
    Limit {
        name: "calibration-bus",
        end: ExcitationEnd::Bus,
        inject: |rig| rig.bus_v = Some(26.0),
        bars: Some(|fault| matches!(fault, Fault::OverVoltage { .. })),
    },
    Limit {
        name: "calibration-bus",
        end: ExcitationEnd::Bus,
        inject: |rig| rig.bus_v = Some(f32::NAN),
        bars: Some(|fault| matches!(fault, Fault::OverVoltage { .. })),
    },
    Limit {
        name: "calibration-bus",
        end: ExcitationEnd::Bus,
        inject: |rig| rig.bus_v = Some(7.5),
        bars: Some(|fault| matches!(fault, Fault::UnderVoltage { .. })),
    },
];

#[test]
fn a_limit_ends_a_calibration_in_its_period() {
    let table = table();
    for limit in LIMITS {
        let row = &table[limit.name];
        for drive in ALL {
            for seed in 0..6 {
                let what = format!("{:?} {drive:?} {seed}", limit.end);
                let mut rig = Rig::calibrating(*drive, seed);
                let moment = rig.random.between(1.0, 2_000.0) as u32;
                rig.run(moment);
                (limit.inject)(&mut rig);
                let most = periods(&row.off_within, rig.every);
                let took = rig.run_until_off(most + 10);
                assert!(took <= most, "{what}: {took} periods, the page says {most}");
                rig.run(2_000);
                assert_eq!(rig.state(), State::Disarmed, "{what}");
                assert_eq!(rig.excitation_end(), Some(limit.end), "{what}");
                assert_eq!(rig.on_since_off, 0, "{what}: the bridge was on again");
                let Some(bars) = limit.bars else {
                    continue;
                };
                for request in [Request::Calibrate(rig.excitation()), Request::Arm] {
                    let refused = rig.ask(request);
                    let Told::Refused(Refusal::State(State::Fault(fault))) = refused else {
                        panic!("{what}: {refused:?}");
                    };
                    assert!(bars(fault), "{what}: {fault:?}");
                    assert!(
                        matches!(rig.ask(Request::Clear), Told::Refused(_)),
                        "{what}"
                    );
                    rig.bus_v = None;
                    rig.run(1);
                    assert!(rig.ask(Request::Clear) == Told::Done, "{what}");
                    (limit.inject)(&mut rig);
                    rig.run(30);
                }
                assert_eq!(rig.on_since_off, 0, "{what}: the bridge was on again");
            }
        }
    }
}

#[test]
fn a_calibration_that_turns_too_far_in_a_windows_time_ends() {
    assert_eq!(table()["calibration-speed"].off_within, "2 windows");
    for drive in ALL {
        for seed in 0..6 {
            let mut rig = Rig::new(*drive, seed, Knob::Free);
            let excitation = Excitation {
                way_max: 4_000,
                window: 500,
                windows: 60,
                ..rig.excitation()
            };
            assert!(rig.ask(Request::Calibrate(excitation)) == Told::Done);
            let moment = rig.random.between(3_000.0, 9_000.0) as u32;
            rig.run(moment);
            assert_eq!(rig.state(), State::Calibrating, "{drive:?} {seed}");
            // Its own way was below 8 in a period, or it would have ended: 12 are left at least.
            rig.add_counts_a_period = 20;
            let took = rig.run_until_off(1_100);
            assert!(took <= 1_000, "{drive:?} {seed}: {took}");
            rig.run(1_500);
            assert_eq!(rig.excitation_end(), Some(ExcitationEnd::Speed));
            assert_eq!(rig.state(), State::Disarmed);
        }
    }
}

#[test]
fn a_calibration_ends_by_itself_and_may_not_last() {
    let mut rig = Rig::new(Drive::Current, 1, Knob::Free);
    let excitation = rig.excitation();
    // 720,000 periods are 30 s.
    let long = Excitation {
        windows: 552,
        ..excitation
    };
    let refused = rig.ask(Request::Calibrate(long));
    assert!(refused == Told::Refused(Refusal::Excitation), "{refused:?}");
    let longest = Excitation {
        windows: 550,
        ..excitation
    };
    for (excitation, most) in [(excitation, 30_000), (longest, 719_000)] {
        assert!(rig.ask(Request::Calibrate(excitation)) == Told::Done);
        let took = rig.run_until_off(most + 10);
        assert!(took <= most, "{took}");
        assert!(took > most / 10 * 9, "{took}");
        rig.run(1_500);
        assert_eq!(rig.excitation_end(), Some(ExcitationEnd::Done));
        assert_eq!(rig.state(), State::Disarmed);
        assert_eq!(rig.on_since_off, 0);
    }
}

/// What flowed while a motor was measured is not taken for an offset.
#[test]
fn a_calibration_that_was_broken_off_leaves_the_way_to_arming_free() {
    for drive in ALL {
        for seed in 0..6 {
            let mut rig = Rig::calibrating(*drive, seed);
            rig.run(4_000);
            assert!(rig.ask(Request::Disarm) == Told::Done);
            let armed = rig.ask(Request::Arm);
            assert!(armed == Told::Done, "{drive:?} {seed}: {armed:?}");
        }
    }
}

#[test]
fn a_count_that_does_not_follow_the_motor_is_found_by_its_back_emf() {
    let row = &table()["count-stands"];
    for drive in [Drive::Current, Drive::Brushed] {
        let mut found = 0;
        for seed in 0..40 {
            let mut rig = Rig::new(drive, seed, Knob::Turned);
            rig.arm();
            let moment = rig.random.between(2_600.0, 6_000.0) as u32;
            rig.run(moment);
            let fault = [EncoderFault::Stuck, EncoderFault::DeadChannel][seed as usize % 2];
            rig.plant.fault_encoder(Some(fault));
            // From here on the back-EMF is beyond everything that could explain it.
            let plain_v = rig.unexplained_limit_v();
            let mut plain = 0;
            for _ in 0..24_000 {
                if rig.first_off.is_some() {
                    break;
                }
                rig.period();
                plain = if rig.back_emf_v().abs() > plain_v {
                    plain + 1
                } else {
                    0
                };
                // Three phases show it only while the back-EMF alternates slowly enough.
                let most = periods(&row.off_within, rig.every);
                assert!(
                    drive != Drive::Brushed || plain <= most,
                    "{seed}: {plain} periods"
                );
            }
            if rig.first_off.is_some() {
                found += 1;
                rig.run(2 * rig.every);
                let State::Fault(fault) = rig.state() else {
                    panic!("{drive:?} {seed}: {:?}", rig.state());
                };
                assert_eq!(fault_code(fault), row.fault, "{drive:?} {seed}");
            }
        }
        println!("{drive:?}: found in {found} of 40");
        assert!(found >= 20, "{drive:?}: {found}");
    }
}

#[test]
fn arming_is_refused_where_something_is_wrong_already() {
    for (drive, seed) in [
        (Drive::Current, 1),
        (Drive::Brushed, 2),
        (Drive::Voltage, 3),
    ] {
        let mut rig = Rig::new(drive, seed, Knob::Pushed);
        // An offset that has moved by more than a calibrated one may.
        rig.add_codes = [60, 0];
        rig.run(1_500);
        let refused = rig.ask(Request::Arm);
        assert!(
            matches!(
                refused,
                Told::Refused(Refusal::State(State::Fault(Fault::CurrentSense)))
            ),
            "{refused:?}"
        );
        // It can be cleared, as it takes a calibration to mend; and bars the way to arming again.
        assert!(rig.ask(Request::Clear) == Told::Done);
        assert!(matches!(rig.ask(Request::Arm), Told::Refused(_)));
        assert!(rig.ask(Request::Clear) == Told::Done);
        rig.add_codes = [0, 0];
        rig.run(1_500);
        rig.bus_v = Some(5.0);
        rig.run(30);
        for request in [Request::Arm, Request::Push(rig.push())] {
            let refused = rig.ask(request);
            assert!(
                matches!(
                    refused,
                    Told::Refused(Refusal::State(State::Fault(Fault::UnderVoltage { .. })))
                ),
                "{refused:?}"
            );
            rig.bus_v = None;
            rig.run(1);
            assert!(rig.ask(Request::Clear) == Told::Done);
            rig.bus_v = Some(5.0);
            rig.run(30);
        }
        assert!(matches!(rig.ask(Request::Arm), Told::Refused(_)));
        assert!(matches!(rig.ask(Request::Clear), Told::Refused(_)));
        rig.bus_v = None;
        rig.run(1);
        assert!(rig.ask(Request::Clear) == Told::Done);
        assert!(rig.ask(Request::Arm) == Told::Done);
        assert_eq!(rig.ons, rig.on_since_off, "the bridge was on before");
    }
}

#[test]
fn the_first_fault_is_the_one_that_is_told() {
    let mut rig = Rig::armed(Drive::Current, 5);
    rig.run(2_000);
    rig.add_codes = [1500, -1500];
    rig.run_until_off(10);
    rig.overran = true;
    rig.bus_v = Some(40.0);
    rig.board.temperature_c = 150.0;
    rig.run(2_000);
    rig.gate_line_falls();
    rig.run(2_000);
    assert!(matches!(
        rig.state(),
        State::Fault(Fault::OverCurrent { .. })
    ));
    assert!(matches!(rig.snapshot(), Some(it) if matches!(it.fault, Fault::OverCurrent { .. })));
}

/// Noise of 0.3 A, hands that shake and push, any drive: nothing trips.
#[test]
fn a_healthy_knob_does_not_trip() {
    const PERIODS: u32 = 240_000;
    let mut healthy = 0_u64;
    let mut loudest = 0.0_f64;
    for drive in ALL {
        for seed in 100..108 {
            let mut rig = Rig::armed(*drive, seed);
            for _ in 0..PERIODS / 2_400 {
                rig.run(2_400);
                assert_eq!(rig.state(), State::Armed, "{drive:?} {seed}, {healthy}");
                healthy += 2_400;
            }
            loudest = loudest.max(rig.loudest_nm);
        }
    }
    println!("{healthy} healthy periods, {loudest} Nm at the most");
}

#[test]
fn arming_ramps_the_torque_in() {
    for drive in ALL {
        for seed in 0..8 {
            let mut rig = Rig::new(*drive, seed, Knob::Turned);
            rig.run(1_000);
            rig.arm();
            let start = rig.tick();
            let period_s = f64::from(rig.every) / 24e3;
            for _ in 0..4_800 {
                rig.period();
                let since_s = f64::from(rig.tick() - start + 1) * period_s;
                let allowed = (since_s / 0.1).min(1.0) * rig.torque_max_nm();
                let nm = rig.commanded_nm().abs();
                assert!(
                    nm <= allowed * 1.000_1 + 1e-6,
                    "{drive:?} {seed}: {nm} of {allowed}"
                );
            }
        }
    }
}

#[test]
fn the_watchdog_is_fed_only_while_tick_desk_and_slow_task_run() {
    let mut rig = Rig::armed(Drive::Current, 9);
    let fed = |rig: &mut Rig| {
        let before = rig.board.fed;
        rig.run(4_800);
        rig.board.fed - before
    };
    assert!(fed(&mut rig) >= 9, "once in each slow period");
    rig.desk_runs = false;
    rig.run(480);
    assert_eq!(fed(&mut rig), 0, "without the desk");
    rig.desk_runs = true;
    assert!(fed(&mut rig) >= 9);
    rig.slow_runs = false;
    assert_eq!(fed(&mut rig), 0, "without the slow task");
    rig.slow_runs = true;
    assert!(fed(&mut rig) >= 9);
    // Slow task and desk go on, but no haptic tick comes.
    rig.ticks_run = false;
    rig.run(480);
    assert_eq!(fed(&mut rig), 0, "without the tick");
}

#[test]
fn the_status_tells_why_the_device_started() {
    let mut rig = Rig::new(Drive::Current, 3, Knob::Pushed);
    let Told::Status(status) = rig.ask(Request::Status) else {
        panic!("no status");
    };
    assert_eq!(status.reset, ResetReason::Watchdog);
}

#[test]
fn the_page_has_every_fault_and_names_tests_that_exist() {
    let table = table();
    let told: BTreeSet<&str> = table.values().map(|row| row.fault.as_str()).collect();
    let all = [
        Fault::Overrun,
        Fault::EncoderJump { counts: 1 },
        Fault::TorqueNotFinite,
        Fault::CurrentOverrun,
        Fault::GateDriver,
        Fault::OverCurrent { current_a: 1.0 },
        Fault::CurrentSense,
        Fault::OverVoltage { bus_v: 1.0 },
        Fault::UnderVoltage { bus_v: 1.0 },
        Fault::OverTemperature { temperature_c: 1.0 },
        Fault::OverSpeed { speed_rad_s: 1.0 },
        Fault::Encoder,
        Fault::Guard,
    ];
    let all: BTreeSet<&str> = all.into_iter().map(fault_code).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let sources = sources(&root);
    assert!(
        all.is_subset(&told),
        "{:?} have no row",
        all.difference(&told)
    );
    for injection in INJECTIONS {
        assert!(table.contains_key(injection.name), "{}", injection.name);
    }
    for limit in LIMITS {
        assert!(table.contains_key(limit.name), "{}", limit.name);
    }
    for (what, row) in &table {
        assert!(!row.tests.is_empty(), "{what} names no test");
        for test in &row.tests {
            let name = test.rsplit("::").next().unwrap_or(test);
            let head = format!("fn {name}(");
            let found = sources.iter().any(|source| {
                source.match_indices(&head).any(|(at, _)| {
                    source[..at].trim_end().ends_with("#[test]")
                        || source[..at].contains("proptest!")
                })
            });
            assert!(found, "{what}: no test is called {name}");
        }
    }
}

/// The package's sources that hold tests.
fn sources(root: &Path) -> Vec<String> {
    let mut all = Vec::new();
    for folder in [
        "tests/tests",
        "firmware/src",
        "firmware/tests",
        "control/src",
        "host-cli/src",
        "host-cli/tests",
    ] {
        for entry in walk(&root.join(folder)) {
            if entry.extension().is_some_and(|extension| extension == "rs") {
                all.push(std::fs::read_to_string(entry).unwrap());
            }
        }
    }
    all
}

fn walk(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            all.extend(walk(&path));
        } else {
            all.push(path);
        }
    }
    all
}

//! The image with a power stage in the emulator against windings and a knob, its native twin beside it.
//!
//! [`PoweredRig`] compares every duty and every serial byte of the two, so every test here is also one of
//! bit equality.

use acceptance::powered_twin::{all_of, example_motor, knob};
use acceptance::{PoweredRig, Random};
use control::criterion::Device;
use firmware::power::ODRIVE_V3_24V;
use plant_sim::electrical::CurrentSensing;
use plant_sim::hold::State as Motion;
use plant_sim::powered_lockstep::{LockstepError, Order};
use protocol::{
    Changes, Drive, Fault, Fields, Law, Message, Motor, Request, Shape, State, Subscription,
};

const DEVICE: Device<f64> = Device {
    inertia_kg_m2: 1.2e-5,
    viscous_nm_s_rad: 2e-5,
    coulomb_nm: 4e-3,
};

fn rig(motor: &Motor, velocity: f64) -> PoweredRig {
    let mut setup = knob(
        motor,
        8192,
        DEVICE,
        Motion {
            position: 0.0,
            velocity,
        },
    );
    setup.sensing = CurrentSensing {
        noise_a: 0.02,
        ..setup.sensing
    };
    PoweredRig::start(&setup)
}

fn every(n: u32) -> Changes {
    Changes {
        sample_period_s: Some((f64::from(n) * ODRIVE_V3_24V.pwm_period_s) as f32),
        ..Changes::default()
    }
}

fn state(rig: &mut PoweredRig) -> State {
    rig.ask(Request::Status, |message| match message {
        Message::Status(status) => status.state,
        other => panic!("{other:?}"),
    })
}

const LAWS: [Law; 5] = [Law::Raw, Law::Static, Law::Episode, Law::Ledger, Law::Auto];
const SHAPES: [Shape; 3] = [Shape::Spring, Shape::Wall, Shape::Detent];

/// Laws, shapes, stiffnesses, motors and haptic periods that change at random times, arming, late periods and the gate
/// driver's line, and a motor that turns the knob by its own springs.
fn busy_run(drive: Drive, seed: u64, periods: u64) -> PoweredRig {
    let motor = Motor {
        reversed: seed.is_multiple_of(2),
        ..example_motor(drive)
    };
    let mut rig = rig(&motor, 12.0);
    let mut random = Random(seed);
    rig.must(Request::Subscribe(Subscription {
        every_ticks: 29,
        fields: Fields::ALL,
        clamp_events: true,
    }));
    rig.must(Request::SetMotor(all_of(&motor)));
    let mut faults = 0;
    while rig.periods < periods {
        if random.below(3) == 0 {
            rig.must(Request::Disarm);
            rig.must(Request::Set(every(1 + random.below(30) as u32)));
            let other = Motor {
                current_max_a: 1.0 + random.below(8) as f32,
                ..motor
            };
            rig.must(Request::SetMotor(all_of(&other)));
        }
        rig.must(Request::Arm);
        for _ in 0..4 {
            let share = |random: &mut Random| random.below(1000) as f32 / 1000.0;
            rig.must(Request::Set(Changes {
                law: Some(LAWS[random.below(5) as usize]),
                shape: Some(SHAPES[random.below(3) as usize]),
                stiffness_nm_rad: Some(2.0 * share(&mut random)),
                // A centre elsewhere throws the knob about.
                centre_rad: Some(share(&mut random) - 0.5),
                wall_rad: Some(share(&mut random) - 0.5),
                period_rad: Some(0.2 + share(&mut random)),
                ..Changes::default()
            }));
            rig.periods(1 + random.below(700));
        }
        match random.below(4) {
            0 => drop(rig.period_with(true, false)),
            1 => drop(rig.period_with(false, true)),
            _ => {}
        }
        rig.periods(30);
        if let State::Fault(_) = state(&mut rig) {
            faults += 1;
            rig.must(Request::Clear);
        }
    }
    assert!(faults > 3, "{faults} faults");
    assert!(4 * rig.on > rig.periods, "on in {} periods", rig.on);
    rig
}

#[test]
fn the_chip_s_duties_are_those_of_its_native_twin_to_the_last_bit() {
    for (drive, seed) in [
        (Drive::Current, 0x5eed),
        (Drive::Current, 0x5eee),
        (Drive::Voltage, 0xbeef),
        (Drive::Brushed, 0xcafe),
    ] {
        let rig = busy_run(drive, seed, 50_000);
        println!("{drive:?}: {} periods, on in {}", rig.periods, rig.on);
    }
}

#[test]
fn the_gate_driver_s_line_puts_the_bridge_off_before_the_next_tick_and_until_cleared() {
    let motor = example_motor(Drive::Brushed);
    let mut rig = rig(&motor, 0.0);
    rig.must(Request::SetMotor(all_of(&motor)));
    rig.must(Request::Arm);
    assert!(rig.period().report.duties.is_some());
    assert_eq!(rig.period_with(true, false).report.duties, None);
    for _ in 0..100 {
        assert_eq!(rig.period().report.duties, None);
    }
    assert_eq!(state(&mut rig), State::Fault(Fault::GateDriver));
    rig.must(Request::Clear);
    assert_eq!(rig.period().report.duties, None);
    rig.must(Request::Arm);
    assert!(rig.period().report.duties.is_some());
}

#[test]
fn a_panic_and_a_hard_fault_put_the_bridge_off_first_and_are_reported() {
    for (order, code) in [(Order::Panic, 101), (Order::HardFault, 102)] {
        let motor = example_motor(Drive::Current);
        let mut rig = rig(&motor, 0.0);
        rig.must(Request::SetMotor(all_of(&motor)));
        rig.must(Request::Arm);
        assert!(rig.period().report.duties.is_some());
        let sensed = rig.bench.knob.sensed();
        let mut exchange = |order| {
            let around = rig.bench.around;
            rig.bench.emulator.exchange(order, &sensed, &around)
        };
        assert_eq!(exchange(order).unwrap().duties, None);
        match exchange(Order::Period) {
            Err(LockstepError::Ended(status)) => assert_eq!(status.code(), Some(code)),
            other => panic!("{other:?}"),
        }
    }
}

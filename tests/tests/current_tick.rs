//! The whole current tick, natively, on windings and a knob: what torque comes of what is asked, what the governor is
//! told of it, and whether springs stay passive with that.

use std::cell::Cell;

use acceptance::powered_twin::{NativeBench, all_of, duties, example_motor, knob, sensed};
use control::criterion::Device;
use firmware::drive::MotorDrive;
use firmware::power::ODRIVE_V3_24V;
use firmware::settings::{
    self, BoardKind, DEFAULTS, MOTOR_HIGHEST, MOTOR_LOWEST, NO_MOTOR, Settings,
};
use plant_sim::hold::State;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use protocol::{
    Changes, Drive, Fields, Interval, Law, Message, Motor, MotorChanges, MotorName, Name,
    Parameters, Push, Refusal, Request, Subscription,
};

const PWM_S: f64 = ODRIVE_V3_24V.pwm_period_s;

const STAGE: BoardKind = BoardKind::Stage(ODRIVE_V3_24V);

const DRIVES: [Drive; 3] = [Drive::Current, Drive::Voltage, Drive::Brushed];

/// n PWM periods.
fn every(n: u32) -> Changes {
    Changes {
        sample_period_s: Some((f64::from(n) * PWM_S) as f32),
        ..Changes::default()
    }
}

const AT_REST: State = State {
    position: 0.0,
    velocity: 0.0,
};

/// What friction stops within 0.1 s from 1.1 rad/s, and holds then, whatever the motor does.
const STUCK: Device<f64> = Device {
    inertia_kg_m2: 0.8,
    viscous_nm_s_rad: 0.0,
    coulomb_nm: 10.0,
};

/// What a step of the torque made.
struct Step {
    /// Of the haptic tick, Nm, positive where the motor's is.
    commanded_nm: f64,
    /// In each PWM period after the one with the haptic tick, Nm.
    torques_nm: Vec<f64>,
}

/// Has a motor that is held give a torque of about a current, from one haptic tick to the next.
fn step(motor: &Motor, n: u32, current_a: f64, counts_per_rev: u32) -> Step {
    // The knob passes its centre, slowly enough to be seen there, and stops 4.4 mrad further on, where a torque of the sign wanted draws it back.
    let sign = if motor.reversed { -1.0 } else { 1.0 };
    let thrown = State {
        position: 0.0,
        velocity: -1.1 * current_a.signum(),
    };
    let stiffness = current_a.abs() * f64::from(motor.torque_constant_nm_a) / 4.4e-3;
    let mut bench = NativeBench::new(&knob(motor, counts_per_rev, STUCK, thrown));
    for request in [
        Request::Set(Changes {
            counts_per_rev: Some(counts_per_rev),
            law: Some(Law::Raw),
            stiffness_nm_rad: Some(stiffness as f32),
            torque_max_nm: Some(0.0),
            centre_rad: Some((-44e-3 * sign * current_a.signum()) as f32),
            ..every(n)
        }),
        Request::SetMotor(all_of(motor)),
        Request::Subscribe(Subscription {
            every_ticks: 1,
            fields: Fields::TORQUE,
            clamp_events: false,
        }),
        Request::Arm,
    ] {
        bench.must(request);
    }
    for _ in 0..6000 {
        bench.period();
    }
    bench.must(Request::Set(Changes {
        torque_max_nm: Some(10.0),
        ..Changes::default()
    }));
    // The period with the haptic tick that took it is over.
    bench.twin.take_output();
    let torques_nm = (0..200)
        .map(|_| bench.period().electrical.torque_nm)
        .collect();
    let told = bench.twin.take_messages();
    let commanded = told[0].read(|_, message| match message {
        Message::Telemetry(telemetry) => telemetry.torque_nm.unwrap(),
        other => panic!("{other:?}"),
    });
    Step {
        commanded_nm: sign * f64::from(commanded),
        torques_nm,
    }
}

#[test]
fn torque_is_within_one_percent_half_a_millisecond_after_the_haptic_tick() {
    for drive in [Drive::Current, Drive::Brushed] {
        for n in [1, 4, 24] {
            for (current_a, reversed) in [(4.0, false), (-4.0, true), (2.0, true)] {
                let motor = Motor {
                    reversed,
                    ..example_motor(drive)
                };
                let step = step(&motor, n, current_a, 8192);
                let given_a = step.commanded_nm / f64::from(motor.torque_constant_nm_a);
                assert!(given_a / current_a > 0.8, "{given_a} A for {current_a}");
                // One PWM period after the tick's count, whatever n is, torque begins to change.
                assert!(step.torques_nm[0] / step.commanded_nm > 0.05);
                // Of these, the first is the second of the twelve of half a millisecond.
                for (period, torque_nm) in step.torques_nm.iter().enumerate().skip(11) {
                    let error = torque_nm / step.commanded_nm - 1.0;
                    assert!(
                        error.abs() < 0.01,
                        "{drive:?} n {n} {current_a} A, period {period}: {error:+.4}"
                    );
                }
            }
        }
    }
}

fn three_phase_motors() -> impl Strategy<Value = Motor> {
    (
        (-2.0..1.0f64).prop_map(f64::exp),
        (-9.0..-6.5f64).prop_map(f64::exp),
        1.0..1.4f64,
        0.02..0.1f64,
        (1..15_u32, any::<bool>(), -1.0..1.0f32),
        (-390.0..390.0f32, -390.0..390.0f32),
    )
        .prop_map(
            |(
                resistance,
                time_constant,
                saliency,
                constant,
                (pole_pairs, reversed, zero),
                (b, c),
            )| {
                Motor {
                    drive: Drive::Current,
                    pole_pairs,
                    resistance_ohm: resistance as f32,
                    d_inductance_h: (resistance * time_constant) as f32,
                    q_inductance_h: (resistance * time_constant * saliency) as f32,
                    torque_constant_nm_a: constant as f32,
                    current_max_a: 20.0,
                    reversed,
                    zero_turns: zero,
                    offset_b_codes: 2048.0 + b,
                    offset_c_codes: 2048.0 + c,
                }
            },
        )
}

fn gimbal_motors() -> impl Strategy<Value = Motor> {
    three_phase_motors().prop_map(|motor| Motor {
        drive: Drive::Voltage,
        resistance_ohm: 10.0 * motor.resistance_ohm,
        d_inductance_h: 10.0 * motor.d_inductance_h,
        q_inductance_h: 10.0 * motor.q_inductance_h,
        torque_constant_nm_a: 3.0 * motor.torque_constant_nm_a,
        ..motor
    })
}

fn brushed_motors() -> impl Strategy<Value = Motor> {
    three_phase_motors().prop_map(|motor| Motor {
        drive: Drive::Brushed,
        pole_pairs: 1,
        q_inductance_h: motor.d_inductance_h,
        ..motor
    })
}

fn any_motor() -> impl Strategy<Value = Motor> {
    prop_oneof![three_phase_motors(), gimbal_motors(), brushed_motors()]
}

/// The largest step of current that is not held up by the bus, of which a loop asks (ω_c·L + R)·current at once, A.
fn drivable_a(motor: &Motor) -> f64 {
    let inductance_h = motor.d_inductance_h.max(motor.q_inductance_h);
    let volts_a = 0.29 / PWM_S * f64::from(inductance_h) + f64::from(motor.resistance_ohm);
    (9.0 / volts_a).min(15.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Of any motor, through converters of 20 mA and duties of 1/3500: within 1 % and what the drive says of its step.
    #[test]
    fn any_motor_gives_the_torque_asked_within_its_own_step(
        motor in any_motor(),
        n in prop_oneof![Just(1_u32), Just(4), Just(24)],
        share in prop_oneof![-1.0..-0.3f64, 0.3..1.0f64],
    ) {
        let current_a = share * drivable_a(&motor);
        let step = step(&motor, n, current_a, 16_384);
        let delivery = MotorDrive::new(&motor, 16_384, &ODRIVE_V3_24V).unwrap().unwrap().delivery();
        // A voltage drive is as fast as its windings; the tolerance is not used here.
        let settled = match motor.drive {
            Drive::Voltage => 2 + (5.0 * f64::from(motor.q_inductance_h / motor.resistance_ohm) / PWM_S) as usize,
            _ => 11,
        };
        prop_assert!(step.commanded_nm * current_a > 0.0);
        for (period, torque_nm) in step.torques_nm.iter().enumerate().skip(settled) {
            let error_nm = (torque_nm - step.commanded_nm).abs();
            prop_assert!(
                error_nm < 0.01 * step.commanded_nm.abs() + 0.5 * delivery.torque_step_nm,
                "period {period}: {torque_nm} for {}", step.commanded_nm
            );
        }
    }
}

fn believed(value: f64, off: f64) -> Option<Interval> {
    Some(Interval {
        low: (value * (1.0 - off)) as f32,
        high: (value * (1.0 + off)) as f32,
    })
}

fn devices() -> impl Strategy<Value = Device<f64>> {
    (
        (-12.2..-9.9f64).prop_map(f64::exp),
        (-13.8..-9.2f64).prop_map(f64::exp),
        (-6.5..-4.0f64).prop_map(f64::exp),
    )
        .prop_map(|(inertia_kg_m2, viscous_nm_s_rad, coulomb_nm)| Device {
            inertia_kg_m2,
            viscous_nm_s_rad,
            coulomb_nm,
        })
}

/// A knob that is thrown into a spring of any stiffness never gets faster than it was when it was armed, and in
/// the end it rests, or creeps towards rest against the drag that is left of a voltage drive, but does not swing.
#[test]
fn a_spring_stays_passive_with_what_the_governor_is_told() {
    let scenes = (
        any_motor(),
        devices(),
        prop_oneof![Just(1_u32), Just(4), Just(24)],
        prop_oneof![Just(Law::Ledger), Just(Law::Auto)],
        (-5.0..2.5f64).prop_map(f64::exp),
        1.0..15.0f64,
    );
    let mut runner = TestRunner::new(ProptestConfig::with_cases(60));
    let (runs, held) = (Cell::new(0), Cell::new(0));
    let run = |(motor, device, n, law, stiffness, velocity): (Motor, Device<f64>, _, _, f64, _)| {
        let start = State {
            position: -0.01,
            velocity,
        };
        let mut bench = NativeBench::new(&knob(&motor, 8192, device, start));
        for request in [
            Request::Set(Changes {
                law: Some(law),
                stiffness_nm_rad: Some(stiffness as f32),
                torque_max_nm: Some(10.0),
                inertia_kg_m2: believed(device.inertia_kg_m2, 0.05),
                viscous_nm_s_rad: believed(device.viscous_nm_s_rad, 0.3),
                coulomb_nm: believed(device.coulomb_nm, 0.1),
                ..every(n)
            }),
            Request::SetMotor(all_of(&motor)),
            Request::Arm,
        ] {
            bench.must(request);
        }
        // Until then it only lost speed, to its friction.
        let armed = bench.knob.state().velocity.abs();
        let mut held_back = false;
        let mut late = (0.0_f64, 0.0_f64);
        for period in 0..48_000 {
            let turned = bench.period();
            held_back |= turned.electrical.torque_nm.abs() > device.coulomb_nm;
            let now = bench.knob.state().velocity.abs();
            prop_assert!(
                now <= armed,
                "period {period}: {now} rad/s, armed at {armed}"
            );
            if period >= 36_000 {
                let velocity = bench.knob.state().velocity;
                late = (late.0.min(velocity), late.1.max(velocity));
            }
        }
        prop_assert!(late.0 == 0.0 || late.1 == 0.0, "{late:?} rad/s");
        runs.set(runs.get() + 1);
        held.set(held.get() + u32::from(held_back));
        Ok(())
    };
    runner.run(&scenes, run).unwrap();
    println!("{} of {} springs beyond friction", held.get(), runs.get());
    assert!(3 * held.get() > runs.get());
}

proptest! {
    /// Within its limits every motor has a drive, or it is said which value is not accepted, and what would be.
    #[test]
    fn every_motor_within_its_limits_has_a_drive(
        shares in prop::collection::vec(0.0..=1.0f32, 9),
        drive in prop_oneof![Just(Drive::Current), Just(Drive::Voltage), Just(Drive::Brushed)],
        counts_per_rev in prop_oneof![Just(4_u32), Just(8192), Just(1_000_000)],
        edge in any::<bool>(),
    ) {
        let (low, high) = (MOTOR_LOWEST, MOTOR_HIGHEST);
        let share = |at: usize| if edge { shares[at].round() } else { shares[at] };
        let between = |at: usize, low: f32, high: f32| low * (high / low).powf(share(at));
        let mut motor = Motor {
            drive,
            pole_pairs: 1 + (99.0 * share(0)) as u32,
            resistance_ohm: between(1, low.resistance_ohm, high.resistance_ohm).clamp(low.resistance_ohm, high.resistance_ohm),
            d_inductance_h: between(2, low.d_inductance_h, high.d_inductance_h).clamp(low.d_inductance_h, high.d_inductance_h),
            q_inductance_h: between(3, low.q_inductance_h, high.q_inductance_h).clamp(low.q_inductance_h, high.q_inductance_h),
            torque_constant_nm_a: between(4, low.torque_constant_nm_a, high.torque_constant_nm_a)
                .clamp(low.torque_constant_nm_a, high.torque_constant_nm_a),
            current_max_a: 30.0 * share(5),
            reversed: shares[5] > 0.5,
            zero_turns: 2.0 * share(6) - 1.0,
            offset_b_codes: 4095.0 * share(7),
            offset_c_codes: 4095.0 * share(8),
        };
        for _ in 0..4 {
            match MotorDrive::new(&motor, counts_per_rev, &ODRIVE_V3_24V) {
                Ok(made) => {
                    prop_assert!(made.is_some());
                    let settings = Settings { parameters: Parameters { counts_per_rev, ..DEFAULTS }, motor };
                    prop_assert!(settings::settle(&settings, &STAGE).is_ok(), "{motor:?}");
                    return Ok(());
                }
                Err(Refusal::MotorValue { name, given, lowest, highest }) => {
                    prop_assert!(!(lowest..=highest).contains(&given));
                    match name {
                        MotorName::OffsetBCodes => motor.offset_b_codes = lowest,
                        MotorName::OffsetCCodes => motor.offset_c_codes = highest,
                        MotorName::QInductanceH => motor.q_inductance_h = highest,
                        other => prop_assert!(false, "{other:?}"),
                    }
                }
                Err(other) => prop_assert!(false, "{other:?}"),
            }
        }
        prop_assert!(false, "what would be accepted is not: {motor:?}");
    }

    /// The plan of a power stage is that of a board with an amplifier, where the user believes in addition what the
    /// drive says of itself; without a motor it is what is believed alone.
    #[test]
    fn how_the_torque_comes_enters_the_plan(
        motor in any_motor(),
        n in 3..200_u32,
        delay in 0.0..40e-6f64,
        tau in 0.0..1e-3f64,
        step in 0.0..1e-2f64,
        torque_max in 0.01..2.0f64,
        law in prop_oneof![Just(Law::Static), Just(Law::Ledger), Just(Law::Auto)],
    ) {
        let with = |delay: f64, tau: f64, step: f64, torque_max: f64| Parameters {
            sample_period_s: (f64::from(n) * PWM_S) as f32,
            stiffness_nm_rad: 1.0,
            law,
            delay_s: delay as f32,
            amplifier_tau_s: tau as f32,
            torque_step_nm: step as f32,
            torque_max_nm: torque_max as f32,
            ..DEFAULTS
        };
        let settle = |parameters, motor, kind: &BoardKind| settings::settle(&Settings { parameters, motor }, kind).unwrap();
        let amplifier = BoardKind::Amplifier { counter_bits: 32 };
        let told = with(delay, tau, step, torque_max);
        let alone = settle(told, NO_MOTOR, &STAGE);
        let ideal = settle(told, NO_MOTOR, &amplifier);
        prop_assert!(ideal.power.is_none());
        prop_assert!((alone.plan.applied_limit_nm_rad() / ideal.plan.applied_limit_nm_rad() - 1.0).abs() < 1e-5);
        let staged = settle(told, motor, &STAGE);
        let delivery = staged.power.unwrap().delivery(&motor, &ODRIVE_V3_24V, f64::from(DEFAULTS.inertia_kg_m2.low)).unwrap();
        prop_assert_eq!(delivery.delay_s, PWM_S);
        let sum = settle(
            with(
                delay + delivery.delay_s,
                tau + delivery.tau_s,
                step.max(delivery.torque_step_nm),
                torque_max.min(delivery.torque_max_nm),
            ),
            motor,
            &amplifier,
        );
        let ratio = staged.plan.applied_limit_nm_rad() / sum.plan.applied_limit_nm_rad();
        prop_assert!((ratio - 1.0).abs() < 1e-4, "{ratio}");
        // And it does limit.
        prop_assert!(staged.plan.applied_limit_nm_rad() <= ideal.plan.applied_limit_nm_rad());
        prop_assert_eq!(staged.furthest_counts, ideal.furthest_counts);
    }
}

fn refusal(bench: &mut NativeBench, request: Request) -> Refusal {
    bench.ask(request, |message| match message {
        Message::Refused(refusal) => *refusal,
        other => panic!("{request:?}: {other:?}"),
    })
}

#[test]
fn a_sample_period_is_a_whole_number_of_pwm_periods() {
    let motor = example_motor(Drive::Current);
    let mut bench = NativeBench::new(&knob(&motor, 8192, STUCK, AT_REST));
    for n in [1, 2, 3, 24, 480] {
        bench.must(Request::Set(every(n)));
        // And the haptic ticks are as far apart as that.
        let haptic = |bench: &mut NativeBench| {
            bench.period();
            bench.twin.was_haptic()
        };
        while !haptic(&mut bench) {}
        for period in 1..=3 * n {
            assert_eq!(
                haptic(&mut bench),
                period % n == 0,
                "n {n}, period {period}"
            );
        }
    }
    for (asked, below, above) in [
        (40e-6, 1, 1),
        (60e-6, 1, 2),
        (0.999e-3, 23, 24),
        (1.001e-3, 24, 25),
        (19.99e-3, 479, 480),
    ] {
        let changes = Changes {
            sample_period_s: Some(asked),
            ..Changes::default()
        };
        let whole = |n: u32| (f64::from(n) * PWM_S) as f32;
        assert_eq!(
            refusal(&mut bench, Request::Set(changes)),
            Refusal::Together {
                name: Name::SamplePeriodS,
                lowest: whole(below),
                highest: whole(above)
            }
        );
        for accepted in [below, above] {
            bench.must(Request::Set(every(accepted)));
        }
    }
}

#[test]
fn the_stage_s_own_delay_leaves_no_other_at_24_khz() {
    let motor = example_motor(Drive::Current);
    let mut bench = NativeBench::new(&knob(&motor, 8192, STUCK, AT_REST));
    bench.must(Request::SetMotor(all_of(&motor)));
    bench.must(Request::Set(every(1)));
    let delay = Changes {
        delay_s: Some(1e-6),
        ..Changes::default()
    };
    let refused = |name| Refusal::Together {
        name,
        lowest: 0.0,
        highest: 0.0,
    };
    assert_eq!(
        refusal(&mut bench, Request::Set(delay)),
        refused(Name::DelayS)
    );
    let jitter = Changes {
        jitter_s: Some(1e-6),
        ..Changes::default()
    };
    assert_eq!(
        refusal(&mut bench, Request::Set(jitter)),
        refused(Name::JitterS)
    );
    bench.must(Request::Set(every(2)));
    bench.must(Request::Set(delay));
}

#[test]
fn without_a_motor_nothing_is_armed_and_a_motor_is_taken_only_while_disarmed() {
    let motor = example_motor(Drive::Voltage);
    let mut bench = NativeBench::new(&knob(&motor, 8192, STUCK, AT_REST));
    assert_eq!(refusal(&mut bench, Request::Arm), Refusal::NoMotor);
    let off = MotorChanges {
        offset_b_codes: Some(0.0),
        ..all_of(&motor)
    };
    assert!(matches!(
        refusal(&mut bench, Request::SetMotor(off)),
        Refusal::MotorValue {
            name: MotorName::OffsetBCodes,
            ..
        }
    ));
    assert_eq!(refusal(&mut bench, Request::Arm), Refusal::NoMotor);
    bench.must(Request::SetMotor(all_of(&motor)));
    bench.must(Request::Arm);
    assert!(matches!(
        refusal(&mut bench, Request::SetMotor(all_of(&motor))),
        Refusal::State(_)
    ));
    bench.must(Request::Disarm);
    let none = MotorChanges {
        drive: Some(Drive::None),
        ..MotorChanges::default()
    };
    bench.must(Request::SetMotor(none));
    assert_eq!(refusal(&mut bench, Request::Arm), Refusal::NoMotor);
}

/// After a start the counter counts from wherever the knob stands: a zero that was kept would turn the torque's angle.
#[test]
fn three_phases_are_armed_and_pushed_only_once_the_zero_was_told() {
    let push = Request::Push(Push {
        from_nm: 0.0,
        to_nm: 0.0,
        rise_ticks: 0,
        most_ticks: 1,
        way_counts: 1,
        speed_counts: 1,
        rest_ticks: 1,
        coast_ticks: 1,
        guard_counts: 1,
    });
    for drive in DRIVES {
        let motor = example_motor(drive);
        let mut bench = NativeBench::new(&knob(&motor, 8192, STUCK, AT_REST));
        bench.must(Request::SetMotor(MotorChanges {
            zero_turns: None,
            ..all_of(&motor)
        }));
        if drive != Drive::Brushed {
            assert_eq!(refusal(&mut bench, Request::Arm), Refusal::NoZero);
            assert_eq!(refusal(&mut bench, push), Refusal::NoZero);
            bench.must(Request::SetMotor(MotorChanges {
                zero_turns: Some(motor.zero_turns),
                ..MotorChanges::default()
            }));
        }
        bench.must(Request::Arm);
    }
}

#[test]
fn each_drive_is_off_but_while_armed() {
    for drive in DRIVES {
        let motor = example_motor(drive);
        let mut bench = NativeBench::new(&knob(&motor, 8192, STUCK, AT_REST));
        let on = |bench: &mut NativeBench| {
            let read = sensed(&bench.knob.sensed());
            let bridge = bench.twin.period(&read, false, false);
            bench.knob.period(duties(bridge));
            bridge != firmware::power::Bridge::Off
        };
        bench.must(Request::SetMotor(all_of(&motor)));
        assert!((0..100).all(|_| !on(&mut bench)));
        bench.must(Request::Arm);
        assert!((0..100).all(|_| on(&mut bench)));
        let read = sensed(&bench.knob.sensed());
        for (gate_fault, overran) in [(true, false), (false, true)] {
            assert_eq!(
                bench.twin.period(&read, gate_fault, overran),
                firmware::power::Bridge::Off
            );
            assert!((0..100).all(|_| !on(&mut bench)));
            bench.must(Request::Clear);
            bench.must(Request::Arm);
        }
        bench.must(Request::Disarm);
        assert!((0..100).all(|_| !on(&mut bench)));
        // A push coasts with it off, for 50 ticks of 24 periods here: the knob is stuck.
        bench.must(Request::Push(Push {
            from_nm: 1e-3,
            to_nm: 1e-3,
            rise_ticks: 0,
            most_ticks: 10,
            way_counts: 1000,
            speed_counts: 1000,
            rest_ticks: 50,
            coast_ticks: 50,
            guard_counts: 1000,
        }));
        assert!((0..8 * 24).all(|_| on(&mut bench)));
        assert!((0..2 * 24).any(|_| !on(&mut bench)));
        assert!((0..60 * 24).all(|_| !on(&mut bench)));
        bench.must(Request::Arm);
    }
}

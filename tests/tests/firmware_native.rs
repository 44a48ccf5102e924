//! The firmware without its board, run natively: limits, arming, and a line that is too slow.

use acceptance::{Answer, Twin, answers, request_frame};
use firmware::settings::{self, BoardKind, DEFAULTS, HIGHEST, LOWEST, NO_MOTOR, Settings};
use firmware::ticker::Settled;
use proptest::prelude::*;
use protocol::{
    Changes, Event, Fields, Frames, Interval, Law, Message, Name, Parameters, Refusal, Request,
    Shape, State, Subscription,
};

fn ask(twin: &mut Twin, request: Request) -> Vec<Answer> {
    twin.send(&request_frame(3, request));
    twin.tick(0, false);
    answers(&mut Frames::new(), &twin.take_output())
}

fn settle(parameters: &Parameters, counter_bits: u32) -> Result<Settled, Refusal> {
    let settings = Settings {
        parameters: *parameters,
        motor: NO_MOTOR,
    };
    settings::settle(&settings, &BoardKind::Amplifier { counter_bits })
}

#[test]
fn the_defaults_settle_on_every_counter_and_so_do_the_limits() {
    for bits in [16, 32] {
        assert!(settle(&DEFAULTS, bits).is_ok());
        for edge in [LOWEST, HIGHEST] {
            // A wall or centre may be more counts away than there are, and a delay longer than a
            // period; all else goes together.
            let near = Parameters {
                centre_rad: 0.0,
                wall_rad: 0.0,
                delay_s: 0.0,
                ..edge
            };
            assert!(settle(&near, bits).is_ok(), "{near:?}");
        }
    }
}

#[test]
fn a_line_that_is_too_slow_loses_telemetry_counts_it_and_says_so() {
    let mut twin = Twin::new(0, "test");
    let subscription = Subscription {
        every_ticks: 1,
        fields: Fields::ALL,
        clamp_events: false,
    };
    ask(&mut twin, Request::Subscribe(subscription));
    for _ in 0..1000 {
        twin.tick_alone(0, false);
    }
    // What found room goes out a few at a time, and the host is heard in between.
    twin.send(&request_frame(
        4,
        Request::Subscribe(Subscription::default()),
    ));
    for _ in 0..10 {
        twin.tick(0, false);
    }
    let told = answers(&mut Frames::new(), &twin.take_output());
    let telemetry =
        |answer: &&Answer| answer.read(|_, message| matches!(message, Message::Telemetry(_)));
    assert_eq!(
        told.iter().filter(telemetry).count(),
        63,
        "as many as find room"
    );
    let dropped = told.iter().find_map(|answer| {
        answer.read(|_, message| match message {
            Message::Event(Event::Dropped { total }) => Some(*total),
            _ => None,
        })
    });
    assert_eq!(dropped, Some(1000 - 63));
    // Said once, and in the status.
    twin.take_output();
    let status = ask(&mut twin, Request::Status);
    assert!(
        status[0]
            .read(|_, message| matches!(message, Message::Status(status) if status.dropped == 937))
    );
}

#[test]
fn the_host_is_heard_however_much_the_tick_has_to_tell() {
    let mut twin = Twin::new(0, "test");
    let subscription = Subscription {
        every_ticks: 1,
        fields: Fields::ALL,
        clamp_events: true,
    };
    ask(&mut twin, Request::Subscribe(subscription));
    // A line so slow that 60 ticks pass while the desk sends once.
    twin.send(&request_frame(4, Request::Disarm));
    let mut answered = false;
    for _ in 0..20 {
        for _ in 0..60 {
            twin.tick_alone(0, false);
        }
        twin.tick(0, false);
        let told = answers(&mut Frames::new(), &twin.take_output());
        assert!(told.len() <= 11, "{} frames in one go", told.len());
        answered |= told
            .iter()
            .any(|answer| answer.read(|_, message| matches!(message, Message::Done { .. })));
    }
    assert!(answered);
}

#[test]
fn a_fault_is_told_rightly_even_where_its_event_found_no_room() {
    let mut twin = Twin::new(0, "test");
    let subscription = Subscription {
        every_ticks: 1,
        ..Subscription::default()
    };
    ask(&mut twin, Request::Subscribe(subscription));
    ask(&mut twin, Request::Arm);
    for _ in 0..100 {
        twin.tick_alone(0, false);
    }
    twin.tick_alone(100_000, false);
    twin.send(&request_frame(9, Request::Status));
    let told = answers(&mut Frames::new(), &twin.take_output());
    let jump = State::Fault(protocol::Fault::EncoderJump { counts: 100_000 });
    let right = |answer: &Answer| {
        answer.read(|_, message| matches!(message, Message::Status(status) if status.state == jump))
    };
    assert!(told.iter().any(right));
}

#[test]
fn a_new_subscription_starts_at_once() {
    let mut twin = Twin::new(0, "test");
    for every_ticks in [5000, 1] {
        let subscription = Subscription {
            every_ticks,
            ..Subscription::default()
        };
        ask(&mut twin, Request::Subscribe(subscription));
        twin.tick(0, false);
    }
    twin.take_output();
    twin.tick(0, false);
    assert_eq!(answers(&mut Frames::new(), &twin.take_output()).len(), 1);
}

#[test]
fn arming_under_load_gives_no_torque_until_zero_force() {
    let mut twin = Twin::new(0, "test");
    let set = Changes {
        law: Some(Law::Raw),
        stiffness_nm_rad: Some(0.5),
        ..Changes::default()
    };
    twin.send(&request_frame(1, Request::Set(set)));
    for _ in 0..5 {
        assert_eq!(twin.tick(300, false), 0.0, "disarmed");
    }
    twin.send(&request_frame(2, Request::Arm));
    for count in [300, 250, 120, 30, 5, 2, 1] {
        assert_eq!(
            twin.tick(count, false),
            0.0,
            "armed, but deflected all the time"
        );
    }
    assert_ne!(twin.tick(0, false), 0.0);
    assert_ne!(twin.tick(50, false), 0.0);
    // Nor where the knob was at zero force while disarmed, and is not when it is armed.
    ask(&mut twin, Request::Disarm);
    twin.tick(0, false);
    twin.tick(40, false);
    twin.send(&request_frame(3, Request::Arm));
    assert_eq!(twin.tick(40, false), 0.0);
    assert_eq!(twin.tick(30, false), 0.0);
    twin.tick(0, false);
    assert_ne!(twin.tick(30, false), 0.0);
}

#[test]
fn what_is_refused_is_refused_by_name_and_changes_nothing() {
    let mut twin = Twin::new(0, "test");
    let mut refusal = |changes: Changes| {
        let answer = ask(&mut twin, Request::Set(changes));
        answer[0].read(|_, message| match message {
            Message::Refused(refusal) => Some(*refusal),
            Message::Done { .. } => None,
            other => panic!("{other:?}"),
        })
    };
    let name = |refusal: Option<Refusal>| match refusal {
        Some(Refusal::Value { name, .. }) => Some(name.as_str()),
        other => panic!("{other:?}"),
    };
    for bad in [f32::NAN, f32::INFINITY, -1.0, 2e4] {
        let changes = Changes {
            stiffness_nm_rad: Some(bad),
            ..Changes::default()
        };
        assert_eq!(name(refusal(changes)), Some("stiffness_nm_rad"), "{bad}");
    }
    let changes = Changes {
        sample_period_s: Some(0.05),
        ..Changes::default()
    };
    assert_eq!(name(refusal(changes)), Some("sample_period_s"));
    let changes = Changes {
        decimation: Some(4097),
        ..Changes::default()
    };
    assert_eq!(name(refusal(changes)), Some("decimation"));
    let swapped = Changes {
        viscous_nm_s_rad: Some(Interval {
            low: 2e-5,
            high: 1e-5,
        }),
        ..Changes::default()
    };
    assert!(matches!(refusal(swapped), Some(Refusal::Reversed { .. })));
    let get = ask(&mut twin, Request::Get);
    assert!(get[0].read(|_, message| *message == Message::Parameters(DEFAULTS)));

    ask(&mut twin, Request::Arm);
    for changes in [
        Changes {
            sample_period_s: Some(2e-3),
            ..Changes::default()
        },
        Changes {
            decimation: Some(2),
            ..Changes::default()
        },
        Changes {
            counts_per_rev: Some(4096),
            ..Changes::default()
        },
    ] {
        let answer = ask(&mut twin, Request::Set(changes));
        let armed =
            |message: &Message<'_>| matches!(message, Message::Refused(Refusal::Armed { .. }));
        assert!(answer[0].read(|_, message| armed(message)), "{changes:?}");
    }
}

#[test]
fn another_version_is_refused_with_the_one_that_is_spoken() {
    let mut twin = Twin::new(0, "test");
    let answer = ask(&mut twin, Request::Hello { version: 1 });
    assert!(
        answer[0].read(|_, message| *message == Message::Refused(Refusal::Version { accepted: 4 }))
    );
}

/// Anything, NaN too, and often what is accepted between two limits.
fn number(lowest: f32, highest: f32) -> impl Strategy<Value = f32> {
    let floor = lowest.max(1e-6).ln();
    prop_oneof![
        1 => any::<f32>(),
        1 => -2.0..2.0f32,
        2 => Just(lowest.max(0.0)),
        40 => (floor..highest.ln()).prop_map(f32::exp),
    ]
}

fn interval(lowest: Interval, highest: Interval) -> impl Strategy<Value = Interval> {
    let ends = (
        number(lowest.low, highest.low),
        number(lowest.high, highest.high),
    );
    // Now and then as they come, so perhaps reversed.
    (ends, 0..10).prop_map(|((a, b), swap)| {
        let (low, high) = if a <= b || swap == 0 { (a, b) } else { (b, a) };
        Interval { low, high }
    })
}

prop_compose! {
    /// Anything that a frame can carry.
    fn any_changes()(
        numbers in [
            (LOWEST.sample_period_s, HIGHEST.sample_period_s),
            (LOWEST.stiffness_nm_rad, HIGHEST.stiffness_nm_rad),
            (LOWEST.damping_nm_s_rad, HIGHEST.damping_nm_s_rad),
            (LOWEST.centre_rad, HIGHEST.centre_rad),
            (LOWEST.wall_rad, HIGHEST.wall_rad),
            (LOWEST.period_rad, HIGHEST.period_rad),
            (LOWEST.torque_max_nm, HIGHEST.torque_max_nm),
            (LOWEST.speed_max_rad_s, HIGHEST.speed_max_rad_s),
            (LOWEST.delay_s, HIGHEST.delay_s),
            (LOWEST.amplifier_tau_s, HIGHEST.amplifier_tau_s),
            (LOWEST.jitter_s, HIGHEST.jitter_s),
            (LOWEST.torque_step_nm, HIGHEST.torque_step_nm),
        ].map(|(lowest, highest)| prop::option::of(number(lowest, highest))),
        whole in prop::collection::vec(prop::option::of(prop_oneof![1 => any::<u32>(), 20 => 1..10_000u32]), 2),
        inertia_kg_m2 in prop::option::of(interval(LOWEST.inertia_kg_m2, HIGHEST.inertia_kg_m2)),
        viscous_nm_s_rad in prop::option::of(interval(LOWEST.viscous_nm_s_rad, HIGHEST.viscous_nm_s_rad)),
        coulomb_nm in prop::option::of(interval(LOWEST.coulomb_nm, HIGHEST.coulomb_nm)),
        law in prop::option::of(prop::sample::select(vec![Law::Raw, Law::Static, Law::Episode, Law::Ledger, Law::Auto])),
        shape in prop::option::of(prop::sample::select(vec![Shape::Spring, Shape::Wall, Shape::Detent])),
    ) -> Changes {
        Changes {
            sample_period_s: numbers[0],
            decimation: whole[0],
            counts_per_rev: whole[1],
            law,
            shape,
            stiffness_nm_rad: numbers[1],
            damping_nm_s_rad: numbers[2],
            centre_rad: numbers[3],
            wall_rad: numbers[4],
            period_rad: numbers[5],
            torque_max_nm: numbers[6],
            speed_max_rad_s: numbers[7],
            inertia_kg_m2,
            viscous_nm_s_rad,
            coulomb_nm,
            delay_s: numbers[8],
            amplifier_tau_s: numbers[9],
            jitter_s: numbers[10],
            torque_step_nm: numbers[11],
        }
    }
}

/// The counter from tick to tick: mostly a few counts further, now and then anywhere.
fn counters() -> impl Strategy<Value = Vec<u32>> {
    let step = prop_oneof![
        20 => -3..=3i32,
        5 => -300..300i32,
        1 => any::<i32>(),
    ];
    prop::collection::vec(step, 1..60).prop_map(|steps| {
        let mut counter = 0_i32;
        let walk = steps.into_iter().map(|step| {
            counter = counter.wrapping_add(step);
            counter as u32
        });
        walk.collect()
    })
}

/// What a set was answered with.
fn set(twin: &mut Twin, changes: Changes) -> Option<Refusal> {
    let answer = ask(twin, Request::Set(changes));
    answer[0].read(|_, message| match message {
        Message::Done { .. } => None,
        Message::Refused(refusal) => Some(*refusal),
        other => panic!("{other:?}"),
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5_000))]

    /// Whatever is set, it is taken whole or not at all, the torque stays finite and within its
    /// limit, and the device goes on answering. What is refused beside the others is not with either end of
    /// what is said to be accepted.
    #[test]
    fn no_set_gets_past_the_desk_that_the_tick_could_not_run_with(
        sets in prop::collection::vec((any_changes(), counters()), 1..4), arm in any::<bool>(),
    ) {
        let mut twin = Twin::new(0, "test");
        let mut want = DEFAULTS;
        let mut armed = false;
        for (changes, counters) in sets {
            match set(&mut twin, changes) {
                None => want = want.with(&changes),
                Some(Refusal::Together { name, lowest, highest }) => {
                    for accepted in [lowest, highest] {
                        let parameters = with(&want.with(&changes), name, accepted);
                        // Another may still be wrong.
                        let left = settle(&parameters, 32).err();
                        let same = |refusal| matches!(refusal, Refusal::Together { name: other, .. } if other == name);
                        prop_assert!(!left.is_some_and(same), "{name:?} {accepted} {parameters:?}");
                    }
                }
                Some(_) => {}
            }
            prop_assert!(settle(&want, 32).is_ok());
            let get = ask(&mut twin, Request::Get);
            prop_assert!(get[0].read(|_, message| *message == Message::Parameters(want)));
            if arm && !armed {
                ask(&mut twin, Request::Arm);
                armed = true;
            }
            for counter in counters {
                let torque = twin.tick(counter, false);
                prop_assert!(torque.is_finite() && torque.abs() <= want.torque_max_nm);
            }
            twin.take_output();
            let status = ask(&mut twin, Request::Status);
            let not_finite = State::Fault(protocol::Fault::TorqueNotFinite);
            let known = status.iter().any(|answer| answer.read(|_, message| matches!(
                message,
                Message::Status(status) if status.state != not_finite
            )));
            prop_assert!(known);
        }
    }
}

/// Parameters with one number of [`Refusal::Together`] changed.
fn with(parameters: &Parameters, name: Name, value: f32) -> Parameters {
    let mut all = *parameters;
    let place = match name {
        Name::CentreRad => &mut all.centre_rad,
        Name::WallRad => &mut all.wall_rad,
        Name::PeriodRad => &mut all.period_rad,
        Name::DelayS => &mut all.delay_s,
        Name::JitterS => &mut all.jitter_s,
        other => panic!("{other:?} goes together with anything"),
    };
    *place = value;
    all
}

#[test]
fn what_does_not_go_together_is_refused_with_what_would() {
    let together = |changes: Changes| match set(&mut Twin::new(0, "test"), changes) {
        Some(Refusal::Together {
            name,
            lowest,
            highest,
        }) => (name, lowest, highest),
        other => panic!("{other:?}"),
    };
    let none = Changes::default();
    for law in [Law::Ledger, Law::Auto] {
        let late = Changes {
            law: Some(law),
            delay_s: Some(0.9e-3),
            jitter_s: Some(0.2e-3),
            ..none
        };
        let (name, lowest, highest) = together(late);
        assert_eq!((name, lowest), (Name::DelayS, 0.0));
        assert!((highest - 0.8e-3).abs() < 1e-9);
    }
    let late = Changes {
        law: Some(Law::Static),
        delay_s: Some(5e-3),
        ..none
    };
    assert_eq!(
        set(&mut Twin::new(0, "test"), late),
        None,
        "only the ledger looks ahead"
    );
    let fine = Changes {
        shape: Some(Shape::Detent),
        period_rad: Some(1e-3),
        ..none
    };
    let (name, lowest, highest) = together(fine);
    assert_eq!(name, Name::PeriodRad);
    assert!((lowest - 2.0 * std::f32::consts::TAU / 8192.0).abs() < 1e-9 && highest > 1e5);
    let shaking = Changes {
        jitter_s: Some(1e-3),
        ..none
    };
    let (name, _, highest) = together(shaking);
    assert!(name == Name::JitterS && highest < 1e-3);
    let far = Changes {
        counts_per_rev: Some(1_000_000),
        wall_rad: Some(1e3),
        shape: Some(Shape::Wall),
        ..none
    };
    assert_eq!(
        set(&mut Twin::new(0, "test"), far),
        None,
        "1.6e8 counts can be counted"
    );
}

/// A jump is measured by what the knob can turn in the longest period that is believed.
#[test]
fn believed_jitter_gives_the_encoder_as_much_more_room() {
    let furthest = |jitter_s| {
        let parameters = Parameters {
            jitter_s,
            ..DEFAULTS
        };
        settle(&parameters, 32).unwrap().furthest_counts
    };
    assert_eq!(furthest(0.0), 1304);
    assert_eq!(furthest(0.5e-3), 1956);
}

#[test]
fn telemetry_tells_the_law_in_force_and_what_the_account_holds() {
    let mut twin = Twin::new(0, "test");
    let stiff = Changes {
        law: Some(Law::Auto),
        stiffness_nm_rad: Some(2.0),
        ..Changes::default()
    };
    let soft = Changes {
        stiffness_nm_rad: Some(0.01),
        ..Changes::default()
    };
    for request in [
        Request::Set(stiff),
        Request::Arm,
        Request::Subscribe(Subscription {
            every_ticks: 1,
            fields: Fields::ALL,
            clamp_events: false,
        }),
    ] {
        ask(&mut twin, request);
    }
    let told = |twin: &mut Twin, counter| {
        twin.take_output();
        twin.tick(counter, false);
        let told = answers(&mut Frames::new(), &twin.take_output());
        told[0].read(|_, message| match message {
            Message::Telemetry(telemetry) => *telemetry,
            other => panic!("{other:?}"),
        })
    };
    let mut most = 0.0_f32;
    for counter in 0..40 {
        let now = told(&mut twin, counter);
        // At rest where friction holds it the episode's spring will do; not at two counts a tick.
        let law = if counter == 0 {
            Law::Episode
        } else {
            Law::Ledger
        };
        assert_eq!((now.law, now.demanded_nm_rad), (Some(law), Some(2.0)));
        most = most.max(now.account_j.unwrap());
    }
    assert!(most > 0.0, "pushing the spring in pays in");
    twin.send(&request_frame(5, Request::Set(soft)));
    // At the centre the plain spring can do all that is demanded.
    for counter in (0..40).rev() {
        twin.tick(counter, false);
    }
    let now = told(&mut twin, 0);
    assert_eq!((now.law, now.account_j), (Some(Law::Static), Some(0.0)));
    assert_eq!(now.stiffness_nm_rad, Some(0.01));
}

/// Arming lets go under the ledger too: its account begins empty, and stays so at rest.
#[test]
fn arming_under_load_gives_no_more_torque_than_friction_holds() {
    for law in [Law::Ledger, Law::Auto] {
        let mut twin = Twin::new(0, "test");
        let changes = Changes {
            law: Some(law),
            stiffness_nm_rad: Some(2.0),
            ..Changes::default()
        };
        twin.send(&request_frame(1, Request::Set(changes)));
        for _ in 0..5 {
            assert_eq!(twin.tick(300, false), 0.0, "disarmed");
        }
        twin.send(&request_frame(2, Request::Arm));
        for _ in 0..200 {
            // 0.46 Nm are demanded.
            assert!(
                twin.tick(300, false).abs() < DEFAULTS.coulomb_nm.low,
                "{law:?}"
            );
        }
    }
}

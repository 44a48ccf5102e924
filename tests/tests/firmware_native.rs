//! The firmware without its board, run natively: limits, arming, and a line that is too slow.

use acceptance::{Answer, Twin, answers, request_frame};
use firmware::settings::{DEFAULTS, HIGHEST, LOWEST, settle};
use proptest::prelude::*;
use protocol::{
    Changes, Event, Fields, Frames, Interval, Law, Message, Refusal, Request, Shape, State,
    Subscription,
};

fn ask(twin: &mut Twin, request: Request) -> Vec<Answer> {
    twin.send(&request_frame(3, request));
    twin.tick(0, false);
    answers(&mut Frames::new(), &twin.take_output())
}

#[test]
fn the_defaults_settle_on_every_counter_and_so_do_the_limits() {
    for bits in [16, 32] {
        assert!(settle(&DEFAULTS, bits).is_ok());
        for edge in [LOWEST, HIGHEST] {
            // A wall or centre may be more counts away than there are; all else goes together.
            let near = protocol::Parameters {
                centre_rad: 0.0,
                wall_rad: 0.0,
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
    let answer = ask(&mut twin, Request::Hello { version: 2 });
    assert!(
        answer[0].read(|_, message| *message == Message::Refused(Refusal::Version { accepted: 1 }))
    );
}

fn interval() -> impl Strategy<Value = Interval> {
    (any::<f32>(), any::<f32>()).prop_map(|(low, high)| Interval { low, high })
}

prop_compose! {
    /// Anything that a frame can carry.
    fn any_changes()(
        numbers in prop::collection::vec(prop::option::of(prop_oneof![any::<f32>(), -2.0..2.0f32]), 6),
        whole in prop::collection::vec(prop::option::of(any::<u32>()), 2),
        intervals in prop::collection::vec(prop::option::of(interval()), 3),
        law in prop::option::of(prop::sample::select(vec![Law::Raw, Law::Static, Law::Episode])),
        shape in prop::option::of(prop::sample::select(vec![Shape::Spring, Shape::Wall])),
    ) -> Changes {
        Changes {
            sample_period_s: numbers[0],
            decimation: whole[0],
            counts_per_rev: whole[1],
            law,
            shape,
            stiffness_nm_rad: numbers[1],
            centre_rad: numbers[2],
            wall_rad: numbers[3],
            torque_max_nm: numbers[4],
            speed_max_rad_s: numbers[5],
            inertia_kg_m2: intervals[0],
            viscous_nm_s_rad: intervals[1],
            coulomb_nm: intervals[2],
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5_000))]

    /// Whatever is set, it is taken whole or not at all, the torque stays finite and within its
    /// limit, and the device goes on answering.
    #[test]
    fn no_set_gets_past_the_desk_that_the_tick_could_not_run_with(
        changes in any_changes(), counters in prop::collection::vec(any::<u32>(), 1..20), arm in any::<bool>(),
    ) {
        let mut twin = Twin::new(0, "test");
        if arm {
            ask(&mut twin, Request::Arm);
        }
        let answer = ask(&mut twin, Request::Set(changes));
        let done = answer[0].read(|_, message| match message {
            Message::Done { .. } => true,
            Message::Refused(_) => false,
            other => panic!("{other:?}"),
        });
        let want = if done { DEFAULTS.with(&changes) } else { DEFAULTS };
        prop_assert!(!done || settle(&want, 32).is_ok());
        let get = ask(&mut twin, Request::Get);
        prop_assert!(get[0].read(|_, message| *message == Message::Parameters(want)));
        for counter in counters {
            let torque = twin.tick(counter, false);
            prop_assert!(torque.is_finite() && torque.abs() <= want.torque_max_nm);
        }
        let status = ask(&mut twin, Request::Status);
        let known = status.iter().any(|answer| answer.read(|_, message| matches!(
            message,
            Message::Status(status) if matches!(status.state, State::Disarmed | State::Armed | State::Fault(_))
        )));
        prop_assert!(known);
    }
}

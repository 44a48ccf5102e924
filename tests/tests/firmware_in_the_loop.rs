//! The firmware's image in the emulator against the exact plant, its native twin beside it.
//!
//! [`Rig`] compares every torque and every serial byte of the two, so every test here is also
//! one of bit equality.

use std::collections::BTreeSet;

use acceptance::{Rig, request_frame};
use control::criterion::Device;
use plant_sim::clock::Clock;
use plant_sim::closed_loop::Scene;
use plant_sim::drive::Drive;
use plant_sim::hand::Hand;
use plant_sim::hold::State as Motion;
use plant_sim::lockstep::{LockstepError, Order, Plant};
use plant_sim::motor::Motor;
use plant_sim::outcome::Class;
use plant_sim::preset::preset;
use protocol::{
    Changes, ClampReason, Event, Fault, Fields, Interval, Law, Message, Name, Push, PushEnd,
    Refusal, Request, Shape, State, Subscription,
};

fn re35() -> Device<f64> {
    preset("re35").unwrap().device
}

fn rig(counts_per_rev: f64) -> Rig {
    Rig::start(Plant::new(re35(), counts_per_rev, 0.0).unwrap())
}

fn law(law: Law, stiffness: f32) -> Changes {
    Changes {
        law: Some(law),
        stiffness_nm_rad: Some(stiffness),
        torque_max_nm: Some(10.0),
        ..Changes::default()
    }
}

/// Sets up over serial, arms, and lets the hand throw the knob.
fn throw(rig: &mut Rig, changes: Changes, velocity: f64) {
    rig.must(Request::Set(changes));
    rig.must(Request::Arm);
    rig.bench.plant.let_go(velocity);
}

/// A generator of test bytes that is the same everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    /// Between −1 and 1.
    fn share(&mut self) -> f64 {
        self.below(1 << 32) as f64 / f64::from(1_u32 << 31) - 1.0
    }
}

const LAWS: [Law; 5] = [Law::Raw, Law::Static, Law::Episode, Law::Ledger, Law::Auto];
const SHAPES: [Shape; 3] = [Shape::Spring, Shape::Wall, Shape::Detent];

/// What was seen of the controller in a run.
#[derive(Default)]
struct Seen {
    hash: u64,
    laws: BTreeSet<String>,
    reasons: BTreeSet<String>,
    /// Sets that were taken while torque was given, without letting go of the knob.
    in_contact: u32,
}

/// A change of law, shape, demand or what is believed, as it may come at any time.
fn any_change(random: &mut Random) -> Changes {
    let mut changes = law(
        LAWS[random.below(5) as usize],
        (random.share() * 2.0).exp() as f32,
    );
    changes.shape = Some(SHAPES[random.below(3) as usize]);
    changes.damping_nm_s_rad = Some([0.0, 1e-5, 1e-3][random.below(3) as usize]);
    if random.below(3) == 0 {
        changes.centre_rad = Some(random.share() as f32 * 0.1);
        changes.wall_rad = Some(random.share() as f32 * 0.1);
        changes.period_rad = Some(0.3 + 0.2 * random.share() as f32);
    }
    if random.below(4) == 0 {
        changes.coulomb_nm = Some(Interval {
            low: 1e-3 * (1.0 + random.share() as f32),
            high: 3e-3,
        });
    }
    if random.below(4) == 0 {
        // Together less than the shortest period below.
        changes.delay_s = Some([0.0, 5e-5][random.below(2) as usize]);
        changes.jitter_s = Some([0.0, 5e-5][random.below(2) as usize]);
        changes.amplifier_tau_s = Some([0.0, 2e-4][random.below(2) as usize]);
        changes.torque_step_nm = Some([0.0, 1e-3][random.below(2) as usize]);
    }
    changes
}

/// Shapes, laws, stiffnesses, damping, centres, periods, decimations and what is believed, which
/// change at random times over serial, while a hand throws and pushes the knob.
fn busy_run(seed: u64, ticks: u64) -> Seen {
    let mut rig = rig(8192.0);
    let mut random = Random(seed);
    let mut seen = Seen::default();
    rig.must(Request::Subscribe(Subscription {
        every_ticks: 7,
        fields: Fields::ALL,
        clamp_events: true,
    }));
    rig.must(Request::Arm);
    while rig.ticks < ticks {
        let mut changes = any_change(&mut random);
        if random.below(6) == 0 {
            rig.must(Request::Disarm);
            changes.sample_period_s = Some(1e-3 * (random.share() * 2.0).exp() as f32);
            changes.decimation = Some(1 + random.below(40) as u32);
            rig.must(Request::Set(changes));
            rig.must(Request::Arm);
        } else {
            rig.must(Request::Set(changes));
        }
        rig.bench.plant.hold_at(random.share() * 0.02);
        rig.bench.plant.push(random.share() * 0.01);
        rig.bench.plant.let_go(random.share() * 20.0);
        for _ in 0..1 + random.below(4) {
            for _ in 0..random.below(200) {
                rig.tick();
                // A raw spring that runs away is caught again.
                if rig.bench.plant.state().velocity.abs() > 200.0 {
                    rig.bench.plant.hold_at(0.0);
                }
            }
            seen.in_contact += u32::from(rig.bench.emulator.report().torque_nm != 0.0);
            rig.must(Request::Set(any_change(&mut random)));
        }
        let fault = rig.ask(Request::Status, |message| match message {
            Message::Status(status) => matches!(status.state, State::Fault(_)),
            other => panic!("{other:?}"),
        });
        if fault {
            rig.must(Request::Clear);
            rig.must(Request::Arm);
        }
        for message in rig.take_messages() {
            message.read(|_, message| {
                if let Message::Telemetry(telemetry) = message {
                    seen.laws.insert(format!("{:?}", telemetry.law));
                    seen.reasons.insert(format!("{:?}", telemetry.reason));
                }
            });
        }
    }
    seen.hash = rig.hash();
    seen
}

#[test]
fn the_chip_gives_the_torque_of_its_native_twin_to_the_last_bit_and_twice_the_same() {
    let first = busy_run(0x5eed, 110_000);
    assert_eq!(
        first.hash,
        busy_run(0x5eed, 110_000).hash,
        "two runs differ"
    );
    assert_ne!(first.hash, busy_run(0xbeef, 5_000).hash);
    println!("{:?}, {:?}", first.laws, first.reasons);
    // Auto is never itself in force.
    assert_eq!(first.laws.len(), 4);
    assert_eq!(first.reasons.len(), 10, "every reason comes up");
    assert!(
        first.in_contact > 100,
        "{} changes in contact",
        first.in_contact
    );
}

#[test]
fn figure_6_holds_in_the_firmware_set_up_over_serial_alone() {
    // counts/rev of the encoder, decimation, K, start, outcome.
    for (counts, decimation, stiffness, velocity, class) in [
        (8192, 1, 0.015, 30.0, Class::Rest),
        (8200, 410, 0.015, 12.0, Class::LimitCycle), // 20 counts by decimation
        (8192, 1, 1.0, 3.0, Class::Rest),
        (8192, 1, 1.0, 7.0, Class::Unstable),
    ] {
        let mut rig = rig(f64::from(counts));
        let changes = Changes {
            counts_per_rev: Some(counts),
            decimation: Some(decimation),
            ..law(Law::Raw, stiffness)
        };
        throw(&mut rig, changes, velocity);
        // The same scene natively, by the same controller: sample for sample the same run.
        let parameters = firmware::settings::DEFAULTS.with(&changes);
        let scene = Scene {
            device: re35(),
            motor: Motor::default(),
            drive: Drive::default(),
            clock: Clock {
                period_s: f64::from(parameters.sample_period_s),
                jitter_s: 0.0,
                missed_ticks: 0.0,
            },
            hand: Hand::default(),
            config: firmware::settings::config(&parameters, 32).unwrap(),
            seed: 0,
            start: Motion {
                position: 0.0,
                velocity,
            },
            samples: 2000,
        };
        let mut differing = 0;
        let report = scene
            .run(|sample| {
                // Armed at rest: the spring is on from the first tick on.
                differing += u32::from(rig.bench.plant.state() != sample.state);
                assert_eq!(rig.tick().to_bits(), sample.tick.torque_nm.to_bits());
                true
            })
            .unwrap();
        assert_eq!(differing, 0);
        assert_eq!(report.class, class, "K {stiffness}, {velocity} rad/s");
    }
}

#[test]
fn the_static_law_tames_what_the_raw_one_lets_grow() {
    for (counts, decimation) in [(8192, 1), (8200, 410)] {
        let mut rig = rig(f64::from(counts));
        let changes = Changes {
            counts_per_rev: Some(counts),
            decimation: Some(decimation),
            ..law(Law::Static, 1.0)
        };
        throw(&mut rig, changes, 7.0);
        rig.ticks(4000);
        assert_eq!(rig.bench.plant.state().velocity, 0.0);
        let status = rig.ask(
            Request::Subscribe(Subscription {
                every_ticks: 1,
                fields: Fields::ALL,
                clamp_events: false,
            }),
            |message| matches!(message, Message::Done { .. }),
        );
        assert!(status);
        rig.tick();
        let told = rig.take_messages();
        told[0].read(|_, message| match message {
            Message::Telemetry(telemetry) => {
                assert_eq!(telemetry.demanded_nm_rad, Some(1.0));
                assert!(telemetry.stiffness_nm_rad.unwrap() <= 0.0181);
                assert!(telemetry.margin_nm.unwrap() >= -1e-9);
                let coarse = decimation > 1;
                let reason = if coarse {
                    ClampReason::Coulomb
                } else {
                    ClampReason::Viscous
                };
                assert_eq!(telemetry.reason, Some(reason));
            }
            other => panic!("{other:?}"),
        });
    }
}

#[test]
fn the_ledger_holds_two_hundred_times_the_static_stiffness_and_rests() {
    for (which, stiffness) in [(Law::Ledger, 4.0), (Law::Auto, 4.0), (Law::Auto, 0.01)] {
        let mut rig = rig(8192.0);
        throw(&mut rig, law(which, stiffness), 7.0);
        let mut fastest = 0.0_f64;
        for _ in 0..4000 {
            rig.tick();
            fastest = fastest.max(rig.bench.plant.state().velocity.abs());
        }
        assert_eq!(rig.bench.plant.state().velocity, 0.0);
        assert!(
            fastest <= 7.0,
            "it was thrown at 7 rad/s and reached {fastest}"
        );
    }
}

#[test]
fn telemetry_at_every_tick_comes_without_a_gap() {
    let mut rig = rig(8192.0);
    rig.must(Request::Subscribe(Subscription {
        every_ticks: 1,
        fields: Fields::ALL,
        clamp_events: false,
    }));
    rig.take_messages();
    rig.ticks(5000);
    let mut last = None;
    let messages = rig.take_messages();
    assert_eq!(messages.len(), 5000);
    for message in messages {
        let tick = message.read(|_, message| match message {
            Message::Telemetry(telemetry) => telemetry.tick,
            other => panic!("{other:?}"),
        });
        assert!(last.is_none_or(|last| tick == last + 1));
        last = Some(tick);
    }
}

#[test]
fn a_late_tick_and_a_jump_put_torque_to_zero_at_once_and_stay() {
    let mut rig = rig(8192.0);
    for (cause, fault) in [
        (Order::LateTick, Fault::Overrun),
        (Order::Tick, Fault::EncoderJump { counts: 2000 }),
    ] {
        rig.bench.plant.hold_at(0.0);
        rig.must(Request::Set(law(Law::Raw, 1.0)));
        rig.must(Request::Arm);
        rig.tick();
        rig.bench.plant.hold_at(0.01);
        rig.ticks(3);
        assert_ne!(rig.bench.emulator.report().torque_nm, 0.0);
        if fault != Fault::Overrun {
            // Two thousand counts in a millisecond: 1534 rad/s, beyond the limit of 1000.
            rig.bench
                .plant
                .hold_at(0.01 + 2000.0 * std::f64::consts::TAU / 8192.0);
        }
        assert_eq!(rig.tick_with(cause), 0.0, "torque in the tick of {fault:?}");
        rig.ticks(50);
        assert_eq!(rig.bench.emulator.report().torque_nm, 0.0);
        let told = rig.take_messages();
        assert!(told.iter().any(|message| message.read(|_, message| {
            matches!(message, Message::Event(Event::Fault { fault: told, .. }) if *told == fault)
        })));
        assert_eq!(
            rig.refused(Request::Arm),
            Refusal::State(State::Fault(fault))
        );
        rig.must(Request::Clear);
        assert_eq!(rig.tick(), 0.0, "cleared, but disarmed");
        rig.refused(Request::Clear);
    }
}

#[test]
fn a_panic_and_a_hard_fault_turn_torque_off_first_and_are_reported() {
    for (order, code) in [(Order::Panic, 101), (Order::HardFault, 102)] {
        let mut rig = rig(8192.0);
        rig.must(Request::Set(law(Law::Raw, 1.0)));
        rig.must(Request::Arm);
        rig.tick();
        rig.bench.plant.hold_at(0.01);
        assert_ne!(rig.tick(), 0.0);
        let report = rig.bench.emulator.exchange(order, 0).unwrap();
        assert_eq!(report.torque_nm, 0.0);
        match rig.bench.emulator.exchange(Order::Tick, 0) {
            Err(LockstepError::Ended(status)) => assert_eq!(status.code(), Some(code)),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn period_and_encoder_change_only_while_disarmed_and_sets_are_all_or_none() {
    let mut rig = rig(8192.0);
    rig.must(Request::Set(law(Law::Raw, 0.5)));
    rig.must(Request::Arm);
    let parameters = |rig: &mut Rig| {
        rig.ask(Request::Get, |message| match message {
            Message::Parameters(parameters) => *parameters,
            other => panic!("{other:?}"),
        })
    };
    let before = parameters(&mut rig);
    let slow = Changes {
        stiffness_nm_rad: Some(0.1),
        sample_period_s: Some(2e-3),
        ..Changes::default()
    };
    let name = Name::SamplePeriodS;
    assert_eq!(rig.refused(Request::Set(slow)), Refusal::Armed { name });
    for (changes, name) in [
        (
            Changes {
                stiffness_nm_rad: Some(f32::NAN),
                law: Some(Law::Static),
                ..Changes::default()
            },
            Name::StiffnessNmRad,
        ),
        (
            Changes {
                torque_max_nm: Some(f32::INFINITY),
                stiffness_nm_rad: Some(1.0),
                ..Changes::default()
            },
            Name::TorqueMaxNm,
        ),
        (
            Changes {
                wall_rad: Some(-1e9),
                ..Changes::default()
            },
            Name::WallRad,
        ),
        (
            Changes {
                decimation: Some(0),
                ..Changes::default()
            },
            Name::Decimation,
        ),
        (
            Changes {
                sample_period_s: Some(1e-6),
                ..Changes::default()
            },
            Name::SamplePeriodS,
        ),
    ] {
        match rig.refused(Request::Set(changes)) {
            Refusal::Value { name: refused, .. } => assert_eq!(refused, name),
            other => panic!("{other:?}"),
        }
    }
    let reversed = Changes {
        coulomb_nm: Some(Interval {
            low: 2e-3,
            high: 1e-3,
        }),
        ..Changes::default()
    };
    assert!(matches!(
        rig.refused(Request::Set(reversed)),
        Refusal::Reversed { .. }
    ));
    assert_eq!(parameters(&mut rig), before, "nothing was half applied");
    rig.must(Request::Disarm);
    rig.must(Request::Set(slow));
    assert_eq!(parameters(&mut rig), before.with(&slow));
    assert_eq!(rig.bench.emulator.report().period_s, 2e-3);
    assert_eq!(rig.refused(Request::Save), Refusal::NoStorage);
}

/// A million bytes of garbage, torn and merged frames, bad checksums, every message truncated
/// at every length: no panic, no missed tick, no parameter changed, and the next good frame is answered.
#[test]
fn serial_torture() {
    let mut rig = rig(8192.0);
    let mut random = Random(0xbad);
    rig.must(Request::Set(law(Law::Episode, 2.0)));
    rig.must(Request::Arm);
    rig.bench.plant.let_go(5.0);
    let parameters = |rig: &mut Rig| {
        rig.ask(Request::Get, |message| match message {
            Message::Parameters(parameters) => *parameters,
            other => panic!("{other:?}"),
        })
    };
    let before = parameters(&mut rig);
    // No request here changes anything, whole or in pieces.
    let requests = [
        Request::Hello {
            version: protocol::VERSION,
        },
        Request::Hello { version: 9 },
        Request::Get,
        Request::Set(Changes {
            stiffness_nm_rad: Some(f32::NAN),
            ..Changes::default()
        }),
        Request::Set(Changes {
            coulomb_nm: Some(Interval {
                low: -1.0,
                high: f32::INFINITY,
            }),
            ..Changes::default()
        }),
        Request::Arm,
        Request::Clear,
        Request::Save,
        Request::Status,
        Request::Subscribe(Subscription::default()),
    ];
    let ticks_before = rig.ticks;
    let mut bytes = 0;
    for request in requests {
        let frame = request_frame(77, request);
        for length in 0..frame.len() {
            let mut torn = frame[..length].to_vec();
            torn.push(0);
            rig.send(&torn);
            rig.tick();
        }
        for bit in 0..8 * (frame.len() - 1) {
            let mut wrong = frame.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            rig.send(&wrong);
            rig.tick();
        }
        // Merged without a delimiter between, then two good ones at once.
        let mut merged = frame[..frame.len() - 1].to_vec();
        merged.extend_from_slice(&frame);
        merged.extend_from_slice(&frame);
        merged.extend_from_slice(&frame);
        rig.send(&merged);
        rig.ticks(4);
    }
    while bytes < 1_000_000 {
        let length = 1 + random.below(400) as usize;
        let garbage: Vec<u8> = (0..length).map(|_| random.next() as u8).collect();
        rig.send(&garbage);
        rig.tick();
        bytes += length;
    }
    rig.send(&[0]);
    rig.take_messages();
    assert_eq!(parameters(&mut rig), before, "no parameter was touched");
    let (tick, bad) = rig.ask(Request::Status, |message| match message {
        Message::Status(status) => (status.tick, status.bad_frames),
        other => panic!("{other:?}"),
    });
    assert_eq!(u64::from(tick), rig.ticks, "no tick was missed");
    assert!(bad > 1000, "{bad} bad frames were counted");
    println!(
        "{} ticks, {bytes} random bytes, {bad} bad frames",
        rig.ticks - ticks_before
    );
}

/// Torques of a push, the moves that are told, and how it ends: on the chip as natively.
#[test]
fn the_chip_plays_a_push_as_its_native_twin_does() {
    let mut rig = rig(8192.0);
    rig.bench.plant.let_go(0.0);
    let push = Push {
        from_nm: 1e-3,
        to_nm: 5e-3,
        rise_ticks: 30,
        most_ticks: 60,
        way_counts: 400,
        speed_counts: 60,
        rest_ticks: 150,
        coast_ticks: 5000,
        guard_counts: 8192,
    };
    rig.must(Request::Push(push));
    rig.ticks(1000);
    let mut ticks = 0;
    let mut end = None;
    for message in rig.take_messages() {
        message.read(|_, message| {
            if let Message::Moves(moves) = message {
                ticks += moves.moves.len() / 2;
                end = moves.end;
            }
        });
    }
    assert_eq!(end, Some(PushEnd::Rest));
    assert!(ticks > 250, "{ticks}");
    let turned = rig.bench.plant.state().position;
    assert!(turned > 0.1, "{turned} rad");
    // Something runs away with it.
    rig.must(Request::Push(push));
    rig.bench.plant.let_go(500.0);
    rig.ticks(30);
    rig.ask(Request::Status, |message| match message {
        Message::Status(status) => assert_eq!(status.state, State::Fault(Fault::Guard)),
        other => panic!("{other:?}"),
    });
}

//! The wire: golden frames, lengths, damage.

use proptest::prelude::*;
use protocol::{
    Calibrate, CalibrationEnd, Changes, ClampReason, Drive, Event, FRAME_MAX, Fault, Fields,
    FrameError, Frames, FromDevice, Hello, Interval, Law, MOVES_MAX, Message, Motor, MotorChanges,
    Moves, Name, Parameters, Push, PushEnd, Refusal, Request, ResetReason, Shape, Snapshot, Stage,
    State, Status, Stored, Subscription, Telemetry, ToDevice, VERSION, decode, encode,
};

/// The page that describes the wire; its golden frames are those tested here.
const PAGE: &str = include_str!("../../docs/protocol.md");

const PARAMETERS: Parameters = Parameters {
    sample_period_s: 1e-3,
    decimation: 1,
    counts_per_rev: 8192,
    law: Law::Static,
    shape: Shape::Spring,
    stiffness_nm_rad: 0.015,
    damping_nm_s_rad: 1e-5,
    centre_rad: 0.0,
    wall_rad: 0.25,
    period_rad: 0.2,
    torque_max_nm: 0.5,
    speed_max_rad_s: 1000.0,
    inertia_kg_m2: Interval {
        low: 6.28e-6,
        high: 6.28e-6,
    },
    viscous_nm_s_rad: Interval {
        low: 9e-6,
        high: 9e-6,
    },
    coulomb_nm: Interval {
        low: 1.8e-3,
        high: 2.2e-3,
    },
    delay_s: 1e-4,
    amplifier_tau_s: 2e-4,
    jitter_s: 5e-5,
    torque_step_nm: 1e-3,
};

const MOTOR: Motor = Motor {
    drive: Drive::Brushed,
    pole_pairs: 1,
    resistance_ohm: 0.611,
    d_inductance_h: 1.19e-4,
    q_inductance_h: 1.19e-4,
    torque_constant_nm_a: 0.0292,
    current_max_a: 4.0,
    reversed: true,
    zero_turns: 0.25,
    offset_b_codes: 2050.5,
    offset_c_codes: 2047.0,
};

fn requests() -> Vec<(&'static str, Request)> {
    vec![
        ("hello", Request::Hello { version: VERSION }),
        ("get", Request::Get),
        (
            "set stiffness_nm_rad=1 law=raw",
            Request::Set(Changes {
                stiffness_nm_rad: Some(1.0),
                law: Some(Law::Raw),
                ..Changes::default()
            }),
        ),
        (
            "set law=auto shape=detent period_rad=0.5",
            Request::Set(Changes {
                law: Some(Law::Auto),
                shape: Some(Shape::Detent),
                period_rad: Some(0.5),
                ..Changes::default()
            }),
        ),
        ("arm", Request::Arm),
        ("disarm", Request::Disarm),
        ("clear", Request::Clear),
        ("save", Request::Save),
        (
            "subscribe, every 10 ticks, all fields",
            Request::Subscribe(Subscription {
                every_ticks: 10,
                fields: Fields::ALL,
                clamp_events: true,
            }),
        ),
        ("status", Request::Status),
        ("reset-settings", Request::ResetSettings),
        ("motor", Request::Motor),
        (
            "set motor, drive=current pole_pairs=7",
            Request::SetMotor(MotorChanges {
                drive: Some(Drive::Current),
                pole_pairs: Some(7),
                ..MotorChanges::default()
            }),
        ),
        ("last fault", Request::LastFault),
        (
            "calibrate",
            Request::Calibrate(Calibrate {
                drive: Drive::Brushed,
                current_max_a: 2.0,
            }),
        ),
        (
            "push",
            Request::Push(Push {
                from_nm: 0.0,
                to_nm: 0.01,
                rise_ticks: 300,
                most_ticks: 1000,
                way_counts: 500,
                speed_counts: 40,
                rest_ticks: 150,
                coast_ticks: 2000,
                guard_counts: 8192,
            }),
        ),
    ]
}

fn messages() -> Vec<(&'static str, Message<'static>)> {
    vec![
        ("parameters", Message::Parameters(PARAMETERS)),
        ("done in tick 1000", Message::Done { tick: 1000 }),
        (
            "refused, value",
            Message::Refused(Refusal::Value {
                name: Name::SamplePeriodS,
                given: 0.05,
                lowest: 40e-6,
                highest: 0.02,
            }),
        ),
        (
            "refused, together",
            Message::Refused(Refusal::Together {
                name: Name::DelayS,
                lowest: 0.0,
                highest: 1e-3,
            }),
        ),
        (
            "status, fault",
            Message::Status(Status {
                tick: 300,
                state: State::Fault(Fault::EncoderJump { counts: -2000 }),
                dropped: 2,
                bad_frames: 1,
                stored: Stored::Version { found: 300 },
                reset: ResetReason::Watchdog,
            }),
        ),
        (
            "telemetry, all fields",
            Message::Telemetry(Telemetry {
                tick: 123_456,
                state: State::Armed,
                count: Some(-17),
                torque_nm: Some(0.25),
                stiffness_nm_rad: Some(0.018),
                demanded_nm_rad: Some(1.0),
                margin_nm: Some(0.001),
                reason: Some(ClampReason::Account),
                law: Some(Law::Ledger),
                account_j: Some(2e-5),
            }),
        ),
        (
            "event, clamp",
            Message::Event(Event::Clamp {
                tick: 5,
                reason: ClampReason::Coulomb,
                stiffness_nm_rad: 0.0127,
            }),
        ),
        (
            "event, fault",
            Message::Event(Event::Fault {
                tick: 6,
                fault: Fault::Overrun,
            }),
        ),
        (
            "event, measured",
            Message::Event(Event::Measured {
                stage: Stage::Resistance,
                index: 2,
                values: [1.0, 0.5, 0.25, 0.0],
            }),
        ),
        (
            "event, calibrated",
            Message::Event(Event::Calibrated {
                end: CalibrationEnd::Failed {
                    stage: Stage::Turn,
                    reason: 3,
                },
            }),
        ),
        ("motor, brushed", Message::Motor(MOTOR)),
        (
            "snapshot, over-current",
            Message::Snapshot(Some(Snapshot {
                tick: 4000,
                fault: Fault::OverCurrent { current_a: 31.5 },
                count: -5,
                moved: 1,
                torque_nm: 0.25,
                current_b_a: 31.5,
                current_c_a: -30.0,
                bus_v: 24.0,
                temperature_c: 40.0,
                gate_driver: [0x400, 1],
            })),
        ),
        (
            "moves",
            Message::Moves(Moves {
                first: 64,
                from: -12,
                released: Some(66),
                end: None,
                moves: &[0, 0, 1, 0, 0xFF, 0xFF],
            }),
        ),
        (
            "moves, the last",
            Message::Moves(Moves {
                first: 112,
                from: 40,
                released: Some(66),
                end: Some(PushEnd::Rest),
                moves: &[2, 0],
            }),
        ),
    ]
}

fn to_device(request: Request) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    encode(
        &ToDevice {
            sequence: 7,
            request,
        },
        &mut buffer,
    )
    .unwrap()
    .to_vec()
}

fn from_device(message: Message<'_>) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    encode(
        &FromDevice {
            sequence: 7,
            message,
        },
        &mut buffer,
    )
    .unwrap()
    .to_vec()
}

/// Rows of the page: | `name` | `hex` |.
fn golden(name: &str) -> Vec<u8> {
    let start = format!("| {name} | `");
    let row = PAGE.lines().find(|line| line.starts_with(&start));
    let row = row.unwrap_or_else(|| panic!("docs/protocol.md has no frame for {name}"));
    let hex = row[start.len()..].trim_end_matches([' ', '|', '`']);
    let byte = |text: &str| u8::from_str_radix(text, 16).unwrap();
    hex.split(' ').map(byte).collect()
}

#[test]
fn the_golden_frames_of_the_page_are_what_is_sent() {
    // What the page should say, for whoever changes the protocol.
    for (name, request) in requests() {
        println!("| {name} | `{}` |", hex(&to_device(request)));
    }
    for (name, message) in messages() {
        println!("| {name} | `{}` |", hex(&from_device(message)));
    }
    for (name, request) in requests() {
        let frame = to_device(request);
        assert_eq!(frame, golden(name), "{name}");
        assert_eq!(
            decode(&mut golden(name)),
            Ok(ToDevice {
                sequence: 7,
                request
            })
        );
    }
    for (name, message) in messages() {
        let frame = from_device(message);
        assert_eq!(frame, golden(name), "{name}");
        assert_eq!(
            decode(&mut golden(name)),
            Ok(FromDevice {
                sequence: 7,
                message
            })
        );
    }
}

fn hex(bytes: &[u8]) -> String {
    let texts: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    texts.join(" ")
}

/// The page's checksum, worked out bit by bit as a client in another language would.
#[test]
fn the_checksum_is_the_one_described() {
    let mut frame = to_device(Request::Get);
    let body_end = cobs_length(&mut frame);
    let (body, sum) = frame[..body_end].split_at(body_end - 4);
    let mut crc = u32::MAX;
    for byte in body {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 == 1 { 0x82F6_3B78 } else { 0 };
        }
    }
    assert_eq!(sum, (!crc).to_le_bytes());
}

/// Decodes COBS in place, as the page tells it, and returns the length.
fn cobs_length(frame: &mut [u8]) -> usize {
    let (mut read, mut write) = (0, 0);
    while frame[read] != 0 {
        let code = usize::from(frame[read]);
        for i in 1..code {
            frame[write] = frame[read + i];
            write += 1;
        }
        read += code;
        if code < 255 && frame[read] != 0 {
            frame[write] = 0;
            write += 1;
        }
    }
    write
}

#[test]
fn the_longest_of_every_message_fits_a_frame() {
    let interval = Interval {
        low: f32::MAX,
        high: f32::MAX,
    };
    let parameters = Parameters {
        decimation: u32::MAX,
        counts_per_rev: u32::MAX,
        inertia_kg_m2: interval,
        ..PARAMETERS
    };
    let changes = Changes {
        sample_period_s: Some(1.0),
        decimation: Some(u32::MAX),
        counts_per_rev: Some(u32::MAX),
        law: Some(Law::Auto),
        shape: Some(Shape::Detent),
        stiffness_nm_rad: Some(1.0),
        damping_nm_s_rad: Some(1.0),
        centre_rad: Some(1.0),
        wall_rad: Some(1.0),
        period_rad: Some(1.0),
        torque_max_nm: Some(1.0),
        speed_max_rad_s: Some(1.0),
        inertia_kg_m2: Some(interval),
        viscous_nm_s_rad: Some(interval),
        coulomb_nm: Some(interval),
        delay_s: Some(1.0),
        amplifier_tau_s: Some(1.0),
        jitter_s: Some(1.0),
        torque_step_nm: Some(1.0),
    };
    assert!(to_device(Request::Set(changes)).len() <= FRAME_MAX);
    let hello = Message::Hello(Hello {
        version: u16::MAX,
        firmware: "123.456.789-something",
        git_hash: "0123456789ab-dirty",
        board: "a board with a long name",
        lowest: parameters,
        highest: parameters,
    });
    assert!(
        from_device(hello).len() <= FRAME_MAX,
        "{}",
        from_device(hello).len()
    );
    let moves = Message::Moves(Moves {
        first: u32::MAX,
        from: i32::MIN,
        released: Some(u32::MAX),
        end: Some(PushEnd::NoRoom),
        moves: &[0xFF; MOVES_MAX],
    });
    assert!(from_device(moves).len() <= FRAME_MAX);
}

proptest! {
    #[test]
    fn garbage_is_never_a_message_and_the_next_frame_always_is(
        garbage in prop::collection::vec(any::<u8>(), 0..2000), which in 0..requests().len(),
    ) {
        let (_, request) = requests()[which];
        let mut bytes = garbage;
        bytes.push(0);
        bytes.extend(to_device(request));
        let mut frames = Frames::new();
        let mut last = None;
        for byte in bytes {
            if let Some(frame) = frames.push(byte) {
                last = Some(frame.and_then(decode::<ToDevice>));
            }
        }
        prop_assert_eq!(last, Some(Ok(ToDevice { sequence: 7, request })));
    }

    #[test]
    fn a_damaged_frame_is_refused(which in 0..requests().len(), bit in 0usize..400, cut in 0usize..50) {
        let (_, request) = requests()[which];
        let frame = to_device(request);
        let mut wrong = frame.clone();
        let bit = bit % (8 * (frame.len() - 1));
        wrong[bit / 8] ^= 1 << (bit % 8);
        prop_assert!(decode::<ToDevice>(&mut wrong).is_err());
        let mut torn = frame[..cut % (frame.len() - 1)].to_vec();
        prop_assert!(decode::<ToDevice>(&mut torn).is_err());
    }
}

#[test]
fn a_frame_that_is_too_long_is_said_to_be_and_forgotten() {
    let mut frames = Frames::new();
    for _ in 0..10 * FRAME_MAX {
        assert!(frames.push(1).is_none());
    }
    assert_eq!(frames.push(0), Some(Err(FrameError::TooLong)));
    assert_eq!(frames.push(0), None);
    let mut buffer = [0; 4];
    assert_eq!(
        encode(&requests()[0].1, &mut buffer),
        Err(FrameError::TooLong)
    );
}

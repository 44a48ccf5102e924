//! Pushes on the firmware without its board: within limits, over by themselves, and told as they were.

use acceptance::{Answer, Twin, answers, request_frame};
use firmware::settings::{COAST_MOST_S, DEFAULTS, PUSH_MOST_S};
use proptest::prelude::*;
use protocol::{Changes, Fault, Frames, Message, Push, PushEnd, Refusal, Request, State};

const PUSH: Push = Push {
    from_nm: 0.05,
    to_nm: 0.1,
    rise_ticks: 10,
    most_ticks: 40,
    way_counts: 1000,
    speed_counts: 100,
    rest_ticks: 20,
    coast_ticks: 200,
    guard_counts: 5000,
};

/// What the host heard of a push.
#[derive(Debug, Default, PartialEq)]
struct Heard {
    from: Option<i32>,
    moves: Vec<i32>,
    released: Option<u32>,
    end: Option<PushEnd>,
    /// Moves that came after the end.
    late: usize,
}

impl Heard {
    /// Takes what was sent; every message must go on where the last one ended.
    fn add(&mut self, told: &[Answer]) {
        for answer in told {
            answer.read(|_, message| {
                let Message::Moves(moves) = message else {
                    return;
                };
                if self.end.is_some() {
                    self.late += 1;
                }
                assert_eq!(moves.first as usize, self.moves.len());
                let from = *self.from.get_or_insert(moves.from);
                assert_eq!(moves.from, from.wrapping_add(self.moves.iter().sum()));
                let (pairs, rest) = moves.moves.as_chunks();
                assert!(rest.is_empty());
                let pairs = pairs
                    .iter()
                    .map(|pair| i32::from(i16::from_le_bytes(*pair)));
                self.moves.extend(pairs);
                (self.released, self.end) = (moves.released, moves.end);
            });
        }
    }
}

fn hear(twin: &mut Twin) -> Vec<Answer> {
    answers(&mut Frames::new(), &twin.take_output())
}

/// What a request was answered with, by a tick that reads `counter`; and that tick's torque.
fn ask(
    twin: &mut Twin,
    sequence: u16,
    request: Request,
    counter: u32,
) -> (Result<u32, Refusal>, f32, Vec<Answer>) {
    twin.send(&request_frame(sequence, request));
    let torque_nm = twin.tick(counter, false);
    let told = hear(twin);
    let answer = told.iter().find_map(|answer| {
        answer.read(|of, message| match message {
            Message::Done { tick } if of == sequence => Some(Ok(*tick)),
            Message::Refused(refusal) if of == sequence => Some(Err(*refusal)),
            _ => None,
        })
    });
    (answer.expect("it answers"), torque_nm, told)
}

fn state(twin: &mut Twin) -> State {
    status(twin).0
}

/// Its state, and all that was told on the way.
fn status(twin: &mut Twin) -> (State, Vec<Answer>) {
    twin.send(&request_frame(999, Request::Status));
    let told = hear(twin);
    let state = told
        .iter()
        .find_map(|answer| {
            answer.read(|_, message| match message {
                Message::Status(status) => Some(status.state),
                _ => None,
            })
        })
        .expect("it answers");
    (state, told)
}

prop_compose! {
    /// Pushes of which most are accepted.
    fn any_push()(
        from_nm in -0.5..0.5_f32, to_nm in -0.5..0.5_f32, rise_ticks in 0..60_u32, most_ticks in 0..120_u32,
        way_counts in 1..400_u32, speed_counts in 1..60_u32, rest_ticks in 1..40_u32, coast_ticks in 0..300_u32,
        guard_counts in 1..600_u32,
    ) -> Push {
        Push { from_nm, to_nm, rise_ticks, most_ticks, way_counts, speed_counts, rest_ticks, coast_ticks, guard_counts }
    }
}

/// What the knob does, tick by tick: mostly a little, now and then a leap; and whether the desk is served.
fn walks() -> impl Strategy<Value = Vec<(i32, bool)>> {
    let moved = prop_oneof![
        30 => Just(0),
        20 => -3..=3_i32,
        10 => 0..20_i32,
        2 => -60..60_i32,
    ];
    prop::collection::vec((moved, prop::bool::weighted(0.9)), 1..500)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3_000))]

    /// Whatever the knob does: torque between its ends and as said, off for good once a limit is reached,
    /// over in time and disarmed by itself; the guard is a fault in that tick; and what is told is what was.
    #[test]
    fn a_push_keeps_within_its_limits_ends_by_itself_and_tells_what_happened(push in any_push(), walk in walks(), first in any::<i32>()) {
        let mut twin = Twin::new(first.cast_unsigned(), "test");
        let played = control::push::Push {
            from_nm: push.from_nm, to_nm: push.to_nm, rise_ticks: push.rise_ticks, most_ticks: push.most_ticks,
            way_counts: push.way_counts, speed_counts: push.speed_counts, rest_ticks: push.rest_ticks,
            coast_ticks: push.coast_ticks, guard_counts: push.guard_counts,
        };
        let most_nm = push.from_nm.abs().max(push.to_nm.abs());
        let mut heard = Heard::default();
        let (mut counter, mut moves, mut torques) = (first, Vec::new(), Vec::new());
        let mut way = 0_i32;
        let last_tick = push.most_ticks + push.coast_ticks + 1;
        // The knob rests after the walk.
        let rest = std::iter::repeat_n((0, true), 600);
        for (tick, (moved, served)) in (0_u32..).zip(walk.into_iter().chain(rest)) {
            counter = counter.wrapping_add(moved);
            let torque_nm = if tick == 0 {
                let (answer, torque_nm, told) = ask(&mut twin, 7, Request::Push(push), counter.cast_unsigned());
                prop_assert!(answer.is_ok());
                heard.add(&told);
                torque_nm
            } else if served {
                let torque_nm = twin.tick(counter.cast_unsigned(), false);
                heard.add(&hear(&mut twin));
                torque_nm
            } else {
                twin.tick_alone(counter.cast_unsigned(), false)
            };
            prop_assert!(torque_nm.is_finite() && torque_nm.abs() <= most_nm, "{torque_nm}");
            if tick > 0 {
                way += moved;
            }
            torques.push(torque_nm);
            moves.push(moved);
            let limited = tick >= push.most_ticks || way.unsigned_abs() >= push.way_counts
                || moved.unsigned_abs() >= push.speed_counts || way.unsigned_abs() > push.guard_counts;
            if limited {
                // From here on for good.
                prop_assert_eq!(torque_nm, 0.0, "tick {}", tick);
            }
            if tick > last_tick {
                prop_assert_eq!(torque_nm, 0.0);
                let (over, told) = status(&mut twin);
                heard.add(&told);
                prop_assert!(matches!(over, State::Disarmed | State::Fault(Fault::Guard)), "{over:?}");
            }
            if heard.end.is_some() && tick > last_tick + 5 {
                break;
            }
        }
        prop_assert_eq!(heard.late, 0);
        prop_assert_eq!(heard.from, Some(first));
        let ticks = heard.moves.len();
        prop_assert_eq!(&heard.moves[..], &moves[..ticks]);
        for (tick, torque_nm) in torques.iter().enumerate() {
            let on = heard.released.is_none_or(|released| tick < released as usize) && tick < ticks;
            let expected = if on { played.torque_nm(tick as u32) } else { 0.0 };
            prop_assert_eq!(torque_nm.to_bits(), expected.to_bits(), "tick {}", tick);
        }
        let ways = moves[1..ticks].iter().scan(0_i32, |way, moved| { *way += moved; Some(way.unsigned_abs()) });
        let beyond = ways.clone().position(|way| way > push.guard_counts).map(|place| place + 1);
        let still = moves[..ticks].iter().rev().take_while(|moved| **moved == 0).count();
        match heard.end {
            Some(PushEnd::Fault) => {
                prop_assert_eq!(beyond, Some(ticks - 1));
                prop_assert_eq!(torques[ticks - 1], 0.0);
                prop_assert_eq!(state(&mut twin), State::Fault(Fault::Guard));
            }
            Some(PushEnd::Rest) => {
                prop_assert!(beyond.is_none() && still >= push.rest_ticks as usize);
                prop_assert_eq!(state(&mut twin), State::Disarmed);
            }
            Some(PushEnd::InMotion) => {
                prop_assert!(beyond.is_none());
                prop_assert_eq!(ticks, (heard.released.unwrap() + push.coast_ticks.max(1)) as usize + 1);
                prop_assert_eq!(state(&mut twin), State::Disarmed);
            }
            other => prop_assert!(false, "{other:?}"),
        }
    }

    /// What is no push is refused as a whole, and nothing happens.
    #[test]
    fn a_push_out_of_range_is_refused(push in any_push(), which in 0..9_u32, bad in prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.500_001, -0.500_001, 10.0])) {
        let mut wrong = push;
        match which {
            0 => wrong.from_nm = bad,
            1 => wrong.to_nm = bad,
            2 => wrong.most_ticks = (PUSH_MOST_S / DEFAULTS.sample_period_s) as u32 + 2,
            3 => wrong.most_ticks = u32::MAX,
            4 => wrong.coast_ticks = (COAST_MOST_S / DEFAULTS.sample_period_s) as u32 + 2,
            5 => wrong.way_counts = 0,
            6 => wrong.speed_counts = 0,
            7 => wrong.guard_counts = 0,
            _ => wrong.rest_ticks = 0,
        }
        let mut twin = Twin::new(0, "test");
        twin.send(&request_frame(7, Request::Push(wrong)));
        let refused = hear(&mut twin)[0].read(|_, message| *message == Message::Refused(Refusal::Push));
        prop_assert!(refused, "{wrong:?}");
        for _ in 0..5 {
            prop_assert_eq!(twin.tick(0, false), 0.0);
        }
        prop_assert_eq!(state(&mut twin), State::Disarmed);
    }
}

#[test]
fn a_push_is_accepted_only_while_disarmed_and_nothing_else_while_pushing() {
    let mut twin = Twin::new(0, "test");
    let is = Refusal::State;
    ask(&mut twin, 1, Request::Arm, 0).0.unwrap();
    let refused = hear_refusal(&mut twin, 2, Request::Push(PUSH));
    assert_eq!(refused, Err(is(State::Armed)));
    ask(&mut twin, 3, Request::Disarm, 0).0.unwrap();
    ask(&mut twin, 4, Request::Push(PUSH), 0).0.unwrap();
    assert_eq!(state(&mut twin), State::Pushing);
    let set = Request::Set(Changes {
        torque_max_nm: Some(0.01),
        ..Changes::default()
    });
    for (sequence, request) in [(5, Request::Arm), (6, set), (7, Request::Clear)] {
        assert_eq!(
            ask(&mut twin, sequence, request, 0).0,
            Err(is(State::Pushing)),
            "{request:?}"
        );
    }
    for request in [Request::Push(PUSH), Request::Save, Request::ResetSettings] {
        let refused = hear_refusal(&mut twin, 8, request);
        assert!(refused.is_err(), "{request:?}");
    }
    assert_ne!(twin.tick(0, false), 0.0, "the push goes on");
    let fault = twin.tick(0, true);
    assert_eq!(
        (fault, state(&mut twin)),
        (0.0, State::Fault(Fault::Overrun))
    );
    assert_eq!(
        hear_refusal(&mut twin, 9, Request::Push(PUSH)),
        Err(is(State::Fault(Fault::Overrun)))
    );
}

/// A refusal that the desk gives without a tick.
fn hear_refusal(twin: &mut Twin, sequence: u16, request: Request) -> Result<(), Refusal> {
    twin.send(&request_frame(sequence, request));
    hear(twin)
        .iter()
        .find_map(|answer| {
            answer.read(|of, message| match message {
                Message::Refused(refusal) if of == sequence => Some(Err(*refusal)),
                _ => None,
            })
        })
        .unwrap_or(Ok(()))
}

/// As when armed.
#[test]
fn every_fault_ends_a_push_in_its_tick() {
    let jump = DEFAULTS.speed_max_rad_s * DEFAULTS.sample_period_s * 8192.0 / std::f32::consts::TAU;
    for (moved, late, fault) in [
        (0, true, Fault::Overrun),
        (
            jump as i32 + 2,
            false,
            Fault::EncoderJump {
                counts: jump as i32 + 2,
            },
        ),
        (-40_000, false, Fault::EncoderJump { counts: -40_000 }),
    ] {
        let mut twin = Twin::new(0, "test");
        let mut heard = Heard::default();
        let (_, torque_nm, _) = ask(&mut twin, 1, Request::Push(PUSH), 0);
        assert_ne!(torque_nm, 0.0);
        assert_ne!(twin.tick(1, false), 0.0);
        assert_eq!(
            twin.tick(1_i32.wrapping_add(moved).cast_unsigned(), late),
            0.0
        );
        heard.add(&hear(&mut twin));
        assert_eq!(heard.end, Some(PushEnd::Fault));
        assert_eq!(state(&mut twin), State::Fault(fault));
        assert_eq!(twin.tick(1, false), 0.0);
    }
}

#[test]
fn disarm_breaks_a_push_off_at_once() {
    let mut twin = Twin::new(0, "test");
    let mut heard = Heard::default();
    ask(&mut twin, 1, Request::Push(PUSH), 0).0.unwrap();
    twin.tick(1, false);
    let (answer, torque_nm, told) = ask(&mut twin, 2, Request::Disarm, 2);
    assert!(answer.is_ok());
    assert_eq!(torque_nm, 0.0);
    heard.add(&told);
    heard.add(&hear(&mut twin));
    assert_eq!(
        (heard.end, heard.moves),
        (Some(PushEnd::BrokenOff), vec![0, 1])
    );
    assert_eq!(state(&mut twin), State::Disarmed);
    // And the next one is its own.
    let (_, _, told) = ask(&mut twin, 3, Request::Push(PUSH), 9);
    let mut heard = Heard::default();
    heard.add(&told);
    for _ in 0..100 {
        twin.tick(9, false);
        heard.add(&hear(&mut twin));
    }
    assert_eq!((heard.from, heard.end), (Some(2), Some(PushEnd::Rest)));
    assert_eq!(heard.moves.len(), 40 + 1 + 20);
}

/// A host whose answer was lost asks again under the same number, in the push or after it.
#[test]
fn a_request_that_comes_again_does_not_push_again() {
    for wait in [0, 3, 500] {
        let mut twin = Twin::new(0, "test");
        let mut heard = Heard::default();
        let (first, _, told) = ask(&mut twin, 7, Request::Push(PUSH), 0);
        heard.add(&told);
        for _ in 0..wait {
            twin.tick(0, false);
        }
        heard.add(&hear(&mut twin));
        let (second, torque_nm, told) = ask(&mut twin, 7, Request::Push(PUSH), 0);
        heard.add(&told);
        assert_eq!(second, first);
        assert_eq!(torque_nm == 0.0, wait == 500);
        for _ in 0..500 {
            twin.tick(0, false);
            heard.add(&hear(&mut twin));
        }
        assert_eq!((heard.end, heard.late), (Some(PushEnd::Rest), 0));
        // The next number is the next push, and so is the same one after something else.
        let (third, torque_nm, _) = ask(&mut twin, 8, Request::Push(PUSH), 0);
        assert!(third.unwrap() > first.unwrap() && torque_nm != 0.0);
        for _ in 0..500 {
            twin.tick(0, false);
        }
        hear(&mut twin);
        state(&mut twin);
        let (fourth, torque_nm, _) = ask(&mut twin, 8, Request::Push(PUSH), 0);
        assert!(fourth.unwrap() > third.unwrap() && torque_nm != 0.0);
    }
}

/// Where the desk cannot send, the push ends when there is no more room, and says so.
#[test]
fn a_move_that_finds_no_room_ends_the_push_and_is_told() {
    let mut twin = Twin::new(0, "test");
    let long = Push {
        most_ticks: 5000,
        ..PUSH
    };
    let mut heard = Heard::default();
    let (_, _, told) = ask(&mut twin, 1, Request::Push(long), 0);
    heard.add(&told);
    let torques: Vec<f32> = (0..400).map(|_| twin.tick_alone(0, false)).collect();
    let on = torques
        .iter()
        .filter(|torque_nm| **torque_nm != 0.0)
        .count();
    assert_eq!(on, 254, "one of 255 was the tick that took it");
    assert!(torques[on..].iter().all(|torque_nm| *torque_nm == 0.0));
    for _ in 0..10 {
        twin.tick(0, false);
        heard.add(&hear(&mut twin));
    }
    assert_eq!((heard.end, heard.late), (Some(PushEnd::NoRoom), 0));
    assert_eq!(heard.moves.len(), 255);
    assert_eq!(state(&mut twin), State::Disarmed);
}

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use firmware::power::Bridge;
use plant_sim::powered::{Powered, Setup};
use plant_sim::powered_lockstep::{BenchPeriod, DriveEmulator, Order, PoweredBench, Surroundings};
use protocol::{Frames, Message, Request};

use crate::powered_twin::{PoweredTwin, sensed};
use crate::twin::{Answer, answers, request_frame};

/// The image of the board with a power stage on its bench, and its native twin beside it: every duty and every byte
/// that either gives must be the other's, to the last bit.
pub struct PoweredRig {
    /// Chip, motor and knob.
    pub bench: PoweredBench,
    twin: PoweredTwin,
    frames: Frames,
    sequence: u16,
    waiting: VecDeque<Answer>,
    /// PWM periods so far.
    pub periods: u64,
    /// Of them, with the bridge on.
    pub on: u64,
}

impl PoweredRig {
    /// Boots the firmware against a knob.
    #[must_use]
    pub fn start(setup: &Setup) -> Self {
        let emulator =
            DriveEmulator::start(&Self::image(), 3, &[], None).expect("the firmware starts");
        let mut rig = Self {
            bench: PoweredBench {
                emulator,
                knob: Powered::new(setup).expect("a possible knob"),
                around: Surroundings::default(),
            },
            // The chip's counter reads 0 when it starts.
            twin: PoweredTwin::new(0, "set below"),
            frames: Frames::new(),
            sequence: 0,
            waiting: VecDeque::new(),
            periods: 0,
            on: 0,
        };
        rig.twin = PoweredTwin::new(0, rig.git_hash());
        rig
    }

    /// The image that `cargo xtask firmware` built.
    #[must_use]
    pub fn image() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/firmware/emulated_drive.elf")
    }

    /// What the image calls its source: the one thing that the twin cannot know.
    fn git_hash(&mut self) -> &'static str {
        let hello = Request::Hello {
            version: protocol::VERSION,
        };
        self.bench
            .emulator
            .send(&request_frame(0, hello))
            .expect("the firmware listens");
        let bytes = self.bench.emulator.receive().expect("and answers");
        answers(&mut self.frames, &bytes)[0].read(|_, message| match message {
            Message::Hello(hello) => String::leak(hello.git_hash.to_owned()) as &'static str,
            other => panic!("{other:?} in answer to hello"),
        })
    }

    /// One PWM period of both.
    pub fn period(&mut self) -> BenchPeriod {
        self.period_with(false, false)
    }

    /// One PWM period of both. `gate_fault`: the gate driver's line fell before; `late`: another was due before this one.
    pub fn period_with(&mut self, gate_fault: bool, late: bool) -> BenchPeriod {
        if gate_fault {
            let sensed = self.bench.knob.sensed();
            let emulator = &mut self.bench.emulator;
            let around = &self.bench.around;
            let report = emulator.exchange(Order::GateFault, &sensed, around);
            let report = report.expect("the firmware goes on");
            assert_eq!(report.duties, None, "off at once, before any tick");
        }
        let order = if late {
            Order::LatePeriod
        } else {
            Order::Period
        };
        let done = self.bench.period_with(order).expect("the firmware ticks");
        let bridge = self.twin.period(&sensed(&done.sensed), gate_fault, late);
        let twin = match bridge {
            Bridge::Off => None,
            Bridge::On(duties) => Some(duties.parts().map(f32::to_bits)),
        };
        let chip = done.report.duties.map(|duties| duties.map(f32::to_bits));
        self.periods += 1;
        self.on += u64::from(chip.is_some());
        assert_eq!(
            chip, twin,
            "period {}: the chip's duties are {:?}, its twin's {bridge:?}",
            self.periods, done.report.duties
        );
        self.collect();
        done
    }

    /// Many periods.
    pub fn periods(&mut self, periods: u64) {
        for _ in 0..periods {
            self.period();
        }
    }

    /// Bytes on both serial lines, between two periods.
    pub fn send(&mut self, bytes: &[u8]) {
        self.bench
            .emulator
            .send(bytes)
            .expect("the firmware takes them");
        self.twin.send(bytes);
        self.collect();
    }

    /// What both have sent since, which must be the same bytes.
    fn collect(&mut self) {
        let bytes = self.bench.emulator.receive().expect("the line is open");
        assert_eq!(
            bytes,
            self.twin.take_output(),
            "period {}: they say different things",
            self.periods
        );
        self.waiting.extend(answers(&mut self.frames, &bytes));
    }

    /// What was sent unasked or is not yet read.
    pub fn take_messages(&mut self) -> Vec<Answer> {
        self.waiting.drain(..).collect()
    }

    /// Asks, goes on until the answer is there, and reads it.
    pub fn ask<R>(&mut self, request: Request, read: impl FnOnce(&Message<'_>) -> R) -> R {
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        self.send(&request_frame(sequence, request));
        for _ in 0..1000 {
            let mine = |answer: &Answer| {
                answer.read(|got, message| {
                    got == sequence && !matches!(message, Message::Telemetry(_) | Message::Event(_))
                })
            };
            if let Some(place) = self.waiting.iter().position(mine) {
                let answer = self.waiting.remove(place).expect("it was just found");
                return answer.read(|_, message| read(message));
            }
            self.period();
        }
        panic!("{request:?} was not answered within a thousand periods");
    }

    /// Asks for something that must be done.
    pub fn must(&mut self, request: Request) {
        self.ask(request, |message| {
            assert!(
                matches!(message, Message::Done { .. }),
                "{request:?}: {message:?}"
            );
        });
    }
}

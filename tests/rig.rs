use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use plant_sim::lockstep::{Bench, Emulator, Order, Plant};
use protocol::{Frames, Message, Refusal, Request};

use crate::twin::{Answer, Twin, answers, request_frame};

/// The firmware's image on its bench, and its native twin beside it: every torque and every
/// byte that either gives must be the other's, to the last bit.
pub struct Rig {
    /// Chip and motor.
    pub bench: Bench,
    twin: Twin,
    frames: Frames,
    sequence: u16,
    waiting: VecDeque<Answer>,
    /// Ticks so far.
    pub ticks: u64,
    hash: u64,
}

impl Rig {
    /// Boots the firmware against a plant.
    #[must_use]
    pub fn start(plant: Plant) -> Self {
        let emulator = Emulator::start(&Self::image(), 3).expect("the firmware starts");
        let mut rig = Self {
            // The chip's counter reads 0 when it starts.
            twin: Twin::new(0, "set below"),
            bench: Bench { emulator, plant },
            frames: Frames::new(),
            sequence: 0,
            waiting: VecDeque::new(),
            ticks: 0,
            hash: 0xcbf2_9ce4_8422_2325,
        };
        rig.twin = Twin::new(0, rig.git_hash());
        rig
    }

    /// The image that `cargo xtask firmware` built.
    #[must_use]
    pub fn image() -> PathBuf {
        match std::env::var_os("KNOB_FIRMWARE") {
            Some(path) => path.into(),
            None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/firmware/emulated.elf"),
        }
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

    /// One tick of both.
    pub fn tick(&mut self) -> f32 {
        self.tick_with(Order::Tick)
    }

    /// One tick of both, with another order.
    pub fn tick_with(&mut self, order: Order) -> f32 {
        let (counter, report) = self.bench.tick_with(order).expect("the firmware ticks");
        let torque = self.twin.tick(counter, order == Order::LateTick);
        self.ticks += 1;
        assert_eq!(
            report.torque_nm.to_bits(),
            torque.to_bits(),
            "tick {}, counter {counter}: the chip gives {} Nm, its twin {torque} Nm",
            self.ticks,
            report.torque_nm
        );
        assert_eq!(report.period_s.to_bits(), self.twin.period_s().to_bits());
        self.mix(counter);
        self.mix(report.torque_nm.to_bits());
        self.collect();
        torque
    }

    /// Many ticks.
    pub fn ticks(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick();
        }
    }

    /// Bytes on both serial lines, between two ticks.
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
            "tick {}: they say different things",
            self.ticks
        );
        for byte in &bytes {
            self.mix(u32::from(*byte));
        }
        self.waiting.extend(answers(&mut self.frames, &bytes));
    }

    fn mix(&mut self, word: u32) {
        self.hash = (self.hash ^ u64::from(word)).wrapping_mul(0x0100_0000_01b3);
    }

    /// What came of the run so far: counters, torques and serial bytes.
    #[must_use]
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// What was sent unasked or is not yet read.
    pub fn take_messages(&mut self) -> Vec<Answer> {
        self.waiting.drain(..).collect()
    }

    /// Asks, ticks until the answer is there, and reads it.
    pub fn ask<R>(&mut self, request: Request, read: impl FnOnce(&Message<'_>) -> R) -> R {
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        self.send(&request_frame(sequence, request));
        for _ in 0..10 {
            let mine = |answer: &Answer| {
                answer.read(|got, message| {
                    got == sequence
                        && !matches!(
                            message,
                            Message::Telemetry(_) | Message::Event(_) | Message::Moves(_)
                        )
                })
            };
            if let Some(place) = self.waiting.iter().position(mine) {
                let answer = self.waiting.remove(place).expect("it was just found");
                return answer.read(|_, message| read(message));
            }
            self.tick();
        }
        panic!("{request:?} was not answered within ten ticks");
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

    /// Asks for something that must be refused.
    pub fn refused(&mut self, request: Request) -> Refusal {
        self.ask(request, |message| match message {
            Message::Refused(refusal) => *refusal,
            other => panic!("{request:?}: {other:?}"),
        })
    }
}

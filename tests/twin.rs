use std::collections::VecDeque;

use firmware::desk::{Desk, Identity};
use firmware::settings::{self, BoardKind};
use firmware::store::{Keep, NoStore};
use firmware::ticker::Ticker;
use firmware::{Commands, Link, Moves, Records};
use protocol::{FRAME_MAX, Frames, FromDevice, Message, Request, ToDevice, decode, encode};

/// As the emulated board.
const KIND: BoardKind = BoardKind::Amplifier { counter_bits: 32 };

/// The firmware without its board, on this machine.
pub struct Twin<K = NoStore> {
    ticker: Ticker<'static>,
    desk: Desk<'static, K>,
    inbox: VecDeque<u8>,
    outbox: Vec<u8>,
    period_s: f32,
}

impl Twin {
    /// Just started, with the counter at `counter`, on a board that keeps no settings.
    #[must_use]
    pub fn new(counter: u32, git_hash: &'static str) -> Self {
        Self::start(counter, git_hash, NoStore)
    }
}

impl<K: Keep> Twin<K> {
    /// Just started, with the counter at `counter` and what the store holds.
    #[must_use]
    pub fn start(counter: u32, git_hash: &'static str, mut store: K) -> Self {
        // Two queues and a few words a twin, kept until the test ends.
        let link: &'static Link = Box::leak(Box::new(Link::new()));
        let (command_sender, command_receiver) = Box::leak(Box::new(Commands::new())).split();
        let (record_sender, record_receiver) = Box::leak(Box::new(Records::new())).split();
        let (move_sender, move_receiver) = Box::leak(Box::new(Moves::new())).split();
        let start = settings::start(&store.load(), &KIND).expect("the defaults settle");
        let identity = Identity {
            firmware: env!("CARGO_PKG_VERSION"),
            git_hash,
            board: "emulated",
            kind: KIND,
            reset: protocol::ResetReason::Unknown,
        };
        Self {
            ticker: Ticker::new(
                &start.settled,
                counter,
                link,
                command_receiver,
                record_sender,
                move_sender,
            ),
            desk: Desk::new(
                identity,
                &start,
                store,
                link,
                command_sender,
                record_receiver,
                move_receiver,
            ),
            inbox: VecDeque::new(),
            outbox: Vec::new(),
            period_s: start.settings.parameters.sample_period_s,
        }
    }

    fn serve(&mut self) {
        let (inbox, outbox) = (&mut self.inbox, &mut self.outbox);
        self.desk.serve(
            || inbox.pop_front(),
            |frame| outbox.extend_from_slice(frame),
        );
    }

    /// Bytes on the serial line, one interrupt each.
    pub fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            // As on the chip: 511 bytes find room, what comes on top is lost.
            if self.inbox.len() < 511 {
                self.inbox.push_back(*byte);
            }
            self.serve();
        }
    }

    /// One tick, and what follows it. Returns the torque, Nm.
    pub fn tick(&mut self, counter: u32, late: bool) -> f32 {
        let torque_nm = self.tick_alone(counter, late);
        self.serve();
        torque_nm
    }

    /// One tick while the desk is busy with something else, such as a slow line.
    pub fn tick_alone(&mut self, counter: u32, late: bool) -> f32 {
        let output = self.ticker.tick(counter, self.period_s, late);
        if let Some(period_s) = output.period_s {
            self.period_s = period_s;
        }
        output.torque_nm
    }

    /// The period it wants, s.
    #[must_use]
    pub fn period_s(&self) -> f32 {
        self.period_s
    }

    /// Switches it off; what it kept is in the store.
    #[must_use]
    pub fn into_store(self) -> K {
        self.desk.into_store()
    }

    /// Takes what it has sent.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outbox)
    }
}

/// A frame from a device that could be read.
#[derive(Debug, Clone)]
pub struct Answer {
    frame: Vec<u8>,
}

impl Answer {
    /// Reads what is in it.
    pub fn read<R>(&self, read: impl FnOnce(u16, &Message<'_>) -> R) -> R {
        let mut frame = self.frame.clone();
        let from: FromDevice<'_> = decode(&mut frame).expect("it could be read when it came");
        read(from.sequence, &from.message)
    }
}

/// Cuts what a device sent into frames; every one must be whole and correct.
pub fn answers(frames: &mut Frames, bytes: &[u8]) -> Vec<Answer> {
    let mut all = Vec::new();
    for byte in bytes {
        if let Some(frame) = frames.push(*byte) {
            let answer = Answer {
                frame: frame.expect("no frame is too long").to_vec(),
            };
            answer.read(|_, _| ());
            all.push(answer);
        }
    }
    all
}

/// A request as it goes over the wire.
#[must_use]
pub fn request_frame(sequence: u16, request: Request) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    let frame = encode(&ToDevice { sequence, request }, &mut buffer);
    frame.expect("requests fit a frame").to_vec()
}

//! A device without a board or an emulator: the firmware's ticker and desk in a thread,
//! behind a pseudo-terminal.

use std::collections::VecDeque;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::Duration;

use firmware::desk::{Desk, Identity};
use firmware::settings::{self, BoardKind};
use firmware::store::{Keep, NoStore};
use firmware::ticker::Ticker;
use firmware::{Commands, Link, Moves, Records};
use protocol::{FromDevice, Message, decode};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

const KIND: BoardKind = BoardKind::Amplifier { counter_bits: 32 };

/// One end of a serial line, with something behind it; gone when dropped.
pub struct Port {
    pub path: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Port {
    /// About every millisecond `work` is given what came, and adds what goes out.
    pub fn new(mut work: impl FnMut(&[u8], &mut Vec<u8>) + Send + 'static) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC);
        let master = master.unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        // Kept open, so that the line is there between two commands.
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = open(&path, flags, Mode::empty()).unwrap();
        let mut mode = tcgetattr(&slave).unwrap();
        mode.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &mode).unwrap();
        fcntl_setfl(&master, OFlags::NONBLOCK).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let (mut incoming, mut outgoing) = (Vec::new(), Vec::new());
            while !stopped.load(Relaxed) {
                incoming.clear();
                take(&master, &mut incoming);
                work(&incoming, &mut outgoing);
                if let Ok(sent) = write(&master, &outgoing) {
                    outgoing.drain(..sent);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            drop(slave);
        });
        Self {
            path: path.into_string().unwrap(),
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            assert!(ended.is_ok() || std::thread::panicking());
        }
    }
}

fn take(master: &OwnedFd, incoming: &mut Vec<u8>) {
    let mut buffer = [0; 1024];
    while let Ok(count) = read(master, &mut buffer) {
        if count == 0 {
            break;
        }
        incoming.extend_from_slice(&buffer[..count]);
    }
}

/// What becomes of a frame from the device.
pub enum Fate {
    Arrives,
    Vanishes,
    IsDamaged,
}

/// The hand at the knob, and a look at what it does.
#[derive(Default)]
pub struct Hand {
    /// How fast it turns, counts per tick.
    pub speed: AtomicI32,
    /// How far it is to jump in the next tick, counts.
    pub jump: AtomicI32,
    /// Telemetry that was sent.
    pub telemetry: AtomicU32,
}

/// A device as it comes.
pub fn board() -> (Port, Arc<Hand>) {
    board_with(|_| Fate::Arrives)
}

/// A device that keeps settings, and starts with what is kept.
pub fn board_that_keeps(store: impl Keep + Send + 'static) -> (Port, Arc<Hand>) {
    board_on(|_| Fate::Arrives, store)
}

/// A device on a line that does something to its frames.
pub fn board_with(line: impl FnMut(&FromDevice<'_>) -> Fate + Send + 'static) -> (Port, Arc<Hand>) {
    board_on(line, NoStore)
}

fn board_on(
    line: impl FnMut(&FromDevice<'_>) -> Fate + Send + 'static,
    store: impl Keep + Send + 'static,
) -> (Port, Arc<Hand>) {
    let hand = Arc::new(Hand::default());
    let held = Arc::clone(&hand);
    let mut counter = 0_i32;
    let turned = move |_, _| {
        counter = counter.wrapping_add(held.speed.load(Relaxed) + held.jump.swap(0, Relaxed));
        counter
    };
    let port = device(1, turned, Arc::clone(&hand), line, store);
    (port, hand)
}

/// A device whose counter is what `turned` makes of torque (Nm) and period (s), `at_a_time` ticks in about a millisecond.
pub fn board_at(
    at_a_time: u32,
    turned: impl FnMut(f32, f32) -> i32 + Send + 'static,
    line: impl FnMut(&FromDevice<'_>) -> Fate + Send + 'static,
) -> Port {
    device(at_a_time, turned, Arc::default(), line, NoStore)
}

fn device(
    at_a_time: u32,
    mut turned: impl FnMut(f32, f32) -> i32 + Send + 'static,
    hand: Arc<Hand>,
    mut line: impl FnMut(&FromDevice<'_>) -> Fate + Send + 'static,
    mut store: impl Keep + Send + 'static,
) -> Port {
    // Two queues and a few words, kept until the test ends.
    let link: &'static Link = Box::leak(Box::new(Link::new()));
    let (command_sender, command_receiver) = Box::leak(Box::new(Commands::new())).split();
    let (record_sender, record_receiver) = Box::leak(Box::new(Records::new())).split();
    let (move_sender, move_receiver) = Box::leak(Box::new(Moves::new())).split();
    let start = settings::start(&store.load(), &KIND).unwrap();
    let identity = Identity {
        firmware: "1.2.3",
        git_hash: "abc1234",
        board: "native",
        kind: KIND,
        reset: protocol::ResetReason::Unknown,
    };
    let mut ticker = Ticker::new(
        &start.settled,
        0,
        link,
        command_receiver,
        record_sender,
        move_sender,
    );
    let mut desk = Desk::new(
        identity,
        &start,
        store,
        link,
        command_sender,
        record_receiver,
        move_receiver,
    );
    let mut inbox = VecDeque::new();
    let mut torque_nm = 0.0;
    let mut period_s = start.settings.parameters.sample_period_s;
    let mut tick = move |incoming: &[u8], outgoing: &mut Vec<u8>| {
        inbox.extend(incoming);
        let counter = turned(torque_nm, period_s);
        let output = ticker.tick(counter as u32, period_s, false);
        torque_nm = output.torque_nm;
        period_s = output.period_s.unwrap_or(period_s);
        desk.serve(
            || inbox.pop_front(),
            |frame| {
                let (mut copy, mut sent) = (frame.to_vec(), frame.to_vec());
                let said: FromDevice<'_> = decode(&mut copy).unwrap();
                if matches!(said.message, Message::Telemetry(_)) {
                    hand.telemetry.fetch_add(1, Relaxed);
                }
                match line(&said) {
                    Fate::Arrives => {}
                    Fate::Vanishes => return,
                    // Still no zero, still one frame.
                    Fate::IsDamaged => sent[2] = sent[2] % 255 + 1,
                }
                outgoing.extend(sent);
            },
        );
    };
    Port::new(move |incoming, outgoing| {
        tick(incoming, outgoing);
        for _ in 1..at_a_time {
            tick(&[], outgoing);
        }
    })
}

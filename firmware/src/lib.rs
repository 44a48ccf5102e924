//! The part of the firmware that knows no board: it runs natively too, and is tested there.
//!
//! - [`ticker`]: what the tick's interrupt does, and the state disarmed, armed, fault;
//! - [`commission`]: measuring a motor, in the current tick;
//! - [`desk`]: what answers the host, below the tick;
//! - [`current_tick`]: on a board with a power stage, what the interrupt of every PWM period does, the tick in it;
//! - [`drive`]: what drives the motor there;
//! - [`guard`]: what puts its torque to zero, once in each PWM period;
//! - [`upkeep`]: the slow work there, and the watchdog;
//! - [`power`]: what a power stage and the firmware hand each other;
//! - [`settings`]: parameters as they come over the wire, checked and made into a plan;
//! - [`store`]: settings that survive, in two sectors of flash;
//! - [`odrive_v3`]: the motor-driver board, up to its registers;
//! - [`board`]: what a board owes the two; the boards themselves lie in `src/board/`.
//!
//! The ticker and the desk share a [`Link`] and three queues of `heapless`; neither ever waits for the
//! other. `docs/firmware.md` draws it.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod board;
pub mod commission;
pub mod current_tick;
pub mod desk;
pub mod drive;
pub mod guard;
pub mod odrive_v3;
pub mod power;
pub mod settings;
pub mod store;
pub mod ticker;
pub mod upkeep;

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use control::tick::Tick;
use heapless::spsc::{Consumer, Producer, Queue};
use protocol::{Fault, PushEnd, Snapshot};
use ticker::{Command, Record, StateCode, Stood};

const COMMANDS: usize = 2;
const RECORDS: usize = 64;
const MEASUREMENTS: usize = 32;
/// At 4 kHz and 115,200 baud a frame is on the line for 90 ticks.
const MOVES: usize = 256;

/// Commands on their way to the tick: the desk sends the next when the last was taken.
pub type Commands = Queue<Command, COMMANDS>;
/// What the tick has to tell, on its way to the desk.
pub type Records = Queue<Record, RECORDS>;

/// By how much each tick of a push found the count moved, on its way to the desk.
pub type Moves = Queue<i16, MOVES>;

/// The desk's end of [`Commands`].
pub type CommandSender<'a> = Producer<'a, Command, COMMANDS>;
/// The tick's end of [`Commands`].
pub type CommandReceiver<'a> = Consumer<'a, Command, COMMANDS>;
/// The tick's end of [`Records`].
pub type RecordSender<'a> = Producer<'a, Record, RECORDS>;
/// What an excitation has brought, on its way to the desk: so much as a slow line may be behind.
pub type Measurements = Queue<commission::Told, MEASUREMENTS>;
/// The current tick's end of [`Measurements`].
pub type MeasurementSender<'a> = Producer<'a, commission::Told, MEASUREMENTS>;
/// The desk's end of [`Measurements`].
pub type MeasurementReceiver<'a> = Consumer<'a, commission::Told, MEASUREMENTS>;

/// The desk's end of [`Records`].
pub type RecordReceiver<'a> = Consumer<'a, Record, RECORDS>;
/// The tick's end of [`Moves`].
pub type MoveSender<'a> = Producer<'a, i16, MOVES>;
/// The desk's end of [`Moves`].
pub type MoveReceiver<'a> = Consumer<'a, i16, MOVES>;

/// What the tick and the desk tell each other without a queue: single words, each written
/// by one of them.
#[derive(Debug, Default)]
pub struct Link {
    /// By the tick: see [`LinkStatus`].
    status: AtomicU32,
    /// By the tick: its number.
    tick: AtomicU32,
    /// By the tick: the number of the tick that took the last command.
    taken_at: AtomicU32,
    /// By the tick: records that found no room.
    dropped: AtomicU32,
    /// By the tick, before it says that it is in fault: which, and the bits of its number; how many there were; and
    /// how things stood then.
    fault: AtomicU32,
    fault_value: AtomicU32,
    faults: AtomicU32,
    stood: [AtomicU32; 8],
    /// By the slow task: how often it ran, what it found, the temperature's bits, and the gate driver's words as read
    /// last where they told of a fault, since the last fault.
    slow_runs: AtomicU32,
    slow_found: AtomicU32,
    temperature: AtomicU32,
    gate_driver: AtomicU32,
    /// By the desk: how often it served; and how often it asked for a restart of the gate driver.
    desk_runs: AtomicU32,
    restarts_asked: AtomicU32,
    /// By the slow task: how many of these are done.
    restarts_done: AtomicU32,
    /// By the tick: how the last push ended; 0: it did not yet.
    push_end: AtomicU32,
    /// By the tick: the first tick of the last push without torque; `u32::MAX`: there was none yet.
    push_released: AtomicU32,
    /// By the tick: the count before the last push.
    push_from: AtomicU32,
    /// By the desk: one record every so many ticks; 0: none.
    every_ticks: AtomicU32,
    /// By the desk: 1 if changes of the clamp's reason are wanted.
    clamp_events: AtomicU32,
}

/// What one word of [`Link`] says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LinkStatus {
    state: StateCode,
    /// The last command was refused.
    refused: bool,
    /// Commands taken since the start.
    taken: u16,
}

impl Link {
    /// Nothing has happened yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            status: AtomicU32::new(0),
            tick: AtomicU32::new(0),
            taken_at: AtomicU32::new(0),
            dropped: AtomicU32::new(0),
            fault: AtomicU32::new(0),
            fault_value: AtomicU32::new(0),
            faults: AtomicU32::new(0),
            stood: [const { AtomicU32::new(0) }; 8],
            slow_runs: AtomicU32::new(0),
            slow_found: AtomicU32::new(0),
            temperature: AtomicU32::new(0),
            gate_driver: AtomicU32::new(0),
            desk_runs: AtomicU32::new(0),
            restarts_asked: AtomicU32::new(0),
            restarts_done: AtomicU32::new(0),
            push_end: AtomicU32::new(0),
            push_released: AtomicU32::new(0),
            push_from: AtomicU32::new(0),
            every_ticks: AtomicU32::new(0),
            clamp_events: AtomicU32::new(0),
        }
    }

    fn set_status(&self, status: LinkStatus) {
        let word =
            status.state as u32 | u32::from(status.refused) << 8 | u32::from(status.taken) << 16;
        self.status.store(word, Relaxed);
    }

    fn set_fault(&self, fault: Fault) {
        let (code, value) = match fault {
            Fault::Overrun => (0, 0),
            Fault::EncoderJump { counts } => (1, counts.cast_unsigned()),
            Fault::TorqueNotFinite => (2, 0),
            Fault::CurrentOverrun => (3, 0),
            Fault::GateDriver => (4, 0),
            Fault::OverCurrent { current_a } => (5, current_a.to_bits()),
            Fault::CurrentSense => (6, 0),
            Fault::OverVoltage { bus_v } => (7, bus_v.to_bits()),
            Fault::UnderVoltage { bus_v } => (8, bus_v.to_bits()),
            Fault::OverTemperature { temperature_c } => (9, temperature_c.to_bits()),
            Fault::OverSpeed { speed_rad_s } => (10, speed_rad_s.to_bits()),
            Fault::Encoder => (11, 0),
            Fault::Guard => (12, 0),
        };
        self.fault_value.store(value, Relaxed);
        self.fault.store(code, Relaxed);
    }

    /// The last fault.
    fn fault(&self) -> Fault {
        let value = self.fault_value.load(Relaxed);
        let number = f32::from_bits(value);
        match self.fault.load(Relaxed) {
            0 => Fault::Overrun,
            1 => Fault::EncoderJump {
                counts: value.cast_signed(),
            },
            2 => Fault::TorqueNotFinite,
            3 => Fault::CurrentOverrun,
            4 => Fault::GateDriver,
            5 => Fault::OverCurrent { current_a: number },
            6 => Fault::CurrentSense,
            7 => Fault::OverVoltage { bus_v: number },
            8 => Fault::UnderVoltage { bus_v: number },
            9 => Fault::OverTemperature {
                temperature_c: number,
            },
            10 => Fault::OverSpeed {
                speed_rad_s: number,
            },
            11 => Fault::Encoder,
            _ => Fault::Guard,
        }
    }

    /// By the tick, in the tick that finds a fault.
    fn set_snapshot(&self, tick: &Tick, stood: &Stood) {
        let words = [
            self.tick.load(Relaxed),
            tick.count.cast_unsigned(),
            tick.moved.cast_unsigned(),
            tick.torque_nm.to_bits(),
            stood.currents.b_a.to_bits(),
            stood.currents.c_a.to_bits(),
            stood.bus_v.to_bits(),
            self.temperature.load(Relaxed),
        ];
        for (place, word) in self.stood.iter().zip(words) {
            place.store(word, Relaxed);
        }
        let faults = self.faults.load(Relaxed).wrapping_add(1);
        self.faults.store(faults, Relaxed);
    }

    /// How things stood at the last fault since the start. The tick may find another while it is read; then it is read
    /// again.
    fn snapshot(&self) -> Option<Snapshot> {
        let mut faults = self.faults.load(Relaxed);
        loop {
            if faults == 0 {
                return None;
            }
            let [tick, count, moved, torque, b, c, bus, temperature] =
                self.stood.each_ref().map(|word| word.load(Relaxed));
            let gate_driver = self.gate_driver.load(Relaxed);
            let snapshot = Snapshot {
                tick,
                fault: self.fault(),
                count: count.cast_signed(),
                moved: moved.cast_signed(),
                torque_nm: f32::from_bits(torque),
                current_b_a: f32::from_bits(b),
                current_c_a: f32::from_bits(c),
                bus_v: f32::from_bits(bus),
                temperature_c: f32::from_bits(temperature),
                gate_driver: [gate_driver as u16, (gate_driver >> 16) as u16],
            };
            let now = self.faults.load(Relaxed);
            if now == faults {
                return Some(snapshot);
            }
            faults = now;
        }
    }

    fn begin_push(&self, from: i32) {
        self.push_from.store(from.cast_unsigned(), Relaxed);
        self.push_released.store(u32::MAX, Relaxed);
        self.push_end.store(0, Relaxed);
    }

    fn end_push(&self, end: PushEnd) {
        let code = match end {
            PushEnd::Rest => 1,
            PushEnd::InMotion => 2,
            PushEnd::BrokenOff => 3,
            PushEnd::Fault => 4,
            PushEnd::NoRoom => 5,
        };
        self.push_end.store(code, Relaxed);
    }

    /// How the last push ended, if it did. All its moves are in the queue by then.
    fn push_end(&self) -> Option<PushEnd> {
        match self.push_end.load(Relaxed) {
            0 => None,
            1 => Some(PushEnd::Rest),
            2 => Some(PushEnd::InMotion),
            3 => Some(PushEnd::BrokenOff),
            4 => Some(PushEnd::Fault),
            _ => Some(PushEnd::NoRoom),
        }
    }

    fn status(&self) -> LinkStatus {
        let word = self.status.load(Relaxed);
        LinkStatus {
            state: StateCode::from_bits(word),
            refused: word & 0x100 != 0,
            taken: (word >> 16) as u16,
        }
    }
}

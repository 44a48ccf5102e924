//! A board with a power stage inside QEMU (`-M netduinoplus2`, an STM32F405), in lockstep with windings and a knob
//! outside. Its facts are those of the ODrive for 24 V.
//!
//! What the stage senses and does are words of memory, which [`qemu`]'s pipes carry, one exchange a PWM period:
//!
//! - `to-host`, 28 bytes: 1 if the bridge is on; the duties of A, B, C (f32); serial bytes taken so far; cost of the last
//!   current tick; how often the watchdog was fed;
//! - `to-guest`, 28 bytes: order, counter, the number of serial bytes to wait for, codes of B and C (16 bits each, B
//!   low), bus voltage (V, f32), temperature (°C, f32), status words of the gate driver (16 bits each, the first low; both 0 if
//!   all is well).

#[path = "qemu.rs"]
mod qemu;

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use firmware::board::{Housekeeping, PowerStage};
use firmware::power::{Bridge, ODRIVE_V3_24V, Sensed, StageFacts};
use firmware::store::Store;
use protocol::ResetReason;
use stm32f4xx_hal::pac::{self, Interrupt, NVIC, interrupt};

use qemu::{Pipes, SettingsFile, order};
pub use qemu::{SerialOut, Storage, stopwatch, tick_cost};

/// What this board is called.
pub const NAME: &str = "emulated_drive";

static COUNTER: AtomicU32 = AtomicU32::new(0);
/// As they come: B low, C high. In the middle until the first period.
static CODES: AtomicU32 = AtomicU32::new(2048 << 16 | 2048);
static BUS: AtomicU32 = AtomicU32::new(0);
static TEMPERATURE: AtomicU32 = AtomicU32::new(0);
static GATE_DRIVER: AtomicU32 = AtomicU32::new(0);
static OVERRAN: AtomicBool = AtomicBool::new(false);
static GATE_FAULT: AtomicBool = AtomicBool::new(false);
static ON: AtomicBool = AtomicBool::new(false);
static DUTIES: [AtomicU32; 3] = [const { AtomicU32::new(0) }; 3];
static FED: AtomicU32 = AtomicU32::new(0);

/// What the board hands to the tasks.
pub struct Board {
    /// The bridge, its sensing and the encoder.
    pub stage: Stage,
    /// Temperature, gate driver, watchdog.
    pub housekeeper: Housekeeper,
    /// Bytes from the host.
    pub serial_in: SerialIn,
    /// Bytes to the host.
    pub serial_out: SerialOut,
    /// What keeps settings.
    pub storage: Storage,
    /// What `idle` does.
    pub rest: Rest,
}

/// The words of the bridge, its sensing and the encoder.
pub struct Stage(());

impl PowerStage for Stage {
    const COUNTER_BITS: u32 = 16;

    fn facts(&self) -> StageFacts {
        ODRIVE_V3_24V
    }

    fn acknowledge(&mut self) -> bool {
        OVERRAN.load(Relaxed)
    }

    fn sensed(&mut self) -> Sensed {
        let codes = CODES.load(Relaxed);
        Sensed {
            currents: [codes as u16, (codes >> 16) as u16],
            bus_v: f32::from_bits(BUS.load(Relaxed)),
            counter: COUNTER.load(Relaxed),
        }
    }

    fn apply(&mut self, bridge: Bridge) {
        match bridge {
            Bridge::On(duties) if !GATE_FAULT.load(Relaxed) => {
                for (word, part) in DUTIES.iter().zip(duties.parts()) {
                    word.store(part.to_bits(), Relaxed);
                }
                ON.store(true, Relaxed);
            }
            _ => outputs_off(),
        }
    }

    fn gate_fault(&mut self) -> bool {
        let fell = GATE_FAULT.load(Relaxed);
        GATE_FAULT.store(false, Relaxed);
        fell
    }
}

/// The words of temperature and gate driver.
pub struct Housekeeper(());

impl Housekeeping for Housekeeper {
    fn temperature_c(&mut self) -> f32 {
        f32::from_bits(TEMPERATURE.load(Relaxed))
    }

    fn gate_driver(&mut self) -> Result<(), [u16; 2]> {
        match GATE_DRIVER.load(Relaxed) {
            0 => Ok(()),
            words => Err([words as u16, (words >> 16) as u16]),
        }
    }

    fn restart_gate_driver(&mut self) -> Result<(), [u16; 2]> {
        self.gate_driver()
    }

    fn feed_watchdog(&mut self) {
        FED.store(FED.load(Relaxed).wrapping_add(1), Relaxed);
    }

    fn reset_reason(&self) -> ResetReason {
        ResetReason::Unknown
    }
}

/// USART1's receive register. Its interrupt hands over to UART4's, which this chip's emulator has no line for.
pub struct SerialIn(qemu::SerialIn);

impl SerialIn {
    /// The byte that the interrupt announced.
    pub fn read(&mut self) -> Option<u8> {
        let byte = self.0.read();
        // SAFETY: its handler only masks it again and pends another.
        unsafe { NVIC::unmask(Interrupt::USART1) };
        byte
    }
}

/// A byte is there: until it is taken, no more of this.
#[interrupt]
fn USART1() {
    NVIC::mask(Interrupt::USART1);
    NVIC::pend(Interrupt::UART4);
}

/// nFAULT fell: the outputs off, then a word to the current tick. Above every task, and never masked by their
/// locks.
#[interrupt]
fn EXTI2() {
    outputs_off();
    GATE_FAULT.store(true, Relaxed);
}

/// See [`qemu::set_up`].
pub fn set_up(device: pac::Peripherals) -> Board {
    // SAFETY: the handlers above share atomics with the tasks and break no critical section.
    unsafe {
        let mut core = cortex_m::Peripherals::steal();
        // 0 is above all of RTIC's.
        core.NVIC.set_priority(Interrupt::EXTI2, 0);
        NVIC::unmask(Interrupt::EXTI2);
        NVIC::unmask(Interrupt::USART1);
    }
    Board {
        stage: Stage(()),
        housekeeper: Housekeeper(()),
        serial_in: SerialIn(qemu::SerialIn::new()),
        serial_out: qemu::set_up(device.USART1, &device.TIM5),
        storage: SettingsFile::open().map(|file| Store::new(file, 0)),
        rest: Rest(Pipes::open()),
    }
}

/// nFAULT falls; no current tick.
const GATE_FAULT_ORDER: u32 = 7;

/// What `idle` does: exchanges with the world, one after the other.
pub struct Rest(Pipes);

impl Rest {
    /// One exchange.
    pub fn rest(&mut self) {
        let [order, counter, until, codes, bus, temperature, gate_driver] =
            self.0.exchange(report());
        qemu::wait_for_bytes(until);
        match order {
            order::TICK | order::LATE_TICK => {
                COUNTER.store(counter, Relaxed);
                CODES.store(codes, Relaxed);
                BUS.store(bus, Relaxed);
                TEMPERATURE.store(temperature, Relaxed);
                GATE_DRIVER.store(gate_driver, Relaxed);
                OVERRAN.store(order == order::LATE_TICK, Relaxed);
                NVIC::pend(Interrupt::ADC);
                cortex_m::asm::isb();
            }
            GATE_FAULT_ORDER => {
                NVIC::pend(Interrupt::EXTI2);
                cortex_m::asm::isb();
            }
            other => qemu::carry_out(other),
        }
    }
}

/// How things stand.
fn report() -> [u32; 7] {
    let [a, b, c] = [0, 1, 2].map(|phase: usize| DUTIES[phase].load(Relaxed));
    let on = u32::from(ON.load(Relaxed));
    [on, a, b, c, qemu::taken(), qemu::cost(), FED.load(Relaxed)]
}

/// All six switches off.
fn outputs_off() {
    ON.store(false, Relaxed);
    for word in &DUTIES {
        word.store(0, Relaxed);
    }
}

//! The board inside QEMU (`-M netduinoplus2`, an STM32F405), in lockstep with a plant outside.
//!
//! Encoder and torque are two words of memory, which [`qemu`]'s pipes carry:
//!
//! - `to-host`, 16 bytes: torque (f32), serial bytes taken so far, cost of the last tick, period (f32);
//! - `to-guest`, 12 bytes: order, counter, and the number of serial bytes to wait for.

#[path = "qemu.rs"]
mod qemu;

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use firmware::board::{AngleCounter, TickClock, TorqueOutput};
use firmware::store::Store;
use stm32f4xx_hal::pac::{self, Interrupt, NVIC};

use qemu::{Pipes, SettingsFile, order};
pub use qemu::{SerialIn, SerialOut, Storage, stopwatch, tick_cost};

/// What this board is called.
pub const NAME: &str = "emulated";

static COUNTER: AtomicU32 = AtomicU32::new(0);
static TORQUE: AtomicU32 = AtomicU32::new(0);
static PERIOD: AtomicU32 = AtomicU32::new(0);
static OVERRAN: AtomicBool = AtomicBool::new(false);

/// What the board hands to the tasks.
pub struct Board {
    /// The tick's clock.
    pub clock: Clock,
    /// The angle sensor.
    pub encoder: Encoder,
    /// The torque output.
    pub torque: Torque,
    /// Bytes from the host.
    pub serial_in: SerialIn,
    /// Bytes to the host.
    pub serial_out: SerialOut,
    /// What keeps settings.
    pub storage: Storage,
    /// What `idle` does.
    pub rest: Rest,
}

/// The word that the plant's count was put in.
pub struct Encoder(());

impl AngleCounter for Encoder {
    const BITS: u32 = 32;

    fn counter(&mut self) -> u32 {
        COUNTER.load(Relaxed)
    }
}

/// The word that the plant gets its torque from.
pub struct Torque(());

impl TorqueOutput for Torque {
    fn set_nm(&mut self, torque_nm: f32) {
        TORQUE.store(torque_nm.to_bits(), Relaxed);
    }
}

/// The host decides when it is time for a tick.
pub struct Clock(());

impl TickClock for Clock {
    fn set_period_s(&mut self, period_s: f32) {
        PERIOD.store(period_s.to_bits(), Relaxed);
    }

    // The plant's time passes by exactly that.
    fn elapsed_s(&mut self) -> f32 {
        f32::from_bits(PERIOD.load(Relaxed))
    }

    fn acknowledge(&mut self) -> bool {
        OVERRAN.load(Relaxed)
    }
}

/// See [`qemu::set_up`].
pub fn set_up(device: pac::Peripherals) -> Board {
    Board {
        clock: Clock(()),
        encoder: Encoder(()),
        torque: Torque(()),
        serial_in: SerialIn::new(),
        serial_out: qemu::set_up(device.USART1, &device.TIM5),
        storage: SettingsFile::open().map(|file| Store::new(file, 0)),
        rest: Rest(Pipes::open()),
    }
}

/// What `idle` does: exchanges with the plant, one after the other.
pub struct Rest(Pipes);

impl Rest {
    /// One exchange.
    pub fn rest(&mut self) {
        let [order, counter, until] = self.0.exchange(report());
        qemu::wait_for_bytes(until);
        match order {
            order::TICK | order::LATE_TICK => {
                COUNTER.store(counter, Relaxed);
                OVERRAN.store(order == order::LATE_TICK, Relaxed);
                NVIC::pend(Interrupt::TIM2);
                cortex_m::asm::isb();
            }
            other => qemu::carry_out(other),
        }
    }
}

/// How things stand.
fn report() -> [u32; 4] {
    let (torque, period) = (TORQUE.load(Relaxed), PERIOD.load(Relaxed));
    [torque, qemu::taken(), qemu::cost(), period]
}

/// No torque.
fn outputs_off() {
    TORQUE.store(0, Relaxed);
}

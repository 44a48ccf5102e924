//! The board inside QEMU (`-M netduinoplus2`, an STM32F405), in lockstep with a plant outside.
//!
//! Encoder and torque are two words of memory. Between two ticks, when every task sleeps, `idle`
//! carries them over two named pipes in QEMU's working directory, and is told what to do next:
//!
//! - `to-host`, 16 bytes: torque (f32), serial bytes taken so far, cost of the last tick, period (f32);
//! - `to-guest`, 12 bytes: order, counter, and the number of serial bytes to wait for.
//!
//! All words are little endian. The chip stands still while it waits for the answer, so the plant's time and the
//! ticks are one, and a run is the same every time.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use defmt_semihosting as _;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use firmware::board::{AngleCounter, SerialOutput, TickClock, TorqueOutput};
use firmware::store::{SLOT, Store};
use semihosting::fs::File;
use semihosting::io::{Read, Seek, SeekFrom, Write};
use semihosting::process;
use stm32f4xx_hal::pac::{self, Interrupt, NVIC};

/// What this board is called.
pub const NAME: &str = "emulated";

static COUNTER: AtomicU32 = AtomicU32::new(0);
static TORQUE: AtomicU32 = AtomicU32::new(0);
static PERIOD: AtomicU32 = AtomicU32::new(0);
static OVERRAN: AtomicBool = AtomicBool::new(false);
static TAKEN: AtomicU32 = AtomicU32::new(0);
static COST: AtomicU32 = AtomicU32::new(0);

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

/// QEMU's flash answers Ok to erase and program, and stores nothing. A file takes its place; without one the
/// board keeps no settings.
pub type Storage = Option<Store<SettingsFile>>;

/// The file `settings` in QEMU's working directory, as two small sectors of flash.
pub struct SettingsFile(File);

/// The file could not be read or written.
#[derive(Debug)]
pub struct FileError;

impl NorFlashError for FileError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl SettingsFile {
    fn open() -> Option<Self> {
        let file = File::options().read(true).write(true).open(c"settings");
        file.ok().map(Self)
    }

    fn at(&mut self, offset: u32) -> Result<&mut File, FileError> {
        let place = SeekFrom::Start(u64::from(offset));
        self.0.seek(place).map_err(|_| FileError)?;
        Ok(&mut self.0)
    }
}

impl ErrorType for SettingsFile {
    type Error = FileError;
}

impl ReadNorFlash for SettingsFile {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FileError> {
        let file = self.at(offset)?;
        file.read_exact(bytes).map_err(|_| FileError)
    }

    fn capacity(&self) -> usize {
        2 * Self::ERASE_SIZE
    }
}

impl NorFlash for SettingsFile {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FileError> {
        for offset in (from..to).step_by(SLOT) {
            self.write(offset, &[0xFF; SLOT])?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FileError> {
        let file = self.at(offset)?;
        file.write_all(bytes).map_err(|_| FileError)
    }
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

/// USART1's receive register.
pub struct SerialIn(());

impl SerialIn {
    /// The byte that the interrupt announced.
    pub fn read(&mut self) -> Option<u8> {
        // SAFETY: only this type reads SR and DR; reading takes nothing from the transmitter.
        let usart = unsafe { &*pac::USART1::ptr() };
        if usart.sr().read().rxne().bit_is_clear() {
            return None;
        }
        let byte = usart.dr().read().dr().bits() as u8;
        TAKEN.store(TAKEN.load(Relaxed).wrapping_add(1), Relaxed);
        Some(byte)
    }
}

/// USART1's transmit register.
pub struct SerialOut(pac::USART1);

impl SerialOutput for SerialOut {
    // By polling: QEMU models neither the transmit interrupt nor DMA.
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            while self.0.sr().read().txe().bit_is_clear() {}
            self.0.dr().write(|w| w.dr().set(u16::from(*byte)));
        }
    }
}

/// Serial line on, TIM5 free-running as a stopwatch. No clocks: RCC reads 0 here.
pub fn set_up(device: pac::Peripherals) -> Board {
    let line = device.USART1.cr1();
    line.write(|w| {
        w.ue()
            .set_bit()
            .re()
            .set_bit()
            .te()
            .set_bit()
            .rxneie()
            .set_bit()
    });
    device.TIM5.cr1().write(|w| w.cen().set_bit());
    Board {
        clock: Clock(()),
        encoder: Encoder(()),
        torque: Torque(()),
        serial_in: SerialIn(()),
        serial_out: SerialOut(device.USART1),
        storage: SettingsFile::open().map(|file| Store::new(file, 0)),
        rest: Rest::open(),
    }
}

/// Nanoseconds of virtual time; with `-icount shift=0`, instructions.
pub fn stopwatch() -> u32 {
    // SAFETY: reads a free-running counter.
    unsafe { &*pac::TIM5::ptr() }.cnt().read().bits()
}

/// Notes what the tick cost.
pub fn tick_cost(start: u32) {
    COST.store(stopwatch().wrapping_sub(start), Relaxed);
}

/// What `idle` does: exchanges with the plant, one after the other.
pub struct Rest {
    to_host: File,
    to_guest: File,
}

/// What the plant's side may order.
mod order {
    pub const HOLD: u32 = 0;
    pub const TICK: u32 = 1;
    pub const LATE_TICK: u32 = 2;
    pub const EXIT: u32 = 3;
    pub const PANIC: u32 = 4;
    pub const HARD_FAULT: u32 = 5;
    pub const STACK: u32 = 6;
}

impl Rest {
    fn open() -> Self {
        let to_host = File::options()
            .write(true)
            .truncate(true)
            .create(true)
            .open(c"to-host");
        match (to_host, File::open(c"to-guest")) {
            (Ok(to_host), Ok(to_guest)) => Self { to_host, to_guest },
            _ => panic!("the pipes to-host and to-guest cannot be opened"),
        }
    }

    /// Tells the plant's side how things stand.
    fn report(&mut self) {
        let words = [&TORQUE, &TAKEN, &COST, &PERIOD].map(|word| word.load(Relaxed).to_le_bytes());
        if self.to_host.write_all(words.as_flattened()).is_err() {
            process::exit(ExitCode::LOST);
        }
    }

    /// One exchange.
    pub fn rest(&mut self) {
        self.report();
        let mut answer = [[0; 4]; 3];
        if self.to_guest.read_exact(answer.as_flattened_mut()).is_err() {
            process::exit(ExitCode::LOST);
        }
        let [order, counter, until] = answer.map(u32::from_le_bytes);
        while (TAKEN.load(Relaxed).wrapping_sub(until) as i32) < 0 {
            // Masked, so that no interrupt slips in between the look and the sleep; a pending
            // one ends it all the same, and is taken when the mask goes.
            cortex_m::interrupt::disable();
            if (TAKEN.load(Relaxed).wrapping_sub(until) as i32) < 0 {
                cortex_m::asm::wfi();
            }
            // SAFETY: no critical section is open here.
            unsafe { cortex_m::interrupt::enable() };
            cortex_m::asm::isb();
        }
        match order {
            order::HOLD => {}
            order::TICK | order::LATE_TICK => {
                COUNTER.store(counter, Relaxed);
                OVERRAN.store(order == order::LATE_TICK, Relaxed);
                NVIC::pend(Interrupt::TIM2);
                cortex_m::asm::isb();
            }
            order::STACK => COST.store(stack_used(), Relaxed),
            order::EXIT => process::exit(ExitCode::DONE),
            order::PANIC => panic!("ordered to panic"),
            order::HARD_FAULT => {
                // SAFETY: nothing is there; the fault is what is wanted.
                unsafe { core::ptr::read_volatile(0x4001_1800 as *const u32) };
            }
            _ => process::exit(ExitCode::LOST),
        }
    }
}

/// The most stack that was ever used, bytes: what is left of the paint that `cortex-m-rt`
/// gave it.
fn stack_used() -> u32 {
    const PAINT: u32 = 0xCCCC_CCCC;
    unsafe extern "C" {
        static _stack_start: u32;
        static _stack_end: u32;
    }
    let (top, bottom) = (&raw const _stack_start, &raw const _stack_end);
    let mut used = top as u32 - bottom as u32;
    let mut word = bottom;
    // SAFETY: the linker script's stack, from its end up to its start, is RAM; only read.
    while word < top && unsafe { word.read_volatile() } == PAINT {
        used -= 4;
        word = word.wrapping_add(1);
    }
    used
}

/// What QEMU exits with.
struct ExitCode;

impl ExitCode {
    const DONE: i32 = 0;
    const PANIC: i32 = 101;
    const HARD_FAULT: i32 = 102;
    const PANIC_AGAIN: i32 = 103;
    const LOST: i32 = 104;
}

static PANICKED: AtomicBool = AtomicBool::new(false);

/// Torque off first; then tell the plant, then whoever reads the log.
fn stop() {
    cortex_m::interrupt::disable();
    TORQUE.store(0, Relaxed);
    if let Ok(mut pipe) = File::options()
        .write(true)
        .truncate(true)
        .create(true)
        .open(c"to-host")
    {
        let words = [&TORQUE, &TAKEN, &COST, &PERIOD].map(|word| word.load(Relaxed).to_le_bytes());
        let _ = pipe.write_all(words.as_flattened());
    }
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    stop();
    // A panic inside the logger would come back here for ever.
    if PANICKED.swap(true, Relaxed) {
        process::exit(ExitCode::PANIC_AGAIN);
    }
    defmt::error!("{}", defmt::Display2Format(info));
    process::exit(ExitCode::PANIC)
}

#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    stop();
    defmt::error!("hard fault at {=u32:#010x}", frame.pc());
    process::exit(ExitCode::HARD_FAULT)
}

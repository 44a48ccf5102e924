//! What the boards inside QEMU (`-M netduinoplus2`, an STM32F405) have in common: two pipes to whoever plays the
//! world, the serial line, a file in the place of the flash, a stopwatch, and the end.
//!
//! Between two interrupts, when every task sleeps, `idle` tells over `to-host` how things stand and is told over
//! `to-guest` what to do next; both are named pipes in QEMU's working directory, and all words are little endian. The chip
//! stands still while it waits for the answer, so the world's time and the ticks are one, and a run is the same every time.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use defmt_semihosting as _;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use firmware::board::SerialOutput;
use firmware::store::{SLOT, Store};
use semihosting::fs::File;
use semihosting::io::{Read, Seek, SeekFrom, Write};
use semihosting::process;
use stm32f4xx_hal::pac;

use super::{outputs_off, report};

/// Serial bytes taken so far.
static TAKEN: AtomicU32 = AtomicU32::new(0);
static COST: AtomicU32 = AtomicU32::new(0);

/// Serial bytes taken since the start.
pub fn taken() -> u32 {
    TAKEN.load(Relaxed)
}

/// What was asked for last: the cost of the last tick, or the stack.
pub fn cost() -> u32 {
    COST.load(Relaxed)
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
    /// Opens it, if it is there.
    pub fn open() -> Option<Self> {
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

/// USART1's receive register.
pub struct SerialIn(());

impl SerialIn {
    /// The only one.
    pub fn new() -> Self {
        Self(())
    }

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

/// Nanoseconds of virtual time; with `-icount shift=0`, instructions.
pub fn stopwatch() -> u32 {
    // SAFETY: reads a free-running counter.
    unsafe { &*pac::TIM5::ptr() }.cnt().read().bits()
}

/// Notes what the tick cost.
pub fn tick_cost(start: u32) {
    COST.store(stopwatch().wrapping_sub(start), Relaxed);
}

/// The serial line on, TIM5 free-running as a stopwatch. No clocks: RCC reads 0 here.
pub fn set_up(line: pac::USART1, timer: &pac::TIM5) -> SerialOut {
    line.cr1().write(|w| {
        w.ue()
            .set_bit()
            .re()
            .set_bit()
            .te()
            .set_bit()
            .rxneie()
            .set_bit()
    });
    timer.cr1().write(|w| w.cen().set_bit());
    SerialOut(line)
}

/// The two pipes.
pub struct Pipes {
    to_host: File,
    to_guest: File,
}

impl Pipes {
    /// Opens them.
    pub fn open() -> Self {
        match (open_to_host(), File::open(c"to-guest")) {
            (Some(to_host), Ok(to_guest)) => Self { to_host, to_guest },
            _ => panic!("the pipes to-host and to-guest cannot be opened"),
        }
    }

    /// One exchange: tells the other side how things stand, and takes what it answers.
    pub fn exchange<const TOLD: usize, const ANSWER: usize>(
        &mut self,
        told: [u32; TOLD],
    ) -> [u32; ANSWER] {
        let mut answer = [[0; 4]; ANSWER];
        let told = told.map(u32::to_le_bytes);
        if self.to_host.write_all(told.as_flattened()).is_err()
            || self.to_guest.read_exact(answer.as_flattened_mut()).is_err()
        {
            process::exit(ExitCode::LOST);
        }
        answer.map(u32::from_le_bytes)
    }
}

fn open_to_host() -> Option<File> {
    let mut options = File::options();
    let options = options.write(true).truncate(true).create(true);
    options.open(c"to-host").ok()
}

/// Sleeps until so many serial bytes were taken.
pub fn wait_for_bytes(until: u32) {
    while (taken().wrapping_sub(until) as i32) < 0 {
        // Masked, so that no interrupt slips in between the look and the sleep; a pending
        // one ends it all the same, and is taken when the mask goes.
        cortex_m::interrupt::disable();
        if (taken().wrapping_sub(until) as i32) < 0 {
            cortex_m::asm::wfi();
        }
        // SAFETY: no critical section is open here.
        unsafe { cortex_m::interrupt::enable() };
        cortex_m::asm::isb();
    }
}

/// What every board may be ordered to do beside its ticks.
pub mod order {
    /// Nothing.
    pub const HOLD: u32 = 0;
    /// A tick.
    pub const TICK: u32 = 1;
    /// A tick that finds another was due before it.
    pub const LATE_TICK: u32 = 2;
    /// End.
    pub const EXIT: u32 = 3;
    /// Panic.
    pub const PANIC: u32 = 4;
    /// Read where nothing is.
    pub const HARD_FAULT: u32 = 5;
    /// Say how much stack was used.
    pub const STACK: u32 = 6;
}

/// Carries out an order that is not the board's own.
pub fn carry_out(order: u32) {
    match order {
        order::HOLD => {}
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

/// The outputs off first; then tell the other side, then whoever reads the log.
fn stop() {
    cortex_m::interrupt::disable();
    outputs_off();
    if let Some(mut pipe) = open_to_host() {
        let words = report().map(u32::to_le_bytes);
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

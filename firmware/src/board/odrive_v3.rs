//! The ODrive v3.5 or v3.6: the chip's end of [`firmware::odrive_v3`], which knows what to do with its registers.
//! Here is only what cannot run anywhere else: the registers themselves, the interrupts that turn the bridge off, and the
//! log, over a debugger (RTT).
//!
//! Nothing of this was run on a board.

use core::panic::PanicInfo;
use core::sync::atomic::{
    AtomicBool, AtomicU32,
    Ordering::{Relaxed, SeqCst},
};

use cortex_m::peripheral::NVIC;
use cortex_m_rt::{ExceptionFrame, exception};
// In its non-blocking mode, which a debugger cannot change: it is a feature of the crate.
use defmt_rtt as _;
use firmware::board::{Housekeeping, SerialOutput};
use firmware::odrive_v3::housekeeping::Slow;
use firmware::odrive_v3::settings_flash::SettingsFlash;
use firmware::odrive_v3::{self, Registers, bridge, pins, serial, stage, supply};
use firmware::store::Store;
use stm32f4xx_hal::pac::{self, Interrupt, interrupt};

/// What this board is called.
pub const NAME: &str = "odrive_v3";

/// Set by nFAULT's interrupt.
static GATE_FAULT: AtomicBool = AtomicBool::new(false);

/// What DMA writes into TIM1 where current ticks do not come. Not constant, so that it lies in RAM, from where an erase of
/// flash does not hold it up.
static OFF: AtomicU32 = AtomicU32::new(bridge::OFF);

/// The chip's registers and flash.
#[derive(Debug, Clone, Copy)]
pub struct Chip(());

impl Registers for Chip {
    #[inline]
    fn read(&mut self, address: u32) -> u32 {
        // SAFETY: only `firmware::odrive_v3` has a `Chip` to call, with the addresses of registers and of flash that
        // are written down there and multiples of 4; all of them may be read at any time. None is Rust's memory.
        unsafe { (address as *const u32).read_volatile() }
    }

    #[inline]
    fn write(&mut self, address: u32, value: u32) {
        // SAFETY: as above. No register written there has the chip change memory that Rust owns: the one DMA
        // stream reads a word of it, an atomic, and flash is written only in the two sectors that no program lies in. A register that is changed by reading and
        // writing it back belongs to one task.
        unsafe { (address as *mut u32).write_volatile(value) }
    }

    #[inline]
    fn wait_us(&mut self, time_us: u32) {
        cortex_m::asm::delay(time_us.saturating_mul(168));
    }
}

/// The bridge, its sensing and the encoder.
pub type Stage = stage::Stage<Chip>;
/// Temperature, gate driver, watchdog.
pub type Housekeeper = Slow<Chip>;
/// What keeps settings.
pub type Storage = Store<SettingsFlash<Chip>>;

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

/// Sets everything up, the gate driver too, the bridge off; interrupts are masked. Current ticks come as soon as
/// they are not. A gate driver that does not answer is found by the first look at it.
pub fn set_up(_device: pac::Peripherals) -> Board {
    let mut chip = Chip(());
    let reset = match odrive_v3::set_up(&mut chip, OFF.as_ptr() as u32) {
        Ok(reset) => reset,
        Err(error) => panic!("{}", error.text()),
    };
    let variant = supply::variant(&mut chip);
    let mut housekeeper = Slow::new(chip, reset);
    if let Err([one, two]) = housekeeper.restart_gate_driver() {
        defmt::error!("gate driver: {=u16:#x} {=u16:#x}", one, two);
    }
    // SAFETY: the handler below is ready, shares an atomic with the tasks, and breaks no critical section: it
    // writes registers that are safe at any time.
    unsafe {
        let mut core = cortex_m::Peripherals::steal();
        // 0 is above all of RTIC's.
        core.NVIC.set_priority(Interrupt::EXTI2, 0);
        NVIC::unmask(Interrupt::EXTI2);
    }
    Board {
        stage: stage::Stage::new(chip, variant, &GATE_FAULT),
        housekeeper,
        serial_in: SerialIn(chip),
        serial_out: SerialOut(chip),
        storage: Store::new(SettingsFlash::new(chip), 0),
        rest: Rest(()),
    }
}

/// nFAULT fell: the outputs off, then a word to the current tick. Above every task, and never masked by their
/// locks.
#[interrupt]
fn EXTI2() {
    bridge::off(&mut Chip(()));
    GATE_FAULT.store(true, SeqCst);
    pins::acknowledge_fault(&mut Chip(()));
}

/// UART4's receiver.
pub struct SerialIn(Chip);

impl SerialIn {
    /// The byte that the interrupt announced.
    pub fn read(&mut self) -> Option<u8> {
        serial::receive(&mut self.0)
    }
}

/// UART4's transmitter.
pub struct SerialOut(Chip);

impl SerialOutput for SerialOut {
    fn write(&mut self, bytes: &[u8]) {
        serial::send(&mut self.0, bytes);
    }
}

/// What `idle` does.
pub struct Rest(());

impl Rest {
    /// Sleeps until an interrupt.
    pub fn rest(&mut self) {
        cortex_m::asm::wfi();
    }
}

/// A stopwatch: ticks of 84 MHz.
pub fn stopwatch() -> u32 {
    odrive_v3::stopwatch(&mut Chip(()))
}

/// The longest current tick so far, ticks of the stopwatch: for a debugger to read.
static LONGEST_TICK: AtomicU32 = AtomicU32::new(0);

/// Notes what a current tick cost.
#[inline]
pub fn tick_cost(start: u32) {
    let cost = stopwatch().wrapping_sub(start);
    if cost > LONGEST_TICK.load(Relaxed) {
        LONGEST_TICK.store(cost, Relaxed);
    }
}

/// Outputs off, and nothing more happens until the watchdog resets the chip.
fn stop() -> ! {
    loop {
        core::hint::spin_loop();
    }
}

static PANICKED: AtomicBool = AtomicBool::new(false);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    bridge::off(&mut Chip(()));
    cortex_m::interrupt::disable();
    // A panic inside the logger would come back here for ever.
    if !PANICKED.swap(true, SeqCst) {
        defmt::error!("{}", defmt::Display2Format(info));
    }
    stop()
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    bridge::off(&mut Chip(()));
    defmt::error!("hard fault at {=u32:#010x}", frame.pc());
    stop()
}

/// The crystal stopped: the clock security system has broken the outputs off, and here they are kept off.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    bridge::off(&mut Chip(()));
    stop()
}

/// An interrupt that nobody asked for.
#[exception]
unsafe fn DefaultHandler(_number: i16) -> ! {
    bridge::off(&mut Chip(()));
    stop()
}

//! The ODrive v3.5 or v3.6 and its clones, up to the registers: all that sets the chip up and drives it, by way of
//! [`Registers`], so that it runs natively too and is tested there against recorded register writes.
//!
//! Names of registers and bits are those of the STM32F405's reference manual (RM0090). Figures of the board come
//! from its maker's public firmware and schematics and from data sheets. **Nothing of this was run on a board.**
//!
//! | module | subject |
//! |---|---|
//! | [`clocks`] | 168 MHz from the crystal, wait states, clocks of the peripherals |
//! | [`pins`] | every pin of the board, outputs off first |
//! | [`bridge`] | TIM1: PWM, dead time, arming, off |
//! | [`dead_man`] | TIM8: off where current ticks do not come |
//! | [`current_sense`] | the three ADCs, triggered by TIM1 |
//! | [`encoder`] | TIM3 as quadrature counter |
//! | [`serial`] | UART4 |
//! | [`spi`] | SPI3, to the gate driver |
//! | [`gate_driver`] | the DRV8301: set, read back, checked again |
//! | [`supply`] | variant of the board, bus voltage, FET temperature |
//! | [`watchdog`] | IWDG, and what stands still under a debugger |
//! | [`settings_flash`] | sectors 10 and 11 of the flash |
//! | [`reset`] | why the chip was reset |
//! | [`stage`] | the above, once in each PWM period |
//! | [`housekeeping`] | the above, 10 to 100 times a second |

pub mod bridge;
pub mod clocks;
pub mod current_sense;
pub mod dead_man;
pub mod encoder;
pub mod gate_driver;
pub mod housekeeping;
pub mod pins;
pub mod reset;
pub mod serial;
pub mod settings_flash;
pub mod spi;
pub mod stage;
pub mod supply;
pub mod watchdog;

use protocol::ResetReason;

/// The registers of the chip, and its flash: whole words at addresses that are multiples of 4.
pub trait Registers {
    /// Reads a word.
    fn read(&mut self, address: u32) -> u32;

    /// Writes a word.
    fn write(&mut self, address: u32, value: u32);

    /// Lets at least this time go by, µs; up to eleven times as long before [`clocks::set_up`].
    fn wait_us(&mut self, time_us: u32);

    /// Sets bits and leaves the others.
    fn set(&mut self, address: u32, bits: u32) {
        self.change(address, bits, bits);
    }

    /// Clears bits and leaves the others.
    fn clear(&mut self, address: u32, bits: u32) {
        self.change(address, bits, 0);
    }

    /// Writes the bits in `mask` and leaves the others.
    fn change(&mut self, address: u32, mask: u32, value: u32) {
        let others = self.read(address) & !mask;
        self.write(address, others | value);
    }

    /// True as soon as the bits in `mask` read as `value`; false when they do not after so many looks, 10 µs apart.
    fn becomes(&mut self, address: u32, mask: u32, value: u32, looks: u32) -> bool {
        for _ in 0..looks {
            if self.read(address) & mask == value {
                return true;
            }
            self.wait_us(10);
        }
        false
    }
}

impl<R: Registers + ?Sized> Registers for &mut R {
    fn read(&mut self, address: u32) -> u32 {
        (**self).read(address)
    }

    fn write(&mut self, address: u32, value: u32) {
        (**self).write(address, value);
    }

    fn wait_us(&mut self, time_us: u32) {
        (**self).wait_us(time_us);
    }
}

/// Why the chip cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SetUpError {
    /// The internal oscillator did not take over: it runs in every working chip.
    InternalClock,
    /// The 8 MHz crystal did not start.
    Crystal,
    /// The PLL did not lock, or was not taken as the system clock.
    Pll,
    /// The PWM timer does not update, or not at the end of its count at which currents are measured.
    PwmUpdate,
    /// The bridge is not turned off where current ticks do not come.
    DeadMan,
}

impl SetUpError {
    /// What is wrong, and what to look at.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::InternalClock => "the internal oscillator did not start: the chip is damaged",
            Self::Crystal => "the 8 MHz crystal did not start: not this board, or damaged",
            Self::Pll => "no 168 MHz from the crystal: a crystal of 8 MHz is needed",
            Self::PwmUpdate => "TIM1 does not update where its count is highest",
            Self::DeadMan => "TIM8 does not turn the bridge off",
        }
    }
}

const SCB_VTOR: u32 = 0xE000_ED08;
const FLASH: u32 = 0x0800_0000;
const TIM5_CR1: u32 = 0x4000_0C00;
const TIM5_CNT: u32 = 0x4000_0C24;

/// A free-running stopwatch: ticks of 84 MHz, wrapping after 51 s.
#[inline]
pub fn stopwatch(registers: &mut impl Registers) -> u32 {
    registers.read(TIM5_CNT)
}

/// Sets up all but the gate driver, which is still off afterwards, and starts the current tick's interrupt.
/// Everything that drives something is off first, before anything that may fail or takes time. At `off_address` in the
/// chip's memory [`bridge::OFF`] lies for good, for [`dead_man`].
///
/// # Errors
/// Where there are no right clocks or no right PWM. All outputs are off then.
pub fn set_up(registers: &mut impl Registers, off_address: u32) -> Result<ResetReason, SetUpError> {
    bridge::off(registers);
    pins::hold_off(registers);
    let reason = reset::take_reason(registers);
    // The ROM's bootloader, which may have started us, has its own vectors at 0.
    registers.write(SCB_VTOR, FLASH);
    clocks::set_up(registers)?;
    watchdog::freeze_in_debug(registers);
    watchdog::start(registers);
    clocks::feed_peripherals(registers);
    registers.write(TIM5_CR1, 1);
    bridge::set_up(registers);
    pins::connect(registers);
    encoder::set_up(registers);
    serial::set_up(registers);
    spi::set_up(registers);
    current_sense::set_up(registers);
    dead_man::start(registers, off_address)?;
    bridge::start(registers)?;
    current_sense::start(registers);
    Ok(reason)
}

//! 168 MHz from the crystal of 8 MHz: AHB 168 MHz, APB1 42 MHz (its timers 84), APB2 84 MHz (its timers 168),
//! 48 MHz for USB. RM0090, 3.5.1 and 7.2.

use super::{Registers, SetUpError};

const FLASH_ACR: u32 = 0x4002_3C00;
const LATENCY_5: u32 = 5;
const LATENCY: u32 = 7;
const PRFTEN: u32 = 1 << 8;
const ICEN: u32 = 1 << 9;
const DCEN: u32 = 1 << 10;

const PWR_CR: u32 = 0x4000_7000;
const VOS: u32 = 1 << 14;
const PVDE: u32 = 1 << 4;
const PLS: u32 = 7 << 5;
/// 2.9 V, falling.
const PLS_7: u32 = 7 << 5;

const RCC_CR: u32 = 0x4002_3800;
const HSION: u32 = 1 << 0;
const HSIRDY: u32 = 1 << 1;
const HSEON: u32 = 1 << 16;
const HSERDY: u32 = 1 << 17;
const HSEBYP: u32 = 1 << 18;
const CSSON: u32 = 1 << 19;
const PLLON: u32 = 1 << 24;
const PLLRDY: u32 = 1 << 25;

const RCC_PLLCFGR: u32 = 0x4002_3804;
/// 8 MHz / 4 · 168 = 336 MHz; / 2 is the system's clock, / 7 that of USB.
const PLL_336_MHZ: u32 = 4 | 168 << 6 | PLLP_2 | PLLSRC_HSE | 7 << 24;
const PLLP_2: u32 = 0 << 16;
const PLLSRC_HSE: u32 = 1 << 22;

const RCC_CFGR: u32 = 0x4002_3808;
const SW: u32 = 3;
const SW_HSI: u32 = 0;
const SW_PLL: u32 = 2;
const SWS: u32 = 3 << 2;
const SWS_HSI: u32 = 0;
const SWS_PLL: u32 = 2 << 2;
/// HPRE, PPRE1, PPRE2.
const DIVIDERS: u32 = 0xF << 4 | 7 << 10 | 7 << 13;
const PPRE1_4: u32 = 5 << 10;
const PPRE2_2: u32 = 4 << 13;

const RCC_APB1RSTR: u32 = 0x4002_3820;
const RCC_APB2RSTR: u32 = 0x4002_3824;
const RCC_APB1ENR: u32 = 0x4002_3840;
const TIM3: u32 = 1 << 1;
const TIM5: u32 = 1 << 3;
const SPI3: u32 = 1 << 15;
const UART4: u32 = 1 << 19;
const PWR: u32 = 1 << 28;
const RCC_APB2ENR: u32 = 0x4002_3844;
const TIM1: u32 = 1 << 0;
const TIM8: u32 = 1 << 1;
const ADC1: u32 = 1 << 8;
const ADC2: u32 = 1 << 9;
const ADC3: u32 = 1 << 10;
const SYSCFG: u32 = 1 << 14;
/// One bit resets all three.
const ADC_RESET: u32 = 1 << 8;

/// 20 ms and more: a crystal takes 2 ms.
const LOOKS: u32 = 2000;

/// Switches to 168 MHz. Begins at the internal oscillator, whatever ran before: the ROM's bootloader leaves its own
/// clocks behind. The clock security system is on afterwards: when the crystal stops, TIM1's outputs are broken off
/// and NMI comes.
///
/// The supply is watched from here on (PVD, 2.9 V), because brown-out reset is off in a chip as it is delivered, and only option
/// bytes turn it on: [`super::settings_flash`] refuses to write below.
///
/// # Errors
/// If an oscillator or the PLL does not start; the chip runs from its internal oscillator then.
pub fn set_up(registers: &mut impl Registers) -> Result<(), SetUpError> {
    registers.set(RCC_APB1ENR, PWR);
    // Before the clock is fast, not after.
    registers.change(
        FLASH_ACR,
        LATENCY | PRFTEN | ICEN | DCEN,
        LATENCY_5 | PRFTEN | ICEN | DCEN,
    );
    registers.set(RCC_CR, HSION);
    if !registers.becomes(RCC_CR, HSIRDY, HSIRDY, LOOKS) {
        return Err(SetUpError::InternalClock);
    }
    registers.change(RCC_CFGR, SW, SW_HSI);
    if !registers.becomes(RCC_CFGR, SWS, SWS_HSI, LOOKS) {
        return Err(SetUpError::InternalClock);
    }
    // PLLCFGR and VOS take nothing while the PLL runs.
    registers.clear(RCC_CR, PLLON);
    if !registers.becomes(RCC_CR, PLLRDY, 0, LOOKS) {
        return Err(SetUpError::Pll);
    }
    registers.change(PWR_CR, VOS | PVDE | PLS, VOS | PVDE | PLS_7);
    registers.clear(RCC_CR, HSEBYP);
    registers.set(RCC_CR, HSEON);
    if !registers.becomes(RCC_CR, HSERDY, HSERDY, LOOKS) {
        registers.clear(RCC_CR, HSEON);
        return Err(SetUpError::Crystal);
    }
    registers.write(RCC_PLLCFGR, PLL_336_MHZ);
    registers.set(RCC_CR, PLLON);
    if !registers.becomes(RCC_CR, PLLRDY, PLLRDY, LOOKS) {
        return Err(SetUpError::Pll);
    }
    registers.change(RCC_CFGR, DIVIDERS, PPRE1_4 | PPRE2_2);
    if !registers.becomes(FLASH_ACR, LATENCY, LATENCY_5, LOOKS) {
        return Err(SetUpError::Pll);
    }
    registers.change(RCC_CFGR, SW, SW_PLL);
    if !registers.becomes(RCC_CFGR, SWS, SWS_PLL, LOOKS) {
        return Err(SetUpError::Pll);
    }
    registers.set(RCC_CR, CSSON);
    Ok(())
}

/// Clocks for the peripherals in use, each reset to what the manual says. The pins have theirs from
/// [`super::pins::hold_off`].
pub fn feed_peripherals(registers: &mut impl Registers) {
    registers.set(RCC_APB1ENR, TIM3 | TIM5 | SPI3 | UART4 | PWR);
    registers.set(RCC_APB2ENR, TIM1 | TIM8 | ADC1 | ADC2 | ADC3 | SYSCFG);
    // A peripheral takes nothing in the first two cycles of its clock.
    registers.read(RCC_APB2ENR);
    registers.set(RCC_APB1RSTR, TIM3 | TIM5 | SPI3 | UART4);
    registers.clear(RCC_APB1RSTR, TIM3 | TIM5 | SPI3 | UART4);
    registers.set(RCC_APB2RSTR, TIM1 | TIM8 | ADC_RESET);
    registers.clear(RCC_APB2RSTR, TIM1 | TIM8 | ADC_RESET);
    registers.read(RCC_APB2RSTR);
}

//! What turns the bridge off where current ticks do not come, whatever holds them up: a handler that hangs, masked
//! interrupts, a core that has locked up. No program takes part in it.
//!
//! TIM8, which belongs to the other axis, counts four PWM periods. Each current tick sets it back to 0. Where it gets to
//! its end all the same, its update has DMA write one word into TIM1's BDTR: MOE and AOE clear, and again after every four
//! periods. The word lies in memory, and DMA has fetched it beforehand. RM0090, 10 (DMA2, stream 1, channel 7 is TIM8_UP), 17.
//!
//! Otherwise the last duties would stay in force until the watchdog bites, seconds later.

use super::{Registers, SetUpError, bridge};

const RCC_AHB1ENR: u32 = 0x4002_3830;
const DMA2EN: u32 = 1 << 22;

const DMA2_S1CR: u32 = 0x4002_6428;
const EN: u32 = 1 << 0;
const MEMORY_TO_PERIPHERAL: u32 = 1 << 6;
const CIRC: u32 = 1 << 8;
const PSIZE_32: u32 = 2 << 11;
const MSIZE_32: u32 = 2 << 13;
const PL_VERY_HIGH: u32 = 3 << 16;
const CHSEL_7: u32 = 7 << 25;
const DMA2_S1NDTR: u32 = 0x4002_642C;
const DMA2_S1PAR: u32 = 0x4002_6430;
const DMA2_S1M0AR: u32 = 0x4002_6434;
const DMA2_S1FCR: u32 = 0x4002_643C;

const TIM8_CR1: u32 = 0x4001_0400;
const CEN: u32 = 1 << 0;
const TIM8_DIER: u32 = 0x4001_040C;
const UDE: u32 = 1 << 8;
const TIM8_CNT: u32 = 0x4001_0424;
const TIM8_PSC: u32 = 0x4001_0428;
const TIM8_ARR: u32 = 0x4001_042C;

/// Four PWM periods, ticks of 168 MHz: 167 µs.
const LIMIT: u32 = 4 * 2 * bridge::PERIOD as u32;

/// Starts it, and sees it work once: BDTR gets a dead time of one tick more, and must soon be what it was. At `off_address`
/// in the chip's memory, and not in its CCM, lies [`bridge::OFF`] for good.
///
/// # Errors
/// Where BDTR stays as it is.
pub fn start(registers: &mut impl Registers, off_address: u32) -> Result<(), SetUpError> {
    registers.set(RCC_AHB1ENR, DMA2EN);
    registers.read(RCC_AHB1ENR);
    registers.write(DMA2_S1CR, 0);
    // Without FIFO: fetched from memory when it is turned on, and after each time.
    registers.write(DMA2_S1FCR, 0);
    registers.write(DMA2_S1NDTR, 1);
    registers.write(DMA2_S1PAR, bridge::BDTR);
    registers.write(DMA2_S1M0AR, off_address);
    let settings = CHSEL_7 | PL_VERY_HIGH | MSIZE_32 | PSIZE_32 | CIRC | MEMORY_TO_PERIPHERAL;
    registers.write(DMA2_S1CR, settings);
    registers.write(DMA2_S1CR, settings | EN);
    registers.write(TIM8_PSC, 0);
    registers.write(TIM8_ARR, LIMIT - 1);
    registers.write(TIM8_CNT, 0);
    registers.write(TIM8_DIER, UDE);
    registers.write(TIM8_CR1, CEN);
    registers.write(bridge::BDTR, bridge::OFF + 1);
    if registers.becomes(bridge::BDTR, u32::MAX, bridge::OFF, 100) {
        Ok(())
    } else {
        bridge::off(registers);
        Err(SetUpError::DeadMan)
    }
}

/// A current tick has come.
#[inline]
pub fn check_in(registers: &mut impl Registers) {
    registers.write(TIM8_CNT, 0);
}

//! TIM3 counts both edges of the encoder's A (PB4) and B (PB5), 16 bits. RM0090, 18.3.12.

use super::Registers;

const TIM3_CR1: u32 = 0x4000_0400;
const TIM3_SMCR: u32 = 0x4000_0408;
const TIM3_CCMR1: u32 = 0x4000_0418;
const TIM3_CCER: u32 = 0x4000_0420;
const TIM3_CNT: u32 = 0x4000_0424;
const TIM3_ARR: u32 = 0x4000_042C;
const CEN: u32 = 1;
/// Encoder mode 3: edges of A and of B.
const SMS_BOTH: u32 = 3;
const CC1S_TI1: u32 = 1;
const CC2S_TI2: u32 = 1 << 8;
/// Six equal samples at half of 84 MHz: shorter than 143 ns is no edge.
const IC1F_4: u32 = 4 << 4;
const IC2F_4: u32 = 4 << 12;

/// Width of the counter, bits.
pub const BITS: u32 = 16;

/// Starts counting from 0.
pub fn set_up(registers: &mut impl Registers) {
    registers.write(TIM3_SMCR, SMS_BOTH);
    registers.write(TIM3_CCMR1, CC1S_TI1 | CC2S_TI2 | IC1F_4 | IC2F_4);
    registers.write(TIM3_CCER, 0);
    registers.write(TIM3_ARR, 0xFFFF);
    registers.write(TIM3_CNT, 0);
    registers.write(TIM3_CR1, CEN);
}

/// The counter.
#[inline]
pub fn counter(registers: &mut impl Registers) -> u32 {
    registers.read(TIM3_CNT) & 0xFFFF
}

//! The three ADCs, each with one injected conversion at every rising TRGO of TIM1: ADC2 the current of phase B
//! (PC0, IN10), ADC3 that of C (PC1, IN11), at once; ADC1 the bus voltage (PA6, IN6). Sampled for 3 cycles of
//! 21 MHz (0.14 µs) from the middle of the low sides' conduction on; the codes are there 0.71 µs after it. Then ADC1
//! interrupts: the current tick. RM0090, 13.
//!
//! There is no shunt in phase A: its current is what B and C leave. A current out of the bridge into the motor raises
//! the codes.
//!
//! Between its injected conversions ADC1 converts the FETs' temperature, on request; a trigger breaks that off,
//! and it begins again by itself.

use super::Registers;

const ADC1: u32 = 0x4001_2000;
const ADC2: u32 = 0x4001_2100;
const ADC3: u32 = 0x4001_2200;
const SR: u32 = 0x00;
const EOC: u32 = 1 << 1;
const JEOC: u32 = 1 << 2;
const CR1: u32 = 0x04;
const JEOCIE: u32 = 1 << 7;
const CR2: u32 = 0x08;
const ADON: u32 = 1 << 0;
const JEXTSEL: u32 = 0xF << 16;
const JEXTSEL_TIM1_TRGO: u32 = 1 << 16;
const JEXTEN: u32 = 3 << 20;
const JEXTEN_RISING: u32 = 1 << 20;
const SWSTART: u32 = 1 << 30;
/// Sampling times of channels 10 to 18, and of 0 to 9.
const SMPR1: u32 = 0x0C;
const SMPR2: u32 = 0x10;
/// 84 cycles for channel 15: 2.5 kΩ feed it.
const SMP15_84: u32 = 4 << 15;
const SQR1: u32 = 0x2C;
const SQR3: u32 = 0x34;
const JSQR: u32 = 0x38;
const JDR1: u32 = 0x3C;
const DR: u32 = 0x4C;
const ADC_CCR: u32 = 0x4001_2304;
/// 84 MHz / 4: / 2 would be above the 36 MHz that are allowed.
const ADCPRE_4: u32 = 1 << 16;

const BUS: u32 = 6;
const CURRENT_B: u32 = 10;
const CURRENT_C: u32 = 11;
const FET_TEMPERATURE: u32 = 15;

/// A sequence of one takes its channel from JSQ4, the last.
const fn only(channel: u32) -> u32 {
    channel << 15
}

/// Turns the converters on; nothing triggers them yet.
pub fn set_up(registers: &mut impl Registers) {
    registers.write(ADC_CCR, ADCPRE_4);
    for (adc, channel, interrupt) in [
        (ADC1, BUS, JEOCIE),
        (ADC2, CURRENT_B, 0),
        (ADC3, CURRENT_C, 0),
    ] {
        registers.write(adc + CR1, interrupt);
        registers.write(adc + CR2, 0);
        // 3 cycles.
        registers.write(adc + SMPR1, 0);
        registers.write(adc + SMPR2, 0);
        registers.write(adc + JSQR, only(channel));
        registers.write(adc + CR2, ADON);
    }
    registers.write(ADC1 + SMPR1, SMP15_84);
    registers.write(ADC1 + SQR1, 0);
    registers.write(ADC1 + SQR3, FET_TEMPERATURE);
    // A converter wants 3 µs before it is used.
    registers.wait_us(10);
}

/// From the next middle of the low sides' conduction on there are current ticks.
pub fn start(registers: &mut impl Registers) {
    for adc in [ADC1, ADC2, ADC3] {
        registers.write(adc + SR, 0);
    }
    for adc in [ADC3, ADC2, ADC1] {
        registers.change(
            adc + CR2,
            JEXTSEL | JEXTEN,
            JEXTSEL_TIM1_TRGO | JEXTEN_RISING,
        );
    }
}

/// The current tick's interrupt has been seen.
#[inline]
pub fn acknowledge(registers: &mut impl Registers) {
    registers.write(ADC1 + SR, !JEOC);
}

/// Codes of the currents of phases B and C.
#[inline]
pub fn current_codes(registers: &mut impl Registers) -> [u16; 2] {
    [
        registers.read(ADC2 + JDR1) as u16,
        registers.read(ADC3 + JDR1) as u16,
    ]
}

/// Code of the bus voltage.
#[inline]
pub fn bus_code(registers: &mut impl Registers) -> u16 {
    registers.read(ADC1 + JDR1) as u16
}

/// Converts the FETs' temperature; None if the converter does not answer. Below every tick.
pub fn fet_temperature_code(registers: &mut impl Registers) -> Option<u16> {
    registers.write(ADC1 + SR, !EOC);
    registers.set(ADC1 + CR2, SWSTART);
    // 4.6 µs, or as long again after a trigger.
    registers
        .becomes(ADC1 + SR, EOC, EOC, 100)
        .then(|| registers.read(ADC1 + DR) as u16)
}

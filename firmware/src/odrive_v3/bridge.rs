//! TIM1 drives the bridge: centre-aligned PWM at 24 kHz, three phases, both sides, with dead time. RM0090, 17.
//!
//! The counter runs 0, 1 … 3500 … 1, 0 at 168 MHz: 7000 ticks, one PWM period. All channels are in **PWM mode 1**, high
//! active: a high side is on while the counter is below its CCR, so around the count's **low** end, for the part
//! CCR/3500 of the period. The **low sides conduct around the high end**, 3500, and the shunts lie below them.
//!
//! There, at the overflow, three things happen at once: the duties written during the last period come into force,
//! MOE rises if the bridge is being armed, and the ADCs are triggered (TRGO is the update event). It is the middle of the
//! low sides' conduction, as far from every edge as can be; at a duty of 0.85, 3.1 µs after the last edge, where the current
//! amplifiers want 2.4 µs.
//!
//! **Delay**: what is sampled at one overflow decides the duties of the period that begins at the next one, 41.7 µs
//! later. The voltage acts from there on for 41.7 µs, in the mean 62.5 µs after the sample.
//!
//! One update per period needs a repetition counter of 1. Whether an odd one updates at the top or at the bottom of
//! the count depends on when it was loaded: written before the start, without UG, it is at the top. [`start`] looks, and
//! refuses where it is not so. UG is never used: it would load the repetition counter early, and trigger the ADCs.
//!
//! The gate drivers have no way to break TIM1 off (its break input lies on pins that the board uses otherwise). BKE is
//! on all the same: the clock security system breaks it off when the crystal stops.

use super::{Registers, SetUpError};

const TIM1_CR1: u32 = 0x4001_0000;
const CEN: u32 = 1 << 0;
const DIR: u32 = 1 << 4;
const CMS_CENTRE_1: u32 = 1 << 5;
const TIM1_CR2: u32 = 0x4001_0004;
/// TRGO is the update event. The idle levels OIS1 to OIS3N, above it, are all low.
const MMS_UPDATE: u32 = 2 << 4;
const TIM1_SR: u32 = 0x4001_0010;
const UIF: u32 = 1 << 0;
const TIM1_CCMR1: u32 = 0x4001_0018;
const TIM1_CCMR2: u32 = 0x4001_001C;
/// PWM mode 1 with preload, for the first or the second channel of a CCMR.
const FIRST_PWM_1: u32 = 6 << 4 | 1 << 3;
const SECOND_PWM_1: u32 = FIRST_PWM_1 << 8;
const TIM1_CCER: u32 = 0x4001_0020;
/// CC1E CC1NE CC2E CC2NE CC3E CC3NE, all high active.
const ALL_SIX: u32 = 0b0101_0101_0101;
const TIM1_PSC: u32 = 0x4001_0028;
const TIM1_ARR: u32 = 0x4001_002C;
const TIM1_RCR: u32 = 0x4001_0030;
const TIM1_CCR1: u32 = 0x4001_0034;
const TIM1_CCR2: u32 = 0x4001_0038;
const TIM1_CCR3: u32 = 0x4001_003C;
/// TIM1_BDTR.
pub(super) const BDTR: u32 = 0x4001_0044;
const OSSI: u32 = 1 << 10;
const OSSR: u32 = 1 << 11;
const BKE: u32 = 1 << 12;
/// Break input high active: what is not connected reads low.
const BKP: u32 = 1 << 13;
const AOE: u32 = 1 << 14;

/// Ticks of 168 MHz: 119 ns, to which the gate driver adds about 104 ns.
const DEAD_TIME: u32 = 20;

/// What BDTR holds while the bridge is off: MOE and AOE clear, all six outputs held low.
pub const OFF: u32 = DEAD_TIME | OSSI | OSSR | BKE | BKP;
const ARMED: u32 = OFF | AOE;

/// Steps of a duty from 0 to 1; half a PWM period, ticks of 168 MHz.
pub const PERIOD: u16 = 3500;

/// All six switches off: one write, of a constant, that may come at any time and from any interrupt. This is all
/// that nFAULT's interrupt, a panic and a hard fault do before anything else.
#[inline]
pub fn off(registers: &mut impl Registers) {
    registers.write(BDTR, OFF);
}

/// Everything but the start: from here on TIM1 holds its outputs low.
pub fn set_up(registers: &mut impl Registers) {
    off(registers);
    registers.write(TIM1_CR1, CMS_CENTRE_1);
    registers.write(TIM1_CR2, MMS_UPDATE);
    registers.write(TIM1_PSC, 0);
    registers.write(TIM1_ARR, u32::from(PERIOD));
    registers.write(TIM1_RCR, 1);
    registers.write(TIM1_CCMR1, FIRST_PWM_1 | SECOND_PWM_1);
    registers.write(TIM1_CCMR2, FIRST_PWM_1);
    for ccr in [TIM1_CCR1, TIM1_CCR2, TIM1_CCR3] {
        registers.write(ccr, 0);
    }
    registers.write(TIM1_CCER, ALL_SIX);
}

/// Starts the count, the outputs still off, and watches where the updates come.
///
/// # Errors
/// If three updates do not all come at the top of the count.
pub fn start(registers: &mut impl Registers) -> Result<(), SetUpError> {
    registers.set(TIM1_CR1, CEN);
    for _ in 0..3 {
        forget_update(registers);
        // Looks are 10 µs apart, and the count falls for 20.8 µs from the top on.
        let updated = registers.becomes(TIM1_SR, UIF, UIF, 100);
        if !updated || registers.read(TIM1_CR1) & DIR == 0 {
            return Err(SetUpError::PwmUpdate);
        }
    }
    Ok(())
}

/// The duties of the next period, in steps of [`PERIOD`].
#[inline]
pub fn set_duties(registers: &mut impl Registers, steps: [u16; 3]) {
    let [a, b, c] = steps;
    registers.write(TIM1_CCR1, u32::from(a));
    registers.write(TIM1_CCR2, u32::from(b));
    registers.write(TIM1_CCR3, u32::from(c));
}

/// MOE rises at the next update, together with the duties that were set before.
#[inline]
pub fn arm(registers: &mut impl Registers) {
    registers.write(BDTR, ARMED);
}

/// Forgets updates that came before.
#[inline]
pub fn forget_update(registers: &mut impl Registers) {
    registers.write(TIM1_SR, !UIF);
}

/// True if a period has begun since [`forget_update`].
#[inline]
pub fn has_updated(registers: &mut impl Registers) -> bool {
    registers.read(TIM1_SR) & UIF != 0
}

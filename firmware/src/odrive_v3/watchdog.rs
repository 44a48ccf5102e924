//! IWDG, and what stands still while a debugger holds the core. RM0090, 21 and 38.16.
//!
//! Its oscillator runs at 17 to 47 kHz. Fed last just before a sector of settings is erased, it must outlast the
//! 2 s that this may take: 32 · 4096 periods of the oscillator are 2.79 s at 47 kHz, 4.1 s at 32 kHz, 7.7 s at 17 kHz.
//! A program that hangs is reset after this time; what must act sooner does not wait for it.

use super::Registers;

const IWDG_KR: u32 = 0x4000_3000;
const IWDG_PR: u32 = 0x4000_3004;
const IWDG_RLR: u32 = 0x4000_3008;
const IWDG_SR: u32 = 0x4000_300C;
const KEY_START: u32 = 0xCCCC;
const KEY_ACCESS: u32 = 0x5555;
const KEY_RELOAD: u32 = 0xAAAA;
/// The oscillator divided by 32.
const PR_32: u32 = 3;
const RL_4096: u32 = 4095;
const PVU_RVU: u32 = 3;

const DBGMCU_CR: u32 = 0xE004_2004;
const DBG_SLEEP: u32 = 1 << 0;
const DBGMCU_APB1_FZ: u32 = 0xE004_2008;
const DBG_IWDG_STOP: u32 = 1 << 12;
const DBGMCU_APB2_FZ: u32 = 0xE004_200C;
const DBG_TIM1_STOP: u32 = 1 << 0;

/// Starts the watchdog; it cannot be stopped. The oscillator starts with it, and takes over the period within
/// 48 ms; nothing waits for that longer.
pub fn start(registers: &mut impl Registers) {
    registers.write(IWDG_KR, KEY_START);
    registers.write(IWDG_KR, KEY_ACCESS);
    registers.write(IWDG_PR, PR_32);
    registers.write(IWDG_RLR, RL_4096);
    registers.becomes(IWDG_SR, PVU_RVU, 0, 5000);
    feed(registers);
}

/// Begins its period anew.
pub fn feed(registers: &mut impl Registers) {
    registers.write(IWDG_KR, KEY_RELOAD);
}

/// A debugger that holds the core holds TIM1, which takes its outputs off, and the watchdog. It can read the log while the core
/// sleeps.
pub fn freeze_in_debug(registers: &mut impl Registers) {
    registers.set(DBGMCU_CR, DBG_SLEEP);
    registers.set(DBGMCU_APB1_FZ, DBG_IWDG_STOP);
    registers.set(DBGMCU_APB2_FZ, DBG_TIM1_STOP);
}

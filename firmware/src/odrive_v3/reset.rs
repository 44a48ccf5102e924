//! Why the chip was reset. RM0090, 7.3.21.

use protocol::ResetReason;

use super::Registers;

const RCC_CSR: u32 = 0x4002_3874;
const RMVF: u32 = 1 << 24;
const BORRSTF: u32 = 1 << 25;
const PORRSTF: u32 = 1 << 27;
const SFTRSTF: u32 = 1 << 28;
const IWDGRSTF: u32 = 1 << 29;
const WWDGRSTF: u32 = 1 << 30;
const LPWRRSTF: u32 = 1 << 31;

/// Reads the flags and clears them, so that the next reset is told from this one. Unknown are the window watchdog
/// and a low-power reset: nothing here uses them. Brown-out is told only where the option bytes turn it on.
pub fn take_reason(registers: &mut impl Registers) -> ResetReason {
    let flags = registers.read(RCC_CSR);
    registers.set(RCC_CSR, RMVF);
    // The pin's flag comes with every other; the brown-out flag comes with power-on too.
    if flags & IWDGRSTF != 0 {
        ResetReason::Watchdog
    } else if flags & SFTRSTF != 0 {
        ResetReason::Software
    } else if flags & (LPWRRSTF | WWDGRSTF) != 0 {
        ResetReason::Unknown
    } else if flags & PORRSTF != 0 {
        ResetReason::PowerOn
    } else if flags & BORRSTF != 0 {
        ResetReason::BrownOut
    } else {
        ResetReason::Pin
    }
}

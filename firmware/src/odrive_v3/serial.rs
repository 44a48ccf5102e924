//! UART4 on GPIO1 (PA0, TX) and GPIO2 (PA1, RX): 115,200 baud, 8 bits, no parity. The pins may carry a filter of
//! 3.3 kΩ and 82 pF; faster is unverified. RM0090, 30.

use super::Registers;

const UART4_SR: u32 = 0x4000_4C00;
const ORE: u32 = 1 << 3;
const RXNE: u32 = 1 << 5;
const TXE: u32 = 1 << 7;
const UART4_DR: u32 = 0x4000_4C04;
const UART4_BRR: u32 = 0x4000_4C08;
const UART4_CR1: u32 = 0x4000_4C0C;
const RE: u32 = 1 << 2;
const TE: u32 = 1 << 3;
const RXNEIE: u32 = 1 << 5;
const UE: u32 = 1 << 13;
const UART4_CR2: u32 = 0x4000_4C10;
const UART4_CR3: u32 = 0x4000_4C14;

const BAUD: u32 = 115_200;
const APB1_HZ: u32 = 42_000_000;
/// 365 of 42 MHz: 115,068 baud, 0.11 % slow.
const BRR: u32 = (APB1_HZ + BAUD / 2) / BAUD;

/// A byte takes 87 µs.
const LOOKS: u32 = 100;

/// Sends and receives; an interrupt for each byte received.
pub fn set_up(registers: &mut impl Registers) {
    registers.write(UART4_CR2, 0);
    registers.write(UART4_CR3, 0);
    registers.write(UART4_BRR, BRR);
    registers.write(UART4_CR1, UE | TE | RE | RXNEIE);
}

/// The byte that the interrupt announced. After a byte was lost the interrupt comes too; reading ends it.
pub fn receive(registers: &mut impl Registers) -> Option<u8> {
    let status = registers.read(UART4_SR);
    if status & (RXNE | ORE) == 0 {
        return None;
    }
    let byte = registers.read(UART4_DR) as u8;
    (status & RXNE != 0).then_some(byte)
}

/// Sends, waiting for the line; below every tick.
pub fn send(registers: &mut impl Registers, bytes: &[u8]) {
    for byte in bytes {
        // Bounded: the transmitter waits for nobody.
        registers.becomes(UART4_SR, TXE, TXE, LOOKS);
        registers.write(UART4_DR, u32::from(*byte));
    }
}

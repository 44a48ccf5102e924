//! SPI3 to the gate driver of axis 0, as an [`SpiDevice`] of 16-bit words. Mode 1, 1.31 MHz: the DRV8301 takes up to
//! 10, and 1 to 2.6 are in use on this board. RM0090, 28.

use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};

use super::{Registers, pins};

const SPI3_CR1: u32 = 0x4000_3C00;
const CPHA: u32 = 1 << 0;
const MSTR: u32 = 1 << 2;
/// 42 MHz / 32.
const BR_32: u32 = 4 << 3;
const SPE: u32 = 1 << 6;
const SSI: u32 = 1 << 8;
const SSM: u32 = 1 << 9;
const DFF: u32 = 1 << 11;
const SPI3_CR2: u32 = 0x4000_3C04;
const SPI3_SR: u32 = 0x4000_3C08;
const RXNE: u32 = 1 << 0;
const TXE: u32 = 1 << 1;
const BSY: u32 = 1 << 7;
const SPI3_DR: u32 = 0x4000_3C0C;

/// A word takes 12 µs.
const LOOKS: u32 = 100;

/// Turns SPI3 on.
pub fn set_up(registers: &mut impl Registers) {
    registers.write(SPI3_CR2, 0);
    // CPOL 0: the clock rests low.
    registers.write(SPI3_CR1, CPHA | MSTR | BR_32 | SSI | SSM | DFF);
    registers.set(SPI3_CR1, SPE);
}

/// SPI3 did not take or give a word in time: it is off or has no clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpiStuck;

impl Error for SpiStuck {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// The gate driver of axis 0 on SPI3.
pub struct GateDriverSpi<R> {
    registers: R,
}

impl<R: Registers> GateDriverSpi<R> {
    /// SPI3 was set up.
    pub const fn new(registers: R) -> Self {
        Self { registers }
    }

    fn exchange(&mut self, word: u16) -> Result<u16, SpiStuck> {
        let registers = &mut self.registers;
        if !registers.becomes(SPI3_SR, TXE, TXE, LOOKS) {
            return Err(SpiStuck);
        }
        registers.write(SPI3_DR, u32::from(word));
        if !registers.becomes(SPI3_SR, RXNE, RXNE, LOOKS) {
            return Err(SpiStuck);
        }
        Ok(registers.read(SPI3_DR) as u16)
    }

    fn operate(&mut self, operation: &mut Operation<'_, u16>) -> Result<(), SpiStuck> {
        match operation {
            Operation::Read(words) => {
                for word in words.iter_mut() {
                    *word = self.exchange(0)?;
                }
            }
            Operation::Write(words) => {
                for word in *words {
                    self.exchange(*word)?;
                }
            }
            Operation::Transfer(read, write) => {
                for i in 0..read.len().max(write.len()) {
                    let word = self.exchange(write.get(i).copied().unwrap_or(0))?;
                    if let Some(place) = read.get_mut(i) {
                        *place = word;
                    }
                }
            }
            Operation::TransferInPlace(words) => {
                for word in words.iter_mut() {
                    *word = self.exchange(*word)?;
                }
            }
            Operation::DelayNs(time_ns) => self.registers.wait_us(time_ns.div_ceil(1000)),
        }
        Ok(())
    }
}

impl<R> ErrorType for GateDriverSpi<R> {
    type Error = SpiStuck;
}

impl<R: Registers> SpiDevice<u16> for GateDriverSpi<R> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u16>]) -> Result<(), SpiStuck> {
        pins::set_gate_driver_selected(&mut self.registers, true);
        // nCS wants 50 ns before the first edge of the clock, after the last, and between frames.
        self.registers.wait_us(1);
        let mut done = Ok(());
        for operation in operations {
            done = done.and_then(|()| self.operate(operation));
        }
        let quiet = self.registers.becomes(SPI3_SR, BSY, 0, LOOKS);
        self.registers.wait_us(1);
        pins::set_gate_driver_selected(&mut self.registers, false);
        self.registers.wait_us(1);
        done.and(if quiet { Ok(()) } else { Err(SpiStuck) })
    }
}

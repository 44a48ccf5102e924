//! The board's slow work, as [`Housekeeping`].

use protocol::ResetReason;

use super::gate_driver::{self, GateDriver};
use super::spi::GateDriverSpi;
use super::{Registers, current_sense, pins, supply, watchdog};
use crate::board::Housekeeping;

/// The FETs' temperature, the gate driver and the watchdog.
pub struct Slow<R> {
    registers: R,
    driver: GateDriver<GateDriverSpi<R>>,
    reset: ResetReason,
}

impl<R: Registers + Clone> Slow<R> {
    /// The board was set up. The gate driver is off until [`Housekeeping::restart_gate_driver`].
    pub fn new(registers: R, reset: ResetReason) -> Self {
        Self {
            driver: GateDriver::new(GateDriverSpi::new(registers.clone())),
            registers,
            reset,
        }
    }
}

impl<R: Registers + Clone> Housekeeping for Slow<R> {
    fn temperature_c(&mut self) -> f32 {
        current_sense::fet_temperature_code(&mut self.registers)
            .and_then(supply::fet_temperature_c)
            .unwrap_or(f32::NAN)
    }

    /// What is not a fault of its own is told as [`gate_driver::GateDriverError::words`] says.
    fn gate_driver(&mut self) -> Result<(), [u16; 2]> {
        match self.driver.check() {
            Ok(_) => Ok(()),
            Err(error) => Err(error.words()),
        }
    }

    /// Takes 21 ms. nFAULT is listened to from the end on, and must be high by then.
    fn restart_gate_driver(&mut self) -> Result<(), [u16; 2]> {
        pins::ignore_fault(&mut self.registers);
        gate_driver::restart(&mut self.registers);
        let set = self.driver.configure().map_err(|error| error.words())?;
        pins::listen_to_fault(&mut self.registers);
        if pins::is_fault_signalled(&mut self.registers) {
            return Err([set.one, set.two]);
        }
        Ok(())
    }

    fn feed_watchdog(&mut self) {
        watchdog::feed(&mut self.registers);
    }

    fn reset_reason(&self) -> ResetReason {
        self.reset
    }
}

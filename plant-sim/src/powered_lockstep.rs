//! The firmware of a board with a power stage in an emulator, one PWM period at a time with windings and knob.
//!
//! As [`lockstep`](crate::lockstep), but for the board `emulated_drive` and the [`powered`](crate::powered) knob.

use std::path::Path;

use crate::powered::{Powered, Sensed, Turned};
use crate::qemu::Qemu;
pub use crate::qemu::{LockstepError, SETTINGS_BYTES};

/// The board's PWM period, s.
pub const PWM_PERIOD_S: f64 = 1.0 / 24e3;

/// The step of its current converters, A.
pub const CURRENT_STEP_A: f64 = 3.3 / 4096.0 / 80.0 / 0.5e-3;

/// What the chip is to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Order {
    /// Nothing.
    Hold = 0,
    /// A PWM period: a current tick.
    Period = 1,
    /// One that finds another was due before it.
    LatePeriod = 2,
    /// End the emulator.
    Exit = 3,
    /// Panic.
    Panic = 4,
    /// Read an address where nothing is.
    HardFault = 5,
    /// Say in [`DriveReport::cost`] how much stack was ever used, bytes.
    Stack = 6,
    /// The gate driver's fault line falls, between two periods.
    GateFault = 7,
}

/// What the board senses beside the motor, as the test wants it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surroundings {
    /// Of the switches, °C.
    pub temperature_c: f32,
    /// The gate driver's status words; both 0: all is well.
    pub gate_driver: [u16; 2],
}

impl Default for Surroundings {
    /// A cool board, and all is well.
    fn default() -> Self {
        Self {
            temperature_c: 25.0,
            gate_driver: [0; 2],
        }
    }
}

/// How things stand on the chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveReport {
    /// The duties of A, B, C for the next period; None: all switches are off.
    pub duties: Option<[f32; 3]>,
    /// Serial bytes that it has taken since the start.
    pub taken: u32,
    /// What the last current tick cost: nanoseconds of virtual time; at [`DriveEmulator::start`]'s shift 0, instructions.
    pub cost: u32,
    /// How often it has fed its watchdog since the start.
    pub fed: u32,
}

impl DriveReport {
    fn read([on, a, b, c, taken, cost, fed]: [u32; 7]) -> Self {
        Self {
            duties: (on != 0).then(|| [a, b, c].map(f32::from_bits)),
            taken,
            cost,
            fed,
        }
    }
}

/// A firmware image of the board `emulated_drive` running in QEMU. Ends with it.
pub struct DriveEmulator(Qemu<7>);

impl DriveEmulator {
    /// As [`Emulator::start_with`](crate::lockstep::Emulator::start_with).
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn start(
        image: &Path,
        shift: u32,
        arguments: &[String],
        settings: Option<&Path>,
    ) -> Result<Self, LockstepError> {
        Qemu::start(image, shift, arguments, settings).map(Self)
    }

    /// How things stood at the last exchange.
    #[must_use]
    pub fn report(&self) -> DriveReport {
        DriveReport::read(self.0.report())
    }

    /// One exchange: the order is carried out, with what the board senses.
    ///
    /// # Errors
    /// See [`LockstepError`]; the emulator's end is one, also where it was ordered.
    pub fn exchange(
        &mut self,
        order: Order,
        sensed: &Sensed,
        around: &Surroundings,
    ) -> Result<DriveReport, LockstepError> {
        let pair = |[low, high]: [u16; 2]| u32::from(low) | u32::from(high) << 16;
        let more = [
            pair(sensed.codes),
            (sensed.bus_v as f32).to_bits(),
            around.temperature_c.to_bits(),
            pair(around.gate_driver),
        ];
        // The counter's upper half is not the board's.
        let counter = sensed.counter & 0xFFFF;
        let words = self.0.exchange(order as u32, counter, more)?;
        Ok(DriveReport::read(words))
    }

    /// Hands bytes to the firmware's serial line. They are taken before the next order is
    /// carried out.
    ///
    /// # Errors
    /// [`LockstepError::Broken`].
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), LockstepError> {
        self.0.send(bytes, [0; 4])
    }

    /// Takes what the firmware has sent until now; all of it, as the chip stands still.
    ///
    /// # Errors
    /// [`LockstepError::Broken`].
    pub fn receive(&mut self) -> Result<Vec<u8>, LockstepError> {
        self.0.receive()
    }
}

/// What a period on the bench did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BenchPeriod {
    /// What the chip sensed.
    pub sensed: Sensed,
    /// What it did.
    pub report: DriveReport,
    /// What that did to motor and knob; with [`Inverter::late`](crate::electrical::Inverter::late) in the period after.
    pub turned: Turned,
}

/// Firmware, windings and knob on one bench.
pub struct PoweredBench {
    /// The chip.
    pub emulator: DriveEmulator,
    /// Motor and knob.
    pub knob: Powered,
    /// The rest of the world.
    pub around: Surroundings,
}

impl PoweredBench {
    /// One PWM period: the chip senses and decides, and the knob moves on by it.
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn period(&mut self) -> Result<BenchPeriod, LockstepError> {
        self.period_with(Order::Period)
    }

    /// As [`PoweredBench::period`], with another order.
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn period_with(&mut self, order: Order) -> Result<BenchPeriod, LockstepError> {
        let sensed = self.knob.sensed();
        let report = self.emulator.exchange(order, &sensed, &self.around)?;
        let duties = report.duties.map(|duties| duties.map(f64::from));
        if duties.is_none() {
            // Off is at once, also what was on its way.
            self.knob.cut();
        }
        Ok(BenchPeriod {
            sensed,
            report,
            turned: self.knob.period(duties),
        })
    }
}

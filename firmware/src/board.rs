//! What a board owes the firmware. Each method states its obligation; the rest of the
//! firmware relies on it and checks nothing twice.
//!
//! A board whose torque output is an amplifier of its own gives [`AngleCounter`], [`TorqueOutput`] and
//! [`TickClock`]; one that drives the motor's windings itself gives [`PowerStage`] and [`Housekeeping`] instead. All give
//! [`SerialOutput`].

use protocol::ResetReason;

use crate::power::{Bridge, Sensed, StageFacts};

/// The angle sensor.
pub trait AngleCounter {
    /// Width of the counter, bits: it wraps there.
    const BITS: u32;

    /// The counter as it reads now, in hardware counts; bits above [`Self::BITS`] are
    /// ignored. Never waits. Between two calls the knob moves by less than half the range.
    fn counter(&mut self) -> u32;
}

/// The torque output.
pub trait TorqueOutput {
    /// Has the motor give this torque, Nm, until the next call; 0 is no torque. The value is
    /// finite. Never waits; takes effect within a delay that the board states.
    fn set_nm(&mut self, torque_nm: f32);
}

/// The clock of the tick.
pub trait TickClock {
    /// Ticks every `period_s` from the next one on; called before the first tick and in a tick, with a period within the
    /// limits of [`crate::settings::HIGHEST`] and [`crate::settings::LOWEST`].
    fn set_period_s(&mut self, period_s: f32);

    /// The time from the previous tick to this one, s; called once in a tick, before
    /// [`Self::set_period_s`]. Finite and above 0, in the first tick too. A board without a clock that
    /// measures it returns the period that was in force.
    fn elapsed_s(&mut self) -> f32;

    /// Acknowledges the tick's interrupt, and says whether another was due before this one
    /// was served.
    fn acknowledge(&mut self) -> bool;
}

/// The serial line to the host.
pub trait SerialOutput {
    /// Sends all, waiting for the line; called below the tick, which may interrupt it.
    fn write(&mut self, bytes: &[u8]);
}

/// A bridge with its current and voltage sensing and its encoder: read and driven once in each PWM
/// period, by the interrupt of the highest priority but one.
pub trait PowerStage {
    /// Width of the encoder's counter, bits.
    const COUNTER_BITS: u32;

    /// What it is made of. The same at every call.
    fn facts(&self) -> StageFacts;

    /// Acknowledges the period's interrupt, and says whether another was due before this one
    /// was served.
    fn acknowledge(&mut self) -> bool;

    /// What was sampled in the middle of the low sides' conduction at this period's start, and the
    /// encoder now. Never waits.
    fn sensed(&mut self) -> Sensed;

    /// [`Bridge::On`] is in force for the whole of the next period; [`Bridge::Off`] at once. Never waits.
    fn apply(&mut self, bridge: Bridge);

    /// True if the gate driver's fault line fell since the last call. The outputs are off by then: its
    /// interrupt, of the highest priority, has put them off, and [`Bridge::On`] does nothing until this was
    /// called.
    fn gate_fault(&mut self) -> bool;
}

/// What a board with a power stage does slowly, 10 to 100 times a second, below the tick.
pub trait Housekeeping {
    /// The temperature of the switches, °C; not finite if the sensor does not answer.
    fn temperature_c(&mut self) -> f32;

    /// Reads the gate driver back.
    ///
    /// # Errors
    /// Its two status words, if it reports a fault, does not answer, or does not hold what it was
    /// set up with.
    fn gate_driver(&mut self) -> Result<(), [u16; 2]>;

    /// Sets the gate driver up anew. Called only while the bridge is off; may take 50 ms.
    ///
    /// # Errors
    /// As [`Self::gate_driver`].
    fn restart_gate_driver(&mut self) -> Result<(), [u16; 2]>;

    /// Feeds the watchdog. Called only when tick, serial line and slow work have all checked in.
    fn feed_watchdog(&mut self);

    /// Why the chip started. The same at every call.
    fn reset_reason(&self) -> ResetReason;
}

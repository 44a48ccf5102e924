//! What a board owes the firmware. Each method states its obligation; the rest of the
//! firmware relies on it and checks nothing twice.

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

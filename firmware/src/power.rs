//! What a power stage and the firmware hand each other in every PWM period.
//!
//! At the start of a period the stage is read ([`Sensed`]); what is decided ([`Bridge`]) is in force for the
//! whole of the next.

use control::torque::modulation::Duties;

/// What is read at the start of a PWM period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensed {
    /// Codes of the current converters of phases B and C; a current out of the bridge raises them.
    pub currents: [u16; 2],
    /// The bus voltage, V.
    pub bus_v: f32,
    /// The encoder's counter; bits above the counter's width are ignored.
    pub counter: u32,
}

/// What the bridge is to do in the next period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bridge {
    /// All six switches off.
    Off,
    /// Switching.
    On(Duties),
}

/// What a power stage is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageFacts {
    /// The PWM period, s; the current tick comes once in it.
    pub pwm_period_s: f64,
    /// Steps of a duty from 0 to 1.
    pub pwm_steps: u16,
    /// How long both switches of a phase are off at a change, the gate driver's share included, s.
    pub dead_time_s: f64,
    /// From this current on, either way, a phase loses the whole dead time, A.
    pub dead_time_edge_a: f64,
    /// The largest duty that leaves the low side on for long enough to measure its current.
    pub duty_max: f64,
    /// One code of the current converters, A.
    pub current_step_a: f64,
    /// The code of no current where amplifier and converter are ideal.
    pub current_zero_code: f64,
    /// By how much the true code of no current may differ from that on a good board, codes.
    pub current_zero_spread: f64,
    /// Up to this current, either way, the amplifiers are linear, A.
    pub current_linear_a: f64,
    /// Below this bus voltage nothing is driven, V.
    pub bus_least_v: f64,
    /// Above this one neither, V.
    pub bus_most_v: f64,
}

/// The ODrive v3.5 or v3.6 for 24 V, and clones that do not say what they are for. Figures of the maker's
/// firmware and of data sheets, not measured by this project.
pub const ODRIVE_V3_24V: StageFacts = StageFacts {
    // 168 MHz, centre-aligned, up and down 3500 steps.
    pwm_period_s: 1.0 / 24e3,
    pwm_steps: 3500,
    // 20 ticks of the timer and about 104 ns of the DRV8301.
    dead_time_s: 223e-9,
    dead_time_edge_a: 0.2,
    duty_max: 0.85,
    // 3.3 V in 4096 codes, a gain of 80, 0.5 mΩ.
    current_step_a: 3.3 / 4096.0 / 80.0 / 0.5e-3,
    current_zero_code: 2048.0,
    // 4 mV at the amplifier's input.
    current_zero_spread: 4e-3 * 80.0 / 3.3 * 4096.0,
    // 0.3 V to 3.0 V at the converter.
    current_linear_a: 33.75,
    bus_least_v: 8.0,
    bus_most_v: 25.68,
};

use serde::{Deserialize, Serialize};

/// A power stage, as whoever measures a motor with it must know it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PowerStage {
    /// The PWM period, s.
    pub pwm_period_s: f32,
    /// One code of the current converters, A.
    pub current_step_a: f32,
    /// The code of no current where amplifier and converter are ideal.
    pub current_zero_code: f32,
    /// By how much the true code of no current may differ from that on a good board, codes.
    pub current_zero_spread: f32,
    /// Up to this current, either way, the amplifiers are linear, A.
    pub current_linear_a: f32,
    /// The longest voltage vector, in units of the bus voltage.
    pub reach: f32,
    /// What a phase loses of its duty by dead time.
    pub dead_duty: f32,
    /// From this current on, either way, a phase loses the whole of it, A.
    pub dead_edge_a: f32,
    /// Below this bus voltage nothing is driven, V.
    pub bus_least_v: f32,
    /// Above this one neither, V.
    pub bus_most_v: f32,
}

/// A voltage on the windings while currents and counts are summed up. All lengths of time are in
/// PWM periods.
///
/// The voltage is a vector of the three phases, α along phase A:
/// (steady + ripple along · s) e^(jθ) + j ripple across · s e^(jθ), s = +1, +1, −1, −1 in the
/// four quarters of the ripple's period. In order:
///
/// 1. `rise`: from 0, the steady voltage grows evenly;
/// 2. `settle`: the ripple begins, and θ begins to turn, evenly faster;
/// 3. `windows` times `window`: θ turns by `turn` in each period, in the second half of the windows
///    the other way if `back`; all is summed up;
/// 4. `rise` again: without ripple, the voltage falls to 0 while θ turns on; then the bridge is off.
///
/// What is decided on what is measured at the start of a period is in force in the next.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Excitation {
    /// θ at first, 2⁻³² turns, electrical.
    pub angle: u32,
    /// By how much θ turns in a period, 2⁻³² turns.
    pub turn: i32,
    /// Whether it turns back in the second half of the windows.
    pub back: bool,
    /// The steady voltage, V.
    pub steady_v: f32,
    /// The current that it is thought to drive, along it and a quarter of a turn ahead, by which dead time is made
    /// up for, A; 0 and 0: it is not.
    pub steady_a: [f32; 2],
    /// The ripple along the steady voltage, V.
    pub along_v: f32,
    /// The ripple a quarter of a turn ahead of it, V.
    pub across_v: f32,
    /// A quarter of the ripple's period; 0: there is no ripple.
    pub quarter: u16,
    /// For how long the steady voltage rises, and falls in the end.
    pub rise: u16,
    /// For how long all settles.
    pub settle: u16,
    /// For how long it is summed up.
    pub window: u16,
    /// How often.
    pub windows: u16,
    /// Codes of B and C without current.
    pub zero_codes: [f32; 2],
    /// A larger current in any phase ends it at once, A.
    pub current_max_a: f32,
    /// So does a count that moves further in the time of a window.
    pub way_max: u32,
}

/// Sums over one window. A fourth for each quarter of the ripple's period, or where there is no ripple of the
/// turn that θ is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sums {
    /// Which window, from 0.
    pub window: u16,
    /// How many periods fell into each quarter.
    pub periods: [u16; 4],
    /// Their codes of phase B.
    pub b_codes: [u32; 4],
    /// Their codes of phase C.
    pub c_codes: [u32; 4],
    /// The counts of all periods.
    pub counts: i64,
    /// The count in the last period.
    pub count: i32,
    /// θ in the last period, 2⁻³² turns.
    pub angle: u32,
    /// The bus voltages, mV.
    pub bus_mv: u32,
}

/// How an excitation ended; the bridge is off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExcitationEnd {
    /// All windows were measured.
    Done,
    /// A current was too large.
    Current,
    /// The bus voltage was too low or too high.
    Bus,
    /// The count moved too far.
    Speed,
    /// It was told to end.
    BrokenOff,
    /// A fault ended it.
    Fault,
}

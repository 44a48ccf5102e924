//! What excitation no device takes.

use control::torque::TorqueError;
use protocol::Excitation;

use super::{FASTEST, LONGEST_S};
use crate::power::StageFacts;

/// Which value of an excitation is not accepted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExcitationError {
    /// Of the power stage: no excitation would do.
    Stage(TorqueError),
    /// A voltage is not a number, or beyond the bus.
    Volts(f32),
    /// A current limit is not from 0 to the largest that can be measured.
    Current(f32),
    /// A code of no current is not within the good board's spread.
    ZeroCode(f32),
    /// Rise, settle, window and windows have to be 1 or more.
    NoTime,
    /// It would take longer than [`LONGEST_S`], s.
    TooLong(f64),
    /// It would turn faster than [`FASTEST`].
    TooFast(i32),
}

/// False for what is not a number.
fn at_most(value: f64, most: f64) -> bool {
    value <= most
}

pub(super) fn check(asked: &Excitation, facts: &StageFacts) -> Result<(), ExcitationError> {
    let volts = [asked.steady_v, asked.along_v, asked.across_v];
    for value in volts {
        if !at_most(f64::from(value.abs()), facts.bus_most_v) {
            return Err(ExcitationError::Volts(value));
        }
    }
    let most = facts.current_linear_a;
    for current in asked.steady_a {
        if !at_most(f64::from(current.abs()), most) {
            return Err(ExcitationError::Current(current));
        }
    }
    if !(asked.current_max_a > 0.0 && f64::from(asked.current_max_a) <= most) {
        return Err(ExcitationError::Current(asked.current_max_a));
    }
    for code in asked.zero_codes {
        let off = (f64::from(code) - facts.current_zero_code).abs();
        if !at_most(off, facts.current_zero_spread) {
            return Err(ExcitationError::ZeroCode(code));
        }
    }
    if [asked.rise, asked.settle, asked.window, asked.windows].contains(&0) {
        return Err(ExcitationError::NoTime);
    }
    let periods = 2.0 * f64::from(asked.rise)
        + f64::from(asked.settle)
        + f64::from(asked.window) * f64::from(asked.windows);
    let time_s = periods * facts.pwm_period_s;
    if time_s > LONGEST_S {
        return Err(ExcitationError::TooLong(time_s));
    }
    if asked.turn.unsigned_abs() > FASTEST {
        return Err(ExcitationError::TooFast(asked.turn));
    }
    Ok(())
}

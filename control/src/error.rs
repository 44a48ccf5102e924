use crate::config::Interval;
use crate::real::Real;

/// A configuration that no tick may run with: which value, and what would do.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A quantity that must be finite and above zero is not.
    #[error("{name} is {value}; accepted: a finite number above 0")]
    NotPositive {
        /// Which quantity, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// A quantity that must be finite and not below zero is not.
    #[error("{name} is {value}; accepted: a finite number, 0 or more")]
    Negative {
        /// Which quantity, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// An interval that is not finite, negative, or reversed.
    #[error("{name} is [{low}, {high}]; accepted: finite, 0 or more, the lower end first")]
    Interval {
        /// Which quantity, with its unit.
        name: &'static str,
        /// The lower end given.
        low: f64,
        /// The upper end given.
        high: f64,
    },
    /// An angle lies further from zero than counts can say.
    #[error("{name} is {value} rad, more than 2^30 counts from zero; accepted: up to {limit} rad")]
    OutOfCounts {
        /// Which angle.
        name: &'static str,
        /// What was given, rad.
        value: f64,
        /// The largest magnitude accepted, rad.
        limit: f64,
    },
    /// A detent's period that counts cannot say.
    #[error("detent period is {value} rad; accepted: {least} to {most} rad, two counts to 2^30")]
    Period {
        /// What was given, rad.
        value: f64,
        /// Two counts, rad.
        least: f64,
        /// 2³⁰ counts, rad.
        most: f64,
    },
    /// A delay that the energy ledger cannot look across.
    #[error(
        "delay is {delay} s; accepted by this law: up to {limit} s, the shortest interval between ticks"
    )]
    Delay {
        /// What was given, s.
        delay: f64,
        /// The most, s.
        limit: f64,
    },
    /// An encoder counter of a width that does not exist.
    #[error("an encoder counter of {0} bits; accepted: 2 to 32")]
    CounterBits(u32),
    /// Decimation by zero, or by too much.
    #[error("encoder decimation is {0}; accepted: a whole number from 1 to 2147483647")]
    Decimation(u32),
}

/// `value`, if it is finite and above zero.
pub(crate) fn positive<T: Real>(name: &'static str, value: T) -> Result<T, ConfigError> {
    let seen: f64 = value.into();
    if seen.is_finite() && seen > 0.0 {
        Ok(value)
    } else {
        Err(ConfigError::NotPositive { name, value: seen })
    }
}

/// `value`, if it is finite and not below zero.
pub(crate) fn not_negative<T: Real>(name: &'static str, value: T) -> Result<T, ConfigError> {
    let seen: f64 = value.into();
    if seen.is_finite() && seen >= 0.0 {
        Ok(value)
    } else {
        Err(ConfigError::Negative { name, value: seen })
    }
}

/// `value`, if it is finite, not negative and not reversed.
pub(crate) fn interval(name: &'static str, value: &Interval) -> Result<Interval, ConfigError> {
    let Interval { low, high } = *value;
    if 0.0 <= low && low <= high && high < f64::INFINITY {
        Ok(*value)
    } else {
        Err(ConfigError::Interval { name, low, high })
    }
}

use crate::error::ConfigError;

/// A motor, an inverter or a loop that no drive may run with: which value, and what would do.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TorqueError {
    /// A quantity has the wrong sign or is not one.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A quantity that may have either sign is not finite.
    #[error("{name} is {value}; accepted: a finite number")]
    NotFinite {
        /// Which quantity, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// A quantity is too large.
    #[error("{name} is {value}; accepted: up to {limit}")]
    Above {
        /// Which quantity, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
        /// The largest accepted.
        limit: f64,
    },
    /// A motor without poles, or with too many.
    #[error("{0} pole pairs; accepted: 1 to 1024")]
    PolePairs(u32),
    /// An encoder that is none, or too fine.
    #[error("{0} counts in a turn; accepted: 2 to 1048576")]
    CountsPerRev(u32),
}

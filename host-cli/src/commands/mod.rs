//! One module per subcommand: its flags, and what it does.

pub mod ablation;
pub mod campaign;
pub mod chart;
pub mod demo;
pub mod emulate;
pub mod failures;
pub mod figures;
pub mod flash;
pub mod get;
pub mod identify;
pub mod info;
pub mod log;
pub mod map;
pub mod monitor;
pub mod orders;
pub mod plan;
pub mod ports;
pub mod set;
pub mod simulate;
pub mod stiffness;

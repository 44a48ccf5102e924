//! One module per subcommand: its flags, and what it does.

pub mod figures;
pub mod map;
pub mod plan;
pub mod simulate;

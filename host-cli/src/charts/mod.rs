//! Pictures, as SVG.

pub mod demo;
pub mod failure;
pub mod figures;
pub mod laws;
mod loglog;
pub mod map;
pub mod plan;
pub mod plane;
pub mod run;
pub mod rungs;
pub mod speed;
pub mod stiffness;
mod style;

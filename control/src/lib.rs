//! What a haptic tick decides, and nothing else.
//!
//! A knob is read every sample period through an encoder, a torque is computed, and
//! held until the next sample. This crate holds that computation, one module an idea:
//!
//! - [`encoder`]: the counts as the controller sees them; [`shape`]: spring, wall and detent;
//! - [`criterion`]: the passivity criterion, in every form of the paper; [`margin`]: with what a
//!   real loop adds;
//! - [`motion`]: where the knob can be and how fast, by set membership;
//! - [`ledger`]: the energy ledger; [`tuning`]: its constants and parts;
//! - [`config`] and [`plan`]: what a controller is told, and what it makes of that;
//! - [`tick`]: the tick that joins them, under the laws raw, static, episode, ledger and auto;
//! - [`push`]: a torque without a spring, from which a knob is identified;
//! - [`torque`]: from a torque to the duties of an inverter, and what that leaves for the margin;
//! - [`root`] and [`sine`]: of + × ÷ alone.
//!
//! It knows no board, no wire and no plant, uses no allocation, and the tick cannot panic.
//!
//! Quantities are in SI units; a bare number carries its unit in its name. Equation
//! numbers in parentheses are those of Diolaiti, Niemeyer, Barbagli, Salisbury, "A
//! Criterion for the Passivity of Haptic Devices" (2005).
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod config;
pub mod criterion;
pub mod encoder;
mod error;
pub mod ledger;
pub mod margin;
pub mod motion;
pub mod plan;
pub mod push;
mod real;
pub mod root;
pub mod shape;
pub mod sine;
pub mod tick;
pub mod torque;
pub mod tuning;

pub use error::ConfigError;
pub use real::Real;

//! A haptic display, solved exactly.
//!
//! A motor with inertia, viscous and Coulomb friction is turned by a torque that is
//! held between samples, computed from an encoder's counts. Between two samples its
//! motion is a closed form, so a run has no step size and no integration error:
//!
//! - [`hold`]: the core, one interval of constant torque (1);
//! - [`display`]: the dimensionless display (6) and its runs;
//! - [`energy`]: the audit of Sec. IV, (16) to (26);
//! - [`outcome`]: rest, limit cycle or divergence, by two rules;
//! - [`kernel`] and [`map`]: many displays at once, the plane of Fig. 5;
//! - [`methods`]: integrators to compare with, behind one trait; [`precise`]: the truth, in 77 digits;
//!   [`compare`]: how fast and how accurate each is;
//! - [`closed_loop`]: a knob in physical units under the controller of [`control`];
//! - [`knob`]: the plant with what a real one adds, each opt-in: a [`hand`] that holds it,
//!   a [`drive`] that delays, lags and rounds the torque, a [`motor`] that cogs and sticks, a [`clock`]
//!   that is not even;
//! - [`electrical`]: windings behind an inverter, PWM period by PWM period, for scenes that ask for it;
//! - [`powered`]: the knob and its windings together, with a board's sensors and what can break of them;
//! - [`driven`]: that under a drive which brings the torque of a controller;
//! - [`fidelity`]: a scene without what cannot change its answer, with a bound on the error;
//! - [`identify`]: inertia and friction from a recording, as the set of all that explain every count;
//! - [`lockstep`]: the firmware in an emulator, tick by tick with the exact plant (Unix);
//! - [`preset`]: devices known by name;
//! - [`trial`], [`campaign`], [`search`]: what counts as a bad run of a law, random runs, and runs that
//!   climb towards a bad one;
//! - [`suite`], [`rivals`], [`ablation`]: how stiff each law gets in systematic runs, published laws
//!   to compare with, and the ledger without one of its parts.
//!
//! Everything is `f64`. Equation numbers in parentheses are those of Diolaiti, Niemeyer,
//! Barbagli, Salisbury, "A Criterion for the Passivity of Haptic Devices" (2005).
#![forbid(unsafe_code)]

pub mod ablation;
pub mod campaign;
pub mod clock;
pub mod closed_loop;
pub mod compare;
pub mod display;
pub mod drive;
pub mod driven;
pub mod electrical;
pub mod energy;
pub mod fidelity;
pub mod hand;
pub mod hold;
pub mod identify;
pub mod kernel;
pub mod knob;
#[cfg(unix)]
pub mod lockstep;
pub mod map;
pub mod methods;
pub mod motor;
pub mod outcome;
pub mod powered;
#[cfg(unix)]
pub mod powered_lockstep;
pub mod precise;
pub mod preset;
#[cfg(unix)]
mod qemu;
pub mod rivals;
pub mod search;
mod series;
mod sprung;
pub mod suite;
pub mod trial;

//! Published laws for a sampled spring, to compare with those of [`control`]: `f64`, exact
//! knowledge of the device, and no firmware.
//!
//! Each is a [`Rival`]: it sees what a tick sees, and answers with a torque. F is the torque on the
//! knob, K the stiffness, q the sensed deflection (the nominal torque is −K·q), δ what the
//! counts moved since the last tick, T the sample period, Δ the count, b and c the friction.

mod bounding;
mod damping;
mod passivity;

use std::f64::consts::TAU;

use control::config::Law;
use control::shape::Shape;
use control::tick::{Reason, Tick};

pub use bounding::EnergyBounding;
pub use damping::VirtualDamping;
pub use passivity::PassivityControl;

/// What a law sees in a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Nominal torque per stiffness, −q of a spring, rad; 0 on the free side of a wall.
    pub pull_rad: f64,
    /// δ, rad.
    pub moved_rad: f64,
    /// On the free side of a wall.
    pub free: bool,
}

/// A law.
pub trait Rival {
    /// F, to be held until the next tick, Nm.
    fn torque_nm(&mut self, seen: &Seen) -> f64;
}

/// The encoder and the shape in front of a rival, so that it stands in for a
/// [`control::tick::Controller`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rendered<R> {
    rival: R,
    shape: Shape,
    count_rad: f64,
    count: i32,
}

impl<R: Rival> Rendered<R> {
    /// A shape rendered by `rival`, where the last tick, a period before the first one, had seen
    /// `count`.
    pub fn new(rival: R, shape: Shape, count_rad: f64, count: i32) -> Self {
        Self {
            rival,
            shape,
            count_rad,
            count,
        }
    }

    /// One sample. The stiffness reported is torque over deflection where it pushes back, else 0;
    /// there is no margin and no account.
    pub fn tick(&mut self, counter: u32) -> Tick {
        let count = counter as i32;
        let moved = count.wrapping_sub(self.count);
        self.count = count;
        let deflection_rad = (f64::from(count) + 0.5) * self.count_rad - self.shape.zero_rad();
        let free = matches!(self.shape, Shape::Wall { .. }) && deflection_rad <= 0.0;
        let pull_rad = match self.shape {
            _ if free => 0.0,
            Shape::Detent { period_rad, .. } => {
                let turn = TAU / period_rad;
                -(turn * deflection_rad).sin() / turn
            }
            Shape::Spring { .. } | Shape::Wall { .. } => -deflection_rad,
        };
        let torque_nm = self.rival.torque_nm(&Seen {
            pull_rad,
            moved_rad: f64::from(moved) * self.count_rad,
            free,
        });
        let stiffness = if torque_nm * pull_rad > 0.0 {
            torque_nm / pull_rad
        } else {
            0.0
        };
        Tick {
            count,
            moved,
            torque_nm: torque_nm as f32,
            stiffness_nm_rad: stiffness as f32,
            margin_nm: 0.0,
            account_j: 0.0,
            law: Law::Raw,
            reason: Reason::None,
        }
    }
}

use super::{Rival, Seen};
use crate::trial::Sampled;

/// A spring with the virtual damping that makes up for the hold: **F = −K·q − B·δ/T** in contact,
/// **B = K·T/2**.
///
/// The hold delays the torque by T/2, which is as if K·T/2 of damping were missing; δ/T, the
/// backward difference of the counts, is late by another T/2 and steps by Δ/T. It does not know when it
/// is too stiff, so K has to be found offline.
///
/// J. E. Colgate and G. Schenkel, "Passivity of a class of sampled-data systems: application to
/// haptic interfaces", American Control Conference 1994: b > K·T/2 + |B|.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VirtualDamping {
    stiffness_nm_rad: f64,
}

impl VirtualDamping {
    /// A spring of `stiffness_nm_rad` and the damping that goes with it.
    #[must_use]
    pub fn new(_sampled: &Sampled, stiffness_nm_rad: f64) -> Self {
        Self { stiffness_nm_rad }
    }
}

impl Rival for VirtualDamping {
    fn torque_nm(&mut self, seen: &Seen) -> f64 {
        if seen.free {
            return 0.0;
        }
        // B·δ/T = K·δ/2.
        self.stiffness_nm_rad * (seen.pull_rad - 0.5 * seen.moved_rad)
    }
}

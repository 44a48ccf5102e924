use super::{Rival, Seen};
use crate::trial::Sampled;

/// Time-domain passivity control: an observer of the energy that the display took in, and a
/// damper that takes back what it is short of.
///
/// Observer, exact for a held torque but for the counts: **E ← E − F₋₁·δ**. Controller, if E < 0
/// and δ ≠ 0: **α = min(−E·T/δ², m/4T)**, **F = −K·q − α·δ/T**; what the damper takes enters E with
/// the next δ, as F does. A limit on α is part of the method (the actuator's, in the paper); without
/// one it turns the knob round within the tick and renders a fifth of the stiffness. Of m/T, m/2T and
/// m/4T the last renders most. E = 0 out of contact, so that one contact does not pay for another.
///
/// It knows neither that energy below a count is unseen, nor that of the tick to come, so K has to be
/// found offline.
///
/// B. Hannaford and J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans.
/// Robotics and Automation 18(1), 2002; the observer with F₋₁: S. Stramigioli, C. Secchi, A. van der
/// Schaft, C. Fantuzzi, "Sampled data systems passivity and discrete port-Hamiltonian systems", IEEE
/// Trans. Robotics 21(4), 2005.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassivityControl {
    stiffness_nm_rad: f64,
    period_s: f64,
    largest_damping: f64,
    held_nm: f64,
    account_j: f64,
}

impl PassivityControl {
    /// A spring of `stiffness_nm_rad`.
    #[must_use]
    pub fn new(sampled: &Sampled, stiffness_nm_rad: f64) -> Self {
        Self {
            stiffness_nm_rad,
            period_s: sampled.period_s,
            largest_damping: 0.25 * sampled.device.inertia_kg_m2 / sampled.period_s,
            held_nm: 0.0,
            account_j: 0.0,
        }
    }
}

impl Rival for PassivityControl {
    fn torque_nm(&mut self, seen: &Seen) -> f64 {
        self.account_j -= self.held_nm * seen.moved_rad;
        if seen.free {
            self.account_j = 0.0;
            self.held_nm = 0.0;
            return 0.0;
        }
        self.held_nm = self.stiffness_nm_rad * seen.pull_rad;
        if self.account_j < 0.0 && seen.moved_rad != 0.0 {
            let damping = (-self.account_j * self.period_s / seen.moved_rad.powi(2))
                .min(self.largest_damping);
            self.held_nm -= damping * seen.moved_rad / self.period_s;
        }
        self.held_nm
    }
}

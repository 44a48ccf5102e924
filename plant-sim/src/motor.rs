//! What a motor has beyond inertia, viscous and Coulomb friction.

use control::ConfigError;

use crate::knob::KnobError;

/// Cogging and stiction. All 0, the default: none.
///
/// At angle x and velocity v the motor gives −A sin(N x) (Nm) beside its torque, A
/// `cogging_nm` and N `cogging_per_rev`, and rubs with
/// c + s·e^(−(v/v_s)²) (Nm) where Coulomb friction alone would be c: Stribeck's curve, s
/// `stiction_nm` and v_s `stribeck_rad_s`. A knob at rest breaks loose above c + s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motor {
    /// A, Nm.
    pub cogging_nm: f64,
    /// N, periods of the cogging in a turn.
    pub cogging_per_rev: f64,
    /// s, Nm: friction at rest beyond Coulomb friction.
    pub stiction_nm: f64,
    /// v_s, rad/s: the speed at which e⁻¹ of the stiction is left.
    pub stribeck_rad_s: f64,
}

/// The most periods of cogging in a turn.
pub const MOST_PERIODS: f64 = 1e4;

/// Beyond so many v_s no stiction is left: e^(−6.25²) is 1e-17.
const FAST: f64 = 6.25;

impl Motor {
    /// Refuses what is not finite or negative, and one half of a pair without the other.
    pub(crate) fn check(&self) -> Result<(), KnobError> {
        for (name, value) in [
            ("cogging (Nm)", self.cogging_nm),
            ("cogging periods in a turn", self.cogging_per_rev),
            ("stiction (Nm)", self.stiction_nm),
            ("Stribeck velocity (rad/s)", self.stribeck_rad_s),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(ConfigError::Negative { name, value }.into());
            }
        }
        for (name, value, with) in [
            (
                "cogging periods in a turn",
                self.cogging_per_rev,
                self.cogging_nm,
            ),
            (
                "Stribeck velocity (rad/s)",
                self.stribeck_rad_s,
                self.stiction_nm,
            ),
        ] {
            if with > 0.0 && value == 0.0 {
                return Err(ConfigError::NotPositive { name, value }.into());
            }
        }
        if self.cogging_per_rev > MOST_PERIODS {
            return Err(KnobError::Above {
                name: "cogging periods in a turn",
                value: self.cogging_per_rev,
                limit: MOST_PERIODS,
                reason: "far beyond any motor",
            });
        }
        Ok(())
    }

    /// Whether it has neither.
    pub(crate) fn is_even(&self) -> bool {
        self.cogging_nm == 0.0 && self.stiction_nm == 0.0
    }

    /// −A sin(N x), Nm.
    pub(crate) fn cogging(&self, angle_rad: f64) -> f64 {
        if self.cogging_nm == 0.0 {
            return 0.0;
        }
        -self.cogging_nm * (self.cogging_per_rev * angle_rad).sin()
    }

    /// s·e^(−(v/v_s)²), Nm.
    pub(crate) fn stiction(&self, velocity_rad_s: f64) -> f64 {
        if self.stiction_nm == 0.0 || velocity_rad_s.abs() > FAST * self.stribeck_rad_s {
            return 0.0;
        }
        let ratio = velocity_rad_s / self.stribeck_rad_s;
        self.stiction_nm * (-ratio * ratio).exp()
    }

    /// How fast these torques vary for a knob of `speed_rad_s` (rad/s) that gains or loses
    /// `acceleration_rad_s2`, 1/s: N·|v| and √(N·acceleration); acceleration/v_s, and where the
    /// knob is too fast for stiction, acceleration over what it is faster.
    pub(crate) fn rate(&self, speed_rad_s: f64, acceleration_rad_s2: f64) -> f64 {
        let mut rate = 0.0_f64;
        if self.cogging_nm > 0.0 {
            let periods = self.cogging_per_rev;
            rate = (periods * speed_rad_s).max((periods * acceleration_rad_s2).sqrt());
        }
        if self.stiction_nm > 0.0 {
            let faster = speed_rad_s - FAST * self.stribeck_rad_s;
            rate = rate.max(acceleration_rad_s2 / faster.max(self.stribeck_rad_s));
        }
        rate
    }
}

//! The core: one hold interval of m ẍ + b ẋ + c sgn ẋ = F (1), solved in closed form.
//!
//! While the force F is held and the sign s of the motion stays, the equation is
//! linear and has the solution
//!
//! v(t) = v e^(−at) + (d/m)·t·φ₁(at),  x(t) = x + v·t·φ₁(at) + (d/m)·t²·φ₂(at),
//!
//! with a = b/m, d = F − c·s. The velocity moves monotonically towards d/b, so it
//! changes its sign at most once in an interval; where it does, the second part
//! starts from rest with the friction turned round, or sticks if |F| ≤ c.
//!
//! There is no step size, no integrator and no tolerance. The forms are chosen so
//! that no digits are lost for any b ≥ 0, also b = 0.
//!
//! The same core serves physical units (kg m², Nm s/rad, Nm, s) and the
//! dimensionless display (6), where m, b, c are μ, β, σ and an interval lasts 1.

use control::ConfigError;
use control::criterion::{Criterion, Device, Sampling};

use crate::series::{phi1, phi2, polynomial};

/// Position and velocity. Units are those of the [`Hold`] that moves them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// x (rad), or ξ (counts).
    pub position: f64,
    /// ẋ (rad/s), or ξ̇ (counts per sample).
    pub velocity: f64,
}

/// Where and when the velocity reached zero inside an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// Time since the start of the interval.
    pub time: f64,
    /// Position at that time.
    pub position: f64,
}

/// What one interval did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// The state at the end.
    pub end: State,
    /// The point where the motion reversed, or stopped for good while it was moving.
    pub turn: Option<Turn>,
}

/// A mass with friction, and the length of the interval for which a force is held.
/// Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    inertia: f64,
    viscous: f64,
    coulomb: f64,
    duration: f64,
    /// 1/m.
    mobility: f64,
    /// a = b/m.
    decay_rate: f64,
    /// a·h = b·h/m.
    decay_exponent: f64,
    /// 1 − e^(−ah).
    decay: f64,
    /// h·φ₁(ah): velocity to displacement.
    reach: f64,
    /// (h/m)·φ₁(ah): force to velocity.
    impulse: f64,
    /// (h²/m)·φ₂(ah): force to displacement.
    thrust: f64,
}

/// The largest μ, β, σ and 1/μ.
const EXTREME: f64 = 1e100;

impl Hold {
    /// Intervals of `duration` for a device in physical units.
    ///
    /// # Errors
    /// Refuses what is not finite, an inertia or duration not above zero, negative
    /// friction, and values whose ratios overflow.
    pub fn new(device: &Device<f64>, duration: f64) -> Result<Self, ConfigError> {
        // Criterion::new holds the rules for a device; a count does not matter here.
        let sampling = Sampling {
            period_s: duration,
            count_rad: 1.0,
        };
        let device = *Criterion::new(*device, sampling)?.device();
        let Device {
            inertia_kg_m2: inertia,
            viscous_nm_s_rad: viscous,
            coulomb_nm: coulomb,
        } = device;
        let y = viscous * duration / inertia;
        let (two, mobility) = (phi2(y), duration / inertia);
        let one = phi1(y, two);
        let hold = Self {
            inertia,
            viscous,
            coulomb,
            duration,
            mobility: 1.0 / inertia,
            decay_rate: viscous / inertia,
            decay_exponent: y,
            decay: -(-y).exp_m1(),
            reach: duration * one,
            impulse: mobility * one,
            thrust: duration * mobility * two,
        };
        for (name, value) in [
            ("viscous friction × duration / inertia", y),
            ("duration² / inertia (s²/kg m²)", duration * mobility),
            ("(duration² / inertia)²", (duration * mobility).powi(2)),
        ] {
            if !value.is_finite() {
                return Err(ConfigError::Negative { name, value });
            }
        }
        Ok(hold)
    }

    /// Intervals of length 1 of the dimensionless display (6) with μ, β, σ.
    ///
    /// # Errors
    /// Refuses a μ that is not above zero, a negative β or σ, and what is not finite or so
    /// extreme that squares overflow: μ from 1e-100 to 1e100, β and σ up to 1e100.
    pub fn dimensionless(mu: f64, beta: f64, sigma: f64) -> Result<Self, ConfigError> {
        if !(EXTREME.recip()..=EXTREME).contains(&mu) {
            let name = "μ (from 1e-100 to 1e100)";
            return Err(ConfigError::NotPositive { name, value: mu });
        }
        for (name, value) in [("β (up to 1e100)", beta), ("σ (up to 1e100)", sigma)] {
            if !(0.0..=EXTREME).contains(&value) {
                return Err(ConfigError::Negative { name, value });
            }
        }
        Self::new(
            &Device {
                inertia_kg_m2: mu,
                viscous_nm_s_rad: beta,
                coulomb_nm: sigma,
            },
            1.0,
        )
    }

    /// m or μ.
    #[must_use]
    pub fn inertia(&self) -> f64 {
        self.inertia
    }

    /// b or β.
    #[must_use]
    pub fn viscous(&self) -> f64 {
        self.viscous
    }

    /// c or σ.
    #[must_use]
    pub fn coulomb(&self) -> f64 {
        self.coulomb
    }

    /// The same with another Coulomb friction.
    ///
    /// # Assumes
    /// Finite and not below zero.
    pub(crate) fn with_coulomb(self, coulomb: f64) -> Self {
        Self { coulomb, ..self }
    }

    /// The length of the interval, h.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// a·h = b·h/m.
    pub(crate) fn decay_exponent(&self) -> f64 {
        self.decay_exponent
    }

    /// 1 − e^(−ah).
    pub(crate) fn decay(&self) -> f64 {
        self.decay
    }

    /// h·φ₁(ah).
    pub(crate) fn reach(&self) -> f64 {
        self.reach
    }

    /// (h/m)·φ₁(ah).
    pub(crate) fn impulse(&self) -> f64 {
        self.impulse
    }

    /// (h²/m)·φ₂(ah).
    pub(crate) fn thrust(&self) -> f64 {
        self.thrust
    }

    /// What the force leaves after Coulomb friction holds as much as it can:
    /// F − clamp(F, ±c). Zero if a mass at rest sticks.
    #[must_use]
    pub fn breakaway(&self, force: f64) -> f64 {
        force - force.clamp(-self.coulomb, self.coulomb)
    }

    /// The state after one interval under a held force.
    ///
    /// Exact but for rounding: against arithmetic of 40 digits the error of one step
    /// stays below 1e-15 of the magnitudes in play.
    ///
    /// ```
    /// use plant_sim::hold::{Hold, State};
    /// // No viscous friction, σ = 1: from 3 counts per sample, 1.5 of mass 1 against φ = −1.
    /// let hold = Hold::dimensionless(1.0, 0.0, 1.0)?;
    /// let step = hold.step(State { position: 0.0, velocity: 3.0 }, -1.0);
    /// assert_eq!(step.end, State { position: 2.0, velocity: 1.0 });
    /// # Ok::<(), control::ConfigError>(())
    /// ```
    #[must_use]
    #[inline]
    pub fn step(&self, start: State, force: f64) -> Step {
        let State {
            position: x,
            velocity: v,
        } = start;
        let d = if v == 0.0 {
            self.breakaway(force)
        } else {
            force - self.coulomb.copysign(v)
        };
        let velocity = v - v * self.decay + d * self.impulse;
        if (v > 0.0 && velocity < 0.0) || (v < 0.0 && velocity > 0.0) {
            return self.step_with_turn(start, force, d);
        }
        let position = x + v * self.reach + d * self.thrust;
        Step {
            end: State { position, velocity },
            turn: None,
        }
    }

    /// The rest of [`Hold::step`], for a velocity that reverses: d opposes v.
    fn step_with_turn(&self, start: State, force: f64, d: f64) -> Step {
        let (time, distance) = self.time_and_distance_to_rest(start.velocity, d);
        let time = time.min(self.duration);
        let turn = Turn {
            time,
            position: start.position + distance,
        };
        let left = self.duration - time;
        let y = self.decay_rate * left;
        let two = phi2(y);
        let gain = self.breakaway(force) * (left * self.mobility);
        Step {
            end: State {
                position: turn.position + gain * left * two,
                velocity: gain * phi1(y, two),
            },
            turn: Some(turn),
        }
    }

    /// How long, and how far, a mass at velocity v goes against d before it stands,
    /// where v and d have opposite signs.
    ///
    /// With z = −b·v/d ≥ 0: t* = (−m·v/d)·log1p(z)/z and distance
    /// −(m·v²/d)·(1 − log1p(z)/z)/z. For z < ½ both come from
    /// log1p(z)/z = 2(1 + w²r)/(2 + z), w = z/(2 + z), r = Σ w²ᵏ/(2k + 3), multiplied
    /// through by d so that one division serves.
    fn time_and_distance_to_rest(&self, v: f64, d: f64) -> (f64, f64) {
        let drag = -self.viscous * v;
        if drag.abs() < 0.5 * d.abs() {
            let reciprocal = 1.0 / (2.0 * d + drag);
            let w = drag * reciprocal;
            let w2 = w * w;
            let r = log_tail(w2);
            let push = -self.inertia * v * reciprocal;
            let time = 2.0 * push * (1.0 + w2 * r);
            let distance = push * v * (1.0 - 2.0 * w * r * (d * reciprocal));
            (time, distance)
        } else {
            let z = drag / d;
            let log = z.ln_1p();
            let q = -self.inertia * v / d;
            (q * (log / z), q * v * ((1.0 - log / z) / z))
        }
    }
}

/// Terms of r = Σ w²ᵏ/(2k + 3) for w² ≤ 0.04 (z ≤ ½).
const LOG_TAIL: [f64; 11] = log_tail_terms();

/// As many as suffice for w² ≤ [`LOG_TAIL_SMALL_W2`].
pub(crate) const LOG_TAIL_SMALL: [f64; 5] = log_tail_terms();

/// w = z/(2 + z) at z = expm1(1/32), the largest z of an interval with b·h/m ≤ 1/32, squared.
const LOG_TAIL_SMALL_W2: f64 = 2.5e-4;

const fn log_tail_terms<const N: usize>() -> [f64; N] {
    let mut terms = [0.0; N];
    let mut k = 0;
    while k < N {
        terms[k] = 1.0 / (2 * k + 3) as f64;
        k += 1;
    }
    terms
}

/// r(w²).
#[inline]
fn log_tail(w2: f64) -> f64 {
    if w2 <= LOG_TAIL_SMALL_W2 {
        polynomial(&LOG_TAIL_SMALL, w2)
    } else {
        polynomial(&LOG_TAIL, w2)
    }
}

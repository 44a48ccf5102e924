//! Methods of N equal steps an interval, without events.

use std::fmt;
use std::num::NonZeroU32;

use super::Method;
use crate::hold::{Hold, State};

/// Semi-implicit Euler with friction c·sgn v, sgn 0 = 0: v′ = v + h·(F − b v − c sgn v)/m,
/// x′ = x + h·v′. Order 1. About v = 0 the sign flips with every step: it chatters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Euler {
    /// Steps an interval.
    pub steps: NonZeroU32,
}

impl Method for Euler {
    #[inline]
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        let State {
            position: mut x,
            velocity: mut v,
        } = start;
        let n = self.steps.get();
        let h = hold.duration() / f64::from(n);
        let gain = h / hold.inertia();
        for _ in 0..n {
            v += gain * (force - hold.viscous() * v - hold.coulomb() * sign(v));
            x += h * v;
        }
        State {
            position: x,
            velocity: v,
        }
    }
}

/// Implicit midpoint with friction projected (a proximal step): v′ is the velocity nearest to
/// that without Coulomb friction which an impulse of at most h·c allows,
/// (m + hb/2)·v′ = r − clamp(r, ±hc), r = (m − hb/2)·v + h·F; x′ = x + h·(v + v′)/2.
///
/// Order 2 while it slides, and it sticks exactly. A step that reverses is of order 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Midpoint {
    /// Steps an interval.
    pub steps: NonZeroU32,
}

impl Method for Midpoint {
    #[inline]
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        let State {
            position: mut x,
            velocity: mut v,
        } = start;
        let n = self.steps.get();
        let h = hold.duration() / f64::from(n);
        let drag = 0.5 * h * hold.viscous();
        let (kept, inverse) = (hold.inertia() - drag, 1.0 / (hold.inertia() + drag));
        let (push, friction) = (h * force, h * hold.coulomb());
        for _ in 0..n {
            let momentum = kept * v + push;
            let next = (momentum - momentum.clamp(-friction, friction)) * inverse;
            x += 0.5 * h * (v + next);
            v = next;
        }
        State {
            position: x,
            velocity: v,
        }
    }
}

/// What stands for c·sgn v.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Friction {
    /// c·sgn v, sgn 0 = 0.
    Sign,
    /// c·tanh(v/width): smooth, but a mass under any force below c creeps instead of sticking.
    Tanh {
        /// Velocity at which three quarters of c are reached, counts per sample or rad/s.
        width: f64,
    },
}

impl Friction {
    fn of(self, v: f64) -> f64 {
        match self {
            Self::Sign => sign(v),
            Self::Tanh { width } => (v / width).tanh(),
        }
    }
}

/// The classical Runge–Kutta method. Order 4 where friction keeps its sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rk4 {
    /// Steps an interval.
    pub steps: NonZeroU32,
    /// What stands for c·sgn v.
    pub friction: Friction,
}

impl Method for Rk4 {
    #[inline]
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        match self.friction {
            Friction::Sign => runge_kutta(hold, start, force, self.steps, |v| Friction::Sign.of(v)),
            smooth => runge_kutta(hold, start, force, self.steps, |v| smooth.of(v)),
        }
    }
}

#[inline]
fn runge_kutta(
    hold: &Hold,
    start: State,
    force: f64,
    steps: NonZeroU32,
    friction: impl Fn(f64) -> f64,
) -> State {
    let State {
        position: mut x,
        velocity: mut v,
    } = start;
    let n = steps.get();
    let h = hold.duration() / f64::from(n);
    let mobility = 1.0 / hold.inertia();
    let acceleration =
        |v: f64| mobility * (force - hold.viscous() * v - hold.coulomb() * friction(v));
    for _ in 0..n {
        let a1 = acceleration(v);
        let v2 = v + 0.5 * h * a1;
        let a2 = acceleration(v2);
        let v3 = v + 0.5 * h * a2;
        let a3 = acceleration(v3);
        let v4 = v + h * a3;
        let a4 = acceleration(v4);
        x += h / 6.0 * (v + 2.0 * (v2 + v3) + v4);
        v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
    }
    State {
        position: x,
        velocity: v,
    }
}

/// sgn, with sgn 0 = 0.
#[inline]
fn sign(v: f64) -> f64 {
    if v > 0.0 {
        1.0
    } else if v < 0.0 {
        -1.0
    } else {
        0.0
    }
}

impl fmt::Display for Euler {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "euler:{}", self.steps)
    }
}

impl fmt::Display for Midpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "midpoint:{}", self.steps)
    }
}

impl fmt::Display for Rk4 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.friction {
            Friction::Sign => write!(f, "rk4:{}", self.steps),
            Friction::Tanh { .. } => write!(f, "rk4-tanh:{}", self.steps),
        }
    }
}

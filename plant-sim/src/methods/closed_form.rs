//! The closed form as textbooks write it.

use std::fmt;

use super::Method;
use crate::hold::{Hold, State};

/// v(t) = v∞ + (v − v∞)·e^(−at), x(t) = x + v∞·t + (v − v∞)·(1 − e^(−at))/a, with v∞ = d/b and the
/// reversal at t* = ln(1 − v/v∞)/a.
///
/// The same solution as [`Exact`](super::Exact) on paper. In numbers v∞ grows beyond all bounds
/// as b/m → 0 and what is left of a difference of large numbers loses its digits; for b = 0 it is
/// no number at all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosedForm;

impl Method for ClosedForm {
    fn sample(&self, hold: &Hold, start: State, force: f64) -> State {
        let State {
            position: x,
            velocity: v,
        } = start;
        let d = if v == 0.0 {
            hold.breakaway(force)
        } else {
            force - hold.coulomb().copysign(v)
        };
        if v == 0.0 && d == 0.0 {
            return start;
        }
        let end = after(hold, start, d, hold.duration());
        if end.velocity * v >= 0.0 {
            return end;
        }
        let (a, terminal) = (hold.viscous() / hold.inertia(), d / hold.viscous());
        let time = (1.0 - v / terminal).ln() / a;
        let turn = after(
            hold,
            State {
                position: x,
                velocity: v,
            },
            d,
            time,
        );
        let rest = State {
            velocity: 0.0,
            ..turn
        };
        let d = hold.breakaway(force);
        if d == 0.0 {
            return rest;
        }
        after(hold, rest, d, hold.duration() - time)
    }
}

/// The motion under a net force d, friction of one sign.
fn after(hold: &Hold, start: State, d: f64, time: f64) -> State {
    let a = hold.viscous() / hold.inertia();
    let terminal = d / hold.viscous();
    let decay = (-a * time).exp();
    State {
        position: start.position
            + terminal * time
            + (start.velocity - terminal) * (1.0 - decay) / a,
        velocity: terminal + (start.velocity - terminal) * decay,
    }
}

impl fmt::Display for ClosedForm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("closed-form")
    }
}

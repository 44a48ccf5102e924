//! A mass with friction on a spring: m ẍ + b ẋ + k (x − rest) + c sgn ẋ = F, in closed form.
//!
//! While F is held and the sign s of the motion stays, the equation is linear. From x, v and
//! the acceleration that forces other than viscous friction give at the start,
//! α = (F − c s − k (x − rest))/m,
//!
//! x(t) = x + v·S(t) + α·Q(t),  ẋ(t) = v·S′(t) + α·S(t),
//!
//! where S is the response to an impulse, S″ + 2γS′ + ω₀²S = 0, S(0) = 0, S′(0) = 1, and
//! Q = ∫S; γ = b/2m, ω₀² = k/m. The time at which the velocity reaches zero is an arctangent
//! below critical damping and a logarithm from there on. The mass then starts from rest with
//! the friction turned round, or sticks if |F − k (x − rest)| ≤ c; below critical damping it
//! may do so every π/√(ω₀² − γ²) (s).
//!
//! The forms keep their digits for weak springs and for none, and through critical damping.

use control::criterion::Device;

use crate::hold::State;
use crate::series::{phi1, phi2};

/// What an interval did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Moved {
    /// The state at its end.
    pub(crate) end: State,
    /// From start to end, rad; more digits than a difference of positions.
    pub(crate) displacement: f64,
    /// The length of the way, rad.
    pub(crate) path: f64,
    /// The largest |x| on it, rad.
    pub(crate) furthest: f64,
    /// Whether the motion reversed or came to a stop.
    pub(crate) turned: bool,
}

/// A mass with friction on a spring.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sprung {
    inertia: f64,
    coulomb: f64,
    stiffness: f64,
    rest: f64,
    /// γ, 1/s.
    gamma: f64,
    /// ω₀², 1/s².
    omega0_squared: f64,
    roots: Roots,
}

/// The two rates of the linear motion.
#[derive(Debug, Clone, Copy)]
enum Roots {
    /// Below critical damping: √(ω₀² − γ²) (1/s), above zero.
    Swinging { omega: f64 },
    /// From critical damping on: e^(−slow·t) and e^(−fast·t), slow ≤ fast.
    Creeping { slow: f64, fast: f64 },
}

/// S, S′ and Q at one time.
struct Response {
    reach: f64,
    decay: f64,
    thrust: f64,
}

impl Sprung {
    /// # Assumes
    /// What `Hold::new` accepts, and a finite stiffness ≥ 0.
    pub(crate) fn new(device: &Device<f64>, stiffness: f64, rest: f64) -> Self {
        let inertia = device.inertia_kg_m2;
        let gamma = 0.5 * device.viscous_nm_s_rad / inertia;
        let omega0_squared = stiffness / inertia;
        let omega0 = omega0_squared.sqrt();
        let roots = if gamma < omega0 {
            Roots::Swinging {
                omega: ((omega0 - gamma) * (omega0 + gamma)).sqrt(),
            }
        } else {
            let fast = gamma + ((gamma - omega0) * (gamma + omega0)).sqrt();
            // slow·fast = ω₀²; without damping and spring both are 0.
            let slow = if fast > 0.0 {
                omega0 / fast * omega0
            } else {
                0.0
            };
            Roots::Creeping { slow, fast }
        };
        Self {
            inertia,
            coulomb: device.coulomb_nm,
            stiffness,
            rest,
            gamma,
            omega0_squared,
            roots,
        }
    }

    /// The same with another Coulomb friction, finite and not below zero.
    pub(crate) fn with_coulomb(self, coulomb: f64) -> Self {
        Self { coulomb, ..self }
    }

    /// The force on the mass at rest, but for friction.
    pub(crate) fn net(&self, position: f64, force: f64) -> f64 {
        force - self.stiffness * (position - self.rest)
    }

    /// The motion over `duration` under a held force. Exact but for rounding.
    ///
    /// It may reverse about ω₀·duration/π times, and costs as much.
    pub(crate) fn advance(&self, start: State, force: f64, duration: f64) -> Moved {
        let State {
            position,
            velocity: mut v,
        } = start;
        let mut left = duration;
        let mut moved = Moved {
            end: start,
            displacement: 0.0,
            path: 0.0,
            furthest: position.abs(),
            turned: false,
        };
        loop {
            let net = self.net(position + moved.displacement, force);
            let driving = if v == 0.0 {
                net - net.clamp(-self.coulomb, self.coulomb)
            } else {
                net - self.coulomb.copysign(v)
            };
            if v == 0.0 && driving == 0.0 {
                break;
            }
            let sign = if v == 0.0 {
                driving.signum()
            } else {
                v.signum()
            };
            let acceleration = driving / self.inertia;
            let stop = self.time_to_rest(v.abs(), acceleration * sign);
            let time = stop.min(left);
            let response = self.response(time);
            let displacement = v * response.reach + acceleration * response.thrust;
            let velocity = v * response.decay + acceleration * response.reach;
            moved.displacement += displacement;
            moved.path += displacement.abs();
            moved.furthest = moved.furthest.max((position + moved.displacement).abs());
            if stop < left {
                left -= stop;
                v = 0.0;
                moved.turned = true;
            } else {
                // At the very end of a swing rounding may say that it is over.
                v = if velocity * sign > 0.0 { velocity } else { 0.0 };
                break;
            }
        }
        moved.end = State {
            position: position + moved.displacement,
            velocity: v,
        };
        moved
    }

    /// When a mass of `speed` ≥ 0 stands that is accelerated by `along` in the direction of
    /// its motion (viscous friction apart); infinite if never.
    ///
    /// Swinging: tan ωt = ω·speed/(γ·speed − along), 0 < ωt ≤ π. Creeping:
    /// t = log1p((fast − slow)·u)/(fast − slow), u = speed/(slow·speed − along).
    fn time_to_rest(&self, speed: f64, along: f64) -> f64 {
        match self.roots {
            Roots::Swinging { omega } => (omega * speed).atan2(self.gamma * speed - along) / omega,
            Roots::Creeping { slow, fast } => {
                let against = slow * speed - along;
                if against <= 0.0 {
                    return f64::INFINITY;
                }
                let u = speed / against;
                let y = (fast - slow) * u;
                if y == 0.0 { u } else { u * (y.ln_1p() / y) }
            }
        }
    }

    /// S, S′ and Q at time t.
    ///
    /// Where 2γt and (ω₀t)² are at most 1, their power series. Else from the roots, with
    /// ω₀²Q = 1 − S′ − 2γS; but creeping and with slow·t < ¼, where that would cancel,
    /// Q = t·(φ₁(slow·t) − φ₁(fast·t))/(fast − slow).
    fn response(&self, t: f64) -> Response {
        let p = 2.0 * self.gamma * t;
        let q = self.omega0_squared * t * t;
        if p <= 1.0 && q <= 1.0 {
            return Response::series(t, p, q);
        }
        match self.roots {
            Roots::Swinging { omega } => {
                let (sin, cos) = (omega * t).sin_cos();
                let envelope = (-self.gamma * t).exp();
                let reach = envelope * sin / omega;
                let decay = envelope * cos - self.gamma * reach;
                let thrust = (1.0 - decay - 2.0 * self.gamma * reach) / self.omega0_squared;
                Response {
                    reach,
                    decay,
                    thrust,
                }
            }
            Roots::Creeping { slow, fast } => {
                let phi1_of = |y: f64| phi1(y, phi2(y));
                let reach = (-slow * t).exp() * t * phi1_of((fast - slow) * t);
                let gone = (-fast * t).exp_m1();
                let thrust = if slow * t < 0.25 {
                    t * ((phi1_of(slow * t) - phi1_of(fast * t)) / (fast - slow))
                } else {
                    (-gone - fast * reach) / self.omega0_squared
                };
                Response {
                    reach,
                    decay: 1.0 + gone - slow * reach,
                    thrust,
                }
            }
        }
    }
}

impl Response {
    /// Q = t²·Σ eₖ from k = 2, e₂ = ½, (k+2)(k+1)·eₖ₊₂ = −p(k+1)·eₖ₊₁ − q·eₖ; p, q ≤ 1.
    fn series(t: f64, p: f64, q: f64) -> Self {
        /// 1/20! is 4e-19.
        const TERMS: u32 = 18;
        let (mut older, mut old) = (0.0, 0.5);
        let (mut thrust, mut reach) = (0.0, 0.0);
        for k in 1..=TERMS {
            let k = f64::from(k);
            let next = -(p * (k + 1.0) * old + q * older) / ((k + 2.0) * (k + 1.0));
            thrust += next;
            reach += (k + 2.0) * next;
            (older, old) = (old, next);
        }
        let (thrust, reach) = (0.5 + thrust, 1.0 + reach);
        Self {
            reach: t * reach,
            decay: 1.0 - p * reach - q * thrust,
            thrust: t * t * thrust,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hold::Hold;
    use proptest::prelude::*;

    /// From 10^low to 10^high.
    fn decades(low: f64, high: f64) -> impl Strategy<Value = f64> {
        (low..high).prop_map(|exponent| 10_f64.powf(exponent))
    }

    fn device(b: f64, c: f64) -> Device<f64> {
        Device {
            inertia_kg_m2: 1.0,
            viscous_nm_s_rad: b,
            coulomb_nm: c,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]

        /// The power series, composed, against the closed forms: below, near and above
        /// critical damping, for short and for long times.
        #[test]
        fn the_closed_forms_continue_the_series(
            p in decades(-3.0, 2.5),
            ratio in prop_oneof![decades(-4.0, 2.0), (-1e-6..1e-6_f64).prop_map(|d| 1.0 + d), Just(1.0)],
        ) {
            // γ = p/2, ω₀ = γ·ratio, t = 1.
            let omega0 = 0.5 * p * ratio;
            let sprung = Sprung::new(&device(p, 0.0), omega0 * omega0, 0.0);
            let pieces = p.max(omega0).ceil() as u32;
            let (mut s, mut ds, mut q) = (0.0, 1.0, 0.0);
            let dt = 1.0 / f64::from(pieces);
            let r = Response::series(dt, p * dt, omega0 * omega0 * dt * dt);
            for _ in 0..pieces {
                // One more piece from (S, S′), and from (Q, S) with unit push.
                let left = 1.0 - omega0 * omega0 * q;
                (q, s, ds) = (
                    q + s * r.reach + left * r.thrust,
                    s * r.decay + left * r.reach,
                    ds * r.decay - omega0 * omega0 * s * r.reach,
                );
            }
            let got = sprung.response(1.0);
            let tolerance = 4e-15 * (1.0 + f64::from(pieces));
            prop_assert!((got.reach - s).abs() <= tolerance * s.abs().max(1.0 / p.max(omega0).max(1.0)),
                "S {} {s}", got.reach);
            prop_assert!((got.decay - ds).abs() <= tolerance, "S′ {} {ds}", got.decay);
            prop_assert!((got.thrust - q).abs() <= tolerance * q, "Q {} {q}", got.thrust);
        }

        /// No spring, or one that hardly is, moves as the core does.
        #[test]
        fn without_a_spring_it_is_the_core(
            b in prop_oneof![Just(0.0), decades(-8.0, 3.0)],
            c in prop_oneof![Just(0.0), decades(-3.0, 2.0)],
            k in prop_oneof![Just(0.0), Just(1e-300), Just(1e-20)],
            v in -10.0..10.0_f64,
            force in -10.0..10.0_f64,
        ) {
            let start = State { position: 0.0, velocity: v };
            let hold = Hold::new(&device(b, c), 1.0).unwrap();
            let step = hold.step(start, force);
            let moved = Sprung::new(&device(b, c), k, 0.0).advance(start, force, 1.0);
            let scale = v.abs() + force.abs() + c;
            prop_assert!((moved.end.position - step.end.position).abs() <= 4e-15 * scale,
                "{moved:?} {step:?}");
            prop_assert!((moved.end.velocity - step.end.velocity).abs() <= 4e-15 * scale,
                "{moved:?} {step:?}");
        }

        /// An interval cut anywhere ends where the whole one does.
        #[test]
        fn an_interval_may_be_cut_anywhere(
            b in prop_oneof![Just(0.0), decades(-6.0, 2.0)],
            c in prop_oneof![Just(0.0), decades(-3.0, 1.0)],
            k in decades(-12.0, 4.0),
            rest in -3.0..3.0_f64,
            x in -3.0..3.0_f64,
            v in prop_oneof![Just(0.0), -10.0..10.0_f64],
            force in -10.0..10.0_f64,
            cut in 0.0..1.0_f64,
        ) {
            let sprung = Sprung::new(&device(b, c), k, rest);
            let start = State { position: x, velocity: v };
            let whole = sprung.advance(start, force, 1.0);
            let first = sprung.advance(start, force, cut);
            let second = sprung.advance(first.end, force, 1.0 - cut);
            let omega = k.sqrt().max(1.0);
            let scale = (x - rest).abs() + 3.0 + (v.abs() + force.abs() / omega + c / omega) / omega;
            let far = (whole.end.position - second.end.position).abs();
            let fast = (whole.end.velocity - second.end.velocity).abs();
            prop_assert!(far <= 1e-14 * omega * scale, "{far} {whole:?} {second:?}");
            prop_assert!(fast <= 1e-14 * omega * omega * scale, "{fast} {whole:?} {second:?}");
            let path = first.path + second.path;
            prop_assert!((whole.path - path).abs() <= 1e-14 * omega * (scale + path));
            let furthest = first.furthest.max(second.furthest);
            prop_assert!((whole.furthest - furthest).abs() <= 1e-14 * omega * scale);
        }
    }

    /// Coulomb friction alone takes 2c/k from every swing, and holds within ±c/k.
    #[test]
    fn swings_shrink_by_twice_c_over_k_and_stop() {
        let sprung = Sprung::new(&device(0.0, 0.25), 1.0, 5.0);
        let start = State {
            position: 6.9,
            velocity: 0.0,
        };
        // Deflections 1.9, −1.4, 0.9, −0.4, −0.4 + … = 0.1 after 4 half-periods.
        for (half_periods, deflection) in [(1.0, -1.4), (2.0, 0.9), (3.0, -0.4), (4.0, -0.1)] {
            let duration = half_periods * std::f64::consts::PI;
            let moved = sprung.advance(start, 0.0, duration + 1e-9);
            assert!(
                (moved.end.position - 5.0 - deflection).abs() < 1e-12,
                "{moved:?}"
            );
        }
        let end = sprung.advance(start, 0.0, 100.0);
        assert_eq!(end.end.velocity, 0.0);
        assert_eq!(sprung.advance(end.end, 0.0, 100.0).end, end.end);
        assert_eq!(end.furthest, 6.9);
    }
}

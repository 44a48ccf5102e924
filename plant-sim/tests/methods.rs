//! The methods beside the exact map: each solves the same equation, to its own order.

use control::criterion::Dimensionless;
use plant_sim::display::Display;
use plant_sim::hold::{Hold, State};
use plant_sim::methods::{self, Method};
use plant_sim::outcome::Class;
use proptest::prelude::*;

fn method(text: &str) -> Box<dyn Method> {
    methods::named(text).unwrap()
}

fn far(method: &dyn Method, hold: &Hold, start: State, force: f64) -> f64 {
    let (is, exact) = (
        method.sample(hold, start, force),
        hold.step(start, force).end,
    );
    (is.position - exact.position)
        .abs()
        .max((is.velocity - exact.velocity).abs())
}

/// The error of n steps over that of 2n where friction keeps its sign: 2 to the power of the
/// order.
#[test]
fn a_sliding_display_is_solved_to_the_order_of_the_method() {
    let hold = Hold::dimensionless(2.0, 1.5, 0.7).unwrap();
    let start = State {
        position: 0.3,
        velocity: 5.0,
    };
    for (name, steps, order) in [
        ("euler", 1000, 1),
        ("midpoint", 100, 2),
        ("rk4", 10, 4),
        ("rk4-tanh", 10, 4),
    ] {
        let error = |steps: u32| far(&*method(&format!("{name}:{steps}")), &hold, start, -1.5);
        let ratio = error(steps) / error(2 * steps);
        let expected = f64::from(1 << order);
        assert!(
            (ratio / expected - 1.0).abs() < 0.05,
            "{name}: {ratio}, not {expected}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Through reversals and standstill too, each comes as near to the exact map as its steps
    /// allow.
    #[test]
    fn every_method_approaches_the_exact_map(
        mu in 0.5..50.0_f64,
        beta in 0.05..2.0_f64,
        sigma in 0.0..2.0_f64,
        v in prop_oneof![Just(0.0), -3.0..3.0_f64],
        force in -3.0..3.0_f64,
    ) {
        let hold = Hold::dimensionless(mu, beta, sigma).unwrap();
        let start = State { position: 0.4, velocity: v };
        // Per step of 1e-3: chatter of 2σh/μ, creep below the width of tanh, a reversal missed by
        // up to a step.
        let step = 1e-3 * (4.0 + force.abs() + sigma) / mu;
        // What tanh lacks of σ, σ(1 − tanh(v/w)) ≤ 2σ e^(−2v/w), moves a display that is only just held at
        // ½w·ln(1 + 4σ/(μw)) after an interval; before and after a turn it may do so.
        let width = methods::TANH_WIDTH;
        let creep = width * (4.0 * sigma / (mu * width)).ln_1p();
        for (name, within) in [
            ("closed-form", 1e-9),
            ("dopri5:1e-10", 1e-8),
            ("midpoint:1000", 2.0 * step),
            ("euler:1000", 2.0 * step + 1e-3),
            ("rk4:1000", 2.0 * step),
            ("rk4-tanh:1000", 2.0 * step + creep),
        ] {
            let error = far(&*method(name), &hold, start, force);
            prop_assert!(error <= within, "{name}: {error}, not {within}");
        }
    }
}

/// The same run, the same rules: the exact map behind the trait is the display's own run.
#[test]
fn the_exact_map_is_the_displays_own() {
    for (beta, sigma, v0) in [(0.3, 0.6, 40.0), (0.6, 0.6, 10.0), (0.6, 0.3, 10.0)] {
        let display = Display::new(Dimensionless {
            mu: 50.0,
            beta,
            sigma,
        })
        .unwrap();
        let start = State {
            position: 0.0,
            velocity: v0,
        };
        let exact = method("exact");
        let run = display.run(start, 10_000, |_, _| true);
        assert_eq!(exact.run(&display, start, 10_000), run);
        if run.classes.window != Class::Rest {
            let end = exact.follow(&display, start, run.samples);
            assert_eq!(end, run.end);
        }
    }
}

#[test]
fn names_say_what_they_are() {
    for name in [
        "exact",
        "closed-form",
        "euler:1",
        "midpoint:10",
        "rk4:100",
        "rk4-tanh:1000",
        "dopri5:1e-6",
    ] {
        assert_eq!(method(name).to_string(), name);
    }
    for wrong in [
        "",
        "exact:1",
        "euler",
        "euler:0",
        "euler:-1",
        "euler:1.5",
        "euler:1000001",
        "rk5:1",
        "dopri5:0",
        "dopri5:nan",
        "dopri5:1",
        "dopri5",
        "Euler:1",
    ] {
        let refused = methods::named(wrong).err().map(|error| error.to_string());
        let refused = refused.unwrap_or_default();
        assert!(
            refused.starts_with(&format!("method {wrong}; accepted: exact")),
            "{wrong}: {refused}"
        );
    }
}

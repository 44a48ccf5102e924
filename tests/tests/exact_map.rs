//! The closed-form map against trajectories computed with more digits than an f64 has.

use control::criterion::Dimensionless;
use plant_sim::display::Display;
use plant_sim::hold::State;
use plant_sim::precise::{PreciseDisplay, double};
use serde::Deserialize;

#[derive(Deserialize)]
struct Cases {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    tag: String,
    mu: f64,
    beta: f64,
    sigma: f64,
    v0: f64,
    #[serde(default)]
    xi0: f64,
    n: u64,
    /// Largest magnitude on the way, where it dwarfs the end's.
    largest: Option<f64>,
    xi: String,
    v: String,
    stuck: Option<bool>,
}

#[test]
fn every_recorded_trajectory_is_reproduced_to_1e_12() {
    reproduce(include_str!("../data/exact-map.json"));
}

/// From displacements, at the switches between forms, with frequent reversals: see
/// `data/exact_map.py`.
#[test]
fn so_is_every_further_one() {
    reproduce(include_str!("../data/exact-map-further.json"));
}

fn reproduce(recorded: &str) {
    let recorded: Cases = serde_json::from_str(recorded).unwrap();
    let mut worst: f64 = 0.0;
    for case in &recorded.cases {
        let Case {
            mu, beta, sigma, ..
        } = *case;
        let display = Display::new(Dimensionless { mu, beta, sigma }).unwrap();
        let start = State {
            position: case.xi0,
            velocity: case.v0,
        };
        let run = display.run(start, case.n, |_, _| true);
        let (xi, v): (f64, f64) = (case.xi.parse().unwrap(), case.v.parse().unwrap());
        let scale = case.largest.unwrap_or(xi.abs().max(v.abs())).max(1.0);
        let error = (run.end.position - xi)
            .abs()
            .max((run.end.velocity - v).abs())
            / scale;
        println!("{:12} {error:.1e}", case.tag);
        assert!(
            error <= 1e-12,
            "{}: μ {mu} β {beta} σ {sigma} v₀ {} after {}: {:?}, not ({xi}, {v})",
            case.tag,
            case.v0,
            case.n,
            run.end
        );
        // The two arithmetics of many digits agree to the last of a double.
        let precise = PreciseDisplay::new(display.parameters()).unwrap();
        let end = precise.follow(start, case.n);
        for (ours, theirs) in [(&end.position, xi), (&end.velocity, v)] {
            let ours = double(ours);
            assert!(
                (ours - theirs).abs() <= f64::EPSILON * theirs.abs(),
                "{}: {ours}, not {theirs}",
                case.tag
            );
        }
        if let Some(stuck) = case.stuck {
            assert_eq!(
                run.end.velocity == 0.0,
                stuck,
                "{}: at rest or not",
                case.tag
            );
        }
        worst = worst.max(error);
    }
    println!(
        "worst relative error {worst:.1e} over {} cases",
        recorded.cases.len()
    );
}

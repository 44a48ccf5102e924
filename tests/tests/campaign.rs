//! Random runs of the laws that promise to be passive, and a search for one that is not.
//!
//! `cargo xtask campaign` makes fifty times as many.

use std::sync::atomic::AtomicBool;

use control::config::Law;
use plant_sim::campaign::{Campaign, Draw, Kind, Tally, explain};
use plant_sim::search::{self, Goal, climb};
use plant_sim::trial::Fault;

const SEED: u64 = 1;

fn run(campaign: &Campaign, kind: Kind, runs: u64) -> Tally {
    let mut tally = Tally::default();
    let go_on = AtomicBool::new(false);
    assert!(
        campaign
            .go_on(kind, &mut tally, runs, &go_on, &|_| {})
            .unwrap()
    );
    assert_eq!(tally.runs, runs);
    tally
}

#[test]
fn twenty_thousand_runs_without_a_hand_are_all_passive_and_settle() {
    for law in [Law::Auto, Law::Ledger] {
        let campaign = Campaign::new(SEED, law);
        for (kind, runs) in [
            (Kind::Wall, 2_500),
            (Kind::Spring, 2_500),
            (Kind::Release, 2_500),
            (Kind::Detent, 2_500),
            (Kind::Loop, 5_000),
            (Kind::Changes, 5_000),
        ] {
            if (law, kind) == (Law::Auto, Kind::Release) {
                continue; // The next test.
            }
            let tally = run(&campaign, kind, runs);
            assert!(tally.bad.is_empty(), "{law:?} {kind:?}: {:?}", tally.bad);
        }
    }
}

#[test]
fn releases_under_auto_are_passive() {
    let tally = run(&Campaign::new(SEED, Law::Auto), Kind::Release, 12_000);
    assert!(tally.bad.is_empty(), "{:?}", tally.bad);
}

/// The campaign sees what is wrong with a law that promises nothing.
#[test]
fn the_plain_spring_is_found_out() {
    let campaign = Campaign {
        hasty: true,
        extension: 4,
        ..Campaign::new(SEED, Law::Raw)
    };
    for kind in [
        Kind::Wall,
        Kind::Spring,
        Kind::Release,
        Kind::Detent,
        Kind::Loop,
    ] {
        let tally = run(&campaign, kind, 200);
        assert!(tally.bad.len() > 60, "{kind:?}: {} bad", tally.bad.len());
        assert!(tally.with(Fault::GivenOut) + tally.with(Fault::Growth) > 30);
    }
}

/// A hand that pushes may ratchet: at most 3 of 60,000, so that none is due in 2,000.
#[test]
fn a_wall_holds_a_hand_that_pushes() {
    let tally = run(&Campaign::new(SEED, Law::Ledger), Kind::Push, 2_000);
    assert!(tally.bad.is_empty(), "{:?}", tally.bad);
}

/// A hand whose spring turns the knob within a few ticks moves it as no believed force can: up to 40 of
/// 20,000 give energy out, so up to 6 of 3,000, and of 20,000 one may grow, so none of these. Each of them only after
/// the truth had left what the counts say.
#[test]
fn a_hand_gets_energy_out_only_by_breaking_an_assumption() {
    for law in [Law::Ledger, Law::Auto] {
        let tally = run(&Campaign::new(SEED, law), Kind::Hand, 3_000);
        assert!(
            (1..=6).contains(&tally.bad.len()),
            "{law:?}: {:?}",
            tally.bad
        );
        assert_eq!(tally.with(Fault::Growth), 0, "{law:?}");
        for bad in &tally.bad {
            let why = explain(SEED, Kind::Hand, bad.number, law).unwrap();
            assert_eq!(why.verdict.fault, Some(bad.fault), "{bad:?}");
            assert!(why.is_outside_the_assumptions(), "{law:?} {bad:?}: {why:?}");
            let scene = Draw::new(SEED, Kind::Hand, bad.number)
                .trial(Kind::Hand, law)
                .scene;
            let inertia = scene.device.inertia_kg_m2 + scene.hand.inertia_kg_m2;
            let turned = (scene.hand.stiffness_nm_rad / inertia).sqrt() * scene.clock.period_s;
            assert!(turned > 0.2, "{law:?} {bad:?}: ω·T {turned}");
        }
    }
}

/// Without a hand the truth stays within what the counts say.
#[test]
fn without_a_hand_the_truth_is_believed() {
    for kind in [
        Kind::Wall,
        Kind::Spring,
        Kind::Release,
        Kind::Detent,
        Kind::Changes,
    ] {
        for number in 0..200 {
            let why = explain(SEED, kind, number, Law::Ledger).unwrap();
            assert_eq!(why.left, None, "{kind:?} {number}");
        }
    }
}

#[test]
fn five_thousand_evaluations_that_climb_find_no_violation() {
    let climbs = 5_000 / search::EVALUATIONS;
    let mut closest = 0.0_f64;
    for number in 0..climbs {
        let summit = climb(SEED, number, Law::Auto).unwrap();
        assert_eq!(summit.verdict.fault, None, "{summit:?}");
        if summit.goal == Goal::Energy {
            closest = closest.max(summit.height);
        }
    }
    // It did come closer than any random run, and the motor gave back less than friction took.
    assert!((0.5..1.0).contains(&closest), "{closest}");
}

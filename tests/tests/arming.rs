//! The torque limit that rises after arming: no energy comes of it, whatever happens meanwhile.

use control::config::Law;
use control::plan::Plan;
use plant_sim::campaign::{Draw, Kind};
use plant_sim::trial::{ROUNDING, Trial, Verdict};
use rayon::prelude::*;

const SEED: u64 = 1;

/// How often a limit was cut while it rose, and how often it had to wait.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    cut: bool,
    waited: bool,
}

/// A run that is armed at its first sample, with a limit that is reached in so many ticks.
fn armed(trial: &Trial, rise_ticks: u32) -> (Verdict, Seen) {
    let mut controller = trial
        .controller(Plan::new(&trial.scene.config).unwrap())
        .unwrap();
    let full_nm = trial.scene.config.torque_max_nm as f32;
    controller.release();
    assert_eq!(controller.limit_torque(0.0), 0.0);
    let (mut limit_nm, mut ticks) = (0.0_f32, 0);
    let mut seen = Seen::default();
    let verdict = trial.run_under(
        |counter, duration_s| {
            let tick = controller.tick(counter, duration_s);
            assert!(
                tick.torque_nm.abs() <= limit_nm,
                "{} Nm of {limit_nm}",
                tick.torque_nm
            );
            seen.cut |= limit_nm < full_nm && tick.torque_nm.abs() == limit_nm && limit_nm > 0.0;
            ticks += 1;
            let wanted_nm = full_nm * (ticks as f32 / rise_ticks as f32).min(1.0);
            limit_nm = controller.limit_torque(wanted_nm);
            seen.waited |= limit_nm < wanted_nm;
            tick
        },
        0.0,
    );
    (verdict.unwrap(), seen)
}

/// The run of a number, with a torque limit of a twentieth to twice what it would come to, and in how many ticks
/// that is reached: as long as the knob is on its way, or some.
fn draw(kind: Kind, law: Law, number: u64) -> (Trial, u32) {
    let mut draw = Draw::new(SEED, kind, number);
    let mut trial = draw.trial(kind, law);
    // Energy is given out early or not at all; whether a run settles is not asked here.
    trial.extension = 1;
    let scene = &mut trial.scene;
    let plan = Plan::new(&scene.config).unwrap();
    let stiffness = plan
        .applied_limit_nm_rad()
        .min(scene.config.stiffness_nm_rad);
    let inertia = scene.device.inertia_kg_m2 + scene.hand.inertia_kg_m2;
    let way_s = (inertia / stiffness).sqrt();
    let force_nm = stiffness * way_s * scene.start.velocity.abs() + scene.hand.push_nm.abs();
    scene.config.torque_max_nm = draw.log(0.05, 2.0) * force_nm;
    let rise_ticks = draw.log(0.1, 10.0) * way_s / scene.clock.period_s;
    (trial, rise_ticks.clamp(1.0, 2_000.0) as u32)
}

#[test]
fn arming_into_any_contact_gives_no_energy_out() {
    const RUNS: u64 = 1_500;
    let all = [Law::Static, Law::Episode, Law::Ledger, Law::Auto];
    let free = [Kind::Wall, Kind::Spring, Kind::Detent, Kind::Loop];
    let mut cases: Vec<(Kind, Law)> = all
        .into_iter()
        .flat_map(|law| free.into_iter().map(move |kind| (kind, law)))
        .collect();
    // Whatever a hand's mass: the static law reckons with none.
    cases.extend([(Kind::Push, Law::Static), (Kind::Hand, Law::Static)]);
    for (kind, law) in cases {
        let runs: Vec<(bool, Seen)> = (0..RUNS)
            .into_par_iter()
            .map(|number| {
                let (trial, rise_ticks) = draw(kind, law, number);
                let (verdict, seen) = armed(&trial, rise_ticks);
                (verdict.excess() > ROUNDING, seen)
            })
            .collect();
        let bad = runs.iter().filter(|(bad, _)| *bad).count();
        let cut = runs.iter().filter(|(_, seen)| seen.cut).count();
        let waited = runs.iter().filter(|(_, seen)| seen.waited).count();
        println!("{law:?} {kind:?}: {bad} bad; cut in {cut}, waited in {waited} of {RUNS}");
        assert_eq!(bad, 0, "{law:?} {kind:?}");
        assert!(cut > 50, "{law:?} {kind:?}: cut in {cut} runs only");
    }
}

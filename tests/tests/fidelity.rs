//! What `plant_sim::fidelity` promises: a scene without what it can do without ends, and is at every
//! sample, within the stated bound of the full scene.

use std::sync::atomic::{AtomicU64, Ordering};

use control::config::Law;
use control::plan::Plan;
use control::tick::Controller;
use plant_sim::campaign::{Draw, Kind};
use plant_sim::closed_loop::{Report, Sample, Scene};
use plant_sim::drive::Drive;
use plant_sim::fidelity::{Answer, Phenomena, Phenomenon, simplest};
use plant_sim::hand::Hand;
use plant_sim::motor::Motor;
use rayon::prelude::*;

/// What the controller of a scene does with a counter.
fn control(scene: &Scene) -> impl FnMut(u32, f32) -> control::tick::Tick + use<> {
    let plan = Plan::new(&scene.config).unwrap();
    let mut controller = Controller::new(plan, scene.start_count());
    move |counter, duration_s| controller.tick(counter, duration_s)
}

fn answer(scene: &Scene, tolerance_rad: f64) -> Answer {
    simplest(scene, tolerance_rad, || control(scene), |_| true).unwrap()
}

/// Angles at all samples and at the end.
fn angles(run: impl FnOnce(&mut dyn FnMut(&Sample) -> bool) -> Report) -> (Vec<f64>, Report) {
    let mut angles = Vec::new();
    let report = run(&mut |sample| {
        angles.push(sample.state.position);
        true
    });
    (angles, report)
}

/// How far the simplified run is from the full one, at most: at the samples that both have, and at
/// the ends.
fn error_rad(scene: &Scene, answer: &Answer) -> f64 {
    let (full, full_end) = angles(|observe| scene.run_under(control(scene), observe).unwrap());
    let (simple, simple_end) =
        angles(|observe| answer.simplified.run_under(control(scene), observe));
    let apart = full.iter().zip(&simple).map(|(a, b)| (a - b).abs());
    let ends = (full_end.end.position - simple_end.end.position).abs();
    apart.fold(ends, f64::max)
}

/// A random scene with some phenomena, each from hardly there to strong, and a tolerance.
fn random(number: u64) -> (Scene, f64) {
    let kinds = [Kind::Wall, Kind::Spring, Kind::Release, Kind::Detent];
    let kind = kinds[(number % 4) as usize];
    let laws = [Law::Raw, Law::Static, Law::Episode, Law::Ledger, Law::Auto];
    let law = laws[(number / 4 % 5) as usize];
    let mut draw = Draw::new(5, kind, number);
    let mut scene = draw.trial(kind, law).scene;
    scene.samples = 200;
    scene.seed = number;
    let period_s = scene.clock.period_s;
    let c = scene.device.coulomb_nm;
    // Most are so weak that they may well be left out.
    let strength = |draw: &mut Draw| {
        let weakest = if draw.chance(0.7) { 1e-9 } else { 1e-3 };
        draw.log(weakest, 0.5)
    };
    let mut drive = Drive::default();
    let mut motor = Motor::default();
    let mut hand = Hand::default();
    if draw.chance(0.2) {
        drive.delay_s = strength(&mut draw) * period_s;
    }
    if draw.chance(0.6) {
        drive.amplifier_tau_s = strength(&mut draw) * period_s;
    }
    if draw.chance(0.3) {
        drive.torque_step_nm = strength(&mut draw) * c;
    }
    if draw.chance(0.3) {
        motor.cogging_nm = strength(&mut draw) * c;
        motor.cogging_per_rev = draw.log(3.0, 60.0).round();
    }
    if draw.chance(0.3) {
        motor.stiction_nm = strength(&mut draw) * c;
        motor.stribeck_rad_s = draw.log(0.3, 10.0);
    }
    if draw.chance(0.2) {
        hand.inertia_kg_m2 = strength(&mut draw) * scene.device.inertia_kg_m2;
        hand.damping_nm_s_rad = strength(&mut draw) * scene.device.viscous_nm_s_rad;
        hand.push_nm = strength(&mut draw) * c * if draw.chance(0.5) { 2.0 } else { -2.0 };
        if draw.chance(0.3) {
            hand.stiffness_nm_rad = strength(&mut draw);
        }
    }
    if draw.chance(0.2) {
        hand.shake_nm = strength(&mut draw) * c;
        hand.shake_hz = draw.log(1e-3, 0.5) / period_s;
    }
    if draw.chance(0.1) {
        scene.clock.jitter_s = draw.between(0.0, 0.2) * period_s;
    }
    scene.drive = drive;
    scene.motor = motor;
    scene.hand = hand;
    let tolerance_rad = draw.log(1e-10, 1e-2);
    (scene, tolerance_rad)
}

/// In 100,000 random scenes the bound that is promised holds, and it is within the tolerance.
#[test]
fn the_promised_bound_always_holds() {
    const SCENES: u64 = 100_000;
    let simplified = AtomicU64::new(0);
    let dropped = Phenomenon::ALL.map(|_| AtomicU64::new(0));
    let present = Phenomenon::ALL.map(|_| AtomicU64::new(0));
    (0..SCENES).into_par_iter().for_each(|number| {
        let (scene, tolerance_rad) = random(number);
        let answer = answer(&scene, tolerance_rad);
        let out = answer.simplified.dropped();
        for (i, phenomenon) in Phenomenon::ALL.into_iter().enumerate() {
            present[i].fetch_add(
                u64::from(Phenomena::of(&scene).has(phenomenon)),
                Ordering::Relaxed,
            );
            dropped[i].fetch_add(u64::from(out.has(phenomenon)), Ordering::Relaxed);
        }
        if out.is_empty() {
            assert_eq!(answer.bound_rad, 0.0);
            return;
        }
        simplified.fetch_add(1, Ordering::Relaxed);
        assert!(answer.bound_rad <= tolerance_rad);
        let error = error_rad(&scene, &answer);
        assert!(
            error <= answer.bound_rad,
            "scene {number}: {error:e} rad, promised {:e}, without {:?}",
            answer.bound_rad,
            out.iter().map(Phenomenon::as_str).collect::<Vec<_>>()
        );
    });
    let count = |counts: &[AtomicU64; 7], i: usize| counts[i].load(Ordering::Relaxed);
    println!(
        "{} of {SCENES} scenes simplified",
        simplified.load(Ordering::Relaxed)
    );
    for (i, phenomenon) in Phenomenon::ALL.into_iter().enumerate() {
        let (out, all) = (count(&dropped, i), count(&present, i));
        println!("{phenomenon:14} left out {out} of {all} times");
        // Else this test would say nothing about it.
        assert!(out > 3000, "{phenomenon}: {out} of {all}");
    }
}

/// Near the top of a cogging hill what is left out grows as e^(ωt), ω² = A N/m, and the bound with it.
#[test]
fn cogging_that_is_kept_drives_knobs_apart() {
    let (cogging_nm, cogging_per_rev) = (1e-3, 10.0);
    let mut scene = Draw::new(5, Kind::Wall, 0)
        .trial(Kind::Wall, Law::Raw)
        .scene;
    scene.device.inertia_kg_m2 = 6e-6;
    scene.device.viscous_nm_s_rad = 0.0;
    scene.device.coulomb_nm = 0.0;
    scene.clock.period_s = 1e-3;
    scene.config.timing.period_s = 1e-3;
    // A wall far away and a count that is never left: no torque but the motor's own.
    scene.config.hardware_count_rad = 1.0;
    scene.config.shape = control::shape::Shape::Wall { edge_rad: 100.0 };
    scene.config.stiffness_nm_rad = 1.0;
    scene.motor = Motor {
        cogging_nm,
        cogging_per_rev,
        ..Motor::default()
    };
    scene.hand = Hand {
        shake_nm: 1e-9,
        shake_hz: 1.0,
        ..Hand::default()
    };
    scene.start.position = std::f64::consts::PI / cogging_per_rev;
    scene.start.velocity = 2e-3;
    scene.samples = 200;
    let answer = answer(&scene, 1e-2);
    let out: Vec<_> = answer.simplified.dropped().iter().collect();
    assert_eq!(out, [Phenomenon::HandShake]);
    let error = error_rad(&scene, &answer);
    // Without the hill 1e-9 Nm moves 6e-6 kg m² by no more than 3.4e-6 rad in 0.2 s.
    assert!(error > 1e-5, "{error:e}");
    assert!(
        error <= answer.bound_rad,
        "{error:e}, promised {:e}",
        answer.bound_rad
    );
}

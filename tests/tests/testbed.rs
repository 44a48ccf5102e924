//! The paper's testbed, Sec. V and Fig. 6, in physical units under the controller that a
//! board runs, and the physical units against the dimensionless ones.

use control::config::{Believed, Config, Law, Timing};
use control::criterion::{Criterion, Device, Region, Sampling};
use control::encoder::EncoderConfig;
use control::shape::Shape;
use plant_sim::clock::Clock;
use plant_sim::closed_loop::{Report, Scene};
use plant_sim::display::Display;
use plant_sim::drive::Drive;
use plant_sim::hand::Hand;
use plant_sim::hold::{Hold, State};
use plant_sim::motor::Motor;
use plant_sim::outcome::Class;
use plant_sim::preset::preset;
use proptest::prelude::*;

fn re35() -> Device<f64> {
    preset("re35").unwrap().device
}

fn scene(counts_per_rev: f64, decimation: u32, stiffness: f64, velocity: f64) -> Scene {
    Scene {
        device: re35(),
        motor: Motor::default(),
        drive: Drive::default(),
        clock: Clock {
            period_s: 1e-3,
            jitter_s: 0.0,
            missed_ticks: 0.0,
        },
        hand: Hand::default(),
        config: Config {
            believed: Believed::exactly(&re35()),
            timing: Timing::ideal(1e-3),
            torque_step_nm: 0.0,
            hardware_count_rad: std::f64::consts::TAU / counts_per_rev,
            encoder: EncoderConfig::new(16, decimation).unwrap(),
            shape: Shape::Spring { centre_rad: 0.0 },
            stiffness_nm_rad: stiffness,
            damping_nm_s_rad: 0.0,
            law: Law::Raw,
            torque_max_nm: 1e3,
        },
        start: State {
            position: 0.0,
            velocity,
        },
        samples: 40_000,
        seed: 1,
    }
}

/// The same, sampled every `period_s`.
fn set_period(scene: &mut Scene, period_s: f64) {
    scene.clock.period_s = period_s;
    scene.config.timing = Timing::ideal(period_s);
}

fn run(scene: &Scene) -> Report {
    scene.run(|_| true).unwrap()
}

#[test]
fn figure_6_comes_out_as_the_paper_shows_it() {
    // counts/rev, K, start, β, σ, region, outcome.
    let rows = [
        (
            8192.0,
            0.015,
            30.0,
            0.60,
            174.0,
            Region::GloballyPassive,
            Class::Rest,
        ),
        (
            20.0,
            0.015,
            12.0,
            0.60,
            0.42,
            Region::LimitCycle,
            Class::LimitCycle,
        ),
        (
            8192.0,
            1.0,
            3.0,
            0.009,
            2.6,
            Region::LocallyPassive,
            Class::Rest,
        ),
        (
            8192.0,
            1.0,
            7.0,
            0.009,
            2.6,
            Region::LocallyPassive,
            Class::Unstable,
        ),
    ];
    for (counts, stiffness, velocity, beta, sigma, region, class) in rows {
        let scene = scene(counts, 1, stiffness, velocity);
        let sampling = Sampling {
            period_s: 1e-3,
            count_rad: scene.config.count_rad(),
        };
        let point = Criterion::new(re35(), sampling)
            .unwrap()
            .dimensionless(stiffness);
        assert!(
            (point.beta / beta - 1.0).abs() < 0.01 && (point.sigma / sigma - 1.0).abs() < 0.012
        );
        assert_eq!(point.region(), region);
        let report = run(&scene);
        assert_eq!(
            report.class, class,
            "K {stiffness}, {counts} counts, {velocity} rad/s: {report:?}"
        );
        // Passive exactly where it does not grow.
        assert_eq!(report.energy_excess_j > 0.0, class == Class::Unstable);
        if class == Class::LimitCycle {
            assert!(
                report.end.position.abs() < scene.config.count_rad(),
                "about one count"
            );
        }
    }
}

/// The criterion is sufficient; the true edge lies beyond it, near the describing function.
#[test]
fn the_edge_of_stability_lies_between_the_criterion_and_a_little_beyond_it() {
    let class_from = |stiffness, velocity, sixteenths: u32| {
        let mut scene = scene(8192.0, 1, stiffness, velocity);
        scene.start.position = f64::from(sixteenths) / 16.0 * scene.config.count_rad();
        run(&scene).class
    };
    // K = 1: (11) says 3.29 rad/s; the describing function 5.15.
    // 10 rad/s: (11) says 0.388; the describing function 0.527, the runs 0.531 to 0.54.
    // Right at the edge a run may be caught by a large cycle that neither grows nor decays.
    for sixteenths in 0..16 {
        assert_eq!(class_from(1.0, 5.0, sixteenths), Class::Rest);
        assert_ne!(class_from(1.0, 5.5, sixteenths), Class::Rest);
        assert_eq!(class_from(1.0, 6.0, sixteenths), Class::Unstable);
        assert_eq!(class_from(0.525, 10.0, sixteenths), Class::Rest);
        assert_ne!(class_from(0.545, 10.0, sixteenths), Class::Rest);
        assert_eq!(class_from(0.56, 10.0, sixteenths), Class::Unstable);
    }
}

#[test]
fn the_static_law_tames_every_row() {
    for (counts, velocity) in [(8192.0, 7.0), (8192.0, 100.0), (20.0, 12.0)] {
        let mut scene = scene(counts, 1, 1.0, velocity);
        scene.config.law = Law::Static;
        let report = run(&scene);
        assert_eq!(
            report.class,
            Class::Rest,
            "{counts} counts, {velocity} rad/s: {report:?}"
        );
        assert!(report.energy_excess_j <= 0.0);
        let applied = report.max_stiffness_nm_rad;
        assert!(applied <= 0.018 * (1.0 + 1e-6) && applied == report.min_stiffness_nm_rad);
    }
}

#[test]
fn decimation_is_a_coarser_encoder() {
    // 8192 counts by 32 are 256 counts: the same torques, bit for bit, and the same run.
    let fine = run(&scene(8192.0, 32, 0.05, 3.0));
    let coarse = run(&scene(256.0, 1, 0.05, 3.0));
    assert_eq!(fine, coarse);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// One core serves both units: (3) to (7) carry one run into the other.
    #[test]
    fn physical_and_dimensionless_runs_are_the_same(
        stiffness in (-4.0..2.0f64).prop_map(f64::exp), counts in 20.0..20_000.0f64,
        period_s in (-9.0..-4.0f64).prop_map(f64::exp), position in -0.5..0.5f64, velocity in -20.0..20.0f64,
    ) {
        let count_rad = std::f64::consts::TAU / counts;
        let criterion = Criterion::new(re35(), Sampling { period_s, count_rad }).unwrap();
        let display = Display::new(criterion.dimensionless(stiffness)).unwrap();
        let hold = Hold::new(&re35(), period_s).unwrap();
        let mut physical = State { position, velocity };
        let mut counted = State { position: position / count_rad, velocity: velocity * period_s / count_rad };
        for _ in 0..50 {
            // The same force in both, from one of them: an edge may round to either side.
            let force = -(counted.position.floor() + 0.5);
            let largest = counted.position.abs().max(counted.velocity.abs()).max(1.0);
            physical = hold.step(physical, force * stiffness * count_rad).end;
            counted = display.hold().step(counted, force).end;
            let error = (physical.position / count_rad - counted.position).abs()
                .max((physical.velocity * period_s / count_rad - counted.velocity).abs());
            prop_assert!(error <= 1e-11 * largest.max(force.abs() / display.parameters().mu), "{error}");
        }
    }

    /// The law that is passive at every speed never lets kinetic energy exceed the start's.
    #[test]
    fn the_static_law_adds_no_energy_from_any_start(
        counts in 20.0..20_000.0f64, period_s in (-9.0..-4.0f64).prop_map(f64::exp),
        position in -0.5..0.5f64, velocity in -50.0..50.0f64, zero_counts in -3i32..3, wall in any::<bool>(),
    ) {
        let mut scene = scene(counts, 1, 1e3, velocity);
        scene.config.law = Law::Static;
        set_period(&mut scene, period_s);
        let zero_rad = f64::from(zero_counts) * scene.config.count_rad();
        scene.config.shape = if wall {
            Shape::Wall { edge_rad: zero_rad }
        } else {
            Shape::Spring { centre_rad: zero_rad }
        };
        scene.start.position = position;
        scene.samples = 3_000;
        let report = run(&scene);
        // The energy that is there, with the stiffness that is applied, and the storage of ⅛ K Δ².
        let count = scene.config.count_rad();
        let storage = report.max_stiffness_nm_rad * count * count / 8.0;
        prop_assert!(report.ledger.given_out <= storage * (1.0 + 1e-6) + 1e-9 * report.energy_start_j,
            "{} J given out, {storage} J allowed", report.ledger.given_out);
        prop_assert!(report.class != Class::Unstable);
    }

    /// A wall on a count edge, hit out of free motion: the law that follows the speed of a contact
    /// applies more than the static one and still gives nothing out beyond the storage.
    #[test]
    fn the_episode_law_adds_no_energy_to_a_hit(
        counts in 200.0..20_000.0f64, period_s in (-9.5..-5.5f64).prop_map(f64::exp),
        speed in (-1.5..3.5f64).prop_map(f64::exp), phase in 0.0..1.0f64,
    ) {
        let mut scene = scene(counts, 1, 1e3, speed);
        scene.config.law = Law::Episode;
        scene.config.shape = Shape::Wall { edge_rad: 0.0 };
        set_period(&mut scene, period_s);
        // So far away that it arrives after some ticks, with speed left.
        let count = scene.config.count_rad();
        scene.start.position = -(phase * count + 5.0 * speed * period_s + 3.0 * count);
        scene.samples = 4_000;
        let report = run(&scene);
        let storage = report.max_stiffness_nm_rad * count * count / 8.0;
        prop_assert!(report.energy_excess_j <= storage * (1.0 + 1e-6),
            "{} J beyond the start's, {storage} J allowed: {report:?}", report.energy_excess_j);
        prop_assert!(report.class != Class::Unstable && report.class != Class::LimitCycle, "{report:?}");
    }
}

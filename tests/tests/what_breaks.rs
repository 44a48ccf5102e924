//! Each effect that a control must reckon with: the naive form, which leaves it out, fails; the
//! mended form, from the same start, does not.

use std::f64::consts::TAU;

use acceptance::systematic::{self, suite};
use control::config::{Config, Interval, Law};
use control::criterion::{Criterion, Device, Region, Sampling};
use control::margin::effective_criterion;
use control::plan::Plan;
use control::shape::{Profile, Shape};
use control::tick::{Controller, Reason, Tick};
use control::tuning::Tuning;
use plant_sim::hold::State;
use plant_sim::outcome::Class;
use plant_sim::preset::preset;
use plant_sim::trial::{EXTENSION, Fault, Sampled, Trial, Verdict};

const SPRING: Shape = Shape::Spring { centre_rad: 0.0 };

/// The laws that promise passivity.
const LAWS: [Law; 4] = [Law::Static, Law::Episode, Law::Ledger, Law::Auto];

/// The paper's motor.
fn re35(counts_per_rev: f64, period_s: f64) -> Sampled {
    Sampled {
        device: preset("re35").unwrap().device,
        count_rad: TAU / counts_per_rev,
        period_s,
    }
}

fn criterion(sampled: &Sampled) -> Criterion<f64> {
    let sampling = Sampling {
        period_s: sampled.period_s,
        count_rad: sampled.count_rad,
    };
    Criterion::new(sampled.device, sampling).unwrap()
}

/// A run whose controller has seen no past.
fn trial(sampled: &Sampled, law: Law, shape: Shape, stiffness: f64, start: (f64, f64)) -> Trial {
    let (position, velocity) = start;
    let start = State { position, velocity };
    Trial {
        extension: EXTENSION,
        hasty: false,
        scene: sampled.scene(sampled.config(law, shape, stiffness), start, 2_000),
        history: 0,
    }
}

fn run(trial: &Trial) -> Verdict {
    trial.run().unwrap()
}

/// The same run under every law that promises passivity: none breaks it.
fn mended(trial: &Trial) {
    for law in LAWS {
        let mut trial = *trial;
        trial.scene.config.law = law;
        let verdict = run(&trial);
        assert_eq!(verdict.fault, None, "{law:?}: {verdict:?}");
    }
}

/// A spring whose stiffness is `stiffness(counts moved, deflection)` in every tick.
fn naive(trial: &Trial, mut stiffness: impl FnMut(i32, f64) -> f64) -> Verdict {
    let config = &trial.scene.config;
    let profile = Profile::new(&config.shape, config.count_rad()).unwrap();
    let mut before = (trial.scene.start.position
        - trial.scene.start.velocity * config.timing.period_s)
        .div_euclid(config.count_rad()) as i32;
    trial
        .run_under(
            |counter, _| {
                let count = counter as i32;
                let moved = count - before;
                before = count;
                let reading = profile.read(count);
                let stiffness = stiffness(moved, f64::from(reading.deflection_rad)) as f32;
                torque(count, moved, stiffness * reading.pull_rad, stiffness)
            },
            0.0,
        )
        .unwrap()
}

fn torque(count: i32, moved: i32, torque_nm: f32, stiffness_nm_rad: f32) -> Tick {
    Tick {
        count,
        moved,
        torque_nm,
        stiffness_nm_rad,
        margin_nm: 0.0,
        account_j: 0.0,
        law: Law::Raw,
        reason: Reason::None,
    }
}

/// The speeds and places of the systematic runs into a spring.
fn starts(sampled: &Sampled) -> impl Iterator<Item = (f64, f64)> {
    let count = sampled.count_rad;
    [0.1, 0.3, 1.0, 3.0, 10.0, 30.0]
        .into_iter()
        .flat_map(move |velocity| {
            (0..16).map(move |place| (-(f64::from(place) + 0.5) / 16.0 * count, velocity))
        })
}

/// (10) asks for the speed at the start, and a spring that is let go under load has none.
#[test]
fn a_start_under_load_counts_with_the_speed_it_turns_into() {
    let device = re35(8192.0, 1e-3);
    let release = trial(&device, Law::Raw, SPRING, 1.0, (0.02, 0.0));
    assert!(criterion(&device).dimensionless(1.0).holds_at(0.0));
    assert_eq!(run(&release).fault, Some(Fault::Growth));
    // √(Kx²/m) = 8 rad/s, and (11) holds up to 3.3: the margin says so in the first tick.
    let reached = release.scene.reachable_speed_rad_s(1.0);
    assert!(criterion(&device).power_margin_nm(1.0, reached) < 0.0);
    let mut controller = release
        .scene
        .controller(Plan::new(&release.scene.config).unwrap());
    let first = controller.tick(release.scene.start_count() as u32, 1e-3);
    assert!(first.margin_nm < 0.0, "{first:?}");
    mended(&release);
}

/// (11) admits region (c) at speed; what is slow there never rests.
#[test]
fn region_c_is_refused_at_every_speed() {
    let device = re35(20.0, 1e-3);
    let coarse = trial(&device, Law::Raw, SPRING, 0.015, (0.0, 300.0));
    let point = criterion(&device).dimensionless(0.015);
    assert_eq!(point.region(), Region::LimitCycle);
    assert!(criterion(&device).power_margin_nm(0.015, 300.0) > 0.0);
    assert_eq!(run(&coarse).fault, Some(Fault::LimitCycle));
    mended(&coarse);
}

/// Rounding to the nearest step of the DAC lifts ±KΔ/2 above friction.
#[test]
fn torques_are_cut_to_steps_not_rounded() {
    let device = re35(8192.0, 1e-3);
    let mut stepped = trial(&device, Law::Raw, SPRING, 4.0, (2e-4, 0.3));
    let step = 2.2e-3;
    stepped.scene.drive.torque_step_nm = step;
    assert_eq!(run(&stepped).fault, Some(Fault::LimitCycle));
    // Nothing else is wrong with it.
    let mut smooth = stepped;
    smooth.scene.drive.torque_step_nm = 0.0;
    assert_eq!(run(&smooth).fault, None);
    // The same spring, cut towards zero.
    let profile = Profile::new(&SPRING, device.count_rad).unwrap();
    let cut = stepped.run_under(
        |counter, _| {
            let count = counter as i32;
            let wanted = 4.0 * profile.read(count).pull_rad;
            let steps = (wanted / step as f32) as i32;
            torque(count, 0, steps as f32 * step as f32, 4.0)
        },
        0.0,
    );
    assert_eq!(cut.unwrap().fault, None);
    stepped.scene.config.torque_step_nm = step;
    mended(&stepped);
}

/// A wall just past the middle of a count begins with a step of nearly KΔ, not KΔ/2.
#[test]
fn a_wall_off_a_count_edge_counts_with_its_first_step() {
    let device = re35(1024.0, 2e-4);
    let wall = |counts: f64| Shape::Wall {
        edge_rad: counts * device.count_rad,
    };
    let start = (device.count_rad * (1.0 - 1e-9), 0.05);
    // 0.97 of 2c/Δ.
    let stiffness = 0.97 * criterion(&device).coulomb_limit();
    let off = trial(&device, Law::Raw, wall(0.501), stiffness, start);
    let verdict = run(&off);
    let kinetic_j = 0.5 * device.device.inertia_kg_m2 * start.1 * start.1;
    assert_eq!(verdict.fault, Some(Fault::GivenOut), "{verdict:?}");
    assert!(verdict.report.given_out_j > 0.2 * kinetic_j, "{verdict:?}");
    mended(&off);
    // Or it is moved to an edge.
    let on = trial(&device, Law::Raw, wall(1.0), stiffness, start);
    assert_eq!(run(&on).fault, None);
}

/// A detent is as stiff as its minimum is, everywhere: off it a torque from the local slope is larger
/// than sampling may make.
#[test]
fn a_detent_counts_with_its_steepest_slope() {
    let device = re35(8192.0, 1e-3);
    let period_rad = TAU / 20.0;
    let detent = Shape::Detent {
        centre_rad: 0.0,
        period_rad,
    };
    let most = criterion(&device).largest_stiffness();
    let mut worst = 0.0_f64;
    for start in starts(&device) {
        let click = trial(&device, Law::Raw, detent, 10.0, start);
        let verdict = naive(&click, |_, deflection| {
            let slope = (TAU * deflection / period_rad).cos().abs();
            (most / slope).min(10.0)
        });
        let kinetic_j = 0.5 * device.device.inertia_kg_m2 * start.1 * start.1;
        worst = worst.max(verdict.excess_j / kinetic_j);
        mended(&click);
    }
    assert!(worst > 20.0, "{worst} times its energy");
}

/// Twice the friction that there is.
#[test]
fn friction_counts_with_the_least_it_may_be() {
    let device = re35(8192.0, 1e-3);
    let twice = Device {
        viscous_nm_s_rad: 2.0 * device.device.viscous_nm_s_rad,
        coulomb_nm: 2.0 * device.device.coulomb_nm,
        ..device.device
    };
    let believed = Sampled {
        device: twice,
        ..device
    };
    let start = (0.0, 10.0);
    let allowed = |sampled: &Sampled| criterion(sampled).largest_stiffness_at(10.0);
    let fast = trial(&device, Law::Raw, SPRING, allowed(&believed), start);
    assert_eq!(run(&fast).fault, Some(Fault::Growth));
    let fast = trial(&device, Law::Raw, SPRING, allowed(&device), start);
    assert_eq!(run(&fast).fault, None);
    // An interval with an honest low end, however wrong its high end is.
    let mut told = trial(&device, Law::Raw, SPRING, 1e3, start);
    let between = |low, high| Interval { low, high };
    told.scene.config.believed.viscous_nm_s_rad =
        between(device.device.viscous_nm_s_rad, twice.viscous_nm_s_rad);
    told.scene.config.believed.coulomb_nm = between(device.device.coulomb_nm, twice.coulomb_nm);
    mended(&told);
}

/// Raw with what the margin allows at 10 rad/s, reckoned with what was told of the loop.
fn at_the_margin(trial: &Trial, told: &Config) -> Verdict {
    let profile = Profile::new(&told.shape, told.count_rad()).unwrap();
    let criterion = effective_criterion(told, &profile, 0.0).unwrap();
    let mut trial = *trial;
    trial.scene.config.stiffness_nm_rad = f64::from(criterion.largest_stiffness_at(10.0));
    run(&trial)
}

#[test]
fn delay_counts_twice_in_the_period() {
    let mut late = trial(&re35(8192.0, 1e-3), Law::Raw, SPRING, 1e3, (0.0, 10.0));
    late.scene.drive.delay_s = 0.5e-3;
    let mut told = late.scene.config;
    assert_eq!(at_the_margin(&late, &told).fault, Some(Fault::Growth));
    told.timing.delay_s = 0.5e-3;
    assert_eq!(at_the_margin(&late, &told).fault, None);
    late.scene.config = told;
    mended(&late);
}

#[test]
fn the_amplifiers_lag_counts_twice_in_the_period() {
    let mut late = trial(&re35(8192.0, 1e-3), Law::Raw, SPRING, 1e3, (0.0, 10.0));
    late.scene.drive.amplifier_tau_s = 0.5e-3;
    let mut told = late.scene.config;
    assert_eq!(at_the_margin(&late, &told).fault, Some(Fault::Growth));
    told.timing.amplifier_tau_s = 0.5e-3;
    assert_eq!(at_the_margin(&late, &told).fault, None);
    late.scene.config = told;
    mended(&late);
}

/// A spring that is passive at T is not where half of the ticks that follow a tick are missed.
#[test]
fn a_missed_tick_counts_as_the_longest_interval() {
    let mut rough = trial(&re35(8192.0, 1e-3), Law::Raw, SPRING, 1e3, (0.0, 10.0));
    rough.scene.clock.missed_ticks = 0.5;
    let mut told = rough.scene.config;
    assert_eq!(at_the_margin(&rough, &told).fault, Some(Fault::Growth));
    told.timing.may_miss = true;
    assert_eq!(at_the_margin(&rough, &told).fault, None);
    rough.scene.config = told;
    mended(&rough);
}

/// The ledger with the nominal period where one tick in fifty is missed, and with the measured one.
#[test]
fn the_ledger_reckons_with_the_measured_interval() {
    let missing = |may_miss: bool, measured: bool| {
        suite(Law::Ledger, |mut trial| {
            trial.scene.clock.missed_ticks = 0.02;
            trial.scene.config.timing.may_miss = may_miss;
            let mut controller =
                systematic::controller(&trial, &trial.scene.config, Tuning::DEFAULT);
            let period_s = trial.scene.clock.period_s as f32;
            let verdict = trial.run_under(
                |counter, duration_s| {
                    let told = if measured { duration_s } else { period_s };
                    controller.tick(counter, told)
                },
                0.0,
            );
            verdict.unwrap()
        })
    };
    let fixed = missing(false, false);
    assert!(fixed.of(Fault::GivenOut) > 10, "{fixed:?}");
    let mended = missing(true, true);
    assert_eq!(mended.total(), 0, "{mended:?}");
}

/// Following the speed both ways, a clamp raises the stiffness under load whenever the knob slows down.
#[test]
fn within_a_contact_stiffness_only_falls() {
    let device = re35(8192.0, 1e-3);
    let limit = criterion(&device);
    let count_speed = device.count_rad / device.period_s;
    let mut grown = 0;
    for start in starts(&device) {
        let hit = trial(&device, Law::Raw, SPRING, 0.5, start);
        let verdict = naive(&hit, |moved, _| {
            let speed = f64::from(moved.abs()) * count_speed;
            limit.largest_stiffness_at(speed).min(0.5)
        });
        grown += usize::from(verdict.fault == Some(Fault::Growth));
        mended(&hit);
    }
    assert!(grown >= 16, "{grown} of 96");
}

/// Each raise by ΔK at a deflection q puts ½ΔKq² in, passive as both stiffnesses are.
#[test]
fn stiffness_is_raised_at_zero_force_only() {
    let device = re35(8192.0, 1e-3);
    let start = (2.0, 0.0);
    let spring = |law| trial(&device, law, SPRING, 0.017, start);
    let stored_j = 0.5 * 0.017 * start.0 * start.0;
    // Stiff on the way in, soft on the way out.
    let wanted = |moved: i32, count: i32| {
        if moved.signum() == count.signum() {
            0.001
        } else {
            0.017
        }
    };
    let raised = spring(Law::Raw);
    let zero = device.count_rad;
    let verdict = naive(&raised, |moved, deflection| {
        wanted(moved, (deflection / zero) as i32)
    });
    assert!(verdict.report.given_out_j > 2.0 * stored_j, "{verdict:?}");
    // The same wishes to a controller, which keeps them until the knob comes by zero.
    for law in LAWS {
        let adopted = spring(law);
        let plan = |stiffness| Plan::new(&device.config(law, SPRING, stiffness)).unwrap();
        let mut controller = Controller::at_rest(plan(0.017), adopted.scene.start_count());
        let mut before = adopted.scene.start_count();
        let verdict = adopted.run_under(
            |counter, duration_s| {
                let count = counter as i32;
                controller.adopt(plan(wanted(count - before, count)));
                before = count;
                controller.tick(counter, duration_s)
            },
            stored_j,
        );
        let verdict = verdict.unwrap();
        assert_eq!(verdict.fault, None, "{law:?}: {verdict:?}");
        assert_eq!(verdict.report.class, Class::Rest);
    }
}

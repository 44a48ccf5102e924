//! `plant_sim::identify` against motors that are known: the truth lies inside, the intervals are narrow, and
//! what is no such motor is refused for the right reason.

use std::f64::consts::TAU;

use control::criterion::Device;
use plant_sim::drive::Drive;
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::identify::experiment::{Experiment, Limits};
use plant_sim::identify::{Identified, Recording, Refusal, identify};
use plant_sim::knob::Knob;
use plant_sim::motor::Motor;
use plant_sim::preset::PRESETS;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

const LIMITS: Limits = Limits {
    speed_rad_s: 50.0,
    angle_rad: 10.0,
    torque_nm: 0.2,
};

/// A motor and how it is seen; what acts beside, if anything does.
#[derive(Debug, Clone, Copy)]
struct Bench {
    device: Device<f64>,
    motor: Motor,
    hand: Hand,
    drive: Drive,
    count_rad: f64,
    period_s: f64,
    /// Where in its count it starts.
    phase: f64,
}

impl Bench {
    fn new(device: Device<f64>, counts_per_rev: f64, period_s: f64) -> Self {
        Self {
            device,
            motor: Motor::default(),
            hand: Hand::default(),
            drive: Drive::default(),
            count_rad: TAU / counts_per_rev,
            period_s,
            phase: 0.5,
        }
    }

    /// The experiment on it, with what becomes of torques (Nm) and angles (rad) on their way; and the
    /// furthest angle and the highest speed.
    fn run(
        &self,
        limits: Limits,
        torque: impl FnMut(f64) -> f64,
        count: impl FnMut(f64) -> i32,
    ) -> (Recording, f64, f64) {
        self.try_run(limits, torque, count).unwrap()
    }

    fn try_run(
        &self,
        limits: Limits,
        mut torque: impl FnMut(f64) -> f64,
        mut count: impl FnMut(f64) -> i32,
    ) -> Result<(Recording, f64, f64), Refusal> {
        let start = State {
            position: self.phase * self.count_rad,
            velocity: 0.0,
        };
        let Self {
            device,
            motor,
            hand,
            drive,
            period_s,
            ..
        } = self;
        let mut knob = Knob::new(device, motor, hand, drive, *period_s, start).unwrap();
        let (mut furthest, mut fastest) = (0.0_f64, 0.0_f64);
        let first = count(start.position);
        let recording = Experiment::record(limits, *period_s, self.count_rad, first, |command| {
            let end = knob.hold(torque(command), *period_s).end;
            furthest = furthest.max((end.position - start.position).abs());
            fastest = fastest.max(end.velocity.abs());
            count(end.position)
        })?;
        Ok((recording, furthest, fastest))
    }

    fn record(&self) -> Recording {
        let count_rad = self.count_rad;
        self.run(LIMITS, |it| it, |angle| (angle / count_rad).floor() as i32)
            .0
    }
}

/// Motors log-uniform around the presets.
fn random(number: u64) -> Bench {
    let mut random = Pcg64::seed_from_u64(number);
    let mut uniform = || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    let mut between = |low: f64, high: f64| low * (high / low).powf(uniform());
    let device = Device {
        inertia_kg_m2: between(2e-6, 5e-5),
        viscous_nm_s_rad: between(1e-6, 1e-4),
        coulomb_nm: between(3e-4, 1.5e-2),
    };
    let counts_per_rev = between(4096.0, 65_536.0).round();
    let mut bench = Bench::new(device, counts_per_rev, between(2.5e-4, 1e-3));
    bench.phase = uniform();
    bench
}

fn inside(found: &Identified, device: &Device<f64>) -> [bool; 3] {
    [
        found.inertia_kg_m2.holds(device.inertia_kg_m2),
        found.viscous_nm_s_rad.holds(device.viscous_nm_s_rad),
        found.coulomb_nm.holds(device.coulomb_nm),
    ]
}

fn widths(found: &Identified) -> [f64; 3] {
    [
        found.inertia_kg_m2.half_width(),
        found.viscous_nm_s_rad.half_width(),
        found.coulomb_nm.half_width(),
    ]
}

/// The presets, and random motors after them.
fn bench(number: u64) -> Bench {
    match PRESETS.get(number as usize) {
        Some(known) => Bench::new(known.device, known.counts_per_rev, known.period_s),
        None => random(number),
    }
}

#[test]
fn the_truth_of_200_random_motors_lies_inside_and_no_limit_is_passed() {
    let all: Vec<_> = (1000..1200_u64)
        .into_par_iter()
        .map(|number| {
            let bench = random(number);
            let count = |angle: f64| (angle / bench.count_rad).floor() as i32;
            let (recording, furthest, fastest) = bench.run(LIMITS, |it| it, count);
            assert!(furthest < LIMITS.angle_rad, "{number}: {furthest} rad");
            assert!(fastest < LIMITS.speed_rad_s, "{number}: {fastest} rad/s");
            let found = identify(&recording).unwrap_or_else(|error| panic!("{number}: {error}"));
            (
                inside(&found, &bench.device),
                widths(&found),
                found.misfit_counts,
            )
        })
        .collect();
    for (which, name) in ["m", "b", "c"].iter().enumerate() {
        let share = all.iter().filter(|it| it.0[which]).count();
        let mut widths: Vec<f64> = all.iter().map(|it| it.1[which]).collect();
        widths.sort_by(f64::total_cmp);
        println!(
            "{name}: inside {share} of 200, ± {:.1e} median, {:.1e} worst",
            widths[100], widths[199]
        );
        assert!(share >= 190, "{name}: {share} of 200 inside");
        assert!(
            *name == "b" || widths[199] <= 0.1,
            "{name}: ± {}",
            widths[199]
        );
    }
    // Nothing but counts is in the way: all of them are explained.
    assert!(all.iter().all(|it| it.2 < 1e-6));
}

#[test]
fn the_presets_are_found_within_a_tenth() {
    for (number, known) in PRESETS.iter().enumerate() {
        let found = identify(&bench(number as u64).record()).unwrap();
        assert_eq!(inside(&found, &known.device), [true; 3], "{}", known.name);
        let [m, b, c] = widths(&found);
        println!("{}: m ± {m:.1e}, b ± {b:.1e}, c ± {c:.1e}", known.name);
        assert!(m <= 0.1 && c <= 0.1, "{}: {m} {c}", known.name);
        let believed = found.believed();
        assert_eq!(believed.inertia_kg_m2.low, found.inertia_kg_m2.low);
        assert_eq!(believed.viscous_nm_s_rad.high, found.viscous_nm_s_rad.high);
        assert_eq!(believed.coulomb_nm.low, found.coulomb_nm.low);
    }
}

/// What no real motor is without. The misfit widens the intervals so that the truth stays inside, where
/// intervals that trust the model would lose it.
#[test]
fn a_little_of_what_the_model_lacks_widens_the_intervals_and_keeps_the_truth() {
    type Change = fn(&mut Bench);
    let cases: [(&str, Change); 4] = [
        ("cogging of 1 % of friction", |bench| {
            bench.motor.cogging_nm = 0.01 * bench.device.coulomb_nm;
            bench.motor.cogging_per_rev = 42.0;
        }),
        ("a delay of a tenth of a period", |bench| {
            bench.drive.delay_s = 0.1 * bench.period_s;
        }),
        ("a converter with steps of 1 % of friction", |bench| {
            bench.drive.torque_step_nm = 0.01 * bench.device.coulomb_nm;
        }),
        ("stiction of 1 % of friction", |bench| {
            bench.motor.stiction_nm = 0.01 * bench.device.coulomb_nm;
            bench.motor.stribeck_rad_s = 0.5;
        }),
    ];
    for (what, change) in cases {
        let all: Vec<_> = (2000..2020_u64)
            .into_par_iter()
            .filter_map(|number| {
                let mut bench = random(number);
                change(&mut bench);
                // A refusal is an honest answer too, where it is rare.
                let found = identify(&bench.record()).ok()?;
                Some(inside(&found, &bench.device))
            })
            .collect();
        let inside = [0, 1, 2].map(|which| all.iter().filter(|it| it[which]).count());
        println!(
            "{what}: {} of 20 have an answer, inside {inside:?}",
            all.len()
        );
        assert!(all.len() >= 18, "{what}: only {} have an answer", all.len());
        let most_outside = all.len() / 20;
        assert!(
            inside.iter().all(|it| it + most_outside >= all.len()),
            "{what}: {inside:?}"
        );
    }
}

/// Presets and some random motors under a sabotage: all are refused, nearly all for the right reason.
fn sabotaged(what: &str, right: fn(&Refusal) -> bool, record: impl Fn(Bench) -> Recording + Sync) {
    let refusals: Vec<Refusal> = (0..8_u64)
        .into_par_iter()
        .map(|number| match identify(&record(bench(number))) {
            Ok(found) => panic!("{what}, {number}: {found:?}"),
            Err(refusal) => refusal,
        })
        .collect();
    let good = refusals.iter().filter(|refusal| right(refusal)).count();
    println!("{what}: {good} of 8: {}", refusals[0]);
    assert!(good >= 7, "{what}: {refusals:#?}");
}

fn is_unexplained(refusal: &Refusal) -> bool {
    matches!(refusal, Refusal::Unexplained { .. })
}

#[test]
fn a_hand_on_the_knob_is_refused() {
    sabotaged(
        "a hand that pushes",
        |it| matches!(it, Refusal::Pushed { .. }),
        |mut bench| {
            bench.hand.push_nm = 0.2 * bench.device.coulomb_nm;
            bench.record()
        },
    );
    sabotaged("a hand that shakes", is_unexplained, |mut bench| {
        (bench.hand.shake_nm, bench.hand.shake_hz) = (0.5 * bench.device.coulomb_nm, 5.0);
        bench.record()
    });
    let held = |it: &Refusal| {
        is_unexplained(it)
            || matches!(
                it,
                Refusal::NoCoastDown { .. } | Refusal::EndsInMotion { .. }
            )
    };
    sabotaged("a hand that holds it like a spring", held, |mut bench| {
        bench.hand.stiffness_nm_rad = 2.0 * bench.device.coulomb_nm;
        bench.record()
    });
}

#[test]
fn a_motor_that_cogs_is_refused() {
    sabotaged(
        "cogging of half of friction",
        is_unexplained,
        |mut bench| {
            bench.motor.cogging_nm = 0.5 * bench.device.coulomb_nm;
            bench.motor.cogging_per_rev = 42.0;
            bench.record()
        },
    );
}

#[test]
fn an_encoder_that_slips_is_refused() {
    sabotaged(
        "8 counts lost once",
        |it| matches!(it, Refusal::Slips { .. }),
        |bench| {
            let mut furthest = 0.0_f64;
            bench
                .run(
                    LIMITS,
                    |it| it,
                    |angle| {
                        furthest = furthest.max(angle / bench.count_rad);
                        let lost = if furthest > 60.0 { 8 } else { 0 };
                        (angle / bench.count_rad).floor() as i32 - lost
                    },
                )
                .0
        },
    );
}

#[test]
fn a_torque_that_saturates_is_refused() {
    let right = |it: &Refusal| matches!(it, Refusal::Saturates { limit_nm, commanded_nm } if limit_nm < commanded_nm);
    sabotaged("not more than 2.5 times friction", right, |bench| {
        let most = 2.5 * bench.device.coulomb_nm;
        let count = |angle: f64| (angle / bench.count_rad).floor() as i32;
        bench.run(LIMITS, |it| it.clamp(-most, most), count).0
    });
}

#[test]
fn a_reversed_sign_and_a_stuck_knob_are_refused() {
    for number in 0..8 {
        let bench = bench(number);
        let count = |angle: f64| (angle / bench.count_rad).floor() as i32;
        let mut most_nm = 0.0_f64;
        let reverse = |torque_nm: f64| {
            most_nm = most_nm.max(torque_nm.abs());
            -torque_nm
        };
        let refusal = bench.try_run(LIMITS, reverse, count).unwrap_err();
        let right = matches!(refusal, Refusal::Reversed { along: 0, .. });
        assert!(right, "{number}: {refusal}");
        // It is found as soon as it moves.
        let coulomb_nm = bench.device.coulomb_nm;
        assert!(most_nm < 3.0 * coulomb_nm, "{number}: {most_nm} Nm");
    }
    sabotaged(
        "an unplugged motor",
        |it| matches!(it, Refusal::NeverMoved { counts: 0, .. }),
        |bench| {
            bench
                .run(
                    LIMITS,
                    |_| 0.0,
                    |angle| (angle / bench.count_rad).floor() as i32,
                )
                .0
        },
    );
    sabotaged(
        "an unplugged encoder",
        |it| matches!(it, Refusal::NeverMoved { .. }),
        |bench| bench.run(LIMITS, |it| it, |_| 7).0,
    );
}

/// A recording of the first preset, changed.
fn changed(change: impl FnOnce(&mut Recording)) -> Refusal {
    let mut recording = bench(0).record();
    change(&mut recording);
    identify(&recording).unwrap_err()
}

#[test]
fn a_recording_that_lacks_something_is_refused_with_what_it_lacks() {
    let whole = bench(0).record();
    let is = |refusal: Refusal, parts: &[&str]| {
        let said = refusal.to_string();
        for part in parts {
            assert!(said.contains(part), "`{part}` is missing in: {said}");
        }
    };
    // Cut anywhere, it still is whole only if it was cut at rest.
    for share in [1, 3, 5, 8] {
        let cut = changed(|recording| {
            let from = recording.samples.len() * share / 10;
            let moving = |place: &usize| recording.samples[*place].torque_nm != 0.0;
            let cut = (from..recording.samples.len()).find(moving).unwrap();
            recording.samples.truncate(cut + 2);
        });
        assert!(
            matches!(
                cut,
                Refusal::EndsInMotion { .. } | Refusal::NeverMoved { .. }
            ),
            "{share}: {cut}"
        );
    }
    is(
        changed(|it| it.samples.truncate(50)),
        &["too short: 50 samples", "400 or more"],
    );
    is(changed(|it| it.samples.clear()), &["too short: 0 samples"]);
    let begun = changed(|it| drop(it.samples.drain(..whole.samples.len() / 2 - 20)));
    is(begun, &["begins in motion", "0.1 s at rest"]);
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let refusal = changed(|it| it.samples[17].torque_nm = value);
        is(
            refusal,
            &["torque of sample 17", &value.to_string(), "finite"],
        );
        let refusal = changed(|it| it.count_rad = value);
        is(
            refusal,
            &["count size (rad)", &value.to_string(), "above 0"],
        );
    }
    for value in [0.0, -1e-3] {
        is(
            changed(|it| it.period_s = value),
            &["sample period (s)", "above 0"],
        );
    }
    // Only pushes upwards: each is followed by its mirror image, which is cut out.
    let mut one_way = whole.clone();
    let mut shift = 0;
    let mut samples: Vec<plant_sim::identify::Sample> = Vec::new();
    let mut down = false;
    for sample in &whole.samples {
        if sample.torque_nm != 0.0 {
            down = sample.torque_nm < 0.0;
        }
        if down {
            shift = samples.last().unwrap().count - sample.count;
        } else {
            samples.push(plant_sim::identify::Sample {
                count: sample.count + shift,
                ..*sample
            });
        }
    }
    let rest = *samples.last().unwrap();
    samples.extend(
        [plant_sim::identify::Sample {
            torque_nm: 0.0,
            ..rest
        }; 300],
    );
    one_way.samples = samples;
    is(
        identify(&one_way).unwrap_err(),
        &["only one direction", "counts downwards"],
    );
    // A hand that turns it.
    let turned = changed(|it| {
        for (place, sample) in it.samples.iter_mut().enumerate() {
            sample.count += (place as i32 - 120).clamp(0, 40);
        }
    });
    is(turned, &["without torque", "keep hands off"]);
}

#[test]
fn slow_pushes_leave_the_viscous_friction_open_and_say_so() {
    let slow = Limits {
        speed_rad_s: 5.0,
        ..LIMITS
    };
    let mut bench = bench(0);
    bench.device.viscous_nm_s_rad = 1e-7;
    let count = |angle: f64| (angle / bench.count_rad).floor() as i32;
    let found = identify(&bench.run(slow, |it| it, count).0).unwrap();
    assert_eq!(inside(&found, &bench.device), [true; 3]);
    assert_eq!(found.viscous_nm_s_rad.low, 0.0, "{found:?}");
}

#[test]
fn limits_that_are_none_are_refused() {
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        for (name, limits) in [
            (
                "speed limit",
                Limits {
                    speed_rad_s: bad,
                    ..LIMITS
                },
            ),
            (
                "angle limit",
                Limits {
                    angle_rad: bad,
                    ..LIMITS
                },
            ),
            (
                "torque limit",
                Limits {
                    torque_nm: bad,
                    ..LIMITS
                },
            ),
        ] {
            let error = Experiment::new(limits, 1e-3, 1e-3).unwrap_err().to_string();
            assert!(
                error.contains(name) && error.contains(&bad.to_string()),
                "{error}"
            );
        }
    }
}

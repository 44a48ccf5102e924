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
        mut torque: impl FnMut(f64) -> f64,
        mut count: impl FnMut(f64) -> i32,
    ) -> (Recording, f64, f64) {
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
        })
        .unwrap();
        (recording, furthest, fastest)
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

#[test]
fn explore() {
    let sab = |name: &str, f: &dyn Fn(Bench) -> Recording| {
        for number in 0..12 {
            let bench = if number < 4 {
                let preset = &PRESETS[number as usize];
                Bench::new(preset.device, preset.counts_per_rev, preset.period_s)
            } else {
                random(number)
            };
            let t = std::time::Instant::now();
            let found = identify(&f(bench));
            match found {
                Ok(found) => println!(
                    "{name} {number} {:.5?} {:?} misfit {} {:?}",
                    widths(&found),
                    inside(&found, &bench.device),
                    found.misfit_counts,
                    t.elapsed()
                ),
                Err(error) => println!("{name} {number} {error} {:?}", t.elapsed()),
            }
        }
    };
    let c = |b: &Bench| b.device.coulomb_nm;
    for share in [0.001, 0.01, 0.1] {
        sab(&format!("cogging {share}"), &|mut b: Bench| {
            b.motor = Motor {
                cogging_nm: share * c(&b),
                cogging_per_rev: 42.0,
                ..Motor::default()
            };
            b.record()
        });
        sab(&format!("delay {share}"), &|mut b: Bench| {
            b.drive.delay_s = share * b.period_s;
            b.record()
        });
        sab(&format!("dac {share}"), &|mut b: Bench| {
            b.drive.torque_step_nm = share * c(&b);
            b.record()
        });
        sab(&format!("push {share}"), &|mut b: Bench| {
            b.hand.push_nm = share * c(&b);
            b.record()
        });
        sab(&format!("stiction {share}"), &|mut b: Bench| {
            b.motor = Motor {
                stiction_nm: share * c(&b),
                stribeck_rad_s: 0.5,
                ..Motor::default()
            };
            b.record()
        });
    }
    sab("push 0.5", &|mut b: Bench| {
        b.hand.push_nm = 0.5 * c(&b);
        b.record()
    });
    sab("spring", &|mut b: Bench| {
        b.hand.stiffness_nm_rad = c(&b);
        b.record()
    });
    sab("shake", &|mut b: Bench| {
        b.hand.shake_nm = 0.5 * c(&b);
        b.hand.shake_hz = 5.0;
        b.record()
    });
    sab("saturate", &|b: Bench| {
        let count_rad = b.count_rad;
        let m = 2.5 * c(&b);
        b.run(
            LIMITS,
            |t| t.clamp(-m, m),
            |a| (a / count_rad).floor() as i32,
        )
        .0
    });
    sab("slip", &|b: Bench| {
        let count_rad = b.count_rad;
        let mut far = 0.0_f64;
        b.run(
            LIMITS,
            |t| t,
            |a| {
                far = far.max(a);
                (a / count_rad).floor() as i32 - if far > 60.0 * count_rad { 8 } else { 0 }
            },
        )
        .0
    });
    sab("creep slip", &|b: Bench| {
        let count_rad = b.count_rad;
        b.run(
            LIMITS,
            |t| t,
            |a| {
                (if a > 0.0 {
                    0.97 * a / count_rad
                } else {
                    a / count_rad
                })
                .floor() as i32
            },
        )
        .0
    });
    sab("reversed", &|b: Bench| {
        let count_rad = b.count_rad;
        b.run(LIMITS, |t| -t, |a| (a / count_rad).floor() as i32).0
    });
    sab("stuck", &|b: Bench| {
        let count_rad = b.count_rad;
        b.run(LIMITS, |_| 0.0, |a| (a / count_rad).floor() as i32).0
    });
}

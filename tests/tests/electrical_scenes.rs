//! Scenes whose torque comes through windings: with ideal ones they are the plain scenes with the delay and lag that
//! the drive tells; with real ones the governor stays passive, if it is told.

use std::f64::consts::TAU;

use control::config::Law;
use control::criterion::Device;
use control::plan::Plan;
use control::shape::Shape;
use control::torque::angle::EncoderOnMotor;
use control::torque::brushed::BrushedLoop;
use control::torque::current::CurrentLoop;
use control::torque::voltage::VoltageDrive;
use control::torque::{BrushedMotor, InverterConfig, LoopConfig, ThreePhaseMotor};
use plant_sim::campaign::{Draw, Kind};
use plant_sim::closed_loop::{Sample, Scene};
use plant_sim::driven::{Driven, TorqueDrive};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
use plant_sim::hold::State;
use plant_sim::powered::{EncoderSetup, Setup};
use plant_sim::trial::{Fault, ROUNDING, Sampled, Trial, Verdict};
use rayon::prelude::*;

const BUS_V: f64 = 24.0;

/// A trial, the windings of its knob and what drives them.
struct Run {
    trial: Trial,
    setup: Setup,
    drive: TorqueDrive,
}

impl Run {
    /// A random trial of a kind, its torque brought by random windings behind an inverter with dead time, steps and noise.
    fn random(kind: Kind, law: Law, number: u64) -> Self {
        (0..1_000)
            .find_map(|attempt| Self::attempt(kind, law, 1_000 * number + attempt))
            .unwrap()
    }

    /// One within what a governor can be told of: currents within the converters' codes, voltage for them, steps of up to twice
    /// Coulomb friction, as far as the plain campaign goes, an encoder by whose counts the speed is known so well that its
    /// back-EMF makes no more current than a step of the converters, and a knob that does not change its speed while
    /// that is found out: m R/k² of 1 ms or more.
    fn attempt(kind: Kind, law: Law, number: u64) -> Option<Self> {
        let mut draw = Draw::new(61, kind, number);
        let mut trial = draw.trial(kind, law);
        let scene = &mut trial.scene;
        let counts_per_rev = draw.log(2048.0, 65_536.0).round() as u32;
        let pwm_period_s = draw.log(2e-5, 6.25e-5);
        let periods = (scene.clock.period_s / pwm_period_s).round().max(1.0);
        scene.clock.period_s = periods * pwm_period_s;
        scene.config.timing.period_s = scene.clock.period_s;
        scene.config.hardware_count_rad = TAU / f64::from(counts_per_rev);
        scene.seed = number;
        if draw.chance(0.3) {
            scene.motor.cogging_nm = draw.log(0.01, 0.5) * scene.device.coulomb_nm;
            scene.motor.cogging_per_rev = 84.0;
        }
        let inverter = Inverter {
            pwm_period_s,
            pwm_steps: 3500,
            dead_time_s: if draw.chance(0.5) {
                draw.between(0.0, 5e-7)
            } else {
                0.0
            },
            dead_time_edge_a: draw.log(0.02, 0.3),
            late: true,
        };
        let constant = draw.log(0.01, 0.1);
        let step_a = draw.log(1e-2, 1.0) * scene.device.coulomb_nm / constant;
        let sensing = CurrentSensing {
            step_a,
            noise_a: if draw.chance(0.5) {
                0.5 * draw.uniform() * step_a
            } else {
                0.0
            },
            offset_a: [0.0; 2],
            seed: number,
        };
        let supply = if draw.chance(0.5) {
            Supply::stiff(BUS_V)
        } else {
            Supply {
                source_v: BUS_V,
                source_ohm: draw.log(0.02, 0.5),
                capacitance_f: 8e-4,
                takes_back: draw.chance(0.5),
            }
        };
        let told = InverterConfig {
            pwm_period_s,
            pwm_steps: inverter.pwm_steps,
            dead_time_s: inverter.dead_time_s,
            dead_time_edge_a: inverter.dead_time_edge_a,
            duty_max: 0.85,
            bus_least_v: 8.0,
            bus_most_v: 25.68,
            current_step_a: step_a,
        };
        let resistance_ohm = draw.log(0.2, 10.0);
        let inductance_h = resistance_ohm * draw.log(3e-4, 3e-3);
        let bandwidth_rad_s = draw.between(0.1, 0.29) / pwm_period_s;
        // Half of what the bus can give a phase is left for back-EMF, and a fifth may sag; a step from one limit to
        // the other, the first voltage of which is ω_c L for each ampere, takes no more than the other half.
        let volts = 0.5 * 0.8 * BUS_V / 3.0_f64.sqrt();
        let asked = LoopConfig {
            bandwidth_rad_s,
            current_max_a: draw.log(0.05, 1.0) * volts
                / (resistance_ohm + 2.0 * bandwidth_rad_s * inductance_h),
            tolerance: 0.0,
        };
        let encoder = EncoderOnMotor {
            counts_per_rev,
            zero_turns: draw.uniform(),
        };
        let pole_pairs = 7;
        let three_phase = ThreePhaseMotor {
            resistance_ohm,
            d_inductance_h: inductance_h,
            q_inductance_h: inductance_h,
            flux_wb: constant / (1.5 * f64::from(pole_pairs)),
            pole_pairs,
        };
        let brushed = BrushedMotor {
            resistance_ohm,
            inductance_h,
            torque_constant_nm_a: constant,
        };
        let (winding, drive) = match number / 1_000 % 3 {
            0 => (
                Winding::Brushed(brushed),
                TorqueDrive::Brushed(BrushedLoop::new(&brushed, &told, &asked).unwrap()),
            ),
            1 => (
                Winding::ThreePhase(three_phase),
                TorqueDrive::Current(
                    CurrentLoop::new(&three_phase, &encoder, &told, &asked).unwrap(),
                ),
            ),
            _ => {
                let drive =
                    VoltageDrive::new(&three_phase, &encoder, &told, asked.current_max_a, 0.0)
                        .unwrap();
                (
                    Winding::ThreePhase(three_phase),
                    TorqueDrive::Voltage(drive),
                )
            }
        };
        let delivery = drive.delivery(&winding, counts_per_rev, pwm_period_s);
        let count_speed_rad_s = TAU / f64::from(counts_per_rev) / (16.0 * pwm_period_s);
        let voltage = matches!(drive, TorqueDrive::Voltage(_));
        let well_sensed = asked.current_max_a < 1_800.0 * step_a
            && constant * count_speed_rad_s < resistance_ohm * step_a;
        let config = &mut scene.config;
        if delivery.torque_step_nm > 2.0 * scene.device.coulomb_nm
            || constant * scene.start.velocity.abs() > volts
            || !(voltage || well_sensed)
            || scene.device.inertia_kg_m2 * resistance_ohm / (constant * constant) < 1e-3
        {
            return None;
        }
        config.timing.delay_s = delivery.delay_s;
        config.timing.amplifier_tau_s = delivery.tau_s;
        config.torque_step_nm = delivery.torque_step_nm;
        config.torque_max_nm = delivery.torque_max_nm;
        let setup = Setup {
            device: scene.device,
            motor: scene.motor,
            hand: scene.hand,
            winding,
            inverter,
            sensing,
            supply,
            encoder: EncoderSetup {
                counts_per_rev,
                reversed: false,
                zero_turns: encoder.zero_turns,
            },
            start: scene.start,
        };
        Some(Self {
            trial,
            setup,
            drive,
        })
    }

    fn verdict(&self) -> Verdict {
        let mut driven = Driven::new(&self.setup, self.drive).unwrap();
        self.trial
            .run_on(|torque_nm, duration_s| driven.hold(torque_nm, duration_s))
            .unwrap()
    }

    /// Given out beyond rounding and what cogging stores, J.
    fn excess_j(&self, verdict: &Verdict) -> f64 {
        let motor = &self.setup.motor;
        let cogging_j = if motor.cogging_nm > 0.0 {
            2.0 * motor.cogging_nm / motor.cogging_per_rev
        } else {
            0.0
        };
        verdict.excess_j - ROUNDING * verdict.scale_j - cogging_j
    }
}

/// Which of a number of random scenes of a kind, first changed by `change`, give energy out.
fn bad(kind: Kind, law: Law, runs: u64, change: impl Fn(&mut Run) + Sync) -> Vec<u64> {
    (0..runs)
        .into_par_iter()
        .filter(|&number| {
            let mut run = Run::random(kind, law, number);
            run.trial.extension = 4;
            change(&mut run);
            let verdict = run.verdict();
            verdict.fault == Some(Fault::Growth) || run.excess_j(&verdict) > 0.0
        })
        .collect()
}

const KINDS: [Kind; 4] = [Kind::Wall, Kind::Spring, Kind::Release, Kind::Detent];

/// Six hundred scenes, with dead time, steps, noise, cogging and a soft bus: no energy comes out but what cogging stores.
#[test]
fn a_governor_that_is_told_the_delivery_is_passive() {
    for law in [Law::Ledger, Law::Auto] {
        for kind in KINDS {
            let bad = bad(kind, law, 75, |_| ());
            assert!(bad.is_empty(), "{law:?} {kind:?}: {bad:?}");
        }
    }
}

/// The same scenes, the governor told of an ideal torque.
#[test]
fn a_governor_that_is_not_told_gives_energy_out() {
    let untold = |run: &mut Run| {
        let config = &mut run.trial.scene.config;
        config.timing.delay_s = 0.0;
        config.timing.amplifier_tau_s = 0.0;
        config.torque_step_nm = 0.0;
    };
    let bad: usize = KINDS
        .map(|kind| bad(kind, Law::Ledger, 150, untold).len())
        .iter()
        .sum();
    println!("not told: {bad} of 600 give energy out");
    assert!(bad >= 3, "{bad}");
}

/// The angles of a scene at its samples, on its own plant or on another, rad.
fn angles(scene: &Scene, driven: Option<Driven>) -> Vec<f64> {
    let mut controller = scene.controller(Plan::new(&scene.config).unwrap());
    let control = |counter: u32, duration_s: f32| controller.tick(counter, duration_s);
    let mut angles = Vec::new();
    let observe = |sample: &Sample| {
        angles.push(sample.state.position);
        true
    };
    match driven {
        Some(mut driven) => scene
            .run_on(
                |torque_nm, duration_s| driven.hold(torque_nm, duration_s),
                control,
                observe,
            )
            .unwrap(),
        None => scene.run_under(control, observe).unwrap(),
    };
    angles
}

fn furthest_apart(one: &[f64], other: &[f64]) -> f64 {
    let apart = one.iter().zip(other).map(|(a, b)| (a - b).abs());
    apart.fold(0.0, f64::max)
}

/// Windings that are nearly ideal, a bus that gives any voltage, a fine encoder: the knob goes where the plain scene with the
/// delay and lag told of has it, for each drive; without delay and lag it would go elsewhere.
#[test]
fn with_ideal_windings_it_is_the_plain_scene_with_the_delay_and_lag_that_are_told() {
    let pwm_period_s = 2e-5;
    let counts_per_rev = 1 << 20;
    let told = InverterConfig {
        pwm_period_s,
        pwm_steps: u16::MAX,
        dead_time_s: 0.0,
        dead_time_edge_a: 0.1,
        duty_max: 0.85,
        bus_least_v: 60.0,
        bus_most_v: 250.0,
        current_step_a: 1e-3,
    };
    let asked = LoopConfig {
        bandwidth_rad_s: 0.05 / pwm_period_s,
        current_max_a: 2.0,
        tolerance: 0.0,
    };
    let encoder = EncoderOnMotor {
        counts_per_rev,
        zero_turns: 0.3,
    };
    // The voltage drive's lag is L/R, and what it makes of a speed that is late acts as inertia, k²/R·W/2: a weaker motor.
    let motor = |constant, resistance_ohm, inductance_h| ThreePhaseMotor {
        resistance_ohm,
        d_inductance_h: inductance_h,
        q_inductance_h: inductance_h,
        flux_wb: constant / 10.5,
        pole_pairs: 7,
    };
    let brushed = BrushedMotor {
        resistance_ohm: 5.0,
        inductance_h: 1e-3,
        torque_constant_nm_a: 0.1,
    };
    let (current, voltage) = (motor(0.1, 5.0, 1e-3), motor(0.05, 20.0, 8e-3));
    let sampled = Sampled {
        device: Device {
            inertia_kg_m2: 5e-5,
            viscous_nm_s_rad: 1e-4,
            coulomb_nm: 5e-4,
        },
        count_rad: TAU / f64::from(counts_per_rev),
        period_s: 20.0 * pwm_period_s,
    };
    for (winding, drive) in [
        (
            Winding::ThreePhase(current),
            TorqueDrive::Current(CurrentLoop::new(&current, &encoder, &told, &asked).unwrap()),
        ),
        (
            Winding::ThreePhase(voltage),
            TorqueDrive::Voltage(VoltageDrive::new(&voltage, &encoder, &told, 4.0, 0.0).unwrap()),
        ),
        (
            Winding::Brushed(brushed),
            TorqueDrive::Brushed(BrushedLoop::new(&brushed, &told, &asked).unwrap()),
        ),
    ] {
        let delivery = drive.delivery(&winding, counts_per_rev, pwm_period_s);
        let shape = Shape::Spring { centre_rad: 0.0 };
        let start = State {
            position: 0.1,
            velocity: 0.0,
        };
        let mut scene = sampled.scene(sampled.config(Law::Raw, shape, 1.0), start, 300);
        let setup = Setup {
            device: scene.device,
            motor: scene.motor,
            hand: scene.hand,
            winding,
            inverter: Inverter {
                late: true,
                ..Inverter::ideal(pwm_period_s)
            },
            sensing: CurrentSensing {
                step_a: told.current_step_a,
                ..CurrentSensing::default()
            },
            supply: Supply::stiff(200.0),
            encoder: EncoderSetup {
                counts_per_rev,
                reversed: false,
                zero_turns: encoder.zero_turns,
            },
            start,
        };
        let electrical = angles(&scene, Some(Driven::new(&setup, drive).unwrap()));
        let ideal = angles(&scene, None);
        scene.drive.delay_s = delivery.delay_s;
        scene.drive.amplifier_tau_s = delivery.tau_s;
        let plain = angles(&scene, None);
        let (near, far) = (
            furthest_apart(&electrical, &plain),
            furthest_apart(&electrical, &ideal),
        );
        println!("{near:.2e} rad from the plain scene, {far:.2e} from one without delay and lag");
        assert!(near < 0.02 * start.position, "{near}");
        assert!(far > 10.0 * near, "{far} {near}");
    }
}

//! The drives of [`control::torque`] on the electrical plant: how fast, how exactly and how safely
//! torque comes, and what each thing that a real inverter adds does where it is not reckoned with.

use std::f64::consts::TAU;

use control::config::{Believed, Config, Law, Timing};
use control::criterion::Device;
use control::encoder::EncoderConfig;
use control::plan::Plan;
use control::shape::Shape;
use control::tick::Controller;
use control::torque::angle::EncoderOnMotor;
use control::torque::brushed::BrushedLoop;
use control::torque::cogging::CoggingFeedForward;
use control::torque::current::CurrentLoop;
use control::torque::modulation::Duties;
use control::torque::sense::{CurrentSense, PhaseCurrents};
use control::torque::voltage::VoltageDrive;
use control::torque::{
    BrushedMotor, Delivery, FASTEST, InverterConfig, LoopConfig, Measured, ThreePhaseMotor,
};
use plant_sim::drive::Drive;
use plant_sim::electrical::{CurrentSensing, Electrical, Inverter, Supply, Winding};
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::knob::Knob;
use plant_sim::motor::Motor;
use proptest::prelude::*;

const PERIOD_S: f64 = 1.0 / 24e3;
const BUS_V: f64 = 24.0;
const COUNTS_PER_REV: u32 = 16_384;
const CURRENT_STEP_A: f64 = 0.020_14;

/// 119 ns of the timer and 104 ns of the gate driver.
const DEAD_TIME_S: f64 = 223e-9;

/// The largest voltage vector at 24 V, V.
const REACH_V: f64 = 0.85 * BUS_V / 1.732_050_807_568_877_2;

/// 0.5 ms, in PWM periods.
const HALF_MILLISECOND: usize = 12;

const INVERTER: InverterConfig = InverterConfig {
    pwm_period_s: PERIOD_S,
    pwm_steps: 3500,
    dead_time_s: 0.0,
    dead_time_edge_a: 0.1,
    duty_max: 0.85,
    bus_least_v: 8.0,
    bus_most_v: 25.0,
    current_step_a: CURRENT_STEP_A,
};

const DEAD_TIME_COMPENSATED: InverterConfig = InverterConfig {
    dead_time_s: DEAD_TIME_S,
    ..INVERTER
};

/// The bridge's delay of a period, which no drive can be without.
fn late() -> Inverter {
    Inverter {
        late: true,
        ..Inverter::ideal(PERIOD_S)
    }
}

fn asked(current_max_a: f64, tolerance: f64) -> LoopConfig {
    LoopConfig {
        bandwidth_rad_s: FASTEST / PERIOD_S,
        current_max_a,
        tolerance,
    }
}

/// The encoder's zero where the electrical angle is 0: the middle of count 0 is half a count on.
fn encoder(pole_pairs: u32) -> EncoderOnMotor {
    EncoderOnMotor {
        counts_per_rev: COUNTS_PER_REV,
        zero_turns: 0.5 * f64::from(pole_pairs) / f64::from(COUNTS_PER_REV),
    }
}

/// A gimbal motor: 0.1 Nm/A on 10 Ω.
const GIMBAL: ThreePhaseMotor = ThreePhaseMotor {
    resistance_ohm: 10.0,
    d_inductance_h: 2.5e-3,
    q_inductance_h: 2.5e-3,
    flux_wb: 9.5e-3,
    pole_pairs: 7,
};

/// A motor that a current loop is for: 53 mNm/A on 0.5 Ω.
const STRONG: ThreePhaseMotor = ThreePhaseMotor {
    resistance_ohm: 0.5,
    d_inductance_h: 2.5e-4,
    q_inductance_h: 3e-4,
    flux_wb: 5e-3,
    pole_pairs: 7,
};

/// As strong as the paper's RE35 with one of its windings.
const RE35: BrushedMotor = BrushedMotor {
    resistance_ohm: 2.0,
    inductance_h: 6e-4,
    torque_constant_nm_a: 0.052,
};

fn motors() -> impl Strategy<Value = ThreePhaseMotor> {
    (
        (-3.0..2.5f64).prop_map(f64::exp),
        (-8.5..-5.8f64).prop_map(f64::exp),
        1.0..1.6f64,
        1e-3..3e-2f64,
        1..15_u32,
    )
        .prop_map(
            |(resistance_ohm, time_constant_s, saliency, flux_wb, pole_pairs)| {
                // With all the current that the bus can give, no more than the magnets' own flux.
                let most = 1.0 + flux_wb / (time_constant_s * REACH_V);
                ThreePhaseMotor {
                    resistance_ohm,
                    d_inductance_h: resistance_ohm * time_constant_s,
                    q_inductance_h: saliency.min(most) * resistance_ohm * time_constant_s,
                    flux_wb,
                    pole_pairs,
                }
            },
        )
}

/// How wrong the torque of a current is, as a part of it, since the angle is known to half a count and the
/// rotor has saliency: (L_q − L_d) i/ψ times half a count, electrical.
fn of_the_angle(motor: &ThreePhaseMotor, current_a: f64) -> f64 {
    let half_count = 0.5 * TAU * f64::from(motor.pole_pairs) / f64::from(COUNTS_PER_REV);
    let saliency = (motor.q_inductance_h - motor.d_inductance_h).abs() / motor.flux_wb;
    saliency * current_a.abs() * half_count
}

fn brushed_motors() -> impl Strategy<Value = BrushedMotor> {
    (
        (-3.0..2.5f64).prop_map(f64::exp),
        (-8.5..-5.8f64).prop_map(f64::exp),
        5e-3..0.2f64,
    )
        .prop_map(|(resistance_ohm, time_constant_s, k)| BrushedMotor {
            resistance_ohm,
            inductance_h: resistance_ohm * time_constant_s,
            torque_constant_nm_a: k,
        })
}

/// The most current that a step may ask for and leave a fifth of the voltage: its first voltage is K_p times it.
fn step_without_limit_a(resistance_ohm: f64, inductance_h: f64, reach_v: f64) -> f64 {
    let decay = -(-PERIOD_S * resistance_ohm / inductance_h).exp_m1();
    (0.8 * reach_v / (FASTEST * resistance_ohm / decay)).min(0.8 * reach_v / resistance_ohm)
}

/// A motor on the bench: its shaft at a speed, whatever the torque.
struct Bench {
    plant: Electrical,
    angle_rad: f64,
    velocity_rad_s: f64,
    /// What the drive believes of the bus, where it does not measure it.
    believed_bus_v: Option<f64>,
}

impl Bench {
    fn new(winding: Winding, inverter: Inverter) -> Self {
        Self::with(
            winding,
            inverter,
            CurrentSensing::default(),
            Supply::stiff(BUS_V),
        )
    }

    fn with(winding: Winding, inverter: Inverter, sensing: CurrentSensing, supply: Supply) -> Self {
        Self {
            plant: Electrical::new(winding, inverter, sensing, supply).unwrap(),
            angle_rad: 0.0,
            velocity_rad_s: 0.0,
            believed_bus_v: None,
        }
    }

    fn three_phase(motor: &ThreePhaseMotor) -> Self {
        Self::new(Winding::ThreePhase(*motor), late())
    }

    fn turning(mut self, velocity_rad_s: f64) -> Self {
        self.velocity_rad_s = velocity_rad_s;
        self
    }

    fn at(mut self, angle_rad: f64) -> Self {
        self.angle_rad = angle_rad;
        self
    }

    fn measured(&mut self) -> Measured {
        let [b_a, c_a] = self.plant.measure(self.angle_rad);
        Measured {
            currents: PhaseCurrents {
                b_a: b_a as f32,
                c_a: c_a as f32,
            },
            count: (self.angle_rad / TAU * f64::from(COUNTS_PER_REV)).floor() as i32,
            speed_rad_s: self.velocity_rad_s as f32,
            bus_v: self.believed_bus_v.unwrap_or(self.plant.bus_v()) as f32,
        }
    }

    /// One period; the torque at its end, Nm.
    fn period(&mut self, mut drive: impl FnMut(&Measured) -> Duties) -> f64 {
        let duties = drive(&self.measured()).parts().map(f64::from);
        self.plant
            .period(Some(duties), self.angle_rad, self.velocity_rad_s);
        self.angle_rad += self.velocity_rad_s * PERIOD_S;
        self.plant.torque_nm()
    }

    /// The torque now and after each of `periods` periods, Nm.
    fn run(&mut self, periods: usize, mut drive: impl FnMut(&Measured) -> Duties) -> Vec<f64> {
        let mut torques = vec![self.plant.torque_nm()];
        torques.extend((0..periods).map(|_| self.period(&mut drive)));
        torques
    }
}

fn mean(torques: &[f64]) -> f64 {
    torques.iter().sum::<f64>() / torques.len() as f64
}

/// The largest distance from a value.
fn furthest(torques: &[f64], from: f64) -> f64 {
    torques
        .iter()
        .map(|torque| (torque - from).abs())
        .fold(0.0, f64::max)
}

/// ∫(1 − y) dt of an answer to a step, over where it ended, by the trapezoid, s.
fn area_s(torques: &[f64]) -> f64 {
    let goal = torques[torques.len() - 1];
    let missing = |torque: &f64| 1.0 - torque / goal;
    let ends = missing(&torques[0]) + missing(&torques[torques.len() - 1]);
    PERIOD_S * (torques.iter().map(missing).sum::<f64>() - 0.5 * ends)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Within 1 % no later than half a millisecond after the command, and never out of it again, for any
    /// motor, at rest and turning, as far as the voltage reaches; on the way never beyond 2 %.
    #[test]
    fn a_step_of_torque_settles_within_half_a_millisecond(
        motor in motors(), angle in 0.0..TAU, part in 0.05..1.0f64, turning in -0.3..0.3f64,
        sign in prop_oneof![Just(1.0), Just(-1.0)],
    ) {
        let p = f64::from(motor.pole_pairs);
        // A part of the voltage goes to the back-EMF, up to an electrical 1,500 rad/s.
        let electrical = (turning * REACH_V / motor.flux_wb).clamp(-1_500.0, 1_500.0);
        let left_v = REACH_V - electrical.abs() * motor.flux_wb;
        let current = part * step_without_limit_a(motor.resistance_ohm, motor.q_inductance_h, left_v);
        // Nor may turning it take more: ω L i.
        let current = current.min(0.1 * REACH_V / (electrical.abs() * motor.q_inductance_h + 1e-9));
        let goal = sign * current * motor.torque_constant_nm_a();
        let mut drive = CurrentLoop::new(
            &motor, &encoder(motor.pole_pairs), &INVERTER, &asked(2.0 * current, 0.0),
        ).unwrap();
        let mut bench = Bench::three_phase(&motor).at(angle).turning(electrical / p);
        bench.run(2_000, |measured| drive.tick(0.0, measured));
        let torques = bench.run(240, |measured| drive.tick(goal as f32, measured));
        let settled = &torques[HALF_MILLISECOND..];
        prop_assert!(furthest(settled, goal) < 0.01 * goal.abs(), "{} of {goal}: {torques:?}", furthest(settled, goal));
        let beyond = torques.iter().map(|torque| torque / goal).fold(0.0, f64::max);
        prop_assert!(beyond < 1.02, "{beyond}");
    }

    /// With resistance and inductance off by 30 %, any way, it is stable: it overshoots by less than
    /// 20 %, and arrives. (The worst are a low inductance, and a high one on a low resistance.)
    #[test]
    fn it_is_stable_with_resistance_and_inductance_off_by_a_third(
        motor in motors(), r in 0.7..1.3f64, l_d in 0.7..1.3f64, l_q in 0.7..1.3f64,
        corner in 0..9_usize, electrical in -1_000.0..1_000.0f64,
    ) {
        // Half of them at the corners.
        let (r, l_d, l_q) = if corner < 8 {
            let end = |bit: usize| if corner & bit == 0 { 0.7 } else { 1.3 };
            (end(1), end(2), end(4))
        } else {
            (r, l_d, l_q)
        };
        let truth = ThreePhaseMotor {
            resistance_ohm: r * motor.resistance_ohm,
            d_inductance_h: l_d * motor.d_inductance_h,
            q_inductance_h: l_q * motor.q_inductance_h,
            ..motor
        };
        let electrical = electrical.clamp(-0.2 * REACH_V / motor.flux_wb, 0.2 * REACH_V / motor.flux_wb);
        let current = 0.5 * step_without_limit_a(motor.resistance_ohm, motor.q_inductance_h, 0.8 * REACH_V);
        let current = current.min(0.1 * REACH_V / (electrical.abs() * motor.q_inductance_h + 1e-9));
        let goal = current * motor.torque_constant_nm_a();
        let mut drive = CurrentLoop::new(
            &motor, &encoder(motor.pole_pairs), &INVERTER, &asked(2.0 * current, 0.3),
        ).unwrap();
        let mut bench = Bench::three_phase(&truth).turning(electrical / f64::from(motor.pole_pairs));
        bench.run(2_000, |measured| drive.tick(0.0, measured));
        let torques = bench.run(2_000, |measured| drive.tick(goal as f32, measured));
        let saliency = (truth.d_inductance_h - truth.q_inductance_h) / truth.flux_wb;
        let current_scale = 1.0 + (saliency * current).abs();
        let beyond = torques.iter().map(|torque| torque / goal).fold(0.0, f64::max);
        prop_assert!(beyond < 1.0 + 0.2 * current_scale, "{beyond}");
        // Within 0.1 %, what half a count of angle makes, and half a step as it was told.
        let within = (1e-3 + of_the_angle(&truth, current)) * goal + 0.5 * drive.delivery().torque_step_nm;
        prop_assert!(furthest(&torques[1_500..], goal) < within, "{}, not {within}", furthest(&torques[1_500..], goal));
    }

    /// The delay and the time constant that the governor is told are what a step shows: exactly where the
    /// motor is as believed, and no less than that where its resistance is at the end of the tolerance.
    #[test]
    fn the_governor_is_told_the_lag_there_is(motor in motors(), r in 0.7..1.3f64, l in 0.7..1.3f64) {
        let current = 0.5 * step_without_limit_a(motor.resistance_ohm, motor.q_inductance_h, REACH_V);
        let goal = current * motor.torque_constant_nm_a();
        let answer = |truth: &ThreePhaseMotor, tolerance: f64| {
            let mut drive = CurrentLoop::new(
                &motor, &encoder(motor.pole_pairs), &INVERTER, &asked(2.0 * current, tolerance),
            ).unwrap();
            let told = drive.delivery();
            let torques = Bench::three_phase(truth)
                .run(1_500, |measured| drive.tick(goal as f32, measured));
            (area_s(&torques), told, torques)
        };
        let (area, told, torques) = answer(&motor, 0.0);
        prop_assert!((area / (told.delay_s + told.tau_s) - 1.0).abs() < 0.02, "{area} {told:?}");
        prop_assert_eq!(torques[1], 0.0);
        prop_assert!(torques[2] > 0.0);
        let off = ThreePhaseMotor {
            resistance_ohm: r * motor.resistance_ohm,
            q_inductance_h: l * motor.q_inductance_h,
            ..motor
        };
        let (area, told, _) = answer(&off, 0.3);
        prop_assert!(area < 1.02 * (told.delay_s + told.tau_s), "{area} {told:?}");
    }

    /// However long a torque is asked for that the bus cannot give, the next that it can give comes
    /// as if nothing had been: no wind-up.
    #[test]
    fn out_of_saturation_it_comes_without_overshoot(
        motor in motors(), angle in 0.0..TAU, beyond in 1.2..20.0f64, back in -0.8..0.8f64, periods in 50..2_000_usize,
    ) {
        let most = REACH_V / motor.resistance_ohm;
        let per_a = motor.torque_constant_nm_a();
        let mut drive = CurrentLoop::new(
            &motor, &encoder(motor.pole_pairs), &INVERTER, &asked(beyond * most, 0.0),
        ).unwrap();
        let mut bench = Bench::three_phase(&motor).at(angle);
        let up = bench.run(periods, |measured| drive.tick((beyond * most * per_a) as f32, measured));
        let top = *up.last().unwrap();
        let goal = back * most * per_a;
        let down = bench.run(1_500, |measured| drive.tick(goal as f32, measured));
        // From above: never below the goal by more than 2 % of the way, or of all that the bus gives where
        // the way is short.
        let way = (top - goal).max(most * per_a);
        let under = down.iter().map(|torque| goal - torque).fold(0.0, f64::max);
        if top > goal {
            prop_assert!(under < 0.02 * way, "{under} of {way}");
        }
        let angle = of_the_angle(&motor, back * most);
        let within = (0.01 + angle) * goal.abs() + 1e-4 * top.abs();
        prop_assert!(furthest(&down[1_000..], goal) < within, "{}, not {within}", furthest(&down[1_000..], goal));
    }

    /// Whatever is asked for, no current flows beyond the limit but for the overshoot of a step.
    #[test]
    fn the_current_limit_holds(
        motor in motors(), commands in prop::collection::vec(-10.0..10.0f64, 1..12), periods in 1..60_usize,
    ) {
        let current = 0.5 * step_without_limit_a(motor.resistance_ohm, motor.q_inductance_h, REACH_V);
        let per_a = motor.torque_constant_nm_a();
        let mut drive = CurrentLoop::new(
            &motor, &encoder(motor.pole_pairs), &INVERTER, &asked(current, 0.0),
        ).unwrap();
        let mut bench = Bench::three_phase(&motor);
        for command in commands {
            let torque = (command * current * per_a) as f32;
            for _ in 0..periods {
                bench.period(|measured| drive.tick(torque, measured));
                let [d, q] = bench.plant.rotor_currents();
                // Steps come from either limit: 1 % of two.
                prop_assert!(q.abs() < 1.021 * current, "{q} of {current}");
                prop_assert!(d.abs() < 0.01 * current, "{d}");
            }
        }
    }

    /// Measurements that are no numbers, or absurd, make no duty that the bridge has not, and are
    /// forgotten once they are over.
    #[test]
    fn absurd_measurements_are_survived(
        motor in motors(),
        absurd in prop::collection::vec((0..5_usize, prop_oneof![
            Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY), Just(f32::MAX), -1e9..1e9f32,
        ], any::<i32>()), 1..20),
    ) {
        let current = 0.5 * step_without_limit_a(motor.resistance_ohm, motor.q_inductance_h, REACH_V);
        let goal = current * motor.torque_constant_nm_a();
        let mut drive = CurrentLoop::new(
            &motor, &encoder(motor.pole_pairs), &INVERTER, &asked(2.0 * current, 0.0),
        ).unwrap();
        let good = Measured {
            currents: PhaseCurrents { b_a: 0.0, c_a: 0.0 },
            count: 0,
            speed_rad_s: 0.0,
            bus_v: BUS_V as f32,
        };
        for (which, value, count) in absurd {
            let mut measured = Measured { count, ..good };
            let mut torque = goal as f32;
            match which {
                0 => measured.currents.b_a = value,
                1 => measured.currents.c_a = value,
                2 => measured.speed_rad_s = value,
                3 => measured.bus_v = value,
                _ => torque = value,
            }
            for part in drive.tick(torque, &measured).parts() {
                prop_assert!((0.0..=0.85_f32).contains(&part), "{part}");
            }
        }
        // A winding's time constant may pass until the integral has recovered.
        let mut bench = Bench::three_phase(&motor);
        let torques = bench.run(3_000, |measured| drive.tick(goal as f32, measured));
        let error = furthest(&torques[2_000..], goal);
        prop_assert!(error < 0.01 * goal, "{error} of {goal}");
    }

    /// A brushed motor between B and C: the same figures.
    #[test]
    fn a_brushed_motor_settles_as_fast(motor in brushed_motors(), part in 0.05..1.0f64, emf in -0.3..0.3f64) {
        let reach = 0.85 * BUS_V;
        let current = part * step_without_limit_a(
            motor.resistance_ohm, motor.inductance_h, reach * (1.0 - emf.abs()),
        );
        let goal = current * motor.torque_constant_nm_a;
        let velocity = emf * reach / motor.torque_constant_nm_a;
        let mut drive = BrushedLoop::new(&motor, &INVERTER, &asked(2.0 * current, 0.0)).unwrap();
        let mut bench = Bench::new(Winding::Brushed(motor), late()).turning(velocity);
        bench.run(2_000, |measured| drive.tick(0.0, measured));
        let torques = bench.run(240, |measured| drive.tick(goal as f32, measured));
        let settled = &torques[HALF_MILLISECOND..];
        prop_assert!(furthest(settled, goal) < 0.01 * goal, "{torques:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    /// Of a gimbal motor whose resistance is known, voltage alone gives torque within 1 %, at rest and turning, with
    /// the lag that the governor is told.
    #[test]
    fn voltage_alone_gives_a_gimbal_motor_its_torque(
        resistance_ohm in 3.0..20.0f64, time_constant_s in 1e-4..5e-4f64, angle in 0.0..TAU,
        part in 0.05..0.9f64, emf in -0.4..0.4f64,
    ) {
        let motor = ThreePhaseMotor {
            resistance_ohm,
            d_inductance_h: resistance_ohm * time_constant_s,
            q_inductance_h: resistance_ohm * time_constant_s,
            ..GIMBAL
        };
        let drive = VoltageDrive::new(&motor, &encoder(7), &INVERTER, 10.0, 0.0).unwrap();
        let goal = part * 0.9 * REACH_V * (1.0 - emf.abs()) / resistance_ohm * motor.torque_constant_nm_a();
        // Turning, L_q takes its part of the voltage, too: slower than that.
        let electrical = emf * REACH_V / motor.flux_wb * 0.5;
        let mut bench = Bench::three_phase(&motor).at(angle).turning(electrical / 7.0);
        bench.run(500, |measured| drive.tick(0.0, measured));
        let torques = bench.run(500, |measured| drive.tick(goal as f32, measured));
        let error = furthest(&torques[200..], goal);
        prop_assert!(error < 0.01 * goal + 1e-4, "{error} of {goal}");
        if emf.abs() < 0.1 {
            let mut still = Bench::three_phase(&motor).at(angle);
            let torques = still.run(500, |measured| drive.tick(goal as f32, measured));
            let told = drive.delivery();
            let ratio = area_s(&torques) / (told.delay_s + told.tau_s);
            prop_assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
        }
    }
}

/// A drive of voltage on the STRONG motor at speed, told its angle by this many turns late.
fn torque_turned_late(turns: f64) -> f64 {
    let electrical = 1_500.0;
    let on = encoder(7);
    let encoder = EncoderOnMotor {
        zero_turns: on.zero_turns - turns,
        ..on
    };
    let drive = VoltageDrive::new(&STRONG, &encoder, &INVERTER, 10.0, 0.0).unwrap();
    let mut bench = Bench::three_phase(&STRONG).turning(electrical / 7.0);
    bench.run(1_000, |measured| drive.tick(0.1, measured));
    mean(&bench.run(4_800, |measured| drive.tick(0.1, measured)))
}

/// The voltage acts a period late and for a period: while the rotor turns on, by a tenth of a
/// radian here.
#[test]
fn late_voltage_is_turned_ahead() {
    let ahead = 1_500.0 * 1.5 * PERIOD_S / TAU;
    let (off, on) = (torque_turned_late(ahead), torque_turned_late(0.0));
    assert!((off / 0.1 - 1.0).abs() > 0.2, "{off}");
    assert!((on / 0.1 - 1.0).abs() < 0.01, "{on}");
}

/// A loop as fast as an inverter without delay allows is unstable on one with: the bandwidth is limited to what
/// the delay allows.
#[test]
fn the_bandwidth_reckons_with_the_delay() {
    // Five times the inductance is five times the gain: ω_c·T = 1.45.
    let hasty = ThreePhaseMotor {
        d_inductance_h: 5.0 * STRONG.d_inductance_h,
        q_inductance_h: 5.0 * STRONG.q_inductance_h,
        ..STRONG
    };
    let error = |believed: &ThreePhaseMotor, inverter: Inverter| {
        let mut drive =
            CurrentLoop::new(believed, &encoder(7), &INVERTER, &asked(10.0, 0.0)).unwrap();
        let mut bench = Bench::new(Winding::ThreePhase(STRONG), inverter);
        let goal = 0.05 / STRONG.torque_constant_nm_a();
        let mut furthest = 0.0_f64;
        for period in 0..1_000 {
            bench.period(|measured| drive.tick(0.05, measured));
            if period >= 800 {
                let [d, q] = bench.plant.rotor_currents();
                furthest = furthest.max(d.hypot(q - goal) / goal);
            }
        }
        furthest
    };
    let (prompt, unstable, stable) = (
        error(&hasty, Inverter::ideal(PERIOD_S)),
        error(&hasty, late()),
        error(&STRONG, late()),
    );
    println!("hasty: {prompt:.4} without delay, {unstable:.4} with; {stable:.4} as limited");
    assert!(prompt < 0.01, "{prompt}");
    assert!(unstable > 1.0, "{unstable}");
    assert!(stable < 0.01, "{stable}");
    let asked = LoopConfig {
        bandwidth_rad_s: 4.0 * FASTEST / PERIOD_S,
        ..asked(10.0, 0.0)
    };
    assert!(CurrentLoop::new(&STRONG, &encoder(7), &INVERTER, &asked).is_err());
}

fn with_dead_time() -> Inverter {
    Inverter {
        dead_time_s: DEAD_TIME_S,
        dead_time_edge_a: 0.1,
        ..late()
    }
}

/// Dead time costs a gimbal motor at 2 V a twelfth of its torque.
#[test]
fn dead_time_is_put_back_into_the_voltage() {
    let error = |config: &InverterConfig| {
        let drive = VoltageDrive::new(&GIMBAL, &encoder(7), config, 10.0, 0.0).unwrap();
        let mut bench = Bench::new(Winding::ThreePhase(GIMBAL), with_dead_time()).turning(3.0);
        let torques = bench.run(9_600, |measured| drive.tick(0.02, measured));
        (mean(&torques[400..]) / 0.02 - 1.0).abs()
    };
    assert!(error(&INVERTER) > 0.05, "{}", error(&INVERTER));
    let on = error(&DEAD_TIME_COMPENSATED);
    assert!(on < 0.01, "{on}");
}

/// Under a current loop it is a ripple, six times in an electrical turn.
#[test]
fn dead_time_does_not_ripple_the_current() {
    let ripple = |config: &InverterConfig| {
        let mut drive = CurrentLoop::new(&STRONG, &encoder(7), config, &asked(10.0, 0.0)).unwrap();
        let mut bench =
            Bench::new(Winding::ThreePhase(STRONG), with_dead_time()).turning(600.0 / 7.0);
        let torques = bench.run(4_800, |measured| drive.tick(0.02, measured));
        furthest(&torques[400..], 0.02) / 0.02
    };
    let (off, on) = (ripple(&INVERTER), ripple(&DEAD_TIME_COMPENSATED));
    println!("dead time: {off:.4} without, {on:.4} with");
    assert!(off > 0.01, "{off}");
    assert!(on < 0.2 * off, "{on} of {off}");
}

/// On the brushed motor between two phases, half a tenth of a step goes missing until the integral has found it.
#[test]
fn dead_time_does_not_delay_a_brushed_motor() {
    let settled = |config: &InverterConfig| {
        let mut drive = BrushedLoop::new(&RE35, config, &asked(5.0, 0.0)).unwrap();
        let mut bench = Bench::new(Winding::Brushed(RE35), with_dead_time());
        let torques = bench.run(240, |measured| drive.tick(0.052, measured));
        furthest(&torques[HALF_MILLISECOND..], 0.052) / 0.052
    };
    let (off, on) = (settled(&INVERTER), settled(&DEAD_TIME_COMPENSATED));
    assert!(off > 0.01, "{off}");
    assert!(on < 0.01, "{on}");
}

/// Standard deviation and largest error of a gimbal motor's torque over 0.1 s, relative to a command.
fn gimbal_error(
    sensing: CurrentSensing,
    torque_nm: f64,
    drive: impl FnMut(&Measured) -> Duties,
) -> (f64, f64) {
    let mut bench = Bench::with(
        Winding::ThreePhase(GIMBAL),
        late(),
        sensing,
        Supply::stiff(BUS_V),
    )
    .turning(2.0);
    let torques = &bench.run(4_800, drive)[2_400..];
    let middle = mean(torques);
    let variance = torques
        .iter()
        .map(|torque| (torque - middle).powi(2))
        .sum::<f64>();
    (
        (variance / torques.len() as f64).sqrt() / torque_nm,
        furthest(torques, torque_nm) / torque_nm,
    )
}

/// Noise of 0.2 A, as users report, is torque to a current loop, and nothing to a voltage drive. So is a
/// converter's step for a torque of half of it.
#[test]
fn noise_and_steps_of_the_current_are_kept_out_of_a_gimbal_motor() {
    let by_current = |sensing, torque_nm: f64| {
        let mut drive =
            CurrentLoop::new(&GIMBAL, &encoder(7), &INVERTER, &asked(10.0, 0.0)).unwrap();
        gimbal_error(sensing, torque_nm, |measured| {
            drive.tick(torque_nm as f32, measured)
        })
    };
    let by_voltage = |sensing, torque_nm: f64| {
        let drive = VoltageDrive::new(&GIMBAL, &encoder(7), &INVERTER, 10.0, 0.0).unwrap();
        gimbal_error(sensing, torque_nm, |measured| {
            drive.tick(torque_nm as f32, measured)
        })
    };
    let noise = CurrentSensing {
        noise_a: 0.2,
        ..CurrentSensing::default()
    };
    let ((noisy, _), (quiet, _)) = (by_current(noise, 0.02), by_voltage(noise, 0.02));
    assert!(noisy > 0.2 && quiet < 0.01, "{noisy} {quiet}");
    let steps = CurrentSensing {
        step_a: CURRENT_STEP_A,
        ..CurrentSensing::default()
    };
    let ((_, coarse), (_, fine)) = (by_current(steps, 1e-3), by_voltage(steps, 1e-3));
    assert!(coarse > 0.3 && fine < 0.01, "{coarse} {fine}");
}

/// A supply of 2 Ω sags under a gimbal motor by a twentieth; so does its torque, where the bus is taken for
/// what it was.
#[test]
fn the_bus_is_measured_not_assumed() {
    let soft = Supply {
        source_v: BUS_V,
        source_ohm: 2.0,
        capacitance_f: 8e-4,
        takes_back: false,
    };
    let error = |believed_bus_v| {
        let drive = VoltageDrive::new(&GIMBAL, &encoder(7), &INVERTER, 10.0, 0.0).unwrap();
        let sensing = CurrentSensing::default();
        let mut bench = Bench::with(Winding::ThreePhase(GIMBAL), late(), sensing, soft);
        bench.believed_bus_v = believed_bus_v;
        let torques = bench.run(4_800, |measured| drive.tick(0.1, measured));
        furthest(&torques[2_400..], 0.1) / 0.1
    };
    assert!(error(Some(BUS_V)) > 0.04, "{}", error(Some(BUS_V)));
    assert!(error(None) < 0.01, "{}", error(None));
}

/// Without the back-EMF a gimbal motor at 30 rad/s lacks 20 mNm.
#[test]
fn back_emf_is_put_on_top_of_the_voltage() {
    let error = |speed_told: f32| {
        let drive = VoltageDrive::new(&GIMBAL, &encoder(7), &INVERTER, 10.0, 0.0).unwrap();
        let mut bench = Bench::three_phase(&GIMBAL).turning(30.0);
        let torques = bench.run(2_400, |measured| {
            let told = Measured {
                speed_rad_s: speed_told * measured.speed_rad_s,
                ..*measured
            };
            drive.tick(0.05, &told)
        });
        furthest(&torques[1_200..], 0.05) / 0.05
    };
    assert!(error(0.0) > 0.3, "{}", error(0.0));
    assert!(error(1.0) < 0.01, "{}", error(1.0));
}

/// Offsets of the shunt amplifiers up to 8 A are found while nothing flows, and subtracted.
#[test]
fn offsets_of_the_converters_are_subtracted() {
    let sensing = CurrentSensing {
        step_a: CURRENT_STEP_A,
        offset_a: [8.0, -3.0],
        ..CurrentSensing::default()
    };
    let error = |sense: &CurrentSense| {
        let mut drive =
            CurrentLoop::new(&STRONG, &encoder(7), &INVERTER, &asked(10.0, 0.0)).unwrap();
        let mut bench = Bench::with(
            Winding::ThreePhase(STRONG),
            late(),
            sensing,
            Supply::stiff(BUS_V),
        )
        .turning(20.0);
        let torques = bench.run(9_600, |measured| {
            let PhaseCurrents { b_a, c_a } = measured.currents;
            let code = |current: f32| (2048.0 + f64::from(current) / CURRENT_STEP_A).round() as u16;
            let currents = sense.currents([code(b_a), code(c_a)]);
            drive.tick(
                0.2,
                &Measured {
                    currents,
                    ..*measured
                },
            )
        });
        (mean(&torques[2_400..]) / 0.2 - 1.0).abs() + furthest(&torques[2_400..], 0.2) / 0.2
    };
    let found = [8.0, -3.0].map(|offset: f64| 2048.0 + (offset / CURRENT_STEP_A).round());
    let ignored = CurrentSense::new(CURRENT_STEP_A, [2048.0; 2]).unwrap();
    let subtracted = CurrentSense::new(CURRENT_STEP_A, found).unwrap();
    assert!(error(&ignored) > 1.0, "{}", error(&ignored));
    assert!(error(&subtracted) < 0.02, "{}", error(&subtracted));
}

/// The step that the governor is told bounds the error, of currents in whole steps of the converter and of
/// duties in whole steps of the timer.
#[test]
fn the_governor_is_told_the_step_there_is() {
    let sensing = CurrentSensing {
        step_a: CURRENT_STEP_A,
        ..CurrentSensing::default()
    };
    let stepped = Inverter {
        pwm_steps: 3500,
        ..late()
    };
    let (mut by_current, mut by_voltage, mut by_brush) = (0.0_f64, 0.0_f64, 0.0_f64);
    for place in 0..200 {
        let angle = 0.17 * f64::from(place);
        let part = (0.618 * f64::from(place)).fract();
        let bench =
            |winding| Bench::with(winding, stepped, sensing, Supply::stiff(BUS_V)).at(angle);
        let mut drive =
            CurrentLoop::new(&STRONG, &encoder(7), &INVERTER, &asked(10.0, 0.0)).unwrap();
        let goal = 0.2 * part;
        let torques = bench(Winding::ThreePhase(STRONG))
            .run(2_400, |measured| drive.tick(goal as f32, measured));
        let told = drive.delivery().torque_step_nm;
        by_current = by_current.max(furthest(&torques[1_200..], goal) / told);

        let drive = VoltageDrive::new(&GIMBAL, &encoder(7), &INVERTER, 10.0, 0.0).unwrap();
        let goal = 0.1 * part;
        let torques = bench(Winding::ThreePhase(GIMBAL))
            .run(2_400, |measured| drive.tick(goal as f32, measured));
        by_voltage =
            by_voltage.max(furthest(&torques[1_200..], goal) / drive.delivery().torque_step_nm);

        let mut drive = BrushedLoop::new(&RE35, &INVERTER, &asked(5.0, 0.0)).unwrap();
        let goal = 0.2 * part;
        let torques =
            bench(Winding::Brushed(RE35)).run(2_400, |measured| drive.tick(goal as f32, measured));
        by_brush =
            by_brush.max(furthest(&torques[1_200..], goal) / drive.delivery().torque_step_nm);
    }
    println!("errors in steps: {by_current:.3} {by_voltage:.3} {by_brush:.3}");
    for (drive, error) in [
        ("current", by_current),
        ("voltage", by_voltage),
        ("brushed", by_brush),
    ] {
        // Half a step, and no less than a tenth: it is no idle bound.
        assert!((0.1..0.5).contains(&error), "{drive}: {error}");
    }
}

/// The speed ripple of a gimbal motor that coasts over its cogging, relative.
fn coasting_ripple(feed_forward: Option<&CoggingFeedForward>) -> f64 {
    let device = Device {
        inertia_kg_m2: 1e-5,
        viscous_nm_s_rad: 0.0,
        coulomb_nm: 0.0,
    };
    let cogs = Motor {
        cogging_nm: 2e-3,
        cogging_per_rev: 42.0,
        ..Motor::default()
    };
    let start = State {
        position: 0.0,
        velocity: 20.0,
    };
    let (hand, drive) = (Hand::default(), Drive::default());
    let mut knob = Knob::new(&device, &cogs, &hand, &drive, PERIOD_S, start).unwrap();
    let drive = VoltageDrive::new(&GIMBAL, &encoder(7), &INVERTER, 10.0, 0.0).unwrap();
    let mut bench = Bench::three_phase(&GIMBAL);
    let (mut state, mut slowest, mut fastest) = (start, f64::MAX, 0.0_f64);
    for _ in 0..12_000 {
        (bench.angle_rad, bench.velocity_rad_s) = (state.position, state.velocity);
        let measured = bench.measured();
        let torque = feed_forward.map_or(0.0, |cogging| cogging.torque_nm(measured.count));
        let duties = drive.tick(torque, &measured).parts().map(f64::from);
        let period = bench
            .plant
            .period(Some(duties), state.position, state.velocity);
        state = knob.hold(period.torque_nm, PERIOD_S).end;
        slowest = slowest.min(state.velocity);
        fastest = fastest.max(state.velocity);
    }
    (fastest - slowest) / start.velocity
}

/// Cogging that is known is undone by a torque in its counter-phase.
#[test]
fn cogging_is_undone() {
    let encoder = EncoderOnMotor {
        counts_per_rev: COUNTS_PER_REV,
        zero_turns: 0.5 * 42.0 / f64::from(COUNTS_PER_REV),
    };
    let feed_forward = CoggingFeedForward::new(2e-3, 42, &encoder).unwrap();
    let (off, on) = (coasting_ripple(None), coasting_ripple(Some(&feed_forward)));
    println!("cogging: {off:.4} without, {on:.4} with");
    assert!(off > 0.02, "{off}");
    assert!(on < 0.4 * off, "{on} of {off}");
}

/// All at once: what is measured is noisy, offset and stepped, the bridge late, dead in between and
/// stepped, the bus soft. The mean torque is within 1 %.
#[test]
fn torque_is_within_a_hundredth_with_everything_at_once() {
    let inverter = Inverter {
        pwm_steps: 3500,
        ..with_dead_time()
    };
    let sensing = CurrentSensing {
        step_a: CURRENT_STEP_A,
        noise_a: 0.1,
        offset_a: [0.0; 2],
        seed: 11,
    };
    let soft = Supply {
        source_v: BUS_V,
        source_ohm: 0.2,
        capacitance_f: 8e-4,
        takes_back: false,
    };
    let bench = |winding| Bench::with(winding, inverter, sensing, soft).turning(10.0);
    let config = &DEAD_TIME_COMPENSATED;
    for part in [-1.0, -0.3, 0.1, 0.3, 1.0] {
        let goal = 0.3 * part;
        let mut drive = CurrentLoop::new(&STRONG, &encoder(7), config, &asked(10.0, 0.3)).unwrap();
        let torques = bench(Winding::ThreePhase(STRONG))
            .run(24_000, |measured| drive.tick(goal as f32, measured));
        let error = (mean(&torques[1_200..]) / goal - 1.0).abs();
        assert!(error < 0.01, "current, {goal}: {error}");

        let goal = 0.1 * part;
        let drive = VoltageDrive::new(&GIMBAL, &encoder(7), config, 2.0, 0.3).unwrap();
        let torques = bench(Winding::ThreePhase(GIMBAL))
            .run(24_000, |measured| drive.tick(goal as f32, measured));
        let error = (mean(&torques[1_200..]) / goal - 1.0).abs();
        assert!(error < 0.01, "voltage, {goal}: {error}");

        let goal = 0.2 * part;
        let mut drive = BrushedLoop::new(&RE35, config, &asked(5.0, 0.3)).unwrap();
        let torques =
            bench(Winding::Brushed(RE35)).run(24_000, |measured| drive.tick(goal as f32, measured));
        let error = (mean(&torques[1_200..]) / goal - 1.0).abs();
        assert!(error < 0.01, "brushed, {goal}: {error}");
    }
}

/// A knob behind its drive: a haptic tick every so many PWM periods, in the same interrupt, its torque held
/// until the next. Returns its largest energy in the first and in the last fifth of a run, J.
fn energy_of_a_spring(
    config: &Config,
    device: &Device<f64>,
    every: u32,
    mut drive: impl FnMut(f32, &Measured) -> Duties,
    winding: Winding,
) -> (f64, f64) {
    let start = State {
        position: 0.0,
        velocity: 20.0,
    };
    let (hand, ideal) = (Hand::default(), Drive::default());
    let mut knob = Knob::new(device, &Motor::default(), &hand, &ideal, PERIOD_S, start).unwrap();
    let mut bench = Bench::new(winding, late());
    let mut controller = Controller::new(Plan::new(config).unwrap(), 0);
    let (mut state, mut torque, mut count_before) = (start, 0.0, 0);
    let mut speed = 0.0;
    let periods = 96_000;
    let (mut first, mut last) = (0.0_f64, 0.0_f64);
    for period in 0..periods {
        (bench.angle_rad, bench.velocity_rad_s) = (state.position, state.velocity);
        let measured = bench.measured();
        if period % every == 0 {
            let count = measured.count;
            torque = controller
                .tick(count as u32, config.timing.period_s as f32)
                .torque_nm;
            let moved = f64::from(count - count_before) * config.hardware_count_rad;
            speed = (moved / config.timing.period_s) as f32;
            count_before = count;
        }
        let told = Measured {
            speed_rad_s: speed,
            ..measured
        };
        let duties = drive(torque, &told).parts().map(f64::from);
        let given = bench
            .plant
            .period(Some(duties), state.position, state.velocity);
        state = knob.hold(given.torque_nm, PERIOD_S).end;
        let energy = 0.5 * device.inertia_kg_m2 * state.velocity.powi(2);
        if period < periods / 5 {
            first = first.max(energy);
        } else if period >= periods / 5 * 4 {
            last = last.max(energy);
        }
    }
    (first, last)
}

/// A spring as stiff as a governor allows who knows nothing of the drive gains energy through its lag; told
/// the delivery, the governor allows less, and it gains none.
#[test]
fn the_governor_keeps_a_spring_passive_when_it_knows_the_drive() {
    let device = Device {
        inertia_kg_m2: 5e-5,
        viscous_nm_s_rad: 2e-5,
        coulomb_nm: 1e-4,
    };
    let every = 4;
    let timing = Timing::ideal(f64::from(every) * PERIOD_S);
    let told = |delivery: Option<&Delivery>| Config {
        believed: Believed::exactly(&device),
        timing: Timing {
            delay_s: delivery.map_or(0.0, |delivery| delivery.delay_s),
            amplifier_tau_s: delivery.map_or(0.0, |delivery| delivery.tau_s),
            ..timing
        },
        torque_step_nm: 0.0,
        hardware_count_rad: TAU / f64::from(COUNTS_PER_REV),
        encoder: EncoderConfig::new(32, 1).unwrap(),
        shape: Shape::Spring { centre_rad: 0.0 },
        // More than any of them allows, at any speed.
        stiffness_nm_rad: 2.0,
        damping_nm_s_rad: 0.0,
        law: Law::Static,
        torque_max_nm: 1.0,
    };
    let gain =
        |delivery: Option<&Delivery>, drive: &mut dyn FnMut(f32, &Measured) -> Duties, winding| {
            let config = told(delivery);
            let (first, last) = energy_of_a_spring(&config, &device, every, drive, winding);
            last / first
        };
    let brushed = || BrushedLoop::new(&RE35, &INVERTER, &asked(9.0, 0.0)).unwrap();
    let known = brushed().delivery();
    let mut drive = brushed();
    let naive = gain(None, &mut |t, m| drive.tick(t, m), Winding::Brushed(RE35));
    let mut drive = brushed();
    let informed = gain(
        Some(&known),
        &mut |t, m| drive.tick(t, m),
        Winding::Brushed(RE35),
    );
    println!("energy, brushed: x {naive:.2} naive, x {informed:.4} informed");
    assert!(naive > 1.5, "{naive}");
    assert!(informed < 1.0, "{informed}");

    let strong = || CurrentLoop::new(&STRONG, &encoder(7), &INVERTER, &asked(9.0, 0.0)).unwrap();
    let known = strong().delivery();
    let mut drive = strong();
    let naive = gain(
        None,
        &mut |t, m| drive.tick(t, m),
        Winding::ThreePhase(STRONG),
    );
    let mut drive = strong();
    let informed = gain(
        Some(&known),
        &mut |t, m| drive.tick(t, m),
        Winding::ThreePhase(STRONG),
    );
    println!("energy, three-phase: x {naive:.2} naive, x {informed:.4} informed");
    assert!(naive > 1.5, "{naive}");
    assert!(informed < 1.0, "{informed}");

    let gimbal = VoltageDrive::new(&GIMBAL, &encoder(7), &INVERTER, 5.0, 0.0).unwrap();
    let known = gimbal.delivery();
    let mut tick = |t: f32, m: &Measured| gimbal.tick(t, m);
    let naive = gain(None, &mut tick, Winding::ThreePhase(GIMBAL));
    let informed = gain(Some(&known), &mut tick, Winding::ThreePhase(GIMBAL));
    println!("energy, gimbal: x {naive:.2} naive, x {informed:.4} informed");
    // Until its voltage is at its end.
    assert!(naive > 1.3, "{naive}");
    assert!(informed < 1.0, "{informed}");
}

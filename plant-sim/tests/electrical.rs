//! Laws of [`plant_sim::electrical`]: it agrees with a Runge–Kutta integration in the windings' own
//! frame, keeps energy, and each thing a real inverter adds does what it says.

use control::torque::{BrushedMotor, ThreePhaseMotor};
use plant_sim::electrical::{CurrentSensing, Electrical, Inverter, Supply, Winding};
use proptest::prelude::*;

const PERIOD_S: f64 = 1.0 / 24e3;

fn motors() -> impl Strategy<Value = ThreePhaseMotor> {
    (
        0.05..15.0f64,
        1e-4..4e-3f64,
        0.5..2.0f64,
        1e-3..5e-2f64,
        1..15_u32,
    )
        .prop_map(
            |(resistance_ohm, time_constant_s, saliency, flux_wb, pole_pairs)| ThreePhaseMotor {
                resistance_ohm,
                d_inductance_h: resistance_ohm * time_constant_s,
                q_inductance_h: saliency * resistance_ohm * time_constant_s,
                flux_wb,
                pole_pairs,
            },
        )
}

fn duties() -> impl Strategy<Value = Vec<[f64; 3]>> {
    prop::collection::vec([0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64], 1..8)
}

fn ideal(winding: Winding) -> Electrical {
    Electrical::new(
        winding,
        Inverter::ideal(PERIOD_S),
        CurrentSensing::default(),
        Supply::stiff(24.0),
    )
    .unwrap()
}

/// The windings by classical Runge–Kutta, in their own frame, by flux linkages λ of α and β:
/// λ' = u − R i. Currents are found from the flux by turning to the rotor's frame: an independent way.
struct Rk {
    motor: ThreePhaseMotor,
    /// λ_α, λ_β, ∫torque, ∫power, ∫copper loss.
    y: [f64; 5],
}

impl Rk {
    fn new(motor: ThreePhaseMotor) -> Self {
        Self {
            motor,
            y: [motor.flux_wb, 0.0, 0.0, 0.0, 0.0],
        }
    }

    /// i_d, i_q.
    fn rotor(&self, y: &[f64; 5], theta: f64) -> [f64; 2] {
        let (s, c) = theta.sin_cos();
        let (d, q) = (y[0] * c + y[1] * s, y[1] * c - y[0] * s);
        [
            (d - self.motor.flux_wb) / self.motor.d_inductance_h,
            q / self.motor.q_inductance_h,
        ]
    }

    fn slope(&self, y: &[f64; 5], theta: f64, u: [f64; 2]) -> [f64; 5] {
        let (s, c) = theta.sin_cos();
        let [d, q] = self.rotor(y, theta);
        let (alpha, beta) = (d * c - q * s, d * s + q * c);
        let r = self.motor.resistance_ohm;
        // Torque as the cross product of flux and current.
        let torque = 1.5 * f64::from(self.motor.pole_pairs) * (y[0] * beta - y[1] * alpha);
        [
            u[0] - r * alpha,
            u[1] - r * beta,
            torque,
            1.5 * (u[0] * alpha + u[1] * beta),
            1.5 * r * (alpha * alpha + beta * beta),
        ]
    }

    fn period(&mut self, u: [f64; 2], theta: f64, omega: f64) {
        let steps = 400;
        let h = PERIOD_S / f64::from(steps);
        let add = |y: &[f64; 5], k: &[f64; 5], f: f64| -> [f64; 5] {
            std::array::from_fn(|i| y[i] + f * k[i])
        };
        for n in 0..steps {
            let t = theta + omega * h * f64::from(n);
            let k1 = self.slope(&self.y, t, u);
            let k2 = self.slope(&add(&self.y, &k1, h / 2.0), t + omega * h / 2.0, u);
            let k3 = self.slope(&add(&self.y, &k2, h / 2.0), t + omega * h / 2.0, u);
            let k4 = self.slope(&add(&self.y, &k3, h), t + omega * h, u);
            for i in 0..5 {
                self.y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn it_agrees_with_runge_kutta_in_the_windings_frame(
        motor in motors(), duties in duties(), start in -3.0..3.0f64, electrical_rad_s in -4e3..4e3f64,
    ) {
        let velocity = electrical_rad_s / f64::from(motor.pole_pairs);
        let mut plant = ideal(Winding::ThreePhase(motor));
        let p = f64::from(motor.pole_pairs);
        let mut rk = Rk::new(motor);
        let (s, c) = (p * start).sin_cos();
        (rk.y[0], rk.y[1]) = (motor.flux_wb * c, motor.flux_wb * s);
        let scale_a = 24.0 * PERIOD_S / motor.d_inductance_h.min(motor.q_inductance_h)
            + electrical_rad_s.abs() * motor.flux_wb * PERIOD_S / motor.q_inductance_h.min(motor.d_inductance_h);
        let scale_nm = 1.5 * p * (motor.flux_wb
            + (motor.d_inductance_h - motor.q_inductance_h).abs() * scale_a) * scale_a;
        for (n, duty) in duties.iter().enumerate() {
            let angle = start + velocity * PERIOD_S * n as f64;
            let [a, b, c] = duty.map(|part| 24.0 * part);
            let u = [(2.0 * a - b - c) / 3.0, (b - c) / 3.0_f64.sqrt()];
            let before = rk.y;
            rk.period(u, p * angle, electrical_rad_s);
            let period = plant.period(Some(*duty), angle, velocity);
            let after = p * (angle + velocity * PERIOD_S);
            for (ours, theirs) in plant.rotor_currents().iter().zip(rk.rotor(&rk.y, after)) {
                prop_assert!((ours - theirs).abs() < 1e-8 * scale_a, "{ours} {theirs} {scale_a}");
            }
            let torque = (rk.y[2] - before[2]) / PERIOD_S;
            prop_assert!((period.torque_nm - torque).abs() < 1e-5 * scale_nm, "{period:?} {torque} scale {scale_nm} diff {}", period.torque_nm - torque);
        }
    }

    /// What is drawn is lost in copper, stored in inductance or turned into work.
    #[test]
    fn energy_is_kept(
        motor in motors(), duties in duties(), start in -3.0..3.0f64, electrical_rad_s in -4e3..4e3f64,
    ) {
        let velocity = electrical_rad_s / f64::from(motor.pole_pairs);
        let mut plant = ideal(Winding::ThreePhase(motor));
        let mut rk = Rk::new(motor);
        let p = f64::from(motor.pole_pairs);
        let (s, c) = (p * start).sin_cos();
        (rk.y[0], rk.y[1]) = (motor.flux_wb * c, motor.flux_wb * s);
        let (mut drawn, mut work, mut turnover) = (0.0, 0.0, 0.0);
        for (n, duty) in duties.iter().enumerate() {
            let angle = start + velocity * PERIOD_S * n as f64;
            let [a, b, c] = duty.map(|part| 24.0 * part);
            rk.period([(2.0 * a - b - c) / 3.0, (b - c) / 3.0_f64.sqrt()], p * angle, electrical_rad_s);
            let period = plant.period(Some(*duty), angle, velocity);
            drawn += period.drawn_j;
            work += period.torque_nm * velocity * PERIOD_S;
            turnover += period.drawn_j.abs() + (period.torque_nm * velocity * PERIOD_S).abs();
        }
        let [d, q] = plant.rotor_currents();
        let stored = 0.75 * (motor.d_inductance_h * d * d + motor.q_inductance_h * q * q);
        let copper = rk.y[4];
        prop_assert!((drawn - work - stored - copper).abs() < 1e-5 * (turnover + stored + copper), "{drawn} {work} {stored} {copper} {turnover}");
    }

    /// A brushed motor goes to (u − k·speed)/R with L/R.
    #[test]
    fn a_brushed_motor_is_an_exponential(
        resistance_ohm in 0.1..20.0f64, time_constant_s in 5e-5..5e-3f64, k in 1e-3..0.2f64,
        b in 0.0..1.0f64, c in 0.0..1.0f64, velocity in -300.0..300.0f64, periods in 1..40_u32,
    ) {
        let motor = BrushedMotor {
            resistance_ohm, inductance_h: resistance_ohm * time_constant_s, torque_constant_nm_a: k,
        };
        let mut plant = ideal(Winding::Brushed(motor));
        for _ in 0..periods {
            plant.period(Some([0.0, b, c]), 0.0, velocity);
        }
        let goal = (24.0 * (b - c) - k * velocity) / resistance_ohm;
        let left = (-f64::from(periods) * PERIOD_S / time_constant_s).exp();
        let scale = (24.0 + k * velocity.abs()) / resistance_ohm;
        prop_assert!((plant.rotor_currents()[0] - goal * (1.0 - left)).abs() < 1e-12 * scale);
    }
}

fn brushed() -> BrushedMotor {
    BrushedMotor {
        resistance_ohm: 2.0,
        inductance_h: 1e-3,
        torque_constant_nm_a: 0.05,
    }
}

fn with(inverter: Inverter, sensing: CurrentSensing, supply: Supply) -> Electrical {
    Electrical::new(Winding::Brushed(brushed()), inverter, sensing, supply).unwrap()
}

fn at_rest(plant: &mut Electrical, duties: [f64; 3], periods: u32) -> f64 {
    for _ in 0..periods {
        plant.period(Some(duties), 0.0, 0.0);
    }
    plant.rotor_currents()[0]
}

#[test]
fn dead_time_takes_its_part_of_the_bus_off_both_phases() {
    let inverter = Inverter {
        dead_time_s: 0.5e-6,
        ..Inverter::ideal(PERIOD_S)
    };
    let mut plant = with(inverter, CurrentSensing::default(), Supply::stiff(24.0));
    let current = at_rest(&mut plant, [0.0, 0.6, 0.4], 2_000);
    let lost = 2.0 * 24.0 * 0.5e-6 * 24e3;
    assert!((current - (4.8 - lost) / 2.0).abs() < 1e-9, "{current}");
}

#[test]
fn duties_act_a_period_late_and_in_whole_steps() {
    let inverter = Inverter {
        late: true,
        pwm_steps: 10,
        ..Inverter::ideal(PERIOD_S)
    };
    let mut plant = with(inverter, CurrentSensing::default(), Supply::stiff(24.0));
    assert_eq!(at_rest(&mut plant, [0.0, 0.64, 0.4], 1), 0.0);
    let current = at_rest(&mut plant, [0.0; 3], 1);
    let exact = 24.0 * 0.2 / 2.0 * -(-PERIOD_S * 2.0 / 1e-3).exp_m1();
    assert!((current - exact).abs() < 1e-12, "{current} {exact}");
}

#[test]
fn a_measurement_is_rounded_offset_and_noisy_as_stated() {
    let sensing = CurrentSensing {
        step_a: 0.02,
        noise_a: 0.3,
        offset_a: [1.0, -2.0],
        seed: 7,
    };
    let mut plant = with(Inverter::ideal(PERIOD_S), sensing, Supply::stiff(24.0));
    let n = 40_000;
    let (mut sum, mut squares) = ([0.0; 2], [0.0; 2]);
    for _ in 0..n {
        for (k, current) in plant.measure(0.0).into_iter().enumerate() {
            assert!((current / 0.02 - (current / 0.02).round()).abs() < 1e-6);
            sum[k] += current;
            squares[k] += current * current;
        }
    }
    for (k, offset) in [1.0, -2.0].into_iter().enumerate() {
        let mean = sum[k] / f64::from(n);
        let deviation = (squares[k] / f64::from(n) - mean * mean).sqrt();
        assert!((mean - offset).abs() < 0.006, "{mean}");
        assert!((deviation - 0.3).abs() < 0.005, "{deviation}");
    }
}

#[test]
fn a_soft_bus_sags_under_load_and_rises_when_it_cannot_give_back() {
    let soft = Supply {
        source_v: 24.0,
        source_ohm: 0.5,
        capacitance_f: 8e-4,
        takes_back: false,
    };
    let mut plant = with(Inverter::ideal(PERIOD_S), CurrentSensing::default(), soft);
    let current = at_rest(&mut plant, [0.0, 0.75, 0.25], 2_000);
    // Half the bus on 2 Ω: v = 24 − 0.5·(v/4)/2.
    let bus = 24.0 / (1.0 + 0.5 / 8.0);
    assert!((plant.bus_v() - bus).abs() < 1e-6, "{}", plant.bus_v());
    assert!((current - bus / 4.0).abs() < 1e-6);
    // Driven from outside and shorted against its EMF, the motor feeds the bus.
    let before = plant.bus_v();
    for _ in 0..2_000 {
        plant.period(Some([0.0, 0.6, 0.4]), 0.0, 300.0);
    }
    assert!(plant.bus_v() > before.max(24.5), "{}", plant.bus_v());
}

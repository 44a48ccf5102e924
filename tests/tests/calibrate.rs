//! Random motors on the electrical plant, measured by the device's excitations and judged by the host; and
//! every way to set one up wrongly that is noticed.

use control::criterion::Device;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use firmware::commission::{self, Run};
use firmware::power::{self, Bridge, ODRIVE_V3_24V};
use host_cli::calibrate::{self, Bench, Found, Recorded, Refusal, Step, Told};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::identify::Estimate;
use plant_sim::motor::Motor;
use plant_sim::powered::{EncoderSetup, Powered, Setup};
use protocol::{Excitation, PowerStage};
use rayon::prelude::*;

/// A board and its motor.
struct Board {
    knob: Powered,
    periods: u64,
    /// The largest current that any phase bore, A.
    most_a: f64,
    fastest_rad_s: f64,
}

impl Board {
    fn new(setup: &Setup) -> Self {
        Self {
            knob: Powered::new(setup).unwrap(),
            periods: 0,
            most_a: 0.0,
            fastest_rad_s: 0.0,
        }
    }

    fn period(&mut self, bridge: Bridge) {
        self.knob.period(match bridge {
            Bridge::Off => None,
            Bridge::On(duties) => Some(duties.parts().map(f64::from)),
        });
        self.periods += 1;
        for current in self.knob.phase_currents() {
            self.most_a = self.most_a.max(current.abs());
        }
        self.fastest_rad_s = self.fastest_rad_s.max(self.knob.state().velocity.abs());
    }
}

impl Bench for Board {
    type Error = Refusal;

    fn power_stage(&self) -> PowerStage {
        commission::power_stage(&ODRIVE_V3_24V)
    }

    fn excite(&mut self, excitation: &Excitation) -> Result<Recorded, Refusal> {
        let mut run = Run::new(excitation, &ODRIVE_V3_24V)
            .unwrap_or_else(|error| panic!("{error:?}: {excitation:?}"));
        let mut windows = Vec::new();
        loop {
            let sensed = self.knob.sensed();
            let step = run.tick(
                &power::Sensed {
                    currents: sensed.codes,
                    bus_v: sensed.bus_v as f32,
                    counter: sensed.counter,
                },
                sensed.counter as i32,
            );
            windows.extend(step.sums);
            self.period(step.bridge);
            if let Some(end) = step.end {
                // Until the host asks for the next.
                for _ in 0..120 {
                    self.period(Bridge::Off);
                }
                return Ok(Recorded { windows, end });
            }
        }
    }

    fn begin(&mut self, _: Step) {}
}

/// Numbers that are the same each time: splitmix64.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ z >> 31) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    /// Evenly in the logarithm.
    fn log(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn whole(&mut self, low: u32, high: u32) -> u32 {
        self.between(f64::from(low), f64::from(high) + 1.0) as u32
    }
}

/// A set-up and what its user would tell.
#[derive(Clone, Copy)]
struct Case {
    setup: Setup,
    told: Told,
}

/// What every board and every encoder has.
fn around(dice: &mut Dice, winding: Winding, device: Device<f64>, motor: Motor) -> Setup {
    let dead_time_s = ODRIVE_V3_24V.dead_time_s * dice.between(0.8, 1.2) * std::env::var("DT").map_or(1.0, |d| d.parse().unwrap());
    Setup {
        device,
        motor,
        hand: Hand::default(),
        winding,
        inverter: Inverter {
            pwm_period_s: ODRIVE_V3_24V.pwm_period_s,
            pwm_steps: ODRIVE_V3_24V.pwm_steps,
            dead_time_s,
            dead_time_edge_a: ODRIVE_V3_24V.dead_time_edge_a * dice.between(0.7, 1.3),
            late: true,
        },
        sensing: CurrentSensing {
            step_a: ODRIVE_V3_24V.current_step_a,
            noise_a: dice.between(0.01, 0.08),
            offset_a: [dice.between(-4.0, 4.0), dice.between(-4.0, 4.0)],
            seed: (dice.next() * 1e9) as u64,
        },
        supply: Supply {
            source_v: dice.between(12.0, 24.0),
            source_ohm: dice.between(0.05, 0.3),
            capacitance_f: dice.log(0.4e-3, 3e-3),
            takes_back: true,
        },
        encoder: EncoderSetup {
            counts_per_rev: [4096, 8192, 16_384][dice.whole(0, 2) as usize],
            reversed: dice.next() < 0.5,
            zero_turns: dice.next(),
        },
        start: State {
            position: dice.between(-3.0, 3.0),
            velocity: 0.0,
        },
    }
}

/// From drones' motors to gimbals'.
fn three_phase(seed: u64) -> Case {
    let mut dice = Dice(seed);
    let resistance_ohm = dice.log(0.04, 12.0);
    let d_inductance_h = resistance_ohm * dice.log(0.2e-3, 1.2e-3);
    let q_inductance_h = d_inductance_h * dice.between(1.0, 1.6);
    let constant_nm_a = resistance_ohm.sqrt() * dice.between(0.02, 0.05);
    let pole_pairs = dice.whole(2, 16);
    let current_max_a = dice.between(2.0, 5.0) * resistance_ohm.powf(-0.25);
    let flux_wb = constant_nm_a / 1.5 / f64::from(pole_pairs);
    let winding = Winding::ThreePhase(ThreePhaseMotor {
        resistance_ohm,
        d_inductance_h,
        q_inductance_h,
        flux_wb,
        pole_pairs,
    });
    // What the field can turn it with.
    let torque_nm = constant_nm_a * (0.5 * current_max_a).min(0.4 * 12.0 / resistance_ohm);
    let device = Device {
        inertia_kg_m2: dice.log(3e-6, 3e-5),
        viscous_nm_s_rad: dice.log(1e-6, 2e-5),
        coulomb_nm: torque_nm * dice.between(0.01, 0.15),
    };
    let motor = Motor {
        cogging_nm: torque_nm * dice.between(0.0, 0.15),
        cogging_per_rev: f64::from(pole_pairs * [6, 12][dice.whole(0, 1) as usize]),
        ..Motor::default()
    };
    let kv_rpm_v = 60.0 / (std::f64::consts::TAU * 3.0_f64.sqrt() * f64::from(pole_pairs) * flux_wb);
    let mut setup = around(&mut dice, winding, device, motor);
    // Where cogging lets it rest.
    let cog_rad = std::f64::consts::TAU / motor.cogging_per_rev;
    setup.start.position = (setup.start.position / cog_rad).round() * cog_rad;
    let told = Told {
        winding: calibrate::Winding::ThreePhase,
        pole_pairs: (dice.next() < 0.5).then_some(pole_pairs),
        kv_rpm_v: (dice.next() < 0.5).then_some(kv_rpm_v * dice.between(0.95, 1.05)),
        current_max_a,
        counts_per_rev: setup.encoder.counts_per_rev,
    };
    Case { setup, told }
}

/// Brushed motors, as strong for their size as the others.
fn brushed(seed: u64) -> Case {
    let mut dice = Dice(seed ^ 0xB205_4ED0);
    let resistance_ohm = dice.log(0.3, 10.0);
    let inductance_h = resistance_ohm * dice.log(0.15e-3, 0.8e-3);
    let torque_constant_nm_a = resistance_ohm.sqrt() * dice.between(0.015, 0.04);
    let current_max_a = dice.between(3.0, 6.0) * resistance_ohm.powf(-0.4);
    let winding = Winding::Brushed(BrushedMotor {
        resistance_ohm,
        inductance_h,
        torque_constant_nm_a,
    });
    let torque_nm = torque_constant_nm_a * 0.15 * current_max_a;
    let device = Device {
        inertia_kg_m2: dice.log(5e-6, 4e-5),
        viscous_nm_s_rad: dice.log(1e-6, 1e-5),
        coulomb_nm: torque_nm * dice.between(0.02, 0.4),
    };
    let motor = Motor {
        cogging_nm: torque_nm * dice.between(0.0, 0.2),
        cogging_per_rev: f64::from(dice.whole(5, 13)),
        ..Motor::default()
    };
    let mut setup = around(&mut dice, winding, device, motor);
    let cog_rad = std::f64::consts::TAU / motor.cogging_per_rev;
    setup.start.position = (setup.start.position / cog_rad).round() * cog_rad;
    let kv_rpm_v = 60.0 / (std::f64::consts::TAU * torque_constant_nm_a);
    let told = Told {
        winding: calibrate::Winding::Brushed,
        pole_pairs: None,
        kv_rpm_v: (dice.next() < 0.5).then_some(kv_rpm_v * dice.between(0.95, 1.05)),
        current_max_a,
        counts_per_rev: setup.encoder.counts_per_rev,
    };
    Case { setup, told }
}

fn holds(of: &Estimate, truth: f64) -> bool {
    of.holds(truth)
}

fn report(seed: u64, case: &Case, result: &Result<Found, Refusal>, board: &Board) -> String {
    let (r, d, q, k, p) = match case.setup.winding {
        Winding::ThreePhase(m) => (m.resistance_ohm, m.d_inductance_h, m.q_inductance_h, m.torque_constant_nm_a(), m.pole_pairs),
        Winding::Brushed(m) => (m.resistance_ohm, m.inductance_h, m.inductance_h, m.torque_constant_nm_a, 1),
    };
    match result {
        Err(refusal) => format!("{seed} REFUSED {refusal} | {:?} max {} {:?} {:?}", case.setup.winding, case.told.current_max_a, case.setup.device, case.setup.motor),
        Ok(found) => {
            let one = |e: &Estimate, t: f64| format!("{}{:+.2}%±{:.1}", if holds(e, t) { ' ' } else { 'X' }, 100.0 * (e.value / t - 1.0), 100.0 * e.half_width());
            let zero = if found.zero_turns.high == 0.0 { String::new() } else {
                let off = (found.zero_turns.value - case.setup.encoder.zero_turns + 0.5).rem_euclid(1.0) - 0.5;
                let half = 0.5 * (found.zero_turns.high - found.zero_turns.low);
                format!("{}{:+.4}±{:.4}", if off.abs() <= half { ' ' } else { 'X' }, off, half)
            };
            let Found { pole_pairs, reversed, .. } = found;
            format!("{seed} R{:.2} I{:.1} p{} {} | R {} Ld {} Lq {} zero {zero} k {} meas {} | {:.1}s most {:.2} of {:.2} v {:.0}",
                r, case.told.current_max_a, pole_pairs, if *reversed == case.setup.encoder.reversed && *pole_pairs == p { "ok" } else { "WRONG" },
                one(&found.resistance_ohm, r), one(&found.d_inductance_h, d), one(&found.q_inductance_h, q),
                one(&found.torque_constant_nm_a, k), one(&found.measured_constant_nm_a, k), board.periods as f64 / 24e3, board.most_a, case.told.current_max_a, board.fastest_rad_s)
        }
    }
}

#[test]
fn scratch() {
    let env = |name: &str, or: u64| std::env::var(name).map_or(or, |n| n.parse().unwrap());
    let (number, from, brushed_too) = (env("N", 20), env("FROM", 0), env("B", 0));
    let rows: Vec<String> = (from..from + number)
        .into_par_iter()
        .map(|seed| {
            let case = if brushed_too == 1 { brushed(seed) } else { three_phase(seed) };
            let mut board = Board::new(&case.setup);
            let result = calibrate::calibrate(&mut board, &case.told);
            report(seed, &case, &result, &board)
        })
        .collect();
    for row in rows { println!("{row}"); }
}

//! Random motors on the electrical plant, measured by the device's excitations and judged by the host; and
//! every way to set one up wrongly that is noticed.

use control::criterion::Device;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use firmware::commission::{self, Run};
use firmware::power::{self, Bridge, ODRIVE_V3_24V};
use host_cli::calibrate::{self, Bench, Found, Phase, Recorded, Refusal, Step, Told};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding, Wiring};
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::identify::Estimate;
use plant_sim::motor::Motor;
use plant_sim::powered::{EncoderFault, EncoderSetup, Powered, Setup};
use protocol::{Excitation, PowerStage};
use rayon::prelude::*;

/// A board and its motor.
struct Board {
    knob: Powered,
    periods: u64,
    /// The largest current that any phase bore, A.
    most_a: f64,
    fastest_rad_s: f64,
    counts_per_pole_pair: Option<f64>,
    /// The count leaps at this part of the field's turn, by so many.
    leap: Option<(f64, i32)>,
    step: Step,
}

impl Board {
    fn new(setup: &Setup) -> Self {
        Self {
            knob: Powered::new(setup).unwrap(),
            periods: 0,
            most_a: 0.0,
            fastest_rad_s: 0.0,
            counts_per_pole_pair: match setup.winding {
                Winding::ThreePhase(motor) => {
                    Some(f64::from(setup.encoder.counts_per_rev) / f64::from(motor.pole_pairs))
                }
                Winding::Brushed(_) => None,
            },
            leap: None,
            step: Step::Offsets,
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
        let mut leap = self.leap.filter(|_| self.step == Step::Turn);
        loop {
            if let Some((at, counts)) = leap
                && windows.len() as f64 > at * f64::from(excitation.windows)
            {
                self.knob.slip(counts);
                leap = None;
            }
            let sensed = self.knob.sensed();
            let step = run.tick(
                &power::Sensed {
                    currents: sensed.codes,
                    bus_v: sensed.bus_v as f32,
                    counter: sensed.counter,
                },
                sensed.counter as i32,
            );
            if step.window_over {
                windows.push(*run.sums());
            }
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

    fn begin(&mut self, step: Step) {
        self.step = step;
    }
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
    let dead_time_s = ODRIVE_V3_24V.dead_time_s * dice.between(0.8, 1.2);
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
    let kv_rpm_v =
        60.0 / (std::f64::consts::TAU * 3.0_f64.sqrt() * f64::from(pole_pairs) * flux_wb);
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

fn measured(case: &Case, sabotage: impl FnOnce(&mut Board)) -> (Result<Found, Refusal>, Board) {
    let mut board = Board::new(&case.setup);
    sabotage(&mut board);
    let result = calibrate::calibrate(&mut board, &case.told);
    // The stop is in force a period after the current was seen; in a short it grows until then.
    let late_a = match case.setup.winding {
        Winding::ThreePhase(motor) if motor.resistance_ohm < 0.01 => 0.6,
        _ => 0.1,
    };
    assert!(
        board.most_a <= case.told.current_max_a * 1.02 + late_a,
        "{} A of {}",
        board.most_a,
        case.told.current_max_a
    );
    // Nothing is left on.
    assert!(
        board
            .knob
            .phase_currents()
            .iter()
            .all(|current| current.abs() < 1e-3)
    );
    (result, board)
}

/// How often an interval held the truth.
#[derive(Default, Debug)]
struct Tally {
    held: u32,
    of: u32,
    widest: f64,
}

impl Tally {
    fn add(&mut self, estimate: &Estimate, truth: f64) {
        self.of += 1;
        self.held += u32::from(estimate.holds(truth));
        self.widest = self.widest.max(estimate.half_width());
    }

    fn check(&self, name: &str) {
        println!("{name}: {self:?}");
        assert!(
            f64::from(self.held) >= 0.95 * f64::from(self.of),
            "{name}: {self:?}"
        );
    }
}

/// An angle is as right a turn further.
fn near(zero: &Estimate, truth: f64) -> f64 {
    zero.value + (truth - zero.value + 0.5).rem_euclid(1.0) - 0.5
}

#[test]
fn two_hundred_random_motors_lie_inside_their_intervals() {
    let three: Vec<(Case, Found)> = (0..140_u64)
        .into_par_iter()
        .map(|seed| {
            let case = three_phase(seed);
            let (result, _) = measured(&case, |_| {});
            (
                case,
                result.unwrap_or_else(|refusal| panic!("motor {seed}: {refusal}")),
            )
        })
        .collect();
    let mut tallies: [Tally; 6] = Default::default();
    for (case, found) in &three {
        let Winding::ThreePhase(motor) = case.setup.winding else {
            panic!("not three phases");
        };
        assert_eq!(found.pole_pairs, motor.pole_pairs);
        assert_eq!(found.reversed, case.setup.encoder.reversed);
        let [r, d, q, k, zero, measured] = &mut tallies;
        r.add(&found.resistance_ohm, motor.resistance_ohm);
        d.add(&found.d_inductance_h, motor.d_inductance_h);
        q.add(&found.q_inductance_h, motor.q_inductance_h);
        k.add(&found.torque_constant_nm_a, motor.torque_constant_nm_a());
        measured.add(&found.measured_constant_nm_a, motor.torque_constant_nm_a());
        let Estimate { low, high, .. } = found.zero_turns;
        zero.add(
            &found.zero_turns,
            near(&found.zero_turns, case.setup.encoder.zero_turns),
        );
        assert!(high - low < 0.05, "an angle within {low} to {high} turns");
    }
    for (tally, name) in tallies
        .iter()
        .zip(["R", "L_d", "L_q", "k", "zero", "k by back-EMF"])
    {
        tally.check(name);
    }
    let brushed: Vec<(Case, Found)> = (0..60_u64)
        .into_par_iter()
        .map(|seed| {
            let case = brushed(seed);
            let (result, _) = measured(&case, |_| {});
            (
                case,
                result.unwrap_or_else(|refusal| panic!("brushed motor {seed}: {refusal}")),
            )
        })
        .collect();
    let mut tallies: [Tally; 4] = Default::default();
    for (case, found) in &brushed {
        let Winding::Brushed(motor) = case.setup.winding else {
            panic!("not brushed");
        };
        assert_eq!(found.reversed, case.setup.encoder.reversed);
        let [r, l, k, measured] = &mut tallies;
        r.add(&found.resistance_ohm, motor.resistance_ohm);
        l.add(&found.d_inductance_h, motor.inductance_h);
        k.add(&found.torque_constant_nm_a, motor.torque_constant_nm_a);
        measured.add(&found.measured_constant_nm_a, motor.torque_constant_nm_a);
    }
    for (tally, name) in tallies.iter().zip(["brushed R", "L", "k", "k by back-EMF"]) {
        tally.check(name);
    }
}

/// Each of so many random motors is refused as expected.
fn refused(
    what: &str,
    of: fn(u64) -> Case,
    change: impl Fn(&mut Case, &mut Dice) + Sync,
    sabotage: impl Fn(&mut Board, &mut Dice) + Sync,
    expected: impl Fn(&Refusal) -> bool + Sync,
) {
    let wrong: Vec<String> = (0..SABOTAGED)
        .into_par_iter()
        .filter_map(|seed| {
            let mut dice = Dice(seed ^ 0x5AB0_7A6E);
            let mut case = of(1000 + seed);
            change(&mut case, &mut dice);
            let (result, _) = measured(&case, |board| sabotage(board, &mut dice));
            match result {
                Err(refusal) if expected(&refusal) => None,
                Err(refusal) => Some(format!("motor {seed}: {refusal}")),
                Ok(found) => Some(format!(
                    "motor {seed}: {found:?} of {:?}",
                    case.setup.winding
                )),
            }
        })
        .collect();
    assert!(
        wrong.is_empty(),
        "{what}: {} of {SABOTAGED}:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// Motors for each sabotage.
const SABOTAGED: u64 = 20;

fn as_it_is(_: &mut Case, _: &mut Dice) {}

fn wired(terminals: [usize; 3], open: Option<usize>) -> impl Fn(&mut Board, &mut Dice) + Sync {
    move |board, _| board.knob.wire(Wiring { terminals, open }).unwrap()
}

const STRAIGHT: [usize; 3] = [0, 1, 2];

#[test]
fn an_unplugged_phase_is_named() {
    for (open, named) in [(0, Phase::A), (1, Phase::B), (2, Phase::C)] {
        refused(
            "unplugged",
            three_phase,
            as_it_is,
            wired(STRAIGHT, Some(open)),
            |refusal| matches!(refusal, Refusal::Unplugged { phase, .. } if *phase == named),
        );
    }
    for open in [1, 2] {
        refused(
            "brushed, unplugged",
            brushed,
            as_it_is,
            wired(STRAIGHT, Some(open)),
            |refusal| matches!(refusal, Refusal::NoCurrent { .. }),
        );
    }
}

#[test]
fn a_brushed_motor_at_the_wrong_phases_is_noticed() {
    let at = |named: Phase| move |refusal: &Refusal| matches!(refusal, Refusal::BrushedAt { other } if *other == named);
    refused(
        "A–B",
        brushed,
        as_it_is,
        wired([1, 2, 0], None),
        at(Phase::B),
    );
    refused(
        "A–C",
        brushed,
        as_it_is,
        wired([1, 0, 2], None),
        at(Phase::C),
    );
    refused(
        "brushed, told to have three phases",
        brushed,
        |case, _| case.told.winding = calibrate::Winding::ThreePhase,
        |_, _| {},
        |refusal| {
            matches!(
                refusal,
                Refusal::Unplugged {
                    phase: Phase::A,
                    ..
                }
            )
        },
    );
    refused(
        "three phases, told to be brushed",
        three_phase,
        |case, _| case.told.winding = calibrate::Winding::Brushed,
        |_, _| {},
        |refusal| matches!(refusal, Refusal::Sum { .. }),
    );
}

#[test]
fn a_stuck_converter_is_named() {
    for (which, named) in [(0, Phase::B), (1, Phase::C)] {
        for of in [three_phase as fn(u64) -> Case, brushed] {
            refused(
                "stuck",
                of,
                as_it_is,
                |board, dice| {
                    let mut codes = [None; 2];
                    codes[which] = Some(dice.between(1900.0, 2200.0) as u16);
                    board.knob.stick(codes);
                },
                |refusal| matches!(refusal, Refusal::Stuck { phase, .. } if *phase == named),
            );
        }
        refused(
            "off by more than a good board",
            three_phase,
            as_it_is,
            |board, dice| {
                let mut codes = [None; 2];
                codes[which] = Some(dice.between(2500.0, 3500.0) as u16);
                board.knob.stick(codes);
            },
            |refusal| matches!(refusal, Refusal::Offset { phase, .. } if *phase == named),
        );
        refused(
            "at its end",
            three_phase,
            as_it_is,
            |board, _| {
                let mut codes = [None; 2];
                codes[which] = Some(4095);
                board.knob.stick(codes);
            },
            |refusal| matches!(refusal, Refusal::CurrentWithoutVoltage { .. }),
        );
    }
}

#[test]
fn a_short_is_noticed() {
    refused(
        "short",
        three_phase,
        |case, _| {
            if let Winding::ThreePhase(motor) = &mut case.setup.winding {
                motor.resistance_ohm = 1e-3;
                motor.d_inductance_h = 3e-5;
                motor.q_inductance_h = 3e-5;
            }
            case.setup.motor = Motor::default();
        },
        |_, _| {},
        |refusal| matches!(refusal, Refusal::Short { .. }),
    );
}

#[test]
fn a_shaft_that_does_not_turn_or_an_encoder_that_does_not_count_is_noticed() {
    for of in [three_phase as fn(u64) -> Case, brushed] {
        refused(
            "unplugged encoder",
            of,
            as_it_is,
            |board, _| board.knob.fault_encoder(Some(EncoderFault::Stuck)),
            |refusal| matches!(refusal, Refusal::NoMotion),
        );
        refused(
            "blocked shaft",
            of,
            |case, _| case.setup.device.coulomb_nm = 10.0,
            |_, _| {},
            |refusal| matches!(refusal, Refusal::NoMotion),
        );
        refused(
            "dead channel",
            of,
            as_it_is,
            |board, _| board.knob.fault_encoder(Some(EncoderFault::DeadChannel)),
            |refusal| matches!(refusal, Refusal::Toggles { .. }),
        );
    }
}

#[test]
fn a_slipping_encoder_and_a_wrong_count_of_poles_are_noticed() {
    let known = |case: &mut Case| {
        if let Winding::ThreePhase(motor) = case.setup.winding {
            case.told.pole_pairs = Some(motor.pole_pairs);
        }
    };
    refused(
        "slipping",
        three_phase,
        |case, _| known(case),
        |board, dice| {
            let follows = dice.between(0.6, 0.93);
            board
                .knob
                .fault_encoder(Some(EncoderFault::Slipping { follows }));
        },
        |refusal| {
            matches!(
                refusal,
                Refusal::NotWhole { .. } | Refusal::Slips { .. } | Refusal::PolePairs { .. }
            )
        },
    );
    refused(
        "wrong pole pairs",
        three_phase,
        |case, dice| {
            known(case);
            let off = dice.whole(1, 3);
            case.told.pole_pairs = case.told.pole_pairs.map(|pairs| pairs + off);
        },
        |_, _| {},
        |refusal| matches!(refusal, Refusal::PolePairs { .. }),
    );
    refused(
        "poles for pole pairs",
        three_phase,
        |case, _| {
            known(case);
            case.told.pole_pairs = case.told.pole_pairs.map(|pairs| 2 * pairs);
        },
        |_, _| {},
        |refusal| matches!(refusal, Refusal::PolePairs { .. }),
    );
    for of in [three_phase as fn(u64) -> Case, brushed] {
        refused(
            "wrong Kv",
            of,
            |case, dice| {
                let constant = match case.setup.winding {
                    Winding::ThreePhase(motor) => {
                        motor.torque_constant_nm_a() * 2.0 / 3.0_f64.sqrt()
                    }
                    Winding::Brushed(motor) => motor.torque_constant_nm_a,
                };
                let wrong = if dice.next() < 0.5 { 0.6 } else { 1.7 };
                case.told.kv_rpm_v = Some(wrong * 60.0 / (std::f64::consts::TAU * constant));
            },
            |_, _| {},
            |refusal| matches!(refusal, Refusal::Kv { .. }),
        );
    }
}

/// A count that leaps once, anywhere in the turn of the field.
#[test]
fn an_encoder_that_leaps_is_noticed() {
    refused(
        "leaps",
        three_phase,
        as_it_is,
        |board, dice| {
            let Some(counts) = board.counts_per_pole_pair else {
                panic!("not three phases")
            };
            board.leap = Some((
                dice.between(0.2, 0.8),
                (counts * dice.between(0.15, 0.4)) as i32,
            ));
        },
        |refusal| {
            matches!(
                refusal,
                Refusal::Slips { .. } | Refusal::ZeroMoved { .. } | Refusal::NotWhole { .. }
            )
        },
    );
}

/// Two wires of the motor swapped turn it the other way: found and told, not refused.
#[test]
fn swapped_wires_are_taken_as_they_are() {
    let wrong: Vec<String> = (0..SABOTAGED)
        .into_par_iter()
        .filter_map(|seed| {
            let case = three_phase(2000 + seed);
            let swap = Wiring {
                terminals: [0, 2, 1],
                open: None,
            };
            let (result, _) = measured(&case, |board| board.knob.wire(swap).unwrap());
            let encoder = case.setup.encoder;
            match result {
                Err(refusal) => Some(format!("motor {seed}: {refusal}")),
                Ok(found) => {
                    let zero = near(&found.zero_turns, -encoder.zero_turns);
                    let right = found.reversed != encoder.reversed && found.zero_turns.holds(zero);
                    (!right).then(|| format!("motor {seed}: {found:?}, not {zero}"))
                }
            }
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A limit that noise does not leave room for; hands on the knob.
#[test]
fn noise_and_hands_are_noticed() {
    refused(
        "noise",
        three_phase,
        |case, _| case.setup.sensing.noise_a = 0.15 * case.told.current_max_a,
        |_, _| {},
        |refusal| matches!(refusal, Refusal::Noise { .. }),
    );
    refused(
        "turned",
        brushed,
        |case, _| {
            case.setup.start.velocity = 10.0;
            case.setup.motor = Motor::default();
        },
        |_, _| {},
        |refusal| {
            matches!(
                refusal,
                Refusal::Moving { .. } | Refusal::CurrentWithoutVoltage { .. }
            )
        },
    );
    refused(
        "a weak supply",
        three_phase,
        |case, _| {
            case.setup.supply.source_v = 8.1;
            case.setup.supply.source_ohm = 30.0;
        },
        |_, _| {},
        |refusal| matches!(refusal, Refusal::Bus { .. }),
    );
}

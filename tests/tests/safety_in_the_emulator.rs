//! What puts the outputs off on the chip whatever else happens: in the emulated board with a power stage.

use std::path::Path;

use acceptance::{answers, request_frame};
use control::criterion::Device;
use control::torque::ThreePhaseMotor;
use firmware::power::ODRIVE_V3_24V;
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
use plant_sim::hand::Hand;
use plant_sim::hold::State as Motion;
use plant_sim::motor::Motor as Extras;
use plant_sim::powered::{EncoderSetup, Powered, Setup};
use plant_sim::powered_lockstep::{DriveEmulator, Order, PoweredBench, Surroundings};
use protocol::{
    Changes, Drive, Fault, Frames, Law, Message, MotorChanges, Refusal, Request, State,
};

const COUNTS: u32 = 8192;

/// PWM periods of a haptic tick.
const EVERY: u32 = 24;

fn knob() -> Powered {
    Powered::new(&Setup {
        device: Device {
            inertia_kg_m2: 2e-5,
            viscous_nm_s_rad: 2e-5,
            coulomb_nm: 2e-3,
        },
        motor: Extras::default(),
        hand: Hand {
            inertia_kg_m2: 1e-5,
            damping_nm_s_rad: 1e-3,
            push_nm: 0.02,
            shake_nm: 0.05,
            shake_hz: 5.0,
            ..Hand::default()
        },
        winding: Winding::ThreePhase(ThreePhaseMotor {
            resistance_ohm: 0.5,
            d_inductance_h: 5e-4,
            q_inductance_h: 5e-4,
            flux_wb: 0.05 / 1.5 / 7.0,
            pole_pairs: 7,
        }),
        inverter: Inverter {
            pwm_period_s: ODRIVE_V3_24V.pwm_period_s,
            pwm_steps: ODRIVE_V3_24V.pwm_steps,
            dead_time_s: ODRIVE_V3_24V.dead_time_s,
            dead_time_edge_a: ODRIVE_V3_24V.dead_time_edge_a,
            late: true,
        },
        sensing: CurrentSensing {
            step_a: ODRIVE_V3_24V.current_step_a,
            noise_a: 0.3,
            ..CurrentSensing::default()
        },
        supply: Supply::stiff(24.0),
        encoder: EncoderSetup {
            counts_per_rev: COUNTS,
            reversed: false,
            zero_turns: 0.0,
        },
        start: Motion {
            position: 0.0,
            velocity: 0.0,
        },
    })
    .unwrap()
}

struct Chip {
    bench: PoweredBench,
    frames: Frames,
    sequence: u16,
    /// The most that a current tick cost since arming, instructions.
    most: u32,
}

impl Chip {
    fn armed() -> Self {
        let image =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/firmware/emulated_drive.elf");
        let mut chip = Self {
            bench: PoweredBench {
                emulator: DriveEmulator::start(&image, 0, &[], None).expect("the firmware starts"),
                knob: knob(),
                around: Surroundings::default(),
            },
            frames: Frames::new(),
            sequence: 0,
            most: 0,
        };
        let motor = MotorChanges {
            drive: Some(Drive::Current),
            pole_pairs: Some(7),
            resistance_ohm: Some(0.5),
            d_inductance_h: Some(5e-4),
            q_inductance_h: Some(5e-4),
            torque_constant_nm_a: Some(0.05),
            current_max_a: Some(4.0),
            zero_turns: Some(0.0),
            ..MotorChanges::default()
        };
        let spring = Changes {
            law: Some(Law::Ledger),
            stiffness_nm_rad: Some(0.5),
            counts_per_rev: Some(COUNTS),
            speed_max_rad_s: Some(300.0),
            ..Changes::default()
        };
        for request in [Request::SetMotor(motor), Request::Set(spring), Request::Arm] {
            chip.ask(request).expect("done");
        }
        chip.run(4_000);
        assert!(chip.bench.emulator.report().duties.is_some());
        chip
    }

    fn run(&mut self, periods: u32) {
        for _ in 0..periods {
            let report = self.bench.period().unwrap().report;
            self.most = self.most.max(report.cost);
        }
    }

    /// The state, or why not.
    fn ask(&mut self, request: Request) -> Result<Option<State>, Refusal> {
        self.sequence += 1;
        let sequence = self.sequence;
        self.bench
            .emulator
            .send(&request_frame(sequence, request))
            .unwrap();
        for _ in 0..3_000 {
            self.bench.period().unwrap();
            let bytes = self.bench.emulator.receive().unwrap();
            for answer in answers(&mut self.frames, &bytes) {
                let told = answer.read(|number, message| match message {
                    Message::Done { .. } if number == sequence => Some(Ok(None)),
                    Message::Status(status) if number == sequence => Some(Ok(Some(status.state))),
                    Message::Refused(refusal) if number == sequence => Some(Err(*refusal)),
                    _ => None,
                });
                if let Some(told) = told {
                    return told;
                }
            }
        }
        panic!("no answer");
    }

    fn state(&mut self) -> State {
        self.ask(Request::Status).unwrap().expect("a state")
    }
}

#[test]
fn the_gate_drivers_line_puts_the_bridge_off_without_a_current_tick() {
    let mut chip = Chip::armed();
    let sensed = chip.bench.knob.sensed();
    let around = chip.bench.around;
    let report = chip
        .bench
        .emulator
        .exchange(Order::GateFault, &sensed, &around)
        .unwrap();
    assert_eq!(report.duties, None);
    chip.bench.around.gate_driver = [0x0420, 1];
    for _ in 0..3 * EVERY {
        assert_eq!(chip.bench.period().unwrap().report.duties, None);
    }
    assert_eq!(chip.state(), State::Fault(Fault::GateDriver));
    // Not left while the gate driver does not come up.
    assert_eq!(
        chip.ask(Request::Clear),
        Err(Refusal::State(State::Fault(Fault::GateDriver)))
    );
    chip.bench.around.gate_driver = [0; 2];
    assert_eq!(chip.ask(Request::Clear), Ok(None));
    assert_eq!(chip.state(), State::Disarmed);
}

#[test]
fn a_late_current_tick_and_a_hot_stage_put_the_bridge_off() {
    let mut chip = Chip::armed();
    let report = chip.bench.period_with(Order::LatePeriod).unwrap().report;
    assert_eq!(report.duties, None);
    chip.run(2 * EVERY);
    assert_eq!(chip.state(), State::Fault(Fault::CurrentOverrun));

    let mut chip = Chip::armed();
    let fed = chip.bench.emulator.report().fed;
    chip.run(4_800);
    // Once in each slow period.
    assert!((9..=11).contains(&(chip.bench.emulator.report().fed - fed)));
    chip.bench.around.temperature_c = 130.0;
    chip.run(EVERY + 481);
    assert_eq!(chip.bench.emulator.report().duties, None);
    assert!(matches!(
        chip.state(),
        State::Fault(Fault::OverTemperature { .. })
    ));
    println!("{} instructions at the most", chip.most);
}

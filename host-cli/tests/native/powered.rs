//! A device with a power stage and a motor: the firmware's current tick, and the exact plant.

use std::collections::VecDeque;

use control::criterion::Device;
use control::torque::ThreePhaseMotor;
use firmware::current_tick::{CurrentTick, widened};
use firmware::desk::{Desk, Identity};
use firmware::power::{Bridge, ODRIVE_V3_24V, Sensed};
use firmware::settings::{self, BoardKind};
use firmware::store::{Keep, NoStore};
use firmware::ticker::Ticker;
use firmware::{Commands, Link, Measurements, Moves, Records};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding, Wiring};
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::motor::Motor;
use plant_sim::powered::{EncoderSetup, Powered, Setup};

use super::Port;

/// Width of the encoder's counter.
const COUNTER_BITS: u32 = 16;

/// PWM periods for about each millisecond that passes: faster than real time, as the tests wait.
const PERIODS: u32 = 120;

pub const MOTOR: ThreePhaseMotor = ThreePhaseMotor {
    resistance_ohm: 0.5,
    d_inductance_h: 2.5e-4,
    q_inductance_h: 3e-4,
    flux_wb: 5e-3,
    pole_pairs: 7,
};

pub const ZERO_TURNS: f64 = 0.3;

fn setup() -> Setup {
    Setup {
        device: Device {
            inertia_kg_m2: 1e-5,
            viscous_nm_s_rad: 1e-5,
            coulomb_nm: 2e-3,
        },
        motor: Motor::default(),
        hand: Hand::default(),
        winding: Winding::ThreePhase(MOTOR),
        inverter: Inverter {
            pwm_period_s: ODRIVE_V3_24V.pwm_period_s,
            pwm_steps: ODRIVE_V3_24V.pwm_steps,
            dead_time_s: ODRIVE_V3_24V.dead_time_s,
            dead_time_edge_a: ODRIVE_V3_24V.dead_time_edge_a,
            late: true,
        },
        sensing: CurrentSensing {
            step_a: ODRIVE_V3_24V.current_step_a,
            noise_a: 0.04,
            offset_a: [1.5, -2.0],
            seed: 7,
        },
        supply: Supply::stiff(20.0),
        encoder: EncoderSetup {
            counts_per_rev: 8192,
            reversed: true,
            zero_turns: ZERO_TURNS,
        },
        start: State {
            position: 0.1,
            velocity: 0.0,
        },
    }
}

/// A board whose motor is wired like this.
pub fn board_with_motor(wiring: Wiring) -> Port {
    let mut knob = Powered::new(&setup()).unwrap();
    knob.wire(wiring).unwrap();
    // Three queues and a few words, kept until the test ends.
    let link: &'static Link = Box::leak(Box::new(Link::new()));
    let (command_sender, command_receiver) = Box::leak(Box::new(Commands::new())).split();
    let (record_sender, record_receiver) = Box::leak(Box::new(Records::new())).split();
    let (move_sender, move_receiver) = Box::leak(Box::new(Moves::new())).split();
    let measurements: &'static mut Measurements = Box::leak(Box::new(Measurements::new()));
    let (measurement_sender, measurement_receiver) = measurements.split();
    let identity = Identity {
        firmware: "1.2.3",
        git_hash: "abc1234",
        board: "native-drive",
        kind: BoardKind::Stage(ODRIVE_V3_24V),
        reset: protocol::ResetReason::Unknown,
    };
    let start = settings::start(&NoStore.load(), &identity.kind).unwrap();
    let counter = knob.sensed().counter & 0xFFFF;
    let ticker = Ticker::new(
        &start.settled,
        widened(counter, COUNTER_BITS).cast_unsigned(),
        link,
        command_receiver,
        record_sender,
        move_sender,
    );
    let power = start.settled.power.unwrap();
    let mut current = CurrentTick::new(ticker, power, COUNTER_BITS, counter, measurement_sender);
    let mut desk = Desk::new(
        identity,
        &start,
        NoStore,
        link,
        command_sender,
        record_receiver,
        move_receiver,
    )
    .told(measurement_receiver);
    let mut inbox = VecDeque::new();
    Port::new(move |incoming, outgoing| {
        inbox.extend(incoming);
        for _ in 0..PERIODS {
            let read = knob.sensed();
            let sensed = Sensed {
                currents: read.codes,
                bus_v: read.bus_v as f32,
                counter: read.counter & 0xFFFF,
            };
            let bridge = current.tick(&sensed, false, false);
            knob.period(match bridge {
                Bridge::Off => None,
                Bridge::On(duties) => Some(duties.parts().map(f64::from)),
            });
            if current.was_haptic() {
                desk.serve(|| inbox.pop_front(), |frame| outgoing.extend(frame));
            }
        }
    })
}

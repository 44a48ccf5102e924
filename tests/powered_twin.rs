//! The firmware of a board with a power stage run natively, and the knob it turns.

use std::collections::VecDeque;

use control::criterion::Device;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use firmware::board::Housekeeping;
use firmware::current_tick::{CurrentTick, widened};
use firmware::desk::{Desk, Identity};
use firmware::power::{Bridge, ODRIVE_V3_24V, Sensed};
use firmware::settings::{self, BoardKind, NO_MOTOR};
use firmware::store::{Keep, NoStore};
use firmware::ticker::Ticker;
use firmware::upkeep::{PERIODS, Upkeep};
use firmware::{Commands, Link, Measurements, Moves, Records};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::powered::{self, EncoderSetup, Setup};
use protocol::{Drive, Frames, Message, Motor, MotorChanges, Request, ResetReason};

use crate::twin::{Answer, answers, request_frame};

/// Width of the board's encoder counter.
pub const COUNTER_BITS: u32 = 16;

/// The firmware of a board with a power stage, without its board, on this machine: the tasks of
/// `firmware/src/app/power_stage.rs` in their order.
pub struct PoweredTwin<K = NoStore> {
    current: CurrentTick<'static>,
    upkeep: Upkeep<'static>,
    slow_in: u32,
    desk: Desk<'static, K>,
    inbox: VecDeque<u8>,
    outbox: Vec<u8>,
    frames: Frames,
}

impl PoweredTwin {
    /// Just started, with the counter at `counter`, on a board that keeps no settings.
    #[must_use]
    pub fn new(counter: u32, git_hash: &'static str) -> Self {
        Self::start(counter, git_hash, NoStore)
    }
}

impl<K: Keep> PoweredTwin<K> {
    /// Just started, with the counter at `counter` and what the store holds.
    #[must_use]
    pub fn start(counter: u32, git_hash: &'static str, mut store: K) -> Self {
        // Three queues and a few words a twin, kept until the test ends.
        let link: &'static Link = Box::leak(Box::new(Link::new()));
        let (command_sender, command_receiver) = Box::leak(Box::new(Commands::new())).split();
        let (record_sender, record_receiver) = Box::leak(Box::new(Records::new())).split();
        let measurements: &'static mut Measurements = Box::leak(Box::new(Measurements::new()));
        let (measurement_sender, measurement_receiver) = measurements.split();
        let (move_sender, move_receiver) = Box::leak(Box::new(Moves::new())).split();
        let identity = Identity {
            firmware: env!("CARGO_PKG_VERSION"),
            git_hash,
            board: "emulated_drive",
            kind: BoardKind::Stage(ODRIVE_V3_24V),
            reset: ResetReason::Unknown,
        };
        let start = settings::start(&store.load(), &identity.kind).expect("the defaults settle");
        let ticker = Ticker::new(
            &start.settled,
            widened(counter, COUNTER_BITS).cast_unsigned(),
            link,
            command_receiver,
            record_sender,
            move_sender,
        );
        let power = start.settled.power.expect("a stage has settings");
        Self {
            upkeep: Upkeep::new(link),
            slow_in: PERIODS,
            current: CurrentTick::new(ticker, power, COUNTER_BITS, counter, measurement_sender),
            desk: Desk::new(
                identity,
                &start,
                store,
                link,
                command_sender,
                record_receiver,
                move_receiver,
            )
            .told(measurement_receiver),
            inbox: VecDeque::new(),
            outbox: Vec::new(),
            frames: Frames::new(),
        }
    }

    fn serve(&mut self) {
        let (inbox, outbox) = (&mut self.inbox, &mut self.outbox);
        self.desk.serve(
            || inbox.pop_front(),
            |frame| outbox.extend_from_slice(frame),
        );
    }

    /// Bytes on the serial line, one interrupt each.
    pub fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            // As on the chip: 511 bytes find room, what comes on top is lost.
            if self.inbox.len() < 511 {
                self.inbox.push_back(*byte);
            }
            self.serve();
        }
    }

    /// One PWM period, and what follows it.
    pub fn period(&mut self, sensed: &Sensed, gate_fault: bool, overran: bool) -> Bridge {
        let bridge = self.current.tick(sensed, gate_fault, overran);
        // The slow task is above the desk.
        self.slow_in -= 1;
        if self.slow_in == 0 {
            self.slow_in = PERIODS;
            self.upkeep.run(&mut QuietBoard);
        }
        if self.current.was_haptic() {
            self.serve();
        }
        bridge
    }

    /// True if the last period had a haptic tick in it.
    #[must_use]
    pub fn was_haptic(&self) -> bool {
        self.current.was_haptic()
    }

    /// Takes what it has sent.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outbox)
    }

    /// Takes what it has sent, in messages.
    pub fn take_messages(&mut self) -> Vec<Answer> {
        let bytes = self.take_output();
        answers(&mut self.frames, &bytes)
    }
}

/// The slow side of a board on which all is well.
struct QuietBoard;

impl Housekeeping for QuietBoard {
    fn temperature_c(&mut self) -> f32 {
        25.0
    }

    fn gate_driver(&mut self) -> Result<(), [u16; 2]> {
        Ok(())
    }

    fn restart_gate_driver(&mut self) -> Result<(), [u16; 2]> {
        Ok(())
    }

    fn feed_watchdog(&mut self) {}

    fn reset_reason(&self) -> ResetReason {
        ResetReason::Unknown
    }
}

/// What the board reads of a powered knob.
#[must_use]
pub fn sensed(read: &powered::Sensed) -> Sensed {
    Sensed {
        currents: read.codes,
        bus_v: read.bus_v as f32,
        counter: read.counter & (u32::MAX >> (32 - COUNTER_BITS)),
    }
}

/// What a powered knob takes of a bridge.
#[must_use]
pub fn duties(bridge: Bridge) -> Option<[f64; 3]> {
    match bridge {
        Bridge::Off => None,
        Bridge::On(duties) => Some(duties.parts().map(f64::from)),
    }
}

/// A powered knob and the firmware natively.
pub struct NativeBench {
    /// The firmware.
    pub twin: PoweredTwin,
    /// Motor and knob.
    pub knob: powered::Powered,
    sequence: u16,
}

impl NativeBench {
    /// Switched on beside a knob.
    #[must_use]
    pub fn new(setup: &Setup) -> Self {
        let mut knob = powered::Powered::new(setup).expect("a possible knob");
        let counter = sensed(&knob.sensed()).counter;
        Self {
            twin: PoweredTwin::new(counter, "test"),
            knob,
            sequence: 0,
        }
    }

    /// One PWM period of both. What the knob did in it, under what was decided in the one before.
    pub fn period(&mut self) -> powered::Turned {
        let read = sensed(&self.knob.sensed());
        let bridge = self.twin.period(&read, false, false);
        self.knob.period(duties(bridge))
    }

    /// Asks, and goes on until the answer is there.
    pub fn ask<R>(&mut self, request: Request, read: impl FnOnce(&Message<'_>) -> R) -> R {
        self.sequence = self.sequence.wrapping_add(1);
        self.twin.send(&request_frame(self.sequence, request));
        for _ in 0..1000 {
            for answer in self.twin.take_messages() {
                let mine = |got, message: &Message<'_>| {
                    got == self.sequence
                        && !matches!(message, Message::Telemetry(_) | Message::Event(_))
                };
                if answer.read(mine) {
                    return answer.read(|_, message| read(message));
                }
            }
            self.period();
        }
        panic!("{request:?} was not answered within a thousand periods");
    }

    /// Asks for something that must be done; it is in force from the last period on.
    pub fn must(&mut self, request: Request) {
        self.ask(request, |message| {
            assert!(
                matches!(message, Message::Done { .. }),
                "{request:?}: {message:?}"
            );
        });
    }
}

/// Windings as a motor is told of, on an ODrive's stage with all that it adds but noise, amplifiers that are `offset`
/// codes off, and a knob of that device at rest.
#[must_use]
pub fn knob(motor: &Motor, counts_per_rev: u32, device: Device<f64>, start: State) -> Setup {
    let stage = ODRIVE_V3_24V;
    let resistance_ohm = f64::from(motor.resistance_ohm);
    let constant = f64::from(motor.torque_constant_nm_a);
    let winding = match motor.drive {
        Drive::Brushed => Winding::Brushed(BrushedMotor {
            resistance_ohm,
            inductance_h: f64::from(motor.d_inductance_h),
            torque_constant_nm_a: constant,
        }),
        _ => Winding::ThreePhase(ThreePhaseMotor {
            resistance_ohm,
            d_inductance_h: f64::from(motor.d_inductance_h),
            q_inductance_h: f64::from(motor.q_inductance_h),
            flux_wb: constant / (1.5 * f64::from(motor.pole_pairs)),
            pole_pairs: motor.pole_pairs,
        }),
    };
    let offset_a = [motor.offset_b_codes, motor.offset_c_codes]
        .map(|code| (f64::from(code) - stage.current_zero_code) * stage.current_step_a);
    Setup {
        device,
        motor: plant_sim::motor::Motor::default(),
        hand: Hand::default(),
        winding,
        inverter: Inverter {
            pwm_period_s: stage.pwm_period_s,
            pwm_steps: stage.pwm_steps,
            dead_time_s: stage.dead_time_s,
            dead_time_edge_a: stage.dead_time_edge_a,
            late: true,
        },
        sensing: CurrentSensing {
            step_a: stage.current_step_a,
            noise_a: 0.0,
            offset_a,
            seed: 1,
        },
        supply: Supply::stiff(24.0),
        encoder: EncoderSetup {
            counts_per_rev,
            reversed: motor.reversed,
            zero_turns: f64::from(motor.zero_turns),
        },
        start,
    }
}

/// All of a motor, to be set.
#[must_use]
pub fn all_of(motor: &Motor) -> MotorChanges {
    MotorChanges {
        drive: Some(motor.drive),
        pole_pairs: Some(motor.pole_pairs),
        resistance_ohm: Some(motor.resistance_ohm),
        d_inductance_h: Some(motor.d_inductance_h),
        q_inductance_h: Some(motor.q_inductance_h),
        torque_constant_nm_a: Some(motor.torque_constant_nm_a),
        current_max_a: Some(motor.current_max_a),
        reversed: Some(motor.reversed),
        zero_turns: Some(motor.zero_turns),
        offset_b_codes: Some(motor.offset_b_codes),
        offset_c_codes: Some(motor.offset_c_codes),
    }
}

/// A motor for each of the drives: 53 mNm/A on 0.5 Ω; a gimbal motor of 0.1 Nm/A on 10 Ω; the paper's RE35 with one of
/// its windings.
#[must_use]
pub fn example_motor(drive: Drive) -> Motor {
    let common = Motor {
        drive,
        current_max_a: 8.0,
        zero_turns: 0.3,
        offset_b_codes: 2071.5,
        offset_c_codes: 1989.0,
        ..NO_MOTOR
    };
    match drive {
        Drive::Voltage => Motor {
            pole_pairs: 7,
            resistance_ohm: 10.0,
            d_inductance_h: 2.5e-3,
            q_inductance_h: 2.5e-3,
            torque_constant_nm_a: 0.1,
            current_max_a: 1.0,
            ..common
        },
        Drive::Brushed => Motor {
            resistance_ohm: 2.0,
            d_inductance_h: 6e-4,
            q_inductance_h: 6e-4,
            torque_constant_nm_a: 0.052,
            current_max_a: 5.0,
            ..common
        },
        Drive::Current | Drive::None => Motor {
            pole_pairs: 7,
            resistance_ohm: 0.5,
            d_inductance_h: 2.5e-4,
            q_inductance_h: 3e-4,
            torque_constant_nm_a: 0.0525,
            ..common
        },
    }
}

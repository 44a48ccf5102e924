//! `knob info`: who a device is, and how.

use anyhow::Result;
use protocol::{Drive, Motor, Snapshot, State};
use serde::Serialize;

use crate::output::say_line;
use crate::parameters::short;
use crate::ports::Connection;
use crate::words;

/// Show who the device is and how: firmware, board, state and why it is in fault if it is, its motor where it drives
/// one, what became of the saved settings, why it started, and how things stood at its last fault.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  knob info --port /dev/ttyACM0")]
pub struct Args {
    #[command(flatten)]
    connection: Connection,
}

#[derive(Serialize)]
struct Json<'a> {
    port: &'a str,
    firmware: &'a str,
    git_hash: &'a str,
    board: &'a str,
    protocol: u16,
    state: &'a str,
    fault: Option<&'a str>,
    fault_text: Option<String>,
    tick: u32,
    dropped: u32,
    bad_frames: u32,
    settings: &'a str,
    settings_text: String,
    reset: &'a str,
    reset_text: &'a str,
    /// Null where none is set.
    motor: Option<MotorJson>,
    /// How things stood at the last fault since the start.
    last_fault: Option<SnapshotJson>,
}

#[derive(Serialize)]
struct MotorJson {
    drive: &'static str,
    pole_pairs: u32,
    resistance_ohm: f32,
    d_inductance_h: f32,
    q_inductance_h: f32,
    torque_constant_nm_a: f32,
    current_max_a: f32,
    reversed: bool,
    zero_turns: f32,
    offset_codes: [f32; 2],
}

impl MotorJson {
    fn of(motor: &Motor) -> Option<Self> {
        let drive = match motor.drive {
            Drive::None => return None,
            Drive::Current => "current",
            Drive::Voltage => "voltage",
            Drive::Brushed => "brushed",
        };
        Some(Self {
            drive,
            pole_pairs: motor.pole_pairs,
            resistance_ohm: motor.resistance_ohm,
            d_inductance_h: motor.d_inductance_h,
            q_inductance_h: motor.q_inductance_h,
            torque_constant_nm_a: motor.torque_constant_nm_a,
            current_max_a: motor.current_max_a,
            reversed: motor.reversed,
            zero_turns: motor.zero_turns,
            offset_codes: [motor.offset_b_codes, motor.offset_c_codes],
        })
    }
}

#[derive(Serialize)]
struct SnapshotJson {
    tick: u32,
    fault: &'static str,
    fault_text: String,
    count: i32,
    moved: i32,
    torque_nm: f32,
    current_b_a: f32,
    current_c_a: f32,
    bus_v: f32,
    temperature_c: f32,
    gate_driver: [u16; 2],
}

impl From<Snapshot> for SnapshotJson {
    fn from(it: Snapshot) -> Self {
        Self {
            tick: it.tick,
            fault: words::fault_code(it.fault),
            fault_text: words::fault(it.fault),
            count: it.count,
            moved: it.moved,
            torque_nm: it.torque_nm,
            current_b_a: it.current_b_a,
            current_c_a: it.current_c_a,
            bus_v: it.bus_v,
            temperature_c: it.temperature_c,
            gate_driver: it.gate_driver,
        }
    }
}

pub fn run(args: &Args) -> Result<()> {
    let (mut device, identity) = args.connection.connect()?;
    let status = device.status()?;
    let last_fault = device.last_fault()?;
    let motor = MotorJson::of(&device.motor()?);
    let fault = match status.state {
        State::Fault(fault) => Some(fault),
        State::Disarmed | State::Armed | State::Calibrating | State::Pushing => None,
    };
    if args.connection.json {
        let json = Json {
            port: device.path(),
            firmware: &identity.firmware,
            git_hash: &identity.git_hash,
            board: &identity.board,
            protocol: identity.version,
            state: words::state(status.state),
            fault: fault.map(words::fault_code),
            fault_text: fault.map(words::fault),
            tick: status.tick,
            dropped: status.dropped,
            bad_frames: status.bad_frames,
            settings: words::stored_code(status.stored),
            settings_text: words::stored(status.stored),
            reset: words::reset_code(status.reset),
            reset_text: words::reset(status.reset),
            motor,
            last_fault: last_fault.map(SnapshotJson::from),
        };
        say_line!("{}", serde_json::to_string(&json)?);
        return Ok(());
    }
    say_line!("port         {}", device.path());
    say_line!("board        {}", identity.board);
    say_line!(
        "firmware     {} ({}), protocol {}",
        identity.firmware,
        identity.git_hash,
        identity.version
    );
    say_line!("state        {}", words::state_in_full(status.state));
    if let Some(it) = motor {
        say_line!(
            "motor        {}, {} pole pairs, {} Ω, {} and {} H, {} Nm/A, at most {} A{}",
            it.drive,
            it.pole_pairs,
            short(it.resistance_ohm),
            short(it.d_inductance_h),
            short(it.q_inductance_h),
            short(it.torque_constant_nm_a),
            short(it.current_max_a),
            if it.reversed { ", reversed" } else { "" }
        );
    }
    say_line!("settings     {}", words::stored(status.stored));
    say_line!("started by   {}", words::reset(status.reset));
    match last_fault {
        None => say_line!("last fault   none since the start"),
        Some(it) => {
            say_line!(
                "last fault   tick {}: {}; count {}, moved {}, torque {} Nm",
                it.tick,
                words::fault(it.fault),
                it.count,
                it.moved,
                short(it.torque_nm)
            );
            // What a board does not measure is 0.
            if it.bus_v != 0.0 {
                say_line!(
                    "             B {} A, C {} A, bus {} V, {} °C, gate driver {:#06x} {:#06x}",
                    short(it.current_b_a),
                    short(it.current_c_a),
                    short(it.bus_v),
                    short(it.temperature_c),
                    it.gate_driver[0],
                    it.gate_driver[1]
                );
            }
        }
    }
    say_line!("tick         {}", status.tick);
    say_line!(
        "lost         {} messages found no room, {} frames could not be read",
        status.dropped,
        status.bad_frames
    );
    Ok(())
}

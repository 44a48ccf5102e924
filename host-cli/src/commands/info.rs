//! `knob info`: who a device is, and how.

use anyhow::Result;
use protocol::State;
use serde::Serialize;

use crate::output::say_line;
use crate::ports::Connection;
use crate::words;

/// Show who the device is and how: firmware, board, state and why it is in fault if it is, and what
/// became of the saved settings.
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
}

pub fn run(args: &Args) -> Result<()> {
    let (mut device, identity) = args.connection.connect()?;
    let status = device.status()?;
    let fault = match status.state {
        State::Fault(fault) => Some(fault),
        State::Disarmed | State::Armed => None,
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
    say_line!("settings     {}", words::stored(status.stored));
    say_line!("tick         {}", status.tick);
    say_line!(
        "lost         {} messages found no room, {} frames could not be read",
        status.dropped,
        status.bad_frames
    );
    Ok(())
}

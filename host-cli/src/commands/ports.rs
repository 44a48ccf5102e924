//! `knob ports`: where a knob may be.

use anyhow::Result;
use serde::Serialize;

use crate::output::say_line;
use crate::ports::{Candidate, candidates};

/// List the ports that may be a knob's: serial ports on USB, and emulators.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  knob ports")]
pub struct Args {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Json {
    ports: Vec<Candidate>,
}

pub fn run(args: &Args) -> Result<()> {
    let ports = candidates();
    if args.json {
        say_line!("{}", serde_json::to_string(&Json { ports })?);
        return Ok(());
    }
    for port in &ports {
        say_line!("{:<20} {}", port.port, port.description());
    }
    if ports.is_empty() {
        say_line!(
            "none: no serial port on USB, and no emulator is running (`knob emulate` starts one)"
        );
    }
    Ok(())
}

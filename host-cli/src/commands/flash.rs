//! `knob flash`: the firmware onto a board.

#[cfg(feature = "flash")]
mod library;
#[cfg(not(feature = "flash"))]
mod program;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use serde::Serialize;

use crate::image;
use crate::output::say_line;
use crate::stop::Ended;

#[cfg(feature = "flash")]
use library::write;
#[cfg(not(feature = "flash"))]
use program::write;

/// Write the firmware onto a board through a debug probe (ST-Link, CMSIS-DAP, J-Link), check it, and start it.
///
/// Only the sectors of the program are erased: saved settings are kept. Disarm first: the chip is halted and
/// reset. Built with `--features flash`, this command talks to the probe itself; otherwise it calls the
/// installed `probe-rs`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  cargo xtask firmware && knob flash\n  knob flash --board odrive-v3 --image odrive_v3.elf\n  knob flash --probe 0483:3748"
)]
pub struct Args {
    /// The board
    #[arg(long, value_enum, default_value_t = Board::OdriveV3)]
    board: Board,
    /// The image [default: target/firmware/odrive_v3.elf, which `cargo xtask firmware` builds]
    #[arg(long, value_name = "FILE.elf")]
    image: Option<PathBuf>,
    /// Which probe, if there are several
    #[arg(long, value_name = "VID:PID[:SERIAL]", env = "PROBE_RS_PROBE")]
    probe: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A board that can be flashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Board {
    /// ODrive v3.5 or v3.6, or a clone
    OdriveV3,
}

impl Board {
    /// As its image is marked.
    fn mark(self) -> &'static str {
        match self {
            Self::OdriveV3 => "odrive_v3",
        }
    }

    /// Where `cargo xtask firmware` puts its image.
    fn image(self) -> &'static Path {
        Path::new(match self {
            Self::OdriveV3 => "target/firmware/odrive_v3.elf",
        })
    }

    /// As probe-rs calls its chip.
    fn chip(self) -> &'static str {
        match self {
            Self::OdriveV3 => "STM32F405RGTx",
        }
    }
}

#[derive(Serialize)]
struct Json<'a> {
    image: &'a str,
    board: &'a str,
    chip: &'a str,
    /// Written to the flash, and read back.
    bytes: u64,
}

pub fn run(args: &Args) -> Result<()> {
    let (board, chip) = (args.board.mark(), args.board.chip());
    let path = args.image.as_deref().unwrap_or(args.board.image());
    if !path.exists() {
        bail!(
            "{}: there is no such file; `cargo xtask firmware` in a clone of the repository builds \
             {}, or name an image with --image",
            path.display(),
            args.board.image().display()
        );
    }
    let bytes = image::check(path, board)?;
    eprintln!(
        "{}: {bytes} bytes for the board {board} ({chip})",
        path.display()
    );
    write(
        path,
        chip,
        args.probe.as_deref().filter(|probe| !probe.is_empty()),
    )?;
    if args.json {
        let json = Json {
            image: &path.display().to_string(),
            board,
            chip,
            bytes,
        };
        say_line!("{}", serde_json::to_string(&json)?);
    } else {
        say_line!("written, checked and started; `knob info` shows what runs");
    }
    Ok(())
}

/// The user stopped it.
fn stopped() -> anyhow::Error {
    anyhow::Error::from(Ended).context(
        "stopped; what is on the chip may be half written: flash it again before you use it",
    )
}

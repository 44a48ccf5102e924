//! The firmware on its bench, and a host that talks to it between ticks.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use plant_sim::lockstep::{Bench, ChipReport, Emulator, Plant};
use protocol::{FRAME_MAX, Frames, FromDevice, Message, Request, ToDevice, decode, encode};

/// Where `cargo xtask firmware` puts the image.
pub const IMAGE: &str = "target/firmware/emulated.elf";

/// Which image to run.
#[derive(clap::Args)]
pub struct ImageChoice {
    /// The firmware's image [default: target/firmware/emulated.elf, which `cargo xtask firmware` builds]
    #[arg(long, value_name = "ELF", env = "KNOB_FIRMWARE")]
    pub firmware: Option<PathBuf>,
}

impl ImageChoice {
    /// Boots it against a plant, with what a file keeps of its settings.
    pub fn boot(&self, plant: Plant, settings: Option<&Path>) -> Result<Session> {
        let image = self.firmware.as_deref().unwrap_or(Path::new(IMAGE));
        let emulator = Emulator::start_with(image, 3, &[], settings).context("--firmware")?;
        Ok(Session {
            bench: Bench { emulator, plant },
            frames: Frames::new(),
            sequence: 0,
        })
    }
}

/// A bench whose chip answers.
pub struct Session {
    pub bench: Bench,
    frames: Frames,
    sequence: u16,
}

impl Session {
    /// One tick.
    pub fn tick(&mut self) -> Result<ChipReport> {
        Ok(self.bench.tick()?.1)
    }

    /// Asks, ticks until the answer is there, and reads it.
    pub fn ask<R>(
        &mut self,
        request: Request,
        read: impl FnOnce(&Message<'_>) -> Result<R>,
    ) -> Result<R> {
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        let mut buffer = [0; FRAME_MAX];
        let frame = encode(&ToDevice { sequence, request }, &mut buffer);
        let frame = frame.map_err(|_| anyhow!("the request does not fit a frame"))?;
        self.bench.emulator.send(frame)?;
        for _ in 0..20 {
            for byte in self.bench.emulator.receive()? {
                let Some(Ok(frame)) = self.frames.push(byte) else {
                    continue;
                };
                let mut frame = frame.to_vec();
                if let Ok(FromDevice {
                    sequence: of,
                    message,
                }) = decode(&mut frame)
                    && of == sequence
                    && !matches!(
                        message,
                        Message::Telemetry(_) | Message::Event(_) | Message::Moves(_)
                    )
                {
                    return read(&message);
                }
            }
            self.tick()?;
        }
        bail!("the firmware did not answer within 20 ticks");
    }

    /// Asks for something that must be done.
    pub fn must(&mut self, request: Request) -> Result<()> {
        self.ask(request, |message| match message {
            Message::Done { .. } => Ok(()),
            other => bail!("the firmware refused: {other:?}"),
        })
    }
}

impl Session {
    /// The stiffness applied now: subscribes, ticks, reads the telemetry, and unsubscribes.
    pub fn applied(&mut self, subscribe: Request, unsubscribe: Request) -> Result<f32> {
        self.must(subscribe)?;
        let mut applied = None;
        for _ in 0..3 {
            self.tick()?;
            for byte in self.bench.emulator.receive()? {
                if let Some(Ok(frame)) = self.frames.push(byte)
                    && let Ok(FromDevice {
                        message: Message::Telemetry(telemetry),
                        ..
                    }) = decode(frame)
                {
                    applied = telemetry.stiffness_nm_rad.or(applied);
                }
            }
        }
        self.must(unsubscribe)?;
        applied.context("the firmware sent no telemetry")
    }
}

//! Flashing by the library of probe-rs.

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use indicatif::ProgressBar;
use probe_rs::Permissions;
use probe_rs::flashing::{
    DownloadOptions, ElfLoader, FlashProgress, ProgressEvent, ProgressOperation,
    download_file_with_options,
};
use probe_rs::probe::list::Lister;
use probe_rs::probe::{DebugProbeSelector, Probe};

use super::stopped;
use crate::progress;
use crate::stop::{self, Usage};

/// Writes an image, reads it back, and starts it.
///
/// In a thread of its own, as a step of it may take seconds and Ctrl-C should not wait for that.
pub fn write(image: &Path, chip: &'static str, probe: Option<&str>) -> Result<()> {
    let probe = open(probe)?;
    let image: PathBuf = image.to_owned();
    let (done, result) = mpsc::channel();
    std::thread::spawn(move || {
        // Nobody listens after Ctrl-C.
        let _ = done.send(flash(probe, &image, chip));
    });
    loop {
        match result.recv_timeout(Duration::from_millis(50)) {
            Ok(result) => return result,
            Err(mpsc::RecvTimeoutError::Timeout) if stop::requested() => return Err(stopped()),
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => bail!("probe-rs failed without a reason"),
        }
    }
}

/// The probe that was picked, or the only one.
fn open(wanted: Option<&str>) -> Result<Probe> {
    let lister = Lister::new();
    if let Some(text) = wanted {
        let selector: DebugProbeSelector = text.parse().map_err(|error| {
            Usage(format!(
                "--probe: `{text}`: {error}; accepted: VID:PID or VID:PID:SERIAL, as in 0483:3748"
            ))
        })?;
        return lister
            .open(selector)
            .with_context(|| format!("--probe: {text}: cannot open it; {REMEDY}"));
    }
    match &lister.list_all()[..] {
        [one] => one
            .open()
            .with_context(|| format!("{one}: cannot open it; {REMEDY}")),
        [] => bail!("no debug probe is there; plug in an ST-Link or a CMSIS-DAP probe; {REMEDY}"),
        several => {
            let list: Vec<_> = several.iter().map(ToString::to_string).collect();
            bail!(
                "{} debug probes are there: {}; pick one with --probe VID:PID:SERIAL or PROBE_RS_PROBE, or unplug the others",
                several.len(),
                list.join("; ")
            )
        }
    }
}

const REMEDY: &str = "on Linux it also takes the rules of https://probe.rs/docs/getting-started/probe-setup for who may \
    use it";

fn flash(probe: Probe, image: &Path, chip: &str) -> Result<()> {
    let mut session = probe.attach(chip, Permissions::new()).context(
        "the probe is there, but the chip does not answer; is it wired as in docs/hardware.md, and is the board powered?",
    )?;
    let mut bar = Bar::default();
    let mut options = DownloadOptions::default();
    options.verify = true;
    options.progress = FlashProgress::new(|event| bar.show(&event));
    let written =
        download_file_with_options(&mut session, image, ElfLoader(Default::default()), options);
    bar.end();
    written.map_err(|error| anyhow!(error)).context(
        "the image was not written whole; what is on the chip may be half of it: flash it again",
    )?;
    let started = session.core(0).and_then(|mut core| core.reset());
    started
        .context("the image is written and checked, but was not started; reset the board by hand")
}

/// A bar for one step after the other.
#[derive(Default)]
struct Bar {
    totals: Vec<(&'static str, u64)>,
    shown: Option<ProgressBar>,
}

impl Bar {
    fn show(&mut self, event: &ProgressEvent) {
        match event {
            ProgressEvent::AddProgressBar { operation, total } => {
                self.totals.push((name(*operation), total.unwrap_or(0)));
            }
            ProgressEvent::Started(operation) => {
                self.end();
                let what = name(*operation);
                let total = self
                    .totals
                    .iter()
                    .filter(|(of, _)| *of == what)
                    .map(|(_, total)| total)
                    .sum();
                self.shown = Some(progress::bar(total, what));
            }
            ProgressEvent::Progress { size, .. } => {
                if let Some(bar) = &self.shown {
                    bar.inc(*size);
                }
            }
            ProgressEvent::Finished(_) | ProgressEvent::Failed(_) => self.end(),
            ProgressEvent::FlashLayoutReady { .. } | ProgressEvent::DiagnosticMessage { .. } => {}
        }
    }

    fn end(&mut self) {
        if let Some(bar) = self.shown.take() {
            bar.finish_and_clear();
        }
    }
}

fn name(operation: ProgressOperation) -> &'static str {
    match operation {
        ProgressOperation::Fill => "read",
        ProgressOperation::Erase => "erase",
        ProgressOperation::Program => "write",
        ProgressOperation::Verify => "verify",
    }
}

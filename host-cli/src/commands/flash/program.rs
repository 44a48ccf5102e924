//! Flashing by the installed `probe-rs`.

use std::ffi::OsStr;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};

use super::stopped;
use crate::stop;

const MISSING: &str = "`probe-rs` is missing, which talks to the debug probe; get it by one of\n  \
    curl -LsSf https://github.com/probe-rs/probe-rs/releases/latest/download/probe-rs-tools-installer.sh | sh\n  \
    cargo install probe-rs-tools --locked\n\
    or build a `knob` that does without it:\n  \
    cargo install --path host-cli --features flash";

/// Writes an image, reads it back, and starts it. What `probe-rs` says goes to standard error.
pub fn write(image: &Path, chip: &str, probe: Option<&str>) -> Result<()> {
    let download = [OsStr::new("--verify"), image.as_os_str()];
    probe_rs("download", chip, probe, &download).context("nothing was started")?;
    // Older versions have no `download --reset`.
    probe_rs("reset", chip, probe, &[])
        .context("the image is written and checked, but was not started; reset the board by hand")
}

fn probe_rs(task: &str, chip: &str, probe: Option<&str>, more: &[&OsStr]) -> Result<()> {
    let mut command = Command::new("probe-rs");
    command.args([task, "--non-interactive", "--chip", chip]);
    if let Some(probe) = probe {
        command.args(["--probe", probe]);
    }
    command.args(more);
    let arguments: Vec<_> = command.get_args().map(OsStr::to_string_lossy).collect();
    let line = format!("probe-rs {}", arguments.join(" "));
    eprintln!("{line}");
    let child = command.stdin(Stdio::null()).stdout(io::stderr()).spawn();
    let mut child = child.map_err(|error| match error.kind() {
        ErrorKind::NotFound => anyhow!(MISSING),
        _ => anyhow!("cannot run `probe-rs`: {error}"),
    })?;
    loop {
        if stop::requested() {
            // It may have ended by the same Ctrl-C.
            let _ = child.kill();
            let _ = child.wait();
            return Err(stopped());
        }
        match child.try_wait().context("probe-rs")? {
            Some(status) if status.success() => return Ok(()),
            Some(status) => bail!(
                "`{line}` failed ({status}) and said why above; are probe and board wired as in \
                 docs/hardware.md, is the board powered, and does no other program use the probe?"
            ),
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}

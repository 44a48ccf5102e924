//! A firmware image in QEMU, and the pipes and the serial line to it.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use control::ConfigError;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{CWD, FileType, Mode, OFlags, fcntl_getfl, fcntl_setfl, mknodat};
use rustix::thread::{CpuSet, sched_getcpu, sched_setaffinity};

/// The emulator's program.
pub const QEMU: &str = "qemu-system-arm";

/// How long a start, or one tick, may take before the firmware counts as hung.
const PATIENCE: Duration = Duration::from_secs(20);

/// Why the firmware in the emulator cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum LockstepError {
    /// The emulator is not installed, or does not start.
    #[error("cannot start {QEMU}: {0}; install it with `cargo xtask setup`")]
    Start(io::Error),
    /// The firmware image cannot be read.
    #[error("cannot read the firmware {path}: {error}; build it with `cargo xtask firmware`")]
    Image {
        /// Which file.
        path: String,
        /// Why.
        error: io::Error,
    },
    /// The firmware did not answer.
    #[error("the firmware did not answer within {} s", PATIENCE.as_secs())]
    Silent,
    /// The emulator ended.
    #[error("the emulator ended: {}", ending(.0))]
    Ended(ExitStatus),
    /// A pipe or socket broke.
    #[error("lost the emulator: {0}")]
    Broken(#[from] io::Error),
    /// The firmware asked for a sample period that no plant can have.
    #[error(transparent)]
    Period(#[from] ConfigError),
}

fn ending(status: &ExitStatus) -> String {
    match status.code() {
        Some(0) => "as ordered".into(),
        Some(101) => "the firmware panicked".into(),
        Some(102) => "the firmware met a hard fault".into(),
        Some(103) => "the firmware panicked while it told of a panic".into(),
        _ => status.to_string(),
    }
}

/// Bytes of the file that keeps the emulated board's settings.
pub const SETTINGS_BYTES: usize = 8192;

/// The order that does nothing, on every board.
pub(crate) const HOLD: u32 = 0;

/// A firmware image running in QEMU, which reports so many words at each exchange. Ends with it.
pub(crate) struct Qemu<const REPORT: usize> {
    child: Child,
    to_host: File,
    to_guest: File,
    serial: UnixStream,
    sent: u32,
    /// What the firmware has sent and nobody has taken.
    received: Vec<u8>,
    report: [u32; REPORT],
    _folder: tempfile::TempDir,
}

impl<const REPORT: usize> Qemu<REPORT> {
    /// Starts QEMU on a firmware image and waits for its first report. `shift`: an instruction
    /// takes 2^shift ns of virtual time. A file of [`SETTINGS_BYTES`] bytes may take the place of the flash.
    pub fn start(
        image: &Path,
        shift: u32,
        arguments: &[String],
        settings: Option<&Path>,
    ) -> Result<Self, LockstepError> {
        let image = image.canonicalize().map_err(|error| LockstepError::Image {
            path: image.display().to_string(),
            error,
        })?;
        let mut one_core = CpuSet::new();
        one_core.set(sched_getcpu());
        // Where it is not allowed it is only slower.
        let _ = sched_setaffinity(None, &one_core);
        let folder = tempfile::tempdir()?;
        for name in ["to-host", "to-guest"] {
            let mode = Mode::RUSR | Mode::WUSR;
            mknodat(CWD, folder.path().join(name), FileType::Fifo, mode, 0)
                .map_err(io::Error::from)?;
        }
        if let Some(settings) = settings {
            symlink(settings.canonicalize()?, folder.path().join("settings"))?;
        }
        let open = |name: &str, write: bool| {
            OpenOptions::new()
                .read(!write)
                .write(write)
                .custom_flags(OFlags::NONBLOCK.bits() as i32)
                .open(folder.path().join(name))
        };
        // Our reading end first; then the chip's opening for writing goes through.
        let to_host = open("to-host", false)?;
        let child = Command::new(QEMU)
            .current_dir(folder.path())
            .args([
                "-M",
                "netduinoplus2",
                "-display",
                "none",
                "-monitor",
                "none",
            ])
            .args(["-icount", &format!("shift={shift},sleep=off")])
            .args(["-semihosting-config", "enable=on,target=native"])
            // wait=on: what the firmware says first is not lost.
            .args(["-serial", "unix:serial,server=on,wait=on"])
            .arg("-kernel")
            .arg(&image)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(LockstepError::Start)?;
        let mut child = KillOnDrop(Some(child));
        let serial = child.until(|| UnixStream::connect(folder.path().join("serial")).ok())?;
        // The writing end opens once the chip reads.
        let to_guest = child.until(|| open("to-guest", true).ok())?;
        for file in [&to_host, &to_guest] {
            let flags = fcntl_getfl(file).map_err(io::Error::from)?;
            fcntl_setfl(file, flags & !OFlags::NONBLOCK).map_err(io::Error::from)?;
        }
        serial.set_nonblocking(true)?;
        let mut emulator = Self {
            child: child.0.take().ok_or(LockstepError::Silent)?,
            to_host,
            to_guest,
            serial,
            sent: 0,
            received: Vec::new(),
            report: [0; REPORT],
            _folder: folder,
        };
        emulator.listen()?;
        Ok(emulator)
    }

    /// What was told at the last exchange.
    pub fn report(&self) -> [u32; REPORT] {
        self.report
    }

    /// One exchange: the order is carried out, with these words.
    pub fn exchange<const MORE: usize>(
        &mut self,
        order: u32,
        counter: u32,
        more: [u32; MORE],
    ) -> Result<[u32; REPORT], LockstepError> {
        let mut bytes = Vec::with_capacity(4 * (3 + MORE));
        for word in [order, counter, self.sent].iter().chain(&more) {
            bytes.extend(word.to_le_bytes());
        }
        if self.to_guest.write_all(&bytes).is_err() {
            return Err(LockstepError::Ended(self.child.wait()?));
        }
        self.listen()
    }

    /// Hands bytes to the firmware's serial line, and waits until they are taken. A hold is ordered with `more`.
    pub fn send<const MORE: usize>(
        &mut self,
        bytes: &[u8],
        more: [u32; MORE],
    ) -> Result<(), LockstepError> {
        // In pieces that the line holds, each taken before the next.
        for piece in bytes.chunks(256) {
            let mut rest = piece;
            while !rest.is_empty() {
                match self.serial.write(rest) {
                    Ok(written) => rest = &rest[written..],
                    Err(error)
                        if matches!(
                            error.kind(),
                            io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
                        ) => {}
                    Err(error) => return Err(error.into()),
                }
            }
            self.sent = self.sent.wrapping_add(piece.len() as u32);
            self.exchange(HOLD, 0, more)?;
        }
        Ok(())
    }

    /// Takes what the firmware has sent until now; all of it, as the chip stands still.
    pub fn receive(&mut self) -> Result<Vec<u8>, LockstepError> {
        self.drain()?;
        Ok(std::mem::take(&mut self.received))
    }

    /// Reads the serial line until it is empty.
    fn drain(&mut self) -> Result<(), LockstepError> {
        let mut buffer = [0; 4096];
        loop {
            match self.serial.read(&mut buffer) {
                Ok(0) => return Err(LockstepError::Ended(self.child.wait()?)),
                Ok(length) => self.received.extend_from_slice(&buffer[..length]),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Waits for the chip's report. The serial line is read meanwhile: it holds fewer than 300 bytes,
    /// and the chip waits while it is full.
    fn listen(&mut self) -> Result<[u32; REPORT], LockstepError> {
        let patience = Timespec {
            tv_sec: PATIENCE.as_secs() as i64,
            tv_nsec: 0,
        };
        loop {
            let mut ready = [
                PollFd::new(&self.to_host, PollFlags::IN),
                PollFd::new(&self.serial, PollFlags::IN),
            ];
            match poll(&mut ready, Some(&patience)) {
                Ok(0) => return Err(LockstepError::Silent),
                Ok(_) => {}
                // A signal, such as Ctrl-C; whoever wants to stop does so between ticks.
                Err(rustix::io::Errno::INTR) => continue,
                Err(error) => return Err(io::Error::from(error).into()),
            }
            let reported = !ready[0].revents().is_empty();
            if reported {
                break;
            }
            self.drain()?;
        }
        let mut words = [[0; 4]; REPORT];
        if self.to_host.read_exact(words.as_flattened_mut()).is_err() {
            return Err(LockstepError::Ended(self.child.wait()?));
        }
        self.report = words.map(u32::from_le_bytes);
        Ok(self.report)
    }
}

impl<const REPORT: usize> Drop for Qemu<REPORT> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A child that does not outlive a failed start.
struct KillOnDrop(Option<Child>);

impl KillOnDrop {
    /// Tries until it works, the child ends, or patience does.
    fn until<T>(&mut self, mut attempt: impl FnMut() -> Option<T>) -> Result<T, LockstepError> {
        let began = Instant::now();
        loop {
            if let Some(value) = attempt() {
                return Ok(value);
            }
            if let Some(child) = &mut self.0
                && let Some(status) = child.try_wait()?
            {
                return Err(LockstepError::Ended(status));
            }
            if began.elapsed() > PATIENCE {
                return Err(LockstepError::Silent);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

impl Drop for KillOnDrop {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

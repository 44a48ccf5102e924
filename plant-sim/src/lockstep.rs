//! The firmware in an emulator, tick by tick with the exact plant.
//!
//! [`Emulator`] runs QEMU on a firmware image and exchanges a few words with it over two
//! named pipes; the emulated chip stands still while it waits. [`Plant`] is the motor outside, in
//! `f64`. [`Bench`] joins the two: one call, one tick. Serial bytes are handed over between
//! ticks and waited for, so a whole run is the same every time.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use control::ConfigError;
use control::criterion::Device;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{CWD, FileType, Mode, OFlags, fcntl_getfl, fcntl_setfl, mknodat};
use rustix::thread::{CpuSet, sched_getcpu, sched_setaffinity};

use crate::hold::{Hold, State};

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

/// What the chip is to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Order {
    /// Nothing.
    Hold = 0,
    /// A tick.
    Tick = 1,
    /// A tick that finds another was due before it.
    LateTick = 2,
    /// End the emulator.
    Exit = 3,
    /// Panic.
    Panic = 4,
    /// Read an address where nothing is.
    HardFault = 5,
    /// Say in [`ChipReport::cost`] how much stack was ever used, bytes.
    Stack = 6,
}

/// How things stand on the chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChipReport {
    /// The torque it commands, Nm.
    pub torque_nm: f32,
    /// Serial bytes that it has taken since the start.
    pub taken: u32,
    /// What the last tick cost: nanoseconds of virtual time; at [`Emulator::start`]'s shift
    /// 0, instructions.
    pub cost: u32,
    /// The sample period it wants, s.
    pub period_s: f32,
}

/// Bytes of the file that keeps the emulated board's settings.
pub const SETTINGS_BYTES: usize = 8192;

/// A firmware image running in QEMU. Ends with it.
pub struct Emulator {
    child: Child,
    to_host: File,
    to_guest: File,
    serial: UnixStream,
    sent: u32,
    /// What the firmware has sent and nobody has taken.
    received: Vec<u8>,
    report: ChipReport,
    _folder: tempfile::TempDir,
}

impl Emulator {
    /// Starts QEMU on a firmware image and waits for its first report. `shift`: an instruction
    /// takes 2^shift ns of virtual time (3 is plausible, 0 counts instructions).
    ///
    /// This thread and the emulator stay on one core from here on: they never run at the
    /// same time, and a wake-up across cores costs more than a tick.
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn start(image: &Path, shift: u32) -> Result<Self, LockstepError> {
        Self::start_with(image, shift, &[], None)
    }

    /// As [`Emulator::start`], with further arguments for QEMU, and with a file of [`SETTINGS_BYTES`] bytes in
    /// the place of the flash that keeps settings, all of them 0xFF as long as none were saved.
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn start_with(
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
            report: ChipReport {
                torque_nm: 0.0,
                taken: 0,
                cost: 0,
                period_s: 0.0,
            },
            _folder: folder,
        };
        emulator.listen()?;
        Ok(emulator)
    }

    /// How things stood at the last exchange.
    #[must_use]
    pub fn report(&self) -> ChipReport {
        self.report
    }

    /// One exchange: the order is carried out, with the encoder's counter as given.
    ///
    /// # Errors
    /// See [`LockstepError`]; the emulator's end is one, also where it was ordered.
    pub fn exchange(&mut self, order: Order, counter: u32) -> Result<ChipReport, LockstepError> {
        let words = [order as u32, counter, self.sent].map(u32::to_le_bytes);
        if self.to_guest.write_all(words.as_flattened()).is_err() {
            return Err(LockstepError::Ended(self.child.wait()?));
        }
        self.listen()
    }

    /// Hands bytes to the firmware's serial line. They are taken before the next order is
    /// carried out.
    ///
    /// # Errors
    /// [`LockstepError::Broken`].
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), LockstepError> {
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
            self.exchange(Order::Hold, 0)?;
        }
        Ok(())
    }

    /// Takes what the firmware has sent until now; all of it, as the chip stands still.
    ///
    /// # Errors
    /// [`LockstepError::Broken`].
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
    fn listen(&mut self) -> Result<ChipReport, LockstepError> {
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
        let mut words = [[0; 4]; 4];
        if self.to_host.read_exact(words.as_flattened_mut()).is_err() {
            return Err(LockstepError::Ended(self.child.wait()?));
        }
        let [torque, taken, cost, period] = words;
        self.report = ChipReport {
            torque_nm: f32::from_le_bytes(torque),
            taken: u32::from_le_bytes(taken),
            cost: u32::from_le_bytes(cost),
            period_s: f32::from_le_bytes(period),
        };
        Ok(self.report)
    }
}

impl Drop for Emulator {
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

/// The motor outside: exact, with an encoder, and a hand that may hold or push it.
#[derive(Debug, Clone, Copy)]
pub struct Plant {
    device: Device<f64>,
    count_rad: f64,
    hold: Hold,
    state: State,
    /// A hand holds the knob where it is.
    held: bool,
    /// A hand pushes with this torque, Nm.
    push_nm: f64,
}

impl Plant {
    /// A device with an encoder of `counts_per_rev`, held at rest at `angle_rad`.
    ///
    /// # Errors
    /// As [`Hold::new`].
    pub fn new(
        device: Device<f64>,
        counts_per_rev: f64,
        angle_rad: f64,
    ) -> Result<Self, ConfigError> {
        Ok(Self {
            hold: Hold::new(&device, 1e-3)?,
            device,
            count_rad: std::f64::consts::TAU / counts_per_rev,
            state: State {
                position: angle_rad,
                velocity: 0.0,
            },
            held: true,
            push_nm: 0.0,
        })
    }

    /// Angle (rad) and velocity (rad/s), as they truly are.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// The encoder's counter.
    #[must_use]
    pub fn counter(&self) -> u32 {
        (self.state.position / self.count_rad).floor() as i64 as u32
    }

    /// The hand holds the knob at an angle.
    pub fn hold_at(&mut self, angle_rad: f64) {
        self.held = true;
        self.state = State {
            position: angle_rad,
            velocity: 0.0,
        };
    }

    /// The hand lets go, after it has given the knob a velocity, rad/s.
    pub fn let_go(&mut self, velocity_rad_s: f64) {
        self.held = false;
        self.state.velocity = velocity_rad_s;
    }

    /// The hand pushes from now on, Nm.
    pub fn push(&mut self, push_nm: f64) {
        self.push_nm = push_nm;
    }

    /// Moves on by one period under a held torque.
    fn advance(&mut self, torque_nm: f32, period_s: f32) -> Result<(), ConfigError> {
        let period_s = f64::from(period_s);
        if self.hold.duration() != period_s {
            self.hold = Hold::new(&self.device, period_s)?;
        }
        if !self.held {
            self.state = self
                .hold
                .step(self.state, f64::from(torque_nm) + self.push_nm)
                .end;
        }
        Ok(())
    }
}

/// Firmware and plant on one bench.
pub struct Bench {
    /// The chip.
    pub emulator: Emulator,
    /// The motor.
    pub plant: Plant,
}

impl Bench {
    /// One tick: the chip reads the plant's count and gives a torque, under which the plant
    /// moves on by one period. Returns the counter that was read, and the chip's report.
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn tick(&mut self) -> Result<(u32, ChipReport), LockstepError> {
        self.tick_with(Order::Tick)
    }

    /// As [`Bench::tick`], with another order.
    ///
    /// # Errors
    /// See [`LockstepError`].
    pub fn tick_with(&mut self, order: Order) -> Result<(u32, ChipReport), LockstepError> {
        let counter = self.plant.counter();
        let report = self.emulator.exchange(order, counter)?;
        self.plant.advance(report.torque_nm, report.period_s)?;
        Ok((counter, report))
    }
}

//! The firmware in an emulator, tick by tick with the exact plant.
//!
//! [`Emulator`] runs QEMU on a firmware image and exchanges a few words with it over two
//! named pipes; the emulated chip stands still while it waits. [`Plant`] is the motor outside, in
//! `f64`. [`Bench`] joins the two: one call, one tick. Serial bytes are handed over between
//! ticks and waited for, so a whole run is the same every time.

use std::path::Path;

use control::ConfigError;
use control::criterion::Device;

use crate::hold::{Hold, State};
use crate::qemu::Qemu;
pub use crate::qemu::{LockstepError, QEMU, SETTINGS_BYTES};

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

impl ChipReport {
    fn read([torque, taken, cost, period]: [u32; 4]) -> Self {
        Self {
            torque_nm: f32::from_bits(torque),
            taken,
            cost,
            period_s: f32::from_bits(period),
        }
    }
}

/// A firmware image of the board `emulated` running in QEMU. Ends with it.
pub struct Emulator(Qemu<4>);

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
        Qemu::start(image, shift, arguments, settings).map(Self)
    }

    /// How things stood at the last exchange.
    #[must_use]
    pub fn report(&self) -> ChipReport {
        ChipReport::read(self.0.report())
    }

    /// One exchange: the order is carried out, with the encoder's counter as given.
    ///
    /// # Errors
    /// See [`LockstepError`]; the emulator's end is one, also where it was ordered.
    pub fn exchange(&mut self, order: Order, counter: u32) -> Result<ChipReport, LockstepError> {
        let words = self.0.exchange(order as u32, counter, [])?;
        Ok(ChipReport::read(words))
    }

    /// Hands bytes to the firmware's serial line. They are taken before the next order is
    /// carried out.
    ///
    /// # Errors
    /// [`LockstepError::Broken`].
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), LockstepError> {
        self.0.send(bytes, [])
    }

    /// Takes what the firmware has sent until now; all of it, as the chip stands still.
    ///
    /// # Errors
    /// [`LockstepError::Broken`].
    pub fn receive(&mut self) -> Result<Vec<u8>, LockstepError> {
        self.0.receive()
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

//! The DRV8301 between TIM1 and the FETs, over SPI: set, read back, and checked again later.
//!
//! A frame is bit 15 read, 14–11 address, 10–0 data. The answer comes in the **next** frame, its bit 15 = frame fault,
//! 14–11 the address again. The first writes after EN_GATE may get lost, so each register is written, read back and compared,
//! up to five times. The values are not zero and not all ones: a line that is stuck cannot pass for a healthy driver.
//!
//! The driver's own shutdown is what protects the FETs: at an over-current it turns all of them off, within 1.5 µs, and stays off
//! until EN_GATE went low. It has no other way to TIM1 than nFAULT's interrupt.

use embedded_hal::spi::SpiDevice;

use super::{Registers, pins};

const READ: u16 = 1 << 15;
const FRAME_FAULT: u16 = 1 << 15;
const DATA: u16 = 0x7FF;

const STATUS_1: u16 = 0;
const STATUS_2: u16 = 1;
const CONTROL_1: u16 = 2;
const CONTROL_2: u16 = 3;

/// 0.511 V from drain to source, the lowest of those in use on this board.
const OC_ADJ_SET: u16 = 18 << 6;
/// Off, and latched.
const OC_MODE_LATCHED: u16 = 1 << 4;
/// Six inputs, and 1.7 A into the gates, for which the dead time was chosen.
const SIX_PWM_1A7: u16 = 0;
const CONTROL_1_VALUE: u16 = OC_ADJ_SET | OC_MODE_LATCHED | SIX_PWM_1A7;
/// The current amplifiers' gain of 80; nOCTW tells both of over-current and of warmth.
const GAIN_80: u16 = 3 << 2;
const CONTROL_2_VALUE: u16 = GAIN_80;

const TRIES: u32 = 5;

/// EN_GATE is low for longer than the 20 µs that reset everything; between 10 and 20 µs it is undefined.
const LOW_US: u32 = 1000;
/// Ready after 10 ms.
const READY_US: u32 = 20_000;

/// Turns the gate drivers off and on, so that ours begins anew; takes 21 ms. The bridge is off meanwhile. It may not
/// start while a phase lies above 8.5 V, which a motor that is turned fast can bring about.
pub fn restart(registers: &mut impl Registers) {
    turn_off(registers);
    registers.wait_us(LOW_US);
    pins::set_en_gate(registers, true);
    registers.wait_us(READY_US);
}

/// Turns the gate drivers off. Before this the bridge must be off, and a fault's status read.
pub fn turn_off(registers: &mut impl Registers) {
    pins::set_en_gate(registers, false);
}

/// Why the gate driver cannot be relied on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GateDriverError {
    /// The bus did not carry a frame.
    Bus,
    /// Nothing but zeros or ones came: no supply, a broken line, or hung by a dip of the supply, which only
    /// power-off cures.
    Silent,
    /// An answer was marked as faulty, or was none to the question.
    Frame {
        /// What came.
        answer: u16,
    },
    /// A register does not hold what was written.
    NotKept {
        /// Its address.
        register: u16,
        /// What was written.
        wrote: u16,
        /// What was read.
        read: u16,
    },
    /// It reports a fault.
    Fault(Status),
}

impl GateDriverError {
    /// In two words: the status registers where it reports a fault. Anything else has bits above the eleven of a register: the
    /// answer (all ones where there was none) and all ones, or a register with its address as it was read, bit 15 set, and
    /// what was written.
    #[must_use]
    pub const fn words(self) -> [u16; 2] {
        match self {
            Self::Bus | Self::Silent => [0xFFFF; 2],
            Self::Frame { answer } => [answer | FRAME_FAULT, 0xFFFF],
            Self::NotKept {
                register,
                wrote,
                read,
            } => [READ | register << 11 | read, wrote],
            Self::Fault(Status { one, two }) => [one, two],
        }
    }
}

/// The two status registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// Status 1: bit 10 fault, 9 gate supply low, 8 motor supply low, 7 too hot, 6 warm, 5–0 over-current of high A, low A, high B,
    /// low B, high C, low C.
    pub one: u16,
    /// Status 2: bit 7 gate supply high, 3–0 which chip.
    pub two: u16,
}

impl Status {
    /// All but the warning of warmth.
    const FAULTS_1: u16 = 0x7BF;
    const FAULTS_2: u16 = 1 << 7;

    /// Something because of which the driver has turned off, or will.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        self.one & Self::FAULTS_1 != 0 || self.two & Self::FAULTS_2 != 0
    }

    /// Warm: about 20 °C below where it turns off.
    #[must_use]
    pub const fn is_warm(self) -> bool {
        self.one & 1 << 6 != 0
    }
}

/// The driver behind an SPI of 16-bit words, mode 1.
pub struct GateDriver<S> {
    spi: S,
}

impl<S: SpiDevice<u16>> GateDriver<S> {
    /// Talks to nobody yet.
    pub const fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Sets both control registers; the driver is on since at least 10 ms ([`restart`]).
    ///
    /// # Errors
    /// If one cannot be read or does not keep its value in five tries, or if there is a fault.
    pub fn configure(&mut self) -> Result<Status, GateDriverError> {
        self.keep(CONTROL_1, CONTROL_1_VALUE)?;
        self.keep(CONTROL_2, CONTROL_2_VALUE)?;
        self.check()
    }

    /// True to its settings and without fault; to be asked now and then. It may have been reset by a dip of
    /// its supply, and then measures with another gain.
    ///
    /// # Errors
    /// What is wrong. A fault's bits are read first: reading clears some.
    pub fn check(&mut self) -> Result<Status, GateDriverError> {
        let status = Status {
            one: self.read(STATUS_1)?,
            two: self.read(STATUS_2)?,
        };
        if status.is_fault() {
            return Err(GateDriverError::Fault(status));
        }
        for (register, wrote) in [(CONTROL_1, CONTROL_1_VALUE), (CONTROL_2, CONTROL_2_VALUE)] {
            let read = self.read(register)?;
            if read != wrote {
                return Err(GateDriverError::NotKept {
                    register,
                    wrote,
                    read,
                });
            }
        }
        Ok(status)
    }

    fn keep(&mut self, register: u16, value: u16) -> Result<(), GateDriverError> {
        let mut last = GateDriverError::Silent;
        for _ in 0..TRIES {
            self.frame(register << 11 | value)?;
            match self.read(register) {
                Ok(read) if read == value => return Ok(()),
                Ok(read) => {
                    last = GateDriverError::NotKept {
                        register,
                        wrote: value,
                        read,
                    };
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn read(&mut self, register: u16) -> Result<u16, GateDriverError> {
        self.frame(READ | register << 11)?;
        let answer = self.frame(READ | register << 11)?;
        // Status 1 without a fault is answered by zeros; the control registers never are.
        if answer == 0xFFFF || answer == 0 && register != STATUS_1 {
            return Err(GateDriverError::Silent);
        }
        if answer & FRAME_FAULT != 0 || answer >> 11 != register {
            return Err(GateDriverError::Frame { answer });
        }
        Ok(answer & DATA)
    }

    fn frame(&mut self, word: u16) -> Result<u16, GateDriverError> {
        let mut words = [word];
        self.spi
            .transfer_in_place(&mut words)
            .map_err(|_| GateDriverError::Bus)?;
        let [answer] = words;
        Ok(answer)
    }
}

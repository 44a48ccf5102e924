//! The bus voltage, which variant of the board it is read on, and how warm the FETs are.
//!
//! The brake is off for good: [`super::pins`] holds both its gates low. What a knob gives back to the bus is
//! bounded; the trip on over-voltage does the rest.

use super::Registers;
use crate::power::{ODRIVE_V3_24V, StageFacts};

/// One-time programmable memory.
const OTP: u32 = 0x1FFF_7800;

/// What the bus may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// 24 V, and boards that do not say: their bytes are blank. Reads too low on a board for more, so that the trip of
    /// over-voltage would come at 44 V, below what that board bears.
    Volts24,
    /// 48 V.
    Volts48,
    /// 56 V.
    Volts56,
}

/// Which variant the maker wrote into the chip (bytes 3 to 5: version major, minor, voltage).
pub fn variant(registers: &mut impl Registers) -> Variant {
    let [.., major] = registers.read(OTP).to_le_bytes();
    let [_minor, voltage, ..] = registers.read(OTP + 4).to_le_bytes();
    match (major, voltage) {
        (3, 48) => Variant::Volts48,
        (3, 56) => Variant::Volts56,
        _ => Variant::Volts24,
    }
}

impl Variant {
    /// Bus voltage over voltage at the converter.
    const fn divider(self) -> f64 {
        match self {
            Self::Volts24 => 11.0,
            Self::Volts48 | Self::Volts56 => 19.0,
        }
    }

    /// One code of the bus voltage's converter, V.
    #[must_use]
    pub const fn bus_step_v(self) -> f32 {
        (3.3 / 4096.0 * self.divider()) as f32
    }

    /// What its stage is made of.
    #[must_use]
    pub const fn facts(self) -> StageFacts {
        StageFacts {
            bus_most_v: match self {
                Self::Volts24 => ODRIVE_V3_24V.bus_most_v,
                Self::Volts48 => 51.36,
                Self::Volts56 => 59.92,
            },
            ..ODRIVE_V3_24V
        }
    }
}

/// The FETs' temperature, °C: within 1.5 °C of the thermistor's law (10 kΩ, B 3434 K, to the supply; 3.3 kΩ to
/// ground) from 0 to 120 °C. None where the thermistor does not answer: a code that only one colder than −20 °C, or
/// a short circuit, would give.
#[must_use]
pub fn fet_temperature_c(code: u16) -> Option<f32> {
    if !(100..=3900).contains(&code) {
        return None;
    }
    let x = f32::from(code) * (1.0 / 4096.0);
    Some(((363.939 * x - 462.154) * x + 307.551) * x - 27.726)
}

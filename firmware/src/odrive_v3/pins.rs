//! Every pin of the board that something hangs on. Pins that are not named here stay as the reset leaves them; among
//! them are PA13 and PA14, by which a debugger talks to the chip.

use super::Registers;

/// What a pin is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    Input,
    Low,
    High,
    /// Alternate function of this number.
    Function(u32),
    Analog,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Port {
    A,
    B,
    C,
    D,
}

impl Port {
    const fn base(self) -> u32 {
        match self {
            Self::A => 0x4002_0000,
            Self::B => 0x4002_0400,
            Self::C => 0x4002_0800,
            Self::D => 0x4002_0C00,
        }
    }
}

const MODER: u32 = 0x00;
const OTYPER: u32 = 0x04;
const OSPEEDR: u32 = 0x08;
const PUPDR: u32 = 0x0C;
const IDR: u32 = 0x10;
const BSRR: u32 = 0x18;
const AFRL: u32 = 0x20;
const AFRH: u32 = 0x24;

const MODE_INPUT: u32 = 0;
const MODE_OUTPUT: u32 = 1;
const MODE_FUNCTION: u32 = 2;
const MODE_ANALOG: u32 = 3;
const NO_PULL: u32 = 0;
const PULL_UP: u32 = 1;
const SPEED_LOW: u32 = 0;
const SPEED_MEDIUM: u32 = 1;

const RCC_AHB1ENR: u32 = 0x4002_3830;
/// GPIOA to GPIOD.
const GPIO_A_TO_D: u32 = 0xF;

const AF_TIM1: u32 = 1;
const AF_TIM3: u32 = 2;
const AF_SPI3: u32 = 6;
const AF_UART4: u32 = 8;

struct Pin(Port, u32, Use, u32);

/// Outputs, from the first that matters to the last.
const OUTPUTS: [Pin; 11] = [
    // EN_GATE of both gate drivers: low, they are off.
    Pin(Port::B, 12, Use::Low, NO_PULL),
    // The brake's low and high side. TIM2 could switch them; nothing here ever does.
    Pin(Port::B, 10, Use::Low, NO_PULL),
    Pin(Port::B, 11, Use::Low, NO_PULL),
    // The inputs of axis 1's gate driver, which EN_GATE turns on too: high sides, low sides.
    Pin(Port::C, 6, Use::Low, NO_PULL),
    Pin(Port::C, 7, Use::Low, NO_PULL),
    Pin(Port::C, 8, Use::Low, NO_PULL),
    Pin(Port::A, 7, Use::Low, NO_PULL),
    Pin(Port::B, 0, Use::Low, NO_PULL),
    Pin(Port::B, 1, Use::Low, NO_PULL),
    // nCS of axis 1's driver and of ours. Both drivers pull theirs down while EN_GATE is high, and would answer
    // over each other.
    Pin(Port::C, 14, Use::High, NO_PULL),
    Pin(Port::C, 13, Use::High, NO_PULL),
];

const OTHERS: [Pin; 20] = [
    // TIM1: high sides A, B, C, low sides A, B, C.
    Pin(Port::A, 8, Use::Function(AF_TIM1), NO_PULL),
    Pin(Port::A, 9, Use::Function(AF_TIM1), NO_PULL),
    Pin(Port::A, 10, Use::Function(AF_TIM1), NO_PULL),
    Pin(Port::B, 13, Use::Function(AF_TIM1), NO_PULL),
    Pin(Port::B, 14, Use::Function(AF_TIM1), NO_PULL),
    Pin(Port::B, 15, Use::Function(AF_TIM1), NO_PULL),
    // Currents of B and C, bus voltage, FET temperature.
    Pin(Port::C, 0, Use::Analog, NO_PULL),
    Pin(Port::C, 1, Use::Analog, NO_PULL),
    Pin(Port::A, 6, Use::Analog, NO_PULL),
    Pin(Port::C, 5, Use::Analog, NO_PULL),
    // Encoder A, B, index; the board pulls them up. PB4 is NJTRST after reset, with a pull-up.
    Pin(Port::B, 4, Use::Function(AF_TIM3), NO_PULL),
    Pin(Port::B, 5, Use::Function(AF_TIM3), NO_PULL),
    Pin(Port::C, 9, Use::Input, NO_PULL),
    // nFAULT: open drain, and nothing on the board pulls it up.
    Pin(Port::D, 2, Use::Input, PULL_UP),
    // SPI3: SCK, MISO, MOSI. A driver that does not answer reads as all ones, which is not healthy.
    Pin(Port::C, 10, Use::Function(AF_SPI3), NO_PULL),
    Pin(Port::C, 11, Use::Function(AF_SPI3), PULL_UP),
    Pin(Port::C, 12, Use::Function(AF_SPI3), NO_PULL),
    // UART4: TX, RX. An open RX is a quiet line.
    Pin(Port::A, 0, Use::Function(AF_UART4), NO_PULL),
    Pin(Port::A, 1, Use::Function(AF_UART4), PULL_UP),
    // The other axis's FET temperature: not read.
    Pin(Port::A, 4, Use::Analog, NO_PULL),
];

/// All that drives something is off: gate drivers, brake, the other axis; no gate driver is selected.
/// The level is there before the pin becomes an output.
pub fn hold_off(registers: &mut impl Registers) {
    registers.set(RCC_AHB1ENR, GPIO_A_TO_D);
    // A peripheral takes nothing in the first two cycles of its clock.
    registers.read(RCC_AHB1ENR);
    for pin in &OUTPUTS {
        connect_one(registers, pin);
    }
}

/// All other pins. Only after [`super::bridge::set_up`], so that TIM1 holds the bridge's pins low as soon as it
/// gets them.
pub fn connect(registers: &mut impl Registers) {
    for pin in &OTHERS {
        connect_one(registers, pin);
    }
}

fn connect_one(registers: &mut impl Registers, pin: &Pin) {
    let Pin(port, number, usage, pull) = *pin;
    let base = port.base();
    let (mode, speed) = match usage {
        Use::Input => (MODE_INPUT, SPEED_LOW),
        Use::Low | Use::High => (MODE_OUTPUT, SPEED_LOW),
        Use::Function(_) => (MODE_FUNCTION, SPEED_MEDIUM),
        Use::Analog => (MODE_ANALOG, SPEED_LOW),
    };
    match usage {
        Use::Low => registers.write(base + BSRR, 1 << (number + 16)),
        Use::High => registers.write(base + BSRR, 1 << number),
        Use::Function(function) => {
            let (register, place) = if number < 8 {
                (AFRL, 4 * number)
            } else {
                (AFRH, 4 * (number - 8))
            };
            registers.change(base + register, 0xF << place, function << place);
        }
        Use::Input | Use::Analog => {}
    }
    registers.clear(base + OTYPER, 1 << number);
    registers.change(base + OSPEEDR, 3 << (2 * number), speed << (2 * number));
    registers.change(base + PUPDR, 3 << (2 * number), pull << (2 * number));
    registers.change(base + MODER, 3 << (2 * number), mode << (2 * number));
}

/// Turns both gate drivers on or off. How long to wait then says [`super::gate_driver`].
pub(super) fn set_en_gate(registers: &mut impl Registers, high: bool) {
    let bit = if high { 1 << 12 } else { 1 << (12 + 16) };
    registers.write(Port::B.base() + BSRR, bit);
}

/// Selects axis 0's gate driver (nCS low), or no longer.
pub(super) fn set_gate_driver_selected(registers: &mut impl Registers, selected: bool) {
    let bit = if selected { 1 << (13 + 16) } else { 1 << 13 };
    registers.write(Port::C.base() + BSRR, bit);
}

/// True while a gate driver pulls nFAULT down.
pub fn is_fault_signalled(registers: &mut impl Registers) -> bool {
    registers.read(Port::D.base() + IDR) & 1 << 2 == 0
}

const SYSCFG_EXTICR1: u32 = 0x4001_3808;
const EXTI_IMR: u32 = 0x4001_3C00;
const EXTI_RTSR: u32 = 0x4001_3C08;
const EXTI_FTSR: u32 = 0x4001_3C0C;
const EXTI_PR: u32 = 0x4001_3C14;
const EXTICR1_2: u32 = 0xF << 8;
const EXTICR1_2_PD: u32 = 3 << 8;
const LINE_2: u32 = 1 << 2;

/// From now on a falling nFAULT is an EXTI2 interrupt. Only once the gate driver runs: it pulls nFAULT down while it
/// starts. An edge is what counts, so [`is_fault_signalled`] is to be looked at once afterwards.
pub fn listen_to_fault(registers: &mut impl Registers) {
    registers.change(SYSCFG_EXTICR1, EXTICR1_2, EXTICR1_2_PD);
    registers.clear(EXTI_RTSR, LINE_2);
    registers.set(EXTI_FTSR, LINE_2);
    registers.write(EXTI_PR, LINE_2);
    registers.set(EXTI_IMR, LINE_2);
}

/// No EXTI2 interrupt, while the gate driver is off or starts.
pub fn ignore_fault(registers: &mut impl Registers) {
    registers.clear(EXTI_IMR, LINE_2);
}

/// EXTI2 has been served.
pub fn acknowledge_fault(registers: &mut impl Registers) {
    registers.write(EXTI_PR, LINE_2);
}

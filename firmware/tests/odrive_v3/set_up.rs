//! Clocks, pins, watchdog, and the order in which things happen.

use firmware::odrive_v3::{self as board, SetUpError, gate_driver, pins, reset};
use protocol::ResetReason;

use crate::sim::{ADC, Chip, EXTI, FLASH, GPIO, IWDG, OFF_WORD, PWR, RCC, SPI3, TIM1, TIM3, UART4};

pub fn set_up() -> Chip {
    let mut chip = Chip::new();
    board::set_up(&mut chip, OFF_WORD).unwrap();
    chip
}

/// The first write that the predicate accepts.
fn first(chip: &Chip, accept: impl Fn(u32, u32) -> bool) -> usize {
    let writes = chip.writes();
    let found = writes.iter().position(|(at, value)| accept(*at, *value));
    found.expect("such a write")
}

#[test]
fn set_up_and_the_start_of_the_gate_driver_break_no_law() {
    let mut chip = set_up();
    gate_driver::restart(&mut chip);
    pins::listen_to_fault(&mut chip);
    chip.assert_no_violations();
    assert!(chip.sim().drv.on_since.is_some());
    assert!(!pins::is_fault_signalled(&mut chip));
}

#[test]
fn the_core_has_168_mhz_and_the_buses_what_they_may_have() {
    let chip = set_up();
    let pll = chip.word(RCC + 0x04);
    assert_eq!(pll >> 22 & 1, 1, "from the crystal");
    let vco_in = 8e6 / f64::from(pll & 0x3F);
    assert!((1e6..=2e6).contains(&vco_in), "{vco_in}");
    let vco = vco_in * f64::from(pll >> 6 & 0x1FF);
    assert!((100e6..=432e6).contains(&vco), "{vco}");
    let system = vco / f64::from(2 * (pll >> 16 & 3) + 2);
    let usb = vco / f64::from(pll >> 24 & 0xF);
    let cfgr = chip.word(RCC + 0x08);
    let divider = |bits: u32| {
        if bits < 4 {
            1.0
        } else {
            f64::from(2 << (bits - 4))
        }
    };
    assert_eq!(cfgr >> 7 & 1, 0, "AHB is not divided");
    let apb1 = system / divider(cfgr >> 10 & 7);
    let apb2 = system / divider(cfgr >> 13 & 7);
    assert_eq!((system, usb, apb1, apb2), (168e6, 48e6, 42e6, 84e6));
    assert_eq!(cfgr & 3, 2, "the PLL is the system's clock");
    // Above 150 MHz at 3.3 V: 5 wait states, voltage scale 1.
    assert_eq!(chip.word(FLASH) & 7, 5);
    assert_eq!(chip.word(PWR) >> 14 & 1, 1);
    // The supply is watched, at 2.9 V.
    assert_eq!(chip.word(PWR) >> 4 & 0xF, 0b1111);
    // The clock security system, which breaks TIM1 off.
    assert_eq!(chip.word(RCC) >> 19 & 1, 1);
    assert_eq!(chip.word(TIM1 + 0x44) >> 12 & 3, 0b11);
}

#[test]
fn an_oscillator_that_does_not_start_is_an_error_and_leaves_everything_off() {
    type Damage = fn(&Chip);
    let attempts: [(Damage, SetUpError); 7] = [
        (|chip| chip.sim().crystal_dead = true, SetUpError::Crystal),
        (|chip| chip.sim().pll_dead = true, SetUpError::Pll),
        (
            |chip| chip.sim().internal_dead = true,
            SetUpError::InternalClock,
        ),
        (|chip| chip.sim().timer_dead = true, SetUpError::PwmUpdate),
        (|chip| chip.sim().dma_dead = true, SetUpError::DeadMan),
        // Something else lies in memory.
        (|chip| chip.poke(OFF_WORD, 0), SetUpError::DeadMan),
        // Updates at the bottom of the count.
        (|chip| chip.sim().odd_silicon = true, SetUpError::PwmUpdate),
    ];
    for (damage, error) in attempts {
        let mut chip = Chip::new();
        damage(&chip);
        assert_eq!(board::set_up(&mut chip, OFF_WORD), Err(error));
        assert!(!error.text().is_empty());
        chip.assert_no_violations();
        assert!(!chip.sim().moe());
        assert_eq!(chip.sim().driven('B', 12), Some(false), "EN_GATE");
        assert!(chip.sim().now < 168_000_000, "within a second");
        for adc in ADC {
            assert_eq!(chip.word(adc + 8) >> 20 & 3, 0, "no current ticks");
        }
    }
}

#[test]
fn what_the_roms_bootloader_left_behind_is_undone_before_it_is_changed() {
    let mut chip = Chip::new();
    // The PLL runs from the crystal and is the system's clock.
    chip.poke(RCC, 0x0301_0083 & !(2 << 24) | 1 << 24);
    chip.poke(RCC + 0x08, 2 | 5 << 10 | 4 << 13);
    chip.poke(FLASH, 5);
    board::set_up(&mut chip, OFF_WORD).unwrap();
    chip.assert_no_violations();
    assert_eq!(chip.word(RCC + 0x04) >> 6 & 0x1FF, 168);
    assert_eq!(chip.word(0xE000_ED08), 0x0800_0000, "vectors");
}

const INPUT: u32 = 0;
const OUTPUT: u32 = 1;
const FUNCTION: u32 = 2;
const ANALOG: u32 = 3;
const UP: u32 = 1;

/// Pin, mode, function, pull, level.
type PinTable = &'static [(char, u32, u32, u32, u32, bool)];

/// The board's table: design notes, schematic.
const PINS: PinTable = &[
    ('A', 8, FUNCTION, 1, 0, false),
    ('A', 9, FUNCTION, 1, 0, false),
    ('A', 10, FUNCTION, 1, 0, false),
    ('B', 13, FUNCTION, 1, 0, false),
    ('B', 14, FUNCTION, 1, 0, false),
    ('B', 15, FUNCTION, 1, 0, false),
    ('C', 0, ANALOG, 0, 0, false),
    ('C', 1, ANALOG, 0, 0, false),
    ('A', 6, ANALOG, 0, 0, false),
    ('C', 5, ANALOG, 0, 0, false),
    ('B', 4, FUNCTION, 2, 0, false),
    ('B', 5, FUNCTION, 2, 0, false),
    ('C', 9, INPUT, 0, 0, false),
    ('C', 10, FUNCTION, 6, 0, false),
    ('C', 11, FUNCTION, 6, UP, false),
    ('C', 12, FUNCTION, 6, 0, false),
    ('C', 13, OUTPUT, 0, 0, true),
    ('C', 14, OUTPUT, 0, 0, true),
    ('B', 12, OUTPUT, 0, 0, false),
    ('D', 2, INPUT, 0, UP, false),
    ('A', 0, FUNCTION, 8, 0, false),
    ('A', 1, FUNCTION, 8, UP, false),
    ('B', 10, OUTPUT, 0, 0, false),
    ('B', 11, OUTPUT, 0, 0, false),
    ('C', 6, OUTPUT, 0, 0, false),
    ('C', 7, OUTPUT, 0, 0, false),
    ('C', 8, OUTPUT, 0, 0, false),
    ('A', 7, OUTPUT, 0, 0, false),
    ('B', 0, OUTPUT, 0, 0, false),
    ('B', 1, OUTPUT, 0, 0, false),
    // The debugger's, with their pulls.
    ('A', 13, FUNCTION, 0, UP, false),
    ('A', 14, FUNCTION, 0, 2, false),
];

#[test]
fn every_pin_has_the_boards_use_pull_and_level() {
    let chip = set_up();
    for &(port, number, mode, function, pull, level) in PINS {
        let is = chip.pin(port, number);
        assert_eq!(
            (is.0, if is.0 == FUNCTION { is.1 } else { 0 }, is.2, is.3),
            (mode, function, pull, level),
            "P{port}{number}"
        );
        // Push and pull.
        let base = GPIO[port as usize - 'A' as usize];
        assert_eq!(chip.word(base + 0x04) >> number & 1, 0);
    }
}

#[test]
fn levels_are_there_before_outputs_are_and_outputs_before_anything_else() {
    let chip = set_up();
    let clock = first(&chip, |at, value| at == RCC + 0x08 && value & 3 == 2);
    for &(port, number, mode, _, _, level) in PINS.iter().filter(|pin| pin.2 == OUTPUT) {
        let base = GPIO[port as usize - 'A' as usize];
        let bit = if level { number } else { number + 16 };
        let set = first(&chip, |at, value| {
            at == base + 0x18 && value >> bit & 1 == 1
        });
        let made = first(&chip, |at, value| {
            at == base && value >> (2 * number) & 3 == mode
        });
        assert!(set < made && made < clock, "P{port}{number}");
    }
}

#[test]
fn bridge_pins_go_to_tim1_only_when_it_holds_them_low() {
    let chip = set_up();
    let ready = first(&chip, |at, value| at == TIM1 + 0x20 && value == 0x555);
    for (port, number) in [(0, 8), (0, 9), (0, 10), (1, 13), (1, 14), (1, 15)] {
        let given = first(&chip, |at, value| {
            at == GPIO[port] && value >> (2 * number) & 3 == FUNCTION
        });
        assert!(ready < given);
        // And the function is chosen first, or another one would have the pin for a moment.
        let chosen = first(&chip, |at, value| {
            at == GPIO[port] + 0x24 && value >> (4 * (number - 8)) & 0xF == 1
        });
        assert!(chosen < given);
    }
    // Both ends of the order: EN_GATE last of all, after PC14 is high.
    let mut chip = chip;
    gate_driver::restart(&mut chip);
    let enabled = first(&chip, |at, value| {
        at == GPIO[1] + 0x18 && value >> 12 & 1 == 1
    });
    let high = first(&chip, |at, value| {
        at == GPIO[2] + 0x18 && value >> 14 & 1 == 1
    });
    assert!(high < enabled && ready < enabled);
}

#[test]
fn peripherals_are_used_only_with_a_clock_and_after_their_reset() {
    let chip = set_up();
    let clocks = [
        (TIM1, 0x44, 0),
        (ADC[0], 0x44, 8),
        (ADC[1], 0x44, 9),
        (ADC[2], 0x44, 10),
        (TIM3, 0x40, 1),
        (SPI3, 0x40, 15),
        (UART4, 0x40, 19),
    ];
    for (base, register, bit) in clocks {
        let on = first(&chip, |at, value| {
            at == RCC + register && value >> bit & 1 == 1
        });
        // The very first write, which turns a bridge off that may be on, is meant.
        let writes = chip.writes();
        let used = writes
            .iter()
            .skip(1)
            .position(|(at, _)| (base..base + 0x80).contains(at));
        assert!(on < used.unwrap() + 1, "{base:#x}");
    }
    assert_eq!(chip.writes()[0].0, TIM1 + 0x44);
    assert_eq!(chip.word(RCC + 0x20), 0);
    assert_eq!(chip.word(RCC + 0x24), 0);
}

#[test]
fn the_watchdog_outlasts_an_erase_on_its_fastest_clock_and_bites_on_its_slowest() {
    let chip = set_up();
    let divider = f64::from(4 << chip.word(IWDG + 0x04));
    let ticks = f64::from(chip.word(IWDG + 0x08) & 0xFFF) + 1.0;
    let period_s = |clock_hz: f64| divider * ticks / clock_hz;
    // 32 kHz and 47 % more or less; an erase of 2 s and some margin.
    assert!(period_s(32e3 * 1.47) > 2.5, "{}", period_s(32e3 * 1.47));
    assert!(period_s(32e3 * 0.53) < 10.0);
    let order: Vec<_> = chip
        .writes()
        .into_iter()
        .filter(|(at, _)| (IWDG..IWDG + 0x10).contains(at))
        .collect();
    assert_eq!(order.first(), Some(&(IWDG, 0xCCCC)));
    assert_eq!(order.last(), Some(&(IWDG, 0xAAAA)));
    // Under a debugger it stands still, with TIM1.
    assert_eq!(chip.word(0xE004_2008) >> 12 & 1, 1);
    assert_eq!(chip.word(0xE004_200C) & 1, 1);
}

#[test]
fn the_reset_reason_is_told_once() {
    for (flags, reason) in [
        (0x0E00_0000, ResetReason::PowerOn),
        (0x0600_0000, ResetReason::BrownOut),
        (0x0400_0000, ResetReason::Pin),
        (0x1400_0000, ResetReason::Software),
        (0x2400_0000, ResetReason::Watchdog),
        (0x4400_0000, ResetReason::Unknown),
        (0x8400_0000, ResetReason::Unknown),
    ] {
        let mut chip = Chip::new();
        chip.poke(RCC + 0x74, flags);
        assert_eq!(board::set_up(&mut chip, OFF_WORD), Ok(reason), "{flags:#x}");
        // A later reset by the pin alone would set only its flag.
        assert_eq!(chip.word(RCC + 0x74), 0);
        assert_eq!(reset::take_reason(&mut chip), ResetReason::Pin);
    }
}

#[test]
fn nfault_interrupts_on_its_falling_edge_once_the_driver_runs() {
    let mut chip = set_up();
    assert_eq!(chip.word(EXTI) & 4, 0, "not while it may be low");
    assert!(pins::is_fault_signalled(&mut chip), "EN_GATE is low");
    gate_driver::restart(&mut chip);
    pins::listen_to_fault(&mut chip);
    assert_eq!(chip.word(0x4001_3808) >> 8 & 0xF, 3, "port D");
    assert_eq!(chip.word(EXTI + 0x0C), 4, "falling");
    assert_eq!(chip.word(EXTI + 0x08), 0, "not rising");
    assert_eq!(chip.word(EXTI), 4);
    chip.poke(EXTI + 0x14, 4);
    pins::acknowledge_fault(&mut chip);
    assert_eq!(chip.word(EXTI + 0x14), 0);
    pins::ignore_fault(&mut chip);
    assert_eq!(chip.word(EXTI), 0);
}

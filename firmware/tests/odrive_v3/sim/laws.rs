//! What is driven at the pins, and what must hold at every moment.

use super::{FLASH, GPIO, PWR, RCC, SPI3, Sim, TIM1, TIM3, TIM5, TIM8, UART4};

impl Sim {
    pub fn pin(&self, port: char, number: u32) -> (u32, u32, u32, bool) {
        let base = GPIO[port as usize - 'A' as usize];
        let two = |register: u32| self.stored(base + register) >> (2 * number) & 3;
        let function = self.stored(base + 0x20 + 4 * (number / 8)) >> (4 * (number % 8)) & 0xF;
        let level = self.stored(base + 0x14) >> number & 1 == 1;
        (two(0), function, two(0x0C), level)
    }

    /// None where nothing drives the pin.
    pub fn driven(&self, port: char, number: u32) -> Option<bool> {
        match self.pin(port, number) {
            (1, _, _, level) => Some(level),
            (2, 1, _, _) => self.timer_output(port, number),
            _ => None,
        }
    }

    /// What TIM1 drives one of the six pins to; only while MOE is clear.
    fn timer_output(&self, port: char, number: u32) -> Option<bool> {
        let (channel, negated) = match (port, number) {
            ('A', 8..=10) => (number - 8, false),
            ('B', 13..=15) => (number - 13, true),
            _ => return None,
        };
        let enable = 4 * channel + if negated { 2 } else { 0 };
        let bdtr = self.stored(TIM1 + 0x44);
        if bdtr & 1 << 15 != 0 || bdtr & 1 << 10 == 0 || self.stored(TIM1 + 0x20) >> enable & 1 == 0
        {
            return None;
        }
        let idle = 8 + 2 * channel + u32::from(negated);
        Some(self.stored(TIM1 + 0x04) >> idle & 1 == 1)
    }

    pub(super) fn en_gate(&self) -> bool {
        self.driven('B', 12) == Some(true)
    }

    pub(super) fn has_clock(&self, address: u32) -> bool {
        let bit = |register: u32, bit: u32| self.stored(RCC + register) >> bit & 1 == 1;
        match address & !0x3FF {
            0x4002_0000 => bit(0x30, 0),
            0x4002_0400 => bit(0x30, 1),
            0x4002_0800 => bit(0x30, 2),
            0x4002_0C00 => bit(0x30, 3),
            TIM1 => bit(0x44, 0),
            TIM8 => bit(0x44, 1),
            0x4002_6400 => bit(0x30, 22),
            0x4001_2000 => match address & 0x3FF {
                0..0x100 => bit(0x44, 8),
                0x100..0x200 => bit(0x44, 9),
                0x200..0x300 => bit(0x44, 10),
                _ => bit(0x44, 8),
            },
            0x4001_3800 => bit(0x44, 14),
            TIM3 => bit(0x40, 1),
            TIM5 => bit(0x40, 3),
            SPI3 => bit(0x40, 15),
            UART4 => bit(0x40, 19),
            PWR => bit(0x40, 28),
            _ => true,
        }
    }

    pub(super) fn check_laws(&mut self) {
        for (port, number) in [('A', 13), ('A', 14)] {
            if self.pin(port, number).0 != 2 || self.pin(port, number).1 != 0 {
                self.violation(format!("P{port}{number} is taken from the debugger"));
            }
        }
        let bridge = [
            ('A', 8),
            ('A', 9),
            ('A', 10),
            ('B', 13),
            ('B', 14),
            ('B', 15),
        ];
        for (port, number) in bridge {
            let is_connected = self.pin(port, number).0 != 0;
            if is_connected && !self.moe() && self.driven(port, number) != Some(false) {
                self.violation(format!("P{port}{number} is connected and not held low"));
            }
            if self.en_gate() && !is_connected {
                self.violation(format!("EN_GATE is high and P{port}{number} floats"));
            }
        }
        for (port, number) in [
            ('B', 10),
            ('B', 11),
            ('C', 6),
            ('C', 7),
            ('C', 8),
            ('A', 7),
            ('B', 0),
            ('B', 1),
        ] {
            if self.pin(port, number).0 != 0 && self.driven(port, number) != Some(false) {
                self.violation(format!("P{port}{number} is not low"));
            }
            if self.en_gate() && self.driven(port, number) != Some(false) {
                self.violation(format!("EN_GATE is high and P{port}{number} is not low"));
            }
        }
        if self.en_gate() && self.driven('C', 14) != Some(true) {
            self.violation("EN_GATE is high and axis 1's driver may be selected");
        }
        if self.driven('C', 14) == Some(false) {
            self.violation("axis 1's driver is selected");
        }
        let (cfgr, latency) = (self.stored(RCC + 8), self.stored(FLASH) & 7);
        if cfgr & 3 == 2 {
            if latency < 5 {
                self.violation("168 MHz with too few wait states");
            }
            if cfgr >> 10 & 7 < 5 || cfgr >> 13 & 7 < 4 {
                self.violation("168 MHz with APB1 above 42 MHz or APB2 above 84 MHz");
            }
        }
    }
}

//! The chip and what hangs on it, as far as the board module can tell: registers that answer as the manual says,
//! time, the counter of TIM1, the ADCs, the flash, a DRV8301. Everything that the firmware does is recorded in
//! order, and laws that must hold at every moment are checked after each write.
//!
//! Written from RM0090 and the DRV8301's data sheet, with no constant taken from the firmware.

mod flash;
mod laws;
mod timer;

use std::cell::{RefCell, RefMut};
use std::collections::BTreeMap;
use std::rc::Rc;

use firmware::odrive_v3::Registers;

use crate::drv8301::Drv8301;

pub const GPIO: [u32; 4] = [0x4002_0000, 0x4002_0400, 0x4002_0800, 0x4002_0C00];
pub const RCC: u32 = 0x4002_3800;
pub const TIM1: u32 = 0x4001_0000;
pub const TIM3: u32 = 0x4000_0400;
pub const ADC: [u32; 3] = [0x4001_2000, 0x4001_2100, 0x4001_2200];
pub const FLASH: u32 = 0x4002_3C00;
pub const PWR: u32 = 0x4000_7000;
pub const SPI3: u32 = 0x4000_3C00;
pub const UART4: u32 = 0x4000_4C00;
pub const IWDG: u32 = 0x4000_3000;
pub const EXTI: u32 = 0x4001_3C00;
pub const TIM8: u32 = 0x4001_0400;
const DMA2_S1: u32 = 0x4002_6428;
/// Where the word lies that turns the bridge off.
pub const OFF_WORD: u32 = 0x2000_0010;
const TIM5: u32 = 0x4000_0C00;
const SETTINGS: std::ops::Range<u32> = 0x080C_0000..0x0810_0000;
const OTP: u32 = 0x1FFF_7800;

/// One access of the firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Access {
    pub write: bool,
    pub address: u32,
    pub value: u32,
}

/// One update event of TIM1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Update {
    /// Ticks of 168 MHz since the counter started.
    pub at: u64,
    pub overflow: bool,
}

pub struct Sim {
    words: BTreeMap<u32, u32>,
    pub log: Vec<Access>,
    /// What must never be, and was.
    pub violations: Vec<String>,
    /// Ticks of 168 MHz.
    pub now: u64,
    pub crystal_dead: bool,
    pub internal_dead: bool,
    pub pll_dead: bool,
    // TIM1
    started: Option<u64>,
    dead_man_zero: u64,
    pub dead_man_fired: u32,
    pub dma_dead: bool,
    events_done: u64,
    repetitions: u32,
    /// A chip on which the repetition counter stands at 1 after a reset.
    pub odd_silicon: bool,
    pub timer_dead: bool,
    pub updates: Vec<Update>,
    /// The duties in force, as CCR.
    pub active: [u32; 3],
    pub triggers: Vec<u64>,
    // ADC: what lies at channels 0 to 15, and when conversions end.
    pub analog: [u16; 16],
    conversion_ends: [Option<u64>; 3],
    pub adc_dead: bool,
    // Flash
    pub flash: BTreeMap<u32, u32>,
    cache: BTreeMap<u32, u32>,
    keys: Vec<u32>,
    locked_for_good: bool,
    busy_until: u64,
    pub flash_error: u32,
    pub flash_never_ready: bool,
    pub supply_low: bool,
    pub erased: Vec<u32>,
    pub programmed: usize,
    pub longest_busy: u64,
    // SPI
    pub drv: Drv8301,
    selected: Option<u64>,
    answer: Option<u16>,
    pub spi_dead: bool,
    en_gate_fell: Option<u64>,
    // Serial
    pub received: Vec<u8>,
    pub lost_byte: bool,
    pub sent: Vec<u8>,
    // Watchdog
    iwdg_open: bool,
    iwdg_updating: u32,
    pub fed: Vec<u64>,
    pub otp: [u32; 2],
}

#[derive(Clone)]
pub struct Chip(Rc<RefCell<Sim>>);

impl Chip {
    pub fn new() -> Self {
        let mut words = BTreeMap::new();
        for (address, value) in [
            (GPIO[0], 0xA800_0000),
            (GPIO[0] + 0x0C, 0x6400_0000),
            (GPIO[1], 0x0000_0280),
            (GPIO[1] + 0x0C, 0x0000_0100),
            (GPIO[1] + 0x08, 0x0000_00C0),
            (RCC, 0x83),
            (RCC + 0x04, 0x2400_3010),
            (RCC + 0x30, 0x0010_0000),
            (RCC + 0x74, 0x0E00_0000),
            (PWR, 0x4000),
            (FLASH + 0x10, 0x8000_0000),
            (TIM1 + 0x2C, 0xFFFF),
            (TIM3 + 0x2C, 0xFFFF),
            (TIM8 + 0x2C, 0xFFFF),
            // Memory, as the program fills it at its start.
            (OFF_WORD, 20 | 0b11 << 10 | 0b11 << 12),
            (IWDG + 0x08, 0xFFF),
        ] {
            words.insert(address, value);
        }
        Self(Rc::new(RefCell::new(Sim {
            words,
            log: Vec::new(),
            violations: Vec::new(),
            now: 0,
            crystal_dead: false,
            internal_dead: false,
            pll_dead: false,
            started: None,
            dead_man_zero: 0,
            dead_man_fired: 0,
            dma_dead: false,
            events_done: 0,
            repetitions: 0,
            odd_silicon: false,
            timer_dead: false,
            updates: Vec::new(),
            active: [0; 3],
            triggers: Vec::new(),
            analog: std::array::from_fn(|channel| 100 * channel as u16 + 7),
            conversion_ends: [None; 3],
            adc_dead: false,
            flash: BTreeMap::new(),
            cache: BTreeMap::new(),
            keys: Vec::new(),
            locked_for_good: false,
            busy_until: 0,
            flash_error: 0,
            flash_never_ready: false,
            supply_low: false,
            erased: Vec::new(),
            programmed: 0,
            longest_busy: 0,
            drv: Drv8301::default(),
            selected: None,
            answer: None,
            spi_dead: false,
            en_gate_fell: None,
            received: Vec::new(),
            lost_byte: false,
            sent: Vec::new(),
            iwdg_open: false,
            iwdg_updating: 0,
            fed: Vec::new(),
            otp: [u32::MAX; 2],
        })))
    }

    pub fn sim(&self) -> RefMut<'_, Sim> {
        self.0.borrow_mut()
    }

    /// Lets time go by.
    pub fn pass(&self, ticks: u64) {
        let mut sim = self.sim();
        sim.now += ticks;
        sim.run_timer();
    }

    /// A register as it stands.
    pub fn word(&self, address: u32) -> u32 {
        self.sim().stored(address)
    }

    pub fn poke(&self, address: u32, value: u32) {
        self.sim().words.insert(address, value);
    }

    pub fn writes(&self) -> Vec<(u32, u32)> {
        let sim = self.sim();
        let writes = sim.log.iter().filter(|access| access.write);
        writes
            .map(|access| (access.address, access.value))
            .collect()
    }

    pub fn forget(&self) {
        self.sim().log.clear();
    }

    /// Mode (0 input, 1 output, 2 function, 3 analog), function, pull and output level of a pin.
    pub fn pin(&self, port: char, number: u32) -> (u32, u32, u32, bool) {
        self.sim().pin(port, number)
    }

    pub fn assert_no_violations(&self) {
        let sim = self.sim();
        assert!(sim.violations.is_empty(), "{:#?}", sim.violations);
    }
}

impl Registers for Chip {
    fn read(&mut self, address: u32) -> u32 {
        let mut sim = self.sim();
        sim.now += 4;
        sim.run_timer();
        let value = sim.answer_to_read(address);
        if !SETTINGS.contains(&address) {
            sim.log.push(Access {
                write: false,
                address,
                value,
            });
        }
        value
    }

    fn write(&mut self, address: u32, value: u32) {
        let mut sim = self.sim();
        sim.now += 4;
        sim.run_timer();
        sim.log.push(Access {
            write: true,
            address,
            value,
        });
        sim.take_write(address, value);
        sim.check_laws();
    }

    fn wait_us(&mut self, time_us: u32) {
        self.pass(168 * u64::from(time_us));
    }
}

impl Sim {
    fn stored(&self, address: u32) -> u32 {
        self.words.get(&address).copied().unwrap_or(0)
    }

    fn violation(&mut self, text: impl Into<String>) {
        let text = text.into();
        if !self.violations.contains(&text) {
            self.violations.push(text);
        }
    }

    pub fn moe(&self) -> bool {
        self.stored(TIM1 + 0x44) & 1 << 15 != 0
    }

    fn answer_to_read(&mut self, address: u32) -> u32 {
        if !self.has_clock(address) {
            return 0;
        }
        let stored = self.stored(address);
        match address {
            RCC => {
                let on = |bit: u32, dead: bool| stored >> bit & 1 == 1 && !dead;
                let mut value = stored & !(1 << 1 | 1 << 17 | 1 << 25);
                value |= u32::from(on(0, self.internal_dead)) << 1;
                value |= u32::from(on(16, self.crystal_dead)) << 17;
                let source = on(16, self.crystal_dead) || self.stored(RCC + 4) & 1 << 22 == 0;
                value |= u32::from(on(24, self.pll_dead) && source) << 25;
                value
            }
            a if a == RCC + 0x08 => stored & !0xC | (stored & 3) << 2,
            a if a == PWR + 0x04 => 1 << 14 | u32::from(self.supply_low) << 2,
            a if a == GPIO[3] + 0x10 => {
                let low = self.drv.pulls_fault_down(self.now);
                if low { 0 } else { 1 << 2 }
            }
            a if a == TIM1 => {
                let falling = self.position().is_some_and(|at| at >= self.top());
                stored & !(1 << 4) | u32::from(falling) << 4
            }
            a if a == TIM5 + 0x24 && self.stored(TIM5) & 1 != 0 => (self.now / 2) as u32,
            a if a == TIM1 + 0x24 => {
                let (at, top) = (self.position().unwrap_or(0), self.top());
                (if at < top { at } else { 2 * top - at }) as u32
            }
            a if a == ADC[0] + 0x4C => {
                *self.words.entry(ADC[0]).or_default() &= !2;
                let channel = self.stored(ADC[0] + 0x34) & 31;
                u32::from(self.analog[channel as usize])
            }
            a if a == SPI3 + 0x08 => {
                2 | u32::from(self.answer.is_some()) | u32::from(self.spi_dead) << 7
            }
            a if a == SPI3 + 0x0C => u32::from(self.answer.take().unwrap_or(0)),
            a if a == UART4 => {
                let any = !self.received.is_empty();
                0xC0 | u32::from(any) << 5 | u32::from(self.lost_byte) << 3
            }
            a if a == UART4 + 0x04 => {
                self.lost_byte = false;
                if self.received.is_empty() {
                    0
                } else {
                    u32::from(self.received.remove(0))
                }
            }
            a if a == IWDG + 0x0C => {
                self.iwdg_updating = self.iwdg_updating.saturating_sub(1);
                if self.iwdg_updating > 0 { 3 } else { 0 }
            }
            a if a == FLASH + 0x0C => {
                let busy = self.flash_never_ready || self.now < self.busy_until;
                stored | u32::from(busy) << 16
            }
            a if a == OTP => self.otp[0],
            a if a == OTP + 4 => self.otp[1],
            a if SETTINGS.contains(&a) => {
                let held = self.flash.get(&a).copied().unwrap_or(u32::MAX);
                if self.stored(FLASH) & 1 << 10 == 0 {
                    return held;
                }
                *self.cache.entry(a).or_insert(held)
            }
            _ => stored,
        }
    }

    fn take_write(&mut self, address: u32, value: u32) {
        if !address.is_multiple_of(4) {
            self.violation(format!("{address:#010x} is no word"));
        }
        if !self.has_clock(address) {
            return;
        }
        let before = self.stored(address);
        match address {
            a if GPIO.map(|base| base + 0x18).contains(&a) => {
                let odr = a - 0x18 + 0x14;
                let level = self.stored(odr) & !(value >> 16) | value & 0xFFFF;
                self.words.insert(odr, level);
                self.follow_pins();
                return;
            }
            a if a == RCC + 0x04 && self.stored(RCC) & 1 << 24 != 0 => {
                self.violation("PLLCFGR is written while the PLL runs");
                return;
            }
            a if a == RCC + 0x24 => {
                if value & 1 != 0 {
                    self.words.retain(|word, _| word & !0x3FF != TIM1);
                    self.words.insert(TIM1 + 0x2C, 0xFFFF);
                    self.repetitions = u32::from(self.odd_silicon);
                    self.started = None;
                }
                if value & 1 << 8 != 0 {
                    self.words.retain(|word, _| word & !0x3FF != 0x4001_2000);
                }
            }
            a if a == RCC + 0x74 => {
                let kept = if value & 1 << 24 != 0 { 0 } else { before };
                self.words.insert(a, kept);
                return;
            }
            a if a == TIM1 => {
                if value & 1 != 0 && before & 1 == 0 {
                    self.started = Some(self.now);
                    self.events_done = 0;
                } else if value & 1 == 0 {
                    self.started = None;
                }
            }
            a if a == TIM8 + 0x24 || a == TIM8 => self.dead_man_zero = self.now,
            // Flags are cleared by zeros.
            a if a == TIM1 + 0x10 || ADC.contains(&a) => {
                self.words.insert(a, before & value);
                return;
            }
            a if a == TIM1 + 0x14 => {
                self.repetitions = self.stored(TIM1 + 0x30);
                if ADC.iter().any(|adc| self.stored(adc + 8) >> 20 & 3 != 0) {
                    self.violation("UG while the ADCs listen to TRGO");
                }
                return;
            }
            a if a == TIM1 + 0x44 && value & 1 << 15 != 0 => {
                self.violation("MOE is set by hand, not by an update");
            }
            a if a == ADC[0] + 0x08 && value & 1 << 30 != 0 => {
                self.words.insert(a, value & !(1 << 30));
                if !self.adc_dead {
                    *self.words.entry(ADC[0]).or_default() |= 2;
                }
                return;
            }
            a if a == SPI3 + 0x0C => {
                self.spi_word(value);
                return;
            }
            a if a == UART4 + 0x04 => {
                self.sent.push(value as u8);
                self.now += 14_600;
                return;
            }
            a if a == IWDG => {
                self.iwdg_open = value == 0x5555;
                if value == 0xAAAA {
                    let now = self.now;
                    self.fed.push(now);
                }
            }
            a if a == IWDG + 4 || a == IWDG + 8 => {
                if !self.iwdg_open {
                    return;
                }
                self.iwdg_updating = 5;
            }
            a if a == EXTI + 0x14 => {
                self.words.insert(a, before & !value);
                return;
            }
            a if (FLASH..FLASH + 0x18).contains(&a) => {
                self.flash_register(a - FLASH, value);
                return;
            }
            a if (0x0800_0000..0x0810_0000).contains(&a) => {
                self.program(a, value);
                return;
            }
            _ => {}
        }
        self.words.insert(address, value);
        self.follow_pins();
    }

    fn follow_pins(&mut self) {
        let now = self.now;
        match (self.drv.on_since, self.en_gate()) {
            (None, true) => {
                if let Some(fell) = self.en_gate_fell.take() {
                    let low_us = (now - fell) as f64 / 168.0;
                    if (10.0..=20.0).contains(&low_us) {
                        self.violation(format!("EN_GATE was low for {low_us} µs"));
                    }
                }
                self.drv.turn_on(now);
            }
            (Some(_), false) => {
                self.en_gate_fell = Some(now);
                self.drv.turn_off();
            }
            _ => {}
        }
        let selected = self.driven('C', 13) == Some(false);
        match (self.selected, selected) {
            (None, true) => self.selected = Some(now),
            (Some(_), false) => self.selected = None,
            _ => {}
        }
    }

    fn spi_word(&mut self, value: u32) {
        let cr1 = self.stored(SPI3);
        // CPHA, no CPOL, master, enabled, MSB first, 16 bits.
        if cr1 & 0b1100_1000_0111 != 0b1000_0000_0101 || cr1 & 0x40 == 0 || value > 0xFFFF {
            self.violation(format!(
                "SPI3 is not ready for 16 bits in mode 1: {cr1:#06x}"
            ));
        }
        let clock_hz = 42e6 / f64::from(2 << (cr1 >> 3 & 7));
        if clock_hz > 2.7e6 {
            self.violation(format!("SPI3 at {clock_hz} Hz"));
        }
        match self.selected {
            // 50 ns.
            Some(since) if self.now - since >= 9 => {}
            _ => self.violation("a frame without nCS, or too soon after it"),
        }
        if !self.spi_dead {
            let now = self.now;
            self.answer = Some(self.drv.frame(value as u16, now));
        }
    }
}

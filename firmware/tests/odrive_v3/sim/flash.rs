//! The flash: keys, sectors, words, its data cache. RM0090, 3.

use super::{FLASH, SETTINGS, Sim};

impl Sim {
    /// Flash that was like this all along.
    pub fn hold(&mut self, address: u32, value: u32) {
        self.flash.insert(address, value);
        self.cache.remove(&address);
    }

    pub(super) fn flash_register(&mut self, offset: u32, value: u32) {
        let address = FLASH + offset;
        match offset {
            0x00 => {
                let off = self.stored(address) & 1 << 10 == 0;
                if value & 1 << 12 != 0 {
                    if off {
                        self.cache.clear();
                    } else {
                        self.violation("the data cache is emptied while it is on");
                    }
                }
                self.words.insert(address, value);
            }
            0x04 => {
                self.keys.push(value);
                let right = [0x4567_0123, 0xCDEF_89AB];
                if self.keys.as_slice() == right {
                    self.keys.clear();
                    if !self.locked_for_good {
                        *self.words.entry(FLASH + 0x10).or_default() &= !(1 << 31);
                    }
                } else if !right.starts_with(&self.keys) {
                    self.locked_for_good = true;
                }
            }
            0x0C => {
                let kept = self.stored(address) & !value;
                self.words.insert(address, kept);
            }
            0x10 => {
                if self.stored(address) & 1 << 31 != 0 {
                    return;
                }
                if self.now < self.busy_until {
                    self.violation("FLASH_CR is written while the flash is busy");
                }
                self.words.insert(address, value & !(1 << 16));
                if value & 1 << 16 != 0 {
                    self.erase(value);
                }
            }
            _ => {
                self.words.insert(address, value);
            }
        }
    }

    fn erase(&mut self, cr: u32) {
        if self.moe() {
            self.violation("flash is erased with the bridge on");
        }
        if cr & 7 != 2 {
            self.violation(format!("not a sector's erase: {cr:#x}"));
        }
        let sector = cr >> 3 & 0xF;
        self.erased.push(sector);
        if !(10..=11).contains(&sector) {
            self.violation(format!("sector {sector} is erased"));
            return;
        }
        let start = 0x0800_0000 + (sector - 4) * 0x2_0000;
        self.flash
            .retain(|at, _| !(start..start + 0x2_0000).contains(at));
        // Data sheet, 128 KB at worst: 4, 2.6, 2 s.
        let worst_s = [4.0, 2.6, 2.0, 0.0][(cr >> 8 & 3) as usize];
        self.busy((worst_s * 168e6) as u64);
    }

    fn busy(&mut self, ticks: u64) {
        self.busy_until = self.now + ticks;
        self.longest_busy = self.longest_busy.max(ticks);
        *self.words.entry(FLASH + 0x0C).or_default() |= self.flash_error;
    }

    pub(super) fn program(&mut self, address: u32, value: u32) {
        let cr = self.stored(FLASH + 0x10);
        if cr & 1 << 31 != 0 || cr & 1 == 0 {
            self.violation(format!("{address:#010x} is written without PG"));
            return;
        }
        if !SETTINGS.contains(&address) {
            self.violation(format!("{address:#010x} is programmed"));
            return;
        }
        if cr >> 8 & 3 != 2 || self.now < self.busy_until || self.moe() {
            self.violation("a word is programmed at the wrong size or time");
        }
        let held = self.flash.entry(address).or_insert(u32::MAX);
        *held &= value;
        self.programmed += 1;
        self.busy(16 * 168);
    }
}

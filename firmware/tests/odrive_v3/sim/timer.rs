//! TIM1's counter, and the conversions that it triggers. RM0090, 13 and 17.

use super::{ADC, Sim, TIM1, Update};

impl Sim {
    pub(super) fn run_timer(&mut self) {
        let Some(started) = self.started.filter(|_| !self.timer_dead) else {
            return;
        };
        let top = u64::from(self.stored(TIM1 + 0x2C));
        while (self.events_done + 1) * top <= self.now - started {
            self.events_done += 1;
            if self.repetitions == 0 {
                self.repetitions = self.stored(TIM1 + 0x30);
                let at = self.events_done * top;
                let overflow = self.events_done % 2 == 1;
                self.updates.push(Update { at, overflow });
                self.update(started + at);
            } else {
                self.repetitions -= 1;
            }
        }
        for (i, adc) in ADC.into_iter().enumerate() {
            if self.conversion_ends[i].is_some_and(|end| end <= self.now) {
                self.conversion_ends[i] = None;
                // JL 0: the one channel is in JSQ4.
                let channel = self.stored(adc + 0x38) >> 15 & 31;
                let code = self.analog[channel as usize];
                self.words.insert(adc + 0x3C, u32::from(code));
                *self.words.entry(adc).or_default() |= 1 << 2;
            }
        }
    }

    fn update(&mut self, now: u64) {
        *self.words.entry(TIM1 + 0x10).or_default() |= 1;
        for channel in 0..3 {
            self.active[channel as usize] = self.stored(TIM1 + 0x34 + 4 * channel);
        }
        if self.stored(TIM1 + 0x44) & 1 << 14 != 0 {
            *self.words.entry(TIM1 + 0x44).or_default() |= 1 << 15;
        }
        if self.stored(TIM1 + 0x04) >> 4 & 7 == 2 {
            self.trigger(now);
        }
    }

    fn trigger(&mut self, now: u64) {
        let divider = [2, 4, 6, 8][(self.stored(0x4001_2304) >> 16 & 3) as usize];
        let mut any = false;
        for (i, adc) in ADC.into_iter().enumerate() {
            let cr2 = self.stored(adc + 0x08);
            if cr2 & 1 != 0 && cr2 >> 20 & 3 == 1 && cr2 >> 16 & 0xF == 1 {
                // 3 + 12 cycles of 84 MHz / divider.
                self.conversion_ends[i] = Some(now + 15 * 2 * divider);
                any = true;
            }
        }
        if any {
            self.triggers.push(now);
        }
    }

    pub(super) fn top(&self) -> u64 {
        u64::from(self.stored(TIM1 + 0x2C))
    }

    /// Ticks since the last time the count was 0.
    pub fn position(&self) -> Option<u64> {
        let started = self.started.filter(|_| !self.timer_dead)?;
        Some((self.now - started) % (2 * self.top()))
    }
}

//! TIM1's counter, the conversions that it triggers, and TIM8, whose end DMA answers. RM0090, 10, 13 and 17.

use super::{ADC, DMA2_S1, Sim, TIM1, TIM8, Update};

impl Sim {
    /// All that comes by itself, in its order, up to now.
    pub(super) fn run_timer(&mut self) {
        loop {
            let (tim1, tim8) = (self.next_tim1(), self.next_tim8());
            let Some(next) = [tim1, tim8].into_iter().flatten().min() else {
                break;
            };
            if next > self.now {
                break;
            }
            if tim1 == Some(next) {
                self.half_period(next);
            } else {
                self.dead_man(next);
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

    /// The next end of TIM1's count.
    fn next_tim1(&self) -> Option<u64> {
        let started = self.started.filter(|_| !self.timer_dead)?;
        Some(started + (self.events_done + 1) * self.top())
    }

    fn half_period(&mut self, now: u64) {
        self.events_done += 1;
        if self.repetitions == 0 {
            self.repetitions = self.stored(TIM1 + 0x30);
            let at = self.events_done * self.top();
            let overflow = self.events_done % 2 == 1;
            self.updates.push(Update { at, overflow });
            self.update(now);
        } else {
            self.repetitions -= 1;
        }
    }

    /// The next end of TIM8's count.
    fn next_tim8(&self) -> Option<u64> {
        let ticks = u64::from(self.stored(TIM8 + 0x2C)) + 1;
        let is_on = self.stored(TIM8) & 1 != 0 && self.has_clock(TIM8);
        is_on.then_some(self.dead_man_zero + ticks * (u64::from(self.stored(TIM8 + 0x28)) + 1))
    }

    /// TIM8's update: a request to stream 1 of DMA2 where UDE is set.
    fn dead_man(&mut self, now: u64) {
        self.dead_man_zero = now;
        let cr = self.stored(DMA2_S1);
        // TIM8_UP is channel 7; memory to peripheral, by words, over and over, one each.
        let is_right = cr >> 25 & 7 == 7
            && cr >> 6 & 3 == 1
            && cr >> 11 & 0xF == 0b1010
            && cr >> 8 & 7 == 1
            && cr & 1 == 1
            && self.stored(DMA2_S1 + 4) == 1
            && self.stored(DMA2_S1 + 0x14) & 1 << 2 == 0;
        if self.stored(TIM8 + 0x0C) & 1 << 8 != 0
            && is_right
            && self.has_clock(DMA2_S1)
            && !self.dma_dead
        {
            let word = self.stored(self.stored(DMA2_S1 + 0x0C));
            self.words.insert(self.stored(DMA2_S1 + 8), word);
            self.dead_man_fired += 1;
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

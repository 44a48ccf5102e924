//! A DRV8301 as its data sheet describes the SPI.

#[derive(Debug, Default)]
pub struct Drv8301 {
    pub on_since: Option<u64>,
    pub status: [u16; 2],
    pub control: [u16; 2],
    next_answer: u16,
    /// So many writes get lost.
    pub lost_writes: u32,
    /// The line from the driver is stuck at this.
    pub stuck: Option<u16>,
    /// Bits of the control registers that do not take what they are given.
    pub dead_bits: u16,
    pub frame_faults: bool,
    /// Axis 1's driver, on the same line.
    pub other_fault: bool,
    /// Answers are of another register.
    pub wrong_address: bool,
    pub frames: Vec<u16>,
}

impl Drv8301 {
    /// 10 ms of 168 MHz.
    const READY: u64 = 1_680_000;

    pub fn turn_on(&mut self, now: u64) {
        self.on_since = Some(now);
        self.control = [0; 2];
        self.next_answer = 0;
    }

    pub fn turn_off(&mut self) {
        self.on_since = None;
    }

    fn is_ready(&self, now: u64) -> bool {
        self.on_since
            .is_some_and(|since| now - since >= Self::READY)
    }

    pub fn pulls_fault_down(&self, now: u64) -> bool {
        !self.is_ready(now)
            || self.other_fault
            || self.status[0] & 0x7BF != 0
            || self.status[1] & 0x80 != 0
    }

    pub fn frame(&mut self, word: u16, now: u64) -> u16 {
        self.frames.push(word);
        if let Some(level) = self.stuck {
            return level;
        }
        if !self.is_ready(now) {
            return 0;
        }
        let answer = self.next_answer;
        let address = word >> 11 & 0xF;
        if word & 0x8000 == 0 {
            self.next_answer = self.status[0];
            if self.lost_writes > 0 {
                self.lost_writes -= 1;
            } else if let Some(register) = (address as usize)
                .checked_sub(2)
                .and_then(|index| self.control.get_mut(index))
            {
                *register = word & 0x7FF & !self.dead_bits;
            }
        } else {
            let data = match address {
                0 | 1 => self.status[address as usize],
                2 | 3 => self.control[address as usize - 2],
                _ => 0,
            };
            let told = if self.wrong_address {
                address ^ 1
            } else {
                address
            };
            self.next_answer = told << 11 | data;
        }
        if self.frame_faults {
            answer | 0x8000
        } else {
            answer
        }
    }
}

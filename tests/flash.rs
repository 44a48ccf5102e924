use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read,
    check_write,
};

/// The power went, or the call was wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PowerCut {
    /// It went during this call, or before it.
    Now,
    /// Not aligned, out of bounds, or a word that was not erased.
    Wrong,
}

impl NorFlashError for PowerCut {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// How a sector looks that was being erased when the power went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cut {
    /// As before.
    Nothing,
    /// Each bit that was 0 is 1 by chance.
    AnyBits,
    /// Each word is erased by chance.
    AnyWords,
    /// Erased up to somewhere.
    Front,
    /// Erased from somewhere on.
    Back,
    /// Flash that programs all of a sector before it erases it: any bits are 0.
    Programming,
    /// All of it reads as erased.
    All,
}

impl Cut {
    /// Each of them.
    pub const EACH: [Self; 7] = [
        Self::Nothing,
        Self::AnyBits,
        Self::AnyWords,
        Self::Front,
        Self::Back,
        Self::Programming,
        Self::All,
    ];
}

/// NOR flash of two sectors, in memory, whose power can be cut at any word that is programmed and at
/// any erase: words that were programmed stay, the one at the cut has any of its new zeros, the
/// rest is as before; a sector at whose erase it is cut looks as [`Cut`] says.
#[derive(Debug, Clone)]
pub struct Flash<const WORD: usize, const SECTOR: usize> {
    /// What is in it.
    pub bytes: Vec<u8>,
    /// Words programmed and sectors erased so far: the steps at which it can be cut.
    pub steps: u64,
    /// Sectors erased so far.
    pub erases: u64,
    /// Sectors at whose erase the power went.
    pub cut_erases: u64,
    /// The step at which the power goes, and how.
    pub cut: Option<(u64, Cut)>,
    random: Random,
}

impl<const WORD: usize, const SECTOR: usize> Flash<WORD, SECTOR> {
    /// As it comes from the factory.
    #[must_use]
    pub fn blank(seed: u64) -> Self {
        Self {
            bytes: vec![0xFF; 2 * SECTOR],
            steps: 0,
            erases: 0,
            cut_erases: 0,
            cut: None,
            random: Random(seed),
        }
    }

    /// Counts a step; the way of the cut if it is here, an error if it was before.
    fn step(&mut self) -> Result<Option<Cut>, PowerCut> {
        self.steps += 1;
        match self.cut {
            Some((at, _)) if at < self.steps => Err(PowerCut::Now),
            Some((at, cut)) if at == self.steps => Ok(Some(cut)),
            _ => Ok(None),
        }
    }

    fn half_erase(&mut self, from: usize, cut: Cut) {
        let random = &mut self.random;
        let edge = random.below(SECTOR as u64 + 1) as usize;
        let sector = &mut self.bytes[from..from + SECTOR];
        match cut {
            Cut::Nothing => {}
            Cut::AnyBits => sector.iter_mut().for_each(|byte| *byte |= random.byte()),
            Cut::AnyWords => {
                for word in sector.chunks_mut(WORD) {
                    if random.below(2) == 0 {
                        word.fill(0xFF);
                    }
                }
            }
            Cut::Front => sector[..edge].fill(0xFF),
            Cut::Back => sector[edge..].fill(0xFF),
            Cut::Programming => sector.iter_mut().for_each(|byte| *byte &= random.byte()),
            Cut::All => sector.fill(0xFF),
        }
    }
}

impl<const WORD: usize, const SECTOR: usize> ErrorType for Flash<WORD, SECTOR> {
    type Error = PowerCut;
}

impl<const WORD: usize, const SECTOR: usize> ReadNorFlash for Flash<WORD, SECTOR> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerCut> {
        check_read(self, offset, bytes.len()).map_err(|_| PowerCut::Wrong)?;
        let at = offset as usize;
        bytes.copy_from_slice(&self.bytes[at..at + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const WORD: usize, const SECTOR: usize> NorFlash for Flash<WORD, SECTOR> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerCut> {
        check_erase(self, from, to).map_err(|_| PowerCut::Wrong)?;
        for at in (from as usize..to as usize).step_by(SECTOR) {
            if let Some(cut) = self.step()? {
                self.half_erase(at, cut);
                self.cut_erases += 1;
                return Err(PowerCut::Now);
            }
            self.bytes[at..at + SECTOR].fill(0xFF);
            self.erases += 1;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerCut> {
        check_write(self, offset, bytes.len()).map_err(|_| PowerCut::Wrong)?;
        for (i, word) in bytes.chunks(WORD).enumerate() {
            let at = offset as usize + i * WORD;
            let cut = self.step()?;
            let place = &mut self.bytes[at..at + WORD];
            // Not twice, as the trait has it.
            if place.iter().any(|byte| *byte != 0xFF) {
                return Err(PowerCut::Wrong);
            }
            for (byte, new) in place.iter_mut().zip(word) {
                *byte = match cut {
                    None => *new,
                    Some(_) => new | self.random.byte(),
                };
            }
            if cut.is_some() {
                return Err(PowerCut::Now);
            }
        }
        Ok(())
    }
}

/// Numbers by chance (splitmix64), the same each time.
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    /// Any 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ bits >> 31
    }

    /// Less than `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.bits() % limit
    }

    /// Any byte.
    pub fn byte(&mut self) -> u8 {
        self.bits() as u8
    }
}

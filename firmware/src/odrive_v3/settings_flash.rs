//! Sectors 10 and 11 of the flash, 0x080C0000 to 0x080FFFFF, for [`crate::store::Store`]. RM0090, 3.6 and 3.7.
//!
//! Erased and programmed by words, 32 bits in parallel, which the supply of 3.3 V allows and which is fastest: a sector takes
//! 1 s, 2 s at worst. **Everything stands still meanwhile**, every interrupt too, because the program lies in the same flash:
//! only with the bridge off, and with the watchdog just fed.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read,
    check_write,
};

use super::Registers;

const START: u32 = 0x080C_0000;
const FIRST_SECTOR: u32 = 10;

const FLASH_ACR: u32 = 0x4002_3C00;
const DCEN: u32 = 1 << 10;
const DCRST: u32 = 1 << 12;
const FLASH_KEYR: u32 = 0x4002_3C04;
const KEY1: u32 = 0x4567_0123;
const KEY2: u32 = 0xCDEF_89AB;
const FLASH_SR: u32 = 0x4002_3C0C;
/// EOP, OPERR, WRPERR, PGAERR, PGPERR, PGSERR: cleared by writing them.
const FLAGS: u32 = 0xF3;
const ERRORS: u32 = 0xF2;
const BSY: u32 = 1 << 16;
const FLASH_CR: u32 = 0x4002_3C10;
const PG: u32 = 1 << 0;
const SER: u32 = 1 << 1;
const PSIZE_32: u32 = 2 << 8;
const STRT: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;

const PWR_CSR: u32 = 0x4000_7004;
/// The supply is below the level that [`super::clocks::set_up`] watches.
const PVDO: u32 = 1 << 2;

/// 5 s, where the program does not stand still anyway.
const LOOKS_ERASE: u32 = 500_000;
/// A word takes 16 µs, 100 µs at worst.
const LOOKS_PROGRAM: u32 = 100;

/// Why the flash was not written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlashError {
    /// Outside of the two sectors, or not at whole words or sectors.
    Place(NorFlashErrorKind),
    /// The supply is below 2.9 V: 32 bits in parallel are not allowed there.
    SupplyLow,
    /// It could not be unlocked: a wrong key came before, which only a reset mends.
    Locked,
    /// It was busy for longer than the data sheet allows.
    Busy,
    /// It reports errors.
    Reported {
        /// FLASH_SR's error bits: 1 OPERR, 4 WRPERR, 5 PGAERR, 6 PGPERR, 7 PGSERR.
        flags: u32,
    },
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Place(kind) => *kind,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// The two sectors; offset 0 is 0x080C0000.
pub struct SettingsFlash<R> {
    registers: R,
}

impl<R: Registers> SettingsFlash<R> {
    /// Locked, as after a reset.
    pub const fn new(registers: R) -> Self {
        Self { registers }
    }

    fn is_idle(&mut self, looks: u32) -> Result<(), FlashError> {
        if self.registers.becomes(FLASH_SR, BSY, 0, looks) {
            Ok(())
        } else {
            Err(FlashError::Busy)
        }
    }

    /// Does something with the flash unlocked, and locks it again whatever comes of it.
    fn unlocked(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<(), FlashError>,
    ) -> Result<(), FlashError> {
        if self.registers.read(PWR_CSR) & PVDO != 0 {
            return Err(FlashError::SupplyLow);
        }
        self.is_idle(LOOKS_PROGRAM)?;
        if self.registers.read(FLASH_CR) & LOCK != 0 {
            self.registers.write(FLASH_KEYR, KEY1);
            self.registers.write(FLASH_KEYR, KEY2);
        }
        let done = if self.registers.read(FLASH_CR) & LOCK == 0 {
            self.registers.write(FLASH_SR, FLAGS);
            work(self)
        } else {
            Err(FlashError::Locked)
        };
        self.registers.write(FLASH_CR, LOCK);
        // The data cache may hold what was there before. It is emptied only while it is off.
        self.registers.clear(FLASH_ACR, DCEN);
        self.registers.set(FLASH_ACR, DCRST);
        self.registers.clear(FLASH_ACR, DCRST);
        self.registers.set(FLASH_ACR, DCEN);
        done
    }

    fn no_errors(&mut self) -> Result<(), FlashError> {
        match self.registers.read(FLASH_SR) & ERRORS {
            0 => Ok(()),
            flags => Err(FlashError::Reported { flags }),
        }
    }
}

impl<R> ErrorType for SettingsFlash<R> {
    type Error = FlashError;
}

impl<R: Registers> ReadNorFlash for SettingsFlash<R> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        check_read(self, offset, bytes.len()).map_err(FlashError::Place)?;
        let (words, _) = bytes.as_chunks_mut();
        for (word, address) in words.iter_mut().zip((START + offset..).step_by(4)) {
            *word = self.registers.read(address).to_le_bytes();
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * Self::ERASE_SIZE
    }
}

impl<R: Registers> NorFlash for SettingsFlash<R> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 128 * 1024;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check_erase(self, from, to).map_err(FlashError::Place)?;
        let size = Self::ERASE_SIZE as u32;
        self.unlocked(|flash| {
            for sector in from / size..to / size {
                let erase = SER | (FIRST_SECTOR + sector) << 3 | PSIZE_32;
                flash.registers.write(FLASH_CR, erase);
                flash.registers.write(FLASH_CR, erase | STRT);
                flash.is_idle(LOOKS_ERASE)?;
                flash.no_errors()?;
            }
            Ok(())
        })
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check_write(self, offset, bytes.len()).map_err(FlashError::Place)?;
        let (words, _) = bytes.as_chunks();
        self.unlocked(|flash| {
            flash.registers.write(FLASH_CR, PG | PSIZE_32);
            for (word, address) in words.iter().zip((START + offset..).step_by(4)) {
                flash.registers.write(address, u32::from_le_bytes(*word));
                flash.is_idle(LOOKS_PROGRAM)?;
                flash.no_errors()?;
            }
            Ok(())
        })
    }
}

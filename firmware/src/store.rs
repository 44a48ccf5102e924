//! Settings that survive: the parameters of the next start, kept in two sectors of flash.
//!
//! Each save is a record of its own in a slot of 256 bytes, written into a slot that is still blank:
//!
//! | bytes | what |
//! |---|---|
//! | 4 | number of the save, counted up |
//! | 2 | version of what follows |
//! | 2 | its length n |
//! | n | the parameters and the motor, by `postcard` |
//! | 4 | CRC-32C of all of the above |
//!
//! Numbers are little endian; the rest of the slot stays blank (all ones). The record with the highest number of
//! those whose checksum is right is the one that counts. A sector is entered only when the other one, which holds
//! that record, has no blank slot left, and only right after it was erased as a whole. So there is no
//! moment in which the last whole record is touched, and whatever a cut leaves of a slot or a sector, be it
//! half-programmed words or half-erased cells in any order, has no right checksum and is passed over.
//!
//! Assumed: a cut changes nothing outside of the words that are being programmed or the sector that is being
//! erased, and what reads as erased or as programmed after the cut goes on doing so.

use crc::{CRC_32_ISCSI, Crc, Table};
use embedded_storage::nor_flash::NorFlash;
use protocol::Stored;

use crate::settings::{DEFAULT_SETTINGS, Settings};

/// Of what is stored. To be raised whenever [`Settings`] or their meaning changes.
/// Version 1 had no motor.
pub const VERSION: u16 = 2;

/// Bytes of a slot.
pub const SLOT: usize = 256;

/// Before the parameters: number, version, length.
const HEAD: usize = 8;
const SUM: usize = 4;

const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISCSI);

/// What keeps settings.
pub trait Keep {
    /// The settings to start with. Defaults where there are none that can be used.
    fn load(&mut self) -> Loaded;

    /// Keeps settings for the next start. Called only while the motor is off: everything may stand
    /// still meanwhile, on the STM32F405 for up to 2 s where a sector is erased.
    ///
    /// # Errors
    /// Why they are not kept. What was kept before still is.
    fn save(&mut self, settings: &Settings) -> Result<(), SaveError>;
}

/// What a device starts with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loaded {
    /// Where the parameters come from.
    pub stored: Stored,
    /// The settings, not yet checked: a firmware may accept less than an earlier one did.
    pub settings: Settings,
}

impl Loaded {
    /// Defaults, and why.
    #[must_use]
    pub const fn defaults(stored: Stored) -> Self {
        Self {
            stored,
            settings: DEFAULT_SETTINGS,
        }
    }
}

/// Why a save failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SaveError {
    /// The board keeps no settings.
    NoStorage,
    /// The flash refused to be read, erased or programmed.
    Flash,
    /// Something else was read back than was written.
    ReadBack,
    /// The settings do not fit a slot.
    TooLong,
}

/// A board that keeps no settings.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoStore;

impl Keep for NoStore {
    fn load(&mut self) -> Loaded {
        Loaded::defaults(Stored::NoStorage)
    }

    fn save(&mut self, _: &Settings) -> Result<(), SaveError> {
        Err(SaveError::NoStorage)
    }
}

/// A board that may keep settings; None keeps none.
impl<K: Keep> Keep for Option<K> {
    fn load(&mut self) -> Loaded {
        match self {
            Some(store) => store.load(),
            None => NoStore.load(),
        }
    }

    fn save(&mut self, settings: &Settings) -> Result<(), SaveError> {
        match self {
            Some(store) => store.save(settings),
            None => NoStore.save(settings),
        }
    }
}

/// Two neighbouring sectors of [`NorFlash::ERASE_SIZE`] bytes.
pub struct Store<F> {
    flash: F,
    start: u32,
}

/// A slot that holds a whole record.
#[derive(Debug, Clone, Copy)]
struct Newest {
    slot: u32,
    number: u32,
}

/// What lies in the two sectors.
#[derive(Debug, Clone, Copy, Default)]
struct Survey {
    newest: Option<Newest>,
    /// The first blank slot behind the newest record in its sector.
    blank: Option<u32>,
    /// The slot behind the newest record, in its sector, cannot be read: a save that came later was cut short.
    broken_next: bool,
    /// Something cannot be read.
    broken: bool,
    /// By sector: its first slot cannot be read.
    broken_first: [bool; 2],
}

impl<F: NorFlash> Store<F> {
    const SLOTS: u32 = (F::ERASE_SIZE / SLOT) as u32;

    /// The two sectors from `start` on, a multiple of [`NorFlash::ERASE_SIZE`].
    #[must_use]
    pub const fn new(flash: F, start: u32) -> Self {
        const {
            assert!(F::ERASE_SIZE >= SLOT && F::ERASE_SIZE.is_multiple_of(SLOT));
            assert!(SLOT.is_multiple_of(F::READ_SIZE) && SLOT.is_multiple_of(F::WRITE_SIZE));
        }
        Self { flash, start }
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    const fn address(&self, slot: u32) -> u32 {
        self.start + slot * SLOT as u32
    }

    fn read(&mut self, slot: u32) -> Result<[u8; SLOT], F::Error> {
        let mut bytes = [0; SLOT];
        self.flash.read(self.address(slot), &mut bytes)?;
        Ok(bytes)
    }

    fn survey(&mut self) -> Result<Survey, F::Error> {
        let mut survey = Survey::default();
        for slot in 0..2 * Self::SLOTS {
            let sector = slot / Self::SLOTS;
            let bytes = self.read(slot)?;
            let behind = survey
                .newest
                .filter(|newest| newest.slot / Self::SLOTS == sector);
            if bytes.iter().all(|byte| *byte == 0xFF) {
                if behind.is_some() && survey.blank.is_none() {
                    survey.blank = Some(slot);
                }
            } else if let Some(Record { number, .. }) = record(&bytes) {
                if survey.newest.is_none_or(|newest| number > newest.number) {
                    survey.newest = Some(Newest { slot, number });
                    survey.blank = None;
                    survey.broken_next = false;
                }
            } else {
                survey.broken = true;
                if let Some(first) = survey.broken_first.get_mut(sector as usize) {
                    *first |= slot.is_multiple_of(Self::SLOTS);
                }
                survey.broken_next |= behind.is_some_and(|newest| newest.slot + 1 == slot);
            }
        }
        Ok(survey)
    }

    /// A save that came after the newest record was cut short, or was damaged since: its slot is
    /// the next, or the first of the other sector, which is then the first to be tried again.
    fn is_older(survey: &Survey, newest: Newest) -> bool {
        if newest.slot % Self::SLOTS + 1 < Self::SLOTS {
            return survey.broken_next;
        }
        let other = usize::from(newest.slot < Self::SLOTS);
        survey.broken_first.get(other) == Some(&true)
    }

    fn try_load(&mut self) -> Result<Loaded, F::Error> {
        let survey = self.survey()?;
        let Some(newest) = survey.newest else {
            return Ok(Loaded::defaults(if survey.broken {
                Stored::Damaged
            } else {
                Stored::Nothing
            }));
        };
        let bytes = self.read(newest.slot)?;
        let Some(Record {
            version, content, ..
        }) = record(&bytes)
        else {
            return Ok(Loaded::defaults(Stored::Damaged));
        };
        if version != VERSION {
            return Ok(Loaded::defaults(Stored::Version { found: version }));
        }
        Ok(match postcard::take_from_bytes(content) {
            Ok(((parameters, motor), [])) => Loaded {
                stored: if Self::is_older(&survey, newest) {
                    Stored::Older
                } else {
                    Stored::Last
                },
                settings: Settings { parameters, motor },
            },
            _ => Loaded::defaults(Stored::Damaged),
        })
    }
}

impl<F: NorFlash> Keep for Store<F> {
    fn load(&mut self) -> Loaded {
        self.try_load().unwrap_or(Loaded::defaults(Stored::Damaged))
    }

    fn save(&mut self, settings: &Settings) -> Result<(), SaveError> {
        let survey = self.survey().map_err(|_| SaveError::Flash)?;
        let (slot, number) = match (survey.newest, survey.blank) {
            (Some(newest), Some(blank)) => (blank, newest.number.wrapping_add(1)),
            (Some(newest), None) if newest.slot < Self::SLOTS => {
                (Self::SLOTS, newest.number.wrapping_add(1))
            }
            (Some(newest), None) => (0, newest.number.wrapping_add(1)),
            (None, _) => (0, 0),
        };
        let mut bytes = [0xFF; SLOT];
        let length = write_record(&mut bytes, number, settings).ok_or(SaveError::TooLong)?;
        let written = bytes
            .get(..length.next_multiple_of(F::WRITE_SIZE))
            .ok_or(SaveError::TooLong)?;
        let address = self.address(slot);
        if slot.is_multiple_of(Self::SLOTS) {
            // Also where it reads as blank: an erase that was cut short may have left it so.
            self.flash
                .erase(address, address + F::ERASE_SIZE as u32)
                .map_err(|_| SaveError::Flash)?;
        }
        self.flash
            .write(address, written)
            .map_err(|_| SaveError::Flash)?;
        // A slot that does not hold what it was given is not blank now, and is passed over from here on.
        match self.read(slot) {
            Ok(back) if back == bytes => Ok(()),
            Ok(_) => Err(SaveError::ReadBack),
            Err(_) => Err(SaveError::Flash),
        }
    }
}

/// A whole record.
struct Record<'b> {
    number: u32,
    version: u16,
    content: &'b [u8],
}

/// Reads a slot; None where its checksum is wrong.
fn record(slot: &[u8; SLOT]) -> Option<Record<'_>> {
    let [n0, n1, n2, n3, v0, v1, l0, l1, ..] = *slot;
    let end = HEAD + usize::from(u16::from_le_bytes([l0, l1]));
    let sum = slot.get(end..end + SUM)?;
    let content = slot.get(HEAD..end)?;
    let right = CRC.checksum(slot.get(..end)?).to_le_bytes();
    (sum == right).then_some(Record {
        number: u32::from_le_bytes([n0, n1, n2, n3]),
        version: u16::from_le_bytes([v0, v1]),
        content,
    })
}

/// Writes a record and returns its length; None where it does not fit.
fn write_record(slot: &mut [u8; SLOT], number: u32, settings: &Settings) -> Option<usize> {
    let (head, rest) = slot.split_first_chunk_mut::<HEAD>()?;
    let content = postcard::to_slice(&(settings.parameters, settings.motor), rest)
        .ok()?
        .len();
    let [n0, n1, n2, n3] = number.to_le_bytes();
    let [v0, v1] = VERSION.to_le_bytes();
    let [l0, l1] = u16::try_from(content).ok()?.to_le_bytes();
    *head = [n0, n1, n2, n3, v0, v1, l0, l1];
    let end = HEAD + content;
    let sum = CRC.checksum(slot.get(..end)?).to_le_bytes();
    slot.get_mut(end..end + SUM)?.copy_from_slice(&sum);
    Some(end + SUM)
}

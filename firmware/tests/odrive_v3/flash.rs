//! The settings' flash: the driver, and the store on it.

use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use firmware::odrive_v3::settings_flash::{FlashError, SettingsFlash};
use firmware::settings::DEFAULT_SETTINGS;
use firmware::store::{Keep, SaveError, Store};
use protocol::Stored;

use crate::set_up::set_up;
use crate::sim::{Chip, FLASH};

const SECTOR: u32 = 128 * 1024;
const LOCK: u32 = 1 << 31;

fn flash() -> (Chip, SettingsFlash<Chip>) {
    let chip = set_up();
    (chip.clone(), SettingsFlash::new(chip))
}

#[test]
fn words_are_programmed_and_read_back_and_the_flash_is_locked_again() {
    let (chip, mut flash) = flash();
    let mut bytes = [0; 8];
    // Into the data cache, as it was before.
    flash.read(SECTOR + 4, &mut bytes).unwrap();
    assert_eq!(bytes, [0xFF; 8]);
    flash.write(SECTOR + 4, b"settings").unwrap();
    flash.read(SECTOR + 4, &mut bytes).unwrap();
    assert_eq!(&bytes, b"settings");
    let first = u32::from_le_bytes(*b"sett");
    assert_eq!(chip.sim().flash[&(0x080E_0004)], first);
    assert_eq!(chip.word(FLASH + 0x10), LOCK);
    assert_eq!(
        chip.word(FLASH) >> 8 & 7,
        7,
        "prefetch and caches are on again"
    );
    flash.erase(SECTOR, 2 * SECTOR).unwrap();
    flash.read(SECTOR + 4, &mut bytes).unwrap();
    assert_eq!(bytes, [0xFF; 8]);
    assert_eq!(chip.sim().erased, [11]);
    assert_eq!(chip.word(FLASH + 0x10), LOCK);
    chip.assert_no_violations();
}

#[test]
fn an_erase_works_on_32_bits_and_takes_2_s_at_worst() {
    let (chip, mut flash) = flash();
    flash.erase(0, SECTOR).unwrap();
    assert_eq!(chip.sim().erased, [10]);
    assert_eq!(chip.sim().longest_busy, 2 * 168_000_000);
    flash.erase(0, 2 * SECTOR).unwrap();
    assert_eq!(chip.sim().erased, [10, 10, 11]);
    // SER with the sector and size before STRT.
    let cr: Vec<u32> = chip
        .writes()
        .into_iter()
        .filter_map(|(at, value)| (at == FLASH + 0x10).then_some(value))
        .collect();
    assert_eq!(&cr[..3], [0x252, 0x1_0252, LOCK]);
}

#[test]
fn nothing_outside_of_the_two_sectors_is_touched() {
    let (chip, mut flash) = flash();
    chip.forget();
    for (from, to) in [
        (0, SECTOR + 1),
        (4, SECTOR),
        (2 * SECTOR, 3 * SECTOR),
        (0, 3 * SECTOR),
        (SECTOR, 0),
    ] {
        let error = flash.erase(from, to).unwrap_err();
        assert!(
            matches!(error, FlashError::Place(_)),
            "{from} {to} {error:?}"
        );
    }
    for (offset, length) in [
        (2 * SECTOR, 4),
        (2 * SECTOR - 4, 8),
        (2, 4),
        (0, 3),
        (u32::MAX - 3, 4),
    ] {
        let error = flash.write(offset, &[0; 8][..length]).unwrap_err();
        assert!(matches!(error, FlashError::Place(_)), "{offset} {error:?}");
        assert_ne!(error.kind(), NorFlashErrorKind::Other);
    }
    assert!(flash.read(2 * SECTOR, &mut [0; 4]).is_err());
    assert!(chip.writes().is_empty());
    assert_eq!(flash.capacity(), 2 * SECTOR as usize);
}

#[test]
fn errors_are_reported_with_their_flags_and_the_flash_is_locked_all_the_same() {
    for bit in [1, 4, 5, 6, 7] {
        let (chip, mut flash) = flash();
        chip.sim().flash_error = 1 << bit;
        let error = FlashError::Reported { flags: 1 << bit };
        assert_eq!(flash.write(0, &[0; 4]), Err(error));
        assert_eq!(chip.word(FLASH + 0x10), LOCK);
        assert_eq!(flash.erase(0, SECTOR), Err(error));
        assert_eq!(chip.word(FLASH + 0x10), LOCK);
        // An old error does not fail the next one.
        chip.sim().flash_error = 0;
        assert_eq!(flash.write(4, &[0; 4]), Ok(()));
    }
}

#[test]
fn a_flash_that_stays_busy_locked_or_badly_supplied_is_an_error() {
    let (chip, mut busy) = flash();
    chip.sim().flash_never_ready = true;
    assert_eq!(busy.write(0, &[0; 4]), Err(FlashError::Busy));
    assert_eq!(busy.erase(0, SECTOR), Err(FlashError::Busy));
    let (chip, mut locked) = flash();
    chip.clone().write_key(1);
    assert_eq!(locked.write(0, &[0; 4]), Err(FlashError::Locked));
    let (chip, mut weak) = flash();
    chip.sim().supply_low = true;
    assert_eq!(weak.erase(0, SECTOR), Err(FlashError::SupplyLow));
    assert!(chip.sim().erased.is_empty());
}

impl Chip {
    fn write_key(&mut self, key: u32) {
        firmware::odrive_v3::Registers::write(self, FLASH + 4, key);
    }
}

#[test]
fn the_store_keeps_settings_on_it() {
    let (chip, flash) = flash();
    let mut store = Store::new(flash, 0);
    assert_eq!(store.load().stored, Stored::Nothing);
    for (number, start) in (1..=6).zip([0x080C_0000_u32, 0x080E_0000].into_iter().cycle()) {
        let mut settings = DEFAULT_SETTINGS;
        settings.parameters.stiffness_nm_rad = number as f32 * 1e-3;
        store.save(&settings).unwrap();
        let loaded = store.load();
        assert_eq!((loaded.stored, loaded.settings), (Stored::Last, settings));
        assert!(chip.sim().flash.contains_key(&start));
        // No room in this sector any more.
        for slot in 1..512 {
            chip.sim().hold(start + 256 * slot, 0);
        }
    }
    assert_eq!(chip.sim().erased, [10, 11, 10, 11, 10, 11]);
    chip.sim().flash_error = 1 << 7;
    assert_eq!(store.save(&DEFAULT_SETTINGS), Err(SaveError::Flash));
    chip.assert_no_violations();
}

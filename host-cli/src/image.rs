//! The firmware's image as it is to be flashed, and whether it may be.

use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, bail};
use object::elf::{EM_ARM, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol};

/// The program's share of the flash of an STM32F405RG, as in `memory.x`.
const PROGRAM: Range<u64> = 0x0800_0000..SETTINGS.start;
/// The two sectors in which settings survive.
const SETTINGS: Range<u64> = 0x080C_0000..0x0810_0000;
/// With the board's name behind it: the symbol by which `firmware/build.rs` marks an image.
const MARK: &str = "knob_board_";

/// Makes sure that a file is the firmware for a board, and leaves the settings alone. Returns how many bytes go
/// to the chip.
///
/// # Errors
/// Where it cannot be read or is something else.
pub fn check(path: &Path, board: &str) -> Result<u64> {
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    flashable(&bytes, board).with_context(|| path.display().to_string())
}

fn flashable(bytes: &[u8], board: &str) -> Result<u64> {
    let Ok(elf) = ElfFile32::<Endianness>::parse(bytes) else {
        bail!("this is not a 32-bit ELF file; accepted: {ACCEPTED}");
    };
    let endian = elf.endian();
    let machine = elf.elf_header().e_machine(endian);
    if machine != EM_ARM {
        bail!(
            "this program is not for ARM (ELF machine {machine}, not {EM_ARM}); accepted: {ACCEPTED}"
        );
    }
    let mut total = 0;
    for segment in elf.elf_program_headers() {
        let size = u64::from(segment.p_filesz(endian));
        if segment.p_type(endian) != PT_LOAD || size == 0 {
            continue;
        }
        let start = u64::from(segment.p_paddr(endian));
        let end = start + size;
        if start < SETTINGS.end && end > SETTINGS.start {
            bail!(
                "it reaches into the settings of the device: {start:#010x} to {end:#010x}, and these lie from \
                 {:#010x} on; accepted: {ACCEPTED}",
                SETTINGS.start
            );
        }
        if start < PROGRAM.start || end > PROGRAM.end {
            bail!(
                "it reaches out of the program's flash: {start:#010x} to {end:#010x}, not within {:#010x} to \
                 {:#010x}; accepted: {ACCEPTED}",
                PROGRAM.start,
                PROGRAM.end
            );
        }
        total += size;
    }
    if total == 0 {
        bail!("there is nothing in it for the flash; accepted: {ACCEPTED}");
    }
    let marks = elf
        .symbols()
        .filter_map(|symbol| symbol.name().ok()?.strip_prefix(MARK));
    let boards: Vec<&str> = marks.collect();
    match boards[..] {
        [of] if of == board => Ok(total),
        [of] => bail!("it is for the board `{of}`, not `{board}`; accepted: {ACCEPTED}"),
        _ => bail!("it does not say which board it is for; accepted: {ACCEPTED}"),
    }
}

const ACCEPTED: &str = "what `cargo xtask firmware` builds for the board";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_has_the_flash_that_the_linker_gives_it() {
        let script = include_str!("../../memory.x");
        let kilobytes = (PROGRAM.end - PROGRAM.start) / 1024;
        let region = format!(
            "FLASH : ORIGIN = {:#010x}, LENGTH = {kilobytes}K",
            PROGRAM.start
        );
        assert!(script.contains(&region), "`{region}` is not in: {script}");
    }
}

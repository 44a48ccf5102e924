//! The image for the motor-driver board, as `cargo xtask firmware` built it: where it lies, and where its interrupts go.

use std::collections::BTreeMap;
use std::path::Path;

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, elf};

/// Sectors 10 and 11, from here on, keep the settings.
const SETTINGS: u64 = 0x080C_0000;
const FLASH: u64 = 0x0800_0000;

/// Exceptions, then the STM32F405's interrupts by RM0090, table 61: its number, and 16.
const HANDLERS: [(&str, usize); 7] = [
    ("Reset", 1),
    ("NonMaskableInt", 2),
    ("HardFault", 3),
    ("EXTI0", 16 + 6),
    ("EXTI2", 16 + 8),
    ("ADC", 16 + 18),
    ("UART4", 16 + 52),
];

fn image() -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let path = root.join("target/firmware/odrive_v3.elf");
    std::fs::read(&path).expect("`cargo xtask firmware` builds it")
}

fn functions(file: &ElfFile32<'_>) -> BTreeMap<String, u64> {
    file.symbols()
        .filter_map(|symbol| Some((symbol.name().ok()?.to_owned(), symbol.address())))
        .collect()
}

#[test]
fn the_vector_table_leads_to_the_handlers() {
    let bytes = image();
    let file = ElfFile32::<Endianness>::parse(&*bytes).unwrap();
    let table = file.section_by_name(".vector_table").unwrap();
    assert_eq!(table.address(), FLASH);
    let words: Vec<u64> = table
        .data()
        .unwrap()
        .chunks_exact(4)
        .map(|word| u64::from(u32::from_le_bytes([word[0], word[1], word[2], word[3]])))
        .collect();
    assert_eq!(words.len(), 16 + 82, "all interrupts of the chip");
    assert_eq!(words[0], 0x2002_0000, "the stack begins at the top of RAM");
    let functions = functions(&file);
    let other = functions["DefaultHandler"] | 1;
    for (name, place) in HANDLERS {
        let address = functions[name] | 1;
        assert_eq!(words[place], address, "{name}");
        assert_ne!(address, other, "{name}");
    }
    // All others lead to where the outputs are turned off; nothing leads nowhere. Reserved places are 0.
    let known = HANDLERS.map(|(_, place)| place);
    for (place, word) in words.iter().enumerate().skip(16) {
        assert!(
            known.contains(&place) || [0, other].contains(word),
            "{place}: {word:#x}"
        );
    }
}

#[test]
fn the_image_lies_below_the_settings() {
    let bytes = image();
    let file = ElfFile32::<Endianness>::parse(&*bytes).unwrap();
    let mut end = 0;
    for header in file.elf_program_headers() {
        let endian = file.endian();
        if header.p_type(endian) != elf::PT_LOAD || header.p_filesz(endian) == 0 {
            continue;
        }
        let start = u64::from(header.p_paddr(endian));
        assert!(start >= FLASH, "{start:#x} is no flash");
        end = end.max(start + u64::from(header.p_filesz(endian)));
    }
    println!("{} bytes of flash, of {}", end - FLASH, SETTINGS - FLASH);
    assert!(
        (FLASH + 1024..SETTINGS).contains(&end),
        "it ends at {end:#x}"
    );
}

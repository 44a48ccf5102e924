//! The image for the motor-driver board, as `cargo xtask firmware` built it: where it lies, and where its interrupts go.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, elf};

/// Sectors 10 and 11, from here on, keep the settings.
const SETTINGS: u64 = 0x080C_0000;
const FLASH: u64 = 0x0800_0000;

/// Exceptions, then the STM32F405's interrupts by RM0090, table 61: its number, and 16.
const HANDLERS: [(&str, usize); 8] = [
    ("Reset", 1),
    ("NonMaskableInt", 2),
    ("HardFault", 3),
    ("EXTI0", 16 + 6),
    ("EXTI1", 16 + 7),
    ("EXTI2", 16 + 8),
    ("ADC", 16 + 18),
    ("UART4", 16 + 52),
];

fn image() -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let path = root.join("target/firmware/odrive_v3.elf");
    fs::read(&path).expect("`cargo xtask firmware` builds it")
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

#[test]
fn the_word_that_dma_turns_the_bridge_off_with_lies_in_ram() {
    let bytes = image();
    let file = ElfFile32::<Endianness>::parse(&*bytes).unwrap();
    let functions = functions(&file);
    let mut found = functions
        .iter()
        .filter(|(name, _)| name.contains("5board3OFF"));
    let (_, address) = found.next().expect("the word");
    assert!((0x2000_0000..0x2002_0000).contains(address), "{address:#x}");
    let data = file.section_by_name(".data").unwrap();
    let at = (address - data.address()) as usize;
    let word: [u8; 4] = data.data().unwrap()[at..at + 4].try_into().unwrap();
    // Dead time 20, OSSI, OSSR, BKE, BKP; no AOE, no MOE.
    assert_eq!(u32::from_le_bytes(word), 0x3C14);
}

/// Runs an image in the emulator, which has neither clocks nor pins nor timers of this chip but tells of every access to
/// them, until it has told `enough`.
fn accesses(image: &[u8], enough: impl Fn(&[String]) -> bool) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let (elf, log) = (folder.path().join("image.elf"), folder.path().join("log"));
    fs::write(&elf, image).unwrap();
    let mut emulator = Command::new(plant_sim::lockstep::QEMU)
        .args(["-M", "netduinoplus2", "-display", "none"])
        .args(["-monitor", "none", "-serial", "none", "-d", "unimp"])
        .arg("-D")
        .arg(&log)
        .arg("-kernel")
        .arg(&elf)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("`cargo xtask setup` installs the emulator");
    let began = Instant::now();
    let lines = loop {
        let text = fs::read_to_string(&log).unwrap_or_default();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let lines: Vec<String> = whole.lines().map(String::from).collect();
        if enough(&lines) || began.elapsed() > Duration::from_secs(60) {
            break lines;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    emulator.kill().unwrap();
    emulator.wait().unwrap();
    assert!(enough(&lines), "not seen: {:#?}", lines.last());
    lines
}

/// True of a write to TIM1's BDTR that clears AOE and MOE.
fn is_off(line: &str) -> bool {
    let Some(value) = line
        .strip_prefix("timer[1]: unimplemented device write (size 4, offset 0x044, value 0x")
        .and_then(|rest| u32::from_str_radix(rest.trim_end_matches(')'), 16).ok())
    else {
        return false;
    };
    value & 0b11 << 14 == 0
}

#[test]
fn each_handler_that_must_turn_the_bridge_off_does_so_first() {
    let bytes = image();
    let file = ElfFile32::<Endianness>::parse(&*bytes).unwrap();
    let (table, _) = file
        .section_by_name(".vector_table")
        .unwrap()
        .file_range()
        .unwrap();
    let functions = functions(&file);
    for name in ["HardFault", "NonMaskableInt", "EXTI2", "DefaultHandler"] {
        // Begins in the handler, with nothing set up: no memory, no clocks.
        let mut image = bytes.clone();
        let reset = table as usize + 4;
        let address = (functions[name] | 1) as u32;
        image[reset..reset + 4].copy_from_slice(&address.to_le_bytes());
        let told = accesses(&image, |lines| !lines.is_empty());
        assert!(is_off(&told[0]), "{name}: {}", told[0]);
    }
}

#[test]
fn the_image_begins_with_the_bridge_and_en_gate_off_and_a_panic_ends_so() {
    // The emulator's clocks never start: an error, and so a panic.
    let told = accesses(&image(), |lines| {
        lines.iter().filter(|line| is_off(line)).count() > 1
    });
    let writes: Vec<&String> = told.iter().filter(|line| line.contains("write")).collect();
    assert!(is_off(writes[0]), "{}", writes[0]);
    // GPIOB's BSRR: PB12 low, after the port's clock was turned on.
    assert!(writes[1].starts_with("RCC:"), "{}", writes[1]);
    assert!(
        writes[2].starts_with("GPIOB:") && writes[2].contains("offset 0x018, value 0x10000000"),
        "{}",
        writes[2]
    );
    assert!(is_off(writes[writes.len() - 1]));
}

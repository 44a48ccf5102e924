//! Images as small as they can be, for `knob flash`.

/// What an image is made of.
pub struct Image {
    pub machine: u16,
    /// Physical address and length of each segment that is loaded.
    pub segments: Vec<(u32, u32)>,
    /// The names of its symbols.
    pub symbols: Vec<&'static str>,
}

/// An image that may be flashed.
pub fn good() -> Image {
    Image {
        machine: 40,
        segments: vec![(0x0800_0000, 392), (0x0800_0188, 1000)],
        symbols: vec!["main", "knob_board_odrive_v3"],
    }
}

impl Image {
    /// As an ELF file of 32 bits, little endian, with a table of symbols.
    pub fn bytes(&self) -> Vec<u8> {
        let mut names = vec![0];
        let mut symbols = vec![0; 16];
        for name in &self.symbols {
            symbols.extend(words(&[names.len() as u32, 0, 0]));
            // Global, without a type, absolute.
            symbols.extend([0x10, 0, 0xF1, 0xFF]);
            names.extend(name.bytes().chain([0]));
        }
        let segments_at = 52;
        let symbols_at = segments_at + 32 * self.segments.len();
        let names_at = symbols_at + symbols.len();
        let sections_at = (names_at + names.len()).next_multiple_of(4);
        let data_at = sections_at + 3 * 40;

        let mut elf = vec![0x7F, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        elf.extend(halves(&[2, self.machine]));
        elf.extend(words(&[1, 0x0800_0189, segments_at as u32]));
        elf.extend(words(&[sections_at as u32, 0]));
        elf.extend(halves(&[52, 32, self.segments.len() as u16, 40, 3, 2]));
        let mut offset = data_at as u32;
        for (address, length) in &self.segments {
            elf.extend(words(&[
                1, offset, *address, *address, *length, *length, 5, 4,
            ]));
            offset += length;
        }
        elf.extend(&symbols);
        elf.extend(&names);
        elf.resize(sections_at, 0);
        elf.extend([0; 40]);
        let (start, length) = (symbols_at as u32, symbols.len() as u32);
        elf.extend(words(&[0, 2, 0, 0, start, length, 2, 1, 4, 16]));
        let (start, length) = (names_at as u32, names.len() as u32);
        elf.extend(words(&[0, 3, 0, 0, start, length, 0, 0, 1, 0]));
        let total: u32 = self.segments.iter().map(|(_, length)| length).sum();
        elf.resize(data_at + total as usize, 0xA5);
        elf
    }
}

fn words(all: &[u32]) -> Vec<u8> {
    all.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn halves(all: &[u16]) -> Vec<u8> {
    all.iter().flat_map(|half| half.to_le_bytes()).collect()
}

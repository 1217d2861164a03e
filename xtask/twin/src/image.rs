//! Program images: the flash contents of an ELF file and the names of its functions.

use crate::part::Part;
use object::{Object, ObjectSymbol, SymbolKind};
use std::collections::BTreeMap;

/// Why a file is not a program for a microcontroller.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// Not an ELF file, or a damaged one.
    #[error("not a readable ELF file: {0}")]
    Elf(#[from] object::Error),
    /// The file ends before a segment does.
    #[error("the ELF file is cut off")]
    Truncated,
    /// It is for another processor.
    #[error("the program is for {0:?}, not for an ARM microcontroller")]
    Architecture(object::Architecture),
    /// A segment lies outside the part's flash.
    #[error("the segment at {address:#010x} of {size} bytes lies outside of the {}'s flash", part.title)]
    Outside {
        /// Load address.
        address: u64,
        /// Size in bytes.
        size: u64,
        /// The part.
        part: &'static Part,
    },
}

/// The contents of the flash, with the names of the program's functions.
#[derive(Clone, Debug)]
pub struct Image {
    part: &'static Part,
    flash: Vec<u8>,
    functions: BTreeMap<u32, String>,
    symbols: BTreeMap<String, u32>,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// When it is not an ELF file, is for another processor, or does not fit into the flash.
    pub fn from_elf(part: &'static Part, elf: &[u8]) -> Result<Self, ImageError> {
        let file = object::File::parse(elf)?;
        if file.architecture() != object::Architecture::Arm {
            return Err(ImageError::Architecture(file.architecture()));
        }
        let mut image = Self::empty(part);
        for segment in load_segments(elf)? {
            image.place(segment.0, segment.1)?;
        }
        for symbol in file.symbols() {
            let Ok(name) = symbol.name() else { continue };
            let Ok(address) = u32::try_from(symbol.address()) else {
                continue;
            };
            if name.is_empty() || name.starts_with('$') {
                continue;
            }
            image.symbols.entry(name.to_owned()).or_insert(address);
            if symbol.kind() == SymbolKind::Text {
                // Several symbols may share an address. The vector's own name is the one spelled
                // like an interrupt.
                let entry = image.functions.entry(address & !1).or_default();
                if entry.is_empty() || preferred(name, entry) {
                    name.clone_into(entry);
                }
            }
        }
        Ok(image)
    }

    /// Makes a program from the bytes of the flash, which begin with the vector table.
    ///
    /// # Errors
    /// When there are more bytes than flash.
    pub fn from_code(part: &'static Part, code: &[u8]) -> Result<Self, ImageError> {
        let mut image = Self::empty(part);
        image.place(part.flash.base, code)?;
        Ok(image)
    }

    fn empty(part: &'static Part) -> Self {
        Self {
            part,
            flash: vec![0xFF; part.flash.size as usize],
            functions: BTreeMap::new(),
            symbols: BTreeMap::new(),
        }
    }

    /// Programs bytes into the flash after the program, as a debug probe does.
    ///
    /// # Errors
    /// When they do not fit into the flash.
    pub fn program(&mut self, address: u32, bytes: &[u8]) -> Result<(), ImageError> {
        self.place(address, bytes)
    }

    fn place(&mut self, address: u32, bytes: &[u8]) -> Result<(), ImageError> {
        let outside = ImageError::Outside {
            address: u64::from(address),
            size: bytes.len() as u64,
            part: self.part,
        };
        let offset = address.checked_sub(self.part.flash.base);
        let place = offset.and_then(|offset| {
            let start = offset as usize;
            self.flash.get_mut(start..start + bytes.len())
        });
        place.ok_or(outside)?.copy_from_slice(bytes);
        Ok(())
    }

    /// The part that the program is for.
    #[must_use]
    pub fn part(&self) -> &'static Part {
        self.part
    }

    /// The contents of the whole flash; erased bytes are 0xFF.
    #[must_use]
    pub fn flash(&self) -> &[u8] {
        &self.flash
    }

    /// The address of a symbol, exactly as the ELF file states it.
    #[must_use]
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.symbols.get(name).copied()
    }

    /// The function that contains `address`, if its symbol is known.
    #[must_use]
    pub fn function_at(&self, address: u32) -> Option<&str> {
        self.functions
            .range(..=address & !1)
            .next_back()
            .map(|(_, name)| name.as_str())
    }

    /// The handler of exception `number`: its address and the name of its symbol. A handler without
    /// a symbol is named by its address in hexadecimal.
    #[must_use]
    pub fn handler(&self, number: u16) -> Option<(u32, String)> {
        let at = usize::from(number) * 4;
        let bytes: [u8; 4] = self.flash.get(at..at + 4)?.try_into().ok()?;
        let address = u32::from_le_bytes(bytes) & !1;
        let name = self
            .functions
            .get(&address)
            .cloned()
            .unwrap_or_else(|| format!("{address:#010x}"));
        Some((address, name))
    }
}

fn preferred(name: &str, other: &str) -> bool {
    let like_a_vector = |n: &str| {
        n.chars()
            .all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
    };
    like_a_vector(name) && !like_a_vector(other)
}

/// Load addresses and contents of the segments that go into flash.
fn load_segments(elf: &[u8]) -> Result<Vec<(u32, &[u8])>, ImageError> {
    use object::read::elf::{ElfFile32, ProgramHeader};
    let file = ElfFile32::<object::Endianness>::parse(elf)?;
    let endian = file.endian();
    let mut segments = Vec::new();
    for header in file.elf_program_headers() {
        if header.p_type(endian) != object::elf::PT_LOAD || header.p_filesz(endian) == 0 {
            continue;
        }
        let bytes = header
            .data(endian, elf)
            .map_err(|()| ImageError::Truncated)?;
        segments.push((header.p_paddr(endian), bytes));
    }
    Ok(segments)
}

#[cfg(test)]
mod tests {
    use super::{Image, ImageError};
    use crate::part::Part;

    #[test]
    fn what_is_no_program_is_refused_in_a_sentence() {
        let error = Image::from_elf(Part::F303, b"#!/bin/sh").unwrap_err();
        assert!(error.to_string().starts_with("not a readable ELF file"));
        let error = Image::from_code(Part::F303, &[0; 65 * 1024]).unwrap_err();
        assert!(matches!(error, ImageError::Outside { size: 66_560, .. }));
    }

    #[test]
    fn handlers_without_a_name_show_their_address() {
        let mut code = [0; 16];
        code[12..16].copy_from_slice(&0x0800_0101_u32.to_le_bytes());
        let image = Image::from_code(Part::F446, &code).unwrap();
        let handler = image.handler(3).unwrap();
        assert_eq!(handler, (0x0800_0100, "0x08000100".to_owned()));
    }
}

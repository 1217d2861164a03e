//! Writes ranges and check value of an image into the image, where its self-test finds them
//! (`sled_common::image`).

use crc::{CRC_32_MPEG_2, Crc};
use object::{
    LittleEndian, Object, ObjectSymbol,
    elf::{FileHeader32, PT_LOAD},
    read::elf::{ElfFile, ProgramHeader as _},
};

/// Symbol of the words that are written.
const SYMBOL: &str = "IMAGE_SEAL";
/// Ranges that they have room for.
const RANGES: usize = 4;
/// Their size in bytes.
const SIZE: usize = 4 * (2 * RANGES + 1);

/// Why an image cannot be sealed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Error {
    /// It is no ELF file.
    #[error("it is not an ELF file of a 32-bit processor")]
    NotAnImage,
    /// It has more parts in the flash than the seal has room for.
    #[error("it has {0} parts in the flash: up to {RANGES} are accepted")]
    Ranges(usize),
    /// A part does not consist of whole words.
    #[error("its part at {start:#010x} has {length} bytes: a multiple of four is accepted")]
    NoWords {
        /// First address.
        start: u32,
        /// Length in bytes.
        length: u32,
    },
    /// The seal lies in no part of the file.
    #[error("its symbol {SYMBOL} lies in no part of the file")]
    Lost,
}

/// A part of the image in the flash.
#[derive(Clone, Copy, Debug)]
struct Range {
    start: u32,
    length: u32,
    /// Its place in the file.
    offset: usize,
}

/// Seals the image of an ELF file in place. False if the program has no self-test: then nothing
/// changes.
///
/// # Errors
///
/// The file is no image, or its parts do not fit.
pub(crate) fn seal(data: &mut [u8]) -> Result<bool, Error> {
    let Some((ranges, at)) = layout(data)? else {
        return Ok(false);
    };
    let words = ranges
        .iter()
        .flat_map(|range| [range.start, range.length])
        .chain(std::iter::repeat(0))
        .take(2 * RANGES)
        .chain([u32::MAX]);
    for (word, place) in words.zip(data[at..at + SIZE].chunks_exact_mut(4)) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    let crc = Crc::<u32>::new(&CRC_32_MPEG_2);
    let mut digest = crc.digest();
    for range in &ranges {
        let part = &data[range.offset..range.offset + range.length as usize];
        for word in part.chunks_exact(4) {
            // The processor reads the word least significant byte first; its CRC unit takes it
            // most significant bit first.
            digest.update(&[word[3], word[2], word[1], word[0]]);
        }
    }
    data[at + SIZE - 4..at + SIZE].copy_from_slice(&digest.finalize().to_le_bytes());
    Ok(true)
}

/// The parts of the image, and the place of the seal in the file; `None` without one.
fn layout(data: &[u8]) -> Result<Option<(Vec<Range>, usize)>, Error> {
    let file = ElfFile::<FileHeader32<LittleEndian>>::parse(data).map_err(|_| Error::NotAnImage)?;
    let endian = file.endian();
    let mut symbols = file.symbols();
    let Some(symbol) = symbols.find(|symbol| symbol.name() == Ok(SYMBOL)) else {
        return Ok(None);
    };
    let mut ranges = Vec::new();
    for segment in file.elf_program_headers() {
        let (start, length) = (segment.p_paddr(endian), segment.p_filesz(endian));
        if segment.p_type(endian) != PT_LOAD || length == 0 {
            continue;
        }
        if length % 4 != 0 || start % 4 != 0 {
            return Err(Error::NoWords { start, length });
        }
        let offset = segment.p_offset(endian) as usize;
        if offset.saturating_add(length as usize) > data.len() {
            return Err(Error::NotAnImage);
        }
        ranges.push(Range {
            start,
            length,
            offset,
        });
    }
    if ranges.len() > RANGES {
        return Err(Error::Ranges(ranges.len()));
    }
    let address = symbol.address();
    let place = ranges.iter().find_map(|range| {
        let inside = usize::try_from(address.checked_sub(u64::from(range.start))?).ok()?;
        (inside + SIZE <= range.length as usize).then_some(range.offset + inside)
    });
    Ok(Some((ranges, place.ok_or(Error::Lost)?)))
}

#[cfg(test)]
mod tests {
    use super::{Error, seal};

    #[test]
    fn what_is_no_image_is_refused() {
        assert_eq!(seal(&mut []), Err(Error::NotAnImage));
        assert_eq!(seal(&mut [0x7F; 100]), Err(Error::NotAnImage));
    }
}

//! Check of the flash against the image that was built.
//!
//! The build writes the ranges of the image and their check value into [`Seal`] (CRC-32 with the
//! polynomial 04C11DB7, words from the lowest address on, most significant bit first, remainder
//! all ones at the start, no final inversion: what the CRC units of the parts compute). The word of
//! the check value itself counts as all ones.

/// The CRC unit of a part.
pub trait CrcUnit {
    /// Starts a new check value.
    fn begin(&mut self);
    /// Takes the next word.
    fn feed(&mut self, word: u32);
    /// The check value.
    fn value(&self) -> u32;
}

/// Parts of an image: code and constants, and the first values of variables.
pub const RANGES: usize = 4;

/// What the build writes into an image. All zero until then.
#[repr(C)]
pub struct Seal {
    /// First address and length in bytes of each part; a length of zero is none.
    pub ranges: [[u32; 2]; RANGES],
    /// The check value.
    pub crc: u32,
}

#[cfg(target_os = "none")]
mod check {
    use super::{CrcUnit, RANGES, Seal};
    use parts::Memory;

    // SAFETY: the name is no other symbol's; the section is one of constants.
    #[unsafe(export_name = "IMAGE_SEAL")]
    #[unsafe(link_section = ".rodata.IMAGE_SEAL")]
    #[used]
    static SEAL: Seal = Seal {
        ranges: [[0; 2]; RANGES],
        crc: 0,
    };

    fn load(word: *const u32) -> u32 {
        // SAFETY: the caller has checked that the word lies in the flash. Volatile, because the
        // build changes it after the compiler has seen it.
        unsafe { word.read_volatile() }
    }

    /// Whether the flash holds the image that was sealed; `None` if it was not sealed.
    pub fn is_intact(flash: &Memory, unit: &mut impl CrcUnit) -> Option<bool> {
        let crc = &raw const SEAL.crc;
        let ranges = (&raw const SEAL.ranges).cast::<u32>();
        unit.begin();
        let mut sealed = false;
        for range in 0..RANGES {
            let start = load(ranges.wrapping_add(2 * range));
            let length = load(ranges.wrapping_add(2 * range + 1));
            if length == 0 {
                continue;
            }
            sealed = true;
            // A seal that is itself damaged must not lead beyond the flash.
            if !flash.holds(start, length) || !start.is_multiple_of(4) {
                return Some(false);
            }
            for word in 0..length / 4 {
                let at = (start as *const u32).wrapping_add(word as usize);
                unit.feed(if at == crc { u32::MAX } else { load(at) });
            }
        }
        sealed.then(|| unit.value() == load(crc))
    }
}

#[cfg(target_os = "none")]
pub use check::is_intact;

/// On a PC there is no image.
#[cfg(not(target_os = "none"))]
pub fn is_intact(_: &parts::Memory, _: &mut impl CrcUnit) -> Option<bool> {
    None
}

//! Erasing and programming the flash, as far as the firmware does it: missions on the F446, starts on the F303.
//!
//! Only the places for those can be changed, because the rest is decoded once and holds the program. While an
//! operation is running the core waits for its next read of the flash, where its program is: the model lets it wait
//! from the store that begins the operation. Operations take the longest time of the data sheet.

mod changing;
#[cfg(test)]
mod chip;
mod pages;
mod sectors;

use crate::clock::{Cycles, LocalClock, NEVER};
use crate::part::{Family, Part};
use parts::Sled;

/// The control registers and the contents that can be changed.
#[derive(Clone, Debug)]
pub(crate) enum Programming {
    Sectors(sectors::Sectors),
    Pages(pages::Pages),
}

impl Programming {
    /// With these contents of the whole flash.
    pub(crate) fn new(part: &'static Part, flash: &[u8]) -> Self {
        let sled = Sled::carrying(part);
        match part.family {
            Family::F4 => Self::Sectors(sectors::Sectors::new(sled, flash)),
            Family::F3 => Self::Pages(pages::Pages::new(sled, flash)),
        }
    }

    fn changing(&self) -> &changing::Changing {
        match self {
            Self::Sectors(sectors) => &sectors.changing,
            Self::Pages(pages) => &pages.changing,
        }
    }

    /// Resets the registers. What is running ends where it is.
    pub(crate) fn reset(&mut self) {
        match self {
            Self::Sectors(sectors) => sectors.reset(),
            Self::Pages(pages) => pages.reset(),
        }
    }

    /// Offset and number of the bytes that can be changed.
    pub(crate) fn range(&self) -> (u32, usize) {
        self.changing().range()
    }

    /// Bytes that can be changed, from this offset in the flash on; `None` if not all of them can.
    pub(crate) fn bytes(&self, offset: u32, size: usize) -> Option<&[u8]> {
        self.changing().bytes(offset, size)
    }

    /// The end of what is running.
    pub(crate) fn next_event(&self) -> Cycles {
        self.changing().end().unwrap_or(NEVER)
    }

    /// Ends what is over.
    pub(crate) fn advance(&mut self, now: Cycles) {
        match self {
            Self::Sectors(sectors) => sectors.advance(now),
            Self::Pages(pages) => pages.advance(now),
        }
    }

    /// Reads a register other than FLASH_ACR.
    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match self {
            Self::Sectors(sectors) => sectors.read(offset),
            Self::Pages(pages) => pages.read(offset),
        }
    }

    /// Writes a register other than FLASH_ACR.
    ///
    /// # Errors
    /// What the model does not have.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: Cycles,
        clock: &LocalClock,
    ) -> Result<(), &'static str> {
        match self {
            Self::Sectors(sectors) => sectors.write(offset, value, now, clock),
            Self::Pages(pages) => pages.write(offset, value, now, clock),
        }
    }

    /// The program stores bytes at this offset of the flash.
    pub(crate) fn store(&mut self, offset: u32, bytes: &[u8], now: Cycles, clock: &LocalClock) {
        match self {
            Self::Sectors(sectors) => sectors.store(offset, bytes, now, clock),
            Self::Pages(pages) => pages.store(offset, bytes, now, clock),
        }
    }
}

//! The CRC unit, for the check of the flash (RM0316 chapter 6). Its settings after a reset are those
//! that the check needs.

use crate::pac;
use sled_common::image::CrcUnit;

/// The CRC unit; its clock gate is open.
pub(crate) struct Unit<'a>(pub &'a pac::CRC);

impl CrcUnit for Unit<'_> {
    fn begin(&mut self) {
        self.0.cr.write(|w| w.reset().set_bit());
    }

    #[inline]
    fn feed(&mut self, word: u32) {
        self.0.dr().write(|w| w.dr().bits(word));
    }

    fn value(&self) -> u32 {
        self.0.dr().read().bits()
    }
}

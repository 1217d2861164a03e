//! The end of a node's work for a new mission.

use crate::board::flash::{Open, Writer};

use super::store::{self, Flash, Place};

impl Flash for Open<'_> {
    fn words(&self) -> usize {
        Open::words(self)
    }

    fn erase(&mut self, place: Place) -> bool {
        Open::erase(self, place == Place::Second)
    }

    fn write(&mut self, place: Place, at: usize, word: u32) -> bool {
        Open::write(self, place == Place::Second, at, word)
    }
}

/// Writes a record with its number into a place of the flash, and starts the node anew. The node must have left the
/// bus. It takes up to three seconds, in which no interrupt is served. If the flash fails, the old mission is still
/// there.
// Not inlined, because the analysis ends a path here: the node starts again.
#[inline(never)]
pub fn replace(writer: &Writer, place: Place, number: u32, record: &[u32]) -> ! {
    cortex_m::interrupt::disable();
    if let Some(mut flash) = writer.open() {
        // The next start finds out whether it has worked.
        let _ = store::write(&mut flash, place, number, record);
    }
    cortex_m::peripheral::SCB::sys_reset()
}

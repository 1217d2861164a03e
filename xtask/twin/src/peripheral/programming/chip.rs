//! A flash with its controller and a clock, for tests.

use super::Programming;
use super::changing::KEYS;
use crate::clock::{Cycles, LocalClock};
use crate::part::Part;

/// A microcontroller's flash, full of 0x5A at first.
pub(super) struct Chip {
    pub(super) flash: Programming,
    clock: LocalClock,
    now: Cycles,
    mhz: u64,
}

impl Chip {
    pub(super) fn new(part: &'static Part, mhz: u64) -> Self {
        let flash = vec![0x5A; part.flash.size as usize];
        Self {
            flash: Programming::new(part, &flash),
            clock: LocalClock::new(mhz * 1_000_000, 0, 0),
            now: 0,
            mhz,
        }
    }

    /// Unlocks the control register.
    pub(super) fn open(&mut self) {
        for key in KEYS {
            self.write(0x04, key);
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32) {
        assert!(!self.refuses(offset, value));
    }

    /// Writes a register, and says whether the model has no such operation.
    pub(super) fn refuses(&mut self, offset: u32, value: u32) -> bool {
        let written = self.flash.write(offset, value, self.now, &self.clock);
        written.is_err()
    }

    pub(super) fn store(&mut self, offset: u32, bytes: &[u8]) {
        self.flash.store(offset, bytes, self.now, &self.clock);
    }

    /// Lets the operation end, and says how long it took, us.
    pub(super) fn end(&mut self) -> u64 {
        let until = self.flash.changing().end().unwrap();
        let took = (until - self.now) / self.mhz;
        self.now = until;
        self.flash.advance(until);
        took
    }

    /// The word or half-word that lies here.
    pub(super) fn at<const N: usize>(&self, offset: u32) -> [u8; N] {
        self.flash.bytes(offset, N).unwrap().try_into().unwrap()
    }

    pub(super) fn status(&self) -> u32 {
        self.flash.read(0x0C).unwrap()
    }
}

//! Writes the pages in which a node counts its starts (RM0316 4.2.3), before it joins its network.
//!
//! The core cannot read its program while the flash is written: it waits, for up to 60 us, or 40 ms for a page (data
//! sheet DS9866, flash memory characteristics). So this is for the time before the node has deadlines.

use crate::pac;
use sled_common::starts::Units;

/// What unlocks FLASH_CR (RM0316 4.2.3). Anything else locks it until the next reset.
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// Bytes of an erase unit (RM0316 4.1).
const PAGE: u32 = 2048;

const PLACE: parts::Memory = {
    let Some(place) = crate::FACTS.starts else {
        panic!("the board has room for starts")
    };
    assert!(place.size == 2 * PAGE && place.base % PAGE == 0);
    place
};

/// What lets the watchdog be set, and what feeds it (RM0316 25.4).
const WATCHDOG_KEYS: [u16; 2] = [0x5555, 0xAAAA];
/// The longest count of the watchdog.
const LONGEST_COUNT: u16 = 0xFFF;

/// Whoever has it may write these pages.
pub struct Pages(pac::FLASH);

impl Pages {
    pub(crate) const fn new(flash: pac::FLASH) -> Self {
        Self(flash)
    }

    /// Opens the flash for writing. It needs the internal oscillator (RM0316 4.2.3), which runs on.
    fn open(&self) {
        if self.0.cr.read().lock().is_locked() {
            for key in KEYS {
                self.0.keyr.write(|w| w.fkeyr().bits(key));
            }
        }
        self.0
            .sr
            .write(|w| w.eop().reset().wrprterr().reset().pgerr().reset());
    }

    /// Waits for the end of what has begun, and closes the flash. True if it has worked.
    fn ends(&self) -> bool {
        cortex_m::asm::dsb();
        let status = loop {
            let status = self.0.sr.read();
            if status.bsy().is_inactive() {
                break status;
            }
        };
        self.0
            .cr
            .modify(|_, w| w.pg().clear_bit().per().clear_bit());
        self.0.cr.modify(|_, w| w.lock().lock());
        !(status.pgerr().is_error() || status.wrprterr().is_error())
    }

    /// The address of a half-word, if there is one.
    fn address(upper: bool, at: usize) -> Option<usize> {
        let page = PLACE.base + if upper { PAGE } else { 0 };
        let at = at.checked_mul(2).filter(|at| *at < PAGE as usize)?;
        Some(page as usize + at)
    }
}

impl Units for Pages {
    fn size(&self) -> usize {
        (PAGE / 2) as usize
    }

    fn read(&self, upper: bool, at: usize) -> u16 {
        let Some(address) = Self::address(upper, at) else {
            return 0;
        };
        // SAFETY: a half-word of these pages, aligned. Volatile, because it changes.
        unsafe { (address as *const u16).read_volatile() }
    }

    fn write(&mut self, upper: bool, at: usize, value: u16) -> bool {
        let Some(address) = Self::address(upper, at) else {
            return false;
        };
        self.open();
        self.0.cr.modify(|_, w| w.pg().program());
        // SAFETY: the same half-word, which no image uses.
        unsafe { (address as *mut u16).write_volatile(value) };
        self.ends() && self.read(upper, at) == value
    }

    fn erase(&mut self, upper: bool) -> bool {
        let Some(address) = Self::address(upper, 0) else {
            return false;
        };
        // SAFETY: nobody else uses the watchdog yet, and this only makes it wait longer.
        let watchdog = unsafe { &*pac::IWDG::ptr() };
        let usual = watchdog.rlr.read().rl().bits();
        let [set, feed] = WATCHDOG_KEYS;
        let give = |count: u16| {
            // SAFETY: keys of the watchdog, and a count that it has.
            unsafe {
                watchdog.kr.write(|w| w.bits(set.into()));
                watchdog.rlr.write(|w| w.bits(count.into()));
            }
            // It takes effect after some cycles of its oscillator; the watchdog ends this wait itself.
            while watchdog.sr.read().bits() != 0 {}
            // SAFETY: a key of the watchdog.
            unsafe { watchdog.kr.write(|w| w.bits(feed.into())) };
        };
        give(LONGEST_COUNT);
        self.open();
        self.0.cr.modify(|_, w| w.per().page_erase());
        self.0.ar.write(|w| w.far().bits(address as u32));
        self.0.cr.modify(|_, w| w.strt().start());
        let done = self.ends();
        give(usual);
        done && (0..self.size()).all(|at| self.read(upper, at) == u16::MAX)
    }
}

//! Writes missions into the flash (RM0390 3.5), while nothing else happens on the node.
//!
//! The core cannot read its program while the flash is erased or written: it waits, for up to two seconds (data sheet
//! DS10693, 6.3.12). No deadline of a node holds then. So this is for a node that has masked its interrupts, left
//! the bus, and starts anew afterwards.

use crate::pac;

/// What unlocks FLASH_CR (RM0390 3.5.1). Anything else locks it until the next reset.
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Words are written at once, which needs a supply of 2.7 V (RM0390 3.5.2, table 6). The supply is watched.
const WORD: u8 = 0b10;

/// The erase unit in which the missions begin: the first one of 128 KiB (RM0390 3.3, table 4).
const FIRST_SECTOR: u8 = 5;
/// Bytes of an erase unit.
const SECTOR: u32 = 128 * 1024;

const _: () = {
    let Some(mission) = &crate::FACTS.mission else {
        panic!("the board has room for missions")
    };
    // Sectors 0 to 4 have 128 KiB together.
    assert!(mission.base == crate::FACTS.part.flash.base + SECTOR * (FIRST_SECTOR as u32 - 4));
    assert!(mission.size == 2 * SECTOR);
};

/// Settings of the watchdog for its longest time: the largest divider and count (RM0390 22.4).
const LONGEST_DIVIDER: u8 = 6;
const LONGEST_COUNT: u16 = 0xFFF;
/// What lets the watchdog be set, and what feeds it.
const WATCHDOG_KEYS: [u16; 2] = [0x5555, 0xAAAA];

/// Whoever has it may write the flash.
pub struct Writer(pac::FLASH);

/// The flash is open for writing. Nothing but a reset closes it.
pub struct Open<'a>(&'a pac::FLASH);

impl Writer {
    pub(crate) const fn new(flash: pac::FLASH) -> Self {
        Self(flash)
    }

    /// Opens the flash, and gives the watchdog its longest time. `None` if the flash does not open, or the supply is
    /// too low.
    ///
    /// Call it with all interrupts masked for good: the node must start anew afterwards.
    pub fn open(&self) -> Option<Open<'_>> {
        // SAFETY: interrupts are masked for good, so nobody else has the watchdog or the power control any more.
        let (watchdog, power) = unsafe { (pac::IWDG::steal(), pac::PWR::steal()) };
        let [set, feed] = WATCHDOG_KEYS;
        // SAFETY: keys of the watchdog, and settings that it has (RM0390 22.4).
        unsafe {
            watchdog.kr().write(|w| w.key().bits(feed));
            watchdog.kr().write(|w| w.key().bits(set));
            watchdog.pr().write(|w| w.pr().bits(LONGEST_DIVIDER));
            watchdog.rlr().write(|w| w.rl().bits(LONGEST_COUNT));
            // They take effect after some cycles of its oscillator; it ends this wait itself.
            while watchdog.sr().read().bits() != 0 {}
            watchdog.kr().write(|w| w.key().bits(feed));
        }
        if !super::supply::is_good(&power) {
            return None;
        }
        let flash = &self.0;
        // What is read back must come from the flash, and not from the cache.
        flash.acr().modify(|_, w| w.dcen().clear_bit());
        for key in KEYS {
            // SAFETY: the keys of the reference manual.
            flash.keyr().write(|w| unsafe { w.key().bits(key) });
        }
        if flash.cr().read().lock().bit_is_set() {
            return None;
        }
        let open = Open(flash);
        // Errors of before.
        open.clear();
        Some(open)
    }
}

impl Open<'_> {
    /// Forgets errors.
    fn clear(&self) {
        self.0.sr().write(|w| {
            w.eop().clear_bit_by_one();
            w.operr().clear_bit_by_one();
            w.wrperr().clear_bit_by_one();
            w.pgaerr().clear_bit_by_one();
            w.pgperr().clear_bit_by_one();
            w.pgserr().clear_bit_by_one()
        });
    }

    /// Waits for the end of what has begun. True if it has worked.
    fn ends(&self) -> bool {
        cortex_m::asm::dsb();
        loop {
            let status = self.0.sr().read();
            if status.bsy().bit_is_clear() {
                return !(status.operr().bit_is_set()
                    || status.wrperr().bit_is_set()
                    || status.pgaerr().bit_is_set()
                    || status.pgperr().bit_is_set()
                    || status.pgserr().bit_is_set());
            }
        }
    }

    /// Erases half of the place for missions, the lower one or the upper one. True if it has worked.
    pub fn erase(&self, upper: bool) -> bool {
        let sector = FIRST_SECTOR + u8::from(upper);
        // SAFETY: a size that the supply allows, and a sector that holds no part of an image.
        self.0.cr().modify(|_, w| unsafe {
            w.psize().bits(WORD);
            w.snb().bits(sector);
            w.pg().clear_bit();
            w.ser().set_bit()
        });
        self.0.cr().modify(|_, w| w.strt().set_bit());
        self.ends()
    }

    /// Writes the word `at` of a half that is erased, and reads it back. False if that fails, or if there is no such
    /// word.
    pub fn write(&self, upper: bool, at: usize, word: u32) -> bool {
        let half = if upper { SECTOR } else { 0 };
        let Some(place) = &crate::FACTS.mission else {
            return false;
        };
        if at >= (SECTOR / 4) as usize {
            return false;
        }
        let address = (place.base + half) as usize + 4 * at;
        // SAFETY: a size that the supply allows.
        self.0.cr().modify(|_, w| unsafe {
            w.psize().bits(WORD);
            w.ser().clear_bit();
            w.pg().set_bit()
        });
        let target = address as *mut u32;
        // SAFETY: a word of the place for missions, aligned, which no image uses and nobody reads meanwhile.
        unsafe { target.write_volatile(word) };
        // SAFETY: the same word.
        self.ends() && unsafe { target.read_volatile() } == word
    }

    /// Words of a half.
    pub const fn words(&self) -> usize {
        (SECTOR / 4) as usize
    }
}

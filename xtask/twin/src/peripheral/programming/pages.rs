//! The pages of the F303 (RM0316 4.2.3 and 4.5), as far as the count of starts needs them.

use super::changing::{Changing, Gate};
use crate::clock::{Cycles, LocalClock, Ps};
use parts::Sled;

/// Bits of FLASH_CR.
const PG: u32 = 1;
const PER: u32 = 1 << 1;
const MER: u32 = 1 << 2;
const OPTIONS: u32 = 1 << 4 | 1 << 5;
const STRT: u32 = 1 << 6;
const LOCK: u32 = 1 << 7;
/// All fields of it but the lock.
const FIELDS: u32 = 0x3677 & !LOCK;

/// Bits of FLASH_SR.
const BSY: u32 = 1;
const PGERR: u32 = 1 << 2;
const WRPRTERR: u32 = 1 << 4;
const EOP: u32 = 1 << 5;
const FLAGS: u32 = PGERR | WRPRTERR | EOP;

/// Bytes of a page.
const PAGE: u32 = 2048;
/// Longest times for a page and a half-word (data sheet DS9866, flash memory characteristics).
const ERASE: Ps = 40_000_000_000;
const PROGRAM: Ps = 60_000_000;

/// The control registers and the contents that can be changed.
#[derive(Clone, Debug)]
pub(crate) struct Pages {
    gate: Gate,
    cr: u32,
    sr: u32,
    ar: u32,
    base: u32,
    pub(super) changing: Changing,
}

impl Pages {
    /// With these contents of the whole flash. `sled` says which part can be changed; without one, none.
    pub(super) fn new(sled: Option<&Sled>, flash: &[u8]) -> Self {
        let base = sled.map_or(0, |sled| sled.part.flash.base);
        let place = sled.and_then(|sled| sled.starts.as_ref());
        Self {
            gate: Gate::Locked,
            cr: LOCK,
            sr: 0,
            ar: 0,
            base,
            changing: Changing::new(place, base, flash),
        }
    }

    pub(super) fn reset(&mut self) {
        self.gate = Gate::Locked;
        self.cr = LOCK;
        self.sr = 0;
        self.ar = 0;
        self.changing.stop();
    }

    pub(super) fn advance(&mut self, now: Cycles) {
        if self.changing.advance(now) {
            self.cr &= !STRT;
            self.sr |= EOP;
        }
    }

    pub(super) fn read(&self, offset: u32) -> Option<u32> {
        let busy = if self.changing.end().is_some() {
            BSY
        } else {
            0
        };
        match offset {
            // KEYR and OPTKEYR.
            0x04 | 0x08 => Some(0),
            0x0C => Some(self.sr | busy),
            0x10 => Some(self.cr),
            0x14 => Some(self.ar),
            // OBR and WRPR: nothing is protected.
            0x1C => Some(0),
            0x20 => Some(u32::MAX),
            _ => None,
        }
    }

    pub(super) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: Cycles,
        clock: &LocalClock,
    ) -> Result<(), &'static str> {
        match offset {
            0x04 => {
                self.gate = self.gate.turn(value);
                if self.gate == Gate::Open {
                    self.cr &= !LOCK;
                }
            }
            0x0C => self.sr &= !(value & FLAGS),
            0x10 if self.gate == Gate::Open => {
                self.cr = value & FIELDS;
                if value & LOCK != 0 {
                    self.gate = Gate::Locked;
                    self.cr |= LOCK;
                }
                if self.cr & STRT != 0 {
                    return self.start(now, clock);
                }
            }
            // Without the keys it keeps its value.
            0x10 => {}
            0x14 if self.changing.end().is_none() => self.ar = value,
            0x14 => {}
            _ => return Err("option bytes are not modelled"),
        }
        Ok(())
    }

    /// Begins to erase the page of FLASH_AR.
    fn start(&mut self, now: Cycles, clock: &LocalClock) -> Result<(), &'static str> {
        if self.cr & (MER | OPTIONS) != 0 {
            return Err("the whole flash or the option bytes are erased");
        }
        if self.cr & PER == 0 {
            return Err("an operation is started that is none");
        }
        let page = self.ar.wrapping_sub(self.base) / PAGE * PAGE;
        if self.changing.bytes(page, PAGE as usize).is_none() {
            return Err("a page is erased that is not for starts");
        }
        let until = now + clock.cycles_of(ERASE);
        self.changing.begin(page, vec![0xFF; PAGE as usize], until);
        Ok(())
    }

    /// The program stores bytes at this offset of the flash: half-words that are erased, or zeros.
    pub(super) fn store(&mut self, offset: u32, bytes: &[u8], now: Cycles, clock: &LocalClock) {
        let old = self.changing.bytes(offset, bytes.len());
        if self.gate != Gate::Open || self.cr & (PG | PER | MER) != PG || bytes.len() != 2 {
            self.sr |= PGERR;
        } else if let Some(old) = old {
            if old == [0xFF; 2] || bytes == [0; 2] {
                let until = now + clock.cycles_of(PROGRAM);
                self.changing.begin(offset, bytes.to_vec(), until);
            } else {
                self.sr |= PGERR;
            }
        } else {
            self.sr |= WRPRTERR;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::changing::KEYS;
    use super::super::chip::Chip;
    use super::*;
    use crate::part::Part;

    const CR: u32 = 0x10;
    const SR: u32 = 0x0C;
    /// The first half-word of starts.
    const HERE: u32 = 0xE800;

    fn chip() -> Chip {
        Chip::new(Part::F303, 72)
    }

    fn word(chip: &Chip, offset: u32) -> u16 {
        u16::from_le_bytes(chip.at(offset))
    }

    #[test]
    fn a_page_is_erased_and_a_half_word_is_programmed() {
        let mut chip = chip();
        chip.open();
        chip.write(CR, PER);
        chip.write(0x14, 0x0800_E800);
        chip.write(CR, PER | STRT);
        assert_eq!(chip.status(), BSY);
        assert_eq!(chip.end(), 40_000);
        assert_eq!((chip.status(), word(&chip, HERE)), (EOP, u16::MAX));
        assert_eq!(word(&chip, HERE + PAGE), 0x5A5A);
        chip.write(CR, PG);
        chip.write(SR, EOP);
        chip.store(HERE, &[0x34, 0x12]);
        assert_eq!(chip.end(), 60);
        assert_eq!((chip.status(), word(&chip, HERE)), (EOP, 0x1234));
        // What is not erased becomes zero, or stays.
        chip.store(HERE, &[0x34, 0x10]);
        assert_eq!((chip.status(), word(&chip, HERE)), (EOP | PGERR, 0x1234));
        chip.store(HERE, &[0, 0]);
        chip.end();
        assert_eq!(word(&chip, HERE), 0);
    }

    #[test]
    fn without_the_keys_or_beside_the_place_nothing_changes() {
        let mut chip = chip();
        chip.write(CR, PG);
        chip.store(HERE, &[0; 2]);
        assert_eq!((chip.status(), chip.flash.read(CR)), (PGERR, Some(LOCK)));
        chip.write(0x04, KEYS[1]);
        chip.open();
        assert_eq!(chip.flash.read(CR), Some(LOCK));
        chip.flash.reset();
        chip.open();
        chip.write(CR, PG);
        chip.store(HERE + 2 * PAGE, &[0; 2]);
        assert_eq!(chip.status(), WRPRTERR);
        chip.store(HERE, &[0; 4]);
        assert_eq!(chip.status(), WRPRTERR | PGERR);
        let refused = |chip: &mut Chip, cr| chip.refuses(CR, cr);
        chip.write(0x14, 0x0800_0000);
        assert!(refused(&mut chip, PER | STRT) && refused(&mut chip, MER | STRT));
        assert_eq!(word(&chip, HERE), 0x5A5A);
    }
}

//! The sectors of the F446 (RM0390 3.5 and 3.8), as far as missions need them.

use super::changing::{Changing, Gate};
use crate::clock::{Cycles, LocalClock, Ps};
use parts::Sled;

/// Bits of FLASH_CR.
const PG: u32 = 1;
const SER: u32 = 1 << 1;
const MER: u32 = 1 << 2;
const STRT: u32 = 1 << 16;
const EOPIE: u32 = 1 << 24;
const LOCK: u32 = 1 << 31;
/// All fields of it but the lock.
const FIELDS: u32 = 0x0301_037F;

/// Bits of FLASH_SR.
const EOP: u32 = 1;
const WRPERR: u32 = 1 << 4;
const PGAERR: u32 = 1 << 5;
const PGPERR: u32 = 1 << 6;
const PGSERR: u32 = 1 << 7;
const ERRORS: u32 = 0xF2;
const BSY: u32 = 1 << 16;

/// Longest times with 8, 16, 32 and 64 bits at once (DS10693, table "flash memory programming"): a sector of 128 KiB,
/// and one unit.
const ERASE: [Ps; 4] = [
    4_000_000_000_000,
    2_600_000_000_000,
    2_000_000_000_000,
    2_000_000_000_000,
];
const PROGRAM: Ps = 100_000_000;

/// Bytes of a sector from the fifth on, and the number of the first of these.
const SECTOR: u32 = 128 * 1024;
const FIRST: u32 = 5;

/// Bytes that one operation may not leave (RM0390 3.5.4).
const ROW: u32 = 16;

/// The control registers and the contents that can be changed.
#[derive(Clone, Debug)]
pub(crate) struct Sectors {
    gate: Gate,
    cr: u32,
    sr: u32,
    pub(super) changing: Changing,
}

impl Sectors {
    /// With these contents of the whole flash. `sled` says which part can be changed; without one, none.
    pub(super) fn new(sled: Option<&Sled>, flash: &[u8]) -> Self {
        let base = sled.map_or(0, |sled| sled.part.flash.base);
        let place = sled.and_then(|sled| sled.mission.as_ref());
        Self {
            gate: Gate::Locked,
            cr: LOCK,
            sr: 0,
            changing: Changing::new(place, base, flash),
        }
    }

    /// Resets the registers. What is running ends where it is.
    pub(super) fn reset(&mut self) {
        self.gate = Gate::Locked;
        self.cr = LOCK;
        self.sr = 0;
        self.changing.stop();
    }

    /// Ends what is over.
    pub(super) fn advance(&mut self, now: Cycles) {
        if self.changing.advance(now) {
            self.cr &= !STRT;
            if self.cr & EOPIE != 0 {
                self.sr |= EOP;
            }
        }
    }

    pub(super) fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            // KEYR and OPTKEYR.
            0x04 | 0x08 => Some(0),
            0x0C => Some(
                self.sr
                    | if self.changing.end().is_some() {
                        BSY
                    } else {
                        0
                    },
            ),
            0x10 => Some(self.cr),
            0x14 => Some(0x0FFF_AAED),
            _ => None,
        }
    }

    /// Writes a register other than FLASH_ACR.
    ///
    /// # Errors
    /// What the model does not have.
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
            0x0C => self.sr &= !(value & (ERRORS | EOP)),
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
            _ => return Err("option bytes are not modelled"),
        }
        Ok(())
    }

    /// Begins to erase.
    fn start(&mut self, now: Cycles, clock: &LocalClock) -> Result<(), &'static str> {
        if self.cr & MER != 0 {
            return Err("the whole flash is erased, with the program");
        }
        if self.cr & SER == 0 || self.cr & PG != 0 {
            self.cr &= !STRT;
            self.sr |= PGSERR;
            return Ok(());
        }
        let sector = self.cr >> 3 & 0xF;
        let offset = sector.checked_sub(FIRST).map(|above| (above + 1) * SECTOR);
        let Some(at) =
            offset.filter(|offset| self.changing.bytes(*offset, SECTOR as usize).is_some())
        else {
            return Err("a sector is erased that is not for missions");
        };
        let size = self.cr >> 8 & 3;
        let until = now + clock.cycles_of(ERASE[size as usize]);
        self.changing.begin(at, vec![0xFF; SECTOR as usize], until);
        Ok(())
    }

    /// The program stores bytes at this offset of the flash.
    pub(super) fn store(&mut self, offset: u32, bytes: &[u8], now: Cycles, clock: &LocalClock) {
        let size = 1 << (self.cr >> 8 & 3);
        if self.gate != Gate::Open || self.cr & (PG | SER | MER) != PG {
            self.sr |= PGSERR;
        } else if bytes.len() != size {
            self.sr |= PGPERR;
        } else if offset / ROW != (offset + bytes.len() as u32 - 1) / ROW {
            self.sr |= PGAERR;
        } else if let Some(old) = self.changing.bytes(offset, bytes.len()) {
            // Programming makes ones to zeros.
            let new = old.iter().zip(bytes).map(|(old, new)| old & new).collect();
            let until = now + clock.cycles_of(PROGRAM);
            self.changing.begin(offset, new, until);
        } else {
            self.sr |= WRPERR;
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
    /// The first word of missions.
    const HERE: u32 = 0x2_0000;

    fn chip() -> Chip {
        Chip::new(Part::F446, 180)
    }

    fn word(chip: &Chip, offset: u32) -> u32 {
        u32::from_le_bytes(chip.at(offset))
    }

    #[test]
    fn a_sector_is_erased_and_a_word_is_programmed() {
        let mut chip = chip();
        chip.open();
        chip.write(CR, SER | 5 << 3 | 2 << 8);
        chip.write(CR, SER | 5 << 3 | 2 << 8 | STRT);
        assert_eq!(chip.status(), BSY);
        assert!(!matches!(word(&chip, HERE), 0x5A5A_5A5A | u32::MAX));
        assert_eq!(chip.end(), 2_000_000);
        assert_eq!((chip.status(), word(&chip, HERE)), (0, u32::MAX));
        assert_eq!(word(&chip, HERE + SECTOR), 0x5A5A_5A5A);
        chip.write(CR, PG | 2 << 8);
        chip.store(HERE, &0x1234_5678_u32.to_le_bytes());
        assert_eq!(chip.status(), BSY);
        assert_eq!(chip.end(), 100);
        assert_eq!((chip.status(), word(&chip, HERE)), (0, 0x1234_5678));
        // A second time leaves what both have.
        chip.store(HERE, &0x0FF0_0FF0_u32.to_le_bytes());
        chip.end();
        assert_eq!(word(&chip, HERE), 0x1234_5678 & 0x0FF0_0FF0);
    }

    #[test]
    fn without_the_keys_nothing_changes() {
        let mut chip = chip();
        chip.write(CR, PG | 2 << 8);
        chip.store(HERE, &[0; 4]);
        assert_eq!(chip.status(), PGSERR);
        assert_eq!(chip.flash.read(CR), Some(LOCK));
        chip.write(SR, PGSERR);
        assert_eq!(chip.status(), 0);
        // A wrong key bars it until a reset.
        chip.write(0x04, KEYS[1]);
        chip.open();
        assert_eq!(chip.flash.read(CR), Some(LOCK));
        chip.flash.reset();
        chip.open();
        assert_eq!(chip.flash.read(CR), Some(0));
        assert_eq!(word(&chip, HERE), 0x5A5A_5A5A);
    }

    #[test]
    fn what_does_not_fit_its_settings_is_refused() {
        let mut chip = chip();
        chip.open();
        chip.write(CR, PG);
        chip.store(HERE, &[0; 4]);
        assert_eq!(chip.status(), PGPERR);
        chip.write(CR, PG | 2 << 8);
        chip.store(HERE + 14, &[0; 4]);
        assert_eq!(chip.status(), PGPERR | PGAERR);
        chip.store(HERE + 2 * SECTOR, &[0; 4]);
        assert_eq!(chip.status(), PGPERR | PGAERR | WRPERR);
        chip.write(CR, STRT);
        assert_eq!(chip.status() & PGSERR, PGSERR);
        let refused = |chip: &mut Chip, cr| chip.refuses(CR, cr);
        assert!(refused(&mut chip, SER | 7 << 3 | STRT) && refused(&mut chip, SER | STRT));
        assert!(refused(&mut chip, MER | STRT));
        assert_eq!(word(&chip, HERE), 0x5A5A_5A5A);
    }

    #[test]
    fn a_reset_leaves_what_was_running_half_done() {
        let mut chip = chip();
        chip.open();
        chip.write(CR, SER | 6 << 3 | 2 << 8 | STRT);
        chip.flash.reset();
        assert_eq!((chip.status(), chip.flash.changing().end()), (0, None));
        assert!(!matches!(
            word(&chip, HERE + SECTOR),
            0x5A5A_5A5A | u32::MAX
        ));
        assert_eq!(word(&chip, HERE), 0x5A5A_5A5A);
    }
}

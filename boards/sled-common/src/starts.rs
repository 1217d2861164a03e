//! The number of a node's start, counted in its flash.
//!
//! Who has recorded a run can play it to a network that starts anew. A number that no other start of the node has
//! is what the firmware makes each run's tags different by.
//!
//! Two erase units take turns. Each has a head, the count at its beginning, and a mark for each start behind
//! it. The head is written when all marks of the other unit are used, and its first half-word last of all. So the unit
//! with the greatest count that has a whole head is the one that counts, and a loss of power at any write leaves
//! one of the two:
//!
//! | half-word | contents |
//! | --- | --- |
//! | 0 | `0x51A7`, written last |
//! | 1, 2 | the count, least significant half first |
//! | 3 | the exclusive or of these two and of `0x51A7` |
//! | 4.. | marks: erased, or used by a start |
//! | the last | erased, or zero once the other unit goes on from this one |
//!
//! When the other unit has a whole head, the last half-word of this one is written before a start gets a number from
//! the other. So if a head is not whole, the last half-word of the other unit tells why. If it is erased, a loss of
//! power interrupted the head, and no start has a number from it. If it is not, the head was whole once and is
//! damaged: the older unit must not count on, because its next numbers were given already.
//!
//! A number counts only when its mark was read back, so no two starts have the same one. Marks that a loss of power
//! left half written are used ones.

/// Says that a head is whole.
const WHOLE: u16 = 0x51A7;
/// Half-words of a head.
const HEAD: usize = 4;
const ERASED: u16 = u16::MAX;
const USED: u16 = 0;

/// Two erase units of a flash that is written by half-words.
pub trait Units {
    /// Half-words of a unit.
    fn size(&self) -> usize;
    /// The half-word `at` of the upper or lower unit.
    fn read(&self, upper: bool, at: usize) -> u16;
    /// Writes a half-word that is erased, or zero to any, and reads it back. False if it is not there.
    fn write(&mut self, upper: bool, at: usize, value: u16) -> bool;
    /// Erases a unit. False if it is not erased.
    fn erase(&mut self, upper: bool) -> bool;
}

/// Why a start has no number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Lost {
    /// The unit that counts has no whole head: the number of the starts before is not known.
    Damaged,
    /// The flash could not be written.
    Unwritten,
}

/// Counts a start, and returns its number, from 1 on.
///
/// # Errors
/// [`Lost`] says why there is none.
pub fn count(units: &mut impl Units) -> Result<u32, Lost> {
    let (upper, begin) = match [false, true].map(|upper| head(units, upper)) {
        [Some(lower), Some(upper)] => {
            let newer = upper > lower;
            // The loss of power came between the head and this.
            leave(units, !newer)?;
            (newer, lower.max(upper))
        }
        [Some(lower), None] if !is_left(units, false) => (false, lower),
        [None, Some(upper)] if !is_left(units, true) => (true, upper),
        [None, None] if is_unused(units, false) && is_unused(units, true) => {
            self::begin(units, false, 0)?;
            (false, 0)
        }
        _ => return Err(Lost::Damaged),
    };
    if let Some(number) = mark(units, upper, begin) {
        return Ok(number);
    }
    // All of its marks are used, or cannot be written.
    let next = begin.saturating_add(units.size() as u32);
    self::begin(units, !upper, next)?;
    leave(units, upper)?;
    mark(units, !upper, next).ok_or(Lost::Unwritten)
}

/// The count of a unit, if its head is whole.
fn head(units: &impl Units, upper: bool) -> Option<u32> {
    let [whole, low, high, check] = core::array::from_fn(|at| units.read(upper, at));
    let is_whole = whole == WHOLE && check == low ^ high ^ WHOLE;
    is_whole.then_some(u32::from(low) | u32::from(high) << 16)
}

/// Whether no start has used a mark of this unit.
fn is_unused(units: &impl Units, upper: bool) -> bool {
    (HEAD..units.size()).all(|at| units.read(upper, at) == ERASED)
}

/// Whether the other unit has gone on from this one.
fn is_left(units: &impl Units, upper: bool) -> bool {
    units.read(upper, last(units)) != ERASED
}

/// Notes in this unit that the other one goes on from it. A loss of power that leaves this half written does no harm,
/// as the head of the other unit is whole.
fn leave(units: &mut impl Units, upper: bool) -> Result<(), Lost> {
    let last = last(units);
    let done = is_left(units, upper) || units.write(upper, last, USED);
    if done { Ok(()) } else { Err(Lost::Unwritten) }
}

/// The last half-word of a unit.
fn last(units: &impl Units) -> usize {
    units.size().saturating_sub(1)
}

/// Begins a unit with this count.
fn begin(units: &mut impl Units, upper: bool, count: u32) -> Result<(), Lost> {
    let (low, high) = (count as u16, (count >> 16) as u16);
    // Without its first half-word the old head is not whole, whatever an interrupted erasure makes of it.
    let done = units.write(upper, 0, 0)
        && units.erase(upper)
        && units.write(upper, 1, low)
        && units.write(upper, 2, high)
        && units.write(upper, 3, low ^ high ^ WHOLE)
        && units.write(upper, 0, WHOLE);
    if done { Ok(()) } else { Err(Lost::Unwritten) }
}

/// Uses the next mark. Returns the number of the start; `None` if there is no mark.
fn mark(units: &mut impl Units, upper: bool, begin: u32) -> Option<u32> {
    (HEAD..last(units)).find_map(|at| {
        let used = units.read(upper, at) == ERASED && units.write(upper, at, USED);
        used.then(|| begin.saturating_add(at as u32))
    })
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::{collections::BTreeSet, vec, vec::Vec};

    const SIZE: usize = 12;

    /// A flash that loses its power at one of its writes, which leaves some bits changed.
    #[derive(Clone)]
    struct Flash {
        units: [Vec<u16>; 2],
        /// Writes and erasures until the power is lost, and what is left of the bits then.
        power: Option<(usize, u16)>,
        /// Half-words that cannot be written.
        dead: BTreeSet<(bool, usize)>,
        erasures: usize,
    }

    impl Flash {
        fn new() -> Self {
            Self {
                units: [vec![ERASED; SIZE], vec![ERASED; SIZE]],
                power: None,
                dead: BTreeSet::new(),
                erasures: 0,
            }
        }

        /// Whether the power lasts for this operation; if not, which bits of it happen.
        fn lasts(&mut self) -> Option<u16> {
            match &mut self.power {
                None => Some(ERASED),
                Some((0, _)) => None,
                Some((1, bits)) => {
                    let bits = *bits;
                    self.power = Some((0, 0));
                    Some(bits)
                }
                Some((left, _)) => {
                    *left -= 1;
                    Some(ERASED)
                }
            }
        }

        fn is_lost(&self) -> bool {
            matches!(self.power, Some((0, _)))
        }
    }

    impl Units for Flash {
        fn size(&self) -> usize {
            SIZE
        }

        fn read(&self, upper: bool, at: usize) -> u16 {
            self.units[usize::from(upper)][at]
        }

        fn write(&mut self, upper: bool, at: usize, value: u16) -> bool {
            let Some(bits) = self.lasts() else {
                return false;
            };
            if self.dead.contains(&(upper, at)) {
                return false;
            }
            let word = &mut self.units[usize::from(upper)][at];
            assert!(*word == ERASED || value == 0, "the flash refuses that");
            *word &= value | !bits;
            let is_there = *word == value;
            is_there && !self.is_lost()
        }

        fn erase(&mut self, upper: bool) -> bool {
            let Some(bits) = self.lasts() else {
                return false;
            };
            self.erasures += 1;
            for word in &mut self.units[usize::from(upper)] {
                *word |= bits;
            }
            !self.is_lost()
        }
    }

    #[test]
    fn every_start_has_a_number_of_its_own() {
        let mut flash = Flash::new();
        let mut last = 0;
        for _ in 0..100 {
            let number = count(&mut flash).unwrap();
            assert!(number > last);
            last = number;
        }
        // One for each unit that is begun.
        assert_eq!(flash.erasures, 100_usize.div_ceil(SIZE - HEAD - 1));
    }

    #[test]
    fn a_mark_that_cannot_be_written_is_left_out() {
        let mut flash = Flash::new();
        flash.dead.insert((false, 5));
        let numbers = [0; 4].map(|_| count(&mut flash).unwrap());
        assert_eq!(numbers, [4, 6, 7, 8]);
    }

    #[test]
    fn a_flash_that_cannot_be_written_gives_no_number() {
        let mut flash = Flash::new();
        flash.power = Some((0, 0));
        assert_eq!(count(&mut flash), Err(Lost::Unwritten));
    }

    /// One half-word of either head has another value, after any number of starts.
    #[test]
    fn a_damaged_head_gives_no_number_again() {
        for starts in 1..40 {
            let mut flash = Flash::new();
            let given: BTreeSet<u32> = (0..starts).map(|_| count(&mut flash).unwrap()).collect();
            for (upper, at, bit) in
                (0..2 * HEAD * 16).map(|case| (case % 2, case / 32, case / 2 % 16))
            {
                let mut damaged = flash.clone();
                damaged.units[upper][at] ^= 1 << bit;
                for later in 0..30 {
                    let number = count(&mut damaged);
                    if let Ok(number) = number {
                        assert!(
                            !given.contains(&number),
                            "{number}: {starts}, {later} later"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_damaged_head_of_the_unit_that_counts_is_told() {
        let mut flash = Flash::new();
        for _ in 0..SIZE {
            count(&mut flash).unwrap();
        }
        flash.units[1][1] ^= 1;
        assert_eq!(count(&mut flash), Err(Lost::Damaged));
        // The other one is not asked for a number any more.
        flash.units[1][1] ^= 1;
        flash.units[0][1] ^= 1;
        assert!(count(&mut flash).is_ok());
    }

    #[test]
    fn a_count_that_is_gone_does_not_begin_anew() {
        let mut flash = Flash::new();
        count(&mut flash).unwrap();
        flash.units[0][1] ^= 1;
        assert_eq!(count(&mut flash), Err(Lost::Damaged));
    }

    /// The power is lost at any write of any start, twice in a row at most, and leaves any bits.
    #[test]
    fn no_number_comes_twice() {
        // Numerical Recipes' generator: the cases are many and always the same.
        let mut seed = 1_u32;
        let mut random = |below: u32| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) % below
        };
        for _ in 0..20_000 {
            let mut flash = Flash::new();
            let mut last = 0;
            for _ in 0..8 {
                for _ in 0..random(10) {
                    let number = count(&mut flash).unwrap();
                    assert!(number > last, "{number} after {last}");
                    last = number;
                }
                flash.power = Some((1 + random(7) as usize, random(1 << 16) as u16));
                // A number that came before the loss has perhaps been used.
                if let Ok(number) = count(&mut flash) {
                    assert!(number > last, "{number} after {last}");
                    last = number;
                }
                flash.power = None;
            }
            assert!(count(&mut flash).unwrap() > last);
        }
    }
}

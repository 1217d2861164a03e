//! Two places in the flash for missions, of which one holds the mission that counts.
//!
//! A new mission is written into the other place, so a loss of power leaves the old one or the new one, whatever
//! word was being written. A place has the record at its beginning and its number in its last four words:
//!
//! | word of the place | contents |
//! | --- | --- |
//! | 0 | the record's first word, which is written last but one and makes all else count |
//! | 1.. | the rest of the record |
//! | last but three | number of the mission: the higher one of the two places counts |
//! | last but two | the same number, inverted |
//! | last but one | CRC-32 of the number |
//! | last | the record's first word again, which tells a damaged one in word 0 from one that was not written to its end |
//!
//! So whichever two bits of both places are lost, the numbers of both are still known, and no older mission is driven in
//! place of a damaged one: the three words of two numbers differ in five bits or more, which leaves the true number the
//! only one within two bits. Word 0 is the same in all records, so two lost bits of it do no harm.
//!
//! A debug probe writes the record alone. It has number 0.
//!
//! The flash is erased in units of a place. While it is erased or written, the core cannot read its program
//! (RM0390 3.4), so a node writes when it has left the bus, and starts anew afterwards.

use super::record::{CRC, HEAD, Head, MAGIC, Stored};

/// Words behind the record, at the end of a place.
const END: usize = 4;

/// A place of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// That of the lower addresses.
    First,
    /// That of the higher ones.
    Second,
}

impl Place {
    const BOTH: [Self; 2] = [Self::First, Self::Second];

    /// The other place.
    pub const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }
}

/// What lies in both places.
#[derive(Clone, Debug)]
pub struct Found {
    /// The mission that counts.
    pub stored: Stored,
    /// Its number; 0 if a debug probe wrote it, or there is none.
    pub number: u32,
    /// Where the next mission is written.
    pub free: Place,
    /// The number of that.
    pub next: u32,
}

/// What lies in one place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    /// Nothing that counts: it is erased, or was not written to its end.
    Nothing,
    /// A whole record with this number.
    Whole(u32),
    /// A damaged record, which had this number, or something else.
    Damaged(Option<u32>),
}

/// Bits that a place may lose while its number is still known.
const LOST: u32 = 2;

/// The number of a record that may be damaged: the one of which the words behind the record have lost two bits at most.
fn number(place: &[u32]) -> Option<u32> {
    let &[number, inverse, sum, _] = place.last_chunk::<END>()?;
    let erased = [number, inverse, sum].map(u32::count_zeros);
    if erased.iter().sum::<u32>() <= LOST {
        return Some(0);
    }
    let mut found = None;
    let mut consider = |candidate: u32| {
        let lost = (candidate ^ number).count_ones()
            + (!candidate ^ inverse).count_ones()
            + (sealed(candidate) ^ sum).count_ones();
        if lost <= LOST {
            found = Some(candidate);
        }
    };
    consider(number);
    consider(!inverse);
    // Both copies have lost a bit.
    // loop-bound: 32
    for bit in 0..u32::BITS {
        consider(number ^ 1 << bit);
    }
    found
}

/// The check value of a number.
// Not inlined, so that the analysis bounds its loop once.
#[inline(never)]
fn sealed(number: u32) -> u32 {
    CRC.checksum(&number.to_le_bytes())
}

fn content(place: &[u32]) -> Content {
    match place.first() {
        None => Content::Nothing,
        // Only some of its bits were written, or none.
        Some(word)
            if (word ^ MAGIC).count_ones() > LOST
                && word & MAGIC == MAGIC
                && place.last() != Some(&MAGIC) =>
        {
            Content::Nothing
        }
        Some(_) => match (Head::read(place), number(place)) {
            (Some(_), Some(number)) => Content::Whole(number),
            (_, number) => Content::Damaged(number),
        },
    }
}

/// Whether a number is higher than another one. Numbers wrap.
const fn is_higher(one: u32, other: u32) -> bool {
    one.wrapping_sub(other).cast_signed() > 0
}

/// What two places are worth together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Judged {
    /// The newest whole record, with its number.
    newest: Option<(Place, u32)>,
    /// There is a damaged record, newer than that. No older mission is driven in its place.
    replaced: bool,
    /// The number of the next mission.
    next: u32,
}

fn judged(contents: [Content; 2]) -> Judged {
    let mut newest: Option<(Place, u32)> = None;
    let mut highest = 0;
    let mut lost = None;
    // loop-bound: 2
    for (place, content) in Place::BOTH.into_iter().zip(contents) {
        let known = match content {
            Content::Nothing => continue,
            Content::Whole(number) => {
                if newest.is_none_or(|(_, so_far)| is_higher(number, so_far)) {
                    newest = Some((place, number));
                }
                number
            }
            Content::Damaged(number) => {
                let number = number.unwrap_or(0);
                lost = Some(lost.map_or(number, |so_far: u32| so_far.max(number)));
                number
            }
        };
        if is_higher(known, highest) {
            highest = known;
        }
    }
    Judged {
        newest,
        replaced: lost.is_some_and(|lost| newest.is_none_or(|(_, number)| is_higher(lost, number))),
        next: highest.wrapping_add(1).max(1),
    }
}

/// Finds the mission that counts in two places of the same length.
pub fn find(words: &'static [u32]) -> Found {
    let (first, second) = words.split_at(words.len() / 2);
    let Judged {
        newest,
        replaced,
        next,
    } = judged([first, second].map(content));
    let Some((place, number)) = newest else {
        return Found {
            stored: if replaced {
                Stored::Damaged
            } else {
                Stored::None
            },
            number: 0,
            free: Place::First,
            next,
        };
    };
    let words = match place {
        Place::First => first,
        Place::Second => second,
    };
    let stored = if replaced {
        Stored::Damaged
    } else {
        Stored::read(words)
    };
    Found {
        number: match stored {
            Stored::None => 0,
            Stored::Mission(_) | Stored::Damaged => number,
        },
        stored,
        free: place.other(),
        next,
    }
}

/// A flash with two places. Each call is done when it returns, and says whether it has worked.
pub trait Flash {
    /// Words of a place.
    fn words(&self) -> usize;
    /// Erases a place.
    fn erase(&mut self, place: Place) -> bool;
    /// Writes a word of a place that is erased, and reads it back.
    fn write(&mut self, place: Place, at: usize, word: u32) -> bool;
}

/// Writes a record with its number into a place. False if the flash fails or the record does not fit; the place
/// does not count then.
pub fn write(flash: &mut impl Flash, place: Place, number: u32, record: &[u32]) -> bool {
    let end = flash.words().saturating_sub(END);
    let Some((&head, rest)) = record.split_first() else {
        return false;
    };
    if record.len() < HEAD || record.len() > end || head != MAGIC {
        return false;
    }
    if !flash.erase(place) {
        return false;
    }
    // loop-bound: 32768. The words of a place.
    for (at, word) in (1..).zip(rest) {
        if !flash.write(place, at, *word) {
            return false;
        }
    }
    flash.write(place, end, number)
        && flash.write(place, end + 1, !number)
        && flash.write(place, end + 2, sealed(number))
        && flash.write(place, 0, head)
        && flash.write(place, end + 3, head)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::boxed::Box;
    use std::vec::Vec;

    use control::dubins::Pose;
    use control::mission::{End, Leg, Legs, Mission};
    use control::position::Position;
    use proptest::prelude::*;

    use super::super::record::{dropped, words};
    use super::*;

    /// Words of a place in the tests.
    const PLACE: usize = 64;

    /// A flash as it is on the chip: a word can lose bits only. Power fails in the middle of an operation; what it
    /// leaves is chance.
    #[derive(Clone, Debug)]
    struct Chip {
        words: Vec<u32>,
        /// Operations until power fails.
        left: usize,
        chance: u32,
    }

    impl Chip {
        fn new() -> Self {
            Self {
                words: std::vec![u32::MAX; 2 * PLACE],
                left: usize::MAX,
                chance: 0x9E37_79B9,
            }
        }

        fn random(&mut self) -> u32 {
            self.chance ^= self.chance << 13;
            self.chance ^= self.chance >> 17;
            self.chance ^= self.chance << 5;
            self.chance
        }

        fn found(&self) -> Found {
            find(Box::leak(self.words.clone().into_boxed_slice()))
        }

        /// North of the origin of the mission that counts, which tells missions apart.
        fn mission(&self) -> Option<i32> {
            match self.found().stored {
                Stored::Mission(kept) => Some(kept.mission().origin().north),
                Stored::None => None,
                Stored::Damaged => Some(-1),
            }
        }

        fn put(&mut self, record: &[u32]) -> bool {
            let Found { free, next, .. } = self.found();
            write(self, free, next, record)
        }
    }

    impl Flash for Chip {
        fn words(&self) -> usize {
            PLACE
        }

        fn erase(&mut self, place: Place) -> bool {
            let begin = place as usize * PLACE;
            for at in begin..begin + PLACE {
                let chance = if self.left == 0 {
                    self.random()
                } else {
                    u32::MAX
                };
                self.words[at] |= chance;
            }
            self.left = self.left.saturating_sub(1);
            self.left > 0
        }

        fn write(&mut self, place: Place, at: usize, word: u32) -> bool {
            if self.left == 0 {
                return false;
            }
            let spared = if self.left == 1 { self.random() } else { 0 };
            self.left -= 1;
            let cell = &mut self.words[place as usize * PLACE + at];
            *cell &= word | spared;
            self.left > 0 && *cell == word
        }
    }

    /// The record of a mission with its origin so far north.
    fn record(north: i32) -> Vec<u32> {
        let legs = [Leg {
            start: Pose {
                north: 0.0,
                east: 0.0,
                heading: 0.0,
            },
            length: 5.0,
            speed: 1.0,
            ..Leg::default()
        }; 1];
        let mission = Legs {
            origin: Position::new(north, 0),
            legs: &legs,
            fence: &[],
            obstacles: &[],
            end: End::Stop,
        };
        words(&mission).unwrap().collect()
    }

    #[test]
    fn the_last_mission_counts() {
        let mut chip = Chip::new();
        assert_eq!((chip.mission(), chip.found().number), (None, 0));
        for number in 1..5 {
            assert!(chip.put(&record(number)));
            assert_eq!(chip.mission(), Some(number));
            assert_eq!(chip.found().number, number.cast_unsigned());
        }
        assert!(chip.put(&dropped()));
        // A mission that was dropped has no number, but the next one goes on.
        assert_eq!((chip.mission(), chip.found().number), (None, 0));
        assert_eq!(chip.found().next, 6);
    }

    #[test]
    fn a_probe_writes_number_0() {
        let mut chip = Chip::new();
        let written = record(7);
        chip.words[..written.len()].copy_from_slice(&written);
        assert_eq!((chip.mission(), chip.found().number), (Some(7), 0));
        assert!(chip.put(&record(8)));
        assert_eq!((chip.mission(), chip.found().number), (Some(8), 1));
    }

    /// What a probe wrote has no second copy of its first word, and neither has a mission behind which power failed.
    #[test]
    fn the_first_word_may_lose_two_bits() {
        let mut probed = Chip::new();
        let written = record(7);
        probed.words[..written.len()].copy_from_slice(&written);
        let mut cut = Chip::new();
        assert!(cut.put(&record(1)) && cut.put(&record(2)));
        *cut.words.last_mut().unwrap() = u32::MAX;
        for (chip, first, mission) in [(probed, 0, 7), (cut, PLACE, 2)] {
            for (one, other) in (0..32).flat_map(|one| (0..=one).map(move |other| (one, other))) {
                let mut chip = chip.clone();
                chip.words[first] ^= 1 << one | 1 << other;
                assert_eq!(chip.mission(), Some(mission), "bits {one}, {other}");
            }
        }
    }

    #[test]
    fn numbers_wrap() {
        let mut chip = Chip::new();
        assert!(write(&mut chip, Place::First, u32::MAX, &record(1)));
        assert_eq!(chip.mission(), Some(1));
        assert!(write(&mut chip, Place::Second, 1, &record(2)));
        assert_eq!(chip.mission(), Some(2));
    }

    #[test]
    fn a_record_that_does_not_fit_erases_nothing() {
        let mut chip = Chip::new();
        let mut long = record(1);
        long.resize(PLACE - END + 1, 0);
        for wrong in [&long[..], &[], &[MAGIC; 3], &[0; HEAD]] {
            assert!(!write(&mut chip, Place::First, 1, wrong));
        }
        assert!(chip.words.iter().all(|word| *word == u32::MAX));
    }

    /// A mission that has lost a bit is not driven, and neither is an older one in its place.
    #[test]
    fn a_damaged_mission_is_not_replaced_by_an_older_one() {
        let mut chip = Chip::new();
        assert!(chip.put(&record(1)) && chip.put(&record(2)));
        let whole = chip.clone();
        for (at, bit) in (PLACE..2 * PLACE).flat_map(|at| (0..32).map(move |bit| (at, bit))) {
            chip = whole.clone();
            chip.words[at] ^= 1 << bit;
            // Words between the record and its number belong to neither, and each of the last ones is known from others.
            let of_record = (PLACE + 1..PLACE + record(2).len()).contains(&at);
            let expected = if of_record { -1 } else { 2 };
            assert_eq!(chip.mission(), Some(expected), "word {at}, bit {bit}");
            assert!(chip.put(&record(3)));
            assert_eq!(chip.mission(), Some(3));
        }
    }

    /// Of three bits or more, both copies already differ in six. The difference of two check values depends on that of the
    /// numbers only.
    #[test]
    fn two_numbers_differ_in_five_bits_or_more() {
        let pairs = (0..32).flat_map(|one| (0..=one).map(move |other| 1_u32 << one | 1 << other));
        let apart = |bits: u32| 2 * bits.count_ones() + (sealed(bits) ^ sealed(0)).count_ones();
        assert!(pairs.map(apart).min() >= Some(2 * LOST + 1));
    }

    /// The bits of a place that say something: those of the record and of the last words.
    fn telling(record: &[u32]) -> Vec<(usize, u32)> {
        let words = (0..record.len()).chain(PLACE - END..PLACE);
        words
            .flat_map(|at| (0..32).map(move |bit| (at, 1 << bit)))
            .collect()
    }

    /// What a place is with any one of its bits lost, and with any two of them.
    fn with_losses(place: &[u32], bits: &[(usize, u32)]) -> (Vec<Content>, Vec<Content>) {
        let mut place = place.to_vec();
        let (mut one, mut two) = (Vec::new(), Vec::new());
        for (index, &(at, bit)) in bits.iter().enumerate() {
            place[at] ^= bit;
            one.push(content(&place));
            for &(at, bit) in &bits[index + 1..] {
                place[at] ^= bit;
                two.push(content(&place));
                place[at] ^= bit;
            }
            place[at] ^= bit;
        }
        (one, two)
    }

    /// Whichever two bits of both places are lost, the newer mission counts or none. Behind a mission of 0xFFFF a lost bit
    /// makes more of a difference than behind the first ones.
    #[test]
    fn no_two_lost_bits_bring_an_older_mission_back() {
        for number in [1, 2, 0xFFFF, 0x7FFF_FFFE] {
            for newer in [record(2), dropped().to_vec()] {
                let mut chip = Chip::new();
                assert!(write(&mut chip, Place::First, number, &record(1)));
                assert!(write(&mut chip, Place::Second, number + 1, &newer));
                let (older, newer) = (
                    with_losses(&chip.words[..PLACE], &telling(&record(1))),
                    with_losses(&chip.words[PLACE..], &telling(&newer)),
                );
                let whole = (Content::Whole(number), Content::Whole(number + 1));
                let within_older = older.1.iter().map(|older| [*older, whole.1]);
                let within_newer = newer.1.iter().map(|newer| [whole.0, *newer]);
                let one_in_each = older
                    .0
                    .iter()
                    .flat_map(|older| newer.0.iter().map(|newer| [*older, *newer]));
                let all = within_older.chain(within_newer).chain(one_in_each);
                let back = all.filter(|contents| {
                    let Judged {
                        newest, replaced, ..
                    } = judged(*contents);
                    !replaced && newest != Some((Place::Second, number + 1))
                });
                assert_eq!(back.count(), 0, "of {number}");
            }
        }
    }

    /// Wherever power fails, the old mission is there or the new one; and the next one can be written.
    #[test]
    fn a_cut_at_any_word_leaves_the_old_mission_or_the_new_one() {
        // Before it: nothing, one mission, two, and one by a probe.
        for before in 0..4 {
            let mut old = Chip::new();
            match before {
                3 => old.words[PLACE..PLACE + record(9).len()].copy_from_slice(&record(9)),
                count => (0..count).for_each(|number| assert!(old.put(&record(number + 1)))),
            }
            let was = old.mission();
            for new in [record(20), dropped().to_vec()] {
                let is = (new.len() > HEAD).then_some(20);
                for (left, chance) in
                    (0..=new.len() + 5).flat_map(|left| (1..40).map(move |c| (left, c)))
                {
                    let mut chip = Chip {
                        left,
                        chance: 0x9E37_79B9_u32.wrapping_mul(chance),
                        ..old.clone()
                    };
                    assert!(!chip.put(&new), "{left}");
                    let left_behind = chip.mission();
                    assert!(
                        left_behind == was || left_behind == is,
                        "{before}, {left}: {left_behind:?}"
                    );
                    assert!(
                        left > new.len() + 3 || left_behind == was,
                        "{before}, {left}: {left_behind:?}"
                    );
                    chip.left = usize::MAX;
                    assert!(chip.put(&record(30)));
                    assert_eq!(chip.mission(), Some(30), "{before}, {left}");
                }
                let mut chip = old.clone();
                assert!(chip.put(&new));
                assert_eq!(chip.mission(), is);
            }
        }
    }

    proptest! {
        #[test]
        fn any_words_are_read(words in prop::collection::vec(any::<u32>(), 0..3 * PLACE)) {
            let found = find(Box::leak(words.into_boxed_slice()));
            prop_assert!(!matches!(found.stored, Stored::Mission(_)));
            prop_assert!(found.next > 0);
        }
    }
}

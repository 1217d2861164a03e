//! Two places in the flash for missions, of which one holds the mission that counts.
//!
//! A new mission is written into the other place, so a loss of power leaves the old one or the new one, whatever
//! word was being written. A place has the record at its beginning and its number in its last two words:
//!
//! | word of the place | contents |
//! | --- | --- |
//! | 0 | the record's first word, which is written last and makes all else count |
//! | 1.. | the rest of the record |
//! | last but one | number of the mission: the higher one of the two places counts |
//! | last | CRC-32 of that number and the record's check value |
//!
//! A debug probe writes the record alone. It has number 0.
//!
//! The flash is erased in units of a place. While it is erased or written, the core cannot read its program
//! (RM0390 3.4), so a node writes when it has left the bus, and starts anew afterwards.

use super::record::{CHECK, CRC, HEAD, Head, MAGIC, Stored};

/// Words behind the record, at the end of a place.
const END: usize = 2;

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

/// The number of a record that may be damaged.
fn number(place: &[u32]) -> Option<u32> {
    let check = *place.get(CHECK)?;
    match *place.last_chunk::<END>()? {
        [u32::MAX, u32::MAX] => Some(0),
        [number, sum] if sum == sealed(number, check) => Some(number),
        _ => None,
    }
}

/// The last word of a place.
fn sealed(number: u32, check: u32) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&number.to_le_bytes());
    digest.update(&check.to_le_bytes());
    digest.finalize()
}

fn content(place: &[u32]) -> Content {
    match place.first() {
        None => Content::Nothing,
        // Only some of its bits were written, or none.
        Some(word) if *word != MAGIC && word & MAGIC == MAGIC => Content::Nothing,
        Some(_) => match (Head::read(place), number(place)) {
            (Some(_), Some(number)) => Content::Whole(number),
            (_, number) => Content::Damaged(number.filter(|_| place.first() == Some(&MAGIC))),
        },
    }
}

/// Whether a number is higher than another one. Numbers wrap.
const fn is_higher(one: u32, other: u32) -> bool {
    one.wrapping_sub(other).cast_signed() > 0
}

/// Finds the mission that counts in two places of the same length.
pub fn find(words: &'static [u32]) -> Found {
    let (first, second) = words.split_at(words.len() / 2);
    let places = [first, second];
    let contents = places.map(content);
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
    let next = highest.wrapping_add(1).max(1);
    let Some((place, number)) = newest else {
        return Found {
            stored: if lost.is_some() {
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
    // The mission that should count is damaged: an older one is not driven in its place.
    let replaced = lost.is_some_and(|lost| is_higher(lost, number));
    Found {
        stored: if replaced {
            Stored::Damaged
        } else {
            Stored::read(words)
        },
        number,
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
    let Some(&check) = record.get(CHECK) else {
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
        && flash.write(place, end + 1, sealed(number, check))
        && flash.write(place, 0, head)
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
        }; 3];
        let mission = Legs {
            origin: Position::new(north, 0),
            legs: &legs,
            fence: &[],
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
        assert_eq!((chip.mission(), chip.found().number), (None, 5));
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
        for at in (PLACE..PLACE + record(2).len()).skip(1) {
            chip = whole.clone();
            chip.words[at] ^= 1 << (at % 32);
            assert!(matches!(chip.mission(), Some(-1 | 1)), "word {at}");
            // The check value itself: then nobody knows which number it had.
            let check = PLACE + CHECK;
            assert_eq!(chip.mission() == Some(1), at == check, "word {at}");
            assert!(chip.put(&record(3)));
            assert_eq!(chip.mission(), Some(3));
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
                    (0..=new.len() + 3).flat_map(|left| (1..40).map(move |c| (left, c)))
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
                        left > new.len() || left_behind == was,
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

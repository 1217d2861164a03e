//! The record of a mission in the flash.
//!
//! | word | contents |
//! | --- | --- |
//! | 0 | `FMIS`, which tells a record from an erased or foreign place |
//! | 1 | number of the format, [`FORMAT`]; in bit 16 whether the mission is repeated |
//! | 2 | number of legs in the lower half; then a byte with that of the fence's corners, and one with that of the obstacles' |
//! | 3, 4 | the origin of its frame, north and east of the base station, mm |
//! | 5 | CRC-32 of all other words of the record, in order |
//! | 6.. | the legs, [`LEG`] words each |
//! | behind them | the corners of the fence, north and east, m |
//! | behind them | the corners of the obstacles, likewise; each obstacle ends with its first corner again |
//!
//! A leg: north, east (m) and heading (rad) of the rear axle at its beginning, curvature (1/m), sharpness (1/m^2) and
//! length (m), all in single precision; then speed (mm/s) in the lower half of a word, sections of the implement in the
//! next byte, and in the last one bit 0 for reverse and bit 1 for a headland turn behind the leg. All words are
//! little-endian.

use control::dubins::Pose;
use control::fence::{CORNERS, Corners as _, OBSTACLE_CORNERS, Point};
use control::mission::{End, Join, LEGS, Leg, Mission};
use control::position::Position;
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

pub(super) const MAGIC: u32 = u32::from_le_bytes(*b"FMIS");

/// The number of the format.
pub const FORMAT: u16 = 2;

/// Words before the legs, and of a leg.
pub(super) const HEAD: usize = 6;
const LEG: usize = 7;

/// The word of the CRC.
pub(super) const CHECK: usize = 5;

pub(super) const CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

const REPEAT: u32 = 1 << 16;
const REVERSE: u32 = 1 << 24;
const TURN: u32 = 1 << 25;

/// What lies in the place of a mission.
#[derive(Clone, Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "one value, at the start; a target has no heap"
)]
pub enum Stored {
    /// Nothing: the place is erased, or its mission was dropped.
    None,
    /// Something else than a whole record of this format.
    Damaged,
    /// A mission.
    Mission(Kept),
}

/// A mission in the flash.
#[derive(Clone, Debug)]
pub struct Kept {
    head: Head,
    words: &'static [u32],
}

/// What a record says besides its legs.
#[derive(Clone, Debug)]
pub struct Head {
    origin: Position,
    end: End,
    legs: usize,
    /// Corners of the fence and of the obstacles.
    fence: usize,
    obstacles: usize,
}

/// Corners as they stand in a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corners<'a>(&'a [[u32; 2]]);

impl control::fence::Corners<f32> for Corners<'_> {
    fn count(self) -> usize {
        self.0.len()
    }

    fn corner(self, number: usize) -> Option<Point<f32>> {
        let &[north, east] = self.0.get(number)?;
        Some(Point {
            north: f32::from_bits(north),
            east: f32::from_bits(east),
        })
    }
}

/// A mission in words that somebody holds.
#[derive(Clone, Copy, Debug)]
pub struct Recorded<'a> {
    head: &'a Head,
    legs: &'a [[u32; LEG]],
    fence: Corners<'a>,
    obstacles: Corners<'a>,
}

impl Stored {
    /// Reads the words at the beginning of the place.
    pub fn read(words: &'static [u32]) -> Self {
        if words
            .first_chunk::<HEAD>()
            .is_none_or(|head| head.iter().all(|word| *word == u32::MAX))
        {
            return Self::None;
        }
        match Head::read(words) {
            Some(head) if head.legs == 0 => Self::None,
            Some(head) => Self::Mission(Kept { head, words }),
            None => Self::Damaged,
        }
    }
}

impl Kept {
    /// The mission.
    pub fn mission(&self) -> Recorded<'_> {
        self.head.of(self.words)
    }
}

impl Head {
    /// Reads the record at the beginning of these words; `None` if it is not whole or not of this format. One without
    /// legs stands for a mission that was dropped. The first word may have lost two bits: it is the same in all records.
    pub fn read(words: &[u32]) -> Option<Self> {
        let head = Self::parse(words)?;
        let covered = words.get(..head.length())?.iter().enumerate().skip(1);
        let covered = covered.filter(|(at, _)| *at != CHECK);
        let covered = covered.map(|(_, word)| *word);
        let sum = checked(core::iter::once(MAGIC).chain(covered));
        (words.get(CHECK) == Some(&sum)).then_some(head)
    }

    /// The same without the check value, which a [`Verification`] compares.
    pub fn parse(words: &[u32]) -> Option<Self> {
        let (head, rest) = words.split_first_chunk::<HEAD>()?;
        let [magic, format, counts, north, east, _] = *head;
        let repeat = format & REPEAT != 0;
        if (magic ^ MAGIC).count_ones() > 2 || format & !REPEAT != u32::from(FORMAT) {
            return None;
        }
        let legs = counts as u16 as usize;
        let [.., fence, obstacles] = counts.to_le_bytes().map(usize::from);
        if legs > LEGS || fence > CORNERS || obstacles > OBSTACLE_CORNERS {
            return None;
        }
        let length = legs * LEG + (fence + obstacles) * 2;
        (rest.len() >= length).then_some(Self {
            origin: Position::new(north.cast_signed(), east.cast_signed()),
            end: if repeat { End::Repeat } else { End::Stop },
            legs,
            fence,
            obstacles,
        })
    }

    /// Number of legs.
    pub const fn legs(&self) -> usize {
        self.legs
    }

    /// Words of the record.
    pub fn length(&self) -> usize {
        HEAD + self.legs * LEG + (self.fence + self.obstacles) * 2
    }

    /// The mission with this head, in the words that it was read from.
    pub fn of<'a>(&'a self, words: &'a [u32]) -> Recorded<'a> {
        let rest = words.get(HEAD..).unwrap_or_default();
        let (legs, corners) = rest
            .split_at_checked(self.legs * LEG)
            .unwrap_or((rest, &[]));
        let (legs, _) = legs.as_chunks();
        let (corners, _) = corners.as_chunks();
        let (fence, rest) = corners
            .split_at_checked(self.fence)
            .unwrap_or((corners, &[]));
        Recorded {
            head: self,
            legs: legs.get(..self.legs).unwrap_or_default(),
            fence: Corners(fence),
            obstacles: Corners(rest.get(..self.obstacles).unwrap_or_default()),
        }
    }
}

impl<'w> Mission<f32> for Recorded<'w> {
    type Corners<'a>
        = Corners<'w>
    where
        Self: 'a;

    fn origin(&self) -> Position {
        self.head.origin
    }

    fn count(&self) -> usize {
        self.legs.len()
    }

    fn leg(&self, number: usize) -> Option<Leg<f32>> {
        let &[north, east, heading, curvature, sharpness, length, rest] = self.legs.get(number)?;
        Some(Leg {
            start: Pose {
                north: f32::from_bits(north),
                east: f32::from_bits(east),
                heading: f32::from_bits(heading),
            },
            curvature: f32::from_bits(curvature),
            sharpness: f32::from_bits(sharpness),
            length: f32::from_bits(length),
            speed: f32::from(rest as u16) * 1e-3,
            reverse: rest & REVERSE != 0,
            outputs: (rest >> 16) as u8,
            join: if rest & TURN != 0 {
                Join::Turn
            } else {
                Join::Continue
            },
        })
    }

    fn fence(&self) -> Corners<'w> {
        self.fence
    }

    fn obstacles(&self) -> Corners<'w> {
        self.obstacles
    }

    fn end(&self) -> End {
        self.head.end
    }
}

/// Compares the check value of a record, in short steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verification {
    at: usize,
    sum: u32,
}

impl Verification {
    /// Words of a step.
    const STEP: usize = 128;

    /// The next step for a record of these words. Returns whether it is whole, with the last one.
    pub fn step(&mut self, record: &[u32]) -> Option<bool> {
        // Where the last step ended: CRC-32 is reflected, and its result inverted.
        let mut digest = CRC.digest_with_initial((self.sum ^ u32::MAX).reverse_bits());
        let begin = record.get(self.at..).unwrap_or_default();
        // loop-bound: 128. STEP.
        for (at, word) in (self.at..).zip(begin.iter().take(Self::STEP)) {
            if at != CHECK {
                digest.update(&word.to_le_bytes());
            }
        }
        self.sum = digest.finalize();
        self.at += Self::STEP;
        (self.at >= record.len()).then(|| record.get(CHECK) == Some(&self.sum))
    }
}

/// The record of a mission that was dropped.
pub fn dropped() -> [u32; HEAD] {
    let mut head = [MAGIC, u32::from(FORMAT), 0, 0, 0, 0];
    head[CHECK] = checked(head.into_iter().take(CHECK));
    head
}

fn checked(words: impl Iterator<Item = u32>) -> u32 {
    let mut digest = CRC.digest();
    // loop-bound: 28933. The longest record: 4096 legs of seven words and twice 64 corners.
    for word in words {
        digest.update(&word.to_le_bytes());
    }
    digest.finalize()
}

fn leg(leg: &Leg<f32>) -> [u32; LEG] {
    let Leg { start, .. } = leg;
    // Rounded, and a speed that does not fit is the largest one.
    let speed = (leg.speed * 1e3 + 0.5) as u16;
    let flag = |set: bool, bit: u32| if set { bit } else { 0 };
    [
        start.north.to_bits(),
        start.east.to_bits(),
        start.heading.to_bits(),
        leg.curvature.to_bits(),
        leg.sharpness.to_bits(),
        leg.length.to_bits(),
        u32::from(speed)
            | u32::from(leg.outputs) << 16
            | flag(leg.reverse, REVERSE)
            | flag(leg.join == Join::Turn, TURN),
    ]
}

/// The record of a mission, word by word; `None` if it has no leg, or more legs or corners than a record may have.
pub fn words<M: Mission<f32>>(mission: &M) -> Option<impl Iterator<Item = u32>> {
    let legs = mission.count();
    let (fence, obstacles) = (mission.fence(), mission.obstacles());
    let (edges, outlines) = (fence.count(), obstacles.count());
    if legs == 0 || legs > LEGS || edges > CORNERS || outlines > OBSTACLE_CORNERS {
        return None;
    }
    let origin = mission.origin();
    let repeat = if mission.end() == End::Repeat {
        REPEAT
    } else {
        0
    };
    let head = [
        MAGIC,
        u32::from(FORMAT) | repeat,
        legs as u32 | (edges as u32) << 16 | (outlines as u32) << 24,
        origin.north.cast_unsigned(),
        origin.east.cast_unsigned(),
    ];
    let body = move || {
        let all = (0..legs).filter_map(|number| mission.leg(number));
        let fence = (0..edges).filter_map(move |number| fence.corner(number));
        let obstacles = (0..outlines).filter_map(move |number| obstacles.corner(number));
        let corners = fence.chain(obstacles);
        let corners = corners.flat_map(|at| [at.north.to_bits(), at.east.to_bits()]);
        all.flat_map(|one| leg(&one)).chain(corners)
    };
    let check = checked(head.into_iter().chain(body()));
    Some(head.into_iter().chain([check]).chain(body()))
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::boxed::Box;
    use std::vec::Vec;

    use control::mission::Legs;
    use proptest::prelude::*;

    use super::*;

    fn all<C: control::fence::Corners<f32>>(corners: C) -> impl Iterator<Item = Point<f32>> {
        (0..).map_while(move |number| corners.corner(number))
    }

    fn read(words: Vec<u32>) -> Stored {
        Stored::read(Box::leak(words.into_boxed_slice()))
    }

    fn legs() -> impl Strategy<Value = Vec<Leg<f32>>> {
        let numbers = prop::array::uniform6(-4000.0..4000.0_f32);
        let leg = (numbers, 0..60_000_u16, any::<(bool, u8, bool)>());
        let leg = leg.prop_map(|(numbers, speed, (reverse, outputs, turn))| {
            let [north, east, heading, curvature, sharpness, length] = numbers;
            Leg {
                start: Pose {
                    north,
                    east,
                    heading,
                },
                curvature,
                sharpness,
                length,
                speed: f32::from(speed) * 1e-3,
                reverse,
                outputs,
                join: if turn { Join::Turn } else { Join::Continue },
            }
        });
        prop::collection::vec(leg, 1..20)
    }

    fn corners() -> impl Strategy<Value = Vec<Point<f32>>> {
        let corner = (-4000.0..4000.0_f32, -4000.0..4000.0_f32);
        let corner = corner.prop_map(|(north, east)| Point { north, east });
        prop::collection::vec(corner, 0..=CORNERS)
    }

    #[test]
    fn an_erased_place_has_no_mission() {
        assert!(matches!(read(std::vec![u32::MAX; 64]), Stored::None));
        assert!(matches!(read(Vec::new()), Stored::None));
        assert!(matches!(read(std::vec![0; 64]), Stored::Damaged));
    }

    #[test]
    fn a_record_has_a_leg() {
        let none = Legs {
            origin: Position::new(0, 0),
            legs: &[],
            fence: &[],
            obstacles: &[],
            end: End::Stop,
        };
        assert!(words(&none).is_none());
    }

    #[test]
    fn a_dropped_mission_is_none() {
        let mut record = dropped().to_vec();
        assert!(Head::read(&record).is_some_and(|head| head.legs() == 0));
        assert!(matches!(read(record.clone()), Stored::None));
        record[3] ^= 1;
        assert!(matches!(read(record), Stored::Damaged));
    }

    proptest! {
        #[test]
        fn a_record_is_read_back(
            legs in legs(), fence in corners(), obstacles in corners(), north: i32, east: i32, repeat: bool, beyond in 0..9_usize
        ) {
            let written = Legs {
                origin: Position::new(north, east),
                legs: &legs,
                fence: &fence,
                obstacles: &obstacles,
                end: if repeat { End::Repeat } else { End::Stop },
            };
            let mut record: Vec<u32> = words(&written).unwrap().collect();
            // The rest of the place is erased.
            record.resize(record.len() + beyond, u32::MAX);
            let Stored::Mission(found) = read(record) else {
                panic!("no mission");
            };
            prop_assert_eq!(found.head.length() + beyond, found.words.len());
            let whole = &found.words[..found.head.length()];
            let mut verification = Verification::default();
            let verified = core::iter::repeat_with(|| verification.step(whole)).find_map(|told| told);
            prop_assert_eq!(verified, Some(true));
            let found = found.mission();
            prop_assert_eq!((found.origin(), found.end()), (written.origin, written.end));
            prop_assert!(all(found.fence()).eq(all(written.fence)));
            prop_assert!(all(found.obstacles()).eq(all(written.obstacles)));
            prop_assert_eq!(found.count(), legs.len());
            for (number, leg) in legs.iter().enumerate() {
                prop_assert_eq!(found.leg(number), Some(*leg));
            }
            prop_assert_eq!(found.leg(legs.len()), None);
        }

        #[test]
        fn a_damaged_record_is_no_mission(
            legs in legs(), fence in corners(), word: prop::sample::Index, change in 1..=u32::MAX,
            cut: Option<prop::sample::Index>
        ) {
            let written = Legs { origin: Position::new(1, 2), legs: &legs, fence: &fence, obstacles: &fence, end: End::Stop };
            let mut record: Vec<u32> = words(&written).unwrap().collect();
            match cut {
                Some(cut) => {
                    let cut = cut.index(record.len());
                    record[cut..].fill(u32::MAX);
                    prop_assume!(cut > 0);
                }
                None => {
                    let word = word.index(record.len());
                    record[word] ^= change;
                }
            }
            prop_assert!(matches!(read(record), Stored::Damaged));
        }

        #[test]
        fn any_words_are_read(words in prop::collection::vec(any::<u32>(), 0..60)) {
            prop_assert!(!matches!(read(words), Stored::Mission(_)));
        }
    }
}

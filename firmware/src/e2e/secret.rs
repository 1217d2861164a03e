//! The key of a network, and its record in the flash.
//!
//! | word | contents |
//! | --- | --- |
//! | 0 | `FKEY`, which tells a record from an erased or foreign one |
//! | 1..=4 | the key, 16 bytes, least significant first |
//! | 5 | the key's [number](Key::number), which also finds a damaged record |
//!
//! All words are little-endian.

use core::fmt;
use siphasher::sip::SipHasher24;

/// Words of the record.
pub const RECORD: usize = sled_common::secret::WORDS;

const MAGIC: u32 = u32::from_le_bytes(*b"FKEY");

/// What the number of a key is computed from.
const NAME: u64 = u64::from_le_bytes(*b"key name");
/// No message has this identifier, so no tag is the number.
const NO_ID: u16 = u16::MAX;
/// Nor these, for the halves of a session's key.
const HALVES: [u16; 2] = [0xFFFD, 0xFFFC];

/// The secret of a network, 128 bits. Its text shows only its [number](Key::number).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key {
    low: u64,
    high: u64,
}

impl Key {
    /// The key of these bytes, least significant first, as the publication of SipHash has them.
    pub const fn new(bytes: [u8; 16]) -> Self {
        let both = u128::from_le_bytes(bytes);
        Self {
            low: both as u64,
            high: (both >> 64) as u64,
        }
    }

    /// A number that tells keys apart, and does not tell the key. Consoles and logs show it.
    pub fn number(&self) -> u32 {
        self.code(NAME, 0, NO_ID) as u32
    }

    /// The message authentication code of these 14 bytes.
    // Not inlined: once in an image is enough.
    #[inline(never)]
    pub(super) fn code(&self, data: u64, time: u32, id: u16) -> u64 {
        let text = u128::from(data) | u128::from(time) << 64 | u128::from(id) << 96;
        let [text @ .., _, _] = text.to_le_bytes();
        SipHasher24::new_with_keys(self.low, self.high).hash(&text)
    }

    /// The key that follows from this one and a node's start; see [`super::Session`].
    pub(super) fn of_start(&self, place: u32, start: u32) -> Self {
        let [low, high] = HALVES.map(|half| self.code(u64::from(start), place, half));
        Self { low, high }
    }

    /// The record of the key.
    pub fn record(&self) -> [u32; RECORD] {
        let half = |word: u64| [word as u32, (word >> 32) as u32];
        let [a, b] = half(self.low);
        let [c, d] = half(self.high);
        [MAGIC, a, b, c, d, self.number()]
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

/// What a node finds in the place of its key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Secret {
    /// The place is erased: the network has no key.
    #[default]
    None,
    /// The key of the network.
    Key(Key),
    /// Something else. A node that had a key must not go on without one, so it obeys no command.
    Damaged,
}

impl Secret {
    /// Reads a record.
    pub fn read(record: &[u32; RECORD]) -> Self {
        let [magic, a, b, c, d, number] = *record;
        if record.iter().all(|word| *word == u32::MAX) {
            return Self::None;
        }
        let join = |low: u32, high: u32| u64::from(low) | u64::from(high) << 32;
        let key = Key {
            low: join(a, b),
            high: join(c, d),
        };
        if magic == MAGIC && number == key.number() {
            Self::Key(key)
        } else {
            Self::Damaged
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{Key, RECORD, Secret};
    use proptest::prelude::*;

    #[test]
    fn an_erased_place_is_no_key() {
        assert_eq!(Secret::read(&[u32::MAX; RECORD]), Secret::None);
        assert_eq!(Secret::read(&[0; RECORD]), Secret::Damaged);
    }

    #[test]
    fn a_key_shows_nothing_of_itself() {
        assert_eq!(std::format!("{:?}", Key::new([0x5A; 16])), "Key(..)");
    }

    proptest! {
        #[test]
        fn a_record_is_read_back(bytes: [u8; 16]) {
            let key = Key::new(bytes);
            prop_assert_eq!(Secret::read(&key.record()), Secret::Key(key));
        }

        /// A record of which some words were not written, or of which bits have changed.
        #[test]
        fn a_damaged_record_is_no_missing_key(
            bytes: [u8; 16], word in 0..RECORD, change in 1..=u32::MAX, written in 1..RECORD
        ) {
            let mut record = Key::new(bytes).record();
            record[word] ^= change;
            prop_assert_eq!(Secret::read(&record), Secret::Damaged);
            let mut record = Key::new(bytes).record();
            record[written..].fill(u32::MAX);
            prop_assert_eq!(Secret::read(&record), Secret::Damaged);
        }
    }
}

//! The tags of protected messages against another implementation of SipHash-2-4.
//!
//! `siphash24/vectors.py` wrote them, with a package of PyPI.

use core::hash::Hasher;

use firmware::e2e::{Key, tag};
use siphasher::sip::SipHasher24;

fn bytes<const N: usize>(hex: &str) -> [u8; N] {
    let digits = |at: usize| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16);
    core::array::from_fn(|at| digits(at).expect("hexadecimal digits"))
}

#[test]
fn the_tags_are_those_of_another_implementation() {
    let mut seen = 0;
    for line in include_str!("data/tags.txt").lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let [key, id, time, data, mask, expected] = words[..] else {
            panic!("six words: {line}");
        };
        let data = u64::from_le_bytes(bytes(data));
        let number = |word: &str| word.parse::<u64>().expect("a number");
        let found = tag(
            &Key::new(bytes(key)),
            number(id) as u16,
            number(time) as u32,
            data,
            number(mask),
        );
        assert_eq!(found, number(expected), "{line}");
        seen += 1;
    }
    assert_eq!(seen, 200);
}

/// Aumasson and Bernstein, SipHash: a fast short-input PRF, 2012, appendix A.
#[test]
fn the_hash_is_that_of_the_publication() {
    let key: [u8; 16] = core::array::from_fn(|at| at as u8);
    let mut hasher = SipHasher24::new_with_key(&key);
    let text: [u8; 15] = core::array::from_fn(|at| at as u8);
    hasher.write(&text);
    assert_eq!(hasher.finish(), 0xA129_CA61_49BE_45E5);
}

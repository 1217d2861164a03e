//! The tags of protected messages against another implementation of SipHash-2-4.
//!
//! `siphash24/vectors.py` wrote them, with a package of PyPI.

use core::hash::Hasher;

use firmware::e2e::{Key, Secret, Session, TimeProof, tag};
use siphasher::sip::SipHasher24;
use ttcan::{Frame, Id, Micros};

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

#[test]
fn the_tags_of_references_are_those_of_another_implementation() {
    let mut seen = 0;
    for line in include_str!("data/references.txt").lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let [key, id, data, expected] = words[..] else {
            panic!("four words: {line}");
        };
        let id = Id::standard(id.parse().expect("a number")).expect("an identifier");
        let length = data.len() / 2;
        let mut bytes: [u8; 8] = self::bytes(&format!("{data:0<16}"));
        bytes[length..].fill(0);
        let frame = Frame::new(id, &bytes[..length]).expect("a frame");
        let secret = Secret::Key(Key::new(self::bytes(key)));
        let mut proof = TimeProof::new(secret, 0xFF, Micros::millis(100));
        proof.begin(&frame, 100);
        proof.close(proof.open().expect("a tag is needed").answer());
        assert_eq!(proof.bits().to_string(), expected, "{line}");
        seen += 1;
    }
    assert_eq!(seen, 100);
}

#[test]
fn the_keys_of_sessions_are_those_of_another_implementation() {
    let mut seen = 0;
    for line in include_str!("data/sessions.txt").lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let [network, first, second, key] = words[..] else {
            panic!("four words: {line}");
        };
        let mut session = Session::<2>::new(Secret::Key(Key::new(bytes(network))));
        for (place, start) in [first, second].into_iter().enumerate() {
            session.hear(place, start.parse().expect("a number"));
        }
        assert_eq!(
            session.secret(),
            Some(Secret::Key(Key::new(bytes(key)))),
            "{line}"
        );
        seen += 1;
    }
    assert_eq!(seen, 100);
}

//! Frame lengths compared with known lengths and with a bit-by-bit construction.

use proptest::prelude::*;
use ttcan::{Frame, INTERFRAME_BITS, Id, frame_bits, shortest_bits, worst_case_bits};

/// The bits of a frame from the start of frame to the end of the CRC, without stuff
/// bits, as ISO 11898-1 defines them.
fn raw_bits(frame: &Frame) -> Vec<bool> {
    let mut bits = vec![false];
    let mut push = |value: u32, count: u32| {
        for bit in (0..count).rev() {
            bits.push(value >> bit & 1 == 1);
        }
    };
    let id = frame.id().raw();
    if frame.id().is_extended() {
        push(id >> 18, 11);
        push(0b11, 2);
        push(id & 0x3FFFF, 18);
        push(0, 3);
    } else {
        push(id, 11);
        push(0, 3);
    }
    push(u32::from(frame.len()), 4);
    for byte in frame.data() {
        push(u32::from(*byte), 8);
    }
    let mut crc = 0u32;
    for &bit in &bits {
        let feedback = bit != (crc & 0x4000 != 0);
        crc = crc << 1 & 0x7FFF;
        if feedback {
            crc ^= 0x4599;
        }
    }
    for bit in (0..15).rev() {
        bits.push(crc >> bit & 1 == 1);
    }
    bits
}

fn stuff_bits(bits: &[bool]) -> u32 {
    let mut stuffed = 0;
    let mut run = 0;
    let mut last = true;
    for &bit in bits {
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        if run == 5 {
            stuffed += 1;
            last = !bit;
            run = 1;
        }
    }
    stuffed
}

fn any_id() -> impl Strategy<Value = Id> {
    prop_oneof![
        (0u16..=Id::MAX_STANDARD).prop_map(|raw| Id::standard(raw).unwrap()),
        (0u32..=Id::MAX_EXTENDED).prop_map(|raw| Id::extended(raw).unwrap()),
    ]
}

/// Bytes with long runs of equal bits, which random bytes rarely have.
fn any_data() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![Just(0), Just(0xFF), Just(0x0F), Just(0xF0), any::<u8>()];
    prop::collection::vec(byte, 0..=8)
}

proptest! {
    #[test]
    fn exact_length_is_that_of_the_bits(id in any_id(), data in any_data()) {
        let frame = Frame::new(id, &data).unwrap();
        let bits = raw_bits(&frame);
        let expected = bits.len() as u32 + stuff_bits(&bits) + 10;
        prop_assert_eq!(frame_bits(&frame), expected);
        prop_assert!(expected >= shortest_bits(id, frame.len()));
        prop_assert!(expected <= worst_case_bits(id, frame.len()));
    }
}

/// Davis et al. 2007: 55 + 10 n and 80 + 10 n with the interframe space.
#[test]
fn worst_cases_are_the_published_ones() {
    for len in 0..=8u8 {
        let standard = worst_case_bits(Id::constant::<0>(), len) + INTERFRAME_BITS;
        let extended = worst_case_bits(Id::extended(0).unwrap(), len) + INTERFRAME_BITS;
        assert_eq!(standard, 55 + 10 * u32::from(len));
        assert_eq!(extended, 80 + 10 * u32::from(len));
    }
}

/// The function can be called in constants.
#[test]
fn lengths_count_in_constants() {
    const FRAME: Frame = Frame::from_parts(Id::constant::<0>(), 8, [0; 8]);
    const BITS: u32 = frame_bits(&FRAME);
    assert_eq!(
        BITS,
        shortest_bits(FRAME.id(), 8) + stuff_bits(&raw_bits(&FRAME))
    );
}

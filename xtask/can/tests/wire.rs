//! Frames on the wire: known answers, and an independent encoder to compare with.

use can_bus::Frame;
use can_bus::wire::{Decoder, Field, Level, WireFrame, crc15};
use embedded_can::{ExtendedId, Id, StandardId};
use proptest::prelude::*;

/// The bits from start of frame to the last CRC bit, without stuff bits, as a text of zeros and
/// ones. It is built by string formatting instead of shifting.
fn plain_text(frame: &Frame) -> String {
    let rtr = u8::from(frame.is_remote());
    let mut text = match frame.id() {
        Id::Standard(id) => format!("0{:011b}{rtr}00", id.as_raw()),
        Id::Extended(id) => {
            let id = format!("{:029b}", id.as_raw());
            format!("0{}11{}{rtr}00", &id[..11], &id[11..])
        }
    };
    text += &format!("{:04b}", frame.dlc());
    for byte in frame.data() {
        text += &format!("{byte:08b}");
    }
    let crc = remainder(&text);
    text + &crc
}

/// CRC by long division of the polynomial x^15+x^14+x^10+x^8+x^7+x^4+x^3+1 over the text.
fn remainder(text: &str) -> String {
    const DIVISOR: &[u8] = b"1100010110011001";
    let mut dividend: Vec<u8> = text.bytes().chain(*b"000000000000000").collect();
    for at in 0..text.len() {
        if dividend[at] == b'1' {
            for (bit, divisor) in dividend[at..].iter_mut().zip(DIVISOR) {
                *bit = if *bit == *divisor { b'0' } else { b'1' };
            }
        }
    }
    String::from_utf8(dividend[text.len()..].to_vec()).expect("digits")
}

/// Bit stuffing by text replacement from the left.
fn stuffed_text(plain: &str) -> String {
    let mut out = String::new();
    for bit in plain.chars() {
        out.push(bit);
        if out.ends_with("00000") {
            out.push('1');
        } else if out.ends_with("11111") {
            out.push('0');
        }
    }
    out
}

fn text(levels: &[Level]) -> String {
    levels
        .iter()
        .map(|level| if level.is_recessive() { '1' } else { '0' })
        .collect()
}

fn any_id() -> impl Strategy<Value = Id> {
    prop_oneof![
        (0..=0x7FF_u16).prop_map(|raw| StandardId::new(raw).map(Id::Standard).expect("in range")),
        (0..=0x1FFF_FFFF_u32)
            .prop_map(|raw| ExtendedId::new(raw).map(Id::Extended).expect("in range")),
    ]
}

/// Bytes with many long runs of equal bits, which need the most stuff bits.
fn any_byte() -> impl Strategy<Value = u8> {
    prop_oneof![
        any::<u8>(),
        prop::sample::select(vec![0, 0xFF, 0x0F, 0xF0, 0x1F, 0xE0, 0x3C, 0x78, 0x83]),
    ]
}

fn any_frame() -> impl Strategy<Value = Frame> {
    let data = (any_id(), prop::collection::vec(any_byte(), 0..=8))
        .prop_map(|(id, data)| Frame::new_data(id, &data).expect("at most eight bytes"));
    let remote =
        (any_id(), 0..=15_u8).prop_map(|(id, dlc)| Frame::new_remote(id, dlc).expect("in range"));
    let long = (any_id(), 9..=15_u8, prop::collection::vec(any_byte(), 8))
        .prop_map(|(id, dlc, data)| Frame::from_parts(id, false, dlc, &data).expect("eight bytes"));
    prop_oneof![6 => data, 1 => remote, 1 => long]
}

proptest! {
    #[test]
    fn encoding_equals_the_naive_one(frame in any_frame()) {
        let wire = WireFrame::encode(&frame);
        let expected = stuffed_text(&plain_text(&frame)) + "1111111111";
        prop_assert_eq!(text(wire.levels()), expected);
        prop_assert_eq!(
            wire.bits() - wire.stuff_bits(),
            plain_text(&frame).len() + 10
        );
    }

    #[test]
    fn decoding_undoes_encoding(frame in any_frame()) {
        let wire = WireFrame::encode(&frame);
        let mut decoder = Decoder::new();
        for (index, level) in wire.levels().iter().enumerate() {
            let field = decoder.next_field();
            prop_assert_eq!(
                field == Field::AcknowledgeSlot,
                index == wire.acknowledge_slot()
            );
            prop_assert!(decoder.push(*level).is_ok());
        }
        prop_assert_eq!(decoder.next_field(), Field::Done);
        prop_assert!(decoder.crc_matches());
        prop_assert_eq!(decoder.frame(), Some(frame));
    }

    #[test]
    fn lengths_stay_within_the_published_bounds(frame in any_frame()) {
        let bytes = frame.data().len();
        // Davis et al. 2007, with 3 bits of interframe space.
        let (least, most) = match frame.id() {
            Id::Standard(_) => (47 + 8 * bytes, 55 + 10 * bytes),
            Id::Extended(_) => (67 + 8 * bytes, 80 + 10 * bytes),
        };
        let bits = WireFrame::encode(&frame).bits() + 3;
        prop_assert!((least..=most).contains(&bits), "{} bits", bits);
    }

    #[test]
    fn one_flipped_body_bit_is_always_noticed(frame in any_frame(), at in any::<prop::sample::Index>()) {
        let wire = WireFrame::encode(&frame);
        let at = at.index(wire.acknowledge_slot() - 1);
        let mut decoder = Decoder::new();
        let mut noticed = false;
        for (index, level) in wire.levels().iter().enumerate() {
            let level = if index == at { level.inverted() } else { *level };
            noticed |= decoder.push(level).is_err();
            // The checks that a receiver makes in the fixed-form fields.
            noticed |= decoder.next_field() == Field::Done && index + 1 < wire.bits();
        }
        noticed |= !decoder.crc_matches() || decoder.frame() != Some(frame);
        prop_assert!(noticed);
    }
}

#[test]
fn worst_case_lengths_are_reached() {
    // Davis et al. 2007: 135 bits for an 11-bit identifier and eight bytes. The identifier and data
    // are chosen to need nearly every possible stuff bit; the CRC decides the rest.
    let longest = (0..=0x7FF_u16)
        .flat_map(|id| {
            [
                [0x00_u8; 8],
                [0x83, 0xC1, 0xE0, 0xF0, 0x78, 0x3C, 0x1E, 0x0F],
            ]
            .into_iter()
            .map(move |data| (id, data))
        })
        .filter_map(|(id, data)| Frame::standard(id, &data))
        .map(|frame| WireFrame::encode(&frame).bits() + 3)
        .max();
    assert!(
        longest.is_some_and(|bits| (128..=135).contains(&bits)),
        "{longest:?}"
    );
}

#[test]
fn crc_check_value_of_the_catalogue() {
    // CRC-15/CAN over "123456789" is 0x059E (Cook, Catalogue of parametrised CRC algorithms).
    let levels: Vec<Level> = b"123456789"
        .iter()
        .flat_map(|byte| {
            (0..8)
                .rev()
                .map(move |bit| Level::from_bit(byte >> bit & 1 == 1))
        })
        .collect();
    assert_eq!(crc15(&levels), 0x059E);
}

#[test]
fn a_frame_of_zeros_bit_by_bit() {
    // Identifier 0 without data: 19 dominant bits and a CRC of 15 more. A recessive stuff bit
    // follows each five of them, and ten recessive bits end the frame.
    let frame = Frame::standard(0, &[]).expect("valid");
    let wire = WireFrame::encode(&frame);
    assert_eq!(
        text(wire.levels()),
        "000001000001000001000001000001000001".to_owned() + "0000" + "1111111111"
    );
    assert_eq!((wire.bits(), wire.stuff_bits()), (50, 6));
}

#[test]
fn a_stuff_bit_follows_the_last_crc_bit_if_it_completes_a_run() {
    // ISO 11898-1, clause 10.5: bit stuffing covers the whole CRC sequence.
    let frame = (0..=0x7FF)
        .filter_map(|id| Frame::standard(id, &[]))
        .find(|frame| {
            let stuffed = stuffed_text(&plain_text(frame));
            stuffed.ends_with("000001") || stuffed.ends_with("111110")
        })
        .expect("such an identifier exists");
    let wire = WireFrame::encode(&frame);
    assert_eq!(
        text(wire.levels()),
        stuffed_text(&plain_text(&frame)) + "1111111111"
    );
}

//! How long a frame occupies the bus.
//!
//! Lengths are in bit times. [`frame_bits`] counts from the start of frame to the
//! last bit of the end of frame, stuff bits included. The interframe space
//! ([`INTERFRAME_BITS`]) is not included. [`frame_bits`] does one table look-up for
//! every four bits of the frame.

use crate::frame::Frame;
use crate::id::Id;

/// Bits of the interframe space that separate two frames (ISO 11898-1,
/// intermission).
pub const INTERFRAME_BITS: u32 = 3;

/// CRC delimiter, acknowledge slot and delimiter, end of frame: never stuffed.
const TAIL_BITS: u32 = 10;
const CRC_BITS: u32 = 15;
/// ISO 11898-1: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CRC_POLYNOMIAL: u16 = 0x4599;
const STANDARD_HEADER_BITS: u32 = 19;
const EXTENDED_HEADER_BITS: u32 = 39;

/// Bits of a frame with `len` data bytes (at most 8) that could be followed by
/// a stuff bit.
const fn stuffable_bits(extended: bool, len: u8) -> u32 {
    let header = if extended {
        EXTENDED_HEADER_BITS
    } else {
        STANDARD_HEADER_BITS
    };
    let len = if len > 8 { 8 } else { len };
    header + 8 * len as u32 + CRC_BITS
}

/// Length of a frame without any stuff bit.
pub const fn shortest_bits(id: Id, len: u8) -> u32 {
    stuffable_bits(id.is_extended(), len) + TAIL_BITS
}

/// Length of the longest frame of this format and `len` data bytes, with every
/// possible stuff bit (Davis et al. 2007, equation 1, less the interframe
/// space): 52 + 10 len for base frames and 77 + 10 len for extended ones.
///
/// ```
/// let id = ttcan::Id::constant::<0>();
/// assert_eq!(ttcan::worst_case_bits(id, 8) + ttcan::INTERFRAME_BITS, 135);
/// ```
pub const fn worst_case_bits(id: Id, len: u8) -> u32 {
    let stuffable = stuffable_bits(id.is_extended(), len);
    stuffable + (stuffable - 1) / 4 + TAIL_BITS
}

/// CRC-15 of one nibble, indexed by the four leading bits of the register, with a 0 behind it.
const CRC: [u16; 16] = {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut crc = (nibble as u16) << 11;
        let mut bit = 0;
        while bit < 4 {
            crc = if crc & 0x4000 != 0 {
                crc << 1 ^ CRC_POLYNOMIAL
            } else {
                crc << 1
            };
            bit += 1;
        }
        table[nibble] = crc << 1;
        nibble += 1;
    }
    table
};

/// State of bit stuffing: the last bit in bit 2, the length of its run less one in
/// bits 1..0. Two bits are enough, because a stuff bit follows the fifth equal bit
/// and starts a new run.
type Run = u8;
/// Set in a new state if a stuff bit was inserted.
const STUFFED: u8 = 8;
/// Bits of a nibble, below the state in an index of [`STUFF`].
const NIBBLE: u32 = 4;

const fn stuff_bit(run: Run, bit: u8) -> u8 {
    if run >> 2 != bit {
        bit << 2
    } else if run & 3 == 3 {
        (1 - bit) << 2 | STUFFED
    } else {
        run + 1
    }
}

/// New state after four bits, with [`STUFFED`] if a stuff bit was inserted (at most
/// one is), above [`NIBBLE`] bits of 0. Indexed by state and nibble.
const STUFF: [u8; 128] = {
    let mut table = [0; 128];
    let mut at = 0;
    while at < 128 {
        let mut run = (at >> NIBBLE) as u8;
        let mut stuffed = 0;
        let mut bit = NIBBLE;
        while bit > 0 {
            bit -= 1;
            let next = stuff_bit(run, (at as u8 >> bit) & 1);
            stuffed |= next & STUFFED;
            run = next & 7;
        }
        table[at] = (run | stuffed) << NIBBLE;
        at += 1;
    }
    table
};

/// State before the bit 0 that completes the first nibble in front of a frame. That bit ends a
/// run of five, so that a recessive bit is left as on the idle bus, and a stuff bit that is not of
/// the frame. The CRC of a leading 0 is 0.
const BEFORE: u32 = 3 << NIBBLE;

/// Exact length of a data frame from its start of frame to the last bit of its
/// end of frame, stuff bits included, in bit times.
pub const fn frame_bits(frame: &Frame) -> u32 {
    let id = frame.id();
    let raw = id.raw();
    let len = frame.len();
    // A 0 in front, and the first 19 bits: start of frame, 11 identifier bits, then in base
    // format RTR, IDE, a reserved bit and the data length code, in extended
    // format SRR and IDE, both recessive, and the next 5 identifier bits.
    let (head, rest) = if id.is_extended() {
        let head = (raw >> 18) << 7 | 0b11 << 5 | (raw >> 13 & 0x1F);
        // The last 13 identifier bits, RTR, two reserved bits, the data length
        // code.
        (head, ((raw & 0x1FFF) << 7 | len as u32, 5))
    } else {
        (raw << 7 | len as u32, (0, 0))
    };
    let [a, b, c, d, e, f, g, h] = frame.buffer();
    let nibbles = 2 * len as u32;
    let first = if nibbles < 8 { nibbles } else { 8 };
    // Bits from the highest one on, and how many nibbles they are.
    let parts = [
        (head << 12, 5),
        (rest.0 << 12, rest.1),
        (u32::from_be_bytes([a, b, c, d]), first),
        (u32::from_be_bytes([e, f, g, h]), nibbles - first),
        // Known when all others are done.
        (0, 4),
    ];
    // The CRC is in the upper 15 bits.
    let (mut crc, mut run): (u32, u32) = (0, BEFORE);
    // The stuff bit in front of the frame does not count.
    let mut count = shortest_bits(id, len).wrapping_sub(1);
    let mut part = 0;
    while part < parts.len() {
        let (mut word, mut left) = parts[part];
        part += 1;
        if part == parts.len() {
            // The CRC sequence is stuffed too, and is 15 bits long. A bit that differs from its
            // last one completes the nibble, and ends no run of five.
            word = crc | (!crc >> 1 & 1 << 16);
        }
        // loop-bound: 8
        while left > 0 {
            left -= 1;
            let nibble = word >> 28;
            word <<= 4;
            crc = crc << 4 ^ (CRC[(crc >> 28 ^ nibble) as usize] as u32) << 16;
            let next = STUFF[(run | nibble) as usize & 127] as u32;
            count = count.wrapping_add(next >> 7);
            run = next & 0x70;
        }
    }
    count
}

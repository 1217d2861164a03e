//! How long a frame occupies the bus.
//!
//! Lengths are in bit times. [`frame_bits`] counts from the start of frame to the
//! last bit of the end of frame, stuff bits included. The interframe space
//! ([`INTERFRAME_BITS`]) is not included. [`frame_bits`] does one look-up in each of two tables for
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

/// Goes through the bits of a frame, counts stuff bits and computes the CRC.
#[derive(Clone, Copy)]
struct Line {
    /// The CRC in the leading 15 bits.
    crc: u32,
    /// An entry of [`STUFF`].
    run: u8,
    stuffed: u32,
}

impl Line {
    /// After the four leading bits of `bits`.
    #[inline(always)]
    const fn after_nibble(self, bits: u32) -> Self {
        let crc = CRC[((self.crc ^ bits) >> 28) as usize];
        let line = self.after_stuffing(bits);
        Self {
            crc: self.crc << 4 ^ (crc as u32) << 16,
            ..line
        }
    }

    /// The same without the CRC.
    #[inline(always)]
    const fn after_stuffing(self, bits: u32) -> Self {
        let next = STUFF[((self.run & 0x70) as u32 | bits >> 28) as usize];
        Self {
            run: next,
            stuffed: self.stuffed + (next >> 7) as u32,
            ..self
        }
    }
}

/// Bytes in front of the data in [`frame_bits`]: whole words, so that they are stored as such.
const HEAD: usize = 8;

/// Exact length of a data frame from its start of frame to the last bit of its
/// end of frame, stuff bits included, in bit times.
pub const fn frame_bits(frame: &Frame) -> u32 {
    let id = frame.id();
    let raw = id.raw();
    let len = frame.len();
    // The bits from the start of frame to the data length code, behind zeros that make whole bytes of
    // them: 19 bits of a base frame behind five, in three bytes, and 39 of an extended frame
    // behind one, in five. The CRC of leading zeros is 0. The state before them is such that the
    // last zero is the fifth of a run. Its stuff bit leaves the state of the idle bus, which is
    // recessive, and is not of the frame.
    let (begin, run, high, low) = if id.is_extended() {
        // Start of frame, 11 bits, SRR and IDE, which are recessive, 18 bits, RTR and two reserved
        // bits, the data length code.
        let low = 0b11 << 25 | raw >> 18 << 27 | (raw & 0x3_FFFF) << 7 | len as u32;
        (HEAD - 5, 3 << NIBBLE, raw >> 23, low)
    } else {
        // Start of frame, 11 bits, RTR, IDE and a reserved bit, the data length code.
        (HEAD - 3, 4 << NIBBLE, 0, raw << 7 | len as u32)
    };
    let head = (high as u64) << 32 | low as u64;
    let bytes = [head.to_be_bytes(), frame.buffer()];
    let bytes = bytes.as_flattened();
    let mut line = Line {
        crc: 0,
        run,
        stuffed: 0,
    };
    let end = HEAD + len as usize;
    let mut at = begin;
    // One loop for all parts of a frame, so that the analysis of the images finds its longest run, of 13
    // bytes.
    while at < end && at < HEAD + 8 {
        // Every index of four bits is one of a byte.
        let bits = (bytes[at & 15] as u32) << 24;
        line = line.after_nibble(bits).after_nibble(bits << 4);
        at += 1;
    }
    // The CRC sequence is stuffed, too. A bit behind its 15 makes whole nibbles. It is the opposite of
    // the last one, so that no stuff bit follows it.
    let mut crc = line.crc | (!line.crc & 1 << 17) >> 1;
    let mut nibbles = 0;
    while nibbles < 4 {
        line = line.after_stuffing(crc);
        crc <<= 4;
        nibbles += 1;
    }
    // Less the one of the zeros in front.
    shortest_bits(id, len) + line.stuffed - 1
}

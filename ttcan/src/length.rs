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

/// CRC-15 of one nibble, indexed by the four leading bits of the register.
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
        table[nibble] = crc & 0x7FFF;
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
/// one is). Indexed by state and nibble.
const STUFF: [u8; 128] = {
    let mut table = [0; 128];
    let mut at = 0;
    while at < 128 {
        let mut run = (at >> 4) as u8;
        let mut stuffed = 0;
        let mut bit = 4;
        while bit > 0 {
            bit -= 1;
            let next = stuff_bit(run, (at as u8 >> bit) & 1);
            stuffed |= next & STUFFED;
            run = next & 7;
        }
        table[at] = run | stuffed;
        at += 1;
    }
    table
};

/// Goes through the bits of a frame, counts stuff bits and computes the CRC.
struct Line {
    crc: u16,
    run: Run,
    stuffed: u32,
}

impl Line {
    // Not inlined: unrolled in each loop, it would be most of a small image.
    #[inline(never)]
    const fn nibble(&mut self, nibble: u8) {
        let nibble = nibble & 15;
        self.crc = (self.crc << 4 ^ CRC[((self.crc >> 11) as u8 ^ nibble) as usize & 15]) & 0x7FFF;
        self.stuff(nibble);
    }

    const fn stuff(&mut self, nibble: u8) {
        let next = STUFF[(self.run << 4 | nibble) as usize & 127];
        self.stuffed += (next >> 3) as u32;
        self.run = next & 7;
    }

    /// Goes through the `count` low bits of `bits`. `count` is a multiple of 4.
    const fn bits(&mut self, bits: u32, count: u32) {
        let mut left = count;
        while left >= 4 {
            left -= 4;
            self.nibble((bits >> left) as u8);
        }
    }
}

/// Exact length of a data frame from its start of frame to the last bit of its
/// end of frame, stuff bits included, in bit times.
pub const fn frame_bits(frame: &Frame) -> u32 {
    let mut line = Line {
        crc: 0,
        // The idle bus is recessive. The dominant start of frame begins a run.
        run: 4,
        stuffed: 0,
    };
    let id = frame.id();
    let raw = id.raw();
    let len = frame.len();
    // The first 19 bits: start of frame, 11 identifier bits, then in base
    // format RTR, IDE, a reserved bit and the data length code, in extended
    // format SRR and IDE, both recessive, and the next 5 identifier bits.
    let head = if id.is_extended() {
        (raw >> 18) << 7 | 0b11 << 5 | (raw >> 13 & 0x1F)
    } else {
        raw << 7 | len as u32
    };
    // The three leading bits go first, so that whole nibbles remain. Three bits
    // cannot complete a run of five.
    let mut bit = STANDARD_HEADER_BITS;
    while bit > STANDARD_HEADER_BITS - 3 {
        bit -= 1;
        line.run = stuff_bit(line.run, (head >> bit) as u8 & 1) & 7;
    }
    line.crc = CRC[(head >> bit) as usize & 7];
    line.bits(head, STANDARD_HEADER_BITS - 3);
    if id.is_extended() {
        // The last 13 identifier bits, RTR, two reserved bits, the data length
        // code.
        let rest = (raw & 0x1FFF) << 7 | len as u32;
        line.bits(rest, EXTENDED_HEADER_BITS - STANDARD_HEADER_BITS);
    }
    let data = frame.buffer();
    let mut at = 0;
    while at < len as usize && at < 8 {
        line.bits(data[at] as u32, 8);
        at += 1;
    }
    // The CRC sequence is stuffed too, and is 15 bits long.
    let crc = line.crc;
    line.stuff((crc >> 11) as u8 & 15);
    line.stuff((crc >> 7) as u8 & 15);
    line.stuff((crc >> 3) as u8 & 15);
    let mut bit = 3;
    while bit > 0 {
        bit -= 1;
        let next = stuff_bit(line.run, (crc >> bit) as u8 & 1);
        line.stuffed += (next >> 3) as u32;
        line.run = next & 7;
    }
    shortest_bits(id, len) + line.stuffed
}

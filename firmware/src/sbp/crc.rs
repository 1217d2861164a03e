//! The checksum of SBP frames: CRC-16, polynomial 0x1021, initial value 0, not reflected
//! (CRC-16/XMODEM).
//!
//! A checksum is the remainder of the bytes, taken as a polynomial over GF(2), times x^16,
//! modulo x^16 + x^12 + x^5 + 1. The remainder is linear, so the checksum of any stretch of a
//! stream follows from the checksums of the stream up to its begin and up to its end
//! ([`between`]): multiply the first by x^8 for every byte of the stretch, and subtract it
//! (xor) from the second. The crate `crc` has no such operation; without it, each candidate for
//! a frame would cost a pass over its bytes.

/// Shortest stretch that [`between`] accepts, in bytes: a frame with an empty payload, without
/// preamble and checksum (type, sender and length).
const SHORTEST: usize = 5;
/// A payload of n bytes, 0 to 255, uses the four rows from row 2 n on.
const ROWS: usize = 2 * 255 + 4;

/// Row r has the products of the 16 four-bit polynomials with x^(4 r), shifted further by
/// [`SHORTEST`] bytes. The 16 KiB replace a multiplication, which would double the time to
/// check a candidate.
static SHIFTED: [[u16; 16]; ROWS] = {
    let mut rows = [[0; 16]; ROWS];
    // 1, x, x^2 and x^3, multiplied by x^4 for each row.
    let mut powers = [1, 2, 4, 8];
    let mut row = 0;
    while row < 2 * SHORTEST + ROWS {
        let mut value = 0;
        while value < 16 && row >= 2 * SHORTEST {
            let mut bit = 0;
            while bit < 4 {
                if value >> bit & 1 == 1 {
                    rows[row - 2 * SHORTEST][value] ^= powers[bit];
                }
                bit += 1;
            }
            value += 1;
        }
        let mut bit = 0;
        while bit < 4 {
            powers[bit] = times_x4(powers[bit]);
            bit += 1;
        }
        row += 1;
    }
    rows
};

const fn times_x4(crc: u16) -> u16 {
    let out = crc >> 12;
    crc << 4 ^ out << 12 ^ out << 5 ^ out
}

/// Continues `crc` over one byte.
///
/// Eight bits at once without a table. The byte that is shifted out at the top is fed back at
/// the three terms of the polynomial. Four of its bits would be shifted out a second time; they
/// are added to it beforehand.
#[inline(always)]
pub(super) const fn update(crc: u16, byte: u8) -> u16 {
    let out = crc >> 8 ^ byte as u16;
    let out = out ^ out >> 4;
    crc << 8 ^ out << 12 ^ out << 5 ^ out
}

/// The checksum of `bytes`, continued from `crc` (0 to begin).
pub fn crc16(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| update(crc, byte))
}

/// The checksum of the type, sender, length and `payload` bytes of payload that lie between two
/// places of a stream. `first` and `second` are the stream's checksums up to these places.
#[inline(always)]
pub(super) fn between(first: u16, second: u16, payload: u8) -> u16 {
    let row = 2 * usize::from(payload);
    let four = |shift: u32| usize::from(first >> shift & 0xF);
    let left = SHIFTED[row][four(0)]
        ^ SHIFTED[row + 1][four(4)]
        ^ SHIFTED[row + 2][four(8)]
        ^ SHIFTED[row + 3][four(12)];
    second ^ left
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::{between, crc16, update};
    use proptest::prelude::*;

    /// The check value of CRC-16/XMODEM in the catalogue of parametrised CRC algorithms.
    #[test]
    fn gives_the_catalogue_s_check_value() {
        assert_eq!(crc16(0, b"123456789"), 0x31C3);
    }

    /// Bit by bit, as the polynomial says.
    fn shifted(crc: u16, bits: usize) -> u16 {
        (0..bits).fold(crc, |crc, _| {
            crc << 1 ^ if crc & 0x8000 == 0 { 0 } else { 0x1021 }
        })
    }

    #[test]
    fn a_byte_is_eight_bits() {
        for crc in 0..=u16::MAX {
            for byte in [0, 1, 0x55, 0x80, 0xFF] {
                let expected = shifted(crc ^ u16::from(byte) << 8, 8);
                assert_eq!(update(crc, byte), expected);
            }
        }
    }

    proptest! {
        #[test]
        fn the_checksum_of_a_stretch_follows_from_those_of_its_ends(
            before in proptest::collection::vec(any::<u8>(), 0..20),
            stretch in proptest::collection::vec(any::<u8>(), 5..=260),
        ) {
            let first = crc16(0, &before);
            let second = crc16(first, &stretch);
            prop_assert_eq!(between(first, second, (stretch.len() - 5) as u8), crc16(0, &stretch));
        }
    }
}

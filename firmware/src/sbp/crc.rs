//! The checksum of SBP frames: CRC-16, polynomial 0x1021, initial value 0, not reflected
//! (CRC-16/XMODEM).
//!
//! A checksum is the remainder of its bytes, taken as a polynomial over GF(2), times x^16,
//! modulo x^16 + x^12 + x^5 + 1. From the checksums of a stream up to two of its places
//! therefore follows that of what lies between them: the first, times x^8 for every byte
//! between, is what the bytes before it have left in the second ([`between`]). The crate
//! `crc` has no such operation; without it, each candidate for a frame would cost a pass over
//! its bytes.

/// Shortest stretch that [`between`] knows, a frame without preamble, payload and checksum:
/// type, sender and length.
const SHORTEST: usize = 5;
/// Payloads of 0 to 255 bytes, two rows for a byte, and four rows for the last of them.
const ROWS: usize = 2 * 255 + 4;

/// What the 16 polynomials of four bits are times x^4 for each row, after those of
/// [`SHORTEST`] bytes: 16 KiB that spare a multiplication, half the time of a look at a
/// candidate.
static SHIFTED: [[u16; 16]; ROWS] = {
    let mut rows = [[0; 16]; ROWS];
    // x^4 for each row, times 1, x, x^2 and x^3.
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
/// Eight bits at once without a table: what leaves at the top comes back by the three terms
/// of the polynomial, the four bits of it that leave once more already added to it.
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

/// The checksum of the type, sender, length and `payload` bytes of payload that lie between
/// two places of a stream, from its checksums up to there.
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

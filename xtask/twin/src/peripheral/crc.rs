//! The CRC unit of both parts with its polynomial after reset: CRC-32 of Ethernet, a word at a
//! time, most significant bit first, without a final inversion (RM0390 chapter 4, RM0316 chapter
//! 6). Other polynomials, sizes and bit orders of the F303 only read back what was written.

use crate::part::Family;

/// The generator polynomial.
const POLYNOMIAL: u32 = 0x04C1_1DB7;

#[derive(Clone, Debug)]
pub(crate) struct Crc {
    family: Family,
    value: u32,
    independent: u32,
    initial: u32,
}

impl Crc {
    pub(crate) fn new(family: Family) -> Self {
        Self {
            family,
            value: u32::MAX,
            independent: 0,
            initial: u32::MAX,
        }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match (offset, self.family) {
            (0x00, _) => Some(self.value),
            (0x04, _) => Some(self.independent),
            (0x08, Family::F3) => Some(0),
            (0x10, Family::F3) => Some(self.initial),
            (0x14, Family::F3) => Some(POLYNOMIAL),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        match (offset, self.family) {
            (0x00, _) => self.value = step(self.value, value),
            (0x04, _) => self.independent = value & 0xFF,
            (0x08, _) if value & 1 != 0 => self.value = self.initial,
            (0x10, Family::F3) => {
                self.initial = value;
                self.value = value;
            }
            _ => {}
        }
    }
}

/// The remainder after one more word.
fn step(remainder: u32, word: u32) -> u32 {
    (0..32).fold(remainder ^ word, |value, _| {
        value << 1 ^ if value >> 31 != 0 { POLYNOMIAL } else { 0 }
    })
}

#[cfg(test)]
mod tests {
    use super::Crc;
    use crate::part::Family;

    #[test]
    fn the_check_value_of_the_catalogue() {
        // CRC-32/MPEG-2 in the catalogue of parametrised CRC algorithms has the check value
        // 0376E6E7 for the bytes "123456789"; its first eight bytes are two words.
        let mut crc = Crc::new(Family::F4);
        crc.write(0, 0x3132_3334);
        crc.write(0, 0x3536_3738);
        let first = crc.read(0).unwrap();
        let last = (0..8).fold(first ^ u32::from(b'9') << 24, |value, _| {
            value << 1
                ^ if value >> 31 != 0 {
                    super::POLYNOMIAL
                } else {
                    0
                }
        });
        assert_eq!(last, 0x0376_E6E7);
        crc.write(8, 1);
        assert_eq!(crc.read(0), Some(u32::MAX));
    }
}

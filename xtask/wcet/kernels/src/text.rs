//! Check sums and characters.

use crate::Input;

/// CRC-8 (polynomial 0x2f) of 16 bytes, bit by bit.
#[inline(never)]
pub fn crc8_bits(input: &mut Input) -> u32 {
    let mut crc = 0xffu8;
    for word in &input[..16] {
        crc ^= *word as u8;
        for _ in 0..8 {
            crc = if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x2f };
        }
    }
    u32::from(crc)
}

/// CRC-32 of the block with a table of sixteen entries.
#[inline(never)]
pub fn crc32_table(input: &mut Input) -> u32 {
    const TABLE: [u32; 16] = {
        let mut table = [0; 16];
        let mut entry = 0;
        while entry < 16 {
            let mut crc = entry as u32;
            let mut bit = 0;
            while bit < 4 {
                crc = if crc & 1 == 0 { crc >> 1 } else { crc >> 1 ^ 0xedb8_8320 };
                bit += 1;
            }
            table[entry] = crc;
            entry += 1;
        }
        table
    };
    let mut crc = !0u32;
    for word in &input[..16] {
        for byte in word.to_le_bytes() {
            crc ^= u32::from(byte);
            crc = crc >> 4 ^ TABLE[(crc & 15) as usize];
            crc = crc >> 4 ^ TABLE[(crc & 15) as usize];
        }
    }
    !crc
}

/// Decimal digits of a word.
#[inline(never)]
pub fn decimal(input: &mut Input) -> u32 {
    let mut digits = [b'0'; 10];
    let mut word = input[0];
    let mut length = 0;
    for digit in digits.iter_mut().rev() {
        *digit = b'0' + (word % 10) as u8;
        word /= 10;
        length += 1;
        if word == 0 {
            break;
        }
    }
    digits.iter().fold(length, |sum, digit| sum * 3 + u32::from(*digit))
}

/// The number that the first bytes spell, up to the first byte that is no digit.
#[inline(never)]
pub fn parse_number(input: &mut Input) -> u32 {
    let mut number = 0u32;
    for word in &input[..12] {
        let digit = (*word as u8 & 0x1f).wrapping_sub(2);
        if digit > 24 {
            break;
        }
        number = match number.checked_mul(25).and_then(|n| n.checked_add(u32::from(digit))) {
            Some(number) => number,
            None => return u32::MAX,
        };
    }
    number
}

/// Hexadecimal digits of eight words.
#[inline(never)]
pub fn hexadecimal(input: &mut Input) -> u32 {
    let mut text = [0u8; 64];
    for (word, digits) in input.iter().zip(text.chunks_exact_mut(8)) {
        for (place, digit) in digits.iter_mut().rev().enumerate() {
            let value = (word >> (4 * place)) as u8 & 15;
            *digit = if value < 10 { b'0' + value } else { b'a' + value - 10 };
        }
    }
    text.iter().fold(0, |sum, digit| sum ^ u32::from(*digit).rotate_left(sum & 7))
}

//! Division, multiplication and floating point.

use crate::Input;

fn wide(input: &Input, at: usize) -> u64 {
    u64::from(input[at]) << 32 | u64::from(input[at + 1])
}

/// A 32-bit quotient and a remainder.
#[inline(never)]
pub fn divide_u32(input: &mut Input) -> u32 {
    (input[0] / (input[1] | 1)) ^ (input[2] % (input[3] >> 16 | 1))
}

/// One 64-bit division.
#[inline(never)]
pub fn divide_u64(input: &mut Input) -> u32 {
    (wide(input, 0) / (wide(input, 2) | 1)) as u32
}

/// One signed 64-bit division.
#[inline(never)]
pub fn divide_i64(input: &mut Input) -> u32 {
    (wide(input, 0) as i64).wrapping_div(wide(input, 2) as i64 | 1) as u32
}

/// Four 64-bit remainders by a 32-bit divisor.
#[inline(never)]
pub fn remainder_u64(input: &mut Input) -> u32 {
    let divisor = u64::from(input[63]) | 1;
    let mut sum = 0u64;
    for at in 0..4 {
        sum = sum.wrapping_add(wide(input, 2 * at) % divisor);
    }
    sum as u32
}

/// A polynomial of degree 15 by Horner's rule.
#[inline(never)]
pub fn polynomial_f32(input: &mut Input) -> u32 {
    let x = input[0] as f32 * 1.0e-9;
    let mut sum = 0.0f32;
    for word in &input[1..17] {
        sum = sum * x + *word as i32 as f32;
    }
    sum.to_bits()
}

/// A polynomial in double precision, by the run-time library.
#[inline(never)]
pub fn polynomial_f64(input: &mut Input) -> u32 {
    let x = f64::from(input[0]) * 1.0e-9;
    let mut sum = 0.0f64;
    for word in &input[1..9] {
        sum = sum * x + f64::from(*word as i32);
    }
    sum.to_bits() as u32
}

/// A double-precision quotient of arbitrary bit patterns.
#[inline(never)]
pub fn divide_f64(input: &mut Input) -> u32 {
    let quotient = f64::from_bits(wide(input, 0)) / f64::from_bits(wide(input, 2));
    (quotient.to_bits() >> 32) as u32
}

/// Newton's method, eight turns.
#[inline(never)]
pub fn root_f32(input: &mut Input) -> u32 {
    let square = (input[0] >> 1) as f32 + 1.0;
    let mut root = square;
    for _ in 0..8 {
        root = 0.5 * (root + square / root);
    }
    root as u32
}

/// Products of 32 and of 64 bits, accumulated.
#[inline(never)]
pub fn product_u64(input: &mut Input) -> u32 {
    let mut sum = 1u64;
    for pair in input.chunks_exact(2) {
        sum = sum.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(u64::from(pair[0]) * u64::from(pair[1]));
    }
    (sum >> 32) as u32
}

/// Euclid's algorithm. Fibonacci numbers are the worst case: 46 turns in 32 bits (Lamé 1844).
#[inline(never)]
pub fn greatest_divisor(input: &mut Input) -> u32 {
    let (mut a, mut b) = (input[0], input[1]);
    // loop-bound: 47 Lamé's 46, and one if the first number is the smaller one
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// Clears the lowest bit until none is left.
#[inline(never)]
pub fn bits_set(input: &mut Input) -> u32 {
    let mut word = input[0];
    let mut count = 0;
    // loop-bound: 32 one turn for each bit
    while word != 0 {
        word &= word - 1;
        count += 1;
    }
    count
}

/// A second-order section in fixed point over 16 samples, saturating.
#[inline(never)]
pub fn fixed_point_filter(input: &mut Input) -> u32 {
    let (mut x1, mut x2, mut y1, mut y2) = (0i32, 0i32, 0i32, 0i32);
    for word in &mut input[..16] {
        let x = (*word as i32) >> 16;
        let sum = 5 * x + 10 * x1 + 5 * x2 + 31 * y1 - 16 * y2;
        let y = (sum >> 5).clamp(-32_768, 32_767);
        (x2, x1, y2, y1) = (x1, x, y1, y);
        *word = y as u32;
    }
    y1 as u32
}

//! The kernels: small programs with known difficulties, by which the analysis is judged.
//!
//! Their package is in `kernels/` and is built apart. Tests and benchmarks run them on an emulated
//! core and compare the observed times with the bounds.

use crate::image::Image;

/// Number of input words of every kernel.
pub const WORDS: usize = 64;
/// Address of the input. The stack ends below it.
pub const INPUT: u32 = 0x2000_8000;

/// Names of the kernels, with their modules.
pub const NAMES: [&str; 39] = [
    "arithmetic::divide_u32",
    "arithmetic::divide_u64",
    "arithmetic::divide_i64",
    "arithmetic::remainder_u64",
    "arithmetic::polynomial_f32",
    "arithmetic::polynomial_f64",
    "arithmetic::divide_f64",
    "arithmetic::root_f32",
    "arithmetic::product_u64",
    "arithmetic::greatest_divisor",
    "arithmetic::bits_set",
    "arithmetic::fixed_point_filter",
    "arrays::nested",
    "arrays::triangular",
    "arrays::matrix_f32",
    "arrays::matrix_i32",
    "arrays::insertion_sort",
    "arrays::bubble_sort",
    "arrays::heap_sort",
    "arrays::binary_search",
    "arrays::copy_some",
    "arrays::copy_all",
    "arrays::compare_some",
    "arrays::fill_some",
    "arrays::sieve",
    "arrays::median",
    "control::early_exit",
    "control::table_jump",
    "control::pointer_table",
    "control::state_machine",
    "control::choices",
    "control::merged",
    "control::repeated_from_within",
    "control::searches",
    "text::crc8_bits",
    "text::crc32_table",
    "text::decimal",
    "text::parse_number",
    "text::hexadecimal",
];

/// Address of the kernel with this name; `None` if the image does not have it.
#[must_use]
pub fn find(image: &Image, name: &str) -> Option<u32> {
    let full = format!("kernels::{name}");
    let mut functions = image.functions();
    functions
        .find(|(_, function)| function.name == full)
        .map(|(address, _)| address)
}

/// The input of run number `run`, made from random words. Several distributions take turns,
/// because uniform words are seldom the worst case.
pub fn input(mut random: impl FnMut() -> u32, run: u64) -> [u32; WORDS] {
    let mut words = [0; WORDS];
    let level = random();
    for (index, word) in words.iter_mut().enumerate() {
        let value = random();
        *word = match run % 9 {
            0 => value,
            1 => value >> (level % 32),
            2 => u32::MAX - index as u32,
            3 => index as u32 * 3 + (level & 0xff),
            4 => level,
            5 => value | 0x7f80_0000,
            6 => value & 0x3f80_00ff,
            7 => value >> (value % 32),
            _ => u32::MAX << (value % 32),
        };
    }
    match run % 11 {
        // Adjacent Fibonacci numbers, for which Euclid's algorithm takes the most turns.
        3 => (words[0], words[1]) = (1_836_311_903, 2_971_215_073),
        4 => words[0] = 100,
        5 => words[0] = 63,
        6 => words[63] = 0,
        _ => {}
    }
    words
}

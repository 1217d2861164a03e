//! Panics nowhere.

#![no_std]
#![no_main]

use programs::{input, output, silent};

fn work() {
    let table = [1u32, 2, 3, 4];
    let index = input() as usize;
    output(table.get(index).copied().unwrap_or(0).wrapping_mul(3));
}

programs::program!(work, silent);

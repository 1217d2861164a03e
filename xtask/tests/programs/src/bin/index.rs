//! May index past the end of an array.

#![no_std]
#![no_main]

use programs::{input, output, silent};

fn work() {
    let table = [1u32, 2, 3, 4];
    output(table[input() as usize]);
}

programs::program!(work, silent);

//! Traps without any panic.

#![no_std]
#![no_main]

use programs::{input, output, silent};

fn work() {
    if input() > 3 {
        // SAFETY: an undefined instruction is a fault, which is the point.
        unsafe { core::arch::asm!("udf #1") }
    }
    output(1);
}

programs::program!(work, silent);

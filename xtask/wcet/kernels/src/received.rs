//! Receive interrupts, which take a path by the identifier that they read.

use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};

/// The identifier of the oldest frame.
const RI0R: *const u32 = ptr::without_provenance(0x4000_65b0);
/// Releases that frame, and shows whether one was lost.
const RF0R: *mut u32 = ptr::without_provenance_mut(0x4000_640c);
const RELEASE: u32 = 1 << 5;
const LOST: u32 = 1 << 4;
const URGENT: u32 = 100 << 21;

/// The analysis does not know this value.
#[used]
static ANY: AtomicU32 = AtomicU32::new(0);

#[inline(always)]
fn identifier() -> u32 {
    // SAFETY: the register exists on the part that the analysis is told of; nothing runs this program.
    unsafe { RI0R.read_volatile() }
}

#[inline(always)]
fn write(word: u32) {
    // SAFETY: as in `identifier`.
    unsafe { RF0R.write_volatile(word) };
}

/// Takes long.
#[inline(never)]
fn work() {
    // loop-bound: 99
    for _ in 0..100 {
        ANY.load(Ordering::Relaxed);
        write(LOST);
    }
}

/// Takes long for one identifier.
pub fn take() {
    write(LOST);
    let identifier = identifier();
    write(RELEASE);
    if identifier == URGENT {
        work();
    }
}

/// Reads the identifier of the frame behind the oldest one.
pub fn take_next() {
    write(RELEASE);
    if identifier() == URGENT {
        work();
    }
}

/// Takes every frame that is there, up to two.
pub fn take_two() {
    // loop-bound: 2
    for _ in 0..2 {
        if identifier() == URGENT {
            work();
        }
        write(RELEASE);
    }
}

/// Releases a frame on one path before it reads.
pub fn take_or_skip() {
    if identifier() == 0 {
        write(RELEASE);
    }
    if identifier() == URGENT {
        work();
    }
}

/// Writes a word that it reads from memory. The analysis does not know its value.
pub fn take_by_mask() {
    write(ANY.load(Ordering::Relaxed));
    if identifier() == URGENT {
        work();
    }
}

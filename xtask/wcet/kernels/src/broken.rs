//! Programs without a bound, and one with a false annotation.

use crate::Input;
use core::sync::atomic::{AtomicU32, Ordering};

static FLAG: AtomicU32 = AtomicU32::new(0);

/// Waits for a flag that only an interrupt could set.
#[inline(never)]
pub fn endless_wait(input: &mut Input) -> u32 {
    while FLAG.load(Ordering::Relaxed) != input[0] {}
    1
}

/// The Ackermann function, which no compiler turns into a loop.
#[inline(never)]
pub fn recursion(input: &mut Input) -> u32 {
    #[inline(never)]
    fn ackermann(m: u32, n: u32) -> u32 {
        match (m, n) {
            (0, n) => n.wrapping_add(1),
            (m, 0) => ackermann(m - 1, 1),
            (m, n) => ackermann(m - 1, ackermann(m, n - 1)),
        }
    }
    ackermann(input[0] & 3, input[1] & 7)
}

/// Takes a lock that only another task could give back. LLVM would repeat the loop's body, which hides
/// what it is.
#[inline(never)]
pub fn spin_lock(input: &mut Input) -> u32 {
    let mut old: u32;
    // SAFETY: it reads and writes one word, which belongs to an atomic.
    unsafe {
        core::arch::asm!(
            "2: ldrex {old}, [{lock}]",
            "cmp {old}, #0",
            "bne 2b",
            "strex {old}, {new}, [{lock}]",
            "cmp {old}, #0",
            "bne 2b",
            old = out(reg) old,
            new = in(reg) input[0] | 1,
            lock = in(reg) FLAG.as_ptr(),
        );
    }
    old
}

/// Calls the function to which a word in memory points.
#[inline(never)]
pub fn pointer_from_memory(hook: &mut fn(u32) -> u32) -> u32 {
    hook(1).wrapping_add(1)
}

/// Has an annotation below what any path takes.
#[inline(never)]
pub fn never_left(input: &mut Input) -> u32 {
    let mut word = input[0];
    // loop-bound: 10
    for turn in 0..2000 {
        word = core::hint::black_box(word ^ turn);
    }
    word
}

/// Never ends, whatever its annotation says.
#[inline(never)]
pub fn without_end(input: &mut Input) -> u32 {
    // loop-bound: 1
    loop {
        input[0] = core::hint::black_box(input[0].wrapping_add(1));
    }
}

/// Has a false annotation, which a run on the emulator contradicts.
#[inline(never)]
pub fn annotated_too_low(input: &mut Input) -> u32 {
    let mut word = input[0];
    let mut count = 0;
    // loop-bound: 3 it takes up to 32
    while word != 0 {
        word &= word - 1;
        count += 3;
    }
    count
}

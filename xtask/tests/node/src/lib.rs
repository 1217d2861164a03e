//! The little of an STM32F446 that the node needs: four interrupts that
//! software pends, and inputs that no compiler knows.

#![no_std]

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

// Start-up and vector table.
use cortex_m_rt as _;

/// Bits of an interrupt's priority.
pub const NVIC_PRIO_BITS: u8 = 4;

/// The interrupts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Interrupt {
    /// Of `sample`.
    EXTI0 = 6,
    /// Of `filter`.
    EXTI1 = 7,
    /// Of `report`.
    EXTI2 = 8,
    /// Of no task.
    EXTI3 = 9,
}

/// As RTIC spells it.
pub use Interrupt as interrupt;

// SAFETY: these are their places in the part's vector table.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

unsafe extern "C" {
    fn EXTI0();
    fn EXTI1();
    fn EXTI2();
    fn EXTI3();
}

/// An entry of the vector table.
#[derive(Clone, Copy)]
pub union Vector {
    handler: unsafe extern "C" fn(),
    reserved: usize,
}

/// The vectors of the part's interrupts.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
pub static __INTERRUPTS: [Vector; 10] = {
    let mut vectors = [Vector { reserved: 0 }; 10];
    vectors[6] = Vector { handler: EXTI0 };
    vectors[7] = Vector { handler: EXTI1 };
    vectors[8] = Vector { handler: EXTI2 };
    vectors[9] = Vector { handler: EXTI3 };
    vectors
};

static INPUT: AtomicU32 = AtomicU32::new(12_345);

/// A number that is different each time.
pub fn input() -> u32 {
    let value = INPUT.load(Ordering::Relaxed).wrapping_mul(1_664_525);
    INPUT.store(value, Ordering::Relaxed);
    value
}

/// Puts a result where the compiler cannot remove it.
pub fn output(value: u32) {
    INPUT.store(value, Ordering::Relaxed);
}

/// Counts steps by calls in tail position, of which a compiler makes a loop.
pub fn steps(n: u32, known: u32) -> u32 {
    match n {
        0 | 1 => known,
        even if even % 2 == 0 => steps(even / 2, known + 1),
        odd => steps(odd.wrapping_mul(3).wrapping_add(1), known + 1),
    }
}

/// A lock that spins: one while somebody holds it.
pub static LOCK: AtomicU32 = AtomicU32::new(0);

/// Counts, by a compare-and-swap that is repeated only when it was interrupted.
pub fn count() -> u32 {
    LOCK.fetch_add(2, Ordering::Relaxed)
}

/// Waits for the lock by compare-and-swap.
#[inline(never)]
pub fn acquire() {
    let mut locked = true;
    while locked {
        let free = LOCK.compare_exchange(0, 1, Ordering::Acquire, Ordering::Relaxed);
        locked = free.is_err();
    }
}

/// Repeats a store-exclusive that always fails, because what it needs is cleared before it.
#[inline(never)]
pub fn cleared() {
    // SAFETY: nothing is stored.
    unsafe {
        core::arch::asm!(
            "2: ldrex {old}, [{at}]",
            "clrex",
            "strex {failed}, {old}, [{at}]",
            "cmp {failed}, #0",
            "bne 2b",
            at = in(reg) LOCK.as_ptr(), old = out(reg) _, failed = out(reg) _,
        );
    }
}

/// The same behind another store-exclusive.
#[inline(never)]
pub fn twice() {
    // SAFETY: the word keeps its value.
    unsafe {
        core::arch::asm!(
            "2: ldrex {old}, [{at}]",
            "strex {failed}, {old}, [{at}]",
            "strex {failed}, {old}, [{at}]",
            "cmp {failed}, #0",
            "bne 2b",
            at = in(reg) LOCK.as_ptr(), old = out(reg) _, failed = out(reg) _,
        );
    }
}

/// What was last put there.
#[inline(never)]
pub fn last() -> u32 {
    INPUT.load(Ordering::Relaxed)
}

/// Changes the word at this address and puts it back.
#[inline(never)]
pub fn flicker(at: u32) {
    let word = at as *mut u32;
    // SAFETY: the callers name a word that nobody reads meanwhile.
    unsafe {
        let kept = word.read_volatile();
        word.write_volatile(kept ^ 0xF0);
        word.write_volatile(kept);
    }
}

static TABLE: [u32; 16] = [3; 16];

/// A table, at an address that the compiler keeps in memory.
pub fn table() -> &'static [u32; 16] {
    core::hint::black_box(&TABLE)
}

/// What the report makes of the samples.
pub fn checksum(samples: &[u32; 16], repeats: u32) -> u32 {
    let mut sum = 1;
    for repeat in 0..repeats {
        for sample in samples {
            sum = mixed(sum ^ sample, repeat);
        }
    }
    sum
}

/// Never inlined, so that no compiler shortens what is repeated.
#[inline(never)]
fn mixed(sum: u32, repeat: u32) -> u32 {
    sum.rotate_left(repeat).wrapping_mul(0x9E37_79B1)
}

/// The Ackermann function, which no compiler turns into a loop.
#[inline(never)]
pub fn ackermann(m: u32, n: u32) -> u32 {
    match (m, n) {
        (0, n) => n.wrapping_add(1),
        (m, 0) => ackermann(m - 1, 1),
        (m, n) => ackermann(m - 1, ackermann(m, n - 1)),
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

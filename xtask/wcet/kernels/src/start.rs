//! What start-up leaves in memory, and what handlers make of it.

use core::arch::asm;
use core::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

static VALUES: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];
static OTHERS: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];
static PLACE: AtomicPtr<AtomicU32> = AtomicPtr::new(core::ptr::null_mut());

/// Sets a pointer and enables interrupts.
pub fn set_up() {
    PLACE.store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: the analysis and the emulator know of no interrupts here.
    unsafe { asm!("cpsie i") };
}

/// Works on what the pointer leads to.
pub fn use_pointer() {
    let place = PLACE.load(Ordering::Relaxed);
    for distance in 0..8 {
        // SAFETY: the pointer leads to the first of sixteen.
        let value = unsafe { &*place.add(distance) };
        value.store(value.load(Ordering::Relaxed) ^ 5, Ordering::Relaxed);
    }
}

/// Writes to one of several, which one is not known.
pub fn use_index() {
    let index = VALUES[0].load(Ordering::Relaxed) as usize;
    if let Some(value) = OTHERS.get(index) {
        value.store(3, Ordering::Relaxed);
    }
}

/// Lets the pointer lead to somewhere else.
pub fn move_pointer() {
    PLACE.store(OTHERS.as_ptr().cast_mut(), Ordering::Relaxed);
}

/// Writes to where nobody knows.
pub fn write_anywhere(place: &AtomicU32) {
    place.store(1, Ordering::Relaxed);
}

//! A pointer that start-up leaves in memory, and handlers that use or change it.

use core::arch::asm;
use core::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

static VALUES: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];
static OTHERS: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];
static PLACE: AtomicPtr<AtomicU32> = AtomicPtr::new(core::ptr::null_mut());

/// Sets a pointer and enables interrupts.
pub fn set_up() {
    PLACE.store(VALUES.as_ptr().cast_mut(), Ordering::Relaxed);
    // SAFETY: neither the analysis nor the emulator raises an interrupt in this program.
    unsafe { asm!("cpsie i") };
}

/// Changes the words to which the pointer leads.
pub fn use_pointer() {
    let place = PLACE.load(Ordering::Relaxed);
    for distance in 0..8 {
        // SAFETY: the pointer leads to the first of sixteen elements.
        let value = unsafe { &*place.add(distance) };
        value.store(value.load(Ordering::Relaxed) ^ 5, Ordering::Relaxed);
    }
}

/// Writes to an element with an unknown index.
pub fn use_index() {
    let index = VALUES[0].load(Ordering::Relaxed) as usize;
    if let Some(value) = OTHERS.get(index) {
        value.store(3, Ordering::Relaxed);
    }
}

/// Makes the pointer lead to another array.
pub fn move_pointer() {
    PLACE.store(OTHERS.as_ptr().cast_mut(), Ordering::Relaxed);
}

/// Writes to an unknown address.
pub fn write_anywhere(place: &AtomicU32) {
    place.store(1, Ordering::Relaxed);
}

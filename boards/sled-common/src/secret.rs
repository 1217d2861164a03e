//! The place of the network's key in the flash. What its words mean is the firmware's.

/// Words that a record may have.
pub const WORDS: usize = 6;

/// The words at the beginning of this part of the flash.
#[cfg(target_os = "none")]
pub fn record(place: &parts::Memory) -> [u32; WORDS] {
    core::array::from_fn(|word| {
        let at = (place.base as *const u32).wrapping_add(word);
        // SAFETY: the boards' constants give the place: whole words of the flash. Volatile, because
        // a programmer changes them after the compiler has seen the program.
        unsafe { at.read_volatile() }
    })
}

/// On a PC the place is erased.
#[cfg(not(target_os = "none"))]
pub fn record(_: &parts::Memory) -> [u32; WORDS] {
    [u32::MAX; WORDS]
}

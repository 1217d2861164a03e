//! The place of missions in the flash. What its words mean is the firmware's.

/// The words of this part of the flash.
#[cfg(target_os = "none")]
pub fn words(place: &'static parts::Memory) -> &'static [u32] {
    // SAFETY: the boards' constants give the place: whole words of the flash, aligned. A program that
    // writes them does nothing else and ends in a reset, so nobody sees them change.
    unsafe { core::slice::from_raw_parts(place.base as *const u32, place.size as usize / 4) }
}

/// On a PC there is none.
#[cfg(not(target_os = "none"))]
pub fn words(_: &'static parts::Memory) -> &'static [u32] {
    &[]
}

//! Handlers that do not return.

use core::arch::asm;
use core::ptr;

/// Where a reset is requested.
const AIRCR: usize = 0xE000_ED0C;

/// Requests a reset and keeps the other bits, as `cortex-m` does.
pub fn reset() {
    let register = ptr::with_exposed_provenance_mut::<u32>(AIRCR);
    // SAFETY: the register is there on every core, and the emulator never runs this.
    unsafe { register.write_volatile(0x05FA_0004 | register.read_volatile() & 0x700) };
    loop {
        // SAFETY: it does nothing.
        unsafe { asm!("nop") };
    }
}

/// Sets the grouping of priorities, which looks nearly the same.
pub fn group() {
    let register = ptr::with_exposed_provenance_mut::<u32>(AIRCR);
    // SAFETY: as in `reset`.
    unsafe { register.write_volatile(0x05FA_0000 | register.read_volatile() & 0x700) };
    loop {
        // SAFETY: it does nothing.
        unsafe { asm!("nop") };
    }
}

/// Stops at a breakpoint.
pub fn stop() {
    // SAFETY: nothing follows.
    unsafe { asm!("bkpt", "udf #0", options(noreturn)) };
}

/// Returns if its flag is not set.
pub fn maybe_return(flag: &u32) {
    if *flag != 0 {
        loop {
            // SAFETY: it does nothing.
            unsafe { asm!("nop") };
        }
    }
}

//! How deep the stack has ever been.
//!
//! cortex-m-rt fills the stack with a pattern before the program begins. What still holds the
//! pattern at the lower end was never used.

#[cfg(target_os = "none")]
mod mark {
    use cortex_m_rt::STACK_PAINT_VALUE;

    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }

    /// Bytes of the stack that were never used. Takes a few cycles for each free word.
    pub fn unused() -> u16 {
        let bottom = &raw const _stack_end;
        let words = (&raw const _stack_start as usize).saturating_sub(bottom as usize) / 4;
        let mut free = 0_u16;
        let mut at = bottom;
        // At most every word of the stack; the boards have up to 4096.
        for _ in 0..words {
            // SAFETY: a word of the stack's memory, which always exists. The program may change it
            // at any time, but what is above the mark does not matter.
            let word = unsafe { at.read_volatile() };
            if word != STACK_PAINT_VALUE {
                break;
            }
            free = free.saturating_add(4);
            at = at.wrapping_add(1);
        }
        free
    }
}

#[cfg(target_os = "none")]
pub use mark::unused;

/// On a PC the stack carries no pattern.
#[cfg(not(target_os = "none"))]
pub const fn unused() -> u16 {
    0
}

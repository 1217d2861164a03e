//! The priority of SysTick, the timer of RTIC's software tasks.
//!
//! `rtic-monotonics` starts SysTick with its priority after a reset, the highest of all. It
//! would then delay the tasks of the bus, which do not need it.

use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;

unsafe extern "C" {
    /// The priority that RTIC reserves for the timer of its software tasks: above all of these,
    /// and below the hardware tasks if a level is left.
    static RTIC_ASYNC_MAX_LOGICAL_PRIO: u8;
}

/// Gives SysTick the priority that RTIC reserves for it. `bits` is the number of priority bits
/// of the part. Call this from `init`, before SysTick is started.
pub fn set_priority(scb: &mut SCB, bits: u8) {
    // SAFETY: every RTIC application defines it, as a `u8` that nothing writes.
    let logical = unsafe { RTIC_ASYNC_MAX_LOGICAL_PRIO };
    let levels = 1u16 << bits;
    // Priority 1 is RTIC's lowest. In the register a smaller number is more urgent, and the
    // number stands in the upper bits (PM0214 4.4.9).
    let number = levels.saturating_sub(u16::from(logical)) << (8 - bits);
    // SAFETY: in `init` no critical section relies on priorities yet.
    unsafe { scb.set_priority(SystemHandler::SysTick, number as u8) }
}

//! The priority of SysTick, the timer of RTIC's software tasks.
//!
//! `rtic-monotonics` starts SysTick with the priority it has after a reset, the highest of
//! all: it would delay the tasks of the bus, which it has nothing to do with.

use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;

unsafe extern "C" {
    /// The priority that RTIC keeps for the timer of its software tasks: above all of these,
    /// and below the tasks of the hardware where there is room.
    static RTIC_ASYNC_MAX_LOGICAL_PRIO: u8;
}

/// Gives SysTick the priority that RTIC keeps for it; `bits` is the number of priority bits of
/// the part. To be called from `init`, before SysTick is started.
pub fn set_priority(scb: &mut SCB, bits: u8) {
    // SAFETY: every RTIC application defines it, as a `u8` that nothing writes.
    let logical = unsafe { RTIC_ASYNC_MAX_LOGICAL_PRIO };
    let levels = 1u16 << bits;
    // Priority 1 is the lowest, the number in the register the other way round, in its upper
    // bits (PM0214 4.4.9).
    let number = levels.saturating_sub(u16::from(logical)) << (8 - bits);
    // SAFETY: in `init` no critical section relies on priorities yet.
    unsafe { scb.set_priority(SystemHandler::SysTick, number as u8) }
}

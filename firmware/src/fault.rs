//! Handling of panics, hard faults and interrupts without a task.
//!
//! All three leave a record, stop the actuator if the node drives one, and reset the
//! microcontroller. The node reads the record after the reset.

use crate::board;
use board::fault::Fault;

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    stop(Fault::Panic)
}

/// Stops the actuator, records the fault and resets the microcontroller.
// Not inlined, because the analysis ends a path here: the node starts again.
#[inline(never)]
pub fn stop(fault: Fault) -> ! {
    cortex_m::interrupt::disable();
    board::stop_actuator();
    board::fault::reset(fault)
}

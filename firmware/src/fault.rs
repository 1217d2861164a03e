//! What happens on a panic, a hard fault and an interrupt without a task.
//!
//! All three leave a record, bring the actuator to a stop where the node drives one, and
//! reset the microcontroller. The record is read after the reset.

use crate::board;
use board::fault::Fault;

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    stop(Fault::Panic)
}

/// Ends this run of the program.
pub fn stop(fault: Fault) -> ! {
    cortex_m::interrupt::disable();
    board::stop_actuator();
    board::fault::reset(fault)
}

//! The remote control's two lines: PB5 run, PB4 stop, high = on. Their pull-downs hold an open line
//! low, in addition to the sled's.

use stm32f3xx_hal::gpio::{Input, PB4, PB5};
use stm32f3xx_hal::prelude::*;

/// The lines of the remote control.
pub struct Remote {
    run: PB5<Input>,
    stop: PB4<Input>,
}

impl Remote {
    pub(crate) fn new(run: PB5<Input>, stop: PB4<Input>) -> Self {
        Self { run, stop }
    }

    /// Whether the line `run` is high.
    pub fn run(&self) -> bool {
        // A read of the port's input register: the error type is empty.
        self.run.is_high().unwrap_or(false)
    }

    /// Whether the line `stop` is high.
    pub fn stop(&self) -> bool {
        self.stop.is_high().unwrap_or(true)
    }
}

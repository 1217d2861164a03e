//! The green LED of the Nucleo board, PB3, active high.

use stm32f3xx_hal::gpio::{Output, PB3, PushPull};

/// The LED.
pub struct Led {
    pin: PB3<Output<PushPull>>,
}

impl Led {
    pub(crate) fn new(pin: PB3<Output<PushPull>>) -> Self {
        Self { pin }
    }

    /// Switches it on or off.
    pub fn set(&mut self, on: bool) {
        use stm32f3xx_hal::prelude::*;
        // A write to the port's set and reset register: the error type is empty.
        let _ = if on {
            self.pin.set_high()
        } else {
            self.pin.set_low()
        };
    }
}

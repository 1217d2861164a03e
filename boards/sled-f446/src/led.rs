//! The green LED of the Nucleo board, PA5, active high.

use stm32f4xx_hal::gpio::{Output, PA5};

/// The LED.
pub struct Led {
    pin: PA5<Output>,
}

impl Led {
    pub(crate) fn new(pin: PA5) -> Self {
        Self {
            pin: pin.into_push_pull_output(),
        }
    }

    /// Switches it on or off.
    pub fn set(&mut self, on: bool) {
        if on {
            self.pin.set_high();
        } else {
            self.pin.set_low();
        }
    }
}

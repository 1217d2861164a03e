//! The Nucleo-F303K8 on a CAN sled: clocks, pins and peripherals.

#![no_std]

pub mod clocks;
pub mod led;
pub mod time;
pub mod watchdog;

pub use sled_common::{can, clock, dma, fault, lines};
pub use stm32f3xx_hal::pac;

use clock::{Clocks, ResetCause};
use stm32f3xx_hal::prelude::*;

/// What every node on this sled has.
pub struct Sled {
    /// The clocks that were started.
    pub clocks: Clocks,
    /// Why the microcontroller started.
    pub reset_cause: ResetCause,
    /// The time base.
    pub clock: time::Clock,
    /// Its compare channels.
    pub alarms: time::Alarms,
    /// The LED.
    pub led: led::Led,
}

impl Sled {
    /// Starts the board: clocks first, everything else after.
    pub fn start(device: pac::Peripherals) -> Self {
        let reset_cause = clocks::reset_cause(&device.RCC);
        let clocks = clocks::start(&device.RCC, &device.FLASH);
        let (clock, alarms) = time::start(device.TIM2, &device.RCC);
        let mut rcc = device.RCC.constrain();
        let mut gpiob = device.GPIOB.split(&mut rcc.ahb);
        Self {
            clocks,
            reset_cause,
            clock,
            alarms,
            led: led::Led::new(
                gpiob
                    .pb3
                    .into_push_pull_output(&mut gpiob.moder, &mut gpiob.otyper),
            ),
        }
    }
}

/// Brings the actuator that this sled drives to a stop, without any state.
pub fn stop_actuator() {}

//! The Nucleo-F446RE on a CAN sled: clocks, pins and peripherals.

#![no_std]

pub mod clocks;
pub mod led;
pub mod time;
pub mod watchdog;

pub use sled_common::{can, clock, dma, fault, lines};
pub use stm32f4xx_hal::pac;

use clock::{Clocks, ResetCause};
use stm32f4xx_hal::gpio::GpioExt;
use stm32f4xx_hal::rcc::RccExt;

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
        let clocks = clocks::start(&device.RCC, &device.PWR, &device.FLASH);
        let (clock, alarms) = time::start(device.TIM2, &device.RCC);
        let mut rcc = device.RCC.constrain();
        let gpioa = device.GPIOA.split(&mut rcc);
        Self {
            clocks,
            reset_cause,
            clock,
            alarms,
            led: led::Led::new(gpioa.pa5),
        }
    }
}

/// Brings the actuator that this sled drives to a stop, without any state: none is
/// connected to it.
pub fn stop_actuator() {}

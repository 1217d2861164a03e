//! The hardware that the HAL has no driver for, or none that fits: register by register.
//!
//! | module | why not the HAL |
//! | --- | --- |
//! | [`flash`] | `unlocked` panics if the flash stays locked. `UnlockedFlash` writes byte by byte and erases with the smallest current, which takes four times as long. |
//! | [`clocks`] | `Rcc::freeze` waits for the external clock without a bound, has no fallback and does not start the clock security system; it searches for dividers at run time, with assertions that panic. |
//! | [`gate`] | `Enable` does not wait until the peripheral can be used. |
//! | [`time`] | The counters of `timer` stop and restart at each timeout. A free-running counter with two compare interrupts has no driver. |
//! | [`timer`] | A HAL timer takes its rate from `rcc::Clocks`, which only `freeze` makes; a trigger output for the converter is not part of `Counter`. |
//! | [`usart`] | A HAL `Serial` takes its rate from `rcc::Clocks`, too. |
//! | [`scan`] | `Adc::new` converts the internal reference once: it waits for the end without a bound, and divides by the result. |
//! | [`reference`] | The same. |
//! | [`supply`] | The HAL has no driver for the voltage detector. |
//! | [`ratio`] | The HAL has no capture of a clock of the part. |
//!
//! Everything else goes through the HAL: pins, clock gates and resets of the peripherals, DMA
//! streams, the CAN cell, the watchdog.

pub mod clocks;
pub(crate) mod crc;
pub mod flash;
pub(crate) mod gate;
pub(crate) mod ratio;
pub(crate) mod reference;
pub(crate) mod scan;
pub(crate) mod supply;
pub mod time;
pub(crate) mod timer;
pub(crate) mod usart;

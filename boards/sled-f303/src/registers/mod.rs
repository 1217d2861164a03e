//! The hardware that the HAL has no driver for, or none that fits: register by register.
//!
//! | module | why not the HAL |
//! | --- | --- |
//! | [`clocks`] | `CFGR::freeze` waits for the external clock without a bound and has no fallback; it searches for dividers at run time, with assertions that panic. |
//! | [`gate`] | `Enable` does not wait until the peripheral can be used. |
//! | [`time`] | The timers of the HAL stop and restart at each timeout. A free-running counter with two compare interrupts has no driver. |
//! | [`timer`] | A HAL timer takes its rate from `rcc::Clocks`, which only `freeze` makes, and has no trigger output. |
//! | [`pulse`] | The HAL's channels know neither preload nor the break input, and do not restart. |
//! | [`usart`] | A HAL `Serial` takes its rate from `rcc::Clocks`, too; the motor's port must send without any state when the program ends. |
//! | [`scan`] | `adc::Adc` converts one channel at a time and waits for it; it has neither an external trigger nor DMA. |
//! | [`burst`] | The same, and it does not convert without a pause. |
//! | [`flash`] | The HAL writes no flash: it only lends its registers. |
//! | [`ratio`] | The HAL has no capture of a clock of the part. |
//! | [`reference`] | `adc::Adc` calibrates with waits that have no bound. |
//! | [`dma`] | Every setter of an address or a length asserts that the HAL's channel is disabled, which leaves panics in the image; the HAL reads the status register once for each flag. |
//!
//! Everything else goes through the HAL: pins, clock gates of the peripherals, DMA channels
//! except addresses and lengths, the watchdog. The CAN cell has no driver in this HAL; its
//! configuration goes through the `bxcan` crate.

pub(crate) mod burst;
pub mod clocks;
pub(crate) mod crc;
pub(crate) mod dma;
pub mod flash;
pub(crate) mod gate;
pub(crate) mod pulse;
pub(crate) mod ratio;
pub(crate) mod reference;
pub(crate) mod scan;
pub mod time;
pub(crate) mod timer;
pub(crate) mod usart;

//! The independent watchdog (RM0316 chapter 25), on its own 40 kHz oscillator.

use crate::pac;
use stm32f3xx_hal::hal::watchdog::{Watchdog as _, WatchdogEnable};
use stm32f3xx_hal::time::duration::Milliseconds;
use stm32f3xx_hal::watchdog::IndependentWatchDog;

/// The watchdog before it is started.
pub struct Idle(IndependentWatchDog);

/// The running watchdog; nothing but a reset stops it.
pub struct Watchdog(IndependentWatchDog);

impl Idle {
    pub(crate) fn new(iwdg: pac::IWDG) -> Self {
        Self(IndependentWatchDog::new(iwdg))
    }

    /// Starts it. `milliseconds` is nominal, 1 to 26214: the oscillator is somewhere between
    /// 30 and 50 kHz (data sheet, table of LSI characteristics), so the real time is
    /// between 0.8 and 1.34 times as long.
    #[inline]
    pub fn start(self, milliseconds: u16) -> Watchdog {
        let mut watchdog = self.0;
        watchdog.start(Milliseconds(u32::from(milliseconds)));
        watchdog.feed();
        Watchdog(watchdog)
    }
}

impl Watchdog {
    /// Feeds it: its full time starts again.
    #[inline]
    pub fn feed(&mut self) {
        self.0.feed();
    }
}

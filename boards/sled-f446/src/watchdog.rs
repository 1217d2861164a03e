//! The independent watchdog (RM0390 chapter 22), on its own 32 kHz oscillator.

use crate::pac;
use stm32f4xx_hal::watchdog::IndependentWatchdog;

/// The watchdog before it is started.
pub struct Idle(IndependentWatchdog);

/// The running watchdog; nothing but a reset stops it.
pub struct Watchdog(IndependentWatchdog);

impl Idle {
    pub(crate) fn new(iwdg: pac::IWDG) -> Self {
        Self(IndependentWatchdog::new(iwdg))
    }

    /// Starts it. `milliseconds` is nominal, 1 to 32767: the oscillator is somewhere between
    /// 17 and 47 kHz (data sheet, table of LSI characteristics), so the real time is
    /// between 0.68 and 1.9 times as long. The HAL rounds it up to steps of 8 ms.
    #[inline]
    pub fn start(self, milliseconds: u16) -> Watchdog {
        let mut watchdog = self.0;
        watchdog.start(fugit::MillisDurationU32::millis(
            u32::from(milliseconds).min(0x7FFF),
        ));
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

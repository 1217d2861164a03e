//! The independent watchdog (RM0316 chapter 25), on its own 40 kHz oscillator.

use crate::pac;
use stm32f3xx_hal::hal::watchdog::{Watchdog as _, WatchdogEnable};
use stm32f3xx_hal::time::duration::Milliseconds;
use stm32f3xx_hal::watchdog::IndependentWatchDog;

/// The running watchdog; nothing but a reset stops it.
pub struct Watchdog(IndependentWatchDog);

/// Starts it. `milliseconds` is nominal, 1 to 26214: the oscillator is somewhere between
/// 30 and 50 kHz (data sheet, table of LSI characteristics), so the real time is
/// between 0.8 and 1.34 times as long.
///
/// The first period may be longer: the new settings take effect some cycles of the watchdog's
/// oscillator after they are written. It stands still while a debugger holds the core.
pub(crate) fn start(iwdg: pac::IWDG, debug: &pac::DBGMCU, milliseconds: u16) -> Watchdog {
    let mut watchdog = IndependentWatchDog::new(iwdg);
    watchdog.stop_on_debug(debug, true);
    watchdog.start(Milliseconds(u32::from(milliseconds)));
    watchdog.feed();
    Watchdog(watchdog)
}

impl Watchdog {
    /// Feeds it: its full time starts again.
    #[inline]
    pub fn feed(&mut self) {
        self.0.feed();
    }
}

//! The independent watchdog (RM0390 chapter 22), on its own 32 kHz oscillator.

use crate::pac;
use stm32f4xx_hal::watchdog::IndependentWatchdog;

/// The running watchdog; nothing but a reset stops it.
pub struct Watchdog(IndependentWatchdog);

/// Starts it. `milliseconds` is nominal, 1 to 32767: the oscillator is somewhere between
/// 17 and 47 kHz (data sheet, table of LSI characteristics), so the real time is
/// between 0.68 and 1.9 times as long. The HAL rounds it up to steps of 8 ms.
///
/// The first period may be longer: the new settings take effect some cycles of the watchdog's
/// oscillator after they are written. It stands still while a debugger holds the core.
pub(crate) fn start(iwdg: pac::IWDG, debug: &pac::DBGMCU, milliseconds: u16) -> Watchdog {
    let mut watchdog = IndependentWatchdog::new(iwdg);
    watchdog.stop_on_debug(debug, true);
    watchdog.start(fugit::MillisDurationU32::millis(
        u32::from(milliseconds).min(0x7FFF),
    ));
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

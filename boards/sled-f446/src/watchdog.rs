//! The independent watchdog (RM0390 chapter 22), on its own 32 kHz oscillator.

use crate::pac;

/// The running watchdog.
pub struct Watchdog {
    iwdg: pac::IWDG,
}

impl Watchdog {
    /// Starts it. `milliseconds` is nominal, 1..=4095: the oscillator is somewhere between
    /// 17 and 47 kHz (data sheet, table of LSI characteristics), so the real time is
    /// between 0.68 and 1.9 times as long.
    pub(crate) fn start(iwdg: pac::IWDG, milliseconds: u16) -> Self {
        // SAFETY: key values and fields of RM0390 22.4; 32 kHz / 32 = 1 kHz.
        unsafe {
            iwdg.kr().write(|w| w.bits(0xCCCC));
            iwdg.kr().write(|w| w.bits(0x5555));
            iwdg.pr().write(|w| w.bits(0b011));
            iwdg.rlr().write(|w| w.bits(milliseconds.min(0xFFF)));
        }
        let mut watchdog = Self { iwdg };
        watchdog.feed();
        watchdog
    }

    /// Gives it its full time again.
    pub fn feed(&mut self) {
        // SAFETY: the reload key of RM0390 22.4.1.
        self.iwdg.kr().write(|w| unsafe { w.bits(0xAAAA) });
    }
}

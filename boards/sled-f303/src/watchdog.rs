//! The independent watchdog (RM0316 chapter 25), on its own 40 kHz oscillator.

use crate::pac;

/// The running watchdog.
pub struct Watchdog {
    iwdg: pac::IWDG,
}

impl Watchdog {
    /// Starts it. `milliseconds` is nominal, 1..=3276: the oscillator is somewhere between
    /// 30 and 50 kHz (data sheet, table of LSI characteristics), so the real time is
    /// between 0.8 and 1.34 times as long.
    pub(crate) fn start(iwdg: pac::IWDG, milliseconds: u16) -> Self {
        // SAFETY: key values and fields of RM0316 25.4; 40 kHz / 32 = 1.25 kHz.
        unsafe {
            iwdg.kr.write(|w| w.bits(0xCCCC));
            iwdg.kr.write(|w| w.bits(0x5555));
            iwdg.pr.write(|w| w.bits(0b011));
            iwdg.rlr
                .write(|w| w.bits(u32::from(milliseconds.min(3276)) * 5 / 4));
        }
        let mut watchdog = Self { iwdg };
        watchdog.feed();
        watchdog
    }

    /// Gives it its full time again.
    pub fn feed(&mut self) {
        // SAFETY: the reload key of RM0316 25.4.1.
        self.iwdg.kr.write(|w| unsafe { w.bits(0xAAAA) });
    }
}

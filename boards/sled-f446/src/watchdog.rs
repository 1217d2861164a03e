//! The independent watchdog (RM0390 chapter 22), on its own 32 kHz oscillator.

use crate::pac;

/// The watchdog before it is started.
pub struct Idle {
    iwdg: pac::IWDG,
}

/// The running watchdog; nothing but a reset stops it.
pub struct Watchdog {
    iwdg: pac::IWDG,
}

impl Idle {
    pub(crate) fn new(iwdg: pac::IWDG) -> Self {
        Self { iwdg }
    }

    /// Starts it. `milliseconds` is nominal, 1..=4095: the oscillator is somewhere between
    /// 17 and 47 kHz (data sheet, table of LSI characteristics), so the real time is
    /// between 0.68 and 1.9 times as long.
    pub fn start(self, milliseconds: u16) -> Watchdog {
        let iwdg = self.iwdg;
        // SAFETY: key values and fields of RM0390 22.4; 32 kHz / 32 = 1 kHz.
        unsafe {
            iwdg.kr().write(|w| w.bits(0xCCCC));
            iwdg.kr().write(|w| w.bits(0x5555));
            iwdg.pr().write(|w| w.bits(0b011));
            iwdg.rlr().write(|w| w.bits(milliseconds.min(0xFFF)));
        }
        let mut watchdog = Watchdog { iwdg };
        watchdog.feed();
        watchdog
    }
}

impl Watchdog {
    /// Gives it its full time again.
    pub fn feed(&mut self) {
        // SAFETY: the reload key of RM0390 22.4.1.
        self.iwdg.kr().write(|w| unsafe { w.bits(0xAAAA) });
    }
}

//! The node's time base: TIM2 counts at 18 MHz over 32 bits. Its channel 1 is the window timer,
//! its channel 2 releases the control task.
//!
//! 90 MHz / 5 = 18 MHz: one CAN bit of 4 us is 72 ticks, and both kinds of sled have the same
//! rate. The counter wraps after 238 s, so differences of time stamps are taken modulo 2^32.

use crate::pac;

const PRESCALER: u32 = parts::SLED_F446.external.time_base_prescaler();

/// The flags of the status register. Its other bits are reserved and stay zero (RM0390 17.4.5).
const FLAGS: u32 = 0x1E5F;

/// Reads the counter. It can be copied freely, because reading changes nothing.
#[derive(Clone, Copy)]
pub struct Clock(());

impl Clock {
    /// The time now, in ticks modulo 2^32.
    #[inline]
    pub fn now(self) -> u32 {
        // SAFETY: reads the counter of a timer that runs since a `Clock` exists.
        unsafe { (*pac::TIM2::ptr()).cnt().read().bits() }
    }
}

/// The compare channels of the time base.
pub struct Alarms {
    timer: pac::TIM2,
}

/// Starts the time base. The clock gate of TIM2 is open.
pub(crate) fn start(timer: pac::TIM2) -> (Clock, Alarms) {
    // SAFETY: the prescaler is 16 bits wide and PRESCALER fits.
    timer
        .psc()
        .write(|w| unsafe { w.psc().bits((PRESCALER - 1) as u16) });
    // SAFETY: any value is valid; the counter uses all 32 bits.
    timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
    // The update event loads the prescaler; its flag must not be taken for an alarm.
    timer.egr().write(|w| w.ug().set_bit());
    // SAFETY: clears all flags; reserved bits are written as reset.
    timer.sr().write(|w| unsafe { w.bits(0) });
    timer.cr1().write(|w| w.cen().set_bit());
    (Clock(()), Alarms { timer })
}

impl Alarms {
    /// Sets the window timer (channel 1). It fires at once if the instant is in the past.
    #[inline]
    pub fn set_window(&mut self, instant: u32) {
        // SAFETY: any 32-bit compare value is valid.
        self.timer.ccr1().write(|w| unsafe { w.bits(instant) });
        self.timer.dier().modify(|_, w| w.cc1ie().set_bit());
        let late = self.timer.cnt().read().bits().wrapping_sub(instant);
        if late < 1 << 31 {
            self.timer.egr().write(|w| w.cc1g().set_bit());
        }
    }

    /// Disarms the window timer.
    #[inline]
    pub fn clear_window(&mut self) {
        self.timer.dier().modify(|_, w| w.cc1ie().clear_bit());
    }

    /// Whether the window timer fired since the last call; acknowledges it.
    #[inline]
    pub fn take_window(&mut self) -> bool {
        let fired = self.timer.sr().read().cc1if().bit_is_set();
        if fired {
            // SAFETY: rc_w0 flags: writing ones leaves the others alone.
            self.timer
                .sr()
                .write(|w| unsafe { w.bits(FLAGS & !(1 << 1)) });
        }
        fired
    }

    /// Sets the release of the control task (channel 2), like [`Alarms::set_window`].
    #[inline]
    pub fn set_release(&mut self, instant: u32) {
        // SAFETY: any 32-bit compare value is valid.
        self.timer.ccr2().write(|w| unsafe { w.bits(instant) });
        self.timer.dier().modify(|_, w| w.cc2ie().set_bit());
        let late = self.timer.cnt().read().bits().wrapping_sub(instant);
        if late < 1 << 31 {
            self.timer.egr().write(|w| w.cc2g().set_bit());
        }
    }

    /// Whether the release fired since the last call; acknowledges it and disarms it.
    #[inline]
    pub fn take_release(&mut self) -> bool {
        let fired = self.timer.sr().read().cc2if().bit_is_set()
            && self.timer.dier().read().cc2ie().bit_is_set();
        if fired {
            self.timer.dier().modify(|_, w| w.cc2ie().clear_bit());
            // SAFETY: rc_w0 flags: writing ones leaves the others alone.
            self.timer
                .sr()
                .write(|w| unsafe { w.bits(FLAGS & !(1 << 2)) });
        }
        fired
    }
}

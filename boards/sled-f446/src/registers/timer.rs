//! Timers that expire at a fixed rate (RM0390 chapter 17).

use super::clocks::APB1_TIMER_HZ;

pub(crate) use crate::pac::tim3::RegisterBlock;

/// What a timer does when it expires.
pub(crate) enum Effect {
    /// It interrupts.
    Interrupt,
    /// It raises its trigger output (TRGO).
    Trigger,
}

/// Starts a timer of APB1 that expires `HZ` times a second. Its clock gate is open.
#[inline(always)]
pub(crate) fn start<const PRESCALER: u32, const HZ: u32>(timer: &RegisterBlock, effect: Effect) {
    const {
        let period = APB1_TIMER_HZ / PRESCALER / HZ;
        assert!(PRESCALER * period * HZ == APB1_TIMER_HZ && period <= 0x1_0000);
    }
    let period = APB1_TIMER_HZ / PRESCALER / HZ;
    timer.psc().write(|w| w.psc().set((PRESCALER - 1) as u16));
    timer.arr().write(|w| w.arr().set((period - 1) as u16));
    // The update event loads the prescaler; its flag is not an interrupt.
    timer.egr().write(|w| w.ug().set_bit());
    match effect {
        Effect::Interrupt => {
            acknowledge(timer);
            timer.dier().write(|w| w.uie().set_bit());
        }
        Effect::Trigger => {
            timer.cr2().write(|w| w.mms().update());
        }
    }
    timer.cr1().write(|w| w.cen().set_bit());
}

/// Acknowledges the interrupt.
#[inline(always)]
pub(crate) fn acknowledge(timer: &RegisterBlock) {
    timer.sr().modify(|_, w| w.uif().clear_bit());
}

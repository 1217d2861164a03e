//! bxCAN and a 32-bit timer as a node of `ttcan` needs them.
//!
//! The crate `bxcan` configures the cell, and loads and reads frames. It does not tell how a
//! transmission ended, and its abort waits until the frame has left the bus, so both are done with
//! the registers (RM0390 30.9.2).

use crate::mailbox;
use bxcan::{Fifo, Interrupt, filter::Mask32};
use stm32f4xx_hal::{can::Can, pac};
use ttcan::{BitTiming, Controller, Stamp, TransmitOutcome};

/// CAN1 in single shot.
pub(crate) struct BxCan(bxcan::Can<Can<pac::CAN1>>);

impl BxCan {
    /// Configures the cell and lets it join the bus, for which it does not wait.
    pub(crate) fn new(cell: Can<pac::CAN1>, timing: BitTiming) -> Self {
        let mut can = bxcan::Can::builder(cell)
            .set_bit_timing(timing.register())
            .set_automatic_retransmit(false)
            .leave_disabled();
        // A node supervises the whole schedule, so it receives everything.
        let all = Mask32::accept_all();
        can.modify_filters().enable_bank(0, Fifo::Fifo0, all);
        can.enable_interrupt(Interrupt::Fifo0MessagePending);
        can.enable_interrupt(Interrupt::TransmitMailboxEmpty);
        // Also lets the cell recover from bus-off by itself.
        let _ = can.enable_non_blocking();
        Self(can)
    }

    /// Takes the oldest frame. The interrupt stays pending while there are more. After an overrun it
    /// returns none once: the node notices the message that was lost.
    pub(crate) fn receive(&mut self) -> Option<bxcan::Frame> {
        // A length code of 9 to 15 means 8 bytes. The crate's frame would panic, also when it is asked
        // for its length. No node of a matrix sends such a frame, so it is dropped.
        if registers().rx(0).rdtr().read().dlc().bits() > 8 {
            registers().rfr(0).write(|w| w.rfom().set_bit());
            return None;
        }
        self.0.rx0().receive().ok()
    }

    /// Acknowledges a transmission that has ended, and says how.
    pub(crate) fn outcome(&mut self) -> Option<TransmitOutcome> {
        let (outcome, acknowledge) = mailbox::outcome(registers().tsr().read().bits())?;
        // SAFETY: ones clear; the other flags keep their state (RM0390 30.9.2).
        registers().tsr().write(|w| unsafe { w.bits(acknowledge) });
        Some(outcome)
    }

    /// Whether the cell is off the bus because of errors.
    pub(crate) fn is_bus_off(&self) -> bool {
        registers().esr().read().boff().bit_is_set()
    }

    /// Joins the bus again after [`Controller::silence`].
    pub(crate) fn join(&mut self) {
        registers().mcr().modify(|_, w| w.inrq().clear_bit());
    }
}

impl Controller for BxCan {
    type Frame = bxcan::Frame;

    fn transmit_once(&mut self, frame: &bxcan::Frame) -> bool {
        // With a frame pending the crate would withdraw it or wait behind it.
        self.0.is_transmitter_idle() && self.0.transmit(frame).is_ok()
    }

    fn abort(&mut self) {
        // SAFETY: ones request; an empty mailbox ignores it (RM0390 30.9.2).
        registers()
            .tsr()
            .write(|w| unsafe { w.bits(mailbox::ABORT) });
    }

    fn silence(&mut self) {
        self.abort();
        // In initialisation mode the cell sends no dominant bit.
        registers().mcr().modify(|_, w| w.inrq().set_bit());
    }
}

fn registers() -> &'static pac::can1::RegisterBlock {
    // SAFETY: the block exists for ever. Only `BxCan`, which owns the cell, calls this, and no other
    // context changes these registers.
    unsafe { &*pac::CAN1::ptr() }
}

/// TIM2 as free-running counter, with its compare channel 1 as window timer.
pub(crate) struct WindowTimer(pac::TIM2);

impl WindowTimer {
    /// Starts the counter: one tick takes `divider` clocks of the timer.
    pub(crate) fn new(timer: pac::TIM2, divider: u16) -> Self {
        // SAFETY: every value is valid.
        timer
            .psc()
            .write(|w| unsafe { w.bits(u32::from(divider) - 1) });
        // SAFETY: every value is valid.
        timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
        // Takes the divider over; its flag must not be taken for that of a deadline.
        timer.egr().write(|w| w.ug().set_bit());
        timer.sr().modify(|_, w| w.uif().clear_bit());
        timer.dier().write(|w| w.cc1ie().set_bit());
        timer.cr1().write(|w| w.cen().set_bit());
        Self(timer)
    }

    /// The counter.
    pub(crate) fn now(&self) -> Stamp {
        Stamp(self.0.cnt().read().bits())
    }

    /// Acknowledges the interrupt.
    pub(crate) fn acknowledge(&mut self) {
        self.0.sr().modify(|_, w| w.cc1if().clear_bit());
    }

    /// Fires at the deadline, or at once if it has passed.
    pub(crate) fn set(&mut self, deadline: Stamp) {
        // SAFETY: every value is valid.
        self.0.ccr1().write(|w| unsafe { w.bits(deadline.0) });
        if self.now().reached(deadline) {
            self.0.egr().write(|w| w.cc1g().set_bit());
        }
    }
}

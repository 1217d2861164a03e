//! bxCAN as a node of `ttcan` needs it, by the registers: the CAN driver of `embassy-stm32` 0.6 does not tell how an
//! attempt to send ended (RM0390 30.9).

use crate::mailbox;
use embassy_stm32::pac::CAN1;
use ttcan::{BitTiming, Controller, Frame, Id, TransmitOutcome};

/// That all three are empty.
const EMPTY: u32 = 7 << 26;
/// Of an identifier register: extended, remote frame.
const IDE: u32 = 1 << 2;
const RTR: u32 = 1 << 1;

/// CAN1 in single shot. Its clock and pins are set up before.
pub(crate) struct BxCan(());

impl BxCan {
    /// Configures the cell and lets it join the bus, for which it does not wait. There is one at most.
    pub(crate) fn new(timing: BitTiming) -> Self {
        CAN1.mcr().write(|w| {
            w.set_inrq(true);
            w.set_nart(true);
            // Recovers from bus-off by itself.
            w.set_abom(true);
        });
        while !CAN1.msr().read().inak() {}
        CAN1.btr().write(|w| w.0 = timing.register());
        // A node supervises the whole schedule, so it receives everything: bank 0, one 32-bit mask of zeros.
        CAN1.fmr().modify(|w| w.set_finit(true));
        CAN1.fs1r().write(|w| w.set_fsc(0, true));
        CAN1.fb(0).fr1().write(|w| w.0 = 0);
        CAN1.fb(0).fr2().write(|w| w.0 = 0);
        CAN1.fa1r().write(|w| w.set_fact(0, true));
        CAN1.fmr().modify(|w| w.set_finit(false));
        CAN1.ier().write(|w| {
            w.set_fmpie(0, true);
            w.set_tmeie(true);
        });
        CAN1.mcr().modify(|w| w.set_inrq(false));
        Self(())
    }

    /// Whether the cell is off the bus because of errors.
    pub(crate) fn is_bus_off(&self) -> bool {
        CAN1.esr().read().boff()
    }

    /// Joins the bus again after [`Controller::silence`].
    pub(crate) fn join(&mut self) {
        CAN1.mcr().modify(|w| w.set_inrq(false));
    }
}

/// Takes the oldest frame out of the FIFO; none for a remote frame and for a length code above 8, which no node of a
/// matrix sends. For the receive interrupt alone.
pub(crate) fn receive() -> Option<Frame> {
    let cell = CAN1.rx(0);
    let (id, length) = (cell.rir().read().0, cell.rdtr().read().dlc());
    let [low, high] = [cell.rdlr().read().0, cell.rdhr().read().0];
    let is_empty = CAN1.rfr(0).read().fmp() == 0;
    CAN1.rfr(0).write(|w| w.set_rfom(true));
    if is_empty || id & RTR != 0 || length > 8 {
        return None;
    }
    let id = match id & IDE {
        0 => Id::standard((id >> 21) as u16),
        _ => Id::extended(id >> 3),
    };
    let data = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
    Some(Frame::from_parts(id?, length, data))
}

/// Acknowledges a transmission that has ended, and says how. For the transmit interrupt alone.
pub(crate) fn outcome() -> Option<TransmitOutcome> {
    let (outcome, acknowledge) = mailbox::outcome(CAN1.tsr().read().0)?;
    CAN1.tsr().write(|w| w.0 = acknowledge);
    Some(outcome)
}

impl Controller for BxCan {
    type Frame = Frame;

    fn transmit_once(&mut self, frame: &Frame) -> bool {
        if CAN1.tsr().read().0 & EMPTY != EMPTY {
            return false;
        }
        let id = match frame.id().is_extended() {
            false => frame.id().raw() << 21,
            true => frame.id().raw() << 3 | IDE,
        };
        let data = u64::from_le_bytes(frame.buffer());
        let cell = CAN1.tx(0);
        cell.tdtr().write(|w| w.set_dlc(frame.len()));
        cell.tdlr().write(|w| w.0 = data as u32);
        cell.tdhr().write(|w| w.0 = (data >> 32) as u32);
        // With the request.
        cell.tir().write(|w| w.0 = id | 1);
        true
    }

    fn abort(&mut self) {
        CAN1.tsr().write(|w| w.0 = mailbox::ABORT);
    }

    fn silence(&mut self) {
        self.abort();
        // In initialisation mode the cell sends no dominant bit.
        CAN1.mcr().modify(|w| w.set_inrq(true));
    }
}

//! The bxCAN cell in single shot: one mailbox, the outcome of each attempt, the
//! receive FIFO, the error counters and the way back from bus-off.
//!
//! Configuration goes through the `bxcan` crate. The run-time path is written against
//! the registers (RM0390 chapter 30, RM0316 chapter 31; the cell is the same), because
//! a time-triggered node needs what the crate hides: whether a finished attempt was
//! complete, lost arbitration or failed, an abort that does not wait, a receive path
//! without panics whatever length code a frame carries.
//!
//! Settings (thesis 6.2.3.1): no automatic retransmission (NART), transmit order by
//! request (TXFP), receive FIFO not locked, no automatic bus-off management (ABOM off),
//! no automatic wake-up, time-triggered mode off.

pub use bxcan::FilterOwner;
use bxcan::Interrupt;
use ttcan::{BitTiming, Frame, Id};

/// What came out of the receive FIFO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A data frame.
    Data(Frame),
    /// A remote frame, which has no place in a time-triggered schedule.
    Remote(Id),
}

/// How the attempt to send the loaded frame ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Sent and acknowledged.
    Complete,
    /// Another node's frame won the arbitration.
    ArbitrationLost,
    /// A bit, stuff, form or acknowledge error.
    Error,
    /// Withdrawn before it began.
    Aborted,
}

/// Error state of the controller (CAN_ESR).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorState {
    /// Transmit error counter.
    pub transmit: u8,
    /// Receive error counter.
    pub receive: u8,
    /// A counter is at 96 or above.
    pub warning: bool,
    /// A counter is above 127.
    pub passive: bool,
    /// The node is off the bus.
    pub bus_off: bool,
}

/// The mailbox still holds a frame that has neither left nor failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Occupied;

// Register offsets in bytes.
const MCR: usize = 0x000;
const MSR: usize = 0x004;
const TSR: usize = 0x008;
const RF0R: usize = 0x00C;
const IER: usize = 0x014;
const ESR: usize = 0x018;
const TI0R: usize = 0x180;
const TDT0R: usize = 0x184;
const TDL0R: usize = 0x188;
const TDH0R: usize = 0x18C;
const RI0R: usize = 0x1B0;
const RDT0R: usize = 0x1B4;
const RDL0R: usize = 0x1B8;
const RDH0R: usize = 0x1BC;
const FMR: usize = 0x200;
const FM1R: usize = 0x204;
const FS1R: usize = 0x20C;
const FFA1R: usize = 0x214;
const FA1R: usize = 0x21C;
const F0R1: usize = 0x240;
const F0R2: usize = 0x244;

const FMR_FINIT: u32 = 1 << 0;

const MCR_INRQ: u32 = 1 << 0;
const MCR_TXFP: u32 = 1 << 2;
const MCR_NART: u32 = 1 << 4;
/// Running: single shot, order of request, everything else off.
const MCR_RUN: u32 = MCR_NART | MCR_TXFP;

const MSR_INAK: u32 = 1 << 0;
const MSR_ERRI: u32 = 1 << 2;

const TSR_RQCP0: u32 = 1 << 0;
const TSR_TXOK0: u32 = 1 << 1;
const TSR_ALST0: u32 = 1 << 2;
const TSR_TERR0: u32 = 1 << 3;
const TSR_ABRQ0: u32 = 1 << 7;
const TSR_TME0: u32 = 1 << 26;

/// Bits of the identifier registers of mailbox and FIFO.
const TIR_TXRQ: u32 = 1 << 0;
const TIR_RTR: u32 = 1 << 1;
const TIR_IDE: u32 = 1 << 2;

const RF0R_FMP: u32 = 0b11;
const RF0R_FOVR: u32 = 1 << 4;
const RF0R_RFOM: u32 = 1 << 5;

const IER_BOFIE: u32 = 1 << 10;
const IER_ERRIE: u32 = 1 << 15;

const ESR_WARNING: u32 = 1 << 0;
const ESR_PASSIVE: u32 = 1 << 1;
const ESR_BUS_OFF: u32 = 1 << 2;

/// The CAN port of a sled.
pub struct Port<I: FilterOwner> {
    can: bxcan::Can<I>,
}

impl<I: FilterOwner> Port<I> {
    /// Configures the cell and asks it to join the bus, which it does after eleven
    /// recessive bits; nothing waits for that.
    ///
    /// Every frame on the bus is accepted into FIFO 0: each node supervises the schedule
    /// of all the others.
    pub fn new(instance: I, timing: BitTiming) -> Self {
        let mut can = bxcan::Can::builder(instance)
            .set_bit_timing(timing.register())
            .set_automatic_retransmit(false)
            .leave_disabled();
        can.enable_interrupt(Interrupt::Fifo0MessagePending);
        can.enable_interrupt(Interrupt::TransmitMailboxEmpty);
        let mut port = Self { can };
        port.accept_all();
        // The crate has no name for the bus-off interrupt.
        let enabled = port.read(IER);
        port.write(IER, enabled | IER_BOFIE | IER_ERRIE);
        port.write(MCR, MCR_RUN);
        port
    }

    /// Filter bank 0 as one 32-bit mask that asks for nothing, into FIFO 0. The crate's own
    /// way checks the bank's number at run time and could panic.
    fn accept_all(&mut self) {
        let mode = self.read(FMR);
        self.write(FMR, mode | FMR_FINIT);
        for (register, set) in [(FM1R, false), (FS1R, true), (FFA1R, false), (FA1R, true)] {
            let banks = self.read(register) & !1;
            if register == FA1R {
                self.write(F0R1, 0);
                self.write(F0R2, 0);
            }
            self.write(register, banks | u32::from(set));
        }
        self.write(FMR, mode & !FMR_FINIT);
    }

    /// Takes the oldest frame out of the FIFO; `None` when it is empty.
    #[inline]
    pub fn receive(&mut self) -> Option<Received> {
        if self.read(RF0R) & RF0R_FMP == 0 {
            return None;
        }
        let identifier = self.read(RI0R);
        let length = (self.read(RDT0R) & 0xF) as u8;
        let [a, b, c, d] = self.read(RDL0R).to_le_bytes();
        let [e, f, g, h] = self.read(RDH0R).to_le_bytes();
        self.write(RF0R, RF0R_RFOM);
        // Both fields are as wide as the identifiers, so neither is ever `None`.
        let id = if identifier & TIR_IDE == 0 {
            Id::standard((identifier >> 21) as u16)
        } else {
            Id::extended(identifier >> 3)
        }?;
        Some(if identifier & TIR_RTR == 0 {
            Received::Data(Frame::from_parts(id, length, [a, b, c, d, e, f, g, h]))
        } else {
            Received::Remote(id)
        })
    }

    /// Whether the FIFO lost a frame since the last call.
    #[inline]
    pub fn take_overrun(&mut self) -> bool {
        let lost = self.read(RF0R) & RF0R_FOVR != 0;
        if lost {
            self.write(RF0R, RF0R_FOVR);
        }
        lost
    }

    /// Loads the mailbox and requests transmission: on an idle bus the frame starts with
    /// the next bit, otherwise when the bus falls idle.
    ///
    /// # Errors
    /// [`Occupied`] while an earlier frame is pending.
    #[inline]
    pub fn load(&mut self, frame: &Frame) -> Result<(), Occupied> {
        if self.read(TSR) & TSR_TME0 == 0 {
            return Err(Occupied);
        }
        let [a, b, c, d, e, f, g, h] = frame.buffer();
        let id = frame.id();
        let identifier = if id.is_extended() {
            id.raw() << 3 | TIR_IDE
        } else {
            id.raw() << 21
        };
        // Whole words: a TGT bit left from before would overwrite the last two bytes.
        self.write(TDT0R, u32::from(frame.len()));
        self.write(TDL0R, u32::from_le_bytes([a, b, c, d]));
        self.write(TDH0R, u32::from_le_bytes([e, f, g, h]));
        self.write(TI0R, identifier | TIR_TXRQ);
        Ok(())
    }

    /// Asks to withdraw the pending frame. One that is already on the bus is finished;
    /// either way [`Port::outcome`] tells.
    #[inline]
    pub fn abort(&mut self) {
        self.write(TSR, TSR_ABRQ0);
    }

    /// Acknowledges a finished attempt and says how it ended; `None` when none has ended
    /// since the last call.
    #[inline]
    pub fn outcome(&mut self) -> Option<Outcome> {
        let status = self.read(TSR);
        if status & TSR_RQCP0 == 0 {
            return None;
        }
        self.write(TSR, TSR_RQCP0);
        Some(if status & TSR_TXOK0 != 0 {
            Outcome::Complete
        } else if status & TSR_ALST0 != 0 {
            Outcome::ArbitrationLost
        } else if status & TSR_TERR0 != 0 {
            Outcome::Error
        } else {
            Outcome::Aborted
        })
    }

    /// The error counters and states as they are now.
    #[inline]
    pub fn error_state(&self) -> ErrorState {
        let status = self.read(ESR);
        ErrorState {
            transmit: (status >> 16) as u8,
            receive: (status >> 24) as u8,
            warning: status & ESR_WARNING != 0,
            passive: status & ESR_PASSIVE != 0,
            bus_off: status & ESR_BUS_OFF != 0,
        }
    }

    /// Acknowledges the status-change interrupt.
    #[inline]
    pub fn acknowledge_error(&mut self) {
        self.write(MSR, MSR_ERRI);
    }

    /// Leaves the bus: enters initialisation, in which the cell sends no dominant bit, and
    /// drops a pending frame. First half of the recovery from bus-off.
    pub fn leave_bus(&mut self) {
        self.write(MCR, MCR_RUN | MCR_INRQ);
    }

    /// Second half: once the cell is in initialisation, lets it go. It takes part again
    /// after eleven recessive bits, after bus-off 128 times that. Returns false, and does
    /// nothing, while it is not there yet.
    pub fn join_bus(&mut self) -> bool {
        let there = self.read(MSR) & MSR_INAK != 0;
        if there {
            self.write(MCR, MCR_RUN);
        }
        there
    }

    /// The peripheral and its pins.
    pub fn instance(&mut self) -> &mut I {
        self.can.instance()
    }

    #[inline]
    fn read(&self, offset: usize) -> u32 {
        // SAFETY: an aligned register inside the block that `self` owns.
        unsafe {
            I::REGISTERS
                .cast::<u8>()
                .add(offset)
                .cast::<u32>()
                .read_volatile()
        }
    }

    #[inline]
    fn write(&mut self, offset: usize, value: u32) {
        // SAFETY: an aligned register inside the block that `self` owns.
        unsafe {
            I::REGISTERS
                .cast::<u8>()
                .add(offset)
                .cast::<u32>()
                .write_volatile(value);
        }
    }
}

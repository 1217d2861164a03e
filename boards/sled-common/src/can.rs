//! The bxCAN cell in single shot: one mailbox, or three by identifier, the outcome of each attempt,
//! the receive FIFO, the error counters and the way back from bus-off.
//!
//! Configuration goes through the `bxcan` crate. The run-time path is written against the
//! registers (RM0390 chapter 30, RM0316 chapter 31; the cell is the same in both), because the
//! crate does not offer what a time-triggered node needs: the outcome of a finished attempt
//! (complete, arbitration lost or failed), an abort that does not wait, and a receive path that
//! cannot panic, whatever length code a frame carries.
//!
//! Settings (thesis 6.2.3.1): no automatic retransmission (NART), transmit order by
//! request (TXFP), receive FIFO not locked, no automatic bus-off management (ABOM off),
//! no automatic wake-up, time-triggered mode off.

pub use bxcan::FilterOwner;
use bxcan::Interrupt;
use core::marker::PhantomData;
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

/// A register of the cell that is used at run time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Register {
    /// Master control.
    Mcr,
    /// Master status.
    Msr,
    /// Transmit status.
    Tsr,
    /// Receive FIFO 0.
    Rf0r,
    /// Interrupt enable.
    Ier,
    /// Error status.
    Esr,
    /// Bit timing.
    Btr,
    /// Identifier of mailbox 0.
    Ti0r,
    /// Length of mailbox 0.
    Tdt0r,
    /// Bytes 0 to 3 of mailbox 0.
    Tdl0r,
    /// Bytes 4 to 7 of mailbox 0.
    Tdh0r,
    /// Identifier of the oldest frame in FIFO 0.
    Ri0r,
    /// Length of the oldest frame in FIFO 0.
    Rdt0r,
    /// Bytes 0 to 3 of the oldest frame in FIFO 0.
    Rdl0r,
    /// Bytes 4 to 7 of the oldest frame in FIFO 0.
    Rdh0r,
    /// Filter control.
    Fmr,
    /// Filter mode: mask or list.
    Fm1r,
    /// Filter scale.
    Fs1r,
    /// FIFO of each filter.
    Ffa1r,
    /// Filters that are active.
    Fa1r,
    /// First word of filter bank 0.
    F0r1,
    /// Second word of filter bank 0.
    F0r2,
}

/// The registers of a cell, as the board's peripheral access crate knows them.
///
/// The crates of the two parts are of different generations: one has fields where the other has
/// functions, so no code compiles against both. This trait has the part that they share.
///
/// # Safety
/// The address is that of a register of the cell that the port owns.
pub unsafe trait Registers {
    /// The address of a register.
    fn address(register: Register) -> *mut u32;
}

const FMR_FINIT: u32 = 1 << 0;

const MCR_INRQ: u32 = 1 << 0;
const MCR_TXFP: u32 = 1 << 2;
const MCR_NART: u32 = 1 << 4;
const MCR_RESET: u32 = 1 << 15;
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
/// Bits from the status of one mailbox to that of the next, in the low three bytes.
const TSR_STRIDE: usize = 8;

/// Words from the registers of one mailbox to those of the next.
const MAILBOX_WORDS: usize = 4;
/// Words from the registers of one filter bank to those of the next.
const BANK_WORDS: usize = 2;
/// Identifiers in a filter bank that lists standard ones.
const LISTED: usize = 4;
/// Identifiers that [`Port::accept_only`] takes: those of 14 filter banks, which the first cell of
/// every part has.
pub const ACCEPTED: usize = 14 * LISTED;
/// Transmit mailboxes of a cell.
pub const MAILBOXES: usize = 3;

/// Bits of the identifier registers of mailbox and FIFO.
const TIR_TXRQ: u32 = 1 << 0;
const TIR_RTR: u32 = 1 << 1;
const TIR_IDE: u32 = 1 << 2;

const BTR_LBKM: u32 = 1 << 30;
const BTR_SILM: u32 = 1 << 31;

/// How often a flag is polled in the loop-back test. A poll takes ten cycles or more. The longest
/// wait takes 600 us: for a frame of 135 bits, the cell's own or one on the bus.
const LOOP_BACK_POLLS: u32 = 40_000;

/// The frame of the loop-back test: every bit of the data takes both levels.
const LOOP_BACK: [u8; 8] = [0x55, 0xAA, 0x00, 0xFF, 0x0F, 0xF0, 0x33, 0xCC];

const RF0R_FMP: u32 = 0b11;
const RF0R_FOVR: u32 = 1 << 4;
const RF0R_RFOM: u32 = 1 << 5;

const IER_BOFIE: u32 = 1 << 10;
const IER_ERRIE: u32 = 1 << 15;

const ESR_WARNING: u32 = 1 << 0;
const ESR_PASSIVE: u32 = 1 << 1;
const ESR_BUS_OFF: u32 = 1 << 2;

/// The CAN port of a sled: the cell `I` with the registers `R`.
pub struct Port<I: FilterOwner, R: Registers> {
    can: bxcan::Can<I>,
    looped: Option<bool>,
    registers: PhantomData<R>,
}

impl<I: FilterOwner, R: Registers> Port<I, R> {
    /// Configures the cell, tests it in internal loop-back, and asks it to join the bus. The cell
    /// joins after eleven recessive bits; this function does not wait for that. A `silent` cell
    /// only listens: it sends no dominant bit, not even in an acknowledge slot or an error flag.
    ///
    /// Every frame on the bus is accepted into FIFO 0: each node supervises the schedule
    /// of all the others.
    pub fn new(instance: I, timing: BitTiming, silent: bool) -> Self {
        let can = bxcan::Can::builder(instance)
            .set_bit_timing(timing.register())
            .set_silent(silent)
            .set_automatic_retransmit(false)
            .leave_disabled();
        let mut port = Self {
            can,
            looped: None,
            registers: PhantomData,
        };
        port.accept_all();
        port.looped = port.loops_back();
        port.can.enable_interrupt(Interrupt::Fifo0MessagePending);
        port.can.enable_interrupt(Interrupt::TransmitMailboxEmpty);
        // The crate has no name for the bus-off interrupt.
        let enabled = port.read(Register::Ier);
        port.write(Register::Ier, enabled | IER_BOFIE | IER_ERRIE);
        port.write(Register::Mcr, MCR_RUN);
        port
    }

    /// Whether the cell received its own frame in internal loop-back when it was configured. `None`
    /// if that could not be tested, because the cell did not leave initialisation: its receive
    /// pin was dominant.
    pub const fn has_looped_back(&self) -> Option<bool> {
        self.looped
    }

    /// Sends a frame to itself, and leaves loop-back again. Ends in initialisation mode.
    ///
    /// In loop-back and silent mode the cell neither drives its pin nor takes frames from it (RM0390
    /// 30.5.3, RM0316 31.5.3). But it leaves initialisation only after eleven recessive bits, and
    /// the manuals do not say that these come from the loop: INAK is cleared by recessive bits "on
    /// the CAN RX signal" (RM0390 30.9.2). Users report that in loop-back too it stays set while the
    /// pin is low. So a bus that is held dominant, or a low pin without a transceiver, may hinder
    /// the test. That tells nothing about the cell, and the result is `None`.
    fn loops_back(&mut self) -> Option<bool> {
        // The cell sleeps, and takes a mode only while it initialises.
        self.write(Register::Mcr, MCR_RUN | MCR_INRQ);
        if !self.poll(Register::Msr, MSR_INAK, MSR_INAK) {
            return Some(false);
        }
        let timing = self.read(Register::Btr);
        self.write(Register::Btr, timing | BTR_LBKM | BTR_SILM);
        self.write(Register::Mcr, MCR_RUN);
        let joined = self.poll(Register::Msr, MSR_INAK, 0);
        let heard = joined && self.hears_itself();
        let left = self.leave_loop_back(timing);
        (joined || !left).then_some(heard && left)
    }

    /// Whether a frame that the cell sends comes back to it.
    fn hears_itself(&mut self) -> bool {
        let frame = Id::standard(0x555).map(|id| Frame::from_parts(id, 8, LOOP_BACK));
        let sent = frame.is_some_and(|frame| self.load(&frame).is_ok())
            && self.poll(Register::Tsr, TSR_RQCP0, TSR_RQCP0)
            && self.outcome() == Some(Outcome::Complete);
        match (self.receive(), frame) {
            (Some(Received::Data(received)), Some(frame)) => sent && received == frame,
            _ => false,
        }
    }

    /// Takes the cell out of loop-back: `timing` is CAN_BTR without it. False if the cell had to be
    /// reset for that, because it did not enter initialisation mode. Such a cell is broken: it could
    /// not recover from bus-off either.
    fn leave_loop_back(&mut self, timing: u32) -> bool {
        self.write(Register::Tsr, TSR_ABRQ0);
        let left = self.initialise_with(timing);
        if !left {
            self.write(Register::Mcr, MCR_RESET);
            self.initialise_with(timing);
        }
        left
    }

    /// Enters initialisation mode and sets CAN_BTR, which the cell takes over in this mode only.
    /// INAK alone does not show this mode: it is also set while the cell waits for recessive bits.
    /// Nor does CAN_BTR alone: it may have the value already. So this writes again until the cell
    /// keeps the value and INAK is set, for a bounded time.
    fn initialise_with(&mut self, timing: u32) -> bool {
        self.write(Register::Mcr, MCR_RUN | MCR_INRQ);
        (0..LOOP_BACK_POLLS).any(|_| {
            self.write(Register::Btr, timing);
            self.read(Register::Btr) == timing && self.read(Register::Msr) & MSR_INAK != 0
        })
    }

    /// Waits until the bits `mask` of a register are `wanted`, for a bounded time.
    fn poll(&self, register: Register, mask: u32, wanted: u32) -> bool {
        (0..LOOP_BACK_POLLS).any(|_| self.read(register) & mask == wanted)
    }

    /// Sets filter bank 0 to one 32-bit mask that ignores all bits, into FIFO 0. The crate's
    /// own function checks the bank's number at run time and could panic.
    fn accept_all(&mut self) {
        let mode = self.read(Register::Fmr);
        self.write(Register::Fmr, mode | FMR_FINIT);
        for (register, set) in [
            (Register::Fm1r, false),
            (Register::Fs1r, true),
            (Register::Ffa1r, false),
            (Register::Fa1r, true),
        ] {
            let banks = self.read(register) & !1;
            if register == Register::Fa1r {
                self.write(Register::F0r1, 0);
                self.write(Register::F0r2, 0);
            }
            self.write(register, banks | u32::from(set));
        }
        self.write(Register::Fmr, mode & !FMR_FINIT);
    }

    /// Accepts data frames with these standard identifiers only: others on the bus cost the node
    /// nothing. With no identifier, or more than [`ACCEPTED`], every frame is accepted as before.
    pub fn accept_only(&mut self, ids: &[u16]) {
        let Some(first) = ids.first().filter(|_| ids.len() <= ACCEPTED) else {
            return;
        };
        // Half a word of a list: the identifier, of no remote frame (RM0390 30.7.4, RM0316 31.7.4).
        // A place that is left over repeats the first one.
        let entry = |at: usize| u32::from(*ids.get(at).unwrap_or(first)) << 5;
        let pair = |at: usize| entry(at) | entry(at + 1) << 16;
        let banks = ids.len().div_ceil(LISTED);
        let used = (1 << banks) - 1;
        let mode = self.read(Register::Fmr);
        self.write(Register::Fmr, mode | FMR_FINIT);
        for (register, set) in [
            (Register::Fm1r, true),
            (Register::Fs1r, false),
            (Register::Ffa1r, false),
        ] {
            let others = self.read(register) & !used;
            self.write(register, others | if set { used } else { 0 });
        }
        for bank in 0..banks {
            self.write_bank(bank, Register::F0r1, pair(LISTED * bank));
            self.write_bank(bank, Register::F0r2, pair(LISTED * bank + 2));
        }
        let active = self.read(Register::Fa1r);
        self.write(Register::Fa1r, active | used);
        self.write(Register::Fmr, mode & !FMR_FINIT);
    }

    /// Takes the oldest frame out of the FIFO; `None` when it is empty.
    #[inline]
    pub fn receive(&mut self) -> Option<Received> {
        if self.read(Register::Rf0r) & RF0R_FMP == 0 {
            return None;
        }
        let identifier = self.read(Register::Ri0r);
        let length = (self.read(Register::Rdt0r) & 0xF) as u8;
        let [a, b, c, d] = self.read(Register::Rdl0r).to_le_bytes();
        let [e, f, g, h] = self.read(Register::Rdh0r).to_le_bytes();
        self.write(Register::Rf0r, RF0R_RFOM);
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
        let lost = self.read(Register::Rf0r) & RF0R_FOVR != 0;
        if lost {
            self.write(Register::Rf0r, RF0R_FOVR);
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
        self.load_into(0, frame)
    }

    /// The same for one of the [`MAILBOXES`]. Which of the loaded frames goes first is a matter of
    /// [`Port::order_by_identifier`].
    ///
    /// # Errors
    /// [`Occupied`] while an earlier frame is pending in it, or if there is no such mailbox.
    #[inline]
    pub fn load_into(&mut self, mailbox: usize, frame: &Frame) -> Result<(), Occupied> {
        if mailbox >= MAILBOXES || self.read(Register::Tsr) & TSR_TME0 << mailbox == 0 {
            return Err(Occupied);
        }
        let [a, b, c, d, e, f, g, h] = frame.buffer();
        let id = frame.id();
        let identifier = if id.is_extended() {
            id.raw() << 3 | TIR_IDE
        } else {
            id.raw() << 21
        };
        // Written as whole words: a TGT bit left from before would overwrite the last two
        // bytes.
        self.write_to(mailbox, Register::Tdt0r, u32::from(frame.len()));
        self.write_to(mailbox, Register::Tdl0r, u32::from_le_bytes([a, b, c, d]));
        self.write_to(mailbox, Register::Tdh0r, u32::from_le_bytes([e, f, g, h]));
        self.write_to(mailbox, Register::Ti0r, identifier | TIR_TXRQ);
        Ok(())
    }

    /// Lets the lowest identifier among the loaded mailboxes go first, and not the oldest request.
    /// [`Port::leave_bus`] and [`Port::join_bus`] end this.
    pub fn order_by_identifier(&mut self) {
        self.write(Register::Mcr, MCR_RUN & !MCR_TXFP);
    }

    /// Asks to withdraw the pending frame. A frame that is already on the bus is completed.
    /// [`Port::outcome`] tells which of the two happened.
    #[inline]
    pub fn abort(&mut self) {
        self.write(Register::Tsr, TSR_ABRQ0);
    }

    /// The same for one of the [`MAILBOXES`].
    #[inline]
    pub fn abort_in(&mut self, mailbox: usize) {
        if mailbox < MAILBOXES {
            self.write(Register::Tsr, TSR_ABRQ0 << (TSR_STRIDE * mailbox));
        }
    }

    /// Acknowledges a finished attempt and says how it ended; `None` when none has ended
    /// since the last call.
    #[inline]
    pub fn outcome(&mut self) -> Option<Outcome> {
        self.outcome_in(0)
    }

    /// The same for one of the [`MAILBOXES`].
    #[inline]
    pub fn outcome_in(&mut self, mailbox: usize) -> Option<Outcome> {
        if mailbox >= MAILBOXES {
            return None;
        }
        let status = self.read(Register::Tsr) >> (TSR_STRIDE * mailbox);
        if status & TSR_RQCP0 == 0 {
            return None;
        }
        self.write(Register::Tsr, TSR_RQCP0 << (TSR_STRIDE * mailbox));
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
        let status = self.read(Register::Esr);
        ErrorState {
            transmit: (status >> 16) as u8,
            receive: (status >> 24) as u8,
            warning: status & ESR_WARNING != 0,
            passive: status & ESR_PASSIVE != 0,
            bus_off: status & ESR_BUS_OFF != 0,
        }
    }

    /// Whether the cell has seen an error on the bus since the last call: its last error code, of
    /// which 7 means that the program has set it.
    pub fn take_error(&mut self) -> bool {
        let code = self.read(Register::Esr) >> 4 & 0b111;
        self.write(Register::Esr, 0b111 << 4);
        !matches!(code, 0 | 0b111)
    }

    /// Acknowledges the status-change interrupt.
    #[inline]
    pub fn acknowledge_error(&mut self) {
        self.write(Register::Msr, MSR_ERRI);
    }

    /// First half of the recovery from bus-off: withdraws a pending frame and leaves the bus. The
    /// cell enters initialisation mode, in which it sends no dominant bit. That mode alone keeps
    /// the request, and the frame would go out as soon as the cell joins again.
    pub fn leave_bus(&mut self) {
        self.abort();
        self.write(Register::Mcr, MCR_RUN | MCR_INRQ);
    }

    /// Second half: releases the cell from initialisation mode. The cell takes part again after
    /// eleven recessive bits, or after 128 times eleven if it was bus-off. Returns false, and
    /// changes nothing, while the cell has not entered initialisation mode yet. A `silent` cell
    /// only listens.
    pub fn join_bus(&mut self, silent: bool) -> bool {
        let there = self.read(Register::Msr) & MSR_INAK != 0;
        if there {
            let timing = self.read(Register::Btr) & !BTR_SILM;
            let mode = if silent { BTR_SILM } else { 0 };
            self.write(Register::Btr, timing | mode);
            self.write(Register::Mcr, MCR_RUN);
        }
        there
    }

    /// The peripheral and its pins.
    pub fn instance(&mut self) -> &mut I {
        self.can.instance()
    }

    #[inline(always)]
    fn read(&self, register: Register) -> u32 {
        // SAFETY: a register of the cell that `self` owns.
        unsafe { R::address(register).read_volatile() }
    }

    /// Writes the register of a mailbox that `register` names for mailbox 0.
    #[inline(always)]
    fn write_to(&mut self, mailbox: usize, register: Register, value: u32) {
        let address = R::address(register).wrapping_add(MAILBOX_WORDS * mailbox);
        // SAFETY: a register of the cell that `self` owns: the caller has checked the mailbox.
        unsafe { address.write_volatile(value) }
    }

    /// Writes the register of a filter bank that `register` names for bank 0.
    fn write_bank(&mut self, bank: usize, register: Register, value: u32) {
        let address = R::address(register).wrapping_add(BANK_WORDS * bank);
        // SAFETY: a register of the cell that `self` owns, for the caller has no more banks than it.
        unsafe { address.write_volatile(value) }
    }

    #[inline(always)]
    fn write(&mut self, register: Register, value: u32) {
        // SAFETY: a register of the cell that `self` owns.
        unsafe { R::address(register).write_volatile(value) }
    }
}

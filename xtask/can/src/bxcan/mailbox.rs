//! Transmit mailboxes (RM0390, bxCAN, "Transmission handling").

use embedded_can::{ExtendedId, Id, StandardId};

use super::registers::{ir, tdtr};
use crate::Frame;
use crate::time::Ps;

/// One transmit mailbox with its four registers and its bits of TSR.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mailbox {
    tir: u32,
    tdtr: u32,
    data: [u32; 2],
    request: Option<Request>,
    /// The time from which the request is to be aborted.
    aborting: Option<Ps>,
    completed: bool,
    succeeded: bool,
    arbitration_lost: bool,
    failed: bool,
}

#[derive(Clone, Copy, Debug)]
struct Request {
    at: Ps,
    /// Number of the request among those of the controller, for the order of TXFP.
    order: u64,
}

impl Mailbox {
    pub(crate) const fn is_empty(&self) -> bool {
        self.request.is_none()
    }

    /// When transmission was requested, unless an abort has been requested before `now`.
    pub(crate) fn requested_at(&self, now: Ps) -> Option<Ps> {
        self.request
            .filter(|_| self.aborting.is_none_or(|from| now < from))
            .map(|request| request.at)
    }

    /// Position in the chronological order of requests.
    pub(crate) fn order(&self) -> u64 {
        self.request.map_or(u64::MAX, |request| request.order)
    }

    /// Position in the order of arbitration: the bits as they compete on the bus.
    pub(crate) const fn urgency(&self) -> u32 {
        let base = self.tir >> 21;
        let remote = self.tir >> 1 & 1;
        if self.tir & ir::IDE == 0 {
            base << 21 | remote << 20
        } else {
            base << 21 | 0b11 << 19 | (self.tir >> 3 & 0x3_FFFF) << 1 | remote
        }
    }

    pub(crate) const fn read(&self, register: u32) -> u32 {
        match register {
            0 => self.tir,
            1 => self.tdtr,
            2 => self.data[0],
            _ => self.data[1],
        }
    }

    /// Writes one of the four registers; ignored while a request is pending. True if the write
    /// requests transmission.
    pub(crate) fn write(&mut self, register: u32, value: u32) -> bool {
        if self.request.is_some() {
            return false;
        }
        match register {
            0 => {
                self.tir = value;
                return value & ir::TXRQ != 0;
            }
            1 => self.tdtr = value & tdtr::WRITABLE,
            2 => self.data[0] = value,
            _ => self.data[1] = value,
        }
        false
    }

    pub(crate) fn request(&mut self, at: Ps, order: u64) {
        self.request = Some(Request { at, order });
        self.clear_status();
    }

    fn clear_status(&mut self) {
        self.completed = false;
        self.succeeded = false;
        self.arbitration_lost = false;
        self.failed = false;
    }

    /// The frame to send. If the mailbox requests a time stamp, `stamp` replaces the last two data
    /// bytes of an eight-byte frame.
    pub(crate) fn frame(&self, stamp: Option<u16>) -> Option<Frame> {
        let id = if self.tir & ir::IDE == 0 {
            Id::Standard(StandardId::new((self.tir >> 21) as u16)?)
        } else {
            Id::Extended(ExtendedId::new(self.tir >> 3)?)
        };
        let dlc = (self.tdtr & 0xF) as u8;
        let remote = self.tir & ir::RTR != 0;
        let mut bytes = [0; 8];
        bytes[..4].copy_from_slice(&self.data[0].to_le_bytes());
        bytes[4..].copy_from_slice(&self.data[1].to_le_bytes());
        if let Some(stamp) = stamp
            && self.tdtr & tdtr::TGT != 0
            && dlc >= 8
        {
            bytes[6..].copy_from_slice(&stamp.to_be_bytes());
        }
        let len = if remote { 0 } else { usize::from(dlc.min(8)) };
        Frame::from_parts(id, remote, dlc, &bytes[..len])
    }

    /// Stores the time stamp of the start of frame in TDTxR.
    pub(crate) fn stamp(&mut self, stamp: u16) {
        self.tdtr = self.tdtr & 0xFFFF | u32::from(stamp) << 16;
    }

    /// Requests an abort at the end of the frame that is being sent.
    pub(crate) fn abort_later(&mut self, at: Ps) {
        if self.request.is_some() {
            self.aborting.get_or_insert(at);
        }
    }

    pub(crate) const fn is_aborting(&self) -> bool {
        self.aborting.is_some()
    }

    /// Ends the request without a transmission.
    pub(crate) fn finish_abort(&mut self) {
        if self.request.is_some() {
            self.succeeded = false;
            self.finish();
        }
    }

    fn finish(&mut self) {
        self.request = None;
        self.aborting = None;
        self.completed = true;
        self.tir &= !ir::TXRQ;
    }

    pub(crate) fn transmitted(&mut self) {
        self.arbitration_lost = false;
        self.failed = false;
        self.succeeded = true;
        self.finish();
    }

    /// Records a failed attempt. It was the last one if `single_shot` is set or an abort is
    /// pending.
    pub(crate) fn attempt_failed(&mut self, by_arbitration: bool, single_shot: bool) {
        self.succeeded = false;
        self.arbitration_lost = by_arbitration;
        self.failed = !by_arbitration;
        if single_shot || self.aborting.is_some() {
            self.finish();
        }
    }

    /// RQCP, TXOK, ALST, TERR and ABRQ of this mailbox, shifted into the low byte.
    pub(crate) fn status(&self) -> u32 {
        u32::from(self.completed)
            | u32::from(self.succeeded) << 1
            | u32::from(self.arbitration_lost) << 2
            | u32::from(self.failed) << 3
            | u32::from(self.aborting.is_some()) << 7
    }

    pub(crate) const fn is_completed(&self) -> bool {
        self.completed
    }

    /// Writes ones to the status bits.
    pub(crate) fn acknowledge(&mut self, bits: u32) {
        if bits & 1 != 0 {
            self.clear_status();
        }
        if bits & 2 != 0 {
            self.succeeded = false;
        }
        if bits & 4 != 0 {
            self.arbitration_lost = false;
        }
        if bits & 8 != 0 {
            self.failed = false;
        }
    }
}

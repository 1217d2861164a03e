//! Receive FIFOs (RM0390, bxCAN, "Reception handling").

use super::registers::rfr;

/// Messages that fit into a FIFO.
const DEPTH: usize = 3;

/// A received message as the four registers of a receive mailbox show it: RIxR, RDTxR, RDLxR,
/// RDHxR.
pub(crate) type Stored = [u32; 4];

/// One receive FIFO.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fifo {
    messages: [Stored; DEPTH],
    pending: usize,
    full: bool,
    overrun: bool,
}

impl Fifo {
    /// Stores a message. If the FIFO is full, the message is dropped (`locked`) or replaces the
    /// newest one.
    pub(crate) fn store(&mut self, message: Stored, locked: bool) {
        if self.pending < DEPTH {
            self.messages[self.pending] = message;
            self.pending += 1;
            self.full |= self.pending == DEPTH;
        } else {
            self.overrun = true;
            if !locked {
                self.messages[DEPTH - 1] = message;
            }
        }
    }

    /// RFxR.
    pub(crate) fn status(&self) -> u32 {
        let mut value = self.pending as u32;
        if self.full {
            value |= rfr::FULL;
        }
        if self.overrun {
            value |= rfr::FOVR;
        }
        value
    }

    /// Write to RFxR: clears flags, releases the oldest message.
    pub(crate) fn control(&mut self, value: u32) {
        if value & rfr::FULL != 0 {
            self.full = false;
        }
        if value & rfr::FOVR != 0 {
            self.overrun = false;
        }
        if value & rfr::RFOM != 0 && self.pending > 0 {
            self.messages.rotate_left(1);
            self.pending -= 1;
        }
    }

    /// One of the output mailbox's registers.
    pub(crate) fn output(&self, register: usize) -> u32 {
        self.messages[0][register]
    }
}

//! A node behind a CAN controller whose driver has the frame type of `embedded-can`.
//!
//! `embedded_can::nb::Can` and `embedded_can::blocking::Can` send and receive frames, which is not
//! enough for a time-triggered node:
//!
//! * They do not say whether a frame is repeated after an error or lost arbitration. A node needs
//!   one attempt, and [how it ended](TransmitOutcome), because a repeated frame would be in another
//!   node's window.
//! * They do not say when a frame was on the bus. A node needs the stamp of its end, taken in the
//!   interrupt.
//! * They cannot withdraw a frame, or leave the bus.
//!
//! So the driver of a controller implements [`Controller`], and only the frames are those of
//! `embedded-can`.

use crate::frame::Frame;
use crate::id::Id;
use crate::node::{Action, Grant, Node, Reception, TransmitOutcome};
use crate::time::Stamp;

impl From<Id> for embedded_can::Id {
    fn from(id: Id) -> Self {
        // Both kinds hold the same range, so the identifier always fits.
        if id.is_extended() {
            let raw = embedded_can::ExtendedId::new(id.raw());
            Self::Extended(raw.unwrap_or(embedded_can::ExtendedId::MAX))
        } else {
            let raw = embedded_can::StandardId::new(id.raw() as u16);
            Self::Standard(raw.unwrap_or(embedded_can::StandardId::MAX))
        }
    }
}

impl From<embedded_can::Id> for Id {
    fn from(id: embedded_can::Id) -> Self {
        // Not by a constructor that can fail: an identifier of `embedded-can` is in range.
        match id {
            embedded_can::Id::Standard(id) => Self::of_standard_bits(id.as_raw()),
            embedded_can::Id::Extended(id) => Self::of_extended_bits(id.as_raw()),
        }
    }
}

impl embedded_can::Frame for Frame {
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
        Self::new(id.into().into(), data).ok()
    }

    /// Always `None`: a time-triggered schedule has no windows for remote frames.
    fn new_remote(_: impl Into<embedded_can::Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        self.id().is_extended()
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        self.id().into()
    }

    fn dlc(&self) -> usize {
        usize::from(self.len())
    }

    fn data(&self) -> &[u8] {
        self.data()
    }
}

impl Frame {
    /// The data frame that a driver received. `None` for a remote frame, and for a data length code
    /// above 8: that is 8 bytes on the bus, but drivers differ in what they make of it. No node of a
    /// matrix sends either.
    ///
    /// The frames of `bxcan` 0.8 panic with such a code, also when they are asked for it. Its
    /// owner must drop them before.
    pub fn from_can(frame: &impl embedded_can::Frame) -> Option<Self> {
        if frame.is_remote_frame() || frame.dlc() > 8 {
            return None;
        }
        Self::new(frame.id().into(), frame.data()).ok()
    }

    /// This frame as the driver's type. `None` if that type refuses it, for example because it has
    /// only 11-bit identifiers.
    pub fn to_can<F: embedded_can::Frame>(&self) -> Option<F> {
        F::new(self.id(), self.data())
    }
}

/// What a node needs of a CAN controller. All functions return at once.
pub trait Controller {
    /// The driver's frames.
    type Frame: embedded_can::Frame;

    /// Requests one transmission, without automatic retransmission. False if a frame is pending
    /// still.
    ///
    /// The end of the transmission, whatever it was, is an interrupt, in which the owner calls
    /// [`Driver::handle_transmit`].
    fn transmit_once(&mut self, frame: &Self::Frame) -> bool;

    /// Asks to withdraw the pending frame, unless it is on the bus already. Does not wait: the
    /// transmission ends with an interrupt, as any other.
    fn abort(&mut self);

    /// Withdraws everything and leaves the bus. The controller sends no dominant bit, not even in
    /// an acknowledge slot.
    fn silence(&mut self);
}

/// A node and its controller. The three interrupts of one priority call one function each, and then
/// set the timer to [`Driver::next_deadline`]:
///
/// | interrupt | call |
/// | --- | --- |
/// | frame received | [`Driver::handle_receive`] |
/// | transmission ended | [`Driver::handle_transmit`] |
/// | the timer reached the deadline | [`Driver::handle_timer`] |
///
/// The timer fires at once if its deadline has passed. None of the functions has a loop.
#[derive(Debug)]
pub struct Driver<'s, C, const W: usize, const P: usize, const Q: usize> {
    /// The node, for its state, its times and its event messages.
    pub node: Node<'s, W, P, Q>,
    /// The controller.
    pub controller: C,
    refused: bool,
}

impl<'s, C: Controller, const W: usize, const P: usize, const Q: usize> Driver<'s, C, W, P, Q> {
    /// A node that does nothing until [`Node::start`].
    pub const fn new(node: Node<'s, W, P, Q>, controller: C) -> Self {
        Self {
            node,
            controller,
            refused: false,
        }
    }

    /// A frame was received; `stamp` was taken at its end. `None` if the node cannot use it, see
    /// [`Frame::from_can`].
    pub fn handle_receive(&mut self, frame: &C::Frame, stamp: Stamp) -> Option<Reception> {
        let frame = Frame::from_can(frame)?;
        Some(self.node.handle_receive(&frame, stamp))
    }

    /// The transmission that was requested last has ended; `stamp` was taken at its end.
    pub fn handle_transmit(&mut self, outcome: TransmitOutcome, stamp: Stamp) {
        self.node.handle_transmit(outcome, stamp);
    }

    /// The timer reached the deadline: does one thing that is due. `message` has the data of a
    /// granted window, or `None` to leave it empty. Of 8 bytes, the window's length is sent.
    pub fn handle_timer(&mut self, now: Stamp, message: impl FnOnce(Grant) -> Option<[u8; 8]>) {
        if core::mem::take(&mut self.refused) {
            // In an interrupt of its own, so that each is short.
            self.node.handle_transmit(TransmitOutcome::Aborted, now);
            return;
        }
        let frame = match self.node.advance(now) {
            None => return,
            Some(Action::TransmitReference(frame) | Action::TransmitEvent(frame)) => frame,
            Some(Action::Transmit(grant)) => {
                let Some(data) = message(grant) else {
                    self.node.handle_transmit(TransmitOutcome::Empty, now);
                    return;
                };
                Frame::from_parts(grant.id, grant.len, data)
            }
            Some(Action::Abort) => return self.controller.abort(),
            Some(Action::Silence) => return self.controller.silence(),
        };
        let frame = frame.to_can::<C::Frame>();
        self.refused = !frame.is_some_and(|frame| self.controller.transmit_once(&frame));
    }

    /// When to call [`Driver::handle_timer`]. It may be in the past: then the timer fires at once.
    /// `now` is returned if the controller has refused a frame, which the node is told then.
    pub fn next_deadline(&self, now: Stamp) -> Option<Stamp> {
        if self.refused {
            Some(now)
        } else {
            self.node.next_deadline()
        }
    }
}

//! A bus guardian: it keeps a node that babbles off the bus.
//!
//! A [`Guardian`] watches one sender or several, reads no clock and touches no pin. Its owner looks at
//! the TX lines (between each sender's CAN controller and its gate) every two bits or so, and tells it
//! what they did since the look before, and of each frame that is received from the bus, with stamps
//! of the guardian's own counter. Each look hands back whose gates are open. A gate is
//! what connects a TX line to its transceiver: an OR gate, or the transceiver's silent-mode pin
//! (its standby pin would also stop reception). The guardian never sends a frame. It has its own
//! crystal and its own copy of the schedule, and learns the time from the references that it
//! receives.
//!
//! # Why the gates are open between windows
//!
//! A gate that is closed outside a sender's windows, as the guardians of TTP/C and of FlexRay's static
//! segment have it, would also block the acknowledge bit and the error flags that each CAN node
//! sends into the frames of others. A receiver that sends a dominant bit and does not see it on the
//! bus counts errors until it is error passive, and in a network of guarded nodes no frame would be
//! acknowledged. So a gate stays open, and what is limited is how long a sender drives:
//!
//! * A *spell* is a stretch of dominant bits on a TX line. It is over when looks have found the line
//!   recessive for 5.5 bits. Bit stuffing lets a frame have 5 recessive bits in a row at most, and so
//!   holds the whole of it, up to its CRC, together in one spell.
//! * A spell that begins when its sender may begin a frame may take as long as the longest frame
//!   that is allowed there, and in windows of a potential master as long as a reference.
//! * Any other spell may take 20 bit times ([`GuardianConfig::spell_bits`]; up to 28 where references take
//!   time to be handled), and then the gate is closed until the spell is over. An acknowledge bit is 1
//!   bit, an error or overload flag is 6, an acknowledge bit with a flag behind it at most 16, and two
//!   flags with a delimiter between them are 20. A frame takes at least 34 bits up to its CRC, so none
//!   gets through: its receivers see six equal bits, and the bus is idle again at most 50 bits after its
//!   start.
//!
//! # Why looks are enough
//!
//! A microcontroller cannot take an interrupt for each edge of a line: at 250 kbit/s they come each
//! 4 us. A look needs the level of each line, and whether it has become dominant since the look
//! before, which a latch of the microcontroller tells (the pending register of an external interrupt
//! that is not enabled). So no dominant bit is missed, and only its time is uncertain, by the time
//! from look to look, *I* ([`GuardianConfig::interval`]):
//!
//! * A spell begins up to *I* before the look that finds it. Its stamp is the middle of that time. Windows
//!   are widened by half of *I*. The limit of 20 bits is counted from that look, and the gate is closed
//!   by the first look at the limit: 20 bits of a spell pass, and never more than 20 bits and 2 *I*.
//!   That is 25.5 bits at most (33.5 with 28), and less than a frame's 34.
//! * Looks in a frame cannot find 5.5 recessive bits in a row, whatever the time between them. So
//!   a frame never counts as two spells, even if looks are late or omitted.
//! * Between two spells that must be told apart, the line is recessive for 11 bits at least: a flag's
//!   delimiter of 8, or the end of a frame behind an acknowledge bit, and the intermission of 3. Looks
//!   find 11 bits less 2 *I* of them, and that is 5.5 as long as *I* is at most 2.75 bits.
//! * What begins on two lines between two looks, or in one and the next, has no order. If both are short, they answer what
//!   both have heard, and neither counts as a pulse. Who begins alone and a look ahead of the others counts: one bit
//!   lies between a babbler's flag and the answers, and about every second look falls into it.
//!
//! A guardian of one sender can do with three looks a spell: when an edge ends the line's rest, when a limit is reached,
//! and when the line has been quiet for the 5.5 bits that end a spell, which a timer tells that each edge resets
//! ([`Watch::is_between_spells`]). Each of them may be late by *I*.
//!
//! # Two halves
//!
//! What a spell may be follows from the schedule, and a microcontroller does not find that out for several
//! lines between two looks. So the guardian has two halves, which its owner gives to tasks of different
//! priorities ([`Guardian::halves`]), and which take turns in a [`Guardian`]:
//!
//! * [`Watch`] follows the lines from look to look, and closes gates. It knows beforehand when each sender may
//!   begin a frame: the next two slots of each.
//! * [`Judge`] knows the schedule and the time of the network, finds those slots ([`Judge::look_ahead`]), and
//!   counts what a sender did that it may not, in steps that can wait until the next frame. Only what
//!   follows from a reference is urgent: a spell in the first window behind it is a short one for the upper
//!   half until its slot is published, so that has to be within `spell_bits` from then on
//!   ([`GuardianConfig::handling`]). What its master repeats at once begins in the slot that is already
//!   published.
//!
//! # What trips a gate
//!
//! A sender that drives on after its limit is cut: its gate stays closed until the sender has not
//! done so again for [`GuardianConfig::penalty`] basic cycles. Frames in its own windows, flags and
//! acknowledge bits are good conduct meanwhile. [`Trip`] lists what else cuts a sender. While the
//! guardian cannot be sure of the time of the network ([`GuardianState`]), it closes the gate as
//! always, and cuts a sender only after [`GuardianConfig::strikes`] such spells in a basic cycle.
//! Counts begin anew after each basic cycle of the guardian's own, so a babbler may use them up
//! twice.
//!
//! Nobody is cut for noise. A pulse in the delimiter of a flag is an error, for which all send another
//! flag (ISO 11898-1), and such flags make one long spell on each line. So a spell beyond all limits is
//! explained by another one that began at once with it and lasts as long, or that was beyond its own limit
//! already. It counts as eight explained pulses, and three times as many of those as of unexplained ones
//! cut, too. That takes two good lines: with fewer, the guardian cannot tell.
//!
//! # When a sender may begin a frame
//!
//! * From the start of its exclusive window until the end of the transmit enable window, both
//!   widened by the uncertainty of the matrix, the guardian's drift and the jitter of its stamps.
//! * If it has event messages or messages that may be sent late: in the arbitrating windows of their
//!   basic cycles, as long as the shortest of them fits.
//! * A potential master: a reference, from the earliest reference trigger offset before the end of
//!   the basic cycle until a reference is received; through a gap; and behind its own reference,
//!   which it repeats if it saw an error that others did not see. A backup that missed a reference
//!   may send its own in the middle of a basic cycle. This is let through some times
//!   ([`GuardianConfig::untimely`]), because it is rare.
//! * While no reference is known, potential masters may send references at any time, or the
//!   network could not start. All others may acknowledge and send flags, and nothing else.
//!
//! # A guardian of one node
//!
//! With one sender, a guardian needs little. On a small board beside the node (Furrow's image `sentry` for an STM32F303) it
//! shares nothing with the node but the wires. Or it runs on the node's own microcontroller, with a timer and
//! pins of its own at the highest priority, and time for its looks. It then guards against a protocol stack, a driver or a
//! transmitter that runs wild, because none of them reaches its gate: it has its own copy of the schedule, finds the
//! time of the network from the received frames by itself, and asks the stack for nothing.
//!
//! * Its gate has a pull-up, so it is closed from reset until the guardian's tasks run, and again when a
//!   watchdog resets a processor that runs nothing any more.
//! * It need not look all the time. While the line is at rest, looks wait for the next edge
//!   ([`Watch::is_at_rest`]), so they cost time only while the node itself drives: its own frames, and
//!   one bit of each frame of others.
//! * It does not close the gate between windows, for the reason above: where two nodes out of three are guarded so, the
//!   third one's frames would not be acknowledged.
//!
//! It is for nodes that are no potential masters. A master repeats its reference when nobody acknowledges it, or when a
//! babbler with its identifier destroys it, and its own guardian sees neither.
//!
//! What it shares with the node it cannot guard against: the clock (a wrong frequency moves the node's windows and those of
//! the guardian alike), the receiver of the CAN controller, the supply, and the processor with its memories. A central
//! guardian shares none of them.
//!
//! # Sources
//!
//! Babbling idiots and guardians against them on CAN: G. Buja, A. Zuccollo, "Overcoming babbling-idiot
//! failures in the FlexCAN architecture: a simple bus-guardian"; I. Broster, A. Burns, "An analysable
//! bus-guardian for event-triggered communication", RTSS 2003. That a guardian needs a time base of its
//! own and the schedule, and that it can only open or close FlexRay's dynamic segment as a whole, is in
//! Vector's description of FlexRay.

mod config;
mod judge;
mod plan;
mod sender;
mod watch;

pub use config::{GuardianConfig, GuardianError};
pub use judge::Judge;
pub use sender::Trip;
pub use watch::{Evidence, Gates, Lines, News, Orders, Outlook, Watch};

use crate::frame::Frame;
use crate::matrix::NodeId;
use crate::schedule::ScheduleView;
use crate::time::Stamp;

/// How well the guardian knows the time of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GuardianState {
    /// No reference is known, or none came for [`GuardianConfig::lost`] basic cycles.
    Unsynchronised,
    /// One reference was received, or the last one does not follow from the one before.
    Synchronising,
    /// Two references in a row fit. Whether the basic cycle still runs, or the next reference is
    /// due, only the time tells.
    InSchedule,
}

/// A guardian of `P` senders, 1 to 32.
///
/// With one sender it is the guardian of a node, beside the node's TX line. With all senders it is a
/// central guardian in a star.
///
/// Call [`Guardian::look`] at least every [`GuardianConfig::interval`], and set the gates as it says. All
/// stamps must come in the order of their events up to [`GuardianConfig::jitter`].
/// [`Guardian::handle_frame`] must be called before the next frame begins on the bus, 4 bits
/// after a reception.
///
/// A guardian does everything at once, so a look may take long. Where a processor cannot do that
/// between two looks, its owner takes the halves apart ([`Guardian::halves`]).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Guardian<'s, const P: usize> {
    watch: Watch<P>,
    judge: Judge<'s, P>,
}

impl<'s, const P: usize> Guardian<'s, P> {
    /// A guardian of these senders, with all gates open and no time. `now` is its counter. A sender that the schedule has no
    /// message of may acknowledge and send flags, and nothing else.
    ///
    /// # Errors
    /// See [`GuardianError`].
    pub fn new(
        schedule: ScheduleView<'s>,
        config: GuardianConfig,
        senders: [NodeId; P],
        now: Stamp,
    ) -> Result<Self, GuardianError> {
        let judge = Judge::new(schedule, config, senders, now)?;
        Ok(Self {
            watch: Watch::new(judge.times()),
            judge,
        })
    }

    /// The two halves, for tasks of two priorities.
    pub fn halves(self) -> (Watch<P>, Judge<'s, P>) {
        (self.watch, self.judge)
    }

    /// How well the guardian knows the time of the network.
    pub fn state(&self) -> GuardianState {
        self.judge.state()
    }

    /// How often the sender with this index was cut, and why the last time.
    pub fn trips(&self, sender: usize) -> (u16, Option<Trip>) {
        self.judge.trips(sender)
    }

    /// The gates that are open until the next look.
    pub const fn gates(&self) -> Gates {
        self.watch.gates()
    }

    /// The sender was replaced or repaired: its counts begin anew, and its gate opens ([`Guardian::gates`]).
    pub fn pardon(&mut self, sender: usize) {
        self.judge.pardon(sender);
        if sender < P {
            // `P` is at most 32.
            self.watch.pardon(1u32.wrapping_shl(sender as u32));
        }
    }

    /// Whether looks may wait for the next edge of a line; see [`Watch::is_at_rest`]. One look in a basic cycle is needed all the
    /// same, because the lower half has no other call.
    pub const fn is_at_rest(&self) -> bool {
        self.watch.is_at_rest()
    }

    /// Whether no line is in a spell ([`Watch::is_between_spells`]).
    pub const fn is_between_spells(&self) -> bool {
        self.watch.is_between_spells()
    }

    /// What the TX lines did since the look before, at `now`. Returns the gates that are open until
    /// the next look.
    pub fn look(&mut self, lines: Lines, now: Stamp) -> Gates {
        self.settle(now);
        if self.watch.begins(lines) {
            self.look_ahead(now);
        }
        self.watch.look(lines, now);
        let again = Lines { fell: 0, ..lines };
        while self.watch.is_behind(now) {
            self.watch.look(again, now);
        }
        if self.watch.has_news() {
            self.judge.rule(&self.watch.news(), now);
            self.watch.obey(self.judge.orders(now));
            self.settle(now);
        }
        self.watch.gates()
    }

    /// Finds all slots that are near.
    fn look_ahead(&mut self, now: Stamp) {
        while !self.judge.is_ahead(now) {
            self.judge.look_ahead(now);
        }
        let outlook = self.judge.look_ahead(now);
        for sender in 0..P {
            self.watch.publish(&outlook, sender);
        }
    }

    /// A data frame was received from the bus; `stamp` was taken at its end. Returns the gates that are open until the
    /// next look: the frame may cut its sender, and a sender may return, after which looks may wait for an edge.
    pub fn handle_frame(&mut self, frame: &Frame, stamp: Stamp) -> Gates {
        self.settle(stamp);
        self.judge.receive(frame, stamp, &self.watch.evidence());
        self.settle(stamp);
        self.watch.gates()
    }

    /// Does all that can wait.
    fn settle(&mut self, now: Stamp) {
        while self.judge.is_behind(now) {
            let orders = self.judge.account(self.watch.driving(), now);
            self.watch.obey(orders);
        }
    }

    /// A look ahead of this instant that finds the lines as the one before changes nothing, nor does the
    /// time. Simulations can leave such looks out.
    #[cfg(feature = "std")]
    pub fn due(&self) -> Stamp {
        let wake = self.judge.wake();
        match self.watch.due() {
            Some(due) if wake.reached(due) => due,
            _ => wake,
        }
    }

    /// The same guardian with all stamps moved so that `now` is stamp 0. It behaves as before. A model
    /// checker needs this to recognise a state.
    #[cfg(feature = "std")]
    #[must_use]
    pub fn renumbered(mut self, now: Stamp) -> Self {
        self.watch.renumber(now);
        let (recent, following) = (self.watch.recent(), self.watch.following());
        self.judge.renumber(now, recent, following);
        self
    }
}

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
//! * Any other spell may take 20 bit times ([`GuardianConfig::spell_bits`]), and then the gate is
//!   closed until the spell is over. An acknowledge bit is 1 bit, an error or overload flag is 6,
//!   an acknowledge bit with a flag behind it at most 16, and two flags with a delimiter between them
//!   are 20. A frame takes at least 34 bits up to its CRC, so none gets through: its receivers see six
//!   equal bits, and the bus is idle again at most 50 bits after its start.
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
//!   That is 25.5 bits at most, and less than a frame's 34.
//! * Looks in a frame cannot find 5.5 recessive bits in a row, whatever the time between them. So
//!   a frame never counts as two spells, even if looks are late or omitted.
//! * Between two spells that must be told apart, the line is recessive for 11 bits at least: a flag's
//!   delimiter of 8, or the end of a frame behind an acknowledge bit, and the intermission of 3. Looks
//!   find 11 bits less 2 *I* of them, and that is 5.5 as long as *I* is at most 2.75 bits.
//! * What begins on two lines between two looks has no order. If both are short, both count as pulses.
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
//! # Sources
//!
//! Babbling idiots and guardians against them on CAN: G. Buja, A. Zuccollo, "Overcoming babbling-idiot
//! failures in the FlexCAN architecture: a simple bus-guardian"; I. Broster, A. Burns, "An analysable
//! bus-guardian for event-triggered communication", RTSS 2003. That a guardian needs a time base of its
//! own and the schedule, and that it can only open or close FlexRay's dynamic segment as a whole, is in
//! Vector's description of FlexRay.

mod config;
mod plan;
mod sender;

pub use config::{GuardianConfig, GuardianError};
pub use sender::Trip;

use crate::frame::Frame;
use crate::length;
use crate::matrix::NodeId;
use crate::reference::Fields;
use crate::schedule::ScheduleView;
use crate::time::Stamp;
use config::Times;
use plan::Plan;
use sender::{AtLimit, Followed, Line, Sender};

/// Basic cycles after which a sender may send one more untimely reference.
const UNTIMELY_EVERY: u8 = 8;
/// Bits from the beginning of the acknowledge slot to the end of the frame (ISO 11898-1).
const ACKNOWLEDGE_TO_END: u32 = 9;
/// Bits from the end of the CRC to the end of the frame.
const CRC_TO_END: u32 = 10;
/// The transmitter's last dominant bit is at most so many bits before the end of the CRC: five
/// recessive bits and a tolerance.
const LAST_DOMINANT: u32 = 7;

/// What a look at the TX lines found. Bit `k` is that of the sender with index `k`; bits without a
/// sender are ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Lines {
    /// The lines that are dominant now: their senders drive the bus.
    pub dominant: u32,
    /// The lines that have become dominant since the look before, if only for a moment. Read and clear
    /// the latch *before* the levels: then a bit that begins between the two is in `dominant` now, and
    /// once more in `fell` of the next look, which does no harm.
    pub fell: u32,
}

impl Lines {
    const fn line(self, bit: u32) -> Line {
        Line {
            dominant: self.dominant & bit != 0,
            fell: self.fell & bit != 0,
        }
    }
}

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

/// The open gates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Gates(u32);

impl Gates {
    /// Whether the gate of the sender with this index is open.
    pub const fn is_open(self, sender: usize) -> bool {
        sender < 32 && self.0 >> sender & 1 == 1
    }

    /// Bit `k` is set if the gate of sender `k` is open.
    pub const fn bits(self) -> u32 {
        self.0
    }

    fn set(&mut self, bit: u32, open: bool) {
        self.0 = if open { self.0 | bit } else { self.0 & !bit };
    }
}

/// A guardian of `P` senders, 1 to 32. It takes 180 bytes, and 52 for each sender.
///
/// With one sender it is the guardian of a node, beside the node's TX line. With all senders it is a
/// central guardian in a star.
///
/// Call [`Guardian::look`] at least every [`GuardianConfig::interval`], and set the gates as it says. All
/// stamps must come in the order of their events up to [`GuardianConfig::jitter`].
/// [`Guardian::handle_frame`] must be called and be done before the next frame begins on the bus, 4 bits
/// after a reception. It may delay looks for so long, because good nodes drive nothing then but
/// overload flags.
///
/// A look while all lines are recessive is one comparison. Any other goes through the lines
/// that are in a spell, and, where one begins, through the windows that have passed since the last
/// one began.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Guardian<'s, const P: usize> {
    plan: Plan<'s>,
    senders: [Sender; P],
    /// Senders whose lines are in a spell, bit by bit.
    active: u32,
    /// Senders whose last attempt at a reference another one may have answered.
    answered: u32,
    open: Gates,
    /// When time alone changes something while no line is in a spell.
    wake: Stamp,
    /// End of the period, one basic cycle long, in which spells are counted.
    period: Stamp,
    periods: u8,
}

impl<'s, const P: usize> Guardian<'s, P> {
    /// All senders, bit by bit. `new` refuses any other `P` than 1 to 32.
    const ALL: u32 = u32::MAX.wrapping_shr(32u32.wrapping_sub(P as u32));

    /// A guardian of these senders, with all gates open and no time. `now` is its counter.
    ///
    /// # Errors
    /// See [`GuardianError`].
    pub fn new(
        schedule: ScheduleView<'s>,
        config: GuardianConfig,
        senders: [NodeId; P],
        now: Stamp,
    ) -> Result<Self, GuardianError> {
        if P == 0 || P > 32 {
            return Err(GuardianError::Senders);
        }
        for (at, sender) in senders.iter().enumerate() {
            if senders.iter().skip(at + 1).any(|other| other == sender) {
                return Err(GuardianError::Senders);
            }
        }
        let times = Times::new(schedule, config)?;
        let period = now.after(times.cycle);
        Ok(Self {
            senders: senders.map(|node| Sender::new(schedule, &times, node)),
            active: 0,
            answered: 0,
            open: Gates(Self::ALL),
            wake: period,
            period,
            periods: 0,
            plan: Plan::new(schedule, times),
        })
    }

    /// How well the guardian knows the time of the network.
    pub fn state(&self) -> GuardianState {
        match self.plan.known {
            None => GuardianState::Unsynchronised,
            Some(known) if known.consecutive => GuardianState::InSchedule,
            Some(_) => GuardianState::Synchronising,
        }
    }

    /// How often the sender with this index was cut, and why the last time.
    pub fn trips(&self, sender: usize) -> (u16, Option<Trip>) {
        self.senders
            .get(sender)
            .map_or((0, None), |sender| (sender.trips, sender.reason))
    }

    /// The sender was replaced or repaired: its counts begin anew, and the next look opens its gate.
    pub fn pardon(&mut self, sender: usize) {
        if let Some(sender) = self.senders.get_mut(sender) {
            sender.pardon();
            self.settle();
        }
    }

    /// What the TX lines did since the look before, at `now`. Returns the gates that are open until
    /// the next look.
    #[inline]
    pub fn look(&mut self, lines: Lines, now: Stamp) -> Gates {
        let seen = (lines.dominant | lines.fell) & Self::ALL;
        if seen | self.active == 0 && !now.reached(self.wake) {
            return self.open;
        }
        self.look_closely(lines, now)
    }

    /// A look that finds a line in a spell, or comes when time changes something.
    fn look_closely(&mut self, lines: Lines, now: Stamp) -> Gates {
        if now.reached(self.wake) {
            self.advance(now);
        }
        let was = self.active;
        if was != 0 {
            self.follow(lines, now);
        }
        let begin = (lines.dominant | lines.fell) & Self::ALL & !was;
        if begin != 0 {
            self.begin(begin, lines.dominant, now);
        }
        self.open
    }

    /// Follows the lines that are in a spell.
    fn follow(&mut self, lines: Lines, now: Stamp) {
        let times = &self.plan.times;
        let (mut over, mut limits, mut settle) = (0, 0, false);
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter_mut().enumerate() {
            // `at` is below 32, see `new`.
            let bit = 1u32.wrapping_shl(at as u32);
            if self.active & bit == 0 {
                continue;
            }
            match sender.follow(lines.line(bit), now, times) {
                Followed::Unchanged => {}
                Followed::Limit => limits |= bit,
                Followed::Over => over |= bit,
                Followed::Released => settle = true,
            }
        }
        self.active &= !over;
        if limits != 0 {
            self.limit(limits, lines, now);
        } else if settle || over & !self.open.0 != 0 {
            self.settle();
        }
    }

    /// The spells of these senders have gone on beyond their limits.
    #[inline(never)]
    fn limit(&mut self, limits: u32, lines: Lines, now: Stamp) {
        let trusted = self.plan.is_trusted(now);
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter_mut().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            if limits & bit == 0 {
                continue;
            }
            let at_limit = AtLimit {
                answered: self.answered & bit != 0,
                trusted,
            };
            if sender.limit(lines.line(bit), at_limit, now, &self.plan.times) {
                self.answered &= !bit;
            }
        }
        self.settle();
    }

    /// The lines of these senders have become dominant since the look before. Not inlined, so that
    /// a look that finds no beginning does not save the registers that this needs.
    #[inline(never)]
    fn begin(&mut self, begin: u32, dominant: u32, now: Stamp) {
        let began = now.before(self.plan.times.half_interval);
        let provoking = self.provoking();
        let moment = self.plan.moment(began);
        let times = &self.plan.times;
        // The guardian of one node sees no other line, and takes for granted while there are references
        // that its attempts are answered.
        let unseen = P == 1 && self.plan.known.is_some();
        let mut settle = false;
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter_mut().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            if begin & bit == 0 {
                continue;
            }
            let (permit, until) = self.plan.permit(&moment, sender, now);
            let excused = provoking != 0 || sender.is_behind_own(began, times);
            sender.begin(began, until, permit);
            if dominant & bit == 0 {
                sender.release(now);
            }
            if sender.is_short() && !excused {
                settle |= sender.pulse(times, now);
            }
            // A sender that drives may have acknowledged or disturbed what others send.
            self.answered |= if unseen { bit } else { Self::ALL & !bit };
        }
        self.active |= begin;
        if settle {
            self.settle();
        }
    }

    /// A data frame was received from the bus; `stamp` was taken at its end.
    pub fn handle_frame(&mut self, frame: &Frame, stamp: Stamp) {
        if stamp.reached(self.wake) {
            self.advance(stamp);
        }
        let end = stamp.offset(self.plan.times.config.receive_latency.wrapping_neg());
        let bits = length::frame_bits(frame);
        let start = end.before(self.plan.times.bits(bits));
        let genuine = self.attribute(frame, bits, start, end);
        let schedule = self.plan.schedule;
        match schedule.reference_rank(frame.id()) {
            Some(Some(rank)) => {
                let network = schedule.network;
                let fields = Fields::decode(&network.reference_format, frame, network.cycles);
                if let Some(fields) =
                    fields.filter(|fields| !fields.next_is_gap || network.longest_gap > 0)
                    && self.plan.take_reference(&fields, rank, start, genuine)
                {
                    for sender in &mut self.senders {
                        sender.forget_attempts();
                    }
                }
            }
            Some(None) => {}
            None => self.plan.note_message(start),
        }
        self.settle();
    }

    /// Finds who sent a frame of so many bits, and cuts a sender that may not. Returns whether it is what
    /// its sender may send. Takes back the counts of its acknowledge bits.
    fn attribute(&mut self, frame: &Frame, bits: u32, start: Stamp, end: Stamp) -> bool {
        let trusted = self.plan.is_trusted(start);
        let mut genuine = true;
        let Plan {
            schedule, times, ..
        } = &self.plan;
        let acknowledged = end.before(times.bits(ACKNOWLEDGE_TO_END));
        let body = bits.saturating_sub(CRC_TO_END + LAST_DOMINANT);
        let body = start.after(times.bits(body));
        // loop-bound: senders=32
        for sender in &mut self.senders {
            if !sender.is_open() {
                continue;
            }
            if sender.began_at(acknowledged, times.tolerance) {
                sender.take_back();
            } else if sender.began_at(start, times.tolerance) && sender.drove_after(body) {
                sender.sent(*schedule, frame, end, trusted, times);
                genuine &= sender.is_open();
            }
        }
        genuine
    }

    /// Senders in a short spell, or whose gate was closed in a spell, which all others answer with a
    /// flag.
    fn provoking(&self) -> u32 {
        let mut provoking = 0;
        if self.active != 0 {
            // loop-bound: senders=32
            for (at, sender) in self.senders.iter().enumerate() {
                let bit = 1u32.wrapping_shl(at as u32);
                provoking |= if sender.provokes() { bit } else { 0 };
            }
        }
        provoking
    }

    /// Time passes that changes something for senders whose lines are at rest, too.
    fn advance(&mut self, now: Stamp) {
        // loop-bound: senders=32
        for sender in &mut self.senders {
            sender.return_at(now, &self.plan.times);
        }
        if self.plan.lost_at().is_some_and(|lost| now.reached(lost)) {
            self.plan.known = None;
        }
        if now.reached(self.period) {
            self.period = now.after(self.plan.times.cycle);
            self.periods = self.periods.wrapping_add(1);
            let forget = self.periods.is_multiple_of(UNTIMELY_EVERY);
            for sender in &mut self.senders {
                sender.end_period(forget, now, &self.plan.times);
            }
        }
        self.settle();
    }

    /// Sets the gates, and when time alone changes something.
    fn settle(&mut self) {
        let mut wake = self.period;
        if let Some(lost) = self.plan.lost_at()
            && wake.reached(lost)
        {
            wake = lost;
        }
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            self.open.set(bit, sender.is_open());
            if let Some(cut) = sender.cut()
                && wake.reached(cut)
            {
                wake = cut;
            }
        }
        self.wake = wake;
    }

    /// A look ahead of this instant that finds the lines as the one before changes nothing, nor does the
    /// time. Simulations can leave such looks out.
    #[cfg(feature = "std")]
    pub fn due(&self) -> Stamp {
        let gap = self.plan.times.spell_gap;
        let dues = self.senders.iter().filter_map(|sender| sender.due(gap));
        dues.fold(self.wake, |due, at| if due.reached(at) { at } else { due })
    }

    /// The same guardian with all stamps moved so that `now` is stamp 0. It behaves as before. A model
    /// checker needs this to recognise a state.
    #[cfg(feature = "std")]
    #[must_use]
    pub fn renumbered(mut self, now: Stamp) -> Self {
        self.periods %= UNTIMELY_EVERY;
        let renumber = |stamp: &mut Stamp| *stamp = stamp.before(now.0);
        if let Some(known) = &mut self.plan.known {
            renumber(&mut known.mark);
        }
        renumber(&mut self.period);
        renumber(&mut self.wake);
        // loop-bound: senders=32
        for sender in &mut self.senders {
            sender.renumber(now, &self.plan.times);
        }
        self
    }
}

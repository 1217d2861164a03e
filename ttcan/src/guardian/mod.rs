//! A bus guardian: it keeps a node that babbles off the bus.
//!
//! A [`Guardian`] watches one sender or several, reads no clock and touches no pin. Its owner tells
//! it of each frame that is received from the bus and of each edge on the TX line of each sender
//! (between the sender's CAN controller and its gate), with stamps of the guardian's own counter.
//! It hands back a [`Decision`]: whose gates are open, and when it must be asked again. A gate is
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
//! * A *spell* is a stretch of dominant bits on a TX line with fewer than 7 recessive bits between
//!   them. Bit stuffing holds the whole of a frame, up to its CRC, together in one spell.
//! * A spell that begins when its sender may begin a frame may take as long as the longest frame
//!   that is allowed there, and in windows of a potential master as long as a reference.
//! * Any other spell may take 16 bit times ([`GuardianConfig::spell_bits`]), and then the gate is
//!   closed until the spell is over. An acknowledge bit is 1 bit, an error or overload flag is 6,
//!   and an acknowledge bit with a flag behind it at most 14. A frame takes at least 34 bits up to
//!   its CRC, so none gets through: its receivers see six equal bits, and the bus is idle again
//!   some 40 bits after its start.
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
mod sender;

pub use config::{GuardianConfig, GuardianError};
pub use sender::Trip;

use crate::frame::Frame;
use crate::length;
use crate::matrix::{NodeId, REFERENCE_OFFSET_LIMIT};
use crate::reference::Fields;
use crate::schedule::{Entry, Role, ScheduleView};
use crate::time::Stamp;
use config::Times;
use sender::{Permit, Sender};

/// Basic cycles after which a sender may send one more untimely reference.
const UNTIMELY_EVERY: u8 = 8;
/// Bits from the beginning of the acknowledge slot to the end of the frame (ISO 11898-1).
const ACKNOWLEDGE_TO_END: u32 = 9;
/// Bits from the end of the CRC to the end of the frame.
const CRC_TO_END: u32 = 10;
/// The transmitter's last dominant bit is at most so many bits before the end of the CRC: five
/// recessive bits and a tolerance.
const LAST_DOMINANT: u32 = 7;
/// Bits beyond the longest frame that a permitted spell may take: an error flag and one that is
/// begun anew.
const FLAG_BITS: u32 = 14;

/// Level of a TX line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Level {
    /// The sender drives the bus.
    Dominant,
    /// The sender does not drive the bus.
    Recessive,
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
}

/// What the guardian decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[must_use]
pub struct Decision {
    /// The gates that are open until the next event or `ask`.
    pub open: Gates,
    /// When [`Guardian::poll`] must be called again at the latest. It may be in the past only if
    /// the call before was late.
    pub ask: Stamp,
}

/// The basic cycle that the guardian knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Known {
    /// Start of frame of the reference.
    mark: Stamp,
    number: u8,
    master: u8,
    next_is_gap: bool,
    /// Whether it followed from the one before.
    consecutive: bool,
    /// A message was received when the next reference was due: that one was missed, and its basic
    /// cycle runs.
    missed: bool,
}

/// A guardian of `P` senders, 1 to 32. It takes some 150 bytes, and 56 for each sender.
///
/// With one sender it is the guardian of a node, with its own timer on the node's TX line. With all
/// senders it is a central guardian in a star.
///
/// After each `handle_` call and when [`Decision::ask`] is reached, call [`Guardian::poll`], set
/// the gates, and set the timer. All stamps must come in the order of their events up to
/// [`GuardianConfig::jitter`]. Each call goes through the senders once, and
/// [`Guardian::handle_edge`] also through the windows that have passed since the last one.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Guardian<'s, const P: usize> {
    schedule: ScheduleView<'s>,
    times: Times,
    known: Option<Known>,
    /// First entry of the basic cycle that has not passed, and one past the last one.
    cursor: (u16, u16),
    senders: [Sender; P],
    /// End of the period, one basic cycle long, in which spells are counted.
    period: Stamp,
    periods: u8,
}

impl<'s, const P: usize> Guardian<'s, P> {
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
        Ok(Self {
            schedule,
            known: None,
            cursor: (0, 0),
            senders: senders.map(|node| Sender::new(schedule, &times, node)),
            period: now.after(times.cycle),
            periods: 0,
            times,
        })
    }

    /// How well the guardian knows the time of the network.
    pub fn state(&self) -> GuardianState {
        match self.known {
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

    /// The sender was replaced or repaired: its gate opens, and its counts begin anew. Call
    /// [`Guardian::poll`] afterwards.
    pub fn pardon(&mut self, sender: usize) {
        if let Some(sender) = self.senders.get_mut(sender) {
            sender.pardon();
        }
    }

    /// What holds at `now`.
    pub fn poll(&mut self, now: Stamp) -> Decision {
        self.advance(now);
        let mut open = 0;
        let mut ask = self.period;
        for (at, sender) in self.senders.iter().enumerate() {
            if sender.is_open() {
                // `at` is below 32, see `new`.
                open |= 1u32.wrapping_shl(at as u32);
            }
            if let Some(due) = sender.due(self.times.spell_gap)
                && ask.reached(due)
            {
                ask = due;
            }
        }
        Decision {
            open: Gates(open),
            ask,
        }
    }

    /// The TX line of the sender with this index has changed. A second edge to the same level is
    /// ignored, and so is a sender that there is not.
    pub fn handle_edge(&mut self, sender: usize, level: Level, stamp: Stamp) {
        let stamp = stamp.offset(self.times.config.edge_latency.wrapping_neg());
        self.advance(stamp);
        let Some(line) = self.senders.get(sender) else {
            return;
        };
        let begins = level == Level::Dominant && !line.in_spell();
        let (permit, until) = if begins {
            self.permit(sender, stamp)
        } else {
            (line.permit, line.until)
        };
        let provoked = begins && self.is_provoked(sender);
        let trusted = self.is_trusted(stamp);
        let limits = self.times;
        let Some(line) = self.senders.get_mut(sender) else {
            return;
        };
        if !begins {
            line.change(level, stamp, trusted, &limits);
            return;
        }
        let behind = line.is_behind_own(stamp, &limits);
        line.begin(stamp, until, permit);
        if line.is_short() && !provoked && !behind {
            line.pulse(&limits, stamp);
        }
        // A sender that drives may have acknowledged or disturbed what others send. The guardian of one
        // node sees no other line, and takes it for granted while there are references.
        let unseen = P == 1 && self.known.is_some();
        for (at, other) in self.senders.iter_mut().enumerate() {
            other.answered |= at != sender || unseen;
        }
    }

    /// A data frame was received from the bus; `stamp` was taken at its end.
    pub fn handle_frame(&mut self, frame: &Frame, stamp: Stamp) {
        self.advance(stamp);
        let end = stamp.offset(self.times.config.receive_latency.wrapping_neg());
        let start = end.before(self.times.bits(length::frame_bits(frame)));
        let genuine = self.attribute(frame, start, end);
        let rank = match self.schedule.reference_rank(frame.id()) {
            Some(Some(rank)) => rank,
            Some(None) => return,
            None => {
                self.note_message(start);
                return;
            }
        };
        let network = self.schedule.network;
        let fields = Fields::decode(&network.reference_format, frame, network.cycles);
        if let Some(fields) = fields.filter(|fields| !fields.next_is_gap || network.longest_gap > 0)
        {
            self.take_reference(&fields, rank, start, genuine);
        }
    }

    /// What a message tells about references.
    fn note_message(&mut self, start: Stamp) {
        let phase = self.reference_phase();
        if let Some(known) = &mut self.known {
            let elapsed = start.ticks_since(known.mark);
            known.missed |= elapsed >= phase.cast_signed();
        }
    }

    /// Judges a reference as a node does, so that both follow the same one.
    fn take_reference(&mut self, fields: &Fields, rank: u8, start: Stamp, genuine: bool) {
        let mut consecutive = false;
        let mut timely = true;
        if let Some(known) = self.known {
            let elapsed = start.ticks_since(known.mark);
            let next = known.number.wrapping_add(1) & self.schedule.network.cycles.wrapping_sub(1);
            // The nodes follow the reference that the guardian missed, and refuse one of a master that
            // missed it, too: a backup, or the master before.
            let earliest = if known.missed && rank >= known.master {
                self.times.earliest.wrapping_add(self.times.cycle)
            } else {
                self.times.earliest
            };
            if elapsed >= earliest.cast_signed() {
                // A worse-ranked master that begins later than behind a frame may have missed a
                // reference together with the guardian, and the nodes do not follow it.
                let allowance = if rank > known.master {
                    self.times.takeover
                } else {
                    self.times.late
                };
                let late = self.times.cycle.wrapping_add(allowance);
                let in_time = elapsed <= late.cast_signed() || known.next_is_gap;
                consecutive = in_time && fields.cycle == next;
            } else if rank > known.master {
                return;
            } else {
                let soon = self.times.repeated.cast_signed();
                let repeated = rank == known.master && fields.cycle == known.number;
                let repeated = repeated && (0..soon).contains(&elapsed);
                consecutive = repeated && known.consecutive;
                timely = false;
            }
        }
        self.known = Some(Known {
            mark: start,
            number: fields.cycle,
            master: rank,
            next_is_gap: fields.next_is_gap,
            // Nodes follow a reference in another master's name, too. The next one tells which is right.
            consecutive: consecutive && genuine,
            missed: false,
        });
        self.cursor = self.schedule.entries_of(fields.cycle);
        if timely {
            for sender in &mut self.senders {
                sender.forget_attempts();
            }
        }
    }

    /// Finds who sent a frame, and cuts a sender that may not. Returns whether it is what its
    /// sender may send. Takes back the counts of its acknowledge bits.
    fn attribute(&mut self, frame: &Frame, start: Stamp, end: Stamp) -> bool {
        let trusted = self.is_trusted(start);
        let mut genuine = true;
        let schedule = self.schedule;
        let times = self.times;
        let acknowledged = end.before(times.bits(ACKNOWLEDGE_TO_END));
        let body = length::frame_bits(frame).saturating_sub(CRC_TO_END + LAST_DOMINANT);
        let body = start.after(times.bits(body));
        for sender in &mut self.senders {
            if !sender.is_open() {
                continue;
            }
            if sender.began_at(acknowledged, times.tolerance) {
                sender.take_back();
            } else if sender.began_at(start, times.tolerance) && sender.drove_after(body) {
                sender.sent(schedule, frame, end, trusted, &times);
                genuine &= sender.is_open();
            }
        }
        genuine
    }

    /// Whether the guardian is sure of the windows at `now`: the current basic cycle followed from
    /// the one before, and the next reference is not due yet.
    fn is_trusted(&self, now: Stamp) -> bool {
        self.known.is_some_and(|known| {
            let elapsed = now.ticks_since(known.mark);
            known.consecutive && elapsed < self.reference_phase().cast_signed()
        })
    }

    /// Whether another sender began a short spell before, or its gate was closed in a spell, which
    /// all others answer with a flag.
    fn is_provoked(&self, sender: usize) -> bool {
        let others = self.senders.iter().enumerate();
        others
            .filter(|(at, _)| *at != sender)
            .any(|(_, other)| other.provokes())
    }

    /// Time passes.
    fn advance(&mut self, now: Stamp) {
        let trusted = self.is_trusted(now);
        let times = self.times;
        for sender in &mut self.senders {
            sender.advance(now, trusted, &times);
        }
        if let Some(known) = self.known {
            let gap = if known.next_is_gap { times.gap } else { 0 };
            let lost = times.lost.wrapping_add(gap);
            if now.ticks_since(known.mark) >= lost.cast_signed() {
                self.known = None;
            }
        }
        if now.reached(self.period) {
            self.period = now.after(times.cycle);
            self.periods = self.periods.wrapping_add(1);
            let forget = self.periods.is_multiple_of(UNTIMELY_EVERY);
            for sender in &mut self.senders {
                sender.end_period(forget, now, &times);
            }
        }
    }

    /// Cycle time in ticks from which the next reference may begin.
    fn reference_phase(&self) -> u32 {
        let times = &self.times;
        let early = times.offset_limit.wrapping_add(times.margin(times.cycle));
        times.cycle.saturating_sub(early)
    }

    /// What the sender with this index may begin at `now`, and until when it may drive.
    fn permit(&mut self, sender: usize, now: Stamp) -> (Permit, Stamp) {
        let permit = self
            .senders
            .get(sender)
            .copied()
            .and_then(|sender| self.frame_permit(&sender, now));
        let (permit, bits) = permit.unwrap_or((Permit::Short, 0));
        let bits = match permit {
            Permit::Short | Permit::Reference { .. } => u32::from(self.times.config.spell_bits),
            _ => bits.saturating_add(FLAG_BITS),
        };
        (permit, now.after(self.times.bits(bits)))
    }

    /// The frame that a sender may begin at `now`, and its longest length in bits.
    fn frame_permit(&mut self, sender: &Sender, now: Stamp) -> Option<(Permit, u32)> {
        let bits = self.times.reference_bits;
        let reference = |untimely| {
            let permit = (Permit::Reference { untimely }, bits);
            sender.rank.map(|_| permit)
        };
        let Some(known) = self.known else {
            return reference(false);
        };
        let elapsed = now.ticks_since(known.mark).max(0).cast_unsigned();
        if elapsed < self.reference_phase() {
            let window = self.window_permit(sender, known.number, elapsed);
            return match window {
                // A master that the guardian does not follow may have the right time.
                None => reference(known.consecutive),
                // It may be a reference beside its time, which is counted when it was received.
                Some((permit, length)) if sender.rank.is_some() => Some((permit, length.max(bits))),
                window => window,
            };
        }
        let window = if known.next_is_gap {
            None
        } else {
            self.missed_permit(sender, known.number, elapsed)
        };
        match window {
            None => reference(false),
            Some((_, length)) => Some((Permit::Own, length.max(bits))),
        }
    }

    /// A frame in a window of the current basic cycle.
    fn window_permit(&mut self, sender: &Sender, cycle: u8, elapsed: u32) -> Option<(Permit, u32)> {
        let margin = self.times.margin(elapsed);
        let (mut cursor, last) = self.cursor;
        // loop-bound: 64. One turn for each window that has passed since the last spell.
        while cursor < last
            && let Some(entry) = self.schedule.entry(cursor)
            && self.times.ticks(entry.end).wrapping_add(margin) < elapsed
        {
            cursor = cursor.wrapping_add(1);
        }
        self.cursor.0 = cursor;
        // Two windows that touch overlap by the margin.
        let next = cursor.wrapping_add(1);
        for at in [cursor, next] {
            if at < last
                && let Some(entry) = self.schedule.entry(at)
                && let Some(permit) =
                    self.entry_permit(sender, entry, cycle, elapsed, (margin, margin))
            {
                return Some(permit);
            }
        }
        None
    }

    /// A frame in a window of a basic cycle whose reference the guardian did not receive. It may
    /// have begun early by the reference trigger offset, or late by that and repetitions.
    fn missed_permit(&self, sender: &Sender, cycle: u8, elapsed: u32) -> Option<(Permit, u32)> {
        let times = &self.times;
        let margin = times.margin(elapsed);
        let early = times.offset_limit.wrapping_add(margin);
        let late = times.late.wrapping_add(margin);
        let passed = elapsed.wrapping_add(early) / times.cycle.max(1);
        let number =
            cycle.wrapping_add(passed as u8) & self.schedule.network.cycles.wrapping_sub(1);
        let elapsed = elapsed.wrapping_sub(passed.wrapping_mul(times.cycle));
        // The basic cycle begins when this is 0, and the search some time before.
        let elapsed = elapsed.cast_signed().max(0).cast_unsigned();
        let (first, last) = self.schedule.entries_of(number);
        let mut at = first;
        // loop-bound: 64. One turn for each window of a basic cycle, only while references are missing.
        while at < last {
            let entry = self.schedule.entry(at)?;
            let permit = self.entry_permit(sender, entry, number, elapsed, (early, late));
            if permit.is_some() {
                return permit;
            }
            at = at.wrapping_add(1);
        }
        None
    }

    /// A frame in this window, which may begin `margin.0` early and `margin.1` late.
    fn entry_permit(
        &self,
        sender: &Sender,
        entry: &Entry,
        cycle: u8,
        elapsed: u32,
        margin: (u32, u32),
    ) -> Option<(Permit, u32)> {
        let (early, late) = margin;
        let times = &self.times;
        let start = times.ticks(entry.start);
        if elapsed.wrapping_add(early) < start {
            return None;
        }
        match entry.role {
            Role::Exclusive {
                id,
                len,
                sender: owner,
                ..
            } => {
                let latest = start.wrapping_add(times.enable).wrapping_add(late);
                let bits = length::worst_case_bits(id, len);
                (owner == sender.node && elapsed <= latest).then_some((Permit::Window(id), bits))
            }
            Role::Arbitrating => {
                let (shortest, longest) = sender.events?;
                let (mask, offset) = sender.event_cycles;
                let shortest = times.bits(u32::from(shortest));
                let end = times.ticks(entry.end).wrapping_add(late);
                let fits = elapsed.wrapping_add(shortest) <= end;
                (fits && cycle & mask == offset)
                    .then_some((Permit::Arbitrating, u32::from(longest)))
            }
        }
    }

    /// The same guardian with all stamps moved so that `now` is stamp 0. It behaves as before. A model
    /// checker needs this to recognise a state.
    #[cfg(feature = "std")]
    #[must_use]
    pub fn renumbered(mut self, now: Stamp) -> Self {
        self.periods %= UNTIMELY_EVERY;
        let renumber = |stamp: &mut Stamp| *stamp = stamp.before(now.0);
        if let Some(known) = &mut self.known {
            renumber(&mut known.mark);
        }
        renumber(&mut self.period);
        for sender in &mut self.senders {
            sender.renumber(now, &self.times);
        }
        self
    }
}

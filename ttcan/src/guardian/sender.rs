//! One guarded sender: its TX line, and what is counted of it.

use super::config::Times;
use crate::frame::Frame;
use crate::id::Id;
use crate::length;
use crate::matrix::NodeId;
use crate::reference::Fields;
use crate::schedule::ScheduleView;
use crate::time::Stamp;

/// Why a sender was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Trip {
    /// It drove the bus outside its windows, or longer than its longest frame.
    Misplaced,
    /// It sent a frame that is not the one of its window: another identifier, or another master's
    /// reference.
    Identifier,
    /// Too many short spells that nothing explains: it disturbs the frames of others.
    Pulses,
}

/// What a spell may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Permit {
    /// An acknowledge bit, error flag or overload flag.
    Short,
    /// The message of an exclusive window.
    Window(Id),
    /// An event message or a late one.
    Arbitrating,
    /// A reference, beside the time of references if `untimely`. It is an acknowledge bit or a flag
    /// until it is longer than those.
    Reference { untimely: bool },
    /// Any message or reference of this sender.
    Own,
}

/// The current spell of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Spell {
    /// No dominant bit since the period before, so that the stamps mean nothing.
    Never,
    /// The last one is over.
    Over,
    /// The line was dominant at the last look.
    Dominant,
    /// It is recessive, and not long enough yet.
    Recessive,
}

/// What a look found on one line.
#[derive(Clone, Copy)]
pub(super) struct Line {
    /// The line is dominant.
    pub(super) dominant: bool,
    /// It has become dominant since the look before.
    pub(super) fell: bool,
}

/// What a look did to a spell.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Followed {
    /// It goes on, and nothing that others see has changed.
    Unchanged,
    /// It goes on beyond its limit.
    Limit,
    /// It is over.
    Over,
    /// The line was released, and the time until the sender may return begins anew.
    Released,
}

/// What counts when a spell reaches its limit.
#[derive(Clone, Copy)]
pub(super) struct AtLimit {
    /// Another sender may have answered the last attempt to send a reference.
    pub(super) answered: bool,
    /// The guardian is sure of the time.
    pub(super) trusted: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Sender {
    pub(super) node: NodeId,
    /// Rank as a potential master.
    pub(super) rank: Option<u8>,
    /// Longest stuffed lengths of its shortest and its longest message for arbitrating windows.
    pub(super) events: Option<(u8, u8)>,
    /// Mask and offset of the basic cycles in which it may send those.
    pub(super) event_cycles: (u8, u8),
    spell: Spell,
    /// Beginning of the last spell, the instant up to which it may drive, and the first look that
    /// found the line recessive again.
    began: Stamp,
    pub(super) until: Stamp,
    released: Stamp,
    pub(super) permit: Permit,
    /// The gate is closed until the spell is over.
    clipped: bool,
    /// The spell was counted as a violation.
    struck: bool,
    /// The spell was counted as a pulse.
    counted: bool,
    /// The spell was counted as an attempt to send a reference.
    charged: bool,
    /// When the sender may return.
    cut: Option<Stamp>,
    pulses: u8,
    strikes: u16,
    /// Frames that it may begin in two basic cycles, with those that it begins again in an arbitrating
    /// window.
    frames: u16,
    /// Attempts to send a reference since the last one.
    attempts: u8,
    untimely: u8,
    pub(super) trips: u16,
    pub(super) reason: Option<Trip>,
}

impl Sender {
    pub(super) fn new(schedule: ScheduleView<'_>, times: &Times, node: NodeId) -> Self {
        let (repeat, offset) = schedule.event_cycles(node);
        let mut events: Option<(u8, u8)> = None;
        for known in schedule.messages() {
            if known.sender == node && (known.is_event || known.retry_late) {
                // An event message may be shorter than its longest length.
                let least = if known.is_event { 0 } else { known.len };
                // A data frame has at most 157 bits.
                let least = length::worst_case_bits(known.id, least) as u8;
                let most = length::worst_case_bits(known.id, known.len) as u8;
                let (shortest, longest) = events.unwrap_or((least, most));
                events = Some((shortest.min(least), longest.max(most)));
            }
        }
        // It begins a frame in an arbitrating window again as soon as the bus is idle.
        let again = events.map_or(0, |_| times.repetitions);
        let never = Stamp(0);
        Self {
            node,
            rank: schedule.rank_of(node),
            events,
            event_cycles: (repeat.wrapping_sub(1), offset),
            spell: Spell::Never,
            began: never,
            until: never,
            released: never,
            permit: Permit::Short,
            clipped: false,
            struck: false,
            counted: false,
            charged: false,
            cut: None,
            pulses: 0,
            strikes: 0,
            frames: schedule.windows_in_two_cycles(node).saturating_add(again),
            attempts: 0,
            untimely: 0,
            trips: 0,
            reason: None,
        }
    }

    pub(super) const fn is_open(&self) -> bool {
        self.cut.is_none() && !self.clipped
    }

    pub(super) const fn in_spell(&self) -> bool {
        matches!(self.spell, Spell::Dominant | Spell::Recessive)
    }

    /// Whether all others answer what this sender does with a flag.
    pub(super) const fn provokes(&self) -> bool {
        self.in_spell() && (self.clipped || self.is_short())
    }

    /// Whether the last spell is an acknowledge bit or a flag as far as can be told.
    pub(super) const fn is_short(&self) -> bool {
        match self.permit {
            Permit::Short => true,
            Permit::Reference { .. } => !self.charged,
            _ => false,
        }
    }

    /// A reference was received: the attempts to send one begin anew.
    pub(super) fn forget_attempts(&mut self) {
        self.attempts = 0;
    }

    /// Counts a reference beside its time. Returns whether the sender may send it.
    fn count_untimely(&mut self, times: &Times) -> bool {
        let granted = self.untimely < times.config.untimely;
        if granted {
            self.untimely = self.untimely.saturating_add(1);
        }
        granted
    }

    /// Counts the spell as an attempt to send a reference, if another sender may have `answered` the
    /// one before. Returns whether the sender may make it.
    fn charge(&mut self, answered: bool, times: &Times) -> bool {
        let Permit::Reference { untimely } = self.permit else {
            return false;
        };
        if self.charged {
            return false;
        }
        if untimely {
            if !self.count_untimely(times) {
                return false;
            }
        } else if self.attempts >= times.config.attempts {
            return false;
        } else if answered && self.cut.is_none() {
            self.attempts = self.attempts.saturating_add(1);
        }
        self.charged = true;
        self.until = self.began.after(times.reference);
        self.take_back();
        true
    }

    /// Whether a spell that begins at `now` is the error flag behind this sender's own frame. A
    /// frame without an acknowledgement ends so.
    pub(super) fn is_behind_own(&self, now: Stamp, times: &Times) -> bool {
        let since = now.ticks_since(self.released);
        let soon = times.behind.cast_signed();
        self.spell == Spell::Over && !self.struck && !self.is_short() && (0..=soon).contains(&since)
    }

    /// A spell has begun at about `began`, with this permission.
    pub(super) fn begin(&mut self, began: Stamp, until: Stamp, permit: Permit) {
        self.spell = Spell::Dominant;
        self.began = began;
        self.until = until;
        self.permit = permit;
        self.clipped = false;
        self.struck = false;
        self.counted = false;
        self.charged = false;
    }

    /// The look that found the beginning of the spell found the line recessive again.
    pub(super) fn release(&mut self, now: Stamp) {
        self.spell = Spell::Recessive;
        self.released = now;
    }

    /// Whether the spell has gone on beyond its limit, and its gate is still to be closed, or the violation
    /// to be counted.
    fn is_at_limit(&self, now: Stamp) -> bool {
        now.reached(self.until) && !(self.struck && self.clipped)
    }

    /// Follows a line that is in a spell.
    #[inline]
    pub(super) fn follow(&mut self, line: Line, now: Stamp, times: &Times) -> Followed {
        if line.dominant {
            self.spell = Spell::Dominant;
            return if self.is_at_limit(now) {
                Followed::Limit
            } else {
                Followed::Unchanged
            };
        }
        if line.fell || self.spell == Spell::Dominant {
            self.spell = Spell::Recessive;
            self.released = now;
            if self.is_at_limit(now) {
                return Followed::Limit;
            }
            if self.struck && self.cut.is_some() {
                // Good conduct begins here.
                self.cut = Some(now.after(times.penalty));
                return Followed::Released;
            }
            return Followed::Unchanged;
        }
        if now.reached(self.released.after(times.spell_gap)) {
            self.spell = Spell::Over;
            self.clipped = false;
            return Followed::Over;
        }
        if now.reached(self.until) && !self.clipped {
            return Followed::Limit;
        }
        Followed::Unchanged
    }

    /// A short spell that nothing explains begins at `now`. Returns whether it cuts the sender.
    pub(super) fn pulse(&mut self, times: &Times, now: Stamp) -> bool {
        self.counted = true;
        self.pulses = self.pulses.saturating_add(1);
        let cuts = self.pulses > times.config.pulses && self.is_open();
        if cuts {
            self.trip(Trip::Pulses, now, times);
        }
        cuts
    }

    /// The last spell was an acknowledge bit.
    pub(super) fn take_back(&mut self) {
        if self.counted {
            self.counted = false;
            self.pulses = self.pulses.saturating_sub(1);
        }
    }

    /// Lets the sender return, if its time has come.
    pub(super) fn return_at(&mut self, now: Stamp, times: &Times) {
        if let Some(cut) = self.cut
            && now.reached(cut)
        {
            if self.struck && self.in_spell() {
                // It has driven the bus ever since.
                self.cut = Some(now.after(times.penalty));
            } else {
                self.pardon();
            }
        }
    }

    /// The spell goes on beyond its limit: closes the gate, and counts that if the sender still
    /// drives. Returns whether it is an attempt to send a reference instead.
    pub(super) fn limit(
        &mut self,
        line: Line,
        at_limit: AtLimit,
        now: Stamp,
        times: &Times,
    ) -> bool {
        let charged = self.charge(at_limit.answered, times);
        if charged && !now.reached(self.until) {
            return true;
        }
        // Before the first look beyond the limit, the line may have fallen ahead of it.
        let drives = line.dominant || (line.fell && self.clipped);
        self.clipped = true;
        if drives && !self.struck {
            self.struck = true;
            self.strike(Trip::Misplaced, at_limit.trusted, now, times);
        }
        charged
    }

    /// Cuts the sender, or lets its penalty begin anew.
    pub(super) fn trip(&mut self, reason: Trip, now: Stamp, times: &Times) {
        if self.cut.is_none() {
            self.trips = self.trips.saturating_add(1);
            self.reason = Some(reason);
        }
        self.cut = Some(now.after(times.penalty));
    }

    /// Opens the gate, and forgets the counts.
    pub(super) fn pardon(&mut self) {
        self.cut = None;
        self.clipped = false;
        self.pulses = 0;
        self.strikes = 0;
        self.attempts = 0;
        self.untimely = 0;
    }

    /// A basic cycle has passed.
    pub(super) fn end_period(&mut self, forget: bool, now: Stamp, times: &Times) {
        self.pulses = 0;
        self.strikes = 0;
        self.attempts = 0;
        if forget {
            self.untimely = self.untimely.saturating_sub(1);
        }
        let old = self.is_old(now, times);
        if self.spell == Spell::Over && old {
            self.spell = Spell::Never;
        }
        if self.spell == Spell::Dominant && old && now.reached(self.until) {
            // A line that is stuck. The stamps follow it, so that they stay comparable.
            self.until = now;
            self.began = now;
        }
    }

    /// Whether the last spell began longer ago than any frame: it was received, or never will be.
    fn is_old(&self, now: Stamp, times: &Times) -> bool {
        now.ticks_since(self.began) >= times.bits(255).cast_signed()
    }

    /// When it may return, if it was cut.
    pub(super) const fn cut(&self) -> Option<Stamp> {
        self.cut
    }

    /// When a look that finds the line as the one before did changes something.
    #[cfg(feature = "std")]
    pub(super) fn due(&self, spell_gap: u32) -> Option<Stamp> {
        match self.spell {
            Spell::Dominant if !(self.struck && self.clipped) => Some(self.until),
            Spell::Recessive => {
                let over = self.released.after(spell_gap);
                Some(if !self.clipped && over.reached(self.until) {
                    self.until
                } else {
                    over
                })
            }
            _ => None,
        }
    }

    /// Whether the last spell began at `instant`.
    pub(super) fn began_at(&self, instant: Stamp, tolerance: u32) -> bool {
        let off = self.began.ticks_since(instant);
        self.spell != Spell::Never && off.unsigned_abs() <= tolerance
    }

    /// Whether the last spell went on after `instant`.
    pub(super) fn drove_after(&self, instant: Stamp) -> bool {
        self.spell == Spell::Dominant || self.released.reached(instant)
    }

    /// The last spell was this frame, which ended at `now`. Whether the sender may send it there is
    /// known only now.
    pub(super) fn sent(
        &mut self,
        schedule: ScheduleView<'_>,
        frame: &Frame,
        now: Stamp,
        trusted: bool,
        times: &Times,
    ) {
        let reference = schedule.reference_rank(frame.id()).is_some_and(|rank| {
            let network = schedule.network;
            let format = &network.reference_format;
            let whole = Fields::decode(format, frame, network.cycles).is_some();
            rank.is_some() && rank == self.rank && whole
        });
        let message = schedule.known(frame.id());
        let message = message.filter(|known| known.sender == self.node);
        let fits = match self.permit {
            Permit::Window(id) => id == frame.id(),
            Permit::Arbitrating => message.is_some_and(|known| known.is_event || known.retry_late),
            Permit::Reference { .. } => reference,
            Permit::Short | Permit::Own => reference || message.is_some(),
        };
        // A reference beside its time may begin where a window of its sender begins, too.
        let beside = matches!(self.permit, Permit::Window(_) | Permit::Arbitrating) && reference;
        if fits || (beside && self.count_untimely(times)) {
            return;
        }
        // Its own message in another one's place: the guardian may have missed a reference.
        let own = reference || message.is_some();
        let timely = matches!(self.permit, Permit::Reference { untimely: false });
        self.strike(Trip::Identifier, !own || (trusted && !timely), now, times);
    }

    /// Counts a violation, and cuts the sender if it is `certain` or there are too many.
    fn strike(&mut self, reason: Trip, certain: bool, now: Stamp, times: &Times) {
        self.strikes = self.strikes.saturating_add(1);
        let forgiven = self.frames.saturating_add(u16::from(times.config.strikes));
        if certain || self.cut.is_some() || self.strikes > forgiven {
            self.trip(reason, now, times);
        }
    }

    #[cfg(feature = "std")]
    pub(super) fn renumber(&mut self, now: Stamp, times: &Times) {
        if self.spell == Spell::Over && self.is_old(now, times) {
            self.spell = Spell::Never;
        }
        if self.spell == Spell::Never {
            self.permit = Permit::Short;
            (self.clipped, self.struck) = (false, false);
            (self.counted, self.charged) = (false, false);
        }
        let fields = [&mut self.began, &mut self.until, &mut self.released];
        for stamp in fields {
            *stamp = match self.spell {
                Spell::Never => Stamp(0),
                _ => stamp.before(now.0),
            };
        }
        self.cut = self.cut.map(|cut| cut.before(now.0));
    }
}

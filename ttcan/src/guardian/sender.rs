//! One guarded sender: what it may send, and what is counted of it.

use super::config::Times;
use super::watch::{Spell, Window};
use crate::frame::Frame;
use crate::id::Id;
use crate::length;
use crate::matrix::NodeId;
use crate::reference::Fields;
use crate::schedule::ScheduleView;
use crate::time::Stamp;

/// Explained short spells in a basic cycle for each unexplained one that is allowed. With the usual 64, that is more than the
/// 128 flags that a controller sends before its error counter makes them recessive (ISO 11898-1).
const EXPLAINED: u16 = 3;

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

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Sender {
    pub(super) node: NodeId,
    /// Rank as a potential master.
    pub(super) rank: Option<u8>,
    /// Longest stuffed lengths of its shortest and its longest message for arbitrating windows.
    pub(super) events: Option<(u8, u8)>,
    /// Mask and offset of the basic cycles in which it may send those.
    pub(super) event_cycles: (u8, u8),
    /// The last spell that was judged: its beginning, what it may be, whether it was counted as a short one, as one that
    /// nothing explains, or as an attempt to send a reference, and whether it may be the flag behind an own frame.
    began: Stamp,
    window: Window,
    permit: Permit,
    noted: bool,
    counted: bool,
    charged: bool,
    behind_own: bool,
    /// The beginning of the one before, and its window.
    before: (Stamp, Window),
    /// When the sender may return.
    cut: Option<Stamp>,
    /// Short spells that nothing explains, and all that began alone.
    pulses: u8,
    short: u16,
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
        Self {
            node,
            rank: schedule.rank_of(node),
            events,
            event_cycles: (repeat.wrapping_sub(1), offset),
            began: Stamp(0),
            window: Window::NONE,
            permit: Permit::Short,
            noted: false,
            counted: false,
            charged: false,
            behind_own: false,
            before: (Stamp(0), Window::NONE),
            cut: None,
            pulses: 0,
            short: 0,
            strikes: 0,
            frames: schedule.windows_in_two_cycles(node).saturating_add(again),
            attempts: 0,
            untimely: 0,
            trips: 0,
            reason: None,
        }
    }

    /// Whether the last spell is an acknowledge bit or a flag as far as can be told.
    pub(super) const fn is_short(&self) -> bool {
        match self.permit {
            Permit::Short => true,
            Permit::Reference { .. } => !self.charged,
            _ => false,
        }
    }

    /// Whether the last spell is the error flag behind this sender's own frame. A frame without an
    /// acknowledgement ends so.
    pub(super) const fn is_behind_own(&self) -> bool {
        self.behind_own
    }

    /// When it may return, if it was cut.
    pub(super) const fn cut(&self) -> Option<Stamp> {
        self.cut
    }

    /// A spell has begun, with this permission, perhaps `behind` a frame of this sender. It may have been judged
    /// before its slot was known.
    pub(super) fn begin(&mut self, spell: &Spell, permit: Permit, behind: bool) {
        let Spell { began, window, .. } = *spell;
        self.take_back(began, true);
        let again = self.began == began;
        if !again {
            self.before = (self.began, self.window);
        }
        self.window = window;
        let behind_own = if again {
            self.behind_own
        } else {
            behind && !self.is_short()
        };
        self.began = began;
        self.permit = permit;
        self.noted = false;
        self.counted = false;
        self.charged = false;
        self.behind_own = behind_own;
    }

    /// When and where the spell before the last one of its line began. The `last` one may not be judged yet.
    pub(super) fn before(&self, last: Stamp) -> (Stamp, Window) {
        if self.began == last {
            self.before
        } else {
            (self.began, self.window)
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

    /// Whether a short spell may go on as a reference, and as one beside its time.
    pub(super) const fn may_charge(&self, times: &Times) -> (bool, bool) {
        let is_master = self.rank.is_some();
        (
            is_master && self.attempts < times.config.attempts,
            is_master && self.untimely < times.config.untimely,
        )
    }

    /// The spell went on as a reference: counts it if it was `beside` their time, or else as an attempt, if
    /// another sender may have `answered` the one before.
    pub(super) fn charge(&mut self, answered: bool, beside: bool, times: &Times) {
        if beside {
            self.count_untimely(times);
        } else if answered && self.cut.is_none() {
            self.attempts = self.attempts.saturating_add(1);
        }
        self.charged = true;
        self.take_back(self.began, true);
    }

    /// A short spell begins alone at `now`, which nothing explains if it is `unexplained`. Returns whether it cuts the sender.
    pub(super) fn pulse(&mut self, unexplained: bool, times: &Times, now: Stamp) -> bool {
        self.noted = true;
        self.counted = unexplained;
        self.pulses = self.pulses.saturating_add(u8::from(unexplained));
        self.note(1, times, now)
    }

    /// So many more short spells. Returns whether they cut the sender.
    pub(super) fn note(&mut self, spells: u16, times: &Times, now: Stamp) -> bool {
        self.short = self.short.saturating_add(spells);
        let most = u16::from(times.config.pulses).saturating_mul(EXPLAINED);
        let many = self.pulses > times.config.pulses || self.short > most;
        let cuts = many && self.cut.is_none();
        if cuts {
            self.trip(Trip::Pulses, now, times);
        }
        cuts
    }

    /// The spell that began then was no pulse, `if_so`. It takes the same time in any case.
    pub(super) fn take_back(&mut self, began: Stamp, if_so: bool) {
        let is_this = (self.began == began) & if_so;
        let (noted, counted) = (self.noted & is_this, self.counted & is_this);
        self.noted &= !noted;
        self.counted &= !counted;
        self.short = self.short.saturating_sub(u16::from(noted));
        self.pulses = self.pulses.saturating_sub(u8::from(counted));
    }

    /// Lets the sender return, if its time has come. Returns whether it does.
    pub(super) fn return_at(&mut self, driving: bool, now: Stamp, times: &Times) -> bool {
        let returns = self.cut.is_some_and(|cut| now.reached(cut));
        if returns && driving {
            // It has driven the bus ever since.
            self.prolong(now, times);
        } else if returns {
            self.pardon();
        }
        returns && !driving
    }

    /// The time until a sender may return begins anew.
    pub(super) fn prolong(&mut self, now: Stamp, times: &Times) {
        if self.cut.is_some() {
            self.cut = Some(now.after(times.penalty));
        }
    }

    /// Cuts the sender, or lets its penalty begin anew.
    fn trip(&mut self, reason: Trip, now: Stamp, times: &Times) {
        if self.cut.is_none() {
            self.trips = self.trips.saturating_add(1);
            self.reason = Some(reason);
        }
        self.cut = Some(now.after(times.penalty));
    }

    /// Lets the sender return, and forgets the counts.
    pub(super) fn pardon(&mut self) {
        self.cut = None;
        self.pulses = 0;
        self.short = 0;
        self.strikes = 0;
        self.attempts = 0;
        self.untimely = 0;
    }

    /// A basic cycle has passed.
    pub(super) fn end_period(&mut self, forget: bool) {
        self.pulses = 0;
        self.short = 0;
        self.strikes = 0;
        self.attempts = 0;
        if forget {
            self.untimely = self.untimely.saturating_sub(1);
        }
    }

    /// Whether this is a reference of the sender.
    fn is_reference(&self, schedule: ScheduleView<'_>, frame: &Frame) -> bool {
        schedule
            .reference_rank(frame.id())
            .is_some_and(|(rank, master)| {
                let network = schedule.network;
                let format = &network.reference_format;
                let whole = Fields::decode(format, frame, network.cycles).is_some();
                master.is_some() && self.rank == Some(rank) && whole
            })
    }

    /// A spell with this permission was this frame. Whether the sender may send it there is known
    /// only now. Counts a reference beside its time. `Err` if it may not, with whether the frame is its own in
    /// another one's place.
    pub(super) fn may_send(
        &mut self,
        schedule: ScheduleView<'_>,
        frame: &Frame,
        permit: Permit,
        times: &Times,
    ) -> Result<(), bool> {
        let reference = self.is_reference(schedule, frame);
        let message = schedule.known(frame.id());
        let message = message.filter(|known| known.sender == self.node);
        let fits = match permit {
            Permit::Window(id) => id == frame.id(),
            Permit::Arbitrating => message.is_some_and(|known| known.is_event || known.retry_late),
            Permit::Reference { .. } => reference,
            Permit::Short | Permit::Own => reference || message.is_some(),
        };
        // A reference beside its time may begin where a window of its sender begins, too.
        let beside = matches!(permit, Permit::Window(_) | Permit::Arbitrating) && reference;
        if fits || (beside && self.count_untimely(times)) {
            Ok(())
        } else {
            Err(reference || message.is_some())
        }
    }

    /// Counts a violation, and cuts the sender if it is `certain` or there are too many.
    pub(super) fn strike(&mut self, reason: Trip, certain: bool, now: Stamp, times: &Times) {
        self.strikes = self.strikes.saturating_add(1);
        let forgiven = self.frames.saturating_add(u16::from(times.config.strikes));
        if certain || self.cut.is_some() || self.strikes > forgiven {
            self.trip(reason, now, times);
        }
    }

    #[cfg(feature = "std")]
    pub(super) fn renumber(&mut self, now: Stamp, recent: bool, following: bool) {
        self.before = if recent && following {
            (self.before.0.before(now.0), self.before.1)
        } else {
            (Stamp(0), Window::NONE)
        };
        if recent {
            self.began = self.began.before(now.0);
        } else {
            self.began = Stamp(0);
            self.window = Window::NONE;
            self.permit = Permit::Short;
            (self.noted, self.counted, self.charged) = (false, false, false);
            self.behind_own = false;
        }
        self.cut = self.cut.map(|cut| cut.before(now.0));
    }
}

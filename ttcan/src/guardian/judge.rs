//! The lower half of a guardian: it knows the schedule, says what a spell may be, and counts.

use super::config::Times;
use super::plan::{Cursor, Place, Plan};
use super::sender::{Permit, Sender, Trip};
use super::watch::{Evidence, News, Orders, Outlook, Slot, Watch, Window};
use super::{GuardianConfig, GuardianError, GuardianState};
use crate::frame::Frame;
use crate::length;
use crate::matrix::NodeId;
use crate::reference::Fields;
use crate::schedule::ScheduleView;
use crate::time::Stamp;

/// Basic cycles after which a sender may send one more untimely reference.
const UNTIMELY_EVERY: u8 = 8;
/// Bits from the beginning of the acknowledge slot to the end of the frame (ISO 11898-1).
const ACKNOWLEDGE_TO_END: u32 = 9;
/// Bits from the end of the CRC to the end of the frame.
const CRC_TO_END: u32 = 10;
/// The transmitter's last dominant bit is at most so many bits before the end of the CRC: five
/// recessive bits and a tolerance.
const LAST_DOMINANT: u32 = 7;
/// A spell that goes on beyond all limits together with another one counts as so many short ones.
const SHARED_STRIKE: u16 = 8;

/// A frame that was received.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Received<const P: usize> {
    frame: Frame,
    end: Stamp,
    /// Senders that may have sent it, and the windows in which their spells have begun.
    suspects: u32,
    windows: [Window; P],
    /// Whether the guardian was sure of the windows when the frame began.
    trusted: bool,
    /// A reference would have been beside its time.
    untimely: bool,
    /// It began a basic cycle in its time.
    reference: bool,
    /// The guardian follows it as a reference.
    followed: bool,
}

/// The lower half of a guardian of `P` senders: it knows the schedule and the time of the network, says
/// what a spell may be, and counts what a sender does that it may not.
///
/// What follows from a reference has to reach the upper half in time ([`GuardianConfig::handling`]).
/// Everything else can wait until the next frame may be received.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Judge<'s, const P: usize> {
    plan: Plan<'s>,
    senders: [Sender; P],
    /// When each sender may begin a frame next, and where the search for that is.
    slots: [[Option<Slot>; 2]; P],
    cursor: Cursor,
    /// Senders whose last attempt at a reference another one may have answered.
    answered: u32,
    /// When time alone changes something.
    wake: Stamp,
    /// End of the period, one basic cycle long, in which spells are counted.
    period: Stamp,
    periods: u8,
    /// What is still to be accounted: a frame, senders whose period has ended, those that went on
    /// beyond all limits, while the time was sure, and those that were released then.
    received: Option<Received<P>>,
    /// Senders whose spell was an acknowledge bit, and is still to be judged.
    acknowledged: u32,
    ended: u32,
    struck: u32,
    certain: u32,
    /// Senders whose last spell did, and what was told with the last of them.
    beyond: u32,
    witnesses: Option<News<P>>,
    freed: u32,
    pardoned: u32,
    old: u32,
}

impl<'s, const P: usize> Judge<'s, P> {
    const ALL: u32 = Watch::<P>::ALL;

    /// See [`Guardian::new`](super::Guardian::new).
    pub(super) fn new(
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
        if !times.fits(P as u32) {
            return Err(GuardianError::Looks);
        }
        let period = now.after(times.cycle);
        Ok(Self {
            senders: senders.map(|node| Sender::new(schedule, &times, node)),
            slots: [[None; 2]; P],
            cursor: Cursor::default(),
            answered: 0,
            wake: period,
            period,
            periods: 0,
            plan: Plan::new(schedule, times),
            received: None,
            acknowledged: 0,
            ended: 0,
            struck: 0,
            certain: 0,
            beyond: 0,
            witnesses: None,
            freed: 0,
            pardoned: 0,
            old: 0,
        })
    }

    pub(super) const fn times(&self) -> &Times {
        &self.plan.times
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

    /// The sender was replaced or repaired: its counts begin anew, and its gate opens when
    /// [`Watch::obey`] gets the next orders.
    pub fn pardon(&mut self, sender: usize) {
        if let Some(pardoned) = self.senders.get_mut(sender) {
            pardoned.pardon();
            // There are up to 32.
            self.pardoned |= 1u32.wrapping_shl(sender as u32);
            self.settle();
        }
    }

    /// What the spells may be that have begun, and what is to be counted of the others. Of two spells of a
    /// sender between two calls only the later one is judged. So a reference must be told before the flag behind
    /// it: call this at least once in the length of one.
    pub fn rule(&mut self, news: &News<P>, now: Stamp) {
        self.freed |= news.marks.freed;
        if self.plan.is_trusted(now) {
            self.certain |= news.marks.struck;
        }
        let marks = &news.marks;
        // Of spells that were told before. What one behind them may be is only told now.
        let before = marks.charged_before | marks.charged & !marks.begun;
        if before != 0 {
            self.charge(before, marks.charged_beside);
        }
        if news.marks.begun != 0 {
            self.permit(news, now);
        }
        if news.marks.struck != 0 {
            self.struck |= news.marks.struck;
            self.beyond |= news.marks.struck;
            self.witnesses = Some(*news);
        }
    }

    /// Spells went on as references, these ones `beside` their time.
    fn charge(&mut self, charged: u32, beside: u32) {
        let times = &self.plan.times;
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter_mut().enumerate() {
            // `at` is below 32, see `new`.
            let bit = 1u32.wrapping_shl(at as u32);
            if charged & bit != 0 {
                sender.charge(self.answered & bit != 0, beside & bit != 0, times);
            }
        }
        self.answered &= !charged;
    }

    /// Whether the spell of a sender that went on beyond all limits is that of one that answered noise: flags into each
    /// other's delimiters make one long spell, also behind a frame. No sender makes another one drive on with it from its
    /// first bit, nor beyond that one's own limit. What may be a frame is no witness, or else who sends into each frame of
    /// others would have one; but of two frames that begin at once, one loses the arbitration.
    fn answers_noise(&self, news: &News<P>, at: usize) -> bool {
        let Some(spell) = news.spells.get(at) else {
            return false;
        };
        let times = &self.plan.times;
        let frames = framed(news) | news.marks.charged;
        let (mut near, mut earlier) = (0, 0);
        let (mut as_long, mut beside) = (news.active, news.active);
        // loop-bound: senders=32
        for (at, other) in news.spells.iter().enumerate() {
            let off = spell.began.ticks_since(other.began).unsigned_abs();
            near |= u32::from(off <= times.together).wrapping_shl(at as u32);
            earlier |= u32::from(spell.until.reached(other.until)).wrapping_shl(at as u32);
            let lasts = other.released.reached(spell.until);
            as_long |= u32::from(lasts).wrapping_shl(at as u32);
            let overlaps = other.released.reached(spell.began);
            beside |= u32::from(overlaps).wrapping_shl(at as u32);
        }
        let others = !1u32.wrapping_shl(at as u32);
        let with = near & as_long & news.known & others;
        let one = with & !frames != 0;
        let two = with & with.wrapping_sub(1) != 0;
        one || two || self.beyond & earlier & beside & others != 0
    }

    /// Which spells that have begun are short and began at once with another short one, or in the next look: acknowledge
    /// bits, or flags with which senders answer what they have heard at once. Who began alone, and a look ahead of the
    /// others, may be the one that they answer. Only the last such instant counts.
    fn shared(&self, news: &News<P>) -> u32 {
        let times = &self.plan.times;
        let framed = framed(news);
        let short = news.known & !(framed | news.marks.charged);
        let begun = short & news.marks.begun;
        let mut last: Option<Stamp> = None;
        // loop-bound: senders=32
        for (at, spell) in news.spells.iter().enumerate() {
            let is_later = last.is_none_or(|last| spell.began.reached(last));
            let counts = begun.wrapping_shr(at as u32) & 1 != 0 && is_later;
            last = if counts { Some(spell.began) } else { last };
        }
        let Some(last) = last else {
            return 0;
        };
        let (mut near, mut ahead, mut first) = (0, 0, 0);
        let (mut busy, mut longest) = (news.active, 0);
        // loop-bound: senders=32
        for (at, spell) in news.spells.iter().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            // It is larger if it is negative, too.
            let off = last.ticks_since(spell.began).cast_unsigned();
            let is_near = off <= times.together && news.known & bit != 0;
            near |= if is_near { bit } else { 0 };
            first = if !is_near || off < longest {
                first
            } else if off == longest {
                first | bit
            } else {
                bit
            };
            longest = if is_near { longest.max(off) } else { longest };
            let long = off.cast_signed() > times.together.cast_signed();
            ahead |= if long { bit } else { 0 };
            let over = spell.released.after(times.spell_gap);
            busy |= if over.reached(last) { bit } else { 0 };
        }
        // While one sends a frame, no other frame begins.
        let is_busy = ahead & busy & news.known & framed != 0;
        let witnesses = if is_busy { near } else { near & short };
        let two = witnesses & witnesses.wrapping_sub(1);
        let three = near & near.wrapping_sub(1);
        let three = three & three.wrapping_sub(1);
        let alone = if first & first.wrapping_sub(1) == 0 {
            first
        } else {
            0
        };
        if two | three != 0 {
            near & begun & !alone
        } else {
            0
        }
    }

    /// Finds what each spell may be, and counts the short ones that began alone: those that nothing explains, and all.
    fn permit(&mut self, news: &News<P>, now: Stamp) {
        // The guardian of one node sees no other line, and takes for granted while there are references
        // that its attempts are answered.
        let unseen = P == 1 && self.plan.known.is_some();
        let charged = news.marks.charged & news.marks.begun;
        let shared = if P == 1 { 0 } else { self.shared(news) };
        let noted = news.marks.begun & !self.acknowledged & !charged & !shared;
        let counted = noted & !news.marks.excused;
        let mut cuts = 0;
        // loop-bound: senders=32
        for (at, (sender, spell)) in self.senders.iter_mut().zip(&news.spells).enumerate() {
            let is = |mask: u32| mask.wrapping_shr(at as u32) & 1 != 0;
            let mut cut = false;
            if is(news.marks.begun) {
                let permit = self
                    .plan
                    .permit(spell.window, sender, is(news.marks.untimely));
                sender.begin(spell, permit, is(news.marks.behind));
                if is(noted) && sender.is_short() && !sender.is_behind_own() {
                    cut = sender.pulse(is(counted), &self.plan.times, now);
                }
                if is(charged) {
                    let beside = is(news.marks.charged_beside);
                    sender.charge(is(self.answered), beside, &self.plan.times);
                }
            }
            cuts |= u32::from(cut).wrapping_shl(at as u32);
        }
        // A sender that drives may have acknowledged or disturbed what others send.
        self.answered &= !charged;
        let first = news.marks.begun & news.marks.begun.wrapping_neg();
        self.answered |= if unseen {
            news.marks.begun
        } else if news.marks.begun == first {
            Self::ALL & !first
        } else {
            Self::ALL
        };
        self.acknowledged &= !news.marks.begun;
        self.beyond &= !news.marks.begun;
        if cuts != 0 {
            self.settle();
        }
    }

    /// A data frame was received from the bus; `stamp` was taken at its end, and `evidence` up to ten bits behind that: of a
    /// sender that has begun its next spell by then, the one before is known, and of a spell before that one nothing.
    /// Returns whether the guardian follows it as a reference, and
    /// [`Judge::look_ahead`] has to be called now. The rest is for [`Judge::account`].
    pub fn receive(&mut self, frame: &Frame, stamp: Stamp, evidence: &Evidence<P>) -> bool {
        let times = &self.plan.times;
        let end = stamp.offset(times.config.receive_latency.wrapping_neg());
        let bits = length::frame_bits(frame);
        let start = end.before(times.bits(bits));
        self.lose(stamp);
        let (suspects, windows) = self.suspects(evidence, bits, start, end);
        let untimely = self.plan.untimely_until();
        let mut received = Received {
            frame: *frame,
            end,
            suspects,
            windows,
            trusted: self.plan.is_trusted(start),
            untimely: untimely.is_some_and(|until| !start.reached(until)),
            reference: false,
            followed: false,
        };
        let schedule = self.plan.schedule;
        match schedule.reference_rank(frame.id()) {
            Some((rank, Some(_))) => {
                let network = schedule.network;
                let fields = Fields::decode(&network.reference_format, frame, network.cycles);
                let fields = fields.filter(|fields| !fields.next_is_gap || network.longest_gap > 0);
                if let Some(fields) = fields {
                    (received.reference, received.followed) =
                        self.plan.take_reference(&fields, rank, start);
                }
            }
            Some((_, None)) => {}
            None => self.plan.note_message(start),
        }
        let followed = received.followed;
        if followed {
            self.restart();
        }
        self.received = Some(received);
        followed
    }

    /// Finds the senders that have driven from the beginning of a frame to the end of its CRC, with the windows in which
    /// they began, and takes back the counts of those that have acknowledged it. A sender may have begun its next
    /// spell since then.
    fn suspects(
        &mut self,
        evidence: &Evidence<P>,
        bits: u32,
        start: Stamp,
        end: Stamp,
    ) -> (u32, [Window; P]) {
        let times = &self.plan.times;
        let acknowledged = end.before(times.bits(ACKNOWLEDGE_TO_END));
        let body = bits.saturating_sub(CRC_TO_END + LAST_DOMINANT);
        let body = start.after(times.bits(body));
        let judged = evidence.open & evidence.recent;
        let (mut suspects, mut suspects_before, mut acknowledges) = (0, 0, 0);
        let mut windows = [Window::NONE; P];
        let lines = evidence.spells.iter().zip(&mut windows);
        // loop-bound: senders=32
        for (at, (sender, (spell, window))) in self.senders.iter_mut().zip(lines).enumerate() {
            let is = |mask: u32| mask.wrapping_shr(at as u32) & 1 != 0;
            let near = |began: Stamp, instant| {
                let off = began.ticks_since(instant);
                off.unsigned_abs() <= times.tolerance
            };
            let drove = is(evidence.dominant) | spell.released.reached(body);
            let sent = near(spell.began, start) & drove;
            suspects |= u32::from(sent).wrapping_shl(at as u32);
            let before = sender.before(spell.began);
            let sent_before = near(before.0, start);
            suspects_before |= u32::from(sent_before).wrapping_shl(at as u32);
            *window = if sent { spell.window } else { before.1 };
            let acknowledge = near(spell.began, acknowledged);
            acknowledges |= u32::from(acknowledge).wrapping_shl(at as u32);
            sender.take_back(spell.began, acknowledge & is(judged));
        }
        let acknowledges = acknowledges & judged;
        self.acknowledged |= acknowledges & evidence.new;
        let suspects = suspects & judged & !acknowledges;
        // Who acknowledges a frame has not sent it: its spell before was an attempt that lost the arbitration.
        let before = suspects_before & judged & evidence.following & !acknowledges;
        (suspects | before, windows)
    }

    /// Forgets the time if no reference came for so long.
    fn lose(&mut self, now: Stamp) {
        if self.plan.lose(now) {
            self.restart();
        }
    }

    /// The windows of another basic cycle count.
    fn restart(&mut self) {
        self.slots = [[None; 2]; P];
        self.cursor = self.plan.begin();
    }

    /// Whether [`Judge::look_ahead`] would find nothing new at `now`.
    pub fn is_ahead(&self, now: Stamp) -> bool {
        let past = self.past(now);
        let passed =
            |[first, _]: &[Option<Slot>; 2]| first.is_some_and(|slot| past.reached(slot.closes));
        let window = self.plan.window(self.cursor);
        let is_full = window.is_some_and(|window| self.is_full(&window));
        !self.slots.iter().any(passed) && (self.plan.is_over(self.cursor) || is_full)
    }

    /// Whether a sender of this window has two slots ahead of it already.
    fn is_full(&self, window: &Place<'_>) -> bool {
        let mut senders = self.senders.iter().zip(&self.slots);
        senders.any(|(sender, [_, second])| second.is_some() && window.is_for(sender))
    }

    /// A slot that closed before this is of no use any more.
    fn past(&self, now: Stamp) -> Stamp {
        let times = &self.plan.times;
        now.before(times.bits(2 * u32::from(times.config.spell_bits)))
    }

    /// When each sender may begin a frame next. A call looks at one window of the schedule, so it has to be
    /// made once in the shortest one at least, and as soon as a reference was received.
    pub fn look_ahead(&mut self, now: Stamp) -> Outlook<P> {
        let past = self.past(now);
        // loop-bound: senders=32
        for [first, second] in &mut self.slots {
            if first.is_none_or(|slot| past.reached(slot.closes)) {
                *first = second.take();
            }
        }
        let window = self.plan.window(self.cursor);
        let is_full = window.as_ref().is_some_and(|window| self.is_full(window));
        if !self.plan.is_over(self.cursor) && !is_full {
            if let Some(window) = window {
                // loop-bound: senders=32
                for (sender, [first, second]) in self.senders.iter().zip(&mut self.slots) {
                    let slot = self.plan.slot(&window, sender);
                    let slot = slot.filter(|slot| !past.reached(slot.closes));
                    if first.is_none() {
                        *first = slot;
                    } else if slot.is_some() {
                        *second = slot;
                    }
                }
            }
            self.plan.advance(&mut self.cursor);
        }
        let mut outlook = Outlook {
            slots: self.slots,
            timely: 0,
            untimely: 0,
            untimely_until: self.plan.untimely_until(),
        };
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            let (timely, untimely) = sender.may_charge(&self.plan.times);
            outlook.timely |= if timely { bit } else { 0 };
            outlook.untimely |= if untimely { bit } else { 0 };
        }
        outlook
    }

    /// Whether an instant has come that is never more than a basic cycle ahead. If it seems to be, nothing was asked for half
    /// of the counter's range.
    fn has_come(&self, instant: Stamp, now: Stamp) -> bool {
        let ahead = instant.ticks_since(now);
        ahead <= 0 || ahead > self.plan.times.cycle.cast_signed()
    }

    /// Whether [`Judge::account`] has something to do at `now`.
    pub fn is_behind(&self, now: Stamp) -> bool {
        self.received.is_some()
            || self.ended | self.struck | self.freed | self.pardoned | self.old != 0
            || self.has_come(self.wake, now)
    }

    /// One step of what can wait: a frame, a sender that drove beyond all limits, or the end of a period
    /// for one sender. `driving` are the senders that still do ([`Watch::driving`]).
    pub fn account(&mut self, driving: u32, now: Stamp) -> Orders {
        if self.received.is_some() {
            self.attribute();
        } else if let Some(at) = lowest(&mut self.struck) {
            let certain = take(&mut self.certain, at);
            let news = self.witnesses.filter(|_| P > 1);
            let shared = news.is_some_and(|news| self.answers_noise(&news, at));
            if let Some(sender) = self.senders.get_mut(at) {
                if shared {
                    sender.note(SHARED_STRIKE, &self.plan.times, now);
                } else {
                    sender.strike(Trip::Misplaced, certain, now, &self.plan.times);
                }
            }
            if self.struck == 0 {
                self.witnesses = None;
            }
            self.settle();
        } else if let Some(at) = lowest(&mut self.freed) {
            // Good conduct begins here.
            if let Some(sender) = self.senders.get_mut(at) {
                sender.prolong(now, &self.plan.times);
            }
            self.settle();
        } else if let Some(at) = lowest(&mut self.ended) {
            let forget = self.periods.is_multiple_of(UNTIMELY_EVERY);
            if let Some(sender) = self.senders.get_mut(at) {
                sender.end_period(forget);
            }
            self.old |= 1u32.wrapping_shl(at as u32);
        } else if self.has_come(self.wake, now) {
            self.advance(driving, now);
        }
        self.orders(now)
    }

    /// What the upper half has to do.
    pub(super) fn orders(&mut self, now: Stamp) -> Orders {
        Orders {
            cut: self.cut(),
            pardoned: core::mem::take(&mut self.pardoned),
            old: core::mem::take(&mut self.old),
            now,
        }
    }

    /// Finds who sent a frame, and cuts a sender that may not. If several may have sent it, the next step
    /// looks at the next one.
    fn attribute(&mut self) {
        let Some(received) = &mut self.received else {
            return;
        };
        let mut genuine = true;
        if let Some(at) = lowest(&mut received.suspects)
            && let Some(sender) = self.senders.get_mut(at)
            && let Some(window) = received.windows.get(at)
        {
            let (schedule, times) = (self.plan.schedule, &self.plan.times);
            let (frame, end) = (&received.frame, received.end);
            let permit = self.plan.permit(*window, sender, received.untimely);
            if let Err(own) = sender.may_send(schedule, frame, permit, times) {
                let timely = matches!(permit, Permit::Reference { untimely: false });
                // Its own message in another one's place: the guardian may have missed a reference.
                let certain = !own || (received.trusted && !timely);
                sender.strike(Trip::Identifier, certain, end, times);
            }
            genuine = sender.cut().is_none();
        }
        if received.followed && !genuine {
            self.plan.doubt();
        }
        if received.reference {
            // loop-bound: senders=32
            for sender in &mut self.senders {
                sender.forget_attempts();
            }
        }
        if received.suspects == 0 {
            self.received = None;
        }
        self.settle();
    }

    /// Time has passed that changes something.
    fn advance(&mut self, driving: u32, now: Stamp) {
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter_mut().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            if sender.return_at(driving & bit != 0, now, &self.plan.times) {
                self.pardoned |= bit;
            }
        }
        self.lose(now);
        if self.has_come(self.period, now) {
            self.period = now.after(self.plan.times.cycle);
            self.periods = self.periods.wrapping_add(1);
            self.ended = Self::ALL;
        }
        self.settle();
    }

    /// The senders that are cut.
    fn cut(&self) -> u32 {
        let mut cut = 0;
        // loop-bound: senders=32
        for (at, sender) in self.senders.iter().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            cut |= if sender.cut().is_some() { bit } else { 0 };
        }
        cut
    }

    /// Finds when time alone changes something.
    fn settle(&mut self) {
        let mut wake = self.period;
        if let Some(lost) = self.plan.lost_at()
            && wake.reached(lost)
        {
            wake = lost;
        }
        // loop-bound: senders=32
        for sender in &self.senders {
            if let Some(cut) = sender.cut()
                && wake.reached(cut)
            {
                wake = cut;
            }
        }
        self.wake = wake;
    }

    /// When time alone changes something. Simulations can leave earlier calls of [`Judge::account`] out.
    #[cfg(feature = "std")]
    pub const fn wake(&self) -> Stamp {
        self.wake
    }

    #[cfg(feature = "std")]
    pub(super) fn renumber(&mut self, now: Stamp, recent: u32, following: u32) {
        self.periods %= UNTIMELY_EVERY;
        // They are found again ahead of each spell.
        self.restart();
        let renumber = |stamp: &mut Stamp| *stamp = stamp.before(now.0);
        if let Some(known) = &mut self.plan.known {
            renumber(&mut known.mark);
        }
        // All is accounted when a state is compared.
        self.witnesses = None;
        self.beyond &= recent;
        renumber(&mut self.period);
        renumber(&mut self.wake);
        for (at, sender) in self.senders.iter_mut().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            sender.renumber(now, recent & bit != 0, following & bit != 0);
        }
    }
}

/// The lines whose last spell began in a slot.
fn framed<const P: usize>(news: &News<P>) -> u32 {
    let mut framed = 0;
    // loop-bound: senders=32
    for (at, spell) in news.spells.iter().enumerate() {
        let is_framed = u32::from(spell.window.entry().is_some());
        framed |= is_framed.wrapping_shl(at as u32);
    }
    framed
}

/// Takes the lowest bit of a mask, and tells which it is.
fn lowest(mask: &mut u32) -> Option<usize> {
    let at = mask.trailing_zeros();
    *mask &= mask.wrapping_sub(1);
    (at < 32).then_some(at as usize)
}

/// Takes a bit of a mask.
fn take(mask: &mut u32, at: usize) -> bool {
    let bit = 1u32.wrapping_shl(at as u32);
    let is_set = *mask & bit != 0;
    *mask &= !bit;
    is_set
}

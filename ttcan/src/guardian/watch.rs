//! The upper half of a guardian: it follows the TX lines and closes gates.

use super::config::Times;
use crate::time::Stamp;

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

/// When a sender may begin a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Slot {
    /// The first and the last instant.
    pub(super) opens: Stamp,
    pub(super) closes: Stamp,
    /// How long it may drive then, in ticks.
    pub(super) length: u32,
    pub(super) window: Window,
}

impl Slot {
    fn contains(&self, began: Stamp) -> bool {
        // One comparison for both ends, without a branch.
        (began.ticks_since(self.opens) | self.closes.ticks_since(began)) >= 0
    }
}

/// A window in the schedule, or none, and whether the reference of its basic cycle was not received yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Window(u32);

impl Window {
    pub(super) const NONE: Self = Self(0);
    /// There is one.
    const IS: u32 = 1 << 31;
    const DUE: u32 = 1 << 30;

    pub(super) fn new(entry: u16, is_due: bool) -> Self {
        let due = if is_due { Self::DUE } else { 0 };
        Self(u32::from(entry) | due | Self::IS)
    }

    /// Its entry in the schedule.
    pub(super) const fn entry(self) -> Option<u16> {
        if self.0 & Self::IS != 0 {
            Some((self.0 & 0xFFFF) as u16)
        } else {
            None
        }
    }

    pub(super) const fn is_due(self) -> bool {
        self.0 & Self::DUE != 0
    }
}

/// The slots of all senders, as [`Watch`] has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Slots<const P: usize> {
    first: [Slot; P],
    second: [Slot; P],
    /// Senders that have a first and a second one.
    firsts: u32,
    seconds: u32,
}

/// When each sender may begin a frame next, for [`Watch::publish`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Outlook<const P: usize> {
    pub(super) slots: [[Option<Slot>; 2]; P],
    /// Senders whose short spell may go on as a reference, and as one beside its time.
    pub(super) timely: u32,
    pub(super) untimely: u32,
    /// Until when a reference is beside its time, if it can be.
    pub(super) untimely_until: Option<Stamp>,
}

/// The last spell of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Spell {
    /// The middle of the time between two looks in which it began.
    pub(super) began: Stamp,
    /// The instant up to which the sender may drive.
    pub(super) until: Stamp,
    /// The first look that found the line recessive again.
    pub(super) released: Stamp,
    /// The window in which it began.
    pub(super) window: Window,
}

/// What has happened on the lines since [`Watch::news`] was called before, for [`Judge::rule`](super::Judge::rule).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct News<const P: usize> {
    pub(super) spells: [Spell; P],
    /// Lines in a spell, and those of whose last spell something is known. A guardian of one sender needs neither.
    pub(super) active: u32,
    pub(super) known: u32,
    pub(super) marks: Marks,
}

/// The part of the news that is collected from look to look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct Marks {
    /// Lines whose last spell began.
    pub(super) begun: u32,
    /// Of those: it began while another sender was in a short spell, or its gate closed in one, which all
    /// answer.
    pub(super) excused: u32,
    /// Of those: it began so soon after the spell before that it may be the error flag behind the
    /// sender's own frame.
    pub(super) behind: u32,
    /// Of those: a reference would be beside its time.
    pub(super) untimely: u32,
    /// Spells that went on beyond their limit as references; those of them that have another one behind
    /// them; and those that were beside the time of references.
    pub(super) charged: u32,
    pub(super) charged_before: u32,
    pub(super) charged_beside: u32,
    /// Spells that went on beyond all limits.
    pub(super) struck: u32,
    /// Lines that were released after such a spell.
    pub(super) freed: u32,
}

/// The lines at one moment: what [`Judge::receive`](super::Judge::receive) needs to find a frame's sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Evidence<const P: usize> {
    pub(super) spells: [Spell; P],
    /// Lines whose last spell is not long past.
    pub(super) recent: u32,
    /// Of those: the one before may have been a frame too, which ended right ahead of it.
    pub(super) following: u32,
    /// Lines whose last spell is still to be judged, be it that its slot is still to be found.
    pub(super) new: u32,
    /// Lines that are dominant.
    pub(super) dominant: u32,
    /// Gates that are open.
    pub(super) open: u32,
}

/// What the lower half wants changed, for [`Watch::obey`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Orders {
    /// Senders that are cut.
    pub(super) cut: u32,
    /// Senders that return.
    pub(super) pardoned: u32,
    /// Senders whose last spell may be long past.
    pub(super) old: u32,
    pub(super) now: Stamp,
}

/// The upper half of a guardian of `P` senders: it follows the lines, and closes the gate of a spell that
/// goes on beyond its limit. A look takes about the same time whatever it finds, and waits for nothing.
///
/// It knows beforehand when a sender may begin a frame ([`Watch::publish`]). Any other spell may take
/// [`GuardianConfig::spell_bits`](super::GuardianConfig::spell_bits).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Watch<const P: usize> {
    spells: [Spell; P],
    /// Lines in a spell, those of them that were recessive at the last look, and lines whose last spell is
    /// not long past.
    active: u32,
    recessive: u32,
    recent: u32,
    /// As in [`Evidence`], but of all lines.
    following: u32,
    /// Gates that are closed until the spell is over; spells that went on beyond all limits; those
    /// that went on as a reference, those that may, and those that began in a slot.
    clipped: u32,
    struck: u32,
    charged: u32,
    granted: u32,
    framed: u32,
    /// Spells that would be untimely references.
    beside: u32,
    /// Spells that have begun, and whose slot is still to be found: one in each look.
    starting: u32,
    cut: u32,
    open: Gates,
    slots: Slots<P>,
    /// As in [`Outlook`].
    timely: u32,
    untimely: u32,
    untimely_until: Option<Stamp>,
    news: Marks,
    /// Longest short spell, a reference, the rest that ends a spell, half of the time from look to look,
    /// and the longest rest between a frame and a flag behind it, or its sender's next frame, in ticks.
    short: u32,
    reference: u32,
    gap: u32,
    half_interval: u32,
    behind: u32,
    next: u32,
    /// A spell that began longer ago than this is long past, unless it goes on.
    longest: u32,
}

impl<const P: usize> Slots<P> {
    const NONE: Self = {
        let none = Slot {
            opens: Stamp(0),
            closes: Stamp(0),
            length: 0,
            window: Window::NONE,
        };
        Self {
            first: [none; P],
            second: [none; P],
            firsts: 0,
            seconds: 0,
        }
    };
}

impl<const P: usize> Watch<P> {
    /// All senders, bit by bit. A guardian has 1 to 32.
    pub(super) const ALL: u32 = u32::MAX.wrapping_shr(32u32.wrapping_sub(P as u32));

    pub(super) fn new(times: &Times) -> Self {
        let never = Stamp(0);
        let spell = Spell {
            began: never,
            until: never,
            released: never,
            window: Window::NONE,
        };
        Self {
            spells: [spell; P],
            active: 0,
            recessive: 0,
            recent: 0,
            following: 0,
            clipped: 0,
            struck: 0,
            charged: 0,
            granted: 0,
            framed: 0,
            beside: 0,
            starting: 0,
            cut: 0,
            open: Gates(Self::ALL),
            slots: Slots::NONE,
            timely: 0,
            untimely: 0,
            untimely_until: None,
            news: Marks::default(),
            short: times.bits(u32::from(times.config.spell_bits)),
            reference: times.reference,
            gap: times.spell_gap,
            half_interval: times.half_interval,
            behind: times.behind,
            next: times.next,
            longest: times.bits(255),
        }
    }

    /// Whether no line is in a spell and all gates are open. A look that finds all lines recessive changes nothing
    /// then, so looks may be left out until a line becomes dominant, while the lower half goes on. The edge
    /// wakes the owner, and the first look has to come within the
    /// [interval](super::GuardianConfig::interval) behind it: that is as if a look had been right ahead of the edge, so
    /// what holds from look to look still holds.
    pub const fn is_at_rest(&self) -> bool {
        self.active == 0 && self.open.0 == Self::ALL
    }

    /// Whether no line is in a spell, be it that gates are closed. With an edge that wakes the owner, the next look is due
    /// at [`Watch::due`], or as soon as a line becomes dominant, as after a [rest](Self::is_at_rest).
    ///
    /// In a spell, an owner that is woken by edges looks at [`Watch::due`], and when a line has been recessive for the 5.5
    /// bits that end a spell. It then says first when the line was released: a look with the stamp of the last edge
    /// that finds it recessive, and another one with that of now.
    pub const fn is_between_spells(&self) -> bool {
        self.active == 0
    }

    /// The gates that are open.
    pub const fn gates(&self) -> Gates {
        self.open
    }

    /// What the TX lines did since the look before, at `now`. Returns the gates that are open until
    /// the next look.
    #[inline]
    pub fn look(&mut self, lines: Lines, now: Stamp) -> Gates {
        let seen = (lines.dominant | lines.fell) & Self::ALL;
        if seen | self.active != 0 {
            self.follow(lines, seen, now);
        }
        self.open
    }

    /// A look that finds a line in a spell. What the lines did is found for all of them at once, bit by bit:
    /// so the time of a look hardly depends on it.
    fn follow(&mut self, lines: Lines, seen: u32, now: Stamp) {
        let mut ended = 0;
        let mut rested = 0;
        // loop-bound: senders=32
        for (at, spell) in self.spells.iter().enumerate() {
            // `at` is below 32.
            let until = u32::from(now.reached(spell.until));
            ended |= until.wrapping_shl(at as u32);
            let rest = u32::from(now.reached(spell.released.after(self.gap)));
            rested |= rest.wrapping_shl(at as u32);
        }
        let dominant = lines.dominant & self.active;
        let quiet = self.active & !dominant;
        let released = quiet & (lines.fell | !self.recessive);
        let over = quiet & !released & rested;
        self.recessive = self.recessive & !dominant | released;
        // A gate that is closed for good stays so until the line was released.
        let stopped = self.struck & self.clipped;
        self.news.freed |= released & stopped;
        let mut limit = ended & self.active & !over & !stopped;
        limit &= dominant | released | !self.clipped;
        let charged = limit & self.granted;
        limit &= !charged;
        if charged != 0 {
            self.charge(charged);
        }
        // Before the first look beyond the limit, a line that was released may have fallen ahead of it.
        let drives = limit & (dominant | lines.fell & self.clipped) & !self.struck;
        self.struck |= drives;
        self.news.struck |= drives;
        self.active &= !over;
        // What was stopped is no frame that will be received.
        self.recent &= !(over & self.clipped);
        self.clipped = self.clipped & !over | limit;
        let begin = seen & !self.active & !over;
        let released = released | begin & !lines.dominant;
        if begin != 0 {
            self.begin(begin, lines.dominant, now);
        }
        if released != 0 {
            // loop-bound: senders=32
            for (at, spell) in self.spells.iter_mut().enumerate() {
                let is_released = released.wrapping_shr(at as u32) & 1 != 0;
                spell.released = if is_released { now } else { spell.released };
            }
        }
        if self.starting != 0 {
            self.start();
        }
        self.settle();
    }

    /// The first of these spells, which may, goes on as a reference. The others wait for the next look.
    fn charge(&mut self, charged: u32) {
        let at = charged.trailing_zeros();
        let bit = 1u32.wrapping_shl(at);
        if let Some(spell) = self.spells.get_mut(at as usize) {
            spell.until = spell.began.after(self.reference);
        }
        self.granted &= !bit;
        self.charged |= bit;
        self.news.charged |= bit;
        self.news.charged_beside = self.news.charged_beside & !bit | self.beside & bit;
    }

    /// The lines of these senders have become dominant since the look before.
    fn begin(&mut self, begin: u32, dominant: u32, now: Stamp) {
        let began = now.before(self.half_interval);
        let until = now.after(self.short);
        let short = !self.framed & !self.charged & !self.starting;
        let excused = self.active & (self.clipped | short) != 0;
        // Whether the line's last spell can be an own frame.
        let whole = self.recent & !self.struck;
        let (mut behind, mut following) = (0, 0);
        // Without branches, so that the time does not depend on which lines begin.
        // loop-bound: senders=32
        for (at, spell) in self.spells.iter_mut().enumerate() {
            let begun = begin.wrapping_shr(at as u32) & 1 != 0;
            let rest = began.ticks_since(spell.released).cast_unsigned();
            // It is larger if it is negative, too.
            let soon = u32::from(rest <= self.behind);
            behind |= soon.wrapping_shl(at as u32);
            let next = u32::from(rest <= self.next);
            following |= next.wrapping_shl(at as u32);
            spell.began = if begun { began } else { spell.began };
            spell.until = if begun { until } else { spell.until };
        }
        self.news.behind = self.news.behind & !begin | behind & whole & begin;
        self.following = self.following & !begin | following & whole & begin;
        self.news.excused = self.news.excused & !begin | if excused { begin } else { 0 };
        self.news.begun &= !begin;
        self.news.charged_before |= self.news.charged & begin;
        self.news.charged &= !begin;
        self.starting |= begin;
        self.active |= begin;
        self.recent |= begin;
        self.recessive = self.recessive & !begin | begin & !dominant;
        self.struck &= !begin;
        self.charged &= !begin;
        self.granted &= !begin;
        self.framed &= !begin;
    }

    /// Finds the slot of a spell that has begun.
    fn start(&mut self) {
        let at = self.starting.trailing_zeros();
        let bit = 1u32.wrapping_shl(at);
        self.starting &= !bit;
        self.news.begun |= bit;
        let place = at as usize;
        let Some(spell) = self.spells.get_mut(place) else {
            return;
        };
        let fits = |slots: &[Slot; P], there: u32| {
            let slot = slots.get(place).filter(|_| there & bit != 0);
            slot.copied().filter(|slot| slot.contains(spell.began))
        };
        let slot = fits(&self.slots.first, self.slots.firsts);
        let slot = slot.or_else(|| fits(&self.slots.second, self.slots.seconds));
        if let Some(slot) = slot {
            // The time is counted from the look that found it.
            let found = spell.began.after(self.half_interval);
            spell.until = found.after(slot.length);
            spell.window = slot.window;
            self.framed |= bit;
            return;
        }
        spell.window = Window::NONE;
        let untimely = self.untimely_until;
        let untimely = untimely.is_some_and(|until| !spell.began.reached(until));
        let (granted, untimely) = if untimely {
            (self.untimely, bit)
        } else {
            (self.timely, 0)
        };
        self.granted |= granted & bit;
        self.beside = self.beside & !bit | untimely;
        self.news.untimely = self.news.untimely & !bit | untimely;
    }

    /// What has happened since this was called before. Of two short spells of a line, only the later one
    /// is told.
    pub fn news(&mut self) -> News<P> {
        News {
            spells: self.spells,
            active: if P == 1 { 0 } else { self.active },
            known: if P == 1 { 0 } else { self.recent | self.struck },
            marks: core::mem::take(&mut self.news),
        }
    }

    /// The lines as they are now.
    pub const fn evidence(&self) -> Evidence<P> {
        Evidence {
            spells: self.spells,
            recent: self.recent,
            following: self.following & self.recent,
            new: self.news.begun | self.starting,
            dominant: self.active & !self.recessive,
            open: self.open.0,
        }
    }

    /// The senders that drive the bus beyond all limits.
    pub const fn driving(&self) -> u32 {
        self.active & self.struck
    }

    /// Whether a spell begins by what a look found.
    pub(super) const fn begins(&self, lines: Lines) -> bool {
        (lines.dominant | lines.fell) & Self::ALL & !self.active != 0
    }

    /// Whether a look at the same lines would still change something.
    pub(super) fn is_behind(&self, now: Stamp) -> bool {
        self.due().is_some_and(|due| now.reached(due))
    }

    /// Whether there is something that was not told yet.
    pub fn has_news(&self) -> bool {
        let Marks {
            begun,
            charged,
            charged_before,
            struck,
            freed,
            ..
        } = self.news;
        begun | charged | charged_before | struck | freed != 0
    }

    /// Lines in a spell, or whose last one is not long past.
    #[cfg(feature = "std")]
    pub(super) const fn recent(&self) -> u32 {
        self.active | self.recent
    }

    /// Those whose spell before may still be asked for.
    #[cfg(feature = "std")]
    pub(super) const fn following(&self) -> u32 {
        self.following
    }

    /// Takes over when the sender with this index may begin a frame next. A spell that has begun in a slot that
    /// was not known then may go on, unless it was stopped.
    pub fn publish(&mut self, outlook: &Outlook<P>, sender: usize) {
        let at = sender;
        let Some([first, second]) = outlook.slots.get(at) else {
            return;
        };
        // There are up to 32.
        let bit = 1u32.wrapping_shl(at as u32);
        self.timely = outlook.timely;
        self.untimely = outlook.untimely;
        self.untimely_until = outlook.untimely_until;
        self.slots.firsts &= !bit;
        self.slots.seconds &= !bit;
        if let (Some(slot), Some(place)) = (first, self.slots.first.get_mut(at)) {
            *place = *slot;
            self.slots.firsts |= bit;
        }
        if let (Some(slot), Some(place)) = (second, self.slots.second.get_mut(at)) {
            *place = *slot;
            self.slots.seconds |= bit;
        }
        let stopped = self.clipped | self.charged | self.framed | self.starting;
        if self.active & !stopped & bit != 0
            && let Some(spell) = self.spells.get_mut(at)
            && let Some(slot) = first.filter(|slot| slot.contains(spell.began))
        {
            // The time is counted from the look that found it.
            let found = spell.began.after(self.half_interval);
            spell.until = found.after(slot.length);
            spell.window = slot.window;
            self.granted &= !bit;
            self.framed |= bit;
            self.news.begun |= bit;
        }
    }

    /// Closes the gates of the senders that are cut, and opens those of the ones that return.
    pub fn obey(&mut self, orders: Orders) {
        let resting = orders.old & !self.active & self.recent;
        if resting != 0 {
            // loop-bound: senders=32
            for (at, spell) in self.spells.iter().enumerate() {
                let bit = 1u32.wrapping_shl(at as u32);
                let age = orders.now.ticks_since(spell.began);
                if resting & bit != 0 && age >= self.longest.cast_signed() {
                    self.recent &= !bit;
                }
            }
        }
        self.cut = orders.cut;
        self.clipped &= !orders.pardoned;
        self.settle();
    }

    fn settle(&mut self) {
        self.open = Gates(Self::ALL & !(self.cut | self.clipped));
    }

    /// Forgets the counts of a sender's spell: its gate opens.
    pub(super) fn pardon(&mut self, bit: u32) {
        self.cut &= !bit;
        self.clipped &= !bit;
        self.settle();
    }

    /// When the first spell that is not stopped for good reaches its limit: a look there closes its gate, or finds that it
    /// goes on behind a closed one.
    pub fn limit(&self) -> Option<Stamp> {
        let counted = self.active & !(self.struck & self.clipped);
        let mut limit: Option<Stamp> = None;
        // loop-bound: senders=32
        for (at, spell) in self.spells.iter().enumerate() {
            let is_counted = counted.wrapping_shr(at as u32) & 1 != 0;
            if is_counted && limit.is_none_or(|limit| !spell.until.reached(limit)) {
                limit = Some(spell.until);
            }
        }
        limit
    }

    /// When a look that finds the lines as the one before did changes something. An owner that edges wake can leave
    /// earlier ones out.
    pub fn due(&self) -> Option<Stamp> {
        let mut due: Option<Stamp> = None;
        for (at, spell) in self.spells.iter().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            let next = if self.starting & bit != 0 {
                Some(spell.began)
            } else if self.active & bit == 0 {
                None
            } else if self.recessive & bit == 0 {
                (self.struck & self.clipped & bit == 0).then_some(spell.until)
            } else {
                let over = spell.released.after(self.gap);
                let limit = self.clipped & bit == 0 && over.reached(spell.until);
                Some(if limit { spell.until } else { over })
            };
            due = match (due, next) {
                (Some(due), Some(next)) if !due.reached(next) => Some(due),
                (due, next) => next.or(due),
            };
        }
        due
    }

    #[cfg(feature = "std")]
    pub(super) fn renumber(&mut self, now: Stamp) {
        // They are published again ahead of each spell.
        self.slots = Slots::NONE;
        (self.timely, self.untimely, self.untimely_until) = (0, 0, None);
        let past = !self.active;
        for (at, spell) in self.spells.iter_mut().enumerate() {
            let bit = 1u32.wrapping_shl(at as u32);
            if past & bit != 0 && now.ticks_since(spell.began) >= self.longest.cast_signed() {
                self.recent &= !bit;
            }
            let known = (self.active | self.recent) & bit != 0;
            let renumber = |stamp: Stamp| if known { stamp.before(now.0) } else { Stamp(0) };
            spell.began = renumber(spell.began);
            spell.until = renumber(spell.until);
            spell.released = renumber(spell.released);
            spell.window = if known { spell.window } else { Window::NONE };
        }
        let known = self.active | self.recent;
        self.following &= self.recent;
        self.struck &= known;
        self.charged &= known;
        self.framed &= known;
        self.granted &= self.active;
        self.beside &= self.active;
    }
}

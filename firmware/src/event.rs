//! The event-triggered way: each message goes out as soon as it is put (thesis 2.2.5.1).
//!
//! The [`Link`] of this module has the calls of [`link::Link`](crate::link::Link) that the tasks
//! of a node use, so that one source serves both ways. There is no schedule, no time master and no
//! global time: the identifiers alone decide which frame comes first, and a command carries time
//! 0.
//!
//! Up to three frames are in the mailboxes of the controller, where the lowest identifier competes
//! first. The others wait in an [`Outbox`], which has one frame of each message at most: new data
//! replace those that wait. When an attempt ends, the transmit interrupt loads the most urgent frame
//! that waits. A frame that is more urgent than all in the mailboxes has one of them withdrawn, unless
//! that is on the bus already. With three messages or fewer, no frame of a node waits for another
//! one's interrupt, so nothing less urgent gets before it on the bus.
//!
//! # Who repeats a frame
//! The controller attempts each frame once (NART), as in the schedule, and the link repeats it:
//! - After a lost arbitration the frame is in its mailbox again while the winner is still on the bus,
//!   or a more urgent one is. A controller that repeats would keep the old data.
//! - Without a second node on the bus no frame is acknowledged. The error counter of the
//!   controller stops at 128 then (ISO 11898-1), and it would repeat without end. The link loads no
//!   frame after [`ATTEMPTS`] attempts that failed by an error, until its next supervision.
//!
//! A frame that loses arbitration again and again is dropped after two periods of its message: data
//! of that age are of no use.
//!
//! # Supervision
//! The window timer fires once in each basic cycle ([`Link::service`]), and shows the watchdog that it
//! works. Every few cycles the node drops frames and commands that are too old ([`Link::tidy`]). No
//! message waits for either.
//!
//! A node takes the frames of those messages only that the network file says it receives; the filter
//! of its controller keeps others from it.

use network::{MISSED_PERIODS, Message};
use sled_common::can::{ErrorState, MAILBOXES, Occupied, Outcome, Received};
use sled_common::clock::Oscillator;
use ttcan::{
    ClockState, ErrorLevel, Frame, Id, MasterState, Micros, NodeId, QueueError, Severe, Status,
    SyncState, SystemMatrix, WindowKind,
};

use crate::console::BusView;
use crate::design;
use crate::ends::Ends;
use crate::link::{AnyLink, Arrival, Counters, News, Port, Silence, WindowTimer, event};

/// Attempts that may fail by an error on the bus before the node rests until its next supervision. The
/// frames that are in the other mailboxes then are still attempted.
pub const ATTEMPTS: u8 = 3;

/// How a message of an exclusive window is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route {
    /// Its identifier.
    pub id: Id,
    /// Its number of data bytes, 0 to 8.
    pub len: u8,
    /// The node that sends it.
    pub sender: NodeId,
    /// Its period: that of its window in the matrix.
    pub period: Micros,
    /// How many messages of the same sender come before it in the matrix.
    pub place: u8,
}

/// The messages of a matrix, one place for each of its windows. A window that is not exclusive, and
/// each further window of one message, has none.
///
/// # Panics
/// While the constant is computed, if `WINDOWS` is not [`SystemMatrix::window_count`].
pub const fn routes<const WINDOWS: usize>(matrix: &SystemMatrix<'_>) -> [Option<Route>; WINDOWS] {
    let config = matrix.config();
    assert!(
        config.windows.len() == WINDOWS,
        "one route for each window of the matrix"
    );
    let mut routes: [Option<Route>; WINDOWS] = [None; WINDOWS];
    let mut at = 0;
    while at < WINDOWS {
        let window = &config.windows[at];
        if let WindowKind::Exclusive {
            id, len, sender, ..
        } = window.kind
            && !names(&routes, id)
        {
            let repeat = if window.repeat == 0 { 1 } else { window.repeat };
            let cycle = config.basic_cycle.ticks();
            routes[at] = Some(Route {
                id,
                len,
                sender,
                period: Micros::micros(cycle.saturating_mul(repeat as u32)),
                place: count(&routes, sender),
            });
        }
        at += 1;
    }
    routes
}

/// How many of the routes are a node's.
const fn count(routes: &[Option<Route>], node: NodeId) -> u8 {
    let (mut at, mut count) = (0, 0);
    while at < routes.len() {
        if let Some(route) = &routes[at]
            && route.sender.0 == node.0
        {
            count += 1;
        }
        at += 1;
    }
    count
}

/// Whether one of the routes has this identifier.
const fn names(routes: &[Option<Route>], id: Id) -> bool {
    let mut at = 0;
    while at < routes.len() {
        if let Some(route) = &routes[at]
            && route.id.raw() == id.raw()
            && route.id.is_extended() == id.is_extended()
        {
            return true;
        }
        at += 1;
    }
    false
}

/// The most messages that a node of this matrix sends: cyclic ones and events.
pub const fn places(matrix: &SystemMatrix<'_>) -> usize {
    let config = matrix.config();
    let mut most = 0;
    let mut node = 0;
    while node < matrix.node_count() {
        let mut own = 0;
        let mut at = 0;
        while at < config.windows.len() {
            if let WindowKind::Exclusive { sender, .. } = config.windows[at].kind
                && sender.0 as usize == node
            {
                own += 1;
            }
            at += 1;
        }
        at = 0;
        while at < config.events.len() {
            if config.events[at].sender.0 as usize == node {
                own += 1;
            }
            at += 1;
        }
        if own > most {
            most = own;
        }
        node += 1;
    }
    most
}

/// Which node of which network an image is.
#[derive(Clone, Copy, Debug)]
pub struct Identity<const WINDOWS: usize> {
    /// The messages of the network: see [`routes`].
    pub routes: &'static [Option<Route>; WINDOWS],
    /// Time between two supervisions.
    pub basic_cycle: Micros,
    /// The node.
    pub node: NodeId,
    /// The event message that the node waits for: the request for its self-test.
    pub awaited: Id,
    /// Standard identifiers of the messages that it receives. The controller takes no others.
    pub received: &'static [u16],
}

/// A frame that is to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiting {
    /// The frame.
    pub frame: Frame,
    /// Stamp of its last use: later it is dropped.
    pub expires: u32,
}

impl Waiting {
    /// Whether it is too old at `now`.
    const fn is_old(&self, now: u32) -> bool {
        now.wrapping_sub(self.expires).cast_signed() > 0
    }
}

/// The place of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    /// Whose place it is; `None` until it is claimed.
    id: Option<Id>,
    /// Its newest frame. The controller has a copy of one that is in a mailbox.
    newest: Option<Waiting>,
    /// The newest frame is not in a mailbox, and is to be sent.
    waits: bool,
    /// The newest frame is in a mailbox, or an older one that leaves it.
    sending: bool,
}

impl Place {
    const FREE: Self = Self {
        id: None,
        newest: None,
        waits: false,
        sending: false,
    };
}

/// The frames of a node that are to be sent: of each of up to `PLACES` identifiers, one that waits
/// and one in a mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outbox<const PLACES: usize> {
    places: [Place; PLACES],
    mailboxes: [Option<Loaded>; MAILBOXES],
}

/// The frame in a mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Loaded {
    id: Id,
    place: u8,
    /// It is being withdrawn.
    leaving: bool,
}

/// What a frame that has come to wait needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// This mailbox is free for it.
    Load(usize),
    /// The frame in this mailbox gives way.
    Withdraw(usize),
    /// Nothing: a mailbox becomes free.
    Patience,
}

impl<const PLACES: usize> Default for Outbox<PLACES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const PLACES: usize> Outbox<PLACES> {
    /// Nothing is to be sent.
    pub const fn new() -> Self {
        Self {
            places: [Place::FREE; PLACES],
            mailboxes: [None; MAILBOXES],
        }
    }

    /// The place of an identifier. The places are claimed in order.
    ///
    /// # Errors
    /// [`QueueError::Full`]: all places belong to other identifiers.
    // Not inlined, so that the analysis finds the bounds of its loops.
    #[inline(never)]
    pub fn claim(&mut self, id: Id) -> Result<usize, QueueError> {
        let mut places = self.places.iter_mut().enumerate();
        let found = places.find(|(_, place)| place.id.is_none_or(|owner| owner == id));
        let (at, place) = found.ok_or(QueueError::Full)?;
        place.id = Some(id);
        Ok(at)
    }

    /// The place of an identifier that has claimed one.
    #[inline(never)]
    fn place_of(&self, id: Id) -> Option<&Place> {
        self.places.iter().find(|place| place.id == Some(id))
    }

    /// Drops all frames. The places keep their owners.
    pub fn clear(&mut self) {
        for place in &mut self.places {
            (place.waits, place.sending) = (false, false);
        }
        self.mailboxes = [None; MAILBOXES];
    }

    /// Lets a frame wait, at its place. It replaces one that waits there already; then the first
    /// result is true.
    #[inline]
    pub fn insert(&mut self, place: usize, new: Waiting) -> (bool, Need) {
        let Some(slot) = self.places.get_mut(place) else {
            return (false, Need::Patience);
        };
        let replaced = slot.waits;
        (slot.newest, slot.waits) = (Some(new), true);
        let id = new.frame.id();
        if !slot.sending {
            if let Some(mailbox) = self.mailboxes.iter().position(Option::is_none) {
                return (replaced, Need::Load(mailbox));
            }
            return (replaced, self.less_urgent(id));
        }
        // An older frame of the same message gives way.
        let older = |loaded: &Option<Loaded>| loaded.is_some_and(|loaded| loaded.id == id);
        let need = match self.mailboxes.iter().position(older) {
            Some(mailbox) => Need::Withdraw(mailbox),
            None => Need::Patience,
        };
        (replaced, need)
    }

    /// The mailbox with the least urgent frame that is not being withdrawn, if it is less urgent than
    /// this identifier.
    #[inline(never)]
    fn less_urgent(&self, id: Id) -> Need {
        let (mut least, mut need) = (id, Need::Patience);
        for (mailbox, loaded) in self.mailboxes.iter().enumerate() {
            if let Some(loaded) = loaded
                && !loaded.leaving
                && loaded.id > least
            {
                (least, need) = (loaded.id, Need::Withdraw(mailbox));
            }
        }
        need
    }

    /// A mailbox without a frame.
    pub fn free_mailbox(&self) -> Option<usize> {
        self.mailboxes.iter().position(Option::is_none)
    }

    /// The identifier of the frame in a mailbox.
    pub fn sending(&self, mailbox: usize) -> Option<Id> {
        let loaded = self.mailboxes.get(mailbox)?.as_ref()?;
        Some(loaded.id)
    }

    /// Whether the newest frame of the message in a mailbox is too old at `now`, and the mailbox's is
    /// not being withdrawn.
    pub fn is_old(&self, mailbox: usize, now: u32) -> bool {
        let loaded = self.mailboxes.get(mailbox).copied().flatten();
        let stays = loaded.filter(|loaded| !loaded.leaving);
        let place = stays.and_then(|loaded| self.places.get(usize::from(loaded.place)));
        place.is_some_and(|place| place.newest.is_some_and(|newest| newest.is_old(now)))
    }

    /// Notes that the frame in a mailbox is being withdrawn.
    #[inline]
    pub fn leave(&mut self, mailbox: usize) {
        if let Some(Some(loaded)) = self.mailboxes.get_mut(mailbox) {
            loaded.leaving = true;
        }
    }

    /// The place of the most urgent frame that waits and may go into a mailbox.
    #[inline(never)]
    pub fn first(&self) -> Option<usize> {
        let mut first: Option<(usize, Id)> = None;
        for (at, place) in self.places.iter().enumerate() {
            if place.waits
                && !place.sending
                && let Some(id) = place.id
                && first.is_none_or(|(_, first)| id < first)
            {
                first = Some((at, id));
            }
        }
        first.map(|(at, _)| at)
    }

    /// Takes the frame that waits at a place for this mailbox, which must be free.
    #[inline]
    pub fn begin(&mut self, mailbox: usize, place: usize) -> Option<&Frame> {
        let slot = self.mailboxes.get_mut(mailbox)?;
        let owner = self.places.get_mut(place)?;
        if slot.is_some() || !owner.waits || owner.sending {
            return None;
        }
        let newest = owner.newest.as_ref()?;
        *slot = Some(Loaded {
            id: newest.frame.id(),
            place: place as u8,
            leaving: false,
        });
        (owner.waits, owner.sending) = (false, true);
        Some(&newest.frame)
    }

    /// The frame in this mailbox was sent.
    #[inline]
    pub fn end(&mut self, mailbox: usize) {
        self.empty(mailbox);
    }

    /// The frame in this mailbox was not sent: it waits again, unless a newer one of its identifier
    /// has come or it is too old at `now`. False if it is dropped.
    #[inline]
    pub fn back(&mut self, mailbox: usize, now: u32) -> bool {
        let Some(place) = self.empty(mailbox) else {
            return true;
        };
        let again = !place.waits && place.newest.is_some_and(|newest| !newest.is_old(now));
        place.waits |= again;
        again
    }

    /// Notes that a mailbox is free, and returns the place of its last frame.
    #[inline]
    fn empty(&mut self, mailbox: usize) -> Option<&mut Place> {
        let loaded = self.mailboxes.get_mut(mailbox)?.take()?;
        let place = self.places.get_mut(usize::from(loaded.place))?;
        place.sending = false;
        Some(place)
    }

    /// Drops the frames that wait and are too old at `now`. Returns how many.
    #[inline(never)]
    pub fn expire(&mut self, now: u32) -> u16 {
        let mut dropped = 0;
        for place in &mut self.places {
            if place.waits && place.newest.is_some_and(|newest| newest.is_old(now)) {
                place.waits = false;
                dropped += 1;
            }
        }
        dropped
    }
}

/// The CAN controller as the link uses it: all of its [`MAILBOXES`].
pub trait Mailboxes: Port {
    /// Loads a mailbox and requests transmission.
    ///
    /// # Errors
    /// [`Occupied`] while an earlier frame is pending in it.
    fn load_into(&mut self, mailbox: usize, frame: &Frame) -> Result<(), Occupied>;
    /// Asks to withdraw the frame pending in a mailbox.
    fn abort_in(&mut self, mailbox: usize);
    /// How the last attempt of a mailbox ended; each outcome is returned once.
    fn outcome_in(&mut self, mailbox: usize) -> Option<Outcome>;
    /// Lets the lowest identifier among the mailboxes go first, until the controller leaves the
    /// bus.
    fn order_by_identifier(&mut self);
    /// Takes frames with these standard identifiers only.
    fn accept_only(&mut self, ids: &[u16]);
}

impl<I, R> Mailboxes for sled_common::can::Port<I, R>
where
    I: sled_common::can::FilterOwner,
    R: sled_common::can::Registers,
{
    #[inline]
    fn load_into(&mut self, mailbox: usize, frame: &Frame) -> Result<(), Occupied> {
        self.load_into(mailbox, frame)
    }
    #[inline]
    fn abort_in(&mut self, mailbox: usize) {
        self.abort_in(mailbox);
    }
    #[inline]
    fn outcome_in(&mut self, mailbox: usize) -> Option<Outcome> {
        self.outcome_in(mailbox)
    }
    fn order_by_identifier(&mut self) {
        self.order_by_identifier();
    }
    fn accept_only(&mut self, ids: &[u16]) {
        self.accept_only(ids);
    }
}

/// Whether the node takes part in the traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Presence {
    On,
    /// Off the bus since this instant.
    Off(u32),
    /// Waiting for the controller to leave bus-off.
    Joining,
    /// Without its external clock: only listens, for good. There is no reference to trim its RC
    /// oscillator by.
    Listening,
}

/// What a link keeps in static memory of the application.
#[derive(Clone, Copy, Debug)]
pub struct Stack<const WINDOWS: usize, const PLACES: usize> {
    inbox: [Option<Frame>; WINDOWS],
    /// Stamp of the last frame of each message; `None` if it is overdue.
    arrived: [Option<u32>; WINDOWS],
    outbox: Outbox<PLACES>,
}

impl<const WINDOWS: usize, const PLACES: usize> Stack<WINDOWS, PLACES> {
    const EMPTY: Self = Self {
        inbox: [None; WINDOWS],
        arrived: [None; WINDOWS],
        outbox: Outbox::new(),
    };

    /// A stack whose places belong to the messages of a node, as their routes say.
    fn of(identity: &Identity<WINDOWS>) -> Self {
        let mut stack = Self::EMPTY;
        let own = identity.routes.iter().flatten();
        for route in own.filter(|route| route.sender == identity.node) {
            // The order is that of `Route::place`, and `places` has counted them.
            let _ = stack.outbox.claim(route.id);
        }
        stack
    }

    /// Drops all that waits, and all that has come.
    fn forget(&mut self) {
        self.inbox = [None; WINDOWS];
        self.arrived = [None; WINDOWS];
        self.outbox.clear();
    }
}

/// Messages that were not sent, or not received as they should be. Every counter wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Attempts that ended by an error on the bus.
    pub errors: u16,
    /// Frames of this node that were never sent: newer ones replaced them, or they were too old, or
    /// there was no place for them.
    pub dropped: u16,
    /// Messages of other nodes that were overdue.
    pub missed: u16,
    /// Frames of a message with a wrong length, or of a message that this node sends.
    pub misplaced: u16,
}

/// CAN port and supervision timer of a node that sends at once.
///
/// `WINDOWS` are the windows of the matrix: each call names a message by its window. The queue has
/// `PLACES`, one for each message that the node sends: see [`places`].
pub struct Link<P, T, const WINDOWS: usize, const PLACES: usize> {
    stack: &'static mut Stack<WINDOWS, PLACES>,
    identity: Identity<WINDOWS>,
    port: P,
    timer: T,
    event: Option<Frame>,
    presence: Presence,
    started: bool,
    /// Attempts that failed by an error since the last supervision.
    failures: u8,
    /// Supervisions since the node last heard a frame, or an acknowledge of its own.
    silent: u8,
    /// Whether the bus was alive when [`Link::take_stop`] was last called.
    moved: bool,
    /// Whether the application has a command.
    ends: Ends,
    supervision: u32,
    ticks_per_us: u32,
    counters: Counters,
    losses: Losses,
}

impl<P: Mailboxes, T: WindowTimer, const WINDOWS: usize, const PLACES: usize>
    Link<P, T, WINDOWS, PLACES>
{
    /// A link that sends nothing until [`Link::start`].
    ///
    /// `oscillator` is that of the node, `ticks_per_us` the rate of its time base. The controller of
    /// a node on its RC oscillator was started silent, and stays so.
    pub fn new(
        place: &'static mut Option<Stack<WINDOWS, PLACES>>,
        identity: Identity<WINDOWS>,
        oscillator: Oscillator,
        ticks_per_us: u32,
        port: P,
        timer: T,
    ) -> Self {
        const { assert!(WINDOWS <= 32, "News has one bit for each window") };
        Self {
            stack: place.insert(Stack::of(&identity)),
            identity,
            port,
            timer,
            event: None,
            presence: match oscillator {
                Oscillator::External => Presence::On,
                Oscillator::Internal => Presence::Listening,
            },
            started: false,
            failures: 0,
            silent: u8::MAX,
            moved: false,
            ends: Ends::new(ticks_per_us),
            supervision: 0,
            ticks_per_us,
            counters: Counters::default(),
            losses: Losses::default(),
        }
    }

    /// Begins to send, and to supervise.
    pub fn start(&mut self) {
        self.started = true;
        self.supervision = self.timer.now();
        self.supervise_next();
        self.port.accept_only(self.identity.received);
        if self.presence == Presence::On {
            self.port.order_by_identifier();
        }
        self.load_free();
    }

    /// Leaves the bus for good: only a start brings the node back.
    pub fn leave(&mut self) {
        self.port.leave_bus();
    }

    /// Whether [`Link::start`] was called.
    pub const fn is_started(&self) -> bool {
        self.started
    }

    /// Receive interrupt: takes one frame. The interrupt stays pending while the FIFO holds
    /// frames. `stamp` is the time base, which the task reads before anything else.
    pub fn on_receive(&mut self, stamp: u32) -> News {
        self.on_receive_keeping(stamp, |_| {})
    }

    /// The same. `keep` gets each message that has no window of its own and is not the one that the node waits for.
    #[inline(always)]
    pub fn on_receive_keeping(&mut self, stamp: u32, keep: impl FnOnce(&Frame)) -> News {
        let mut news = News::default();
        if self.port.take_overrun() {
            self.counters.overruns = self.counters.overruns.wrapping_add(1);
        }
        let frame = match self.port.receive() {
            Some(Received::Data(frame)) => frame,
            Some(Received::Remote(_)) => {
                self.counters.remote = self.counters.remote.wrapping_add(1);
                return news;
            }
            None => return news,
        };
        if self.presence != Presence::On {
            return news;
        }
        self.silent = 0;
        if frame.id() == self.identity.awaited {
            self.event = Some(frame);
            news.event = true;
        } else if let Some(window) = self.window_of(frame.id()) {
            news.windows = self.take_in(window, frame, stamp);
        } else {
            keep(&frame);
        }
        news
    }

    /// The window of a message.
    #[inline(never)]
    fn window_of(&self, id: Id) -> Option<usize> {
        let mut routes = self.identity.routes.iter();
        routes.position(|route| route.is_some_and(|route| route.id == id))
    }

    /// Keeps the frame of a window. Returns the window's bit if the frame is as it should be.
    fn take_in(&mut self, window: usize, frame: Frame, stamp: u32) -> u32 {
        let route = self.identity.routes.get(window).copied().flatten();
        let fits = route
            .is_some_and(|route| route.len == frame.len() && route.sender != self.identity.node);
        let place = self.stack.inbox.get_mut(window);
        match (place, self.stack.arrived.get_mut(window)) {
            (Some(place), Some(arrived)) if fits => {
                *place = Some(frame);
                *arrived = Some(stamp);
                1u32.checked_shl(window as u32).unwrap_or(0)
            }
            _ => {
                self.losses.misplaced = self.losses.misplaced.wrapping_add(1);
                0
            }
        }
    }

    /// Transmit interrupt: an attempt has ended, and the next frame goes into its mailbox. The
    /// interrupt stays pending while others have ended. Always false: no frame of this node begins a
    /// basic cycle.
    pub fn on_transmit(&mut self, stamp: u32) -> bool {
        let ended = (0..MAILBOXES).find_map(|mailbox| {
            let outcome = self.port.outcome_in(mailbox)?;
            Some((mailbox, outcome))
        });
        let Some((mailbox, outcome)) = ended else {
            return false;
        };
        match outcome {
            Outcome::Complete => {
                self.stack.outbox.end(mailbox);
                self.silent = 0;
                self.failures = 0;
            }
            Outcome::ArbitrationLost | Outcome::Aborted => self.return_to_queue(mailbox, stamp),
            Outcome::Error => {
                self.return_to_queue(mailbox, stamp);
                self.failures = self.failures.saturating_add(1);
                self.losses.errors = self.losses.errors.wrapping_add(1);
            }
        }
        self.load(mailbox);
        false
    }

    /// The frame in this mailbox was not sent.
    fn return_to_queue(&mut self, mailbox: usize, now: u32) {
        if !self.stack.outbox.back(mailbox, now) {
            self.losses.dropped = self.losses.dropped.wrapping_add(1);
        }
    }

    /// Error interrupt.
    pub fn on_error(&mut self) {
        self.port.acknowledge_error();
        if self.port.error_state().bus_off && self.presence == Presence::On {
            self.counters.bus_off = self.counters.bus_off.wrapping_add(1);
            for mailbox in 0..MAILBOXES {
                self.port.abort_in(mailbox);
            }
            self.port.leave_bus();
            self.presence = Presence::Off(self.timer.now());
            // What waits now is of no use when the node is back, and what came before says nothing
            // about then.
            self.stack.forget();
            self.silent = u8::MAX;
        }
    }

    /// The window timer's interrupt, once in each basic cycle: counts how long the bus is silent.
    pub fn service(&mut self) {
        self.counters.services = self.counters.services.wrapping_add(1);
        self.supervise_next();
        self.failures = 0;
        self.silent = self.silent.saturating_add(1);
    }

    /// Drops what is too old, and tries again after errors. Call it every few basic cycles, where it
    /// keeps no message waiting.
    pub fn tidy(&mut self) {
        let now = self.timer.now();
        let dropped = self.stack.outbox.expire(now);
        self.losses.dropped = self.losses.dropped.wrapping_add(dropped);
        let missed = self.forget_overdue(now);
        self.losses.missed = self.losses.missed.wrapping_add(missed);
        for mailbox in 0..MAILBOXES {
            if self.stack.outbox.is_old(mailbox, now) {
                self.withdraw(mailbox);
            }
        }
        // After errors the mailboxes may be free although frames wait. One of them looks whether the
        // bus works again.
        self.load_free();
    }

    /// Notes which messages are overdue, so that their stamps do not look recent again when the
    /// time base has wrapped. Returns how many there are.
    #[inline(never)]
    fn forget_overdue(&mut self, now: u32) -> u16 {
        let per_us = self.ticks_per_us;
        let mut missed = 0;
        for (arrived, route) in self.stack.arrived.iter_mut().zip(self.identity.routes) {
            if let (Some(stamp), Some(route)) = (*arrived, route)
                && now.wrapping_sub(stamp) >= overdue(route, per_us)
            {
                *arrived = None;
                missed += 1;
            }
        }
        missed
    }

    /// Sets the timer to the next supervision. Those that have passed already are left out.
    fn supervise_next(&mut self) {
        let period = self.ticks(self.identity.basic_cycle);
        let now = self.timer.now();
        self.supervision = self.supervision.wrapping_add(period);
        if now.wrapping_sub(self.supervision).cast_signed() >= 0 {
            self.supervision = now.wrapping_add(period);
        }
        self.timer.set_window(self.supervision);
    }

    /// Loads a mailbox with the most urgent frame that waits, if it is free.
    fn load(&mut self, mailbox: usize) {
        if let Some(place) = self.stack.outbox.first() {
            self.load_from(mailbox, place);
        }
    }

    /// Loads a mailbox with the frame that waits at a place, if it is free.
    #[inline(never)]
    fn load_from(&mut self, mailbox: usize, place: usize) {
        if self.presence != Presence::On || !self.started || self.failures >= ATTEMPTS {
            return;
        }
        if let Some(frame) = self.stack.outbox.begin(mailbox, place)
            && self.port.load_into(mailbox, frame).is_err()
        {
            // An older attempt has not ended yet: its transmit interrupt loads the frame.
            self.counters.occupied = self.counters.occupied.wrapping_add(1);
            let now = self.timer.now();
            self.return_to_queue(mailbox, now);
        }
    }

    /// Asks to withdraw the frame in a mailbox. The transmit interrupt tells what became of it.
    fn withdraw(&mut self, mailbox: usize) {
        self.stack.outbox.leave(mailbox);
        self.port.abort_in(mailbox);
    }

    /// Loads a mailbox that is free.
    fn load_free(&mut self) {
        if let Some(mailbox) = self.stack.outbox.free_mailbox() {
            self.load(mailbox);
        }
    }

    /// Lets a frame wait at its place, and sends it if it can.
    fn send(&mut self, place: usize, frame: Frame, lifetime: Micros) {
        // A node that is not on the bus keeps nothing for later.
        if self.presence != Presence::On {
            return;
        }
        let expires = self.timer.now().wrapping_add(self.ticks(lifetime));
        let outbox = &mut self.stack.outbox;
        let (replaced, need) = outbox.insert(place, Waiting { frame, expires });
        if replaced {
            self.losses.dropped = self.losses.dropped.wrapping_add(1);
        }
        match need {
            Need::Load(mailbox) => self.load_from(mailbox, place),
            Need::Withdraw(mailbox) => self.withdraw(mailbox),
            Need::Patience => {}
        }
    }

    /// Sends the message of a window of this node, at once or as soon as the bus lets it. It takes
    /// the place of an older one that waits.
    pub fn put(&mut self, window: usize, data: [u8; 8]) {
        let route = self.identity.routes.get(window).copied().flatten();
        let Some(route) = route.filter(|route| route.sender == self.identity.node) else {
            return;
        };
        let frame = Frame::from_parts(route.id, route.len, data);
        let lifetime = Micros::micros(route.period.ticks().saturating_mul(MISSED_PERIODS));
        self.send(usize::from(route.place), frame, lifetime);
    }

    /// Sends an event message of this node, at once or within `lifetime`. It takes the place of an
    /// older one of its identifier that waits.
    ///
    /// # Errors
    /// The queue is full, or this is no standard identifier, or the data are longer than 8 bytes.
    pub fn queue_event(
        &mut self,
        id: u16,
        data: &[u8],
        lifetime: Micros,
    ) -> Result<(), QueueError> {
        let frame = event(id, data)?;
        let place = self.stack.outbox.claim(frame.id())?;
        self.send(place, frame, lifetime);
        Ok(())
    }

    /// Rate of true time against this node's time base less 1, in 2^-32; `None` while it is unknown, which
    /// it is on the RC oscillator.
    pub fn true_rate(&self) -> Option<i32> {
        (self.presence != Presence::Listening).then_some(0)
    }

    /// Brings the node back after bus-off, when it has stayed away for a pause. Call this every few
    /// milliseconds.
    ///
    /// bxCAN without automatic bus-off management leaves bus-off by a software sequence:
    /// initialisation mode, normal mode, then 128 times eleven recessive bits.
    pub fn keep_present(&mut self) {
        match self.presence {
            Presence::On | Presence::Listening => {}
            Presence::Off(since) => {
                let pause = self.ticks(design::REJOIN_PAUSE);
                if self.timer.now().wrapping_sub(since) >= pause && self.port.join_bus(false) {
                    self.port.order_by_identifier();
                    self.presence = Presence::Joining;
                }
            }
            Presence::Joining => {
                if !self.port.error_state().bus_off {
                    self.presence = Presence::On;
                    self.failures = 0;
                    self.counters.rejoins = self.counters.rejoins.wrapping_add(1);
                }
            }
        }
    }

    /// Why the node sends nothing; `None` if it takes part in the traffic.
    pub const fn silence(&self) -> Option<Silence> {
        match self.presence {
            Presence::On if self.started => None,
            Presence::On => Some(Silence::Waiting),
            Presence::Off(_) | Presence::Joining => Some(Silence::Away),
            Presence::Listening => Some(Silence::NoReference),
        }
    }

    /// Whether this node sends its messages.
    pub const fn is_heard(&self) -> bool {
        matches!(self.presence, Presence::On) && self.started
    }

    /// Whether the bus is alive: the node takes part, and another one sent a frame or acknowledged
    /// one within the last [`MISSED_PERIODS`] supervisions.
    pub const fn is_alive(&self) -> bool {
        self.is_heard() && self.silent as u32 <= MISSED_PERIODS
    }

    /// Whether the bus has ceased to be alive since the last call. Call it after each supervision.
    pub const fn take_stop(&mut self) -> bool {
        let moved = self.moved;
        self.moved = self.is_alive();
        moved && !self.moved
    }

    /// Whether the command that the application has may not stay in force: it has `expired`, or the bus
    /// is no longer alive. True once for a command, and not twice within
    /// [`END_PAUSE`](crate::design::END_PAUSE). Call it after each supervision.
    pub fn take_end(&mut self, expired: bool) -> bool {
        let now = self.timer.now();
        let lost = !self.is_alive();
        self.ends.take(expired || lost, now)
    }

    /// Takes the frame of the message of a window; `None` if there is no new one.
    pub fn take(&mut self, window: usize) -> Option<Frame> {
        self.stack.inbox.get_mut(window).and_then(Option::take)
    }

    /// Takes the message of a window; `None` if there is no new one or its data does not decode as
    /// this message.
    pub fn message<M: Message>(&mut self, window: usize) -> Option<M> {
        self.take(window)
            .and_then(|frame| M::decode(frame.data()).ok())
    }

    /// Takes the frame of the command of the window `command`. It has time 0; `alive` says that the
    /// last command came within [`MISSED_PERIODS`] of its periods. No
    /// command is in force in the pause behind the end of another one.
    pub fn arrival(&mut self, command: usize) -> Arrival {
        let allowed = self.commands_arrive(command);
        let frame = self.take(command);
        let alive = self
            .ends
            .hand_over(allowed, frame.is_some(), self.timer.now());
        Arrival {
            frame,
            time: self.cycle_began(),
            alive,
        }
    }

    /// Whether an actuator may act on commands: the node takes part in the traffic, and at most one
    /// command in a row is missing.
    pub fn commands_arrive(&self, command: usize) -> bool {
        let now = self.timer.now();
        let route = self.identity.routes.get(command).copied().flatten();
        let arrived = self.stack.arrived.get(command).copied().flatten();
        match (route, arrived) {
            (Some(route), Some(stamp)) => {
                self.is_heard() && now.wrapping_sub(stamp) < overdue(&route, self.ticks_per_us)
            }
            _ => false,
        }
    }

    /// Takes the event message that the node waits for, if one has come.
    pub const fn take_event(&mut self) -> Option<Frame> {
        self.event.take()
    }

    /// Always 0: there is no global time.
    pub const fn system_time(&self) -> u32 {
        0
    }

    /// Always 0: there is no basic cycle. Commands are sealed and judged with this time.
    pub const fn cycle_began(&self) -> u32 {
        0
    }

    /// Always true: there is no time to prove. With a key no command is obeyed.
    pub const fn is_time_believed(&self) -> bool {
        true
    }

    /// The window timer.
    pub const fn timer_mut(&mut self) -> &mut T {
        &mut self.timer
    }

    /// Ticks of the time base in a microsecond.
    pub const fn ticks_per_us(&self) -> u32 {
        self.ticks_per_us
    }

    /// `time` in ticks of the time base.
    pub const fn ticks(&self, time: Micros) -> u32 {
        time.ticks().saturating_mul(self.ticks_per_us)
    }

    /// Error counters and states of the controller.
    pub fn error_state(&self) -> ErrorState {
        self.port.error_state()
    }

    /// Counters of the link; `services` counts the supervisions.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// What was not sent, or not received as it should be.
    pub const fn losses(&self) -> Losses {
        self.losses
    }

    /// The state of the node in the words of the schedule: a node whose bus is alive is in schedule,
    /// one that hears nothing looks for it.
    pub fn status(&self) -> Status {
        let errors = self.port.error_state();
        Status {
            sync: if self.is_alive() {
                SyncState::InSchedule
            } else if self.is_heard() {
                SyncState::Synchronising
            } else {
                SyncState::Off
            },
            master: MasterState::Follower,
            error_level: match self.presence {
                Presence::Off(_) | Presence::Joining => ErrorLevel::Severe(Severe::BusOff),
                _ if errors.warning || errors.passive => ErrorLevel::Warning,
                _ => ErrorLevel::None,
            },
            missed_references: 0,
            cycle: 0,
            master_rank: None,
            initial_watch: false,
            clock: ClockState::Unset,
            reference_offset: 0,
        }
    }
}

/// Age at which a message is overdue, ticks: two of its periods, and the time by which one may come
/// later than the other.
const fn overdue(route: &Route, ticks_per_us: u32) -> u32 {
    let periods = route.period.ticks().saturating_mul(MISSED_PERIODS);
    let late = design::REFERENCE_ARRIVAL.ticks();
    periods.saturating_add(late).saturating_mul(ticks_per_us)
}

impl<P: Mailboxes, T: WindowTimer, const WINDOWS: usize, const PLACES: usize> AnyLink
    for Link<P, T, WINDOWS, PLACES>
{
    fn view(&self) -> BusView {
        let losses = self.losses;
        BusView {
            status: self.status(),
            missed_references: 0,
            missed_messages: u32::from(losses.missed),
            missed_windows: u32::from(losses.errors).wrapping_add(u32::from(losses.dropped)),
            misplaced: u32::from(losses.misplaced),
            errors: self.error_state(),
            link: self.counters(),
            silence: self.silence(),
            trim: None,
            quiet: None,
            rank: None,
            time: crate::e2e::Proof::Unasked,
            forged: 0,
        }
    }

    fn take_event(&mut self) -> Option<Frame> {
        self.take_event()
    }

    fn queue_event(&mut self, id: u16, data: &[u8], lifetime: Micros) -> Result<(), QueueError> {
        self.queue_event(id, data, lifetime)
    }

    fn has_event(&self, id: u16) -> bool {
        let place = Id::standard(id).and_then(|id| self.stack.outbox.place_of(id));
        place.is_some_and(|place| place.waits || place.sending)
    }

    fn replace_event(&mut self, id: u16, data: &[u8], lifetime: Micros) -> Result<(), QueueError> {
        let place = self.stack.outbox.place_of(event(id, data)?.id());
        if place.is_some_and(|place| place.waits && !place.sending) {
            self.queue_event(id, data, lifetime)
        } else {
            Err(QueueError::NoneWaits)
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::boxed::Box;
    use std::collections::VecDeque;
    use std::vec::Vec;
    use ttcan::{MatrixConfig, ReferenceFormat, Window};

    /// A CAN controller that records the calls of the link.
    #[derive(Default)]
    struct Cell {
        fifo: VecDeque<Received>,
        loaded: Vec<Frame>,
        pending: [Option<Frame>; MAILBOXES],
        outcome: [Option<Outcome>; MAILBOXES],
        errors: ErrorState,
        away: bool,
        by_identifier: bool,
        accepted: Vec<u16>,
    }

    impl Port for Cell {
        fn receive(&mut self) -> Option<Received> {
            self.fifo.pop_front()
        }
        fn take_overrun(&mut self) -> bool {
            false
        }
        fn load(&mut self, _: &Frame) -> Result<(), Occupied> {
            panic!("the link names the mailbox")
        }
        fn abort(&mut self) {
            panic!("the link names the mailbox")
        }
        fn outcome(&mut self) -> Option<Outcome> {
            panic!("the link names the mailbox")
        }
        fn acknowledge_error(&mut self) {}
        fn error_state(&self) -> ErrorState {
            self.errors
        }
        fn leave_bus(&mut self) {
            self.away = true;
            self.by_identifier = false;
        }
        fn join_bus(&mut self, silent: bool) -> bool {
            assert!(!silent);
            self.away = false;
            true
        }
        fn take_error(&mut self) -> bool {
            false
        }
    }

    impl Mailboxes for Cell {
        fn load_into(&mut self, mailbox: usize, frame: &Frame) -> Result<(), Occupied> {
            assert!(self.by_identifier && !self.away);
            if self.pending[mailbox].is_some() {
                return Err(Occupied);
            }
            self.pending[mailbox] = Some(*frame);
            self.loaded.push(*frame);
            Ok(())
        }
        fn abort_in(&mut self, mailbox: usize) {
            if self.pending[mailbox].is_some() {
                self.outcome[mailbox] = Some(Outcome::Aborted);
            }
        }
        fn outcome_in(&mut self, mailbox: usize) -> Option<Outcome> {
            let outcome = self.outcome[mailbox].take();
            if outcome.is_some() {
                self.pending[mailbox] = None;
            }
            outcome
        }
        fn order_by_identifier(&mut self) {
            self.by_identifier = true;
        }
        fn accept_only(&mut self, ids: &[u16]) {
            self.accepted = ids.into();
        }
    }

    struct Timer {
        now: u32,
        window: Option<u32>,
    }

    impl WindowTimer for Timer {
        fn now(&self) -> u32 {
            self.now
        }
        fn set_window(&mut self, instant: u32) {
            self.window = Some(instant);
        }
        fn clear_window(&mut self) {
            self.window = None;
        }
    }

    const PER_US: u32 = 18;
    const CYCLE: u32 = 5_000 * PER_US;
    /// Start of the tests' time base: the counter wraps during them.
    const BEGIN: u32 = u32::MAX - 10 * CYCLE;

    const SENSORS: NodeId = NodeId(0);
    const FEEDBACK: NodeId = NodeId(1);
    const REQUEST: Id = Id::constant::<530>();

    /// Places of the windows in the matrix. The message of `LEFT` has a second window.
    const LEFT: usize = 0;
    const RIGHT: usize = 1;
    const COMMAND: usize = 2;
    const AGAIN: usize = 3;
    const SLOW: usize = 4;

    const fn window(start: u32, id: Id, len: u8, sender: NodeId) -> Window<'static> {
        let (start, length) = (Micros::micros(start), Micros::micros(400));
        Window::exclusive("", start, length, id, len, sender)
    }

    const MATRIX: SystemMatrix<'static> = SystemMatrix::constant(MatrixConfig {
        bit_rate: 500_000,
        basic_cycle: Micros::millis(5),
        cycles: 2,
        reference: Id::constant::<100>(),
        reference_format: ReferenceFormat::new(1, Some(1), 5, Some(6)),
        masters: &[SENSORS],
        transmit_enable_bits: 16,
        sync_uncertainty: Micros::micros(20),
        longest_gap: Micros::micros(0),
        windows: &[
            window(1000, Id::constant::<200>(), 2, SENSORS),
            window(1500, Id::constant::<201>(), 2, SENSORS),
            window(2000, Id::constant::<300>(), 8, FEEDBACK),
            window(2500, Id::constant::<200>(), 2, SENSORS),
            window(3000, Id::constant::<202>(), 3, SENSORS).every(2, 1),
            Window::arbitrating("", Micros::micros(3500), Micros::micros(1000)),
        ],
        events: &[],
    });
    const WINDOWS: usize = MATRIX.window_count();
    static ROUTES: [Option<Route>; WINDOWS] = routes(&MATRIX);

    /// Two more than the matrix has messages of one node, for events.
    const PLACES: usize = places(&MATRIX) + 2;

    type TestLink = Link<Cell, Timer, WINDOWS, PLACES>;

    /// What the nodes of the tests are said to receive.
    const RECEIVED: [u16; 2] = [200, 530];

    fn link(node: NodeId, oscillator: Oscillator) -> TestLink {
        let identity = Identity {
            routes: &ROUTES,
            basic_cycle: Micros::millis(5),
            node,
            awaited: REQUEST,
            received: &RECEIVED,
        };
        let timer = Timer {
            now: BEGIN,
            window: None,
        };
        let place = Box::leak(Box::new(None));
        Link::new(place, identity, oscillator, PER_US, Cell::default(), timer)
    }

    fn started(node: NodeId) -> TestLink {
        let mut link = link(node, Oscillator::External);
        link.start();
        link
    }

    /// Lets `micros` pass. The window timer's interrupt occurs when it is due.
    fn pass(link: &mut TestLink, micros: u32) {
        let end = link.timer.now.wrapping_add(micros * PER_US);
        while let Some(at) = link.timer.window
            && at.wrapping_sub(link.timer.now) <= end.wrapping_sub(link.timer.now)
        {
            link.timer.now = at;
            link.timer.window = None;
            link.service();
            link.tidy();
        }
        link.timer.now = end;
    }

    /// The attempt of the most urgent frame in the mailboxes ends so.
    fn ends(link: &mut TestLink, outcome: Outcome) {
        let pending = link.port.pending.iter().enumerate();
        let pending = pending.filter_map(|(mailbox, frame)| Some((frame.as_ref()?.id(), mailbox)));
        if let Some((_, mailbox)) = pending.min() {
            link.port.outcome[mailbox] = Some(outcome);
        }
        link.on_transmit(link.timer.now);
    }

    /// A frame of another node arrives now.
    fn receive(link: &mut TestLink, id: u16, data: &[u8]) -> News {
        let id = Id::standard(id).expect("a standard identifier");
        let frame = Frame::new(id, data).expect("up to eight bytes");
        link.port.fifo.push_back(Received::Data(frame));
        link.on_receive(link.timer.now)
    }

    /// Identifier and first byte of each frame that was loaded.
    fn loaded(link: &TestLink) -> Vec<(u32, u8)> {
        let frames = link.port.loaded.iter();
        frames
            .map(|frame| (frame.id().raw(), frame.buffer()[0]))
            .collect()
    }

    #[test]
    fn each_message_has_one_route() {
        let of = |route: &Option<Route>| route.map(|r| (r.id.raw(), r.len, r.period.ticks()));
        let found: Vec<_> = ROUTES.iter().map(of).collect();
        assert_eq!(
            found,
            [
                Some((200, 2, 5_000)),
                Some((201, 2, 5_000)),
                Some((300, 8, 5_000)),
                None,
                Some((202, 3, 10_000)),
                None
            ]
        );
        // Four windows of the sensors, one of the feedback.
        assert_eq!(places(&MATRIX), 4);
    }

    #[test]
    fn messages_are_sent_at_once_and_those_that_find_no_mailbox_when_one_is_free() {
        let mut link = link(SENSORS, Oscillator::External);
        link.put(RIGHT, [1; 8]);
        assert!(loaded(&link).is_empty() && link.silence() == Some(Silence::Waiting));
        link.start();
        link.put(LEFT, [2; 8]);
        link.put(SLOW, [3; 8]);
        // These windows are not this node's, or have no message of their own.
        for other in [COMMAND, AGAIN, 5, 6, usize::MAX] {
            link.put(other, [9; 8]);
        }
        assert_eq!(loaded(&link), [(201, 1), (200, 2), (202, 3)]);
        assert_eq!(link.queue_event(600, &[4], Micros::secs(1)), Ok(()));
        assert_eq!(link.queue_event(599, &[5], Micros::secs(1)), Ok(()));
        assert_eq!(link.port.outcome, [None; MAILBOXES]);
        for _ in 0..5 {
            ends(&mut link, Outcome::Complete);
        }
        assert_eq!(loaded(&link)[3..], [(599, 5), (600, 4)]);
        assert_eq!(link.port.loaded[1].data(), [2, 2]);
        assert_eq!(link.losses(), Losses::default());
        assert_eq!(link.port.pending, [None; MAILBOXES]);
    }

    #[test]
    fn a_more_urgent_frame_has_the_least_urgent_one_withdrawn() {
        let mut link = started(SENSORS);
        link.put(RIGHT, [1; 8]);
        assert_eq!(link.queue_event(600, &[2], Micros::secs(1)), Ok(()));
        link.put(SLOW, [3; 8]);
        link.put(LEFT, [4; 8]);
        let aborted = Some(Outcome::Aborted);
        assert_eq!(link.port.outcome, [None, aborted, None]);
        link.on_transmit(link.timer.now);
        // It was on the bus already: then it is not lost, and the other one follows it.
        link.put(RIGHT, [5; 8]);
        link.port.outcome[0] = Some(Outcome::Complete);
        for _ in 0..5 {
            link.on_transmit(link.timer.now);
            ends(&mut link, Outcome::Complete);
        }
        let expected = [(201, 1), (600, 2), (202, 3), (200, 4), (201, 5), (600, 2)];
        assert_eq!(loaded(&link), expected);
        assert_eq!(link.losses(), Losses::default());
    }

    #[test]
    fn newer_data_replace_those_that_wait_and_those_in_a_mailbox() {
        let mut link = started(SENSORS);
        link.put(LEFT, [1; 8]);
        link.put(RIGHT, [2; 8]);
        link.put(LEFT, [3; 8]);
        link.put(LEFT, [4; 8]);
        link.on_transmit(link.timer.now);
        assert_eq!(loaded(&link), [(200, 1), (201, 2), (200, 4)]);
        assert_eq!(link.losses().dropped, 2);
    }

    #[test]
    fn a_frame_is_repeated_after_lost_arbitration_and_dropped_when_it_is_too_old() {
        let mut link = started(SENSORS);
        link.put(LEFT, [7; 8]);
        for _ in 0..50 {
            ends(&mut link, Outcome::ArbitrationLost);
        }
        assert_eq!(link.port.loaded.len(), 51);
        pass(&mut link, 10_000);
        ends(&mut link, Outcome::ArbitrationLost);
        assert_eq!(link.port.loaded.len(), 52);
        pass(&mut link, 1);
        ends(&mut link, Outcome::ArbitrationLost);
        assert_eq!((link.port.loaded.len(), link.losses().dropped), (52, 1));
    }

    #[test]
    fn a_frame_that_a_stuck_bus_keeps_in_the_mailbox_is_withdrawn_when_it_is_too_old() {
        let mut link = started(SENSORS);
        link.put(LEFT, [7; 8]);
        link.put(RIGHT, [8; 8]);
        pass(&mut link, 10_000);
        assert_eq!(link.port.outcome, [None; MAILBOXES]);
        pass(&mut link, 5_000);
        let aborted = Some(Outcome::Aborted);
        assert_eq!(link.port.outcome, [aborted, aborted, None]);
        link.on_transmit(link.timer.now);
        link.on_transmit(link.timer.now);
        assert_eq!((loaded(&link).len(), link.losses().dropped), (2, 2));
    }

    #[test]
    fn a_node_that_nobody_acknowledges_tries_a_few_times_in_each_supervision_period() {
        let mut link = started(SENSORS);
        for cycle in 1..=20 {
            link.put(LEFT, [cycle; 8]);
            link.put(RIGHT, [cycle; 8]);
            while link.port.pending != [None; MAILBOXES] {
                ends(&mut link, Outcome::Error);
            }
            let most = usize::from(ATTEMPTS) + MAILBOXES - 1;
            assert!(link.port.loaded.len() <= usize::from(cycle) * most);
            assert!(!link.is_alive());
            pass(&mut link, 5_000);
        }
        assert!(link.losses().errors >= 60);
        ends(&mut link, Outcome::Complete);
        assert!(link.is_alive());
    }

    #[test]
    fn a_command_arrives_once_and_is_overdue_after_two_periods() {
        let mut link = started(SENSORS);
        assert!(!link.arrival(COMMAND).alive);
        let news = receive(&mut link, 300, &[5; 8]);
        assert!(news.has(COMMAND) && news.windows == 1 << COMMAND);
        assert!(!news.reference && !news.stop && !news.event);
        let arrival = link.arrival(COMMAND);
        assert_eq!(arrival.frame.map(|frame| frame.buffer()), Some([5; 8]));
        assert!(arrival.alive && arrival.time == 0);
        assert_eq!(link.arrival(COMMAND).frame, None);
        pass(&mut link, 10_000);
        assert!(link.arrival(COMMAND).alive);
        pass(&mut link, 700);
        assert!(!link.arrival(COMMAND).alive);
        // The counter wraps, and the old stamp must not look recent again.
        let silence = u32::MAX / PER_US;
        let steps = silence / 5_000;
        for _ in 0..steps {
            pass(&mut link, 5_000);
        }
        pass(&mut link, silence % 5_000);
        assert!(!link.arrival(COMMAND).alive);
        assert_eq!(link.losses().missed, 1);
    }

    #[test]
    fn frames_that_do_not_fit_change_nothing() {
        let mut link = started(SENSORS);
        assert_eq!(receive(&mut link, 300, &[5; 7]), News::default());
        assert_eq!(receive(&mut link, 200, &[5; 2]), News::default());
        assert_eq!(link.losses().misplaced, 2);
        assert_eq!(receive(&mut link, 301, &[5; 8]), News::default());
        assert!(link.take(COMMAND).is_none() && !link.commands_arrive(COMMAND));
        assert_eq!((link.losses().misplaced, link.take_event()), (2, None));
        assert!(receive(&mut link, 530, &[1]).event);
        assert_eq!(link.take_event().map(|frame| frame.len()), Some(1));
        assert_eq!(link.take_event(), None);
    }

    #[test]
    fn the_controller_takes_what_the_node_receives() {
        let link = link(SENSORS, Oscillator::External);
        assert!(link.port.accepted.is_empty());
        let link = started(SENSORS);
        assert_eq!(link.port.accepted, RECEIVED);
    }

    #[test]
    fn the_bus_is_alive_while_somebody_is_heard() {
        let mut link = started(FEEDBACK);
        assert!(!link.is_alive() && !link.take_stop());
        assert_eq!(link.status().sync, SyncState::Synchronising);
        receive(&mut link, 777, &[]);
        assert!(link.is_alive() && !link.take_stop());
        assert_eq!(link.status().sync, SyncState::InSchedule);
        pass(&mut link, 14_999);
        assert!(link.is_alive());
        pass(&mut link, 1);
        assert!(!link.is_alive() && link.take_stop() && !link.take_stop());
        assert_eq!(link.counters().services, 3);
    }

    #[test]
    fn a_bus_that_is_gone_ends_a_command_once() {
        let mut link = started(SENSORS);
        assert!(!link.take_end(true), "there is no command yet");
        receive(&mut link, 300, &[5; 8]);
        assert!(link.arrival(COMMAND).alive && !link.take_end(false));
        let mut ends = 0;
        for _ in 0..100 {
            pass(&mut link, 1000);
            ends += u32::from(link.take_end(false));
        }
        assert_eq!(ends, 1);
        // It comes back: the pause is over.
        receive(&mut link, 300, &[5; 8]);
        assert!(link.arrival(COMMAND).alive && link.take_end(true));
        receive(&mut link, 300, &[5; 8]);
        assert!(!link.arrival(COMMAND).alive && !link.take_end(true));
    }

    #[test]
    fn the_supervision_keeps_its_pace_and_leaves_out_what_it_missed() {
        let mut link = started(SENSORS);
        let due = |link: &TestLink| link.timer.window.map(|at| at.wrapping_sub(BEGIN) / PER_US);
        pass(&mut link, 12_000);
        assert_eq!((due(&link), link.counters().services), (Some(15_000), 2));
        // The interrupt comes late by less than a period, then by more.
        for (late, next) in [(16_000, 20_000), (31_000, 36_000)] {
            link.timer.now = BEGIN.wrapping_add(late * PER_US);
            link.service();
            link.tidy();
            assert_eq!(due(&link), Some(next));
        }
    }

    #[test]
    fn bus_off_empties_the_queue_and_the_node_comes_back_after_a_pause() {
        let mut link = started(SENSORS);
        receive(&mut link, 300, &[5; 8]);
        link.put(LEFT, [1; 8]);
        link.put(RIGHT, [2; 8]);
        link.port.errors.bus_off = true;
        link.on_error();
        link.on_error();
        assert_eq!(link.counters().bus_off, 1);
        assert!(link.port.away && !link.is_heard() && !link.is_alive());
        assert!(!link.arrival(COMMAND).alive && link.take(COMMAND).is_none());
        assert_eq!(link.silence(), Some(Silence::Away));
        for _ in 0..2 {
            link.on_transmit(link.timer.now);
        }
        assert_eq!(link.port.pending, [None; MAILBOXES]);
        link.put(LEFT, [3; 8]);
        pass(&mut link, 199_999);
        link.keep_present();
        assert!(link.port.away);
        pass(&mut link, 1);
        link.keep_present();
        assert!(!link.port.away);
        link.keep_present();
        assert_eq!(link.counters().rejoins, 0);
        link.port.errors.bus_off = false;
        link.keep_present();
        assert_eq!((link.counters().rejoins, link.silence()), (1, None));
        link.put(RIGHT, [4; 8]);
        assert_eq!(loaded(&link), [(200, 1), (201, 2), (201, 4)]);
    }

    #[test]
    fn a_node_without_its_external_clock_stays_off_the_bus() {
        let mut link = link(SENSORS, Oscillator::Internal);
        link.start();
        link.put(LEFT, [1; 8]);
        assert_eq!(link.queue_event(511, &[1], Micros::secs(1)), Ok(()));
        assert_eq!(receive(&mut link, 300, &[5; 8]), News::default());
        assert!(link.port.fifo.is_empty(), "the FIFO is not emptied");
        for _ in 0..300 {
            pass(&mut link, 5_000);
            link.keep_present();
        }
        assert!(link.port.loaded.is_empty() && !link.is_heard());
        assert!(!link.arrival(COMMAND).alive);
        assert_eq!(link.silence(), Some(Silence::NoReference));
        assert_eq!(link.status().sync, SyncState::Off);
    }

    #[test]
    fn an_event_is_replaced_only_while_it_waits() {
        let mut link = started(SENSORS);
        let life = Micros::secs(1);
        let none = Err(QueueError::NoneWaits);
        assert_eq!(link.replace_event(600, &[1], life), none);
        for window in [LEFT, RIGHT, SLOW] {
            link.put(window, [1; 8]);
        }
        assert_eq!(link.queue_event(600, &[2], life), Ok(()));
        assert!(link.has_event(600) && !link.has_event(599));
        assert_eq!(link.replace_event(600, &[3], life), Ok(()));
        ends(&mut link, Outcome::Complete);
        assert_eq!(loaded(&link)[3..], [(600, 3)]);
        // In its mailbox it may be on the bus already.
        assert_eq!(link.replace_event(600, &[4], life), none);
        for _ in 0..3 {
            assert!(link.has_event(600));
            ends(&mut link, Outcome::Complete);
        }
        assert!(!link.has_event(600));
        assert_eq!(link.replace_event(600, &[5], life), none);
        assert_eq!(loaded(&link).len(), 4);
    }

    #[test]
    fn a_place_belongs_to_one_identifier_and_without_one_an_event_is_refused() {
        let mut link = started(SENSORS);
        // The places of its three messages are theirs from the start.
        for id in 0..PLACES as u16 - 3 {
            assert_eq!(link.queue_event(600 + id, &[1], Micros::secs(1)), Ok(()));
        }
        let full = link.queue_event(700, &[1], Micros::secs(1));
        assert_eq!(full, Err(QueueError::Full));
        assert_eq!(link.queue_event(602, &[2], Micros::secs(1)), Ok(()));
        let wrong = link.queue_event(0x800, &[2], Micros::secs(1));
        assert_eq!(wrong, Err(QueueError::NotAnEvent));
        let wrong = link.queue_event(600, &[2; 9], Micros::secs(1));
        assert_eq!(wrong, Err(QueueError::NotAnEvent));
        link.on_transmit(link.timer.now);
        assert_eq!(loaded(&link), [(600, 1), (601, 1), (602, 1), (602, 2)]);
    }
}

//! A node of the network.
//!
//! A [`Node`] neither reads a clock nor touches a controller. Its owner tells it
//! what happened, with the stamp of the instant, and then asks what to do:
//!
//! 1. After every `handle_` call, and when the deadline passes, call
//!    [`Node::poll`] until it returns `None`, and do what it says; or
//!    [`Node::advance`] once in every interrupt.
//! 2. Then set the timer to [`Node::next_deadline`].
//!
//! No call loops over windows, messages or nodes. The node never has two
//! transmissions open, so one mailbox does.

mod config;
#[cfg(feature = "std")]
mod normal;
mod receive;
mod status;
mod timing;
mod transmit;

pub use config::{ConfigError, NodeConfig, StampLatency};
use status::bump;
pub use status::{
    Action, Counters, Fault, Grant, MasterState, NotInCharge, QueueError, Reception, Status,
    SyncState, TransmitOutcome,
};

use crate::clock::Clock;
#[cfg(feature = "events")]
use crate::events::Item;
use crate::events::Queue;
use crate::parts::{EVENTS, GAPS, MASTER, PEERS};
use crate::schedule::Entry;
use crate::supervision::{Counts, ErrorLevel, Health, Peer, Severe, WindowStatus};
use crate::{Frame, GlobalTime, Id, Micros, NodeId, ScheduleView, Stamp};

/// The transmission that the owner was asked for and has not reported yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Pending {
    None,
    Reference {
        frame: Frame,
        cycle: u8,
        next_is_gap: bool,
        discontinuity: bool,
        asked: Stamp,
    },
    Window {
        window: u16,
        id: Id,
        len: u8,
        retry_late: bool,
    },
    Event {
        /// In the queue.
        place: u8,
    },
}

/// A message of an exclusive window that has been seen, or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Last {
    window: u16,
    id: Id,
    len: u8,
    sender: NodeId,
    seen: bool,
}

/// A node: room for `W` windows of the matrix, `P` nodes of the network and `Q`
/// event messages. It takes some 400 bytes, and 2 for each window, 12 for each
/// node, 28 for each event message.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Node<'s, const W: usize, const P: usize, const Q: usize> {
    schedule: ScheduleView<'s>,
    config: NodeConfig,
    rank: Option<u8>,
    /// Length of a bit in 1/256 tick.
    bit: u32,
    reference_offset: i8,
    trim: i8,
    application: [u8; 8],

    sync: SyncState,
    master: MasterState,
    severe: Option<Severe>,
    error_level: ErrorLevel,
    /// Whether the owner still has to be told to be silent.
    silence_due: bool,
    abort_due: bool,
    /// Whether an event message may have its turn.
    events_due: bool,
    /// When the owner asked last.
    advanced: Stamp,

    /// Reference mark of the basic cycle under way; the instant of the start
    /// while there is none.
    mark: Stamp,
    marked: bool,
    cycle: u8,
    /// Running number of the basic cycle.
    cycles_seen: u32,
    leader: Option<u8>,
    gap_follows: bool,
    gap_wanted: bool,
    initial_watch: bool,
    missed_references: u8,
    /// A reference lost arbitration, and what won has not been seen.
    reference_lost: bool,
    /// When the reference was first asked for, if the bus may have been taken
    /// then.
    asked: Option<Stamp>,
    /// Messages of others contradicted the basic cycle that this node began
    /// while the bus was taken; and for how many basic cycles.
    doubtful: bool,
    doubts: u8,
    /// Repeated references so far when one was last missing while the own one
    /// waited for its report.
    repeats_at_miss: Option<u32>,

    /// The entry under way (`inside`) or the next one.
    cursor: u16,
    cursor_end: u16,
    inside: bool,
    /// Whether the entry under way is for event messages.
    arbitrating: bool,
    seen: bool,
    last: Option<Last>,

    entry_due: Option<Stamp>,
    reference_due: Option<Stamp>,
    missed_due: Option<Stamp>,
    withdraw_due: Option<Stamp>,
    watchdog_due: Option<Stamp>,

    pending: Pending,
    queue: Queue<Q>,
    /// An event message was withdrawn: none is sent before the next entry.
    events_held: bool,
    clock: Clock,
    leap: bool,
    last_receive: Stamp,

    counts: Counts<W>,
    peers: [Peer; P],
    /// Own windows served in this matrix, and whether it was followed from its
    /// beginning.
    served: u16,
    whole_matrix: bool,
    overflow: bool,
    underflow: bool,
    counters: Counters,
}

/// A time span that a deadline may lie ahead, in ticks.
const LONGEST: u32 = 1 << 30;

impl<'s, const W: usize, const P: usize, const Q: usize> Node<'s, W, P, Q> {
    /// A node that does nothing until [`Node::start`].
    ///
    /// # Errors
    /// What does not fit together, see [`ConfigError`].
    pub fn new(schedule: ScheduleView<'s>, config: NodeConfig) -> Result<Self, ConfigError> {
        let network = schedule.network;
        if W < schedule.window_count() || (PEERS && P < schedule.node_count()) {
            return Err(ConfigError::Size);
        }
        if config.ticks_per_us == 0 || config.ticks_per_us > 1000 {
            return Err(ConfigError::Ticks);
        }
        let ticks = |micros: u32| micros.saturating_mul(config.ticks_per_us);
        let cycle = ticks(network.basic_cycle);
        let watchdog = config.application_watchdog.map_or(0, |time| time.ticks());
        let watch = cycle.saturating_mul(u32::from(config.watch) + 2);
        let longest = watch
            .max(ticks(config.longest_gap.ticks()))
            .max(ticks(watchdog));
        if longest > LONGEST {
            return Err(ConfigError::TooLong);
        }
        let latency = config.latency;
        let longest = latency
            .receive
            .unsigned_abs()
            .max(latency.transmit.unsigned_abs())
            .max(config.transmit_lead);
        if longest > cycle / 2 {
            return Err(ConfigError::Latency);
        }
        if config.reference_offset.is_some_and(|offset| offset > 127) {
            return Err(ConfigError::ReferenceOffset);
        }
        if config.watch == 0 {
            return Err(ConfigError::Watch);
        }
        let rank = schedule.rank_of(config.node).filter(|_| config.may_lead);
        if rank.is_some() && !MASTER {
            return Err(ConfigError::Master);
        }
        let bit = (u64::from(network.bit) * u64::from(config.ticks_per_us)) >> 8;
        Ok(Self {
            schedule,
            rank,
            bit: bit as u32,
            reference_offset: 0,
            trim: 0,
            application: [0; 8],
            sync: SyncState::Off,
            master: MasterState::Off,
            severe: None,
            error_level: ErrorLevel::None,
            silence_due: false,
            abort_due: false,
            events_due: false,
            advanced: Stamp(0),
            mark: Stamp(0),
            marked: false,
            cycle: 0,
            cycles_seen: 0,
            leader: None,
            gap_follows: false,
            gap_wanted: false,
            initial_watch: false,
            missed_references: 0,
            reference_lost: false,
            asked: None,
            doubtful: false,
            doubts: 0,
            repeats_at_miss: None,
            cursor: 0,
            cursor_end: 0,
            inside: false,
            arbitrating: false,
            seen: false,
            last: None,
            entry_due: None,
            reference_due: None,
            missed_due: None,
            withdraw_due: None,
            watchdog_due: None,
            pending: Pending::None,
            queue: Queue::new(),
            events_held: false,
            clock: Clock::new(config.ticks_per_us, config.drift_limit_ppm),
            leap: false,
            last_receive: Stamp(0),
            counts: Counts::new(schedule.exclusive_count()),
            peers: [Peer::default(); P],
            served: 0,
            whole_matrix: false,
            overflow: false,
            underflow: false,
            counters: Counters::default(),
            config,
        })
    }

    /// Begins to listen for references; a potential master sends one when
    /// neither a reference nor anything else comes for a basic cycle.
    ///
    /// Also starts again after S3 or at any other time: counters and global
    /// time stay, everything else begins anew.
    pub fn start(&mut self, now: Stamp) {
        if self.pending != Pending::None {
            self.pending = Pending::None;
            self.abort_due = true;
        }
        self.silence_due = false;
        self.advanced = now;
        self.severe = None;
        self.sync = SyncState::Synchronising;
        self.master = MasterState::Follower;
        self.counts = Counts::new(self.schedule.exclusive_count());
        self.peers = [Peer::default(); P];
        self.overflow = false;
        self.underflow = false;
        self.mark = now;
        self.marked = false;
        self.leader = None;
        self.gap_follows = false;
        self.initial_watch = false;
        self.missed_references = 0;
        self.inside = false;
        self.last = None;
        self.last_receive = now;
        self.entry_due = None;
        self.withdraw_due = None;
        if EVENTS {
            self.events_due = false;
            self.queue.clear();
        }
        if self.clock.at(now).is_some() {
            self.clock.carry(now);
        }
        if MASTER {
            self.gap_wanted = false;
            self.forget_reference();
            self.doubts = 0;
            self.reference_offset = self.initial_offset();
            self.reference_due = self.rank().map(|_| now.after(self.quiet()));
        }
        self.missed_due = Some(now.after(self.missed_after(u32::from(self.config.watch))));
        self.feed_watchdog(now);
        self.assess();
    }

    /// Bytes that the application sends in front of its references, from the
    /// next one on; what exceeds the format's share is ignored.
    #[cfg(feature = "master")]
    pub fn set_reference_payload(&mut self, bytes: &[u8]) {
        let room = usize::from(self.schedule.network.reference_format.application());
        for (to, from) in self.application.iter_mut().take(room).zip(bytes) {
            *to = *from;
        }
    }

    /// Tells the node that its application is alive.
    pub fn feed_watchdog(&mut self, now: Stamp) {
        self.watchdog_due = self
            .config
            .application_watchdog
            .map(|time| now.after(self.clock.ticks(time.ticks())));
    }

    /// The controller went bus-off: S3 until [`Node::start`].
    pub fn handle_bus_off(&mut self) {
        if self.sync != SyncState::Off {
            self.stop(Severe::BusOff);
        }
    }

    /// The controller reports that it lost a frame because its receive buffer
    /// was full. What was lost shows as a missed message; this counts why.
    pub fn handle_overrun(&mut self) {
        bump(&mut self.counters.overruns, 1);
    }

    /// Makes the next reference announce a gap: when its basic cycle is over,
    /// the schedule rests until [`Node::end_gap`].
    ///
    /// # Errors
    /// This node is not the current time master.
    #[cfg(all(feature = "master", feature = "gaps"))]
    pub fn request_gap(&mut self) -> Result<(), NotInCharge> {
        if self.master != MasterState::Current {
            return Err(NotInCharge);
        }
        self.gap_wanted = true;
        Ok(())
    }

    /// The event that ends a gap: the reference is sent at once, or as soon as
    /// the basic cycle before the gap is over. Takes back a gap that is wanted
    /// and not yet announced.
    ///
    /// # Errors
    /// This node is not the current time master.
    #[cfg(all(feature = "master", feature = "gaps"))]
    pub fn end_gap(&mut self, now: Stamp) -> Result<(), NotInCharge> {
        if self.master != MasterState::Current {
            return Err(NotInCharge);
        }
        self.gap_wanted = false;
        if self.gap_follows && self.pending == Pending::None {
            let earliest = self.reference_instant(0);
            self.reference_due = Some(if now.reached(earliest) { now } else { earliest });
        }
        Ok(())
    }

    /// Makes one basic cycle longer, or shorter, by `micros`: the one after that
    /// under way. So the current time master follows an event that recurs at
    /// the rate of its basic cycles, such as the measurements of a receiver;
    /// global time runs on as before.
    ///
    /// At most [`Node::LARGEST_TRIM`] either way, more is cut: backups must not
    /// take over, and no node's windows may overlap.
    ///
    /// # Errors
    /// Another node is the time master.
    #[cfg(feature = "master")]
    pub fn trim_cycle(&mut self, micros: i8) -> Result<(), NotInCharge> {
        if self.master != MasterState::Current {
            return Err(NotInCharge);
        }
        self.trim = micros.clamp(-Self::LARGEST_TRIM, Self::LARGEST_TRIM);
        Ok(())
    }

    /// Largest change of a basic cycle by [`Node::trim_cycle`], in microseconds:
    /// half of the default reference trigger offset between two ranks.
    #[cfg(feature = "master")]
    pub const LARGEST_TRIM: i8 = 8;

    /// Sets the global time of the instant `stamp`. The next reference tells
    /// all nodes that it leapt.
    ///
    /// # Errors
    /// Another node is the time master.
    #[cfg(all(feature = "master", feature = "global-time"))]
    pub fn set_global_time(&mut self, stamp: Stamp, time: GlobalTime) -> Result<(), NotInCharge> {
        let unled = self.leader.is_none() && self.rank().is_some();
        if self.master != MasterState::Current && !unled {
            return Err(NotInCharge);
        }
        self.clock.set(stamp, time);
        self.leap = true;
        Ok(())
    }

    /// Global time at `stamp`, within 2^30 ticks of the last reference.
    #[cfg(feature = "global-time")]
    pub fn global_time(&self, stamp: Stamp) -> Option<GlobalTime> {
        self.clock.at(stamp)
    }

    /// Rate of global time against this node's counter, in 2^-32 (4295 is one
    /// part per million).
    #[cfg(feature = "global-time")]
    pub fn rate(&self) -> i32 {
        self.clock.rate()
    }

    /// Time from the last reference mark to `stamp`, `None` before the first
    /// one.
    pub fn cycle_time(&self, stamp: Stamp) -> Option<Micros> {
        let ticks = stamp.ticks_since(self.mark);
        self.marked
            .then(|| Micros::from_ticks(self.clock.micros(ticks)))
    }

    /// The last reference mark.
    pub fn reference_mark(&self) -> Option<Stamp> {
        self.marked.then_some(self.mark)
    }

    /// Queues an event message for the next arbitrating window; it is dropped
    /// when it has not been sent within `lifetime`. The lower the identifier,
    /// the earlier it goes. Call [`Node::poll`] afterwards.
    ///
    /// # Errors
    /// See [`QueueError`].
    #[cfg(feature = "events")]
    pub fn queue_event(
        &mut self,
        frame: Frame,
        now: Stamp,
        lifetime: Micros,
    ) -> Result<(), QueueError> {
        let ours = self.schedule.known(frame.id()).is_some_and(|known| {
            known.is_event && known.sender == self.config.node && frame.len() <= known.len
        });
        if !ours {
            return Err(QueueError::NotAnEvent);
        }
        let ticks = lifetime.ticks().saturating_mul(self.config.ticks_per_us);
        if ticks > LONGEST {
            return Err(QueueError::Lifetime);
        }
        if self.enqueue(Item::Event(frame), now.after(ticks), now) {
            self.attend_events();
            Ok(())
        } else {
            Err(QueueError::Full)
        }
    }

    /// Number of messages that wait for an arbitrating window.
    #[cfg(feature = "events")]
    pub fn queued(&self) -> usize {
        self.queue.len()
    }

    /// Whether the network lives as far as this node can tell: it is in
    /// schedule, and fewer than two references in a row are missing. An
    /// actuator stops when this is false, or when
    /// [`WindowStatus::missed`] of its command reaches 2 (thesis 6.2.4.4).
    pub fn is_alive(&self) -> bool {
        matches!(self.sync, SyncState::InSchedule | SyncState::InGap) && self.missed_references < 2
    }

    /// State of the node.
    pub fn status(&self) -> Status {
        Status {
            sync: if self.in_gap() {
                SyncState::InGap
            } else {
                self.sync
            },
            master: self.master,
            error_level: self.error_level,
            missed_references: self.missed_references,
            cycle: self.cycle,
            master_rank: self.leader,
            initial_watch: self.initial_watch,
            clock: self.clock.state(),
            reference_offset: self.reference_offset,
        }
    }

    /// Forgets what became of the own reference of the basic cycle before.
    fn forget_reference(&mut self) {
        self.reference_lost = false;
        self.asked = None;
        self.doubtful = false;
        self.repeats_at_miss = None;
    }

    /// Rank as a potential master.
    fn rank(&self) -> Option<u8> {
        if MASTER { self.rank } else { None }
    }

    /// Whether the basic cycle under way is followed by a gap.
    fn gap_follows(&self) -> bool {
        GAPS && self.gap_follows
    }

    fn in_gap(&self) -> bool {
        self.sync == SyncState::InSchedule && self.gap_follows() && self.entry_due.is_none()
    }

    /// State of a window, by its index in the matrix.
    pub fn window(&self, window: u16) -> Option<WindowStatus> {
        self.counts.get(window)
    }

    /// State of another node, judged from what it sends when. A node without
    /// an exclusive window is never called dead.
    #[cfg(feature = "peers")]
    pub fn peer(&self, node: NodeId) -> Health {
        let Some(peer) = self.peers.get(usize::from(node.0)) else {
            return Health::Unknown;
        };
        peer.health(self.cycles_seen, self.windows_in_two_cycles(node))
    }

    fn windows_in_two_cycles(&self, node: NodeId) -> u16 {
        let windows = u32::from(self.schedule.windows_of(node)) * 2;
        windows.div_ceil(u32::from(self.schedule.network.cycles.max(1))) as u16
    }

    /// What happened so far.
    #[cfg(feature = "counters")]
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Which node this is.
    pub fn id(&self) -> NodeId {
        self.config.node
    }

    /// The application's decision to go on after S1 or S2: status counts and
    /// budgets begin anew. S3 needs [`Node::start`].
    pub fn clear_errors(&mut self) {
        self.counts = Counts::new(self.schedule.exclusive_count());
        self.overflow = false;
        self.underflow = false;
        self.whole_matrix = false;
        self.assess();
    }

    /// Finds the error level anew.
    fn assess(&mut self) {
        self.error_level = if let Some(cause) = self.severe {
            ErrorLevel::Severe(cause)
        } else if self.overflow || self.counts.fails() {
            ErrorLevel::Error
        } else if self.underflow || self.counts.warns() {
            ErrorLevel::Warning
        } else {
            ErrorLevel::None
        };
    }

    /// Enters S3.
    fn stop(&mut self, cause: Severe) {
        self.severe = Some(cause);
        self.sync = SyncState::Off;
        self.master = MasterState::Off;
        self.leader = None;
        self.marked = false;
        self.silence_due = true;
        self.abort_due = false;
        if EVENTS {
            self.events_due = false;
        }
        self.pending = Pending::None;
        self.inside = false;
        self.entry_due = None;
        self.reference_due = None;
        self.missed_due = None;
        self.withdraw_due = None;
        self.watchdog_due = None;
        self.assess();
    }

    fn entry(&self) -> Option<&'s Entry> {
        self.schedule.entry(self.cursor)
    }

    /// Offset of a backup behind better-ranked masters.
    fn initial_offset(&self) -> i8 {
        let by_rank = self.rank().unwrap_or(0).saturating_mul(16);
        self.config.reference_offset.unwrap_or(by_rank).min(127) as i8
    }

    /// Ticks of silence after which a potential master that has seen no
    /// reference sends one: one that is under way is heard before.
    fn quiet(&self) -> u32 {
        let network = self.schedule.network;
        let offset = u32::from(self.reference_offset.unsigned_abs());
        self.clock
            .ticks(network.basic_cycle + 2 * network.reference_length + offset)
    }

    /// When the own reference is to be asked for in the basic cycle under way.
    fn reference_instant(&self, offset: i8) -> Stamp {
        let cycle = self.schedule.network.basic_cycle;
        self.instant(cycle.wrapping_add_signed(i32::from(offset)))
    }

    /// When a transmission at this cycle time is to be asked for.
    fn instant(&self, cycle_time: u32) -> Stamp {
        let mark = self.mark.after(self.clock.ticks(cycle_time));
        Stamp(mark.0.wrapping_sub(self.config.transmit_lead))
    }

    /// Ticks after the reference mark (or the start) at which the reference
    /// `cycles` basic cycles later counts as missing: the last backup's offset,
    /// the uncertainty and two longest references have passed.
    fn missed_after(&self, cycles: u32) -> u32 {
        let network = self.schedule.network;
        let late = crate::matrix::REFERENCE_OFFSET_LIMIT
            + network.uncertainty
            + 2 * network.reference_length;
        // The whole was checked against the counter's range.
        self.clock
            .ticks(network.basic_cycle.wrapping_mul(cycles).wrapping_add(late))
    }

    /// Ticks that `bits` bit times take.
    fn bits(&self, bits: u32) -> u32 {
        self.bit.wrapping_mul(bits) >> 8
    }
}

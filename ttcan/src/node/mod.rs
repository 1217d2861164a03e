//! A node of the network.
//!
//! A [`Node`] reads no clock and touches no controller. Its owner tells it what
//! happened, with the stamp of the instant, and then asks what to do:
//!
//! 1. After every `handle_` call, and when the deadline passes, call
//!    [`Node::poll`] until it returns `None`, and carry out each action; or call
//!    [`Node::advance`] once in every interrupt.
//! 2. Then set the timer to [`Node::next_deadline`].
//!
//! No call but a late [`Node::poll`] loops over windows, messages or nodes. The
//! node never has two transmissions pending, so one mailbox is enough.
//!
//! A node is made of parts, each in a file of its own: its configuration
//! (`setup`), the current basic cycle (`basic_cycle`), the position in its
//! windows (`position`), the deadlines (`agenda`), own transmissions
//! (`transmission`), the role of a time master (`master_role`), error levels and
//! other nodes (`crate::supervision`), and the clock (`crate::clock`). The other
//! files are what the node does: `timing`, `receive`, `references`, `transmit`,
//! `events` and `master`.

mod agenda;
mod basic_cycle;
mod config;
mod counters;
mod events;
mod instants;
mod master;
mod master_role;
#[cfg(feature = "std")]
mod normal;
mod position;
mod receive;
mod references;
mod setup;
mod status;
mod timing;
mod transmission;
mod transmit;

pub use config::{ConfigError, NodeConfig, StampLatency};
pub use counters::Counters;
pub use status::{
    Action, Fault, Grant, MasterState, NotInCharge, QueueError, Reception, Status, SyncState,
    TransmitOutcome,
};

use agenda::{Agenda, Order};
use basic_cycle::BasicCycle;
use counters::bump;
use master_role::MasterRole;
use position::Position;
use setup::Setup;
use transmission::{Pending, Transmission};

use crate::clock::Clock;
use crate::features::{EVENTS, MASTER, PEERS};
use crate::matrix::NodeId;
use crate::schedule::{Entry, ScheduleView};
#[cfg(feature = "peers")]
use crate::supervision::Health;
use crate::supervision::{Missing, Severe, Supervision, WindowStatus};
#[cfg(feature = "global-time")]
use crate::time::GlobalTime;
use crate::time::{Micros, Stamp};

/// A node with room for `W` windows of the matrix, `P` nodes of the network and
/// `Q` event messages. It takes some 400 bytes, and 2 for each window, 12 for
/// each node, 28 for each event message.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
// In this order, because instructions have two bytes only if they reach up to 31 bytes, halfwords up to
// 62 and words up to 124 from the node's beginning (Armv7-M, T1 encodings), and it makes a fiftieth of an
// image. It was found by trials, `cargo xtask bench`.
#[repr(C)]
pub struct Node<'s, const W: usize, const P: usize, const Q: usize> {
    sync: SyncState,
    cycle: BasicCycle,
    clock: Clock,
    setup: Setup<'s>,
    counters: Counters,
    position: Position,
    supervision: Supervision<W, P>,
    transmission: Transmission<Q>,
    /// Stamp of the last received frame, or of the start.
    last_received: Stamp,
    master: MasterRole,
    agenda: Agenda,
}

impl<'s, const W: usize, const P: usize, const Q: usize> Node<'s, W, P, Q> {
    /// A node that does nothing until [`Node::start`].
    ///
    /// # Errors
    /// Schedule, configuration and sizes do not go together, see
    /// [`ConfigError`].
    pub fn new(schedule: ScheduleView<'s>, config: NodeConfig) -> Result<Self, ConfigError> {
        if W < schedule.window_count() || (PEERS && P < schedule.node_count()) {
            return Err(ConfigError::Size);
        }
        let setup = Setup::new(schedule, config)?;
        let never = Stamp(0);
        Ok(Self {
            setup,
            sync: SyncState::Off,
            cycle: BasicCycle::new(never),
            position: Position::NONE,
            agenda: Agenda::new(never),
            transmission: Transmission::new(),
            master: MasterRole::new(),
            supervision: Supervision::NEW,
            clock: Clock::new(config.ticks_per_us, config.drift_limit_ppm),
            last_received: never,
            counters: Counters::NONE,
        })
    }

    /// Begins to listen for references. A potential master sends one itself if
    /// neither a reference nor any other frame comes for a basic cycle.
    ///
    /// Also starts again after S3 or at any other time. Counters, global time
    /// and the bytes of [`Node::set_reference_payload`] stay, everything else
    /// begins anew. The global time is the node's own
    /// ([`ClockState::Own`](crate::ClockState::Own)) until the first references
    /// tell that of the network, which may have been set meanwhile.
    pub fn start(&mut self, now: Stamp) {
        let abort = !self.transmission.is_idle() || self.agenda.order == Order::Abort;
        self.sync = SyncState::Synchronising;
        self.cycle = BasicCycle::new(now);
        self.position = Position::NONE;
        self.agenda = Agenda::new(now);
        if abort {
            self.agenda.order = Order::Abort;
        }
        self.transmission.pending = Pending::None;
        if EVENTS {
            self.transmission.queue.clear();
        }
        self.supervision
            .reset(self.setup.schedule.exclusive_count());
        self.last_received = now;
        self.clock.resume(now);
        self.master.restart(self.setup.initial_offset);
        if MASTER {
            self.agenda.reference = self.setup.rank().map(|_| now.after(self.quiet()));
        }
        let cycle = self.setup.network().basic_cycle;
        let watch = self.missing_after(cycle.wrapping_mul(u32::from(self.setup.config.watch)));
        self.agenda.missing_reference = Some(now.after(watch));
        self.feed_watchdog(now);
    }

    /// Enters S3.
    // In every place that calls it, it would be a tenth of a small image.
    #[inline(never)]
    fn stop(&mut self, cause: Severe) {
        self.sync = SyncState::Off;
        self.cycle.master = None;
        self.position = Position::NONE;
        self.agenda = Agenda::new(self.agenda.polled);
        self.agenda.order = Order::Silence;
        if !self.transmission.is_idle() {
            self.transmission.pending = Pending::Abandoned;
        }
        if EVENTS {
            self.transmission.queue.clear();
        }
        self.master.state = MasterState::Off;
        self.supervision.stop(cause);
    }

    /// Tells the node that its application is alive.
    // In both places that call it, it would be in an image twice.
    #[inline(never)]
    pub fn feed_watchdog(&mut self, now: Stamp) {
        if self.sync != SyncState::Off {
            let time = self.setup.config.application_watchdog;
            self.agenda.watchdog = time.map(|time| now.after(self.clock.ticks(time.ticks())));
        }
    }

    /// The controller went bus-off: S3 until [`Node::start`].
    pub fn handle_bus_off(&mut self) {
        if self.sync != SyncState::Off {
            self.stop(Severe::BusOff);
        }
    }

    /// The application takes the node off the bus: S3 until [`Node::start`].
    pub fn withdraw(&mut self) {
        if self.sync != SyncState::Off {
            self.stop(Severe::Withdrawn);
        }
    }

    /// The rate of this node's counter has changed: it is measured anew. Or this node has begun to lead, and its
    /// oscillator is better than the rate that it has measured by others: nobody corrects a master's rate.
    pub fn forget_rate(&mut self) {
        self.clock.forget_rate();
    }

    /// Changes the largest drift that is corrected, up to 10 000 ppm; see
    /// [`NodeConfig::drift_limit_ppm`]. It holds from the next reference on.
    pub fn set_drift_limit(&mut self, ppm: u16) {
        self.clock.set_limit(ppm);
    }

    /// The controller lost a frame because its receive buffer was full. The lost
    /// frame shows as a missed message; this counts why.
    pub fn handle_overrun(&mut self) {
        bump(&mut self.counters.overruns, 1);
    }

    /// The application's decision to go on after S1 or S2: status counts and
    /// transmission budget begin anew. S3 needs [`Node::start`].
    pub fn clear_errors(&mut self) {
        self.supervision
            .clear(self.setup.schedule.exclusive_count());
    }

    /// Which node this is.
    pub fn id(&self) -> NodeId {
        self.setup.config.node
    }

    /// State of the node.
    pub fn status(&self) -> Status {
        let (missed_references, initial_watch) = match self.supervision.missing {
            Missing::InRow(missed) => (missed, false),
            Missing::Initial => (0, true),
        };
        Status {
            sync: if self.in_gap() {
                SyncState::InGap
            } else {
                self.sync
            },
            master: self.master.state,
            error_level: self.supervision.level(),
            missed_references,
            cycle: self.cycle.number,
            master_rank: self.cycle.master,
            initial_watch,
            clock: self.clock.state(),
            reference_offset: self.master.offset,
        }
    }

    /// Whether the network is alive as far as this node can tell: the node is in
    /// schedule, and fewer than two references in a row are missing. An actuator
    /// stops when this is false, or when [`WindowStatus::missed`] of its command
    /// reaches 2 (thesis 6.2.4.4).
    pub fn is_alive(&self) -> bool {
        matches!(self.sync, SyncState::InSchedule | SyncState::InGap)
            && matches!(self.supervision.missing, Missing::InRow(0 | 1))
    }

    /// State of a window, by its index in the matrix.
    pub fn window(&self, window: u16) -> Option<WindowStatus> {
        self.supervision.window(window)
    }

    /// Health of another node, judged from what it sends and when. A node
    /// without an exclusive window is never called dead.
    #[cfg(feature = "peers")]
    pub fn peer(&self, node: NodeId) -> Health {
        self.supervision.health(
            node,
            self.cycle.count,
            self.setup.schedule.windows_in_two_cycles(node),
        )
    }

    /// What happened so far.
    #[cfg(feature = "counters")]
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Global time at `stamp`, which must be within 2^30 ticks of the last
    /// reference.
    #[cfg(feature = "global-time")]
    pub fn global_time(&self, stamp: Stamp) -> Option<GlobalTime> {
        self.clock.at(stamp)
    }

    /// Rate of global time against this node's counter less 1, in units of 2^-32
    /// (4295 is one part per million).
    #[cfg(feature = "global-time")]
    pub fn rate(&self) -> i32 {
        self.clock.rate()
    }

    /// Cycle time at `stamp`, counted from the last reference mark; `None` before
    /// the first reference.
    pub fn cycle_time(&self, stamp: Stamp) -> Option<Micros> {
        let ticks = stamp.ticks_since(self.cycle.mark);
        self.cycle
            .has_begun()
            .then(|| Micros::from_ticks(self.clock.micros(ticks)))
    }

    /// The last reference mark (Ref_Mark).
    pub fn reference_mark(&self) -> Option<Stamp> {
        self.cycle.has_begun().then_some(self.cycle.mark)
    }

    fn in_gap(&self) -> bool {
        self.sync == SyncState::InSchedule
            && self.cycle.next_is_gap()
            && self.agenda.time_mark.is_none()
    }

    /// The current entry of the schedule, or the next one.
    fn entry(&self) -> Option<&'s Entry> {
        self.setup.schedule.entry(self.position.cursor)
    }
}

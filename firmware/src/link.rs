//! Protocol stack, CAN port and window timer as one value, which the interrupts of the bus
//! share.
//!
//! Each interrupt does one thing, and none of them waits. The receive and the transmit
//! interrupt each report one frame to the stack. The window timer's interrupt carries out one
//! action of the stack ([`Link::service`]); if another action is due, the timer fires again at
//! once. So the execution time of each interrupt is bounded, however many actions are due at
//! the same time.

use crate::oscillator::{Tuner, Tuning, measured_cycles};
use network::Message;
use sled_common::can::{ErrorState, Occupied, Outcome, Received};
use sled_common::clock::Oscillator;
use ttcan::{
    Action, ClockState, ConfigError, ErrorLevel, Frame, Id, Micros, NodeConfig, NodeId, QueueError,
    Reception, ScheduleView, Stamp, TransmitOutcome,
};
#[cfg(feature = "master")]
use ttcan::{Fault, GlobalTime, MasterState};

use crate::console::BusView;
use crate::e2e::{Answer, Open, Proof, Secret, TimeProof, time_of};
use crate::ends::Ends;
use crate::leader::{Leader, Rule};

/// Capacity of a node's queue of event messages that wait for their window. An actuator node
/// sends no events but its status.
pub const EVENT_QUEUE: usize = if cfg!(feature = "f303") { 2 } else { 8 };
/// The protocol stack of a node of a network with this many windows and nodes.
pub type Stack<const WINDOWS: usize, const NODES: usize> =
    ttcan::Node<'static, WINDOWS, NODES, EVENT_QUEUE>;

/// Which node of which network an image is.
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// The network's schedule.
    pub schedule: ScheduleView<'static>,
    /// Bit rate of the network, bit/s.
    pub bit_rate: u32,
    /// The node.
    pub node: NodeId,
    /// Under which time master its actuators may move.
    pub rule: Rule,
    /// The bits of the first byte of every reference that belong to no signal.
    pub free: u8,
    /// The event message that the node waits for: the request for its self-test.
    pub awaited: Id,
}

/// The CAN controller as the link uses it.
pub trait Port {
    /// Takes the oldest frame out of the receive FIFO.
    fn receive(&mut self) -> Option<Received>;
    /// Whether the FIFO lost a frame since the last call.
    fn take_overrun(&mut self) -> bool;
    /// Loads the mailbox and requests transmission.
    ///
    /// # Errors
    /// [`Occupied`] while an earlier frame is pending.
    fn load(&mut self, frame: &Frame) -> Result<(), Occupied>;
    /// Asks to withdraw the pending frame.
    fn abort(&mut self);
    /// How the last attempt ended; each outcome is returned once.
    fn outcome(&mut self) -> Option<Outcome>;
    /// Acknowledges the error interrupt.
    fn acknowledge_error(&mut self);
    /// Error counters and states.
    fn error_state(&self) -> ErrorState;
    /// Leaves the bus: sends no dominant bit from now on.
    fn leave_bus(&mut self);
    /// Joins the bus again; false while the controller is still leaving it. A `silent` controller
    /// only listens.
    fn join_bus(&mut self, silent: bool) -> bool;
    /// Whether the controller has seen an error on the bus since the last call.
    fn take_error(&mut self) -> bool;
}

impl<I, R> Port for sled_common::can::Port<I, R>
where
    I: sled_common::can::FilterOwner,
    R: sled_common::can::Registers,
{
    #[inline]
    fn receive(&mut self) -> Option<Received> {
        self.receive()
    }
    #[inline]
    fn take_overrun(&mut self) -> bool {
        self.take_overrun()
    }
    #[inline]
    fn load(&mut self, frame: &Frame) -> Result<(), Occupied> {
        self.load(frame)
    }
    #[inline]
    fn abort(&mut self) {
        self.abort();
    }
    #[inline]
    fn outcome(&mut self) -> Option<Outcome> {
        self.outcome()
    }
    #[inline]
    fn acknowledge_error(&mut self) {
        self.acknowledge_error();
    }
    #[inline]
    fn error_state(&self) -> ErrorState {
        self.error_state()
    }
    fn leave_bus(&mut self) {
        self.leave_bus();
    }
    fn join_bus(&mut self, silent: bool) -> bool {
        self.join_bus(silent)
    }
    fn take_error(&mut self) -> bool {
        self.take_error()
    }
}

/// The time base and its window timer.
pub trait WindowTimer {
    /// The counter now.
    fn now(&self) -> u32;
    /// Fires when the counter reaches `instant`; at once if `instant` is in the past.
    fn set_window(&mut self, instant: u32);
    /// Disarms the timer.
    fn clear_window(&mut self);
}

/// What housekeeping and console need of a link, whatever the protocol of its vehicle: this
/// module's or that of [`event`](crate::event).
pub trait AnyLink {
    /// The bus as the node sees it.
    fn view(&self) -> BusView;
    /// Takes the event message that the node waits for, if one has come.
    fn take_event(&mut self) -> Option<Frame>;
    /// Queues an event message of this node, to be sent within `lifetime`.
    ///
    /// # Errors
    /// The queue is full, or the message is not one of this node's events.
    fn queue_event(&mut self, id: u16, data: &[u8], lifetime: Micros) -> Result<(), QueueError>;
    /// Whether an event message of this node has not left it yet: it waits, or is being sent.
    fn has_event(&self, id: u16) -> bool;
    /// Puts newer data in the place of an event message of this node that waits. Once it is being
    /// sent it is not replaced, because the newer one would follow it at once.
    ///
    /// # Errors
    /// None of this identifier waits, or the message is not one of this node's events.
    fn replace_event(&mut self, id: u16, data: &[u8], lifetime: Micros) -> Result<(), QueueError>;
    /// The last reference, if its tag is needed and not computed yet.
    fn open(&self) -> Option<Open> {
        None
    }
    /// Takes the tag of a reference.
    fn close(&mut self, _: Answer) {}
}

/// Bit of the application's byte of a reference: its master runs on its RC oscillator.
pub const INTERNAL_CLOCK: u8 = 1 << 1;

/// How far the RC oscillator of a node may differ from the master's clock while it takes part in
/// the traffic, ppm: not more than the bit timing of a board allows each of two nodes.
pub const TOLERANCE_PPM: u32 = 9_800;

/// Basic cycles in a row that a node begins before it leads at the rate of its own crystal, and not at that of the
/// master whom it followed: nobody corrects a master, and that one may have been an attacker. Before the fifth, the
/// other master may only have lost a reference or two, and all nodes have measured its rate.
#[cfg(feature = "master")]
const LEADS: u8 = 5;

/// What an interrupt of the bus has brought for the application.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct News {
    /// A basic cycle began.
    pub reference: bool,
    /// Exclusive windows whose message arrived, one bit each.
    pub windows: u32,
    /// The event message arrived that the node waits for.
    pub event: bool,
    /// From now on actuators must not move: see [`Link::take_stop`].
    pub stop: bool,
}

impl News {
    /// Whether the message of this window arrived.
    pub const fn has(self, window: usize) -> bool {
        window < 32 && self.windows & 1 << window != 0
    }
}

/// A command frame and the state of the bus, for an actuator node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The frame from the command's window, if there was a new one.
    pub frame: Option<Frame>,
    /// System time at which the current basic cycle began, ms.
    pub time: u32,
    /// True if the network is alive, at most one command in a row is missing, and actuators may
    /// move under its time master.
    pub alive: bool,
}

/// Counters of the link, in addition to those of the stack. Every counter wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Times the receive FIFO overran.
    pub overruns: u16,
    /// Remote frames received.
    pub remote: u16,
    /// Requests to send that found the mailbox occupied.
    pub occupied: u16,
    /// Bus-off states.
    pub bus_off: u16,
    /// Times the node left the bus and joined it again.
    pub rejoins: u16,
    /// References of a time that was before, which were ignored.
    pub past: u16,
    /// Calls of [`Link::service`]: a growing count shows that the window timer works.
    pub services: u32,
}

/// Whether the node takes part in the traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Presence {
    On,
    /// Off the bus since this instant, for at least `pause` ticks.
    Off {
        since: u32,
        pause: u32,
    },
    /// Joining: waiting for the controller to leave bus-off.
    Joining,
    /// Off the bus: listens without sending anything, to trim its oscillator.
    Listening,
    /// Its oscillator is trimmed: waiting for the controller to stop listening.
    Trimmed,
}

/// Why a node sends nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Silence {
    /// The application has not started the schedule yet.
    Waiting,
    /// It left the bus after bus-off or error level S3, and will be back.
    Away,
    /// It has no external clock, and hears no reference to trim its own oscillator by.
    NoReference,
    /// It is trimming its own oscillator by the references.
    Trimming,
}

/// Protocol stack, port and timer.
///
/// The stack lives in static memory of the application: it takes about 1 KiB, which should not
/// be moved about on the call stack while the node starts.
pub struct Link<P, T, const WINDOWS: usize, const NODES: usize> {
    node: &'static mut Stack<WINDOWS, NODES>,
    port: P,
    timer: T,
    inbox: [Option<Frame>; WINDOWS],
    outbox: [Option<[u8; 8]>; WINDOWS],
    /// The event message that the node waits for, and the last one that came.
    awaited: Option<Id>,
    event: Option<Frame>,
    presence: Presence,
    /// Instant to which the window timer is set.
    armed: Option<Stamp>,
    started: bool,
    /// The stack is to be started.
    start_due: bool,
    /// The mailbox refused a frame, and the stack has not been told yet.
    refused: bool,
    leader: Leader,
    /// Whether actuators were allowed to move when [`Link::take_stop`] was last called.
    moved: bool,
    /// Whether the application has a command.
    ends: Ends,
    reference_byte: u8,
    cycle_time: u32,
    /// Proof of the time that references tell, and the mark of the last one.
    time: TimeProof,
    begun: Stamp,
    /// The reference that this node sends.
    offered: Option<Frame>,
    /// What the application wants in the first byte of this node's references.
    #[cfg(feature = "master")]
    wanted: u8,
    /// The system time that this node went on from when it started, ms.
    #[cfg(feature = "master")]
    resumed: Option<u32>,
    /// Proof of the time that another master tells which does not follow this one, and the end of the last
    /// reference that was weighed for it.
    #[cfg(feature = "master")]
    rival: TimeProof,
    #[cfg(feature = "master")]
    weighed: Stamp,
    /// Basic cycles for which this still counts, and whether others follow this master in the current one.
    #[cfg(feature = "master")]
    young: u32,
    #[cfg(feature = "master")]
    followed: bool,
    /// Basic cycles in a row that this node has begun.
    #[cfg(feature = "master")]
    led: u8,
    troubled_since: Option<u32>,
    pause: u32,
    ticks_per_us: u32,
    /// Largest rate of the master's clock against this node's RC oscillator, in 2^-32.
    tolerance: u32,
    /// On a node without an external clock.
    tuner: Option<Tuner>,
    /// Bits that every reference of this node carries in its application's byte.
    quality: u8,
    schedule: ScheduleView<'static>,
    counters: Counters,
}

impl<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize> Link<P, T, WINDOWS, NODES> {
    /// A link that sends nothing until [`Link::start`] is called or the first frame arrives.
    ///
    /// `oscillator` is that of the node. The controller of a node on its RC oscillator was started
    /// silent: it only listens until the oscillator is trimmed. A node that leads as the last
    /// resort does not wait for that.
    ///
    /// # Errors
    /// The stack refuses the configuration.
    pub fn new(
        place: &'static mut Option<Stack<WINDOWS, NODES>>,
        schedule: ScheduleView<'static>,
        config: NodeConfig,
        oscillator: Oscillator,
        rule: Rule,
        port: P,
        timer: T,
    ) -> Result<Self, ConfigError> {
        const { assert!(WINDOWS <= 32, "News has one bit for each window") };
        let node = place.insert(Stack::new(schedule, config)?);
        let cycle = schedule
            .basic_cycle()
            .ticks()
            .saturating_mul(config.ticks_per_us);
        let internal = oscillator == Oscillator::Internal;
        let last_resort = internal && config.may_lead;
        let mut port = port;
        let presence = match oscillator {
            Oscillator::External => Presence::On,
            Oscillator::Internal if last_resort => {
                port.leave_bus();
                Presence::Trimmed
            }
            Oscillator::Internal => Presence::Listening,
        };
        let quality = if internal { INTERNAL_CLOCK } else { 0 };
        #[cfg(feature = "master")]
        node.set_reference_payload(&[quality]);
        Ok(Self {
            tuner: (internal && !last_resort)
                .then(|| Tuner::new(cycle, measured_cycles(schedule.basic_cycle()))),
            quality,
            // 2^32 / 10^6, rounded.
            tolerance: TOLERANCE_PPM.saturating_mul(4295),
            schedule,
            pause: crate::design::REJOIN_PAUSE
                .ticks()
                .saturating_mul(config.ticks_per_us),
            ticks_per_us: config.ticks_per_us,
            node,
            port,
            timer,
            inbox: [None; WINDOWS],
            outbox: [None; WINDOWS],
            awaited: None,
            event: None,
            presence,
            armed: None,
            started: false,
            start_due: false,
            refused: false,
            leader: Leader::new(rule, config.ticks_per_us),
            moved: false,
            ends: Ends::new(config.ticks_per_us),
            reference_byte: 0,
            cycle_time: 0,
            time: TimeProof::new(Secret::None, 0, schedule.basic_cycle()),
            offered: None,
            #[cfg(feature = "master")]
            wanted: 0,
            #[cfg(feature = "master")]
            resumed: None,
            begun: Stamp(0),
            #[cfg(feature = "master")]
            rival: TimeProof::new(Secret::None, 0, schedule.basic_cycle()),
            #[cfg(feature = "master")]
            weighed: Stamp(0),
            #[cfg(feature = "master")]
            young: 0,
            #[cfg(feature = "master")]
            followed: false,
            #[cfg(feature = "master")]
            led: 0,
            troubled_since: None,
            counters: Counters::default(),
        })
    }

    /// Joins the schedule, or, as a time master, begins it.
    ///
    /// A node that still listens begins as soon as its oscillator is trimmed.
    pub fn start(&mut self) {
        self.started = true;
        if !matches!(self.presence, Presence::Listening | Presence::Trimmed) {
            self.begin();
        }
    }

    fn begin(&mut self) {
        self.leader.forget();
        self.start_due = true;
        self.fire();
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

    /// The same. `keep` gets each event message that the node does not wait for.
    #[inline(always)]
    pub fn on_receive_keeping(&mut self, stamp: u32, keep: impl FnOnce(&Frame)) -> News {
        let mut news = News::default();
        if self.presence == Presence::Listening {
            self.listen(stamp);
            return news;
        }
        if !self.started {
            // Other nodes keep a schedule already: join it.
            self.start();
        }
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
        if self.schedule.is_reference(frame.id()) && self.time.is_past(&frame) {
            self.counters.past = self.counters.past.wrapping_add(1);
            return news;
        }
        match self.node.handle_receive(&frame, Stamp(stamp)) {
            Reception::Reference { rank, .. } => {
                self.begin_cycle(rank, &frame);
                news.reference = true;
                news.stop = self.take_stop();
                let [byte, ..] = frame.buffer();
                self.reference_byte = byte;
                self.node.set_drift_limit(self.drift_limit());
            }
            Reception::Scheduled { window } | Reception::Late { window } => {
                if let Some(slot) = self.inbox.get_mut(usize::from(window)) {
                    *slot = Some(frame);
                    #[cfg(feature = "master")]
                    {
                        self.followed = true;
                    }
                    news.windows |= 1u32.checked_shl(u32::from(window)).unwrap_or(0);
                }
            }
            Reception::Event => {
                if self.awaited == Some(frame.id()) {
                    self.event = Some(frame);
                    news.event = true;
                } else {
                    keep(&frame);
                }
            }
            #[cfg(feature = "master")]
            Reception::Fault(Fault::UntimelyReference) => self.weigh(&frame, Stamp(stamp)),
            Reception::Fault(_) => {}
        }
        self.arm();
        news
    }

    /// Weighs the reference of a master that does not follow this one, which leads the bus.
    ///
    /// A master that comes back may lead before it has the time of the bus: one reference is too little for
    /// that, and at the second one both may have waited for the end of a frame. It then tells an earlier time
    /// than the one that was proven to all others. They ignore it, and two masters would go on for ever. So the
    /// one that came back takes over a later time that the other one's references prove.
    ///
    /// Once others have followed it for some basic cycles this cannot be the case any more. Then only
    /// references that were recorded in another run tell a later time.
    #[cfg(feature = "master")]
    #[cold]
    #[inline(never)]
    fn weigh(&mut self, reference: &Frame, end: Stamp) {
        let time = time_of(reference);
        let ahead = time.wrapping_sub(self.cycle_time).cast_signed();
        let leads = self.node.status().master == MasterState::Current;
        if !leads || self.young == 0 || ahead <= self.time.interval().cast_signed() {
            return;
        }
        // Who sends false ones between the true ones only delays the end.
        self.young = self.youth();
        let since = self.millis(end.0.wrapping_sub(self.weighed.0));
        self.weighed = end;
        self.rival.begin(reference, since);
        if self.time.go_on(&self.rival) {
            self.rival = self.rival.anew();
            // The time is rounded down to 1 ms, and the frame took most of another one.
            let time = time.wrapping_add(1);
            self.set_time(end, time);
            self.resumed = Some(time);
            self.set_payload();
        }
    }

    /// Basic cycles that others have to follow this master until it weighs no more: some tags are lost, and each
    /// wrong one takes three right ones.
    #[cfg(feature = "master")]
    fn youth(&self) -> u32 {
        self.time.cycles().saturating_mul(4)
    }

    /// Takes a frame while the node only listens. Not inlined, so that it takes no registers of
    /// [`Link::on_receive`], on which the other frames wait.
    #[cold]
    #[inline(never)]
    fn listen(&mut self, stamp: u32) {
        if let Some(Received::Data(frame)) = self.port.receive()
            && self.schedule.is_reference(frame.id())
            && let Some(tuner) = &mut self.tuner
        {
            tuner.reference(stamp);
        }
    }

    /// Drift against the master that led last, ppm: either of the two may be on its RC oscillator.
    const fn drift_limit(&self) -> u16 {
        if (self.quality | self.reference_byte) & INTERNAL_CLOCK != 0 {
            crate::design::DRIFT_LIMIT_PPM_INTERNAL
        } else {
            crate::design::DRIFT_LIMIT_PPM
        }
    }

    /// Transmit interrupt. `stamp` is the time base, which the task reads before anything else.
    /// True if the node's own reference was sent, which begins a basic cycle.
    pub fn on_transmit(&mut self, stamp: u32) -> bool {
        let cycle = self.node.reference_mark();
        if let Some(outcome) = self.port.outcome() {
            let outcome = match outcome {
                Outcome::Complete => TransmitOutcome::Sent,
                Outcome::ArbitrationLost => TransmitOutcome::ArbitrationLost,
                Outcome::Error => TransmitOutcome::Error,
                Outcome::Aborted => TransmitOutcome::Aborted,
            };
            self.node.handle_transmit(outcome, Stamp(stamp));
        }
        self.arm();
        // No other node sends references.
        let begun = cfg!(feature = "master") && self.node.reference_mark() != cycle;
        if begun {
            if let (Some(rank), Some(frame)) = (self.node.status().master_rank, self.offered) {
                self.begin_cycle(rank, &frame);
            }
            self.reference_byte = 0;
            self.node.set_drift_limit(self.drift_limit());
            #[cfg(feature = "master")]
            if self.led == LEADS && self.quality & INTERNAL_CLOCK == 0 {
                self.node.forget_rate();
            }
        }
        begun
    }

    /// Notes that this reference, of the master of this rank, began a basic cycle.
    fn begin_cycle(&mut self, rank: u8, reference: &Frame) {
        self.cycle_time = time_of(reference);
        if let Some(mark) = self.node.reference_mark() {
            let since = self.millis(mark.0.wrapping_sub(self.begun.0));
            self.begun = mark;
            self.time.begin(reference, since);
            self.leader.begin(rank, mark.0);
        }
        #[cfg(feature = "master")]
        {
            let leads = self.rank() == Some(rank);
            self.led = if leads { self.led.saturating_add(1) } else { 0 };
            let shared = self.time.proof() == Proof::Proven;
            if core::mem::take(&mut self.followed) && leads || shared && !leads {
                self.young = self.young.saturating_sub(1);
            }
        }
    }

    /// `ticks` of the time base in whole milliseconds.
    fn millis(&self, ticks: u32) -> u32 {
        ticks
            .checked_div(self.ticks_per_us.wrapping_mul(1000))
            .unwrap_or(0)
    }

    /// Error interrupt.
    pub fn on_error(&mut self) {
        self.port.acknowledge_error();
        if self.port.error_state().bus_off && self.presence == Presence::On {
            self.counters.bus_off = self.counters.bus_off.wrapping_add(1);
            self.node.handle_bus_off();
        }
        self.arm();
    }

    /// The window timer's interrupt: carries out one action that is due and sets the timer to
    /// the next deadline.
    pub fn service(&mut self) {
        self.counters.services = self.counters.services.wrapping_add(1);
        let now = self.now();
        if self.start_due {
            self.start_due = false;
            self.node.start(now);
        } else if self.refused {
            self.refused = false;
            self.node.handle_transmit(TransmitOutcome::Aborted, now);
        } else if let Some(action) = self.node.advance(now) {
            self.perform(action, now);
        }
        if self.start_due || self.refused {
            self.fire();
        } else {
            // The timer has fired, so it is set to nothing.
            self.set_timer(self.node.next_deadline());
        }
    }

    fn perform(&mut self, action: Action, now: Stamp) {
        let frame = match action {
            Action::TransmitReference(frame) => {
                self.offered = Some(frame);
                frame
            }
            Action::TransmitEvent(frame) => frame,
            Action::Transmit(grant) => {
                let data = self
                    .outbox
                    .get_mut(usize::from(grant.window))
                    .and_then(Option::take);
                let Some(data) = data else {
                    self.node.handle_transmit(TransmitOutcome::Empty, now);
                    return;
                };
                Frame::from_parts(grant.id, grant.len, data)
            }
            Action::Abort => {
                self.port.abort();
                return;
            }
            Action::Silence => {
                self.port.leave_bus();
                self.presence = Presence::Off {
                    since: now.0,
                    pause: self.pause,
                };
                return;
            }
        };
        if self.port.load(&frame).is_err() {
            self.counters.occupied = self.counters.occupied.wrapping_add(1);
            self.refused = true;
        }
    }

    /// Sets the window timer to the stack's next deadline, unless it is set to it already.
    fn arm(&mut self) {
        let deadline = self.node.next_deadline();
        // If an action of the link itself is due, the timer has fired already.
        if deadline == self.armed || self.start_due || self.refused {
            return;
        }
        self.set_timer(deadline);
    }

    fn set_timer(&mut self, deadline: Option<Stamp>) {
        self.armed = deadline;
        match deadline {
            Some(deadline) => self.timer.set_window(deadline.0),
            None => self.timer.clear_window(),
        }
    }

    /// Makes the window timer fire at once.
    fn fire(&mut self) {
        let now = self.now();
        self.armed = Some(now);
        self.timer.set_window(now.0);
    }

    /// Brings the node back after bus-off and after error level S3, and clears S2 after a
    /// pause. A node without an external clock listens first, to trim its oscillator, and leaves
    /// the bus when the oscillator has drifted too far. Returns the trim to set, in steps from the
    /// factory's setting.
    ///
    /// bxCAN without automatic bus-off management leaves bus-off by a software sequence, which
    /// also ends S3: initialisation mode, normal mode, then 128 times eleven recessive bits.
    /// Call this every few milliseconds.
    pub fn keep_present(&mut self) -> Option<i8> {
        match self.presence {
            Presence::On => {
                self.forgive();
                if self.has_drifted() {
                    self.node.withdraw();
                    self.arm();
                }
            }
            Presence::Off { since, pause } => {
                let silent = self.tuner.is_some();
                if self.timer.now().wrapping_sub(since) >= pause && self.port.join_bus(silent) {
                    if let Some(tuner) = &mut self.tuner {
                        tuner.resume();
                        self.presence = Presence::Listening;
                    } else {
                        self.presence = Presence::Joining;
                    }
                }
            }
            Presence::Joining => {
                if !self.port.error_state().bus_off {
                    self.presence = Presence::On;
                    self.counters.rejoins = self.counters.rejoins.wrapping_add(1);
                    if self.started {
                        self.begin();
                    }
                }
            }
            Presence::Listening => {
                let now = self.timer.now();
                let disturbed = self.port.take_error();
                match self.tuner.as_mut()?.step(now, disturbed) {
                    Tuning::Listen => {}
                    Tuning::Trim(steps) => return Some(steps),
                    Tuning::Tuned => {
                        self.node.forget_rate();
                        self.port.leave_bus();
                        self.presence = Presence::Trimmed;
                    }
                }
            }
            Presence::Trimmed => {
                if self.port.join_bus(false) {
                    self.presence = Presence::Joining;
                }
            }
        }
        None
    }

    /// Whether the node's own oscillator differs from the master's by more than its bit timing
    /// allows.
    fn has_drifted(&self) -> bool {
        self.tuner.is_some()
            && (self.node.rate().unsigned_abs() > self.tolerance
                || self.node.status().clock == ClockState::Suspended)
    }

    /// Why the node sends nothing; `None` if it takes part in the traffic.
    pub fn silence(&self) -> Option<Silence> {
        match self.presence {
            Presence::On if self.started => None,
            Presence::On => Some(Silence::Waiting),
            Presence::Off { .. } | Presence::Joining => Some(Silence::Away),
            Presence::Listening | Presence::Trimmed => {
                let hears = self.tuner.as_ref().is_some_and(Tuner::hears);
                Some(if hears {
                    Silence::Trimming
                } else {
                    Silence::NoReference
                })
            }
        }
    }

    /// Rank of the node among the potential time masters.
    pub fn rank(&self) -> Option<u8> {
        self.schedule.rank_of(self.node.id())
    }

    /// Trim of the node's own oscillator, in steps; `None` on its external clock.
    pub fn trim(&self) -> Option<i8> {
        self.tuner.as_ref().map(Tuner::trim)
    }

    /// Rate of true time against this node's time base less 1, in 2^-32 (4295 is one part per
    /// million); `None` while it is unknown. An external clock has true time. An RC oscillator is compared
    /// with it by the references, as long as their master is on its external clock.
    pub fn true_rate(&self) -> Option<i32> {
        if self.quality & INTERNAL_CLOCK == 0 {
            return Some(0);
        }
        let measured = self.node.is_alive()
            && self.node.status().clock == ClockState::Locked
            && self.reference_byte & INTERNAL_CLOCK == 0
            && self.tuner.is_some();
        measured.then(|| self.node.rate())
    }

    /// How long a node that listens has heard nothing at all; `None` if it does not listen.
    pub fn quiet(&self) -> Option<Micros> {
        let tuner = self.tuner.as_ref()?;
        let ticks = match self.presence {
            Presence::Listening => tuner.quiet(self.timer.now())?,
            _ => return None,
        };
        Some(Micros::micros(ticks.checked_div(self.ticks_per_us)?))
    }

    /// Sets the application's byte of this node's references. Its bit 1 is the link's: the node
    /// leads on its RC oscillator.
    #[cfg(feature = "master")]
    pub fn set_reference_byte(&mut self, byte: u8) {
        self.wanted = byte;
        self.set_payload();
    }

    /// Puts the first byte of this node's next reference together.
    #[cfg(feature = "master")]
    fn set_payload(&mut self) {
        let tag = self.time.bits();
        let byte = self.wanted & !INTERNAL_CLOCK & !self.time.mask() | self.quality | tag;
        self.node.set_reference_payload(&[byte]);
    }

    /// Goes on from a time that this node saw proven before it started, ms. A reference of an earlier time
    /// begins no basic cycle, so no command of an earlier cycle is obeyed. Call this after
    /// [`Link::prove_time`].
    ///
    /// If the node leads the bus, its first reference tells a later time, as later references were not
    /// proven yet, and commands may have followed them. If it hears another master first, it takes that
    /// one's time.
    pub fn resume(&mut self, before: u32) {
        self.time.resume(before);
        #[cfg(feature = "master")]
        {
            let time = before.wrapping_add(2 * self.time.interval());
            self.set_time(self.now(), time);
            self.resumed = Some(time);
        }
    }

    /// Sets the system time of the instant `stamp`, ms. A time before the one that the node goes on from
    /// is ignored, as others would not follow it; so is any while another master leads.
    #[cfg(feature = "master")]
    pub fn set_time(&mut self, stamp: Stamp, time: u32) {
        let is_past = |from| time.wrapping_sub(from).cast_signed() < 0;
        if !self.resumed.is_some_and(is_past) {
            let time = GlobalTime::from_micros(u64::from(time) * 1000);
            let _ = self.node.set_global_time(stamp, time);
        }
    }

    /// From now on references prove the time by a tag, in the bits `free` of their first byte. `secret`
    /// is that of the node. Call this before [`Link::start`].
    pub fn prove_time(&mut self, secret: Secret, free: u8) {
        self.time = TimeProof::new(secret, free, self.schedule.basic_cycle());
        #[cfg(feature = "master")]
        if self.time.mask() != 0 {
            self.rival = self.time;
            self.young = self.youth();
        }
    }

    /// Clears error level S2 after a pause. S2 stops all transmissions except the reference
    /// until the application clears it. By then its cause may be gone, so the node tries again.
    fn forgive(&mut self) {
        if self.node.status().error_level != ErrorLevel::Error {
            self.troubled_since = None;
            return;
        }
        let now = self.timer.now();
        let since = *self.troubled_since.get_or_insert(now);
        if now.wrapping_sub(since) >= self.pause {
            self.troubled_since = None;
            self.node.clear_errors();
        }
    }

    /// Whether this node sends its messages: it is in the schedule, and its error level permits
    /// sending.
    pub fn is_heard(&self) -> bool {
        let level = self.node.status().error_level;
        self.node.is_alive() && matches!(level, ErrorLevel::None | ErrorLevel::Warning)
    }

    /// Whether the node follows the schedule of a bus that is alive.
    pub fn is_alive(&self) -> bool {
        self.node.is_alive()
    }

    /// The application's byte of the last reference from another node; 0 if this node itself is
    /// the time master.
    pub const fn reference_byte(&self) -> u8 {
        self.reference_byte
    }

    /// System time at which the current basic cycle began, ms, as its reference says.
    pub const fn cycle_began(&self) -> u32 {
        self.cycle_time
    }

    /// Whether the time of the current basic cycle is proven, or the node has no key and believes every
    /// reference.
    ///
    /// If not, seal nothing for this cycle. A forged reference may have told a time of days ahead: whoever
    /// records the sealed command could play it then, and an actuator that took it would refuse all earlier
    /// commands, the true ones, until then.
    pub fn is_time_believed(&self) -> bool {
        self.time.proof() != Proof::Unproven
    }

    /// Takes the frame that arrived in a window; `None` if there is no new one.
    pub fn take(&mut self, window: usize) -> Option<Frame> {
        self.inbox.get_mut(window).and_then(Option::take)
    }

    /// Takes a sealed frame that arrived in a window. One that came while the time was not
    /// [believed](Self::is_time_believed) is dropped: its tag says nothing, and the receiver would go on from its time.
    pub fn take_believed(&mut self, window: usize) -> Option<Frame> {
        let frame = self.take(window);
        frame.filter(|_| self.is_time_believed())
    }

    /// Takes the message that arrived in a window; `None` if there is no new one or its data
    /// does not decode as this message.
    pub fn message<M: Message>(&mut self, window: usize) -> Option<M> {
        self.take(window)
            .and_then(|frame| M::decode(frame.data()).ok())
    }

    /// Takes the frame of the command's window `command`, and reads the state of the bus. No
    /// command is in force in the pause behind the end of another one.
    pub fn arrival(&mut self, command: usize) -> Arrival {
        let allowed = self.commands_arrive(command);
        let frame = self.take_believed(command);
        let alive = self
            .ends
            .hand_over(allowed, frame.is_some(), self.timer.now());
        Arrival {
            frame,
            time: self.cycle_time,
            alive,
        }
    }

    /// Leaves the bus for good: only a start brings the node back.
    pub fn leave(&mut self) {
        self.port.leave_bus();
    }

    /// Waits for an event message with this identifier.
    pub fn wait_for(&mut self, event: Id) {
        self.awaited = Some(event);
    }

    /// Takes the event message that the node waits for, if one has come.
    pub fn take_event(&mut self) -> Option<Frame> {
        self.event.take()
    }

    /// Enqueues data for a window of this node. It is sent once; without new data the next
    /// occurrence of the window stays empty.
    pub fn put(&mut self, window: usize, data: [u8; 8]) {
        if let Some(slot) = self.outbox.get_mut(window) {
            *slot = Some(data);
        }
    }

    /// Enqueues data for a window of this node; `None` removes what was enqueued.
    pub fn replace(&mut self, window: usize, data: Option<[u8; 8]>) {
        if let Some(slot) = self.outbox.get_mut(window) {
            *slot = data;
        }
    }

    /// Queues an event message of this node.
    ///
    /// # Errors
    /// The queue is full, or the message is not one of this node's events.
    pub fn queue_event(
        &mut self,
        id: u16,
        data: &[u8],
        lifetime: Micros,
    ) -> Result<(), QueueError> {
        let frame = event(id, data)?;
        let now = self.now();
        let queued = self.node.queue_event(frame, now, lifetime);
        self.arm();
        queued
    }

    /// Whether actuators may move under the time master that leads the bus, by the time that it tells.
    pub fn may_move(&self) -> bool {
        self.may_move_at(self.timer.now())
    }

    fn may_move_at(&self, now: u32) -> bool {
        self.is_time_believed() && self.leader.permits(now)
    }

    /// Whether the time master's permission to move has ended since the last call. Call it after
    /// each service of the window timer, which is due when a reference is missing.
    pub fn take_stop(&mut self) -> bool {
        let moved = self.moved;
        self.moved = self.may_move();
        moved && !self.moved
    }

    /// Whether the command that the application has may not stay in force: it has `expired`, the node is
    /// no longer in the schedule, or actuators may not move any more. True once for a command, and not
    /// twice within [`END_PAUSE`](crate::design::END_PAUSE), so that a bus which is gone or comes and
    /// goes releases no more work than one that works. Call it after each service of the window
    /// timer, which is due when a reference is missing, and at once after bus-off.
    pub fn take_end(&mut self, expired: bool) -> bool {
        let now = self.timer.now();
        let lost = !(self.may_move_at(now) && self.node.is_alive());
        self.ends.take(expired || lost, now)
    }

    /// Whether an actuator may act on commands: the network is alive, at most one command in a
    /// row is missing from window `command` (thesis 6.2.4.4), and actuators may move under its
    /// time master.
    pub fn commands_arrive(&self, command: usize) -> bool {
        self.may_move()
            && self.node.is_alive()
            && self
                .node
                .window(command as u16)
                .is_some_and(|status| u32::from(status.missed) < network::MISSED_PERIODS)
    }

    /// Global time now, ms; 0 before it is known.
    pub fn system_time(&self) -> u32 {
        self.node
            .global_time(self.now())
            .map_or(0, |time| time.as_millis())
    }

    /// The protocol stack.
    pub fn node(&self) -> &Stack<WINDOWS, NODES> {
        self.node
    }

    /// Failure class of another node (thesis 4.3.7).
    #[cfg(feature = "peers")]
    pub fn health(&self, node: NodeId) -> ttcan::Health {
        self.node.peer(node)
    }

    /// The protocol stack, for the application's decisions.
    pub fn node_mut(&mut self) -> &mut Stack<WINDOWS, NODES> {
        self.node
    }

    /// The window timer.
    pub fn timer_mut(&mut self) -> &mut T {
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

    /// Counters of the link.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Ticks of the time base from now until the age of the basic cycle is `time`; negative if
    /// that instant has passed. `None` before the first reference.
    pub fn until(&self, time: Micros) -> Option<i32> {
        let now = self.now();
        let age = self.node.cycle_time(now)?;
        let left = time
            .ticks()
            .cast_signed()
            .saturating_sub(age.ticks().cast_signed());
        Some(left.saturating_mul(self.ticks_per_us.cast_signed()))
    }

    fn now(&self) -> Stamp {
        Stamp(self.timer.now())
    }
}

impl<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize> AnyLink
    for Link<P, T, WINDOWS, NODES>
{
    fn view(&self) -> BusView {
        let counters = self.node.counters();
        BusView {
            status: self.node.status(),
            missed_references: counters.missed_references,
            missed_messages: counters.missed_messages,
            missed_windows: counters
                .skipped
                .wrapping_add(counters.suppressed)
                .wrapping_add(counters.transmit_errors),
            misplaced: counters
                .misplaced
                .wrapping_add(counters.foreign)
                .wrapping_add(u32::from(self.counters.past)),
            errors: self.error_state(),
            link: self.counters(),
            silence: self.silence(),
            trim: self.trim(),
            quiet: self.quiet(),
            rank: self.rank(),
            time: self.time.proof(),
            forged: self.time.wrong(),
        }
    }

    fn take_event(&mut self) -> Option<Frame> {
        self.take_event()
    }

    fn queue_event(&mut self, id: u16, data: &[u8], lifetime: Micros) -> Result<(), QueueError> {
        self.queue_event(id, data, lifetime)
    }

    fn has_event(&self, id: u16) -> bool {
        Id::standard(id).is_some_and(|id| self.node.has_event(id))
    }

    fn replace_event(&mut self, id: u16, data: &[u8], lifetime: Micros) -> Result<(), QueueError> {
        let now = self.now();
        self.node.replace_event(event(id, data)?, now, lifetime)
    }

    fn open(&self) -> Option<Open> {
        let open = self.time.open();
        #[cfg(feature = "master")]
        let open = open.or_else(|| self.rival.open());
        open
    }

    fn close(&mut self, answer: Answer) {
        self.time.close(answer);
        #[cfg(feature = "master")]
        {
            self.rival.close(answer);
            self.set_payload();
        }
    }
}

/// The frame of an event message.
///
/// # Errors
/// This is no standard identifier, or the data are longer than 8 bytes.
pub(crate) fn event(id: u16, data: &[u8]) -> Result<Frame, QueueError> {
    Id::standard(id)
        .and_then(|id| Frame::new(id, data).ok())
        .ok_or(QueueError::NotAnEvent)
}

/// Data of a shorter message, padded with zeros to the size of a window's buffer.
pub fn padded<const N: usize>(data: [u8; N]) -> [u8; 8] {
    let mut bytes = [0; 8];
    for (to, from) in bytes.iter_mut().zip(data) {
        *to = from;
    }
    bytes
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::leader::BackupMaster;
    use std::boxed::Box;
    use std::collections::VecDeque;
    use std::vec::Vec;
    use ttcan::{MatrixConfig, ReferenceFormat, SystemMatrix, Window};

    /// A CAN controller that records the calls of the link.
    #[derive(Default)]
    struct Cell {
        fifo: VecDeque<Received>,
        loaded: Vec<Frame>,
        pending: bool,
        outcome: Option<Outcome>,
        errors: ErrorState,
        away: bool,
        silent: bool,
        error: bool,
    }

    impl Port for Cell {
        fn receive(&mut self) -> Option<Received> {
            self.fifo.pop_front()
        }
        fn take_overrun(&mut self) -> bool {
            false
        }
        fn load(&mut self, frame: &Frame) -> Result<(), Occupied> {
            if self.pending {
                return Err(Occupied);
            }
            self.pending = true;
            self.loaded.push(*frame);
            Ok(())
        }
        fn abort(&mut self) {
            self.outcome = Some(Outcome::Aborted);
        }
        fn outcome(&mut self) -> Option<Outcome> {
            self.pending = false;
            self.outcome.take()
        }
        fn acknowledge_error(&mut self) {}
        fn error_state(&self) -> ErrorState {
            self.errors
        }
        fn leave_bus(&mut self) {
            self.away = true;
            self.pending = false;
        }
        fn join_bus(&mut self, silent: bool) -> bool {
            self.away = false;
            self.silent = silent;
            true
        }
        fn take_error(&mut self) -> bool {
            core::mem::take(&mut self.error)
        }
    }

    #[derive(Default)]
    struct Timer {
        now: u32,
        window: Option<u32>,
    }

    impl WindowTimer for Timer {
        fn now(&self) -> u32 {
            self.now
        }
        fn set_window(&mut self, instant: u32) {
            let late = self.now.wrapping_sub(instant) < 1 << 31;
            self.window = Some(if late { self.now } else { instant });
        }
        fn clear_window(&mut self) {
            self.window = None;
        }
    }

    const PER_US: u32 = 18;
    /// Start of the tests' time base: the counter wraps during them.
    const BEGIN: u32 = u32::MAX - 5_000_000;

    const MASTER: NodeId = NodeId(0);
    const STEERING: NodeId = NodeId(1);
    /// Place of the steering's window in the matrix.
    const STEERING_POT: usize = 0;

    const MATRIX: SystemMatrix<'static> = matrix(&[MASTER]);

    const fn matrix(masters: &'static [NodeId]) -> SystemMatrix<'static> {
        SystemMatrix::constant(MatrixConfig {
            bit_rate: 250_000,
            basic_cycle: Micros::millis(100),
            cycles: 1,
            reference: Id::constant::<100>(),
            reference_format: ReferenceFormat::new(1, Some(1), 5, Some(6)),
            masters,
            transmit_enable_bits: 16,
            sync_uncertainty: Micros::micros(20),
            longest_gap: Micros::micros(0),
            windows: const {
                &[Window::exclusive(
                    "steering_pot",
                    Micros::millis(6),
                    Micros::millis(1),
                    Id::constant::<206>(),
                    2,
                    STEERING,
                )]
            },
            events: &[],
        })
    }

    ttcan::schedule!(
        /// Two nodes: the master, and the steering, which sends one message.
        static SCHEDULE = MATRIX
    );

    type TestLink = Link<Cell, Timer, { MATRIX.window_count() }, { MATRIX.node_count() }>;

    fn steering() -> TestLink {
        on(Oscillator::External)
    }

    fn on(oscillator: Oscillator) -> TestLink {
        let place = Box::leak(Box::new(None));
        let timer = Timer {
            now: BEGIN,
            window: None,
        };
        Link::new(
            place,
            SCHEDULE.view(),
            NodeConfig {
                may_lead: oscillator == Oscillator::External,
                ..NodeConfig::new(STEERING, PER_US)
            },
            oscillator,
            Rule::new(BackupMaster::Stop, Micros::millis(100)),
            Cell::default(),
            timer,
        )
        .expect("a configuration that fits")
    }

    /// Lets `micros` pass. The window timer's interrupt and the transmit interrupt occur when
    /// they are due.
    fn pass(link: &mut TestLink, micros: u32) {
        let end = link.timer.now.wrapping_add(micros * PER_US);
        loop {
            if link.port.pending || link.port.outcome.is_some() {
                // 300 us later the frame is out.
                link.timer.now = link.timer.now.wrapping_add(300 * PER_US);
                link.port.outcome.get_or_insert(Outcome::Complete);
                link.on_transmit(link.timer.now);
                continue;
            }
            let left = end.wrapping_sub(link.timer.now);
            if left.cast_signed() < 0 {
                return;
            }
            match link.timer.window {
                Some(at) if at.wrapping_sub(link.timer.now) <= left => {
                    link.timer.now = at;
                    link.timer.window = None;
                    link.service();
                }
                _ => break,
            }
        }
        link.timer.now = end;
    }

    /// The reference of system time `time` (ms) arrives now.
    fn reference(link: &mut TestLink, fix: u8, time: u32) -> News {
        let [a, b, c, d] = time.to_be_bytes();
        // The reference before was sent 100 ms earlier; in 1/32 us.
        let [e, f] = (time.wrapping_sub(100).wrapping_mul(32_000) as u16).to_be_bytes();
        let data = [fix, a, b, c, d, 0, e, f];
        let frame = Frame::new(Id::constant::<100>(), &data).expect("eight bytes");
        link.port.fifo.push_back(Received::Data(frame));
        link.on_receive(link.timer.now)
    }

    fn synchronised() -> TestLink {
        let mut link = steering();
        link.start();
        pass(&mut link, 0);
        for cycle in 0..2 {
            assert!(reference(&mut link, 1, 1000 + 100 * cycle).reference);
            pass(&mut link, 100_000);
        }
        link
    }

    /// A command comes and is handed to the application.
    fn command(link: &mut TestLink) -> Arrival {
        link.inbox[STEERING_POT] = Frame::new(Id::constant::<206>(), &[0; 2]).ok();
        link.arrival(STEERING_POT)
    }

    #[test]
    fn with_a_key_a_command_counts_only_while_the_time_is_proven() {
        let mut link = steering();
        link.prove_time(Secret::Key(crate::e2e::Key::new([7; 16])), 0xFC);
        link.start();
        pass(&mut link, 0);
        let cycle = |link: &mut TestLink, time: u32, wrong: u8| {
            let news = reference(link, link.time.bits() ^ wrong | 1, time);
            assert!(news.reference, "{time}");
            if let Some(open) = link.open() {
                link.close(open.answer());
            }
            let alive = command(link).alive;
            pass(link, 100_000);
            (news.stop, alive)
        };
        // Five right tags, after a first reference that has none before it.
        for number in 0..20 {
            let expected = (false, number >= 5);
            assert_eq!(
                cycle(&mut link, 1000 + 100 * number, 0),
                expected,
                "{number}"
            );
        }
        assert_eq!(cycle(&mut link, 3000, 4), (false, true));
        assert_eq!(cycle(&mut link, 3100, 4), (true, false));
        assert_eq!(link.view().forged, 2);
        // A time that was before begins no cycle.
        let before = link.cycle_began();
        assert_eq!(reference(&mut link, 1, 1500), News::default());
        assert_eq!((link.cycle_began(), link.counters().past), (before, 1));
    }

    #[test]
    fn a_node_that_starts_again_follows_no_time_before_the_kept_one() {
        let mut link = steering();
        link.prove_time(Secret::Key(crate::e2e::Key::new([7; 16])), 0xFC);
        link.resume(5000);
        link.start();
        pass(&mut link, 0);
        for time in [0, 1000, 4900] {
            assert_eq!(reference(&mut link, 1, time), News::default(), "{time}");
            pass(&mut link, 100_000);
        }
        assert_eq!(link.counters().past, 3);
        for time in [5100, 5200] {
            assert!(reference(&mut link, 1, time).reference, "{time}");
            pass(&mut link, 100_000);
        }
    }

    /// Two masters, and one that has come back and leads without having heard the other.
    #[cfg(feature = "master")]
    mod rivals {
        use super::*;
        use crate::e2e::Key;

        ttcan::schedule!(
            /// The same with the steering as the backup master.
            static RIVALS = matrix(&[MASTER, STEERING])
        );

        const SECRET: Secret = Secret::Key(Key::new([7; 16]));
        const FREE: u8 = 0xFC;
        /// As many as have 30 bits together.
        const NEEDED: u32 = 5;

        /// A master that has started and has heard nothing yet.
        fn started(node: NodeId) -> TestLink {
            let timer = Timer {
                now: BEGIN,
                window: None,
            };
            let mut link = Link::new(
                Box::leak(Box::new(None)),
                RIVALS.view(),
                NodeConfig::new(node, PER_US),
                Oscillator::External,
                Rule::new(BackupMaster::Stop, Micros::millis(100)),
                Cell::default(),
                timer,
            )
            .expect("a configuration that fits");
            link.prove_time(SECRET, FREE);
            link.start();
            link
        }

        /// The master that came back, which goes on from the time `before`, and the first cycle that it leads.
        fn returned(before: u32) -> TestLink {
            let mut link = started(MASTER);
            link.resume(before);
            pass(&mut link, 110_000);
            assert_eq!(link.node.status().master, MasterState::Current);
            compute(&mut link);
            link
        }

        /// What the housekeeping does.
        fn compute(link: &mut TestLink) {
            while let Some(open) = link.open() {
                link.close(open.answer());
            }
        }

        /// The last reference that the link sent.
        fn own(link: &TestLink) -> Frame {
            *link.port.loaded.last().expect("a reference")
        }

        /// The master that led meanwhile.
        struct Other {
            proof: TimeProof,
            time: u32,
        }

        impl Other {
            fn at(time: u32) -> Self {
                let proof = TimeProof::new(SECRET, FREE, Micros::millis(100));
                Self { proof, time }
            }

            /// Its reference arrives, with `wrong` bits of its tag; then a basic cycle passes.
            fn send(&mut self, link: &mut TestLink, wrong: u8) {
                self.send_only(link, wrong);
                pass(link, 100_000);
                compute(link);
            }

            fn send_only(&mut self, link: &mut TestLink, wrong: u8) {
                let [a, b, c, d] = self.time.to_be_bytes();
                let data = [self.proof.bits() ^ wrong | 1, a, b, c, d, 0, 0, 0];
                let frame = Frame::new(Id::constant::<101>(), &data).expect("eight bytes");
                self.proof.begin(&frame, 100);
                self.compute();
                link.port.fifo.push_back(Received::Data(frame));
                assert_eq!(link.on_receive(link.timer.now), News::default());
                compute(link);
                self.time += 100;
            }

            fn compute(&mut self) {
                if let Some(open) = self.proof.open() {
                    self.proof.close(open.answer());
                }
            }
        }

        #[test]
        fn a_master_that_came_back_takes_the_later_time_of_the_other_one() {
            let mut link = returned(5000);
            let mut other = Other::at(7000);
            for _ in 0..NEEDED {
                other.send(&mut link, 0);
                assert!(time_of(&own(&link)) < 6500);
            }
            other.send(&mut link, 0);
            // The other one's came 9 ms behind the one before.
            let since = time_of(&own(&link)) + 100 - other.time;
            assert!((91..=93).contains(&since), "{since} ms");
            assert!(link.is_time_believed());
            // To all others, its references go on where those of the other one ended.
            for _ in 0..10 {
                assert!(!other.proof.is_past(&own(&link)));
                other.proof.begin(&own(&link), 100);
                other.compute();
                pass(&mut link, 100_000);
                compute(&mut link);
            }
            assert_eq!(
                (other.proof.proof(), other.proof.wrong()),
                (Proof::Proven, 0)
            );
        }

        /// The other master's time ran 190 ppm faster, which that of no two crystals does.
        #[test]
        fn a_master_on_its_crystal_leads_at_the_rate_of_the_crystal() {
            let mut link = started(STEERING);
            pass(&mut link, 1000);
            for cycle in 0..12 {
                if cycle > 0 {
                    pass(&mut link, 99_500);
                    // The node's own reference is due while this one is on the bus.
                    link.timer.now = link.timer.now.wrapping_add(481 * PER_US);
                }
                assert!(reference(&mut link, 1, 7000 + 100 * cycle).reference);
            }
            assert_eq!(link.node.status().master, MasterState::Backup);
            let ppm = |link: &TestLink| f64::from(link.node.rate()) / 4295.0;
            let followed = ppm(&link);
            assert!((150.0..=200.0).contains(&followed), "{followed}");
            let mut led = || {
                link.port.loaded.clear();
                let begins = |frame: &Frame| frame.id() == Id::constant::<101>();
                while !link.port.loaded.iter().any(begins) {
                    pass(&mut link, 1000);
                }
                // The frame is out.
                pass(&mut link, 1000);
                assert_eq!(link.node.status().master, MasterState::Current);
                ppm(&link)
            };
            // The other one has perhaps lost a reference or two.
            for _ in 1..LEADS {
                assert_eq!(led(), followed);
            }
            for _ in 0..3 {
                assert_eq!(led(), 0.0);
            }
        }

        #[test]
        fn it_takes_no_time_that_is_not_proven() {
            let mut link = returned(5000);
            let mut other = Other::at(7000);
            for number in 0..60 {
                other.send(&mut link, if number % 4 == 3 { 4 } else { 0 });
                assert!(time_of(&own(&link)) < 5400 + 100 * (number + 1));
            }
        }

        #[test]
        fn it_takes_no_earlier_time() {
            let mut link = returned(5000);
            let mut other = Other::at(4000);
            for _ in 0..20 {
                other.send(&mut link, 0);
            }
            assert!(time_of(&own(&link)) > 7000);
            assert_eq!(link.counters().past, 20);
        }

        /// A basic cycle in which the steering sends its message where this master's schedule has it.
        fn followed(link: &mut TestLink) {
            let age = link.node.cycle_time(link.now()).expect("it leads");
            pass(link, 106_400 - age.ticks());
            let frame = Frame::new(Id::constant::<206>(), &[0; 2]).expect("two bytes");
            link.port.fifo.push_back(Received::Data(frame));
            assert_eq!(link.on_receive(link.timer.now).windows, 1);
            compute(link);
        }

        #[test]
        fn one_that_others_follow_takes_no_time_of_others() {
            let mut link = returned(5000);
            for _ in 0..=4 * NEEDED {
                followed(&mut link);
            }
            let mut other = Other::at(20_000);
            for _ in 0..4 * NEEDED {
                other.send(&mut link, 0);
            }
            assert!(time_of(&own(&link)) < 10_000);
        }

        #[test]
        fn one_that_nobody_follows_takes_a_later_time_at_any_time() {
            let mut link = returned(5000);
            for _ in 0..100 {
                pass(&mut link, 100_000);
                compute(&mut link);
            }
            let mut other = Other::at(50_000);
            for _ in 0..=NEEDED {
                other.send(&mut link, 0);
            }
            assert!(time_of(&own(&link)) > 50_000);
        }

        #[test]
        fn false_references_between_the_true_ones_only_delay_it() {
            let mut link = returned(5000);
            let (mut other, mut attacker) = (Other::at(50_000), Other::at(90_000));
            for _ in 0..100 {
                attacker.send_only(&mut link, 4);
                other.send(&mut link, 0);
            }
            assert!(time_of(&own(&link)) < 20_000);
            for _ in 0..NEEDED {
                other.send(&mut link, 0);
            }
            assert!(time_of(&own(&link)) > 60_000);
        }

        /// Those of this run that were sent while this master was away.
        #[test]
        fn recorded_references_do_not_keep_it_from_the_true_time() {
            let mut link = returned(5000);
            for time in [5900, 30_000] {
                let mut other = Other::at(time);
                for _ in 0..=NEEDED {
                    other.send(&mut link, 0);
                }
                let ahead = time_of(&own(&link)).wrapping_sub(time);
                assert!((500..700).contains(&ahead), "{ahead} ms");
            }
        }

        /// All within a basic cycle.
        #[test]
        fn references_that_are_played_too_fast_prove_nothing() {
            let mut link = returned(5000);
            for time in [20_000, 40_000] {
                let mut other = Other::at(time);
                for _ in 0..9 {
                    other.send_only(&mut link, 0);
                    pass(&mut link, 10_000);
                }
                pass(&mut link, 10_000);
                assert!(time_of(&own(&link)) < 6000);
            }
        }
    }

    #[test]
    fn a_bus_that_is_gone_ends_a_command_once() {
        let mut link = synchronised();
        assert!(!link.take_end(true), "there is no command yet");
        assert!(command(&mut link).alive && !link.take_end(false));
        let mut ends = 0;
        for _ in 0..1000 {
            pass(&mut link, 1000);
            ends += u32::from(link.take_end(false));
            if ends == 1 {
                assert!(!link.arrival(STEERING_POT).alive);
            }
        }
        assert_eq!(ends, 1);
    }

    #[test]
    fn a_node_that_leaves_the_bus_ends_its_command_at_once() {
        let mut link = synchronised();
        assert!(command(&mut link).alive);
        link.port.errors.bus_off = true;
        link.on_error();
        assert_eq!(
            link.timer.window,
            Some(link.timer.now),
            "the window timer fires"
        );
        pass(&mut link, 0);
        assert!(link.take_end(false) && !link.take_end(false));
    }

    #[test]
    fn what_is_put_in_line_is_sent_once_and_an_empty_line_leaves_the_window_empty() {
        let mut link = synchronised();
        link.put(STEERING_POT, [0x3C, 3, 9, 9, 9, 9, 9, 9]);
        reference(&mut link, 0, 1200);
        pass(&mut link, 100_000);
        let sent: Vec<_> = link
            .port
            .loaded
            .iter()
            .map(|f| (f.id().raw(), f.data().to_vec()))
            .collect();
        assert_eq!(sent, [(206, std::vec![0x3C, 3])]);
        assert_eq!(link.cycle_began(), 1200);
        assert_eq!(link.reference_byte(), 0);
        reference(&mut link, 1, 1300);
        pass(&mut link, 100_000);
        assert_eq!(link.port.loaded.len(), 1);
        assert!(link.node().counters().left_empty > 0);
        assert_eq!(link.node().counters().skipped, 0);
    }

    #[test]
    fn a_link_that_waits_begins_with_the_first_frame() {
        let mut link = steering();
        assert!(!link.is_started());
        reference(&mut link, 1, 5);
        assert!(link.is_started());
        pass(&mut link, 0);
        for cycle in 0..2 {
            assert!(reference(&mut link, 1, 1000 + 100 * cycle).reference);
            pass(&mut link, 100_000);
        }
        assert!(link.is_heard());
    }

    #[test]
    fn a_frame_that_the_mailbox_refuses_is_told_to_the_stack_and_leaves_its_window_empty() {
        let mut link = synchronised();
        link.put(STEERING_POT, [0x3C, 3, 9, 9, 9, 9, 9, 9]);
        reference(&mut link, 0, 1200);
        pass(&mut link, 5_000);
        link.port.pending = true;
        while link
            .timer
            .window
            .is_some_and(|at| at.wrapping_sub(BEGIN) < 1 << 31)
            && link.counters().occupied == 0
        {
            link.timer.now = link.timer.window.take().unwrap_or(0);
            link.service();
        }
        assert_eq!(link.counters().occupied, 1);
        link.port.pending = false;
        pass(&mut link, 50_000);
        assert_eq!(link.node().counters().aborted, 1);
        assert!(link.port.loaded.is_empty());
    }

    #[test]
    fn when_references_cease_the_node_leaves_the_bus_and_comes_back() {
        let mut link = synchronised();
        reference(&mut link, 1, 1200);
        assert!(link.is_heard());
        pass(&mut link, 1_000_000);
        assert!(!link.is_heard() && link.port.away);
        // The software sequence starts only after the pause, and does not end before bus-off
        // does.
        link.keep_present();
        pass(&mut link, 300_000);
        link.port.errors.bus_off = true;
        link.keep_present();
        assert!(!link.port.away);
        link.keep_present();
        assert_eq!(link.counters().rejoins, 0);
        link.port.errors.bus_off = false;
        link.keep_present();
        assert_eq!(link.counters().rejoins, 1);
        pass(&mut link, 0);
        for cycle in 0..3 {
            reference(&mut link, 1, 2000 + 100 * cycle);
            pass(&mut link, 100_000);
        }
        assert!(link.is_heard());
    }

    /// The references of a crystal, every `cycle` of the node's own microseconds.
    fn hear(link: &mut TestLink, cycle: u32, time: u32) -> Option<i8> {
        let mut trim = None;
        for _ in 0..10 {
            pass(link, cycle / 10);
            trim = trim.or(link.keep_present());
        }
        reference(link, 1, time);
        trim
    }

    #[test]
    fn a_node_on_its_own_oscillator_listens_until_it_is_trimmed() {
        let mut link = on(Oscillator::Internal);
        link.start();
        pass(&mut link, 200_000);
        assert_eq!(link.silence(), Some(Silence::NoReference));
        // 2 % fast: four steps too many.
        let trims: Vec<_> = (0..3)
            .map(|k| hear(&mut link, 102_000, 1000 + 100 * k))
            .collect();
        assert_eq!(trims, [None, None, Some(-4)]);
        assert!(link.port.loaded.is_empty() && !link.is_heard());
        for k in 4..12 {
            hear(&mut link, 100_100, 1000 + 100 * k);
            link.put(STEERING_POT, [1; 8]);
        }
        assert_eq!((link.silence(), link.trim()), (None, Some(-4)));
        assert!(link.is_heard() && !link.port.silent);
        assert!(!link.port.loaded.is_empty());
    }

    #[test]
    fn an_rc_oscillator_knows_true_time_by_the_references_of_a_crystal() {
        assert_eq!(on(Oscillator::External).true_rate(), Some(0));
        let mut link = on(Oscillator::Internal);
        link.start();
        for k in 0..4 {
            // 0.1 % fast: it needs no trim.
            hear(&mut link, 100_100, 1000 + 100 * k);
            assert_eq!(link.true_rate(), None, "{k}");
        }
        for k in 4..8 {
            hear(&mut link, 100_100, 1000 + 100 * k);
        }
        let ppm = link.true_rate().expect("it is measured") / 4295;
        assert!((-1050..-950).contains(&ppm), "{ppm}");
        // The master's oscillator is no better.
        pass(&mut link, 100_100);
        reference(&mut link, INTERNAL_CLOCK, 1800);
        assert!(link.is_alive());
        assert_eq!(link.true_rate(), None);
        hear(&mut link, 100_100, 1900);
        assert!(link.true_rate().is_some());
        pass(&mut link, 300_000);
        assert!(!link.is_alive());
        assert_eq!(link.true_rate(), None);
    }

    #[test]
    fn a_node_whose_own_oscillator_drifts_too_far_leaves_the_bus_and_listens() {
        let mut link = on(Oscillator::Internal);
        link.start();
        for k in 0..8 {
            hear(&mut link, 100_000, 1000 + 100 * k);
        }
        assert!(link.is_heard());
        for k in 8..70 {
            // 0.03 % more in every cycle.
            hear(&mut link, 100_000 + 30 * (k - 8), 1000 + 100 * k);
            if link.silence().is_some() {
                break;
            }
        }
        assert_eq!(link.silence(), Some(Silence::Away));
        for _ in 0..50 {
            pass(&mut link, 10_000);
            link.keep_present();
        }
        assert!(link.port.silent && !link.is_heard());
    }

    #[test]
    fn bus_off_is_told_to_the_stack_once() {
        let mut link = synchronised();
        link.port.errors.bus_off = true;
        link.on_error();
        pass(&mut link, 0);
        link.on_error();
        assert_eq!(link.counters().bus_off, 1);
        assert!(link.port.away && !link.is_heard());
    }
}

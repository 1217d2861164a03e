//! Vehicles whose nodes send at once: releases, messages and response times, which depend on each
//! other.
//!
//! Without a schedule nothing has an instant of the cycle. A message is put by a task, which is
//! released by a timer or by another message. So lateness is inherited along a chain: a message is
//! put as late as its task may end, its frame ends as late as the bus lets it, and both make the
//! releases of the receiver's tasks late.
//!
//! | what | period | jitter |
//! | --- | --- | --- |
//! | a message | that of the task that `sends` it | of the task's releases, and its response time |
//! | a task that `receives` it | that of the message | response time of the message, less its shortest frame |
//! | an event message | its least interval | none |
//!
//! [`solve`] begins without jitter, and bounds tasks ([`crate::response`]) and messages
//! ([`crate::queued`]) in turn until nothing changes. No bound ever falls on the way, so the end is
//! the least solution, and it holds (Tindell and Clark 1994, "Holistic schedulability analysis").
//!
//! Messages that follow from the sample of one timer meet in known ways only ([`queued::Meeting`]): each
//! is out before the next sample, or the answer is that a deadline is missed.
//!
//! Bus interrupts are released so:
//!
//! - `frame-received`: by the end of every frame that the node receives by the network file. The FIFO
//!   overruns after three more of them, so that is the deadline.
//! - `frame-sent`: by the end of every own frame; by every frame of others, to which an attempt may
//!   be lost; and, with more messages than mailboxes, once more for every own message, whose put may
//!   withdraw another one. How late it is counts for the messages, in whose time the mailbox is
//!   loaded.
//! - `window-edge`: once in each basic cycle, for the supervision.
//!
//! Each disturbed frame ends one more attempt of each node at most. If only its last bit was disturbed, its
//! receivers have taken it, and take it again when it is repeated: their tasks run once more, and put what
//! follows from it once more ([`Stream::follows`]).

use network_model::{Message, Network, SendType, WindowKind, worst_case_bits};

use crate::arrivals::{Arrivals, Spaced, Sporadic};
use crate::can::{self, ARBITRATION_BITS, ErrorRate, SHORTEST_BITS};
use crate::execution::Execution;
use crate::foreign::{Foreign, SENDER};
use crate::model::{ModelError, ModelFault, NodeModel, TaskFault};
use crate::node::{Observed, schedule};
use crate::queued::{self, Bounds, Meeting, Stream};
use crate::results::{MessageReport, NodeReport, Tolerance};
use crate::table::{BusEvent, By, NodeTable, TaskTable};
use crate::units::{MICROSECOND, Picoseconds};
use std::collections::{BTreeMap, BTreeSet};

/// Shortest time from an error to the next frame, in bits: error flag, delimiter, interframe space.
const ERROR_BITS: u64 = 17;
/// Rounds after which the search for a solution ends without one.
const MAX_ROUNDS: usize = 200;
/// Attempts that fail by an error after which a node rests until its next supervision (`firmware`'s
/// `event::ATTEMPTS`).
pub const ATTEMPTS: u64 = 3;
/// Stands for an interval of errors of which there is one burst only: an hour, in nanoseconds.
const ONE_BURST: u64 = 3_600_000_000_000;
/// Mailboxes of a controller (bxCAN).
const MAILBOXES: usize = 3;
/// Periods after which no frame is sent any more: a node drops it at the first supervision when two are
/// over.
const DROPPED_AFTER: u64 = 3;
/// Picoseconds in a nanosecond.
const NANOSECOND: Picoseconds = 1000;

/// A message as it is known so far.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Known {
    name: String,
    id: u16,
    sender: String,
    /// The nodes that receive it.
    receivers: Vec<String>,
    /// Longest and shortest frame with the interframe space.
    longest: Picoseconds,
    shortest: Picoseconds,
    /// Least time between two nominal instants.
    period: Picoseconds,
    /// How late after its nominal instant it may be put; `None` without a bound.
    put: Option<Picoseconds>,
    bounds: Option<Bounds>,
    /// It is sent in place of another message of its node.
    in_place_of_another: bool,
    /// It turned out to have no bound.
    unbounded: bool,
}

impl Known {
    /// The ends of its frames.
    fn ends(&self) -> Sporadic {
        Sporadic::late(self.period, self.lateness(), self.shortest)
    }

    /// How much later than its nominal instant a frame may end, than the shortest one could. A frame without
    /// a bound may wait until its node drops it.
    fn lateness(&self) -> Picoseconds {
        if self.unbounded {
            return DROPPED_AFTER * self.period;
        }
        let latest = self.bounds.map_or(0, |bounds| bounds.response * NANOSECOND);
        latest.saturating_sub(self.shortest)
    }
}

/// The messages of an event-triggered bus, as they are known so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Traffic {
    /// In the order of their identifiers.
    messages: Vec<Known>,
    bit: Picoseconds,
    basic_cycle: Picoseconds,
    errors: ErrorRate,
}

impl Traffic {
    /// The messages of a network, without jitter, and those of foreign nodes. A reference message is not
    /// sent.
    #[must_use]
    pub fn new(network: &Network, errors: ErrorRate, foreign: &[Foreign]) -> Self {
        let bit = u64::from(network.bit_time_ns()) * NANOSECOND;
        let nodes = network.nodes.iter().map(|node| &node.name);
        let known = |message: &Message| Known {
            name: message.name.clone(),
            id: message.id,
            sender: message.sender.clone(),
            receivers: nodes
                .clone()
                .filter(|node| message.is_for(node))
                .cloned()
                .collect(),
            longest: u64::from(worst_case_bits(message.length)) * bit,
            shortest: (SHORTEST_BITS + 8 * u64::from(message.shortest)) * bit,
            period: u64::from(
                match message.send_type {
                    SendType::Event { interval_ms } => interval_ms,
                    SendType::Cyclic { period_ms } => period_ms,
                }
                .max(1),
            ) * 1000
                * MICROSECOND,
            put: Some(0),
            bounds: None,
            in_place_of_another: message.instead_of.is_some(),
            unbounded: false,
        };
        let sent = |message: &&Message| message.window.kind != WindowKind::Reference;
        let mut messages: Vec<Known> = network.messages.iter().filter(sent).map(known).collect();
        messages.extend(foreign.iter().map(|one| Known {
            name: one.name(),
            id: one.id,
            sender: SENDER.into(),
            // The nodes' filters refuse it.
            receivers: Vec::new(),
            longest: u64::from(worst_case_bits(one.length)) * bit,
            shortest: (SHORTEST_BITS + 8 * u64::from(one.length)) * bit,
            period: u64::from(one.period_us) * MICROSECOND,
            put: Some(u64::from(one.jitter_us) * MICROSECOND),
            bounds: None,
            in_place_of_another: false,
            unbounded: false,
        }));
        messages.sort_by_key(|message| message.id);
        Self {
            messages,
            bit,
            basic_cycle: u64::from(network.basic_cycle_us) * MICROSECOND,
            errors,
        }
    }

    fn of<'a>(&'a self, node: &'a str, own: bool) -> impl Iterator<Item = &'a Known> {
        let messages = self.messages.iter();
        messages.filter(move |message| message.sender.eq_ignore_ascii_case(node) == own)
    }

    /// The messages that a node receives. The filter of its controller keeps the others from it.
    fn received_by<'a>(&'a self, node: &'a str) -> impl Iterator<Item = &'a Known> {
        let messages = self.messages.iter();
        messages.filter(move |message| {
            let mut receivers = message.receivers.iter();
            receivers.any(|receiver| receiver.eq_ignore_ascii_case(node))
        })
    }

    /// Least time between the ends of two frames of these messages.
    fn spacing<'a>(&self, messages: impl Iterator<Item = &'a Known>) -> Picoseconds {
        let shortest = messages.map(|message| message.shortest).min();
        shortest.unwrap_or(SHORTEST_BITS * self.bit)
    }

    /// A release for each error, up to `late` after it.
    fn by_errors(&self, late: Picoseconds) -> impl Iterator<Item = Sporadic> + use<> {
        let interval = match self.errors.interval {
            0 => ONE_BURST,
            interval => interval,
        };
        let stream = Sporadic {
            jitter: late,
            ..Sporadic::every(interval * NANOSECOND)
        };
        (0..self.errors.burst).map(move |_| stream)
    }

    /// The frames of these messages that their receivers take once more because of an error.
    fn taken_again<'a>(&self, messages: impl Iterator<Item = &'a Known>) -> Vec<Sporadic> {
        let late = messages.map(Known::lateness).max().unwrap_or(0);
        self.by_errors(late).collect()
    }

    /// When the jobs of a task may be released.
    ///
    /// # Errors
    /// `receives` names a message that no other node sends.
    pub fn arrivals(&self, node: &str, entry: &TaskTable) -> Result<Arrivals, TaskFault> {
        let mut sporadic = entry.sporadic().ok_or(TaskFault::Unresolved)?;
        let mut spaced = Vec::new();
        for event in entry.on.as_slice() {
            match event {
                BusEvent::FrameReceived => spaced.push(Spaced {
                    streams: self
                        .received_by(node)
                        .map(Known::ends)
                        .chain(self.taken_again(self.received_by(node)))
                        .collect(),
                    apart: self.spacing(self.received_by(node)),
                    burst: 0,
                }),
                BusEvent::FrameSent => {
                    // Each frame on the bus ends one attempt of this node at most, and not before
                    // its first bits: of any three ends, the first and the last are a frame apart.
                    let shortest = self.messages.iter().map(|message| message.shortest).min();
                    spaced.push(Spaced {
                        streams: self.messages.iter().map(Known::ends).collect(),
                        apart: shortest.unwrap_or(SHORTEST_BITS * self.bit),
                        burst: 1,
                    });
                    // An error ends one more attempt.
                    spaced.push(Spaced {
                        streams: self.by_errors(0).collect(),
                        apart: ERROR_BITS * self.bit,
                        burst: 0,
                    });
                    // A put withdraws one frame at most, and none while there is a free mailbox.
                    if self.on_their_way(node) > MAILBOXES {
                        sporadic.extend(self.of(node, true).map(|message| Sporadic {
                            jitter: message.put.unwrap_or(0),
                            ..Sporadic::every(message.period)
                        }));
                    }
                }
                BusEvent::WindowEdge => sporadic.push(Sporadic::every(self.basic_cycle)),
                BusEvent::EventQueued => {}
            }
        }
        for name in entry.receives.as_slice() {
            let mut messages = self.received_by(node);
            let message = messages.find(|message| message.name == *name);
            let message = message.ok_or_else(|| TaskFault::NotReceived(name.clone()))?;
            sporadic.push(message.ends());
        }
        let receives = |message: &&Known| entry.receives.as_slice().contains(&message.name);
        let received = || self.received_by(node).filter(receives);
        if received().next().is_some() {
            spaced.push(Spaced {
                streams: self.taken_again(received()),
                apart: self.spacing(received()),
                burst: 0,
            });
        }
        spaced.retain(|group| !group.streams.is_empty());
        Ok(Arrivals {
            sporadic,
            spaced,
            timed: Vec::new(),
            apart: entry.apart(),
        })
    }

    /// The deadline of a task.
    ///
    /// # Errors
    /// It has none, or one by a window.
    pub fn deadline(&self, node: &str, entry: &TaskTable) -> Result<Picoseconds, TaskFault> {
        let sends = entry.on.as_slice().contains(&BusEvent::FrameSent);
        match (&entry.by, entry.deadline_us) {
            // A late one costs its messages time: see `reload_in_time`.
            (Some(By::WindowEnd), _) if sends => Ok(self.basic_cycle),
            (Some(By::WindowEnd), _) => Ok(3 * self.spacing(self.received_by(node))),
            (Some(By::Window), _) => Ok(self.basic_cycle),
            (None, Some(us)) => Ok(us * MICROSECOND),
            (Some(By::Message(message)), _) => Err(TaskFault::NotSent(message.clone())),
            (None, None) => Err(TaskFault::NoDeadline),
        }
    }

    /// Takes over when each message is put, from the response times of the tasks that send it.
    fn put(&mut self, senders: &Senders, nodes: &[NodeReport], models: &[NodeModel]) {
        for (message, sender) in self.messages.iter_mut().zip(&senders.tasks) {
            let Some(Sender { node, task }) = *sender else {
                continue;
            };
            let Some(model) = models[node].tasks.get(task) else {
                continue;
            };
            let mut reports = nodes[node].tasks.iter();
            let report = reports.find(|report| report.name == model.name);
            let response =
                report.and_then(|report| report.response.filter(|_| report.is_bounded()));
            if let [stream] = model.arrivals.sporadic.as_slice() {
                message.period = stream.period;
                message.put = response.map(|response| stream.jitter + response);
            }
        }
    }

    /// Shortest time from a lost arbitration to the end of the winner.
    fn reload_in_time(&self, node: &str) -> Picoseconds {
        self.spacing(self.of(node, false))
            .saturating_sub(ARBITRATION_BITS * self.bit)
    }

    /// How many of a node's messages may be on their way at once.
    fn on_their_way(&self, node: &str) -> usize {
        self.of(node, true)
            .filter(|message| !message.in_place_of_another)
            .count()
    }

    /// The messages as streams, up to the first one whose put has no bound. `load` is the time of each
    /// node to load its mailbox again.
    fn streams(
        &self,
        nodes: &[&str],
        load: &[Option<Picoseconds>],
        senders: &Senders,
    ) -> Vec<Stream> {
        let up = |time: Picoseconds| time.div_ceil(NANOSECOND);
        let mut streams = Vec::new();
        for (at, message) in self.messages.iter().enumerate() {
            let mut names = nodes.iter();
            let node = names.position(|node| message.sender.eq_ignore_ascii_case(node));
            // A program on the bus may take any time between its frames.
            let load = node.map_or(Some(0), |node| load[node]);
            let (Some(put), Some(load)) = (message.put, load) else {
                break;
            };
            streams.push(Stream {
                node: node.unwrap_or(usize::MAX),
                length: up(message.longest),
                period: message.period / NANOSECOND,
                jitter: up(put),
                load: match self.on_their_way(&message.sender) {
                    0..=MAILBOXES => 0,
                    _ => up(load),
                },
                reload: if load <= self.reload_in_time(&message.sender) {
                    0
                } else {
                    up(load)
                },
                repeat: if load <= ERROR_BITS * self.bit {
                    0
                } else {
                    up(load)
                },
                follows: senders.follows.get(at).cloned().unwrap_or_default(),
                rest: Some((ATTEMPTS, up(self.basic_cycle))),
            });
        }
        streams
    }

    /// Bounds of the streams at this rate of disturbed frames.
    fn bounds(
        &self,
        streams: &[Stream],
        senders: &Senders,
        errors: ErrorRate,
    ) -> Vec<Option<Bounds>> {
        let bit = self.bit.div_ceil(NANOSECOND);
        queued::bounds(streams, bit, errors, |one, other| {
            senders.meeting(one, other)
        })
    }

    /// Bounds all messages anew.
    fn bound(&mut self, streams: &[Stream], senders: &Senders) {
        let all = streams.len() == self.messages.len();
        let bounds = self.bounds(streams, senders, self.errors);
        for (at, message) in self.messages.iter_mut().enumerate() {
            message.bounds = bounds.get(at).copied().flatten().filter(|_| all);
            message.unbounded = message.bounds.is_none();
        }
    }

    /// Longest time from the put to the end of a frame, and the time until the next frame of the message
    /// may be put, at its nominal instant.
    fn need_and_room(message: &Known, bounds: Bounds) -> (Picoseconds, Picoseconds) {
        let put = message.put.unwrap_or(0);
        let late = (bounds.response * NANOSECOND).saturating_sub(put);
        let need = late.max(bounds.delay * NANOSECOND);
        (need, message.period.saturating_sub(put))
    }

    /// The largest burst of disturbed frames with which each message meets its deadline. The tasks are as
    /// late as at the stated rate.
    fn tolerances(&self, streams: &[Stream], senders: &Senders) -> Vec<Tolerance> {
        let all = streams.len() == self.messages.len();
        let of_burst = |burst: u64| {
            let found = self.bounds(streams, senders, self.errors.with_burst(burst));
            let each = self.messages.iter().enumerate();
            let meets = each.map(move |(at, message)| {
                let bounds = found.get(at).copied().flatten().filter(|_| all);
                bounds.is_some_and(|bounds| {
                    let (need, room) = Self::need_and_room(message, bounds);
                    need <= room
                })
            });
            meets.collect()
        };
        can::tolerances(self.messages.len(), of_burst)
    }

    /// The answers for the vehicle's messages.
    fn reports(&self, tolerances: &[Tolerance]) -> Vec<MessageReport> {
        let report = |(message, tolerance): (&Known, &Tolerance)| {
            let put = message.put.unwrap_or(0);
            let bounds = message.bounds.filter(|_| message.put.is_some());
            MessageReport {
                name: message.name.clone(),
                id: message.id,
                need: bounds.map(|bounds| Self::need_and_room(message, bounds).0),
                room: message.period.saturating_sub(put),
                start: None,
                arbitrating: true,
                tolerance: *tolerance,
            }
        };
        let own = self.messages.iter().zip(tolerances);
        own.filter(|(message, _)| message.sender != SENDER)
            .map(report)
            .collect()
    }
}

/// The task of a message: indices of its node and of the task in the node's model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sender {
    node: usize,
    task: usize,
}

/// The tasks that put the messages, in their order; `None` for event messages and for messages of
/// nodes that are not analysed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Senders {
    tasks: Vec<Option<Sender>>,
    /// How a frame of the second message may delay one of the first.
    meetings: Vec<Vec<Meeting>>,
    /// For each message those that have ended before it is put, of the same sample.
    follows: Vec<Vec<usize>>,
}

impl Senders {
    /// Finds the task of each message. `file` names the task table in error messages.
    ///
    /// # Errors
    /// A cyclic message has no task or two, a task has a message of another node, or one with
    /// messages has several streams of releases.
    pub fn find(
        network: &Network,
        traffic: &Traffic,
        nodes: &[(NodeModel, NodeTable)],
        file: &str,
    ) -> Result<Self, ModelError> {
        let mut senders = vec![None; traffic.messages.len()];
        for (at, (model, table)) in nodes.iter().enumerate() {
            let wrong = |fault: ModelFault| ModelError {
                file: file.to_owned(),
                node: model.name.clone(),
                fault,
            };
            for (index, task) in model.tasks.iter().enumerate() {
                let entry = table.task.get(&task.name);
                let sends = entry.map_or(&[][..], |entry| entry.sends.as_slice());
                let of_task = |fault: TaskFault| {
                    wrong(ModelFault::Task {
                        task: task.name.clone(),
                        fault,
                    })
                };
                for name in sends {
                    let own = |known: &Known| {
                        known.name == *name && known.sender.eq_ignore_ascii_case(&model.name)
                    };
                    let place = traffic.messages.iter().position(own);
                    let place = place.ok_or_else(|| of_task(TaskFault::NotSent(name.clone())))?;
                    if senders[place].is_some() {
                        return Err(of_task(TaskFault::SentTwice(name.clone())));
                    }
                    if task.arrivals.sporadic.len() != 1 {
                        return Err(of_task(TaskFault::SeveralStreams));
                    }
                    senders[place] = Some(Sender {
                        node: at,
                        task: index,
                    });
                }
            }
            let mut cyclic = network.messages.iter().filter(|message| {
                matches!(message.send_type, SendType::Cyclic { .. })
                    && message.window.kind != WindowKind::Reference
                    && message.sender.eq_ignore_ascii_case(&model.name)
            });
            let unsent = cyclic.find(|message| {
                let mut known = traffic.messages.iter().zip(&senders);
                known.any(|(known, sender)| known.name == message.name && sender.is_none())
            });
            if let Some(unsent) = unsent {
                return Err(wrong(ModelFault::Unsent(unsent.name.clone())));
            }
        }
        let order = Order::new(traffic, &senders, nodes);
        Ok(Self {
            tasks: senders,
            meetings: order.meetings(),
            follows: order.ended.iter().map(of_set).collect(),
        })
    }

    fn meeting(&self, one: usize, other: usize) -> Meeting {
        let of_one = self.meetings.get(one);
        let meeting = of_one.and_then(|of_one| of_one.get(other));
        meeting.copied().unwrap_or(Meeting::Any)
    }
}

fn of_set(set: &BTreeSet<usize>) -> Vec<usize> {
    set.iter().copied().collect()
}

/// Which messages follow from the same sample, and in which order.
///
/// A task that `receives` a message is released by its end, and a task puts its messages in the order
/// in which its `sends` names them. So if M releases the task that puts N, then M has ended before N
/// is put, and so has each message that the job of M put before it under a more urgent identifier.
struct Order {
    /// The timer's task from which each message follows.
    origin: Vec<Option<Sender>>,
    /// The messages that have ended before each message is put.
    ended: Vec<BTreeSet<usize>>,
    /// Task of each message and its place among those that the task sends.
    place: Vec<Option<(Sender, usize)>>,
}

impl Order {
    fn new(
        traffic: &Traffic,
        senders: &[Option<Sender>],
        nodes: &[(NodeModel, NodeTable)],
    ) -> Self {
        let entry = |sender: Sender| {
            let (model, table) = &nodes[sender.node];
            table.task.get(&model.tasks[sender.task].name)
        };
        let named = |name: &String| {
            let mut messages = traffic.messages.iter();
            messages.position(|message| message.name == *name)
        };
        let mut order = Self {
            origin: Vec::new(),
            ended: Vec::new(),
            place: Vec::new(),
        };
        // The message whose end releases the task that puts each message.
        let mut released_by = Vec::new();
        for (message, sender) in traffic.messages.iter().zip(senders) {
            let entry = sender.and_then(entry);
            let received = entry.and_then(|entry| entry.receives.as_slice().first());
            released_by.push(received.and_then(named));
            order.place.push(sender.and_then(|sender| {
                let mut sends = entry?.sends.as_slice().iter();
                Some((sender, sends.position(|name| *name == message.name)?))
            }));
        }
        for at in 0..senders.len() {
            let mut ended = BTreeSet::new();
            let mut first = at;
            // Each step goes to another message; a circle has no origin.
            while let Some(before) = released_by[first].filter(|before| ended.insert(*before)) {
                let earlier = (0..before).filter(|&urgent| order.puts_before(urgent, before));
                ended.extend(earlier);
                first = before;
            }
            let circle = released_by[first].is_some();
            order.origin.push(senders[first].filter(|_| !circle));
            order.ended.push(ended);
        }
        order
    }

    /// Whether one job puts both, the first message first.
    fn puts_before(&self, one: usize, other: usize) -> bool {
        match (self.place[one], self.place[other]) {
            (Some((task, first)), Some((other, second))) => task == other && first < second,
            _ => false,
        }
    }

    fn meeting(&self, one: usize, other: usize) -> Meeting {
        if self.origin[one].is_none() || self.origin[one] != self.origin[other] {
            return Meeting::Any;
        }
        let apart = self.ended[one].contains(&other) || self.ended[other].contains(&one);
        // A less urgent frame that is put behind this one does not delay it.
        if apart || (one < other && self.puts_before(one, other)) {
            Meeting::Never
        } else {
            Meeting::Once
        }
    }

    fn meetings(&self) -> Vec<Vec<Meeting>> {
        let all = 0..self.origin.len();
        let of = |one: usize| all.clone().map(|other| self.meeting(one, other)).collect();
        all.clone().map(of).collect()
    }
}

/// Response times of all tasks and messages of a vehicle whose nodes send at once.
///
/// # Errors
/// The task table and the network file do not fit together.
pub fn solve(
    (network, errors): (&Network, ErrorRate),
    foreign: &[Foreign],
    file: &str,
    nodes: &[(NodeModel, NodeTable)],
    executions: &[Execution],
    observed: &BTreeMap<String, Observed>,
) -> Result<(Vec<NodeReport>, Vec<MessageReport>), ModelError> {
    let mut traffic = Traffic::new(network, errors, foreign);
    let senders = Senders::find(network, &traffic, nodes, file)?;
    let names: Vec<&str> = nodes.iter().map(|(model, _)| model.name.as_str()).collect();
    let mut models: Vec<NodeModel> = nodes.iter().map(|(model, _)| model.clone()).collect();
    let mut reports = Vec::new();
    for _ in 0..MAX_ROUNDS {
        for (model, (_, table)) in models.iter_mut().zip(nodes) {
            model.take_arrivals(table, &traffic, file)?;
        }
        let all = models.iter().zip(nodes).zip(executions);
        reports = all
            .map(|((model, (_, table)), execution)| {
                schedule(model, table, execution, observed.get(&model.name))
            })
            .collect();
        let before = traffic.clone();
        let load: Vec<_> = reports
            .iter()
            .zip(nodes)
            .map(|(r, n)| load(r, &n.1))
            .collect();
        traffic.put(&senders, &reports, &models);
        let streams = traffic.streams(&names, &load, &senders);
        traffic.bound(&streams, &senders);
        if traffic == before {
            let tolerances = traffic.tolerances(&streams, &senders);
            return Ok((reports, traffic.reports(&tolerances)));
        }
    }
    // No solution: what is late by its own lateness has no bound.
    for message in &mut traffic.messages {
        message.bounds = None;
        message.unbounded = true;
    }
    let none = vec![Tolerance::Repeated(None); traffic.messages.len()];
    Ok((reports, traffic.reports(&none)))
}

/// The time of a node to load its mailbox when an attempt has ended: the response time of the task
/// that handles `frame-sent`. A node without such a task sends nothing.
fn load(report: &NodeReport, table: &NodeTable) -> Option<Picoseconds> {
    let sent = |name: &String| {
        let entry = table.task.get(name);
        entry.is_some_and(|entry| entry.on.as_slice().contains(&BusEvent::FrameSent))
    };
    let mut tasks = report.tasks.iter();
    match tasks.find(|task| sent(&task.name)) {
        None => Some(0),
        Some(task) => task.response.filter(|_| task.is_bounded()),
    }
}

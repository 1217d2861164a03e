//! Whether every message fits in its window.
//!
//! In an exclusive window nothing is sent again (ISO 11898-4), so a disturbed frame is lost. If the error frame
//! reaches into the next window, the frame there begins later within its transmit enable window, or is lost,
//! too. In an arbitrating window a node tries again as long as its frame can end in the window.

use std::collections::{BTreeMap, BTreeSet};

use network_model::{Message, Network, SendType, Window, WindowKind, worst_case_bits};

use crate::arbitrating::{Competition, Frame, Reaction};
use crate::can::{self, ERROR_FRAME_BITS, ErrorRate, INTERFRAME_BITS, SHORTEST_BITS};
use crate::results::{InWindows, MessageReport, NodeReport, TaskReport, Tolerance};
use crate::table::{BusEvent, NodeTable};
use crate::units::{MICROSECOND, Picoseconds};

/// Picoseconds in a nanosecond.
const NANOSECOND: Picoseconds = 1000;

/// How fast each node reacts in an arbitrating window, by its name; `None` without a bound. A node that is not
/// among them reacts at once.
pub type Reactions = BTreeMap<String, Option<Reaction>>;

/// The reaction of a node with these response times; `None` if one of its tasks has no bound. A task that
/// has no jobs in arbitrating windows takes no time there.
///
/// Behind an attempt, the interrupt of the controller runs, and makes that of the timer pending, which requests
/// the next frame. If both have the same priority, jobs of that priority or above run from the first release
/// to the end of the second job. The timer's job would end then even if it had been released with the first
/// one, which its releases allow, too. So its response time bounds the whole.
#[must_use]
pub fn reaction(report: &NodeReport, table: &NodeTable) -> Option<Reaction> {
    let on = |event: BusEvent| -> Option<(InWindows, BTreeSet<u32>)> {
        let is_on = |task: &&TaskReport| {
            let entry = table.task.get(&task.name);
            entry.is_some_and(|entry| entry.on.as_slice().contains(&event))
        };
        let mut worst = InWindows::default();
        let mut priorities = BTreeSet::new();
        for task in report.tasks.iter().filter(is_on) {
            task.response.filter(|_| task.is_bounded())?;
            let of_task = task.in_windows.unwrap_or_default();
            worst.opening = worst.opening.max(of_task.opening);
            worst.any = worst.any.max(of_task.any);
            priorities.insert(task.priority);
        }
        Some((worst, priorities))
    };
    let (timer, of_timer) = on(BusEvent::WindowEdge)?;
    let (sent, of_sent) = on(BusEvent::FrameSent)?;
    let together = of_timer.union(&of_sent).count() <= 1;
    let before = if together { 0 } else { sent.any };
    Some(Reaction {
        first: timer.opening.div_ceil(NANOSECOND),
        next: (before + timer.any).div_ceil(NANOSECOND),
    })
}

/// The answers for all messages, in the order of their windows.
///
/// The window of a reference message and an exclusive window must hold one frame
/// ([`Network::needed_us`]). Messages that share an arbitrating window in the same basic cycles
/// delay each other, with disturbed frames ([`crate::arbitrating`]). `supervised` are the messages after
/// which their receivers stop if [`network_model::MISSED_PERIODS`] in a row are lost.
#[must_use]
pub fn messages(
    network: &Network,
    errors: ErrorRate,
    supervised: &BTreeSet<String>,
    reactions: &Reactions,
) -> Vec<MessageReport> {
    let bit = u64::from(network.bit_time_ns());
    let events = Events::new(network, reactions);
    let mut reports: Vec<MessageReport> = network
        .messages
        .iter()
        .map(|m| {
            let needed = Some(u64::from(network.needed_us(m)) * MICROSECOND);
            let (need, tolerance) = match m.window.kind {
                WindowKind::Arbitrating => (events.need(m, errors), events.tolerance(m, errors)),
                WindowKind::Exclusive => (needed, lost(network, m, supervised)),
                WindowKind::Reference => (needed, Tolerance::Reference(repeated(m, bit))),
            };
            MessageReport {
                name: m.name.clone(),
                id: m.id,
                need,
                room: window(m),
                start: Some(u64::from(m.window.start_us) * MICROSECOND),
                arbitrating: m.window.kind == WindowKind::Arbitrating,
                tolerance,
            }
        })
        .collect();
    reports.sort_by_key(|m| (m.start, m.id));
    reports
}

/// The identifiers of the messages in arbitrating windows that wait for frames of one of these nodes, or are its
/// own: what they need depends on how fast that node reacts.
#[must_use]
pub fn waiting_for(network: &Network, nodes: &[&str]) -> BTreeSet<u16> {
    let reactions = Reactions::new();
    let events = Events::new(network, &reactions);
    let is_of = |message: &&Message| {
        let mut nodes = nodes.iter();
        nodes.any(|node| node.eq_ignore_ascii_case(&message.sender))
    };
    let waits = |message: &&&Message| events.competing(message).iter().any(is_of);
    let waiting = events.messages.iter().filter(waits);
    waiting.map(|message| message.id).collect()
}

/// The messages of the arbitrating windows.
struct Events<'a> {
    network: &'a Network,
    reactions: &'a Reactions,
    /// In the order of their identifiers.
    messages: Vec<&'a Message>,
}

impl<'a> Events<'a> {
    fn new(network: &'a Network, reactions: &'a Reactions) -> Self {
        let all = network.messages.iter();
        let mut messages: Vec<&Message> = all
            .filter(|m| m.window.kind == WindowKind::Arbitrating)
            .collect();
        messages.sort_by_key(|m| m.id);
        Self {
            network,
            reactions,
            messages,
        }
    }

    /// The messages that compete with `message`, which is one of them, in the order of their identifiers. Of
    /// two of which one is sent in place of the other, there is one: `message` itself, else the more urgent.
    fn competing(&self, message: &Message) -> Vec<&'a Message> {
        let mut competing: Vec<&Message> = Vec::new();
        for &other in &self.messages {
            let replaces = |known: &&Message| in_place(known, other);
            if !meet(other.window, message.window)
                || (other.id != message.id && in_place(other, message))
                || competing.iter().any(replaces)
            {
                continue;
            }
            competing.push(other);
        }
        competing
    }

    /// Longest and shortest frame of a message and of those that are sent in its place, in bits.
    fn lengths(&self, message: &Message) -> (u64, u64) {
        let all = self.messages.iter();
        let alike = all.filter(|other| other.id == message.id || in_place(other, message));
        let bits = |other: &&Message| {
            let longest = u64::from(worst_case_bits(other.length));
            (longest, SHORTEST_BITS + 8 * u64::from(other.shortest))
        };
        alike
            .map(bits)
            .fold((0, u64::MAX), |(longest, shortest), (more, less)| {
                (longest.max(more), shortest.min(less))
            })
    }

    /// Longest time from the begin of the window until the message has been sent, if it waits then. The
    /// last frame must also end early enough for the clock of its node, which requests none that could end
    /// behind the window. `None` without a bound.
    fn need(&self, message: &Message, errors: ErrorRate) -> Option<Picoseconds> {
        let bit_time = u64::from(self.network.bit_time_ns());
        let competing = self.competing(message);
        let mut nodes: Vec<&str> = Vec::new();
        let mut reactions = Vec::new();
        let mut frames = Vec::new();
        for other in &competing {
            let known = nodes.iter().position(|node| *node == other.sender);
            let node = match known {
                Some(node) => node,
                None => {
                    nodes.push(&other.sender);
                    reactions.push(self.reaction(&other.sender)?);
                    nodes.len() - 1
                }
            };
            // A message that one is sent in place of has the same sender and the same interval.
            let (longest, shortest) = self.lengths(other);
            frames.push(Frame {
                node,
                length: longest * bit_time,
                shortest: shortest * bit_time,
                count: in_one_window(self.network, other),
            });
        }
        let at = competing.iter().position(|other| other.id == message.id)?;
        let competition = Competition {
            frames,
            reactions,
            bit_time,
        };
        let end = competition.response(at, errors)? * NANOSECOND;
        let clocks = 2 * u64::from(self.network.sync_uncertainty_us) * MICROSECOND;
        Some(end + INTERFRAME_BITS * bit_time * NANOSECOND + clocks)
    }

    fn reaction(&self, sender: &str) -> Option<Reaction> {
        let mut known = self.reactions.iter();
        let found = known.find(|(node, _)| node.eq_ignore_ascii_case(sender));
        found.map_or(Some(Reaction::default()), |(_, reaction)| *reaction)
    }

    fn tolerance(&self, message: &Message, errors: ErrorRate) -> Tolerance {
        let room = window(message);
        let meets = |burst| {
            let need = self.need(message, errors.with_burst(burst));
            vec![need.is_some_and(|need| need <= room)]
        };
        can::tolerances(1, meets).remove(0)
    }
}

/// The most frames of an event message that wait when one of its windows opens: those that its least
/// interval allows since the window before.
pub(crate) fn in_one_window(network: &Network, message: &Message) -> u64 {
    let interval = match message.send_type {
        SendType::Event { interval_ms } => interval_ms,
        SendType::Cyclic { period_ms } => period_ms,
    };
    let cycles = u64::from(message.window.repeat.max(1));
    let pause = cycles * u64::from(network.basic_cycle_us);
    pause.div_ceil(1000 * u64::from(interval.max(1))).max(1)
}

/// Whether one of the two messages is sent in place of the other.
fn in_place(one: &Message, other: &Message) -> bool {
    let replaces = |new: &Message, old: &Message| new.instead_of.as_ref() == Some(&old.name);
    one.sender == other.sender && (replaces(one, other) || replaces(other, one))
}

/// The length of a message's window.
fn window(message: &Message) -> Picoseconds {
    u64::from(message.window.length_us) * MICROSECOND
}

/// What a disturbed frame in an exclusive window means: the next frame comes in the next window of the
/// message.
fn lost(network: &Network, message: &Message, supervised: &BTreeSet<String>) -> Tolerance {
    let period = match message.send_type {
        SendType::Cyclic { period_ms } => period_ms,
        SendType::Event { .. } => network.basic_cycle_us.div_ceil(1000),
    };
    Tolerance::Lost {
        next: u64::from(period) * 1000 * MICROSECOND,
        acted_on: supervised
            .contains(&message.name)
            .then_some(u64::from(network_model::MISSED_PERIODS)),
    }
}

/// By how much a disturbed frame delays the repetition, without the time to load the mailbox.
fn repeated(message: &Message, bit: u64) -> Picoseconds {
    (ERROR_FRAME_BITS + u64::from(worst_case_bits(message.length))) * bit * 1000
}

/// Whether two arbitrating windows are open in the same basic cycles. Both repeats are powers of two
/// (ISO 11898-4), so the rarer one alone decides.
fn meet(one: Window, other: Window) -> bool {
    let often = one.repeat.min(other.repeat).max(1);
    one.offset % often == other.offset % often
}

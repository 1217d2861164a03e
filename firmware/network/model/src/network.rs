//! The network as plain data.

use crate::frame::{shortest_bits, worst_case_bits};
use crate::signal::Signal;

/// A checked network: its nodes, its messages and the time frame they live in.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Comment of the whole file.
    pub comment: String,
    /// Bit rate of the bus in bit/s.
    pub bit_rate: u32,
    /// Length of the basic cycle in microseconds.
    pub basic_cycle_us: u32,
    /// Number of basic cycles in the system matrix: a power of two, 1..=64.
    pub basic_cycles: u8,
    /// Part of each window kept for the nodes' clock error, in microseconds.
    pub sync_uncertainty_us: u32,
    /// How late after its window's start a frame may still begin, in bit times.
    pub transmit_enable_bits: u8,
    /// Nodes in file order.
    pub nodes: Vec<Node>,
    /// Messages in the order of their windows, then of their identifiers.
    pub messages: Vec<Message>,
    /// Named value tables in file order.
    pub value_tables: Vec<ValueTable>,
}

/// A node of the network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    /// Name as in the file.
    pub name: String,
    /// Comment, or empty.
    pub comment: String,
    /// Rank as time master, 0 first; `None` when it is never a master.
    pub master_rank: Option<u8>,
}

/// A message and its window.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Identifier, 11 bits.
    pub id: u16,
    /// Name as in the file.
    pub name: String,
    /// Comment, or empty.
    pub comment: String,
    /// Data bytes, 0..=8.
    pub length: u8,
    /// Fewest data bytes that still decode; the missing ones read as zero.
    pub shortest: u8,
    /// The one node that sends it.
    pub sender: String,
    /// When it is sent.
    pub send_type: SendType,
    /// In which basic cycles a cyclic message is sent.
    pub condition: Condition,
    /// Longest time from when it is due until its window ends, in microseconds; `None` if that
    /// is its period.
    pub deadline_us: Option<u32>,
    /// Where in the system matrix it is sent.
    pub window: Window,
    /// Further windows of an exclusive message, of the same length, when one
    /// repeat factor does not describe them all.
    pub further: Vec<Window>,
    /// Names of the messages that its sender needs first: wherever both come in the same
    /// basic cycle, their windows are over before this one's begins.
    pub after: Vec<String>,
    /// Whether its sender may send it in an arbitrating window, until its own next window, if it could
    /// not send it in its own: the frame was disturbed, or came too late (thesis 4.3.7).
    pub retry_late: bool,
    /// Name of the event message of the same sender in whose place it is sent: the two together
    /// come no more often than that one may.
    pub instead_of: Option<String>,
    /// Time in microseconds that its sender needs from the arrival of those messages
    /// ([`Network::release_us`]) until it can send this one.
    pub preparation_us: u32,
    /// Signals in file order.
    pub signals: Vec<Signal>,
    /// Line of the file on which it begins, from 1.
    pub line: Option<usize>,
}

/// When a message is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SendType {
    /// Every period, in milliseconds.
    Cyclic {
        /// Period in milliseconds.
        period_ms: u32,
    },
    /// When something happened.
    Event {
        /// Least time between two of them, in milliseconds.
        interval_ms: u32,
    },
}

/// In which basic cycles a cyclic message is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    /// In each that has its window.
    Always,
    /// In those whose reference message has its signal `Fixed` set.
    WhileFixed,
}

/// A window of the system matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Window {
    /// Start in the basic cycle, in microseconds.
    pub start_us: u32,
    /// Length in microseconds.
    pub length_us: u32,
    /// Every how many basic cycles it comes: a power of two.
    pub repeat: u8,
    /// First basic cycle it comes in, less than `repeat`.
    pub offset: u8,
    /// Who may send in it.
    pub kind: WindowKind,
}

impl Window {
    /// A window of no length at the beginning of every basic cycle.
    pub(crate) fn of_kind(kind: WindowKind) -> Self {
        Self {
            start_us: 0,
            length_us: 0,
            repeat: 1,
            offset: 0,
            kind,
        }
    }

    /// End in the basic cycle, in microseconds: the first instant after it.
    pub fn end_us(&self) -> u32 {
        self.start_us.saturating_add(self.length_us)
    }

    /// Whether both come in one same basic cycle and share an instant of it.
    pub fn overlaps(&self, other: &Window) -> bool {
        self.shares_cycle(other) && self.start_us < other.end_us() && other.start_us < self.end_us()
    }

    /// Whether both come in one same basic cycle.
    pub fn shares_cycle(&self, other: &Window) -> bool {
        let (few, many) = if self.repeat <= other.repeat {
            (self, other)
        } else {
            (other, self)
        };
        // Both repeat factors are powers of two, so the rarer one always meets
        // the same phase of the more frequent one.
        many.offset % few.repeat.max(1) == few.offset
    }
}

/// Who may send in a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum WindowKind {
    /// The time master's, for the reference message.
    Reference,
    /// One message's.
    Exclusive,
    /// Any event message's; the bus arbitrates.
    Arbitrating,
}

/// Behind the name of a message that is sent late.
const LATE: &str = " (late)";

/// A named set of values of a signal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ValueTable {
    /// Name as in the file.
    pub name: String,
    /// Values in ascending order.
    pub values: Vec<Value>,
}

/// A named value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Value {
    /// Raw value.
    pub raw: i64,
    /// Its name.
    pub name: String,
}

/// The receiver of a signal that names none.
pub(crate) const NOBODY: &str = "Vector__XXX";

impl Message {
    /// Whether this is the message of that name, in its own window or late.
    #[must_use]
    pub fn is_named(&self, name: &str) -> bool {
        self.name == name || self.name.strip_suffix(LATE) == Some(name)
    }

    /// All its windows, the first one first.
    pub fn windows(&self) -> impl Iterator<Item = Window> {
        std::iter::once(self.window).chain(self.further.iter().copied())
    }

    /// The bits of its data that belong to no signal, D0 least significant.
    #[must_use]
    pub fn free(&self) -> u64 {
        let mut data = [0; 8];
        data[..usize::from(self.length)].fill(0xFF);
        for signal in &self.signals {
            signal.insert(&mut data, 0);
        }
        u64::from_le_bytes(data)
    }

    /// Whether a node receives it: a signal of it names that node, or none at all.
    #[must_use]
    pub fn is_for(&self, node: &str) -> bool {
        let receivers = || self.signals.iter().flat_map(|signal| &signal.receivers);
        let named = receivers().any(|receiver| receiver == node);
        let for_all = receivers().all(|receiver| receiver == NOBODY);
        self.sender != node && (named || for_all)
    }
}

impl Network {
    /// What messages that may be sent late ([`Message::retry_late`]) are in the arbitrating windows: event
    /// messages with the same identifier, one in each basic cycle and for each of these windows.
    #[must_use]
    pub fn late_messages(&self) -> Vec<Message> {
        let arbitrating = |window: &Window| window.kind == WindowKind::Arbitrating;
        let windows: Vec<Window> = self.windows().into_iter().filter(arbitrating).collect();
        let may = self.messages.iter().filter(|message| message.retry_late);
        let late = |message: &Message, window: Window| Message {
            name: format!("{}{LATE}", message.name),
            send_type: SendType::Event {
                interval_ms: (self.basic_cycle_us / 1000).max(1),
            },
            condition: Condition::Always,
            deadline_us: None,
            window,
            further: Vec::new(),
            after: Vec::new(),
            retry_late: false,
            preparation_us: 0,
            ..message.clone()
        };
        may.flat_map(|message| windows.iter().map(|window| late(message, *window)))
            .collect()
    }

    /// The same network with its [`late_messages`](Self::late_messages) as messages of their own, for those
    /// that ask what can be in a window.
    #[must_use]
    pub fn with_late_messages(mut self) -> Self {
        self.messages.extend(self.late_messages());
        self
    }

    /// How much more or less than their period apart two frames of a message may start, in
    /// microseconds.
    pub const START_JITTER_US: u32 = 100;

    /// The largest [`Network::release_grain_us`].
    pub const LARGEST_RELEASE_GRAIN_US: u32 = 100;

    /// Release times of steps are multiples of this, in microseconds: the two-hundredth part of the
    /// basic cycle, but not more than [`Network::LARGEST_RELEASE_GRAIN_US`].
    #[must_use]
    pub fn release_grain_us(&self) -> u32 {
        (self.basic_cycle_us / 200).clamp(1, Self::LARGEST_RELEASE_GRAIN_US)
    }

    /// The bits of D0 that belong to no signal in any reference. No field of the protocol stands there
    /// where the references have a byte of the application in front.
    #[must_use]
    pub fn reference_free(&self) -> u8 {
        let messages = self.messages.iter();
        let references = messages.filter(|message| message.window.kind == WindowKind::Reference);
        let free = references.map(|message| message.free() as u8);
        free.reduce(|bits, one| bits & one).unwrap_or(0)
    }

    /// The message with this identifier.
    pub fn message(&self, id: u16) -> Option<&Message> {
        self.messages.iter().find(|message| message.id == id)
    }

    /// One bit time in nanoseconds, rounded up.
    pub fn bit_time_ns(&self) -> u32 {
        1_000_000_000_u32.div_ceil(self.bit_rate.max(1))
    }

    /// Bit times in microseconds, rounded up.
    pub fn bits_to_us(&self, bits: u32) -> u32 {
        let us = (u64::from(bits) * 1_000_000).div_ceil(u64::from(self.bit_rate.max(1)));
        us as u32
    }

    /// Latest begin of a frame after its window's start, in bit times. It is 0 for a reference
    /// message: the cycle time counts from its start of frame.
    pub(crate) fn latest_begin_bits(&self, message: &Message) -> u32 {
        match message.window.kind {
            WindowKind::Reference => 0,
            WindowKind::Exclusive | WindowKind::Arbitrating => u32::from(self.transmit_enable_bits),
        }
    }

    /// Length in microseconds of the shortest window that holds any one frame of a message: the
    /// longest frame, begun as late as allowed, and the nodes' clock error.
    #[must_use]
    pub fn needed_us(&self, message: &Message) -> u32 {
        let bits = worst_case_bits(message.length) + self.latest_begin_bits(message);
        self.bits_to_us(bits)
            .saturating_add(self.sync_uncertainty_us)
    }

    /// Cycle time in microseconds at which everything that a message's sender needs has
    /// arrived, so that its step can be released; `None` for a message that needs nothing.
    ///
    /// The last of those frames may begin a transmit enable window after its mark, by a clock that is
    /// late by the network's uncertainty, and may have the longest length. The result is rounded up
    /// to [`Network::release_grain_us`].
    pub fn release_us(&self, message: &Message) -> Option<u32> {
        let needed = message.after.iter().filter_map(|name| {
            let mut messages = self.messages.iter();
            messages.find(|other| other.name == *name)
        });
        let arrivals = needed.flat_map(|other| {
            let bits = worst_case_bits(other.length) + u32::from(self.transmit_enable_bits);
            let duration = self.bits_to_us(bits) + self.sync_uncertainty_us;
            other
                .windows()
                .map(move |window| window.start_us.saturating_add(duration))
        });
        let last = arrivals.max()?;
        let grain = self.release_grain_us();
        Some(last.div_ceil(grain).saturating_mul(grain))
    }

    /// Time in microseconds from the end of a frame of `message`, in an exclusive window, until
    /// the second frame after it is overdue ([`network::MISSED_PERIODS`]).
    ///
    /// The sum of that many periods, the difference between its shortest and its longest frame,
    /// and [`Network::START_JITTER_US`].
    #[must_use]
    pub fn overdue_us(&self, message: &Message) -> u32 {
        let period = self.basic_cycle_us * u32::from(message.window.repeat.max(1));
        let stuffing = worst_case_bits(message.length) - shortest_bits(message.length);
        network::MISSED_PERIODS * period + self.bits_to_us(stuffing) + Self::START_JITTER_US
    }

    /// The windows of the matrix in order of their start, each once.
    pub fn windows(&self) -> Vec<Window> {
        let mut windows: Vec<Window> = self.messages.iter().flat_map(Message::windows).collect();
        windows.sort();
        windows.dedup();
        windows
    }
}

//! The system matrix: which node may send which message when.
//!
//! A matrix has a power of two of basic cycles. A reference message begins each of
//! them. A window has two time marks (cycle times, counted from the start of frame
//! of the reference) between which a frame may be on the bus. A repeat factor and an
//! offset tell in which basic cycles the window exists. Time that no window covers
//! is free: any frame there is an error.

mod error;
mod validate;

pub use error::{MatrixError, Message, Problem};

use crate::id::Id;
use crate::length;
use crate::reference::ReferenceFormat;
use crate::time::Micros;

/// A node of the network. Nodes are numbered from 0 without gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId(
    /// The node's number.
    pub u16,
);

/// The kind of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowKind {
    /// One message of one sender.
    Exclusive {
        /// Identifier of the message.
        id: Id,
        /// Its number of data bytes, 0 to 8.
        len: u8,
        /// The only node that may send in this window.
        sender: NodeId,
        /// Whether a message that was not sent in this window may be sent in the
        /// next arbitrating one (thesis 4.3.6.1).
        retry_late: bool,
    },
    /// Event messages of all senders; arbitration decides.
    Arbitrating {
        /// Whether this window and the next one form one window. A frame may
        /// cross the time mark between the two.
        merged_with_next: bool,
    },
    /// No message: room for future ones.
    Free,
}

/// A window of the system matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window<'a> {
    /// Name in configuration errors.
    pub name: &'a str,
    /// Cycle time at which the window begins.
    pub start: Micros,
    /// Length.
    pub length: Micros,
    /// Kind.
    pub kind: WindowKind,
    /// Repeat factor: the window exists in every `repeat`-th basic cycle. 1, 2, 4,
    /// .. 64, at most the number of basic cycles.
    pub repeat: u8,
    /// The first basic cycle in which the window exists, below `repeat`.
    pub offset: u8,
}

impl<'a> Window<'a> {
    /// An exclusive window in every basic cycle.
    pub const fn exclusive(
        name: &'a str,
        start: Micros,
        length: Micros,
        id: Id,
        len: u8,
        sender: NodeId,
    ) -> Self {
        let kind = WindowKind::Exclusive {
            id,
            len,
            sender,
            retry_late: false,
        };
        Self::new(name, start, length, kind)
    }

    /// An arbitrating window in every basic cycle.
    pub const fn arbitrating(name: &'a str, start: Micros, length: Micros) -> Self {
        let kind = WindowKind::Arbitrating {
            merged_with_next: false,
        };
        Self::new(name, start, length, kind)
    }

    /// A free window in every basic cycle.
    pub const fn free(name: &'a str, start: Micros, length: Micros) -> Self {
        Self::new(name, start, length, WindowKind::Free)
    }

    /// A window of any kind in every basic cycle.
    pub const fn new(name: &'a str, start: Micros, length: Micros, kind: WindowKind) -> Self {
        Self {
            name,
            start,
            length,
            kind,
            repeat: 1,
            offset: 0,
        }
    }

    /// This window in every `repeat`-th basic cycle only, from cycle `offset`
    /// on.
    pub const fn every(mut self, repeat: u8, offset: u8) -> Self {
        self.repeat = repeat;
        self.offset = offset;
        self
    }

    /// This exclusive window, with permission to send its message in an arbitrating
    /// window if it could not be sent in this one. Windows of another kind do not
    /// change.
    pub const fn retry_late(mut self) -> Self {
        if let WindowKind::Exclusive {
            ref mut retry_late, ..
        } = self.kind
        {
            *retry_late = true;
        }
        self
    }

    /// This arbitrating window, merged with the next one. Windows of another kind do
    /// not change.
    pub const fn merged(mut self) -> Self {
        if let WindowKind::Arbitrating {
            ref mut merged_with_next,
        } = self.kind
        {
            *merged_with_next = true;
        }
        self
    }

    /// Whether the window exists in basic cycle `cycle`.
    pub const fn is_in(&self, cycle: u8) -> bool {
        // The repeat factor is a power of two, so no division is needed.
        cycle & self.repeat.wrapping_sub(1) == self.offset
    }

    pub(crate) const fn end(&self) -> u32 {
        self.start.ticks().saturating_add(self.length.ticks())
    }
}

/// A message that its sender may send in arbitrating windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event<'a> {
    /// Name in configuration errors.
    pub name: &'a str,
    /// Identifier, which is also the priority.
    pub id: Id,
    /// Bits of the identifier that all frames of the message have in common: all of them, if it has
    /// one identifier.
    pub mask: u32,
    /// Largest number of data bytes, 0 to 8.
    pub len: u8,
    /// The node that sends it.
    pub sender: NodeId,
    /// It may be sent in one of so many basic cycles (ISO 11898-4, repeat factor): 1, 2, 4, .. up to
    /// the number of basic cycles. All event messages of a node have the same basic cycles, because
    /// they wait in one line, and so do its messages that are sent late.
    pub repeat: u8,
    /// The first basic cycle in which it may be sent, below `repeat`.
    pub offset: u8,
}

impl<'a> Event<'a> {
    /// An event message that may be sent in the arbitrating windows of every basic cycle.
    pub const fn new(name: &'a str, id: Id, len: u8, sender: NodeId) -> Self {
        Self {
            name,
            id,
            mask: id.all_bits(),
            len,
            sender,
            repeat: 1,
            offset: 0,
        }
    }

    /// All frames of `sender` whose identifiers have the same format as `id`, and its bits where `mask` is
    /// set. So the messages of another protocol can share the arbitrating windows without a name
    /// for each:
    ///
    /// ```
    /// use ttcan::{Event, Id, NodeId};
    ///
    /// const NODE: NodeId = NodeId(2);
    /// // SAE J1939: the source address 0x21 is in the lowest eight bits.
    /// let j1939 = Event::masked("j1939", Id::extended(0x21).unwrap(), 0xFF, 8, NODE);
    /// // CiA 301 (CANopen): the node's number 5 is in the lowest seven bits.
    /// let canopen = Event::masked("canopen", Id::standard(5).unwrap(), 0x7F, 8, NODE);
    /// # assert_ne!(j1939, canopen);
    /// ```
    ///
    /// No other message may have one of these identifiers. A node of the network that is built without the
    /// feature `masks` takes the frames for foreign ones.
    #[cfg(feature = "masks")]
    #[must_use]
    pub const fn masked(name: &'a str, id: Id, mask: u32, len: u8, sender: NodeId) -> Self {
        Self {
            mask: mask & id.all_bits(),
            ..Self::new(name, id, len, sender)
        }
    }

    /// Whether the message has one identifier.
    pub(crate) const fn has_one_id(&self) -> bool {
        self.mask == self.id.all_bits()
    }

    /// The same message, in the arbitrating windows of one of `repeat` basic cycles, from `offset` on.
    #[must_use]
    pub const fn every(self, repeat: u8, offset: u8) -> Self {
        Self {
            repeat,
            offset,
            ..self
        }
    }
}

/// Longest transmit enable window, in bit times.
///
/// ISO 11898-4 has 1 to 16, for controllers that begin a frame by themselves. Here a program does
/// it, which takes the same time at every bit rate: at 500 kbit/s, 16 bit times are only 32 us. A
/// receiver does not see the difference: it judges a frame by the window that it ends in.
pub const LONGEST_TRANSMIT_ENABLE: u8 = 32;

/// What all nodes of a network have in common, before the check.
#[derive(Clone, Copy, Debug)]
pub struct MatrixConfig<'a> {
    /// Bit rate of the bus in bit/s.
    pub bit_rate: u32,
    /// Time from one reference message to the next.
    pub basic_cycle: Micros,
    /// Number of basic cycles in the matrix: 1, 2, 4, .. 64.
    pub cycles: u8,
    /// Identifier of the reference message of the best-ranked master. The master of
    /// rank `r` adds `r` to it. All references share the bits above the lowest three
    /// (ISO 11898-4).
    pub reference: Id,
    /// Fields of the reference message.
    pub reference_format: ReferenceFormat,
    /// The potential time masters, best rank first: one to eight.
    pub masters: &'a [NodeId],
    /// Transmit enable window (Tx_Enable_Window): how long after its time mark a
    /// frame may still begin in an exclusive window, in bit times, 1 to
    /// [`LONGEST_TRANSMIT_ENABLE`].
    pub transmit_enable_bits: u8,
    /// Largest difference between the cycle times of two nodes in schedule.
    pub sync_uncertainty: Micros,
    /// Longest gap (event-synchronised cycle, ISO 11898-4), counted from the reference that
    /// announces it: 0 if the network has none, otherwise at least a basic cycle. After it a
    /// potential master starts the next basic cycle without the event. In a network without
    /// gaps a reference that announces one is not valid.
    pub longest_gap: Micros,
    /// The windows, sorted by start. Windows of the same basic cycle must not
    /// overlap.
    pub windows: &'a [Window<'a>],
    /// The messages that may be sent in arbitrating windows.
    pub events: &'a [Event<'a>],
}

/// A checked system matrix.
///
/// ```
/// use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};
///
/// const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
///     bit_rate: 250_000,
///     basic_cycle: Micros::millis(100),
///     cycles: 1,
///     reference: Id::constant::<100>(),
///     reference_format: ReferenceFormat::LEVEL_1,
///     masters: &[NodeId(0)],
///     transmit_enable_bits: 16,
///     sync_uncertainty: Micros::micros(20),
///     longest_gap: Micros::micros(0),
///     windows: &[Window::exclusive(
///         "speed",
///         Micros::millis(1),
///         Micros::millis(1),
///         Id::constant::<200>(),
///         8,
///         NodeId(1),
///     )],
///     events: &[],
/// });
/// assert_eq!(MATRIX.node_count(), 2);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct SystemMatrix<'a> {
    config: MatrixConfig<'a>,
}

impl<'a> SystemMatrix<'a> {
    /// Checks `config`.
    ///
    /// # Errors
    /// The first problem found, and its window. [`Problem`] lists the checks.
    pub const fn new(config: MatrixConfig<'a>) -> Result<Self, MatrixError<'a>> {
        match validate::check(&config) {
            Ok(()) => Ok(Self { config }),
            Err(error) => Err(error),
        }
    }

    /// [`SystemMatrix::new`] for constants: a matrix that is refused fails the
    /// build.
    ///
    /// ```compile_fail,E0080
    /// # use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};
    /// const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    /// #   bit_rate: 250_000,
    /// #   basic_cycle: Micros::millis(100),
    /// #   cycles: 1,
    /// #   reference: Id::constant::<100>(),
    /// #   reference_format: ReferenceFormat::LEVEL_1,
    /// #   masters: &[NodeId(0)],
    /// #   transmit_enable_bits: 16,
    /// #   sync_uncertainty: Micros::micros(20),
    /// #   longest_gap: Micros::micros(0),
    ///     // 8 bytes take up to 540 us; with all margins it takes 624 us.
    ///     windows: &[Window::exclusive(
    ///         "speed",
    ///         Micros::micros(1000),
    ///         Micros::micros(600),
    ///         Id::constant::<200>(),
    ///         8,
    ///         NodeId(1),
    ///     )],
    ///     // ..
    /// #   events: &[],
    /// });
    /// # println!("{}", MATRIX.node_count());
    /// ```
    ///
    /// The compiler then says
    ///
    /// ```text
    /// window `speed`: is 600 us long, but its longest frame with the transmit
    /// enable window and the synchronisation uncertainty needs 624 us
    /// ```
    ///
    /// # Panics
    /// With the message of the [`MatrixError`] if there is one. Use
    /// [`SystemMatrix::new`] at run time.
    pub const fn constant(config: MatrixConfig<'a>) -> Self {
        match Self::new(config) {
            Ok(matrix) => matrix,
            Err(error) => panic!("{}", error.message().as_str()),
        }
    }

    /// The checked configuration.
    pub const fn config(&self) -> &MatrixConfig<'a> {
        &self.config
    }

    /// Number of windows, of any kind.
    pub const fn window_count(&self) -> usize {
        self.config.windows.len()
    }

    /// One more than the highest node number that is a master or a sender.
    pub const fn node_count(&self) -> usize {
        let mut count = 0;
        let mut at = 0;
        while at < self.config.masters.len() {
            count = max(count, self.config.masters[at].0 as usize + 1);
            at += 1;
        }
        at = 0;
        while at < self.config.windows.len() {
            if let WindowKind::Exclusive { sender, .. } = self.config.windows[at].kind {
                count = max(count, sender.0 as usize + 1);
            }
            at += 1;
        }
        at = 0;
        while at < self.config.events.len() {
            count = max(count, self.config.events[at].sender.0 as usize + 1);
            at += 1;
        }
        count
    }

    /// Number of exclusive windows and event messages: the entries of the table of
    /// identifiers.
    pub const fn id_count(&self) -> usize {
        let mut count = self.config.events.len();
        let mut at = 0;
        while at < self.config.windows.len() {
            if matches!(self.config.windows[at].kind, WindowKind::Exclusive { .. }) {
                count += 1;
            }
            at += 1;
        }
        count
    }

    /// Number of basic cycles after which the windows repeat: the largest repeat
    /// factor.
    pub(crate) const fn distinct_cycles(&self) -> u8 {
        let mut most = 1;
        let mut at = 0;
        while at < self.config.windows.len() {
            let repeat = self.config.windows[at].repeat;
            if repeat > most {
                most = repeat;
            }
            at += 1;
        }
        most
    }

    /// Number of entries of the compiled schedule
    /// ([`Schedule`](crate::Schedule)).
    pub const fn entry_count(&self) -> usize {
        let distinct = self.distinct_cycles();
        let mut count = 0;
        let mut cycle = 0;
        while cycle < distinct {
            let mut merging = false;
            let mut at = 0;
            while at < self.config.windows.len() {
                let window = &self.config.windows[at];
                if window.is_in(cycle) {
                    match window.kind {
                        WindowKind::Exclusive { .. } => count += 1,
                        WindowKind::Arbitrating { merged_with_next } => {
                            if !merging {
                                count += 1;
                            }
                            merging = merged_with_next;
                        }
                        WindowKind::Free => {}
                    }
                }
                at += 1;
            }
            cycle += 1;
        }
        count
    }

    /// Time that `bits` bit times take, in microseconds rounded up.
    pub(crate) const fn bits_to_micros(&self, bits: u32) -> u32 {
        bits_to_micros(bits, self.config.bit_rate)
    }

    /// Longest reference message with its interframe space, in microseconds.
    pub(crate) const fn reference_micros(&self) -> u32 {
        let bits = length::worst_case_bits(
            self.config.reference,
            self.config.reference_format.longest(),
        );
        self.bits_to_micros(bits + length::INTERFRAME_BITS)
    }
}

const fn max(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// Time that `bits` bit times take, in microseconds rounded up. The bit rate of a
/// checked matrix is not 0; for 0 the result is the longest time.
pub(crate) const fn bits_to_micros(bits: u32, bit_rate: u32) -> u32 {
    if bit_rate == 0 {
        return u32::MAX;
    }
    let micros = (bits as u64 * 1_000_000).div_ceil(bit_rate as u64);
    if micros > u32::MAX as u64 {
        u32::MAX
    } else {
        micros as u32
    }
}

pub(crate) use validate::REFERENCE_OFFSET_LIMIT;
#[cfg(feature = "std")]
pub(crate) use validate::needed_micros;

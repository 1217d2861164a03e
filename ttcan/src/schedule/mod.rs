//! The compiled schedule: the matrix as a table that nodes read.
//!
//! The table has the windows of each distinct basic cycle in order, so that a node
//! only steps to the next entry. A second table gives the first entry for each
//! cycle count. The cost of both steps does not depend on the number of windows.

mod compile;
#[cfg(feature = "std")]
mod heap;

#[cfg(feature = "std")]
pub use heap::HeapSchedule;

use crate::id::Id;
use crate::matrix::{NodeId, SystemMatrix};
use crate::reference::ReferenceFormat;
use crate::time::Micros;

/// One window in one distinct basic cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    /// Time marks at which the window begins and ends: cycle times in
    /// microseconds.
    pub start: u32,
    pub end: u32,
    /// Index in [`MatrixConfig::windows`](crate::MatrixConfig::windows); that of the
    /// first window if several are merged.
    pub window: u16,
    pub role: Role,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Exclusive {
        id: Id,
        len: u8,
        sender: NodeId,
        retry_late: bool,
    },
    Arbitrating,
}

/// A message of the network, for frames that are not in their window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Known {
    pub id: Id,
    /// Bits of the identifier that the message's frames have.
    #[cfg(feature = "masks")]
    pub mask: u32,
    pub sender: NodeId,
    pub len: u8,
    pub is_event: bool,
    pub retry_late: bool,
    /// One of the message's windows, 0 for events.
    pub window: u16,
    /// Basic cycles of an event message: repeat factor and offset.
    pub cycles: (u8, u8),
}

/// The parameters of a schedule, without its tables. Times are in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Network {
    /// Length of a bit in 2^-16 us, rounded.
    pub bit: u32,
    pub basic_cycle: u32,
    pub cycles: u8,
    pub reference: Id,
    /// What all references have in common: the identifier's bits but those of the rank.
    pub reference_bits: u32,
    pub reference_format: ReferenceFormat,
    pub masters: [Option<NodeId>; 8],
    pub master_count: u8,
    pub transmit_enable: u32,
    pub uncertainty: u32,
    /// 0 if the network has no gaps.
    pub longest_gap: u32,
    /// Longest reference message with its interframe space.
    pub reference_length: u32,
    /// Time since a reference from which on another one counts as the next.
    pub reference_early: u32,
    /// How late a reference comes at most: by then the last backup's offset, the uncertainty and two
    /// longest references have passed.
    pub reference_late: u32,
    /// Whether references carry the fields of level 2.
    pub tells_time: bool,
    pub window_count: usize,
    /// Number of exclusive windows.
    pub exclusive_count: u16,
    /// Index of the first entry of each distinct basic cycle, and one past the last
    /// entry of the last one.
    pub first: [u16; 65],
    pub distinct_mask: u8,
    /// Number of messages with one identifier.
    #[cfg(feature = "masks")]
    pub one_id: usize,
}

/// The compiled schedule of a matrix, the same for all its nodes: `N` entries, `I`
/// identifiers, `P` nodes. [`schedule!`](crate::schedule) computes the numbers.
#[derive(Clone, Debug)]
pub struct Schedule<const N: usize, const I: usize, const P: usize> {
    network: Network,
    entries: [Entry; N],
    /// Sorted by identifier; behind them those with several.
    known: [Known; I],
    /// Exclusive windows of each node in the whole matrix.
    windows_of: [u16; P],
}

/// A reference to a compiled schedule, without its sizes in the type.
#[derive(Clone, Copy, Debug)]
pub struct ScheduleView<'s> {
    pub(crate) network: &'s Network,
    entries: &'s [Entry],
    known: &'s [Known],
    windows_of: &'s [u16],
}

/// The sizes given for a schedule do not fit its matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongSize;

impl core::fmt::Display for WrongSize {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the sizes of the schedule are not those of its matrix")
    }
}

impl core::error::Error for WrongSize {}

impl<const N: usize, const I: usize, const P: usize> Schedule<N, I, P> {
    /// Compiles `matrix`. `N`, `I` and `P` must be its
    /// [`entry_count`](SystemMatrix::entry_count),
    /// [`id_count`](SystemMatrix::id_count) and
    /// [`node_count`](SystemMatrix::node_count).
    ///
    /// # Errors
    /// The sizes are others, or there are 65 535 entries or more.
    pub const fn new(matrix: &SystemMatrix) -> Result<Self, WrongSize> {
        if N != matrix.entry_count()
            || I != matrix.id_count()
            || P != matrix.node_count()
            || N >= u16::MAX as usize
        {
            return Err(WrongSize);
        }
        let mut schedule = Self {
            network: compile::network(matrix),
            entries: [compile::NO_ENTRY; N],
            known: [compile::NO_MESSAGE; I],
            windows_of: [0; P],
        };
        compile::entries(matrix, &mut schedule.network, &mut schedule.entries);
        compile::known(
            matrix,
            &mut schedule.network,
            &mut schedule.known,
            &mut schedule.windows_of,
        );
        Ok(schedule)
    }

    /// [`Schedule::new`] for constants.
    ///
    /// # Panics
    /// The sizes are wrong. In a `const` this fails the build.
    pub const fn constant(matrix: &SystemMatrix) -> Self {
        match Self::new(matrix) {
            Ok(schedule) => schedule,
            Err(WrongSize) => panic!("the sizes of the schedule are not those of its matrix"),
        }
    }

    /// A reference to the schedule, for nodes.
    pub const fn view(&self) -> ScheduleView<'_> {
        ScheduleView {
            network: &self.network,
            entries: &self.entries,
            known: &self.known,
            windows_of: &self.windows_of,
        }
    }
}

/// Two views are equal if they refer to the same schedule.
impl PartialEq for ScheduleView<'_> {
    fn eq(&self, other: &Self) -> bool {
        core::ptr::eq(self.network, other.network)
    }
}

impl Eq for ScheduleView<'_> {}

impl core::hash::Hash for ScheduleView<'_> {
    /// Nodes of one network share their schedule.
    fn hash<H: core::hash::Hasher>(&self, _: &mut H) {}
}

impl<'s> ScheduleView<'s> {
    pub(crate) fn entry(&self, at: u16) -> Option<&'s Entry> {
        self.entries.get(usize::from(at))
    }

    /// First entry of basic cycle `cycle` and one past its last.
    pub(crate) fn entries_of(&self, cycle: u8) -> (u16, u16) {
        let distinct = usize::from(cycle & self.network.distinct_mask & 63);
        match self.network.first.get(distinct..) {
            Some([first, end, ..]) => (*first, *end),
            _ => (0, 0),
        }
    }

    /// Basic cycles in which a node may send its event messages, as repeat factor and offset: they
    /// are the same for all of them.
    pub(crate) fn event_cycles(&self, node: NodeId) -> (u8, u8) {
        let mut known = self.known.iter();
        let event = known.find(|known| known.is_event && known.sender == node);
        event.map_or((1, 0), |event| event.cycles)
    }

    /// Looks up the message with an identifier, by binary search among those with one, then one by one
    /// among those with several.
    #[inline(never)]
    pub(crate) fn known(&self, id: Id) -> Option<&Known> {
        let (mut from, mut to) = (0, self.one_id());
        // loop-bound: 6. It halves a table of up to 64 identifiers.
        while from < to {
            let middle = from + (to - from) / 2;
            let known = self.known.get(middle)?;
            if known.id == id {
                return Some(known);
            }
            if known.id < id {
                from = middle + 1;
            } else {
                to = middle;
            }
        }
        self.masked(id)
    }

    /// Number of messages with one identifier.
    #[cfg(feature = "masks")]
    const fn one_id(&self) -> usize {
        self.network.one_id
    }

    #[cfg(not(feature = "masks"))]
    const fn one_id(&self) -> usize {
        self.known.len()
    }

    /// The message with several identifiers, of which this is one.
    #[cfg(feature = "masks")]
    fn masked(&self, id: Id) -> Option<&Known> {
        let mut several = self.known.get(self.network.one_id..)?.iter();
        several.find(|known| known.id.agrees(id, known.mask))
    }

    #[cfg(not(feature = "masks"))]
    const fn masked(&self, _: Id) -> Option<&Known> {
        None
    }

    /// All messages, those with one identifier sorted by it.
    pub(crate) fn messages(&self) -> &'s [Known] {
        self.known
    }

    /// Exclusive windows of `node` in the whole matrix.
    pub(crate) fn windows_of(&self, node: NodeId) -> u16 {
        self.windows_of
            .get(usize::from(node.0))
            .copied()
            .unwrap_or(0)
    }

    /// Exclusive windows of `node` in two basic cycles, rounded up.
    pub(crate) fn windows_in_two_cycles(&self, node: NodeId) -> u16 {
        let windows = u32::from(self.windows_of(node)) * 2;
        // The cycles of a matrix are a power of two.
        let last = u32::from(self.network.cycles.wrapping_sub(1));
        let windows = windows.wrapping_add(last) >> last.trailing_ones();
        windows.min(u32::from(u16::MAX)) as u16
    }

    /// Number of windows of the matrix.
    pub fn window_count(&self) -> usize {
        self.network.window_count
    }

    /// Number of nodes that are masters or senders.
    pub fn node_count(&self) -> usize {
        self.windows_of.len()
    }

    /// Number of exclusive windows.
    pub(crate) fn exclusive_count(&self) -> u16 {
        self.network.exclusive_count
    }

    /// Rank of a node among the potential masters.
    pub fn rank_of(&self, node: NodeId) -> Option<u8> {
        let rank = self
            .network
            .masters
            .iter()
            .position(|master| *master == Some(node))?;
        Some(rank as u8)
    }

    /// Length of a basic cycle.
    pub fn basic_cycle(&self) -> Micros {
        Micros::from_ticks(self.network.basic_cycle)
    }

    /// Whether this is the identifier of a potential master's reference message.
    pub fn is_reference(&self, id: Id) -> bool {
        matches!(self.reference_rank(id), Some((_, Some(_))))
    }

    /// The rank that an identifier of the reference message has, and its potential master if there
    /// is one: `None` if it is not the identifier of a reference.
    pub(crate) fn reference_rank(&self, id: Id) -> Option<(u8, Option<NodeId>)> {
        let reference = self.network.reference;
        if !id.agrees_in(reference, self.network.reference_bits) {
            return None;
        }
        // The difference is large if there is no such rank.
        let rank = id.rank(reference);
        let master = self.network.masters.get(rank as usize);
        Some((rank as u8, master.copied().flatten()))
    }
}

/// Compiles the constant matrix `$matrix` into a static schedule.
///
/// ```
/// # use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};
/// # const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
/// #     bit_rate: 250_000, basic_cycle: Micros::millis(100), cycles: 1,
/// #     reference: Id::constant::<100>(), reference_format: ReferenceFormat::LEVEL_1,
/// #     masters: &[NodeId(0)], transmit_enable_bits: 16, sync_uncertainty: Micros::micros(20), longest_gap: Micros::micros(0),
/// #     windows: &[], events: &[],
/// # });
/// ttcan::schedule!(pub static SCHEDULE = MATRIX);
/// assert_eq!(SCHEDULE.view().node_count(), 1);
/// ```
#[macro_export]
macro_rules! schedule {
    ($(#[$attribute:meta])* $visibility:vis static $name:ident = $matrix:expr) => {
        $(#[$attribute])*
        $visibility static $name: $crate::Schedule<
            { $matrix.entry_count() },
            { $matrix.id_count() },
            { $matrix.node_count() },
        > = $crate::Schedule::constant(&$matrix);
    };
}

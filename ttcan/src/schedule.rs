//! The compiled schedule: the matrix as nodes read it.
//!
//! The windows of each distinct basic cycle stand in a row, so a node only ever
//! steps to the next entry; the first entry of a cycle comes from a table by
//! the cycle count. Neither step depends on how many windows there are.

use crate::{Id, NodeId, ReferenceFormat, SystemMatrix, WindowKind, matrix};

/// One window in one distinct basic cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    /// Cycle times in microseconds.
    pub start: u32,
    pub end: u32,
    /// Index in [`MatrixConfig::windows`](crate::MatrixConfig::windows); the
    /// first one's for merged windows.
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

/// A known identifier and its sender, for frames out of place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Known {
    pub id: Id,
    pub sender: NodeId,
    pub len: u8,
    pub is_event: bool,
    pub retry_late: bool,
    /// One of the message's windows, 0 for events.
    pub window: u16,
}

/// What a schedule holds besides its tables. Times in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Network {
    pub bit_rate: u32,
    pub basic_cycle: u32,
    pub cycles: u8,
    pub reference: Id,
    pub reference_format: ReferenceFormat,
    pub masters: [Option<NodeId>; 8],
    pub transmit_enable: u32,
    pub uncertainty: u32,
    /// Longest reference message with its interframe space.
    pub reference_length: u32,
}

/// The compiled schedule of a matrix, common to all its nodes: `N` entries, `I`
/// identifiers, `P` nodes. [`schedule!`](crate::schedule) finds the numbers.
#[derive(Clone, Debug)]
pub struct Schedule<const N: usize, const I: usize, const P: usize> {
    network: Network,
    entries: [Entry; N],
    /// First entry of each distinct cycle, and one past the last cycle's last.
    first: [u16; 65],
    distinct_mask: u8,
    /// Sorted by identifier.
    known: [Known; I],
    /// Exclusive windows of each node in the whole matrix.
    windows_of: [u16; P],
    window_count: usize,
    exclusive_count: u16,
}

/// A compiled schedule without its sizes in the type, as a node holds it.
#[derive(Clone, Copy, Debug)]
pub struct ScheduleView<'s> {
    pub(crate) network: &'s Network,
    entries: &'s [Entry],
    first: &'s [u16; 65],
    distinct_mask: u8,
    known: &'s [Known],
    windows_of: &'s [u16],
    window_count: usize,
    exclusive_count: u16,
}

/// The sizes given for a schedule are not those of its matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongSize;

impl core::fmt::Display for WrongSize {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the sizes of the schedule are not those of its matrix")
    }
}

impl core::error::Error for WrongSize {}

const NO_ENTRY: Entry = Entry {
    start: 0,
    end: 0,
    window: 0,
    role: Role::Arbitrating,
};

impl<const N: usize, const I: usize, const P: usize> Schedule<N, I, P> {
    /// Compiles `matrix`. `N`, `I` and `P` must be its
    /// [`entry_count`](SystemMatrix::entry_count),
    /// [`id_count`](SystemMatrix::id_count) and
    /// [`node_count`](SystemMatrix::node_count).
    pub const fn new(matrix: &SystemMatrix) -> Result<Self, WrongSize> {
        if N != matrix.entry_count()
            || I != matrix.id_count()
            || P != matrix.node_count()
            || N >= u16::MAX as usize
        {
            return Err(WrongSize);
        }
        let config = matrix.config();
        let mut masters = [None; 8];
        let mut rank = 0;
        while rank < config.masters.len() && rank < 8 {
            masters[rank] = Some(config.masters[rank]);
            rank += 1;
        }
        let mut schedule = Self {
            network: Network {
                bit_rate: config.bit_rate,
                basic_cycle: config.basic_cycle.ticks(),
                cycles: config.cycles,
                reference: config.reference,
                reference_format: config.reference_format,
                masters,
                transmit_enable: matrix.bits_to_micros(config.transmit_enable_bits as u32),
                uncertainty: config.sync_uncertainty.ticks(),
                reference_length: matrix.reference_micros(),
            },
            entries: [NO_ENTRY; N],
            first: [0; 65],
            distinct_mask: matrix.distinct_cycles() - 1,
            known: [Known {
                id: config.reference,
                sender: NodeId(0),
                len: 0,
                is_event: false,
                retry_late: false,
                window: 0,
            }; I],
            windows_of: [0; P],
            window_count: config.windows.len(),
            exclusive_count: 0,
        };
        schedule.fill_entries(matrix);
        schedule.fill_known(matrix);
        Ok(schedule)
    }

    const fn fill_entries(&mut self, matrix: &SystemMatrix) {
        let config = matrix.config();
        let distinct = matrix.distinct_cycles();
        let mut next = 0;
        let mut cycle = 0;
        while cycle < distinct {
            self.first[cycle as usize] = next as u16;
            let mut merging = false;
            let mut at = 0;
            while at < config.windows.len() {
                let window = &config.windows[at];
                if window.is_in(cycle) {
                    let role = match window.kind {
                        WindowKind::Exclusive {
                            id,
                            len,
                            sender,
                            retry_late,
                        } => Some(Role::Exclusive {
                            id,
                            len,
                            sender,
                            retry_late,
                        }),
                        WindowKind::Arbitrating { merged_with_next } => {
                            let continued = merging;
                            merging = merged_with_next;
                            if continued {
                                self.entries[next - 1].end = window.end();
                                None
                            } else {
                                Some(Role::Arbitrating)
                            }
                        }
                        WindowKind::Free => None,
                    };
                    if let Some(role) = role {
                        self.entries[next] = Entry {
                            start: window.start.ticks(),
                            end: window.end(),
                            window: at as u16,
                            role,
                        };
                        next += 1;
                    }
                }
                at += 1;
            }
            cycle += 1;
        }
        self.first[distinct as usize] = next as u16;
    }

    const fn fill_known(&mut self, matrix: &SystemMatrix) {
        let config = matrix.config();
        let mut count = 0;
        let mut at = 0;
        while at < config.windows.len() {
            let window = &config.windows[at];
            if let WindowKind::Exclusive {
                id,
                len,
                sender,
                retry_late,
            } = window.kind
            {
                let times = (config.cycles / window.repeat) as u16;
                let total = &mut self.windows_of[sender.0 as usize];
                *total = total.saturating_add(times);
                self.insert(
                    count,
                    Known {
                        id,
                        sender,
                        len,
                        is_event: false,
                        retry_late,
                        window: at as u16,
                    },
                );
                count += 1;
            }
            at += 1;
        }
        self.exclusive_count = count as u16;
        at = 0;
        while at < config.events.len() {
            let event = &config.events[at];
            self.insert(
                count,
                Known {
                    id: event.id,
                    sender: event.sender,
                    len: event.len,
                    is_event: true,
                    retry_late: false,
                    window: 0,
                },
            );
            count += 1;
            at += 1;
        }
    }

    /// Inserts into the `count` sorted identifiers.
    const fn insert(&mut self, count: usize, known: Known) {
        let mut at = count;
        while at > 0 && self.known[at - 1].id.priority() > known.id.priority() {
            self.known[at] = self.known[at - 1];
            at -= 1;
        }
        self.known[at] = known;
    }

    /// [`Schedule::new`] for constants.
    ///
    /// # Panics
    /// When the sizes are wrong: in a `const` this fails the build.
    pub const fn constant(matrix: &SystemMatrix) -> Self {
        match Self::new(matrix) {
            Ok(schedule) => schedule,
            Err(WrongSize) => panic!("the sizes of the schedule are not those of its matrix"),
        }
    }

    /// The schedule as a node takes it.
    pub const fn view(&self) -> ScheduleView<'_> {
        ScheduleView {
            network: &self.network,
            entries: &self.entries,
            first: &self.first,
            distinct_mask: self.distinct_mask,
            known: &self.known,
            windows_of: &self.windows_of,
            window_count: self.window_count,
            exclusive_count: self.exclusive_count,
        }
    }
}

/// Two views are equal when they are of one schedule.
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
        let distinct = usize::from(cycle & self.distinct_mask & 63);
        match self.first.get(distinct..) {
            Some([first, end, ..]) => (*first, *end),
            _ => (0, 0),
        }
    }

    /// Looks up an identifier that did not stand where it should; takes as many
    /// steps as the logarithm of the number of identifiers.
    pub(crate) fn known(&self, id: Id) -> Option<&Known> {
        let at = self
            .known
            .binary_search_by(|known| known.id.cmp(&id))
            .ok()?;
        self.known.get(at)
    }

    /// Exclusive windows of `node` in the whole matrix.
    pub(crate) fn windows_of(&self, node: NodeId) -> u16 {
        self.windows_of
            .get(usize::from(node.0))
            .copied()
            .unwrap_or(0)
    }

    /// Number of windows of the matrix.
    pub fn window_count(&self) -> usize {
        self.window_count
    }

    /// Number of nodes that are masters or senders.
    pub fn node_count(&self) -> usize {
        self.windows_of.len()
    }

    /// Number of exclusive windows.
    pub(crate) fn exclusive_count(&self) -> u16 {
        self.exclusive_count
    }

    pub(crate) fn rank_of(&self, node: NodeId) -> Option<u8> {
        let rank = self
            .network
            .masters
            .iter()
            .position(|master| *master == Some(node))?;
        Some(rank as u8)
    }

    /// The rank that an identifier of the reference message stands for:
    /// `None` if it is no reference, `Some(None)` if nobody has the rank.
    pub(crate) fn reference_rank(&self, id: Id) -> Option<Option<u8>> {
        let reference = self.network.reference;
        if id.is_extended() != reference.is_extended() || id.raw() >> 3 != reference.raw() >> 3 {
            return None;
        }
        let rank = id.raw().checked_sub(reference.raw());
        Some(rank.map(|rank| rank as u8).filter(|rank| {
            self.network
                .masters
                .get(usize::from(*rank))
                .is_some_and(Option::is_some)
        }))
    }

    /// How much earlier than the basic cycle's end a reference is still the
    /// next one, in microseconds.
    pub(crate) fn reference_early(&self) -> u32 {
        matrix::REFERENCE_OFFSET_LIMIT + self.network.uncertainty + self.network.reference_length
    }
}

/// Compiles the constant matrix `$matrix` into a static schedule of the right
/// sizes.
///
/// ```
/// # use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};
/// # const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
/// #     bit_rate: 250_000, basic_cycle: Micros::millis(100), cycles: 1,
/// #     reference: Id::constant::<100>(), reference_format: ReferenceFormat::LEVEL_1,
/// #     masters: &[NodeId(0)], transmit_enable_bits: 16, sync_uncertainty: Micros::micros(20),
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

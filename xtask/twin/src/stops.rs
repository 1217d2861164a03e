//! Where a debugger stops a node, and what a node has passed on its way.

use crate::clock::{Cycles, NEVER};
use crate::stores::{Access, Bytes, Decoder};
use can_bus::SimTime;
use std::collections::BTreeSet;

/// Which accesses to memory stop a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Watched {
    /// Loads.
    Reads,
    /// Stores.
    Writes,
    /// Both.
    Accesses,
}

impl Watched {
    fn covers(self, writes: bool) -> bool {
        match self {
            Self::Reads => !writes,
            Self::Writes => writes,
            Self::Accesses => true,
        }
    }
}

/// A range of addresses whose accesses stop a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Watch {
    /// The first address.
    pub first: u32,
    /// The last address.
    pub last: u32,
    /// Which accesses stop the node.
    pub kind: Watched,
}

impl Watch {
    fn is_hit(self, (first, last): Bytes, writes: bool) -> bool {
        self.kind.covers(writes) && first <= self.last && self.first <= last
    }
}

/// Where a node stops. It stops before it carries out the step that meets one of these.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stops {
    /// Addresses of instructions.
    pub breakpoints: BTreeSet<u32>,
    /// Ranges of memory.
    pub watches: BTreeSet<Watch>,
    /// The number of steps that it has carried out.
    pub step: Option<u64>,
    /// The time at which it next carries out a step.
    pub time: Option<SimTime>,
}

/// Why a node stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// It has carried out the steps that were asked for.
    Step,
    /// The time has come.
    Time,
    /// It is at a breakpoint.
    Breakpoint,
    /// Its next instruction accesses a range that is watched.
    Access(Watch),
    /// A range that is watched was written to by something other than an instruction: a DMA transfer, or the
    /// core, which saves registers when it enters an exception.
    Written(Watch),
}

/// Bits for the addresses that a node has passed. Addresses share bits, so a set bit means only that the node
/// may have been there.
#[derive(Clone, Debug)]
pub struct Footprint {
    executed: Box<[u64]>,
    read: Box<[u64]>,
    written: Box<[u64]>,
}

/// Halfwords of flash that have a bit of their own: 512 KiB.
const CODE: usize = 1 << 18;
/// Words of memory that have a bit of their own: 128 KiB.
const DATA: usize = 1 << 15;

impl Default for Footprint {
    fn default() -> Self {
        let bits = |count: usize| vec![0; count / 64].into_boxed_slice();
        Self {
            executed: bits(CODE),
            read: bits(DATA),
            written: bits(DATA),
        }
    }
}

/// Sets the bit of a number.
#[inline]
fn set(bits: &mut [u64], number: u32) {
    let place = number as usize % (bits.len() * 64);
    bits[place / 64] |= 1 << (place % 64);
}

fn is_set(bits: &[u64], number: u32) -> bool {
    let place = number as usize % (bits.len() * 64);
    bits[place / 64] >> (place % 64) & 1 != 0
}

/// The numbers of the words that have one of these bytes; at most as many as there are bits.
#[inline]
fn words((first, last): Bytes) -> impl Iterator<Item = u32> {
    (first >> 2..=last >> 2).take(DATA)
}

impl Footprint {
    #[inline]
    fn accessed(&mut self, bytes: Bytes, writes: bool) {
        let bits = match writes {
            true => &mut self.written,
            false => &mut self.read,
        };
        for word in words(bytes) {
            set(bits, word);
        }
    }

    /// Adds what another one has.
    pub fn join(&mut self, other: &Self) {
        let pairs = [
            (&mut self.executed, &other.executed),
            (&mut self.read, &other.read),
            (&mut self.written, &other.written),
        ];
        for (own, others) in pairs {
            for (own, other) in own.iter_mut().zip(others) {
                *own |= other;
            }
        }
    }

    /// Whether the node may have met a breakpoint or a watched range on its way.
    #[must_use]
    pub fn may_meet(&self, stops: &Stops) -> bool {
        let mut breakpoints = stops.breakpoints.iter();
        let mut watches = stops.watches.iter();
        breakpoints.any(|at| is_set(&self.executed, at >> 1))
            || watches.any(|watch| {
                let met = |bits, writes| {
                    let mut words = words((watch.first, watch.last));
                    watch.kind.covers(writes) && words.any(|word| is_set(bits, word))
                };
                met(&self.read, false) || met(&self.written, true)
            })
    }
}

/// What a debugger has attached to a node.
#[derive(Clone)]
pub(crate) struct Probe {
    stops: Stops,
    decoder: Decoder,
    footprint: Footprint,
    /// Steps that the node has carried out since the probe was attached.
    pub(crate) steps: u64,
    /// The cycle that belongs to the time of the stops, for the clock with this generation.
    due: (Cycles, Option<u32>),
    /// The watched range that something other than an instruction has written to.
    written: Option<Watch>,
    /// Why the node stopped.
    pub(crate) stop: Option<Stop>,
}

impl Probe {
    /// For a node with a flash of this size in bytes.
    pub(crate) fn new(flash: usize) -> Self {
        Self {
            stops: Stops::default(),
            decoder: Decoder::accesses(flash),
            footprint: Footprint::default(),
            steps: 0,
            due: (NEVER, None),
            written: None,
            stop: None,
        }
    }

    pub(crate) fn set_stops(&mut self, stops: Stops) {
        self.due = (NEVER, None);
        self.written = None;
        self.stops = stops;
    }

    pub(crate) fn take_footprint(&mut self) -> Footprint {
        std::mem::take(&mut self.footprint)
    }

    pub(crate) fn decoder(&mut self) -> &mut Decoder {
        &mut self.decoder
    }

    /// Something other than an instruction has written to these bytes.
    pub(crate) fn wrote(&mut self, bytes: Bytes) {
        self.footprint.accessed(bytes, true);
        let mut watches = self.stops.watches.iter();
        let hit = watches.find(|watch| watch.is_hit(bytes, true));
        self.written = self.written.or(hit.copied());
    }

    /// Whether a write by something other than an instruction stops the node, which may be asleep.
    pub(crate) fn stops_at_write(&mut self) -> bool {
        self.stop = self.written.take().map(Stop::Written);
        self.stop.is_some()
    }

    /// Whether the number of steps or the time stops the node before its next step, at this cycle. `limit` converts a time to the cycle from
    /// which on it has come; it is asked once for each generation of the clock.
    #[inline]
    pub(crate) fn stops_before_step(
        &mut self,
        now: Cycles,
        generation: u32,
        limit: impl Fn(SimTime) -> Cycles,
    ) -> bool {
        if let Some(time) = self.stops.time {
            if self.due.1 != Some(generation) {
                self.due = (limit(time), Some(generation));
            }
            if now >= self.due.0 {
                self.stop = Some(Stop::Time);
                return true;
            }
        }
        let stops = self.stops.step == Some(self.steps);
        if stops {
            self.stop = Some(Stop::Step);
        }
        stops
    }

    /// Whether the node stops before the instruction at `at`, which makes this access.
    #[inline]
    pub(crate) fn stops_before(&mut self, at: u32, access: Option<Access>) -> bool {
        set(&mut self.footprint.executed, at >> 1);
        let mut stop = None;
        if let Some(Access { bytes, writes }) = access {
            self.footprint.accessed(bytes, writes);
            let mut watches = self.stops.watches.iter();
            let hit = watches.find(|watch| watch.is_hit(bytes, writes));
            stop = hit.copied().map(Stop::Access);
        }
        if self.stops.breakpoints.contains(&at) {
            stop = Some(Stop::Breakpoint);
        }
        self.stop = stop;
        stop.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::{Footprint, Stops, Watch, Watched, set};
    use std::collections::BTreeSet;

    fn watching(first: u32, last: u32, kind: Watched) -> Stops {
        Stops {
            watches: BTreeSet::from([Watch { first, last, kind }]),
            ..Stops::default()
        }
    }

    #[test]
    fn a_footprint_knows_code_loads_and_stores() {
        let mut footprint = Footprint::default();
        set(&mut footprint.executed, 0x0800_0102 >> 1);
        footprint.accessed((0x2000_0006, 0x2000_0009), true);
        let mut joined = Footprint::default();
        joined.join(&footprint);
        let at = |address| Stops {
            breakpoints: BTreeSet::from([address]),
            ..Stops::default()
        };
        for footprint in [footprint, joined] {
            assert!(footprint.may_meet(&at(0x0800_0102)));
            assert!(!footprint.may_meet(&at(0x0800_0104)));
            assert!(!footprint.may_meet(&Stops::default()));
            for (first, kind, met) in [
                (0x2000_0004, Watched::Writes, true),
                (0x2000_0008, Watched::Accesses, true),
                (0x2000_0004, Watched::Reads, false),
                (0x2000_000C, Watched::Writes, false),
            ] {
                let stops = watching(first, first + 3, kind);
                assert_eq!(footprint.may_meet(&stops), met, "{stops:?}");
            }
        }
    }

    #[test]
    fn a_watch_is_hit_by_any_of_its_bytes_and_its_kind_of_access() {
        let hit = |kind, bytes, writes| {
            let watch = Watch {
                first: 0x2000_0004,
                last: 0x2000_0007,
                kind,
            };
            watch.is_hit(bytes, writes)
        };
        assert!(hit(Watched::Writes, (0x2000_0007, 0x2000_000A), true));
        assert!(!hit(Watched::Writes, (0x2000_0007, 0x2000_000A), false));
        assert!(hit(Watched::Reads, (0x2000_0000, 0x2000_0004), false));
        assert!(hit(Watched::Accesses, (0x2000_0005, 0x2000_0005), true));
        assert!(!hit(Watched::Accesses, (0x2000_0008, 0x2000_000B), true));
    }
}

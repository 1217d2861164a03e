//! Words of memory that keep the address which start-up wrote to them.
//!
//! A task that follows a pointer in a static variable pays the cost of the memory that the
//! pointer leads to, and finds the values that start-up left there. The analysis uses that
//! where it knows the pointer. It knows the pointer in a word if start-up, run on the abstract
//! machine with all tasks masked, leaves the same address in the word on every path, and no
//! store of a handler or of the idle code can reach the word afterwards.
//!
//! Which words a handler can reach depends in turn on where its own pointers lead. So all
//! handlers are run with every candidate word taken for granted; the words that one of their
//! stores may reach are dropped; and this is repeated until none is dropped. The remaining words
//! are proven by contradiction: the first store that changed one of them would run in a state
//! in which all of them still hold, and from such a state no store reaches them.
//!
//! A software task's future keeps its pointers in words that its handler has set. Such a word holds one of a few
//! addresses, if all stores of handlers and idle code that may reach it store just these, and to just this word:
//! they, and what start-up left there. What they store depends on where pointers lead, too, so the handlers are
//! run again with what was found, until nothing new is (`Stored::choices`).
//!
//! Only words that hold an address are kept. A variable whose address is given to a peripheral
//! is left out, as DMA may write there. A store at an unknown distance from the begin of a
//! static variable stays within the variable, as the language demands of all pointer
//! arithmetic. Any other store to an unknown address may reach every word.

use std::collections::{BTreeMap, BTreeSet};

use super::extent::Extent;
use super::image::FIRST_INTERRUPT;
use super::layout::{BIT_BAND, RAM, STACK};
use super::pend::Pend;
use super::range::Range;
use super::symbols::Symbols;
use super::value::Value;

/// Words by their addresses.
pub type Words = BTreeMap<u32, u32>;

/// Words that hold one of a few addresses, or zero, each by its own address.
pub type Choices = BTreeMap<u32, BTreeSet<u32>>;

/// Bytes that may have been written.
pub type Written = BTreeSet<Extent>;

/// Number of addresses up to which each is examined individually.
pub(crate) const FEW: u64 = 8;

/// A range of addresses that spans this much or more counts as unknown.
pub const FAR: u32 = 0x1_0000;

/// How to treat stores through unresolved pointers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnknownStores {
    /// They may change every word.
    ClobberAll,
    /// They change no word in which start-up left an address.
    SparePointers,
}

/// What a program is known to keep in its memory, from the time on at which a task can first run.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Known {
    /// Words that keep the address which start-up wrote to them.
    pub lasting: Words,
    /// Words that handlers set to one of a few addresses.
    pub choices: Choices,
}

/// What handlers and idle code store in the words of memory.
#[derive(Debug, Default, Clone)]
pub struct Stored {
    /// Addresses and zeros that are stored to exactly one word, by the address of that word.
    words: Choices,
    /// The bytes that all other stores may reach.
    other: Written,
}

impl Stored {
    /// Notes a store that may reach these bytes. It stores one of `addresses` there, if these are few and it reaches
    /// exactly one word.
    pub(crate) fn note(&mut self, reached: Extent, addresses: Option<Vec<u32>>) {
        match addresses {
            Some(words) => self.words.entry(reached.first).or_default().extend(words),
            None => {
                self.other.insert(reached);
            }
        }
    }

    /// Adds the stores of other code.
    pub(crate) fn extend(&mut self, other: Self) {
        for (at, words) in other.words {
            self.words.entry(at).or_default().extend(words);
        }
        self.other.extend(other.other);
    }

    /// Stores through unresolved pointers are taken to spare the words that hold addresses.
    pub(crate) fn spare(&mut self) {
        self.other.remove(&Extent::EVERYWHERE);
    }

    /// The words that hold one of a few addresses. `initial` is what start-up left in a word, if that is known.
    pub(crate) fn choices(self, initial: impl Fn(Extent) -> Option<u32>) -> Choices {
        let Self { words, other } = self;
        let all = words.into_iter().filter_map(|(at, mut words)| {
            let bytes = Extent::new(at, at.checked_add(3)?);
            if other.iter().any(|other| other.meet(bytes).is_some()) {
                return None;
            }
            words.insert(initial(bytes)?);
            // Zeros alone are no address. A debugger may write to such a word, as to the indices of a log.
            let leads = words.iter().any(|word| *word != 0);
            (leads && words.len() as u64 <= FEW).then_some((at, words))
        });
        all.collect()
    }
}

/// Facts about memory that the runs of the abstract machine collect.
#[derive(Debug, Default, Clone)]
pub struct Memory {
    /// Words that are taken for granted.
    pub lasting: std::rc::Rc<Words>,
    /// Whether no exception interrupts start-up and returns.
    pub starts_alone: bool,
    /// Words that are taken to hold one of a few addresses.
    pub choices: std::rc::Rc<Choices>,
    /// Bytes that may have been written since a task could first run.
    pub written: Written,
    /// What was stored since then.
    pub stored: Stored,
    /// Zeros that start-up may have overwritten when a task can first run.
    pub touched: Written,
    /// Exceptions that stores may make pending.
    pub pends: BTreeSet<Pend>,
    /// Words that memory holds when a task can first run, on every path so far.
    pub left: Option<Words>,
    /// While a function that copies or fills memory runs: the bytes outside the stack that it
    /// was called to write, if any.
    pub target: Option<Option<Extent>>,
    /// What was written to the registers of the system control space.
    pub system: SystemWrites,
    /// Bytes of variables whose address was given to a peripheral.
    pub lent: Written,
    /// Whether a byte is known that was written while `PRIMASK` was set.
    pub holds: bool,
    /// Those of these bytes that were read.
    pub trusted: Written,
    /// True if a path could not be followed, so that these facts may not hold.
    pub lost: bool,
}

impl Memory {
    /// Whether DMA may change a byte that was taken as known while `PRIMASK` was set.
    #[must_use]
    pub fn trusts_lent(lent: &Written, trusted: &Written) -> bool {
        let mut trusted = trusted.iter();
        trusted.any(|bytes| lent.iter().any(|lent| lent.meet(*bytes).is_some()))
    }
}

/// Bytes that were written to registers of the system control space, by their addresses: a byte
/// that is the same in all writes, else `None`.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct SystemWrites {
    bytes: BTreeMap<u32, Option<u8>>,
    /// The largest group that is written to `AIRCR` without a request for a reset; `None` beside an unknown
    /// word.
    group: Option<Option<u32>>,
}

impl SystemWrites {
    /// Priorities of interrupts, vector table, priorities of exceptions (DDI 0403 B3.2.2, B3.4.3).
    const REGISTERS: [Extent; 3] = [
        Extent::new(0xe000_e400, 0xe000_e5ef),
        Extent::new(VTOR, VTOR + 3),
        Extent::new(0xe000_ed18, 0xe000_ed23),
    ];

    /// Notes a word that is written to `AIRCR` and requests no reset: bits 8 to 10 are the group.
    pub(crate) fn note_group(&mut self, value: &Value) {
        self.add_group(value.as_constant().map(|word| (word >> 8) & 7));
    }

    fn add_group(&mut self, group: Option<u32>) {
        self.group = Some(match self.group {
            None => group,
            Some(known) => known.zip(group).map(|(known, group)| known.max(group)),
        });
    }

    /// Whether the program may group priorities so that one of `bits` bits no longer decides by each of
    /// them who interrupts whom (DDI 0403 B1.5.4).
    #[must_use]
    pub fn groups_priorities(&self, bits: u32) -> bool {
        match self.group {
            None => false,
            Some(group) => group.is_none_or(|group| group + bits > 7),
        }
    }

    /// Notes a store of the low `size` bytes of `value` to one of the addresses `reached`. The bytes of a
    /// word that are as they were `before`, if that is known, do not count.
    pub(crate) fn note(&mut self, reached: Extent, size: u32, value: &Value, before: Option<u32>) {
        let exact = reached.last - reached.first == size - 1;
        let word = value.as_constant().filter(|_| exact);
        for registers in Self::REGISTERS {
            let Some(both) = registers.meet(reached) else {
                continue;
            };
            for at in both.first..=both.last {
                let byte = |word: u32| (word >> (8 * (at - reached.first))) as u8;
                let (new, old) = (word.map(byte), before.map(byte));
                if new.is_none() || new != old {
                    self.add(at, new);
                }
            }
        }
    }

    fn add(&mut self, at: u32, byte: Option<u8>) {
        let known = self.bytes.entry(at).or_insert(byte);
        if *known != byte {
            *known = None;
        }
    }

    /// Adds the writes of other code.
    pub(crate) fn extend(&mut self, other: &Self) {
        for (&at, &byte) in &other.bytes {
            self.add(at, byte);
        }
        if let Some(group) = other.group {
            self.add_group(group);
        }
    }

    /// The priority value of an exception, by its number, as written: zero, the most urgent, if it is
    /// never written. `None` if different or unknown values are.
    #[must_use]
    pub fn priority(&self, exception: u16) -> Option<u8> {
        let number = u32::from(exception);
        let at = match number.checked_sub(u32::from(FIRST_INTERRUPT)) {
            Some(interrupt) => 0xe000_e400 + interrupt,
            None => 0xe000_ed14 + number,
        };
        self.bytes.get(&at).copied().unwrap_or(Some(0))
    }

    /// Whether the vector table may be moved away from `table`.
    #[must_use]
    pub fn moves_vectors(&self, table: u32) -> bool {
        let bytes = (VTOR..).zip(table.to_le_bytes());
        let mut written = bytes.filter_map(|(at, byte)| Some((self.bytes.get(&at)?, byte)));
        written.any(|(written, byte)| *written != Some(byte))
    }
}

/// The words of priorities of a core on which they can be written as words only, as they are after a reset
/// (Armv6-M Architecture Reference Manual B3.4.7, B3.2.9, B3.2.10).
pub(crate) fn reset_priorities() -> impl Iterator<Item = (u32, u32)> {
    let interrupts = (0..8).map(|register| 0xe000_e400 + 4 * register);
    interrupts
        .chain([0xe000_ed1c, 0xe000_ed20])
        .map(|at| (at, 0))
}

/// Whether a word of priorities is at this address.
#[must_use]
pub(crate) fn is_priorities(address: u32) -> bool {
    reset_priorities().any(|(at, _)| at == address)
}

/// Address of the register that holds the address of the vector table.
const VTOR: u32 = 0xe000_ed08;

impl Memory {
    /// Notes that a path lets tasks run for the first time, with these words in memory.
    pub fn enabled(&mut self, words: &Words) {
        match &mut self.left {
            None => {
                let words = words.iter().filter(|(at, _)| !is_priorities(**at));
                self.left = Some(words.map(|(at, word)| (*at, *word)).collect());
            }
            Some(left) => left.retain(|at, word| words.get(at) == Some(word)),
        }
    }
}

/// The bytes outside the stack that a store of `size` bytes to `address` may reach, if any.
#[must_use]
pub fn reach(symbols: &Symbols, address: &Value, size: u32) -> Option<Extent> {
    if address.stack && address.range.meet(STACK) == Some(address.range) {
        return None;
    }
    let (low, high) = match places(symbols, address) {
        Some(places) => {
            let mut others = places.into_iter().filter(|at| !STACK.contains(*at));
            let first = others.next()?;
            others.fold((first, first), |(low, high), at| {
                (low.min(at), high.max(at))
            })
        }
        None => address.range.unsigned(),
    };
    let high = high.saturating_add(size - 1);
    if BIT_BAND.contains(low) || BIT_BAND.contains(high) {
        return Some(Extent::EVERYWHERE);
    }
    let range = Extent::new(low, high);
    let within = symbols.indexed(address).or_else(|| symbols.origin(address));
    let both = within.and_then(|within| within.meet(range));
    let near = (range.span() < FAR).then_some(range);
    both.or(near).or(within).or(Some(Extent::EVERYWHERE))
}

/// Whether `address` is the sum of a constant address and an index without a limit. A constant part of the index may
/// have made the address that of another variable than the array, or of none, so any array may be meant.
#[must_use]
pub fn is_anywhere_in_arrays(symbols: &Symbols, address: &Value) -> bool {
    let of_data = |(_, offset): (_, Range)| offset.meet(RAM) == Some(offset);
    address.range.span() >= FAR
        && places(symbols, address).is_none()
        && (symbols.indexed(address).is_some() || address.base.is_some_and(of_data))
}

/// Every address that `address` may be, if these are few: a pointer that is null or leads to
/// the stack, say, or to one of a few variables.
#[must_use]
pub fn places(symbols: &Symbols, address: &Value) -> Option<Vec<u32>> {
    match symbols.targets(address) {
        Some(places) if places.len() as u64 <= FEW => Some(places),
        _ if address.range.count() <= FEW => Some(address.range.iter().collect()),
        _ => None,
    }
}

/// Drops the words that a store may reach; true if there are any.
pub fn drop_reached(words: &mut Words, written: &Written) -> bool {
    let before = words.len();
    words.retain(|&at, _| {
        !written
            .iter()
            .any(|reached| reached.first <= at.saturating_add(3) && at <= reached.last)
    });
    words.len() < before
}

#[cfg(test)]
mod tests {
    use super::SystemWrites;
    use crate::extent::Extent;
    use crate::value::Value;

    fn written(stores: &[(u32, u32, Value)]) -> SystemWrites {
        let mut writes = SystemWrites::default();
        for (at, size, value) in stores {
            writes.note(Extent::new(*at, at + size - 1), *size, value, None);
        }
        writes
    }

    #[test]
    fn priorities_are_as_written_last_and_always() {
        let byte = |word| Value::constant(word);
        let once = written(&[(0xe000_e407, 1, byte(0xe0)), (0xe000_ed23, 1, byte(0xd0))]);
        assert_eq!(once.priority(16 + 7), Some(0xe0));
        assert_eq!(once.priority(15), Some(0xd0));
        // Never written, so as after a reset.
        assert_eq!(once.priority(16 + 6), Some(0));
        assert_eq!(once.priority(14), Some(0));
        let all = written(&[(0xe000_e404, 4, byte(0x4030_2010))]);
        let priorities = (4..8).map(|interrupt| all.priority(16 + interrupt));
        assert!(priorities.eq([Some(0x10), Some(0x20), Some(0x30), Some(0x40)]));
        let twice = written(&[(0xe000_e407, 1, byte(0xe0)), (0xe000_e407, 1, byte(0x20))]);
        assert_eq!(twice.priority(16 + 7), None);
        let unknown = written(&[(0xe000_e407, 1, Value::ANY)]);
        assert_eq!(unknown.priority(16 + 7), None);
        let mut somewhere = SystemWrites::default();
        somewhere.note(Extent::new(0xe000_e400, 0xe000_e4ef), 1, &byte(0xe0), None);
        assert_eq!(somewhere.priority(16 + 7), None);
    }

    #[test]
    fn a_vector_table_that_moves_is_seen() {
        let table = 0x0800_0000;
        assert!(!SystemWrites::default().moves_vectors(table));
        let to = |value| written(&[(0xe000_ed08, 4, value)]).moves_vectors(table);
        assert!(!to(Value::constant(table)));
        assert!(to(Value::constant(0x2000_0000)));
        assert!(to(Value::ANY));
    }
}

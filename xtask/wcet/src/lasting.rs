//! Words of memory that start-up sets for good.
//!
//! What a task reaches through a pointer in a static variable costs what its
//! memory costs, and has the values that start-up left there, if it is known
//! where the pointer leads. It is known when start-up, run on the abstract
//! machine with interrupts off, leaves one address in the word on every path,
//! and no store of any handler, nor of the idle code, can reach the word
//! afterwards. Which words a handler can reach depends on where its own
//! pointers lead: all handlers are run with every candidate taken for granted,
//! the words that a store may reach are given up, and that is repeated until
//! none is. Then nothing contradicts the words that are left: the first store
//! that changed one would have to come from a state in which all still hold.
//!
//! Only words that hold an address are kept, and none of a variable whose address
//! a peripheral is told: DMA may write there. A store whose distance from the beginning of a static
//! variable is unknown stays within that variable, as the language demands of
//! all pointer arithmetic; any other store of unknown address leaves nothing.

use std::collections::{BTreeMap, BTreeSet};

use super::range::Range;
use super::state::{STACK, Symbols};
use super::value::Value;

/// Words by their addresses.
pub type Words = BTreeMap<u32, u32>;

/// Bytes that may have been written: the first and the last.
pub type Written = BTreeSet<(u32, u32)>;

/// Where the parts have flash.
const FLASH: Range = Range::between(0x0800_0000, 0x0fff_ffff);
/// Where they have RAM.
pub const RAM: Range = Range::between(0x1000_0000, 0x21ff_ffff);
/// Where a word stands for one bit of RAM.
const BIT_BAND: Range = Range::between(0x2200_0000, 0x23ff_ffff);

/// Addresses that are looked at one by one.
pub const FEW: u64 = 8;
/// The reach of a store of which nothing is known.
pub const EVERYWHERE: (u32, u32) = (0, u32::MAX);

/// Addresses spread over more than this are taken to be unknown.
pub const FAR: u32 = 0x1_0000;

/// What is thought of stores through pointers of which nothing is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Strangers {
    /// They may change every word.
    Change,
    /// They change no word in which start-up left an address.
    Spare,
}

/// What the runs of the abstract machine leave behind.
#[derive(Debug, Default, Clone)]
pub struct Memory {
    /// Words taken for granted.
    pub lasting: std::rc::Rc<Words>,
    /// What was written since interrupts were first enabled.
    pub written: Written,
    /// What memory holds when they are, on every path so far.
    pub left: Option<Words>,
    /// What the function that copies or fills memory is to write, while it
    /// runs: nothing outside the stack, or these bytes.
    pub target: Option<Option<(u32, u32)>>,
    /// Whether a path could not be followed so far as to say that.
    pub lost: bool,
}

/// Whether `word` may lead to memory.
#[must_use]
pub fn leads_to_memory(word: u32) -> bool {
    FLASH.contains(word) || RAM.contains(word)
}

impl Memory {
    /// Interrupts are enabled for the first time with memory like this.
    pub fn enabled(&mut self, words: &Words) {
        match &mut self.left {
            None => self.left = Some(words.clone()),
            Some(left) => left.retain(|at, word| words.get(at) == Some(word)),
        }
    }
}

/// First and last byte that a store of `size` bytes to `address` may reach
/// outside the stack, if any.
#[must_use]
pub fn reach(symbols: &Symbols, address: &Value, size: u32) -> Option<(u32, u32)> {
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
        return Some(EVERYWHERE);
    }
    let within = symbols.indexed(address).or_else(|| symbols.origin(address));
    let (first, last) = within.unwrap_or(EVERYWHERE);
    let both = (low.max(first), high.min(last));
    match within {
        Some(_) if both.0 <= both.1 => Some(both),
        _ if high - low < FAR => Some((low, high)),
        _ => Some((first, last)),
    }
}

/// Every address of a few: a pointer to the stack or null, or to one of some
/// variables.
#[must_use]
pub fn places(symbols: &Symbols, address: &Value) -> Option<Vec<u32>> {
    match symbols.elements(address) {
        Some(places) if places.len() as u64 <= FEW => Some(places),
        _ if address.range.count() <= FEW => Some(address.range.iter().collect()),
        _ => None,
    }
}

/// Gives up the words that a store may reach; whether there are any.
pub fn give_up(words: &mut Words, written: &Written) -> bool {
    let before = words.len();
    words.retain(|&at, _| {
        !written
            .iter()
            .any(|&(first, last)| first <= at.saturating_add(3) && at <= last)
    });
    words.len() < before
}

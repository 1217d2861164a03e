//! The flash memory with its accelerator: which line the core executes, which reads are running,
//! and which lines the caches certainly hold.
//!
//! The flash returns a line at a time. The reference manuals (RM0390 3.4.2, RM0316 4.2.2) say of it:
//!
//! - The line that the core executes is at hand. While the core executes it, the next one is read ahead.
//! - On a jump, a line that is neither of the two comes from the instruction cache without delay, or
//!   else is read and put into that cache. The cache holds the lines used last (LRU).
//! - Constants go through a cache of their own of the same kind. They never take the core's line away.
//!   Their reads have priority over those of instructions.
//!
//! What the manuals leave open is charged as the slower of all readings:
//!
//! - A read that has begun is not cancelled. One that is needed waits for its end.
//! - The core fetches up to three words ahead of the branch that it executes. So the line behind the branch may
//!   have become the core's line, and the reading ahead of the one behind that may have begun. The fetch ahead
//!   ends before the target of the branch is fetched.
//! - Whether a line that was read ahead is put into the cache, and whether its use there counts as a use, is not
//!   relied on.
//!
//! A path that is later than another one, or whose reads end later, stays so. So a state with the later
//! clock and the longer reads of two joined paths bounds both.

use std::collections::BTreeSet;
use std::rc::Rc;

use super::layout::STACK;
use super::part::Areas;
use super::range::Range;

/// How a part reads its flash at one core clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reads {
    /// The addresses at which the flash can be seen.
    pub flash: Areas,
    /// Bytes of a line.
    pub line_bytes: u32,
    /// Wait states of a read, in core cycles.
    pub waits: u64,
    /// Wait states of a word of code in RAM.
    pub ram_waits: u64,
    /// Whether the next line is read ahead. If not, or if it is not known, no line is taken to be at hand
    /// but the one that was fetched last, if no constant was read since.
    pub reads_ahead: bool,
    /// Lines of the instruction cache, zero without one.
    pub instruction_lines: usize,
    /// Lines of the cache of constants, zero without one.
    pub constant_lines: usize,
}

/// Begin of the flash beside the program: boot loader, one-time words, identity of the part (RM0390 3.3,
/// RM0316 4.2). It is not cached.
const SYSTEM: u32 = 0x1fff_0000;
/// First number of a word of code in RAM. Those of lines in flash are smaller.
const RAM: u32 = 0x8000_0000;

impl Reused {
    /// Adds those of `other`.
    pub(crate) fn extend(&mut self, other: &Self) {
        self.instructions.extend(&other.instructions);
        self.constants.extend(&other.constants);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.instructions.is_empty() && self.constants.is_empty()
    }
}

impl Reads {
    /// The number of an instruction's line, or of its word in RAM: over the system bus, code is fetched by
    /// words (Arm DDI 0337I 14.5).
    #[must_use]
    pub(crate) fn line(&self, address: u32) -> u32 {
        if self.flash.contains(address) {
            address / self.line_bytes.max(2)
        } else {
            RAM | (address / 4)
        }
    }

    /// Cycles of a whole read.
    const fn read(&self) -> u64 {
        self.waits + 1
    }

    /// Whether an access to a word in this range may read the flash, and whether it certainly does.
    #[must_use]
    pub(crate) fn reached(&self, address: Range) -> (bool, bool) {
        if address.meet(STACK) == Some(address) {
            return (false, false);
        }
        let (low, high) = address.unsigned();
        let possible = low > high || self.flash.meets(low, high);
        (possible, low <= high && self.flash.within(low, high))
    }

    /// Cycles that a job, or a part of it, may take longer after a preemption in which all lines of the caches
    /// were replaced.
    #[must_use]
    pub(crate) fn reload(&self, reused: &Reused) -> u64 {
        let lines = |lines: &BTreeSet<u32>, size: usize| lines.len().min(size) as u64;
        // A line that was a hit is read once more. It waits for a read that has begun, and what is read
        // ahead waits for it.
        lines(&reused.instructions, self.instruction_lines.max(1)) * 2 * self.read()
            + lines(&reused.constants, self.constant_lines) * 3 * self.read()
    }
}

/// Lines of which a bound assumes at some place that they are still at hand.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Reused {
    instructions: BTreeSet<u32>,
    constants: BTreeSet<u32>,
}

/// The lines that a cache certainly holds: each with the most other lines that were used since, in
/// ascending order of the lines (the must-analysis of Ferdinand and Wilhelm 1999).
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Cached(Rc<Vec<(u32, usize)>>);

impl Cached {
    fn age(&self, line: u32) -> Option<usize> {
        let at = self.0.binary_search_by_key(&line, |entry| entry.0).ok()?;
        Some(self.0[at].1)
    }

    fn holds(&self, line: u32) -> bool {
        self.age(line).is_some()
    }

    /// Lines younger than `age` become older by one, in a cache of `size` lines.
    fn older(&mut self, age: usize, size: usize, but: Option<u32>) {
        if self.0.is_empty() {
            return;
        }
        let lines = Rc::make_mut(&mut self.0);
        for (line, of) in lines.iter_mut() {
            if *of < age && Some(*line) != but {
                *of += 1;
            }
        }
        lines.retain(|(_, age)| *age < size);
    }

    /// The line is used: it is found, or replaces the line that was unused for longest.
    fn used(&mut self, line: u32, size: usize) {
        if size == 0 {
            return;
        }
        self.older(self.age(line).unwrap_or(size), size, Some(line));
        let lines = Rc::make_mut(&mut self.0);
        match lines.binary_search_by_key(&line, |entry| entry.0) {
            Ok(at) => lines[at].1 = 0,
            Err(at) => lines.insert(at, (line, 0)),
        }
    }

    /// The line, any one if `None`, may be used, or it may not.
    fn perhaps_used(&mut self, line: Option<u32>, size: usize) {
        let age = line.and_then(|line| self.age(line)).unwrap_or(size);
        self.older(age, size, line);
    }

    /// The lines that are not older in `next`.
    fn steady(&self, next: &Self) -> Self {
        if self == next {
            return self.clone();
        }
        let kept = self.0.iter();
        let kept = kept.filter(|(line, age)| next.age(*line).is_some_and(|next| next <= *age));
        Self(Rc::new(kept.copied().collect()))
    }

    /// What both hold.
    fn join(&self, other: &Self) -> Self {
        if Rc::ptr_eq(&self.0, &other.0) || self.0 == other.0 {
            return self.clone();
        }
        let both = self.0.iter();
        let both = both.filter_map(|(line, age)| Some((*line, other.age(*line)?.max(*age))));
        Self(Rc::new(both.collect()))
    }
}

/// What is known of the accelerator at one point of a path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Accelerator {
    /// The line that the core executes.
    line: Option<u32>,
    /// Whether a jump within this line finds it at hand, or in the cache.
    again: bool,
    /// Most cycles until the line behind it has been read ahead.
    ahead: u64,
    instructions: Cached,
    constants: Cached,
}

impl Accelerator {
    /// Nothing is known. One read may be running.
    pub(crate) fn unknown(reads: Option<Reads>) -> Self {
        Self {
            line: None,
            again: false,
            ahead: reads.map_or(0, |reads| reads.read()),
            instructions: Cached::default(),
            constants: Cached::default(),
        }
    }

    /// Time passes.
    pub(crate) const fn pass(&mut self, cycles: u64) {
        self.ahead = self.ahead.saturating_sub(cycles);
    }

    /// The last read is known to end in `ahead` cycles at the latest; no time has passed since then.
    pub(crate) const fn settle(&mut self, ahead: u64) {
        self.ahead = ahead;
    }

    /// The core goes on to the line of `address`, without a jump. Returns how long it waits; that time
    /// has passed.
    pub(crate) fn follow(&mut self, reads: Reads, address: u32, reused: &mut Reused) -> u64 {
        let line = reads.line(address);
        let held = self.line.replace(line);
        if held == Some(line) {
            return 0;
        }
        self.again = false;
        if line >= RAM {
            return 1 + reads.ram_waits;
        }
        if !reads.reads_ahead {
            return reads.waits;
        }
        let size = reads.instruction_lines;
        let next = held.is_some_and(|held| held + 1 == line);
        let wait = if self.instructions.holds(line) {
            reused.instructions.insert(line);
            self.ahead = self.ahead.min(reads.waits) + reads.read();
            0
        } else if next {
            std::mem::replace(&mut self.ahead, reads.read())
        } else {
            self.miss(reads)
        };
        self.instructions.perhaps_used(Some(line), size);
        wait
    }

    /// The core jumps to `target`, to an unknown place if `None`. Returns how long it waits; that time
    /// has passed.
    pub(crate) fn jump(&mut self, reads: Reads, target: Option<u32>, reused: &mut Reused) -> u64 {
        let size = reads.instruction_lines;
        let held = self.line.filter(|held| *held < RAM);
        let line = target.map(|target| reads.line(target));
        let line = line.filter(|line| *line < RAM);
        if !reads.reads_ahead {
            // A read that has begun, and the one of the target.
            self.line = line;
            return 2 * reads.waits;
        }
        // The core may have fetched the line behind the branch.
        self.instructions
            .perhaps_used(held.map(|held| held + 1), size);
        let Some(line) = line else {
            self.line = None;
            self.again = false;
            self.instructions.perhaps_used(None, size);
            return self.miss(reads);
        };
        let same = held == Some(line);
        let wait = if self.instructions.holds(line) || same && self.again {
            reused.instructions.insert(line);
            // The line behind the branch comes first. If it was there already, the next may have begun.
            let ahead = self.ahead.max(reads.waits) - self.ahead + reads.read();
            std::mem::replace(&mut self.ahead, ahead)
        } else {
            self.miss(reads)
        };
        // A line that may be at hand or read ahead does not go through the cache.
        if held.is_some_and(|held| !(held..=held + 2).contains(&line)) {
            self.instructions.used(line, size);
        } else {
            self.instructions.perhaps_used(Some(line), size);
        }
        self.line = Some(line);
        // Whether it was at hand or not, from now on it is at hand or in the cache.
        self.again = same && size > 0;
        wait
    }

    /// A line is read that is not at hand. Returns how long the core waits.
    fn miss(&mut self, reads: Reads) -> u64 {
        // The line behind the branch comes first, or the reading ahead of the next one has begun.
        let before = std::mem::replace(&mut self.ahead, reads.read()) + 1;
        before.max(reads.waits) + reads.waits
    }

    /// The core reads `count` words, of `size` bytes each, from the first address on. Returns how long it
    /// waits for the flash, and [`Self::settle`]s after the instruction, if there was a read. The
    /// wait states of words that may lie elsewhere are not in it.
    pub(crate) fn read(
        &mut self,
        reads: Reads,
        address: Range,
        (size, count): (u32, u32),
        reused: &mut Reused,
    ) -> (u64, Option<u64>) {
        let (possible, certain) = reads.reached(address);
        if !possible {
            return (0, None);
        }
        if !reads.reads_ahead {
            self.line = None;
            // An unaligned word lies in two lines, which is more than it takes to wait for a fetch.
            let each = if certain { 2 * reads.waits } else { 0 };
            return (reads.waits + u64::from(count) * each, None);
        }
        // A read ends in the cycle behind the one in which its line is there.
        let running = (self.ahead + 1).min(reads.waits);
        // What has not begun to be read ahead gives way.
        let settled = Some(if self.ahead >= reads.waits {
            reads.read()
        } else {
            0
        });
        let constants = reads.constant_lines;
        let first = address.as_constant().filter(|first| *first < SYSTEM);
        let Some(first) = first else {
            // An unaligned word lies in two lines at most.
            let lines = 2 * count;
            for _ in 0..lines {
                self.constants.perhaps_used(None, constants);
            }
            let unaligned = if size == 1 { 1 } else { 2 };
            let each = if certain { reads.waits * unaligned } else { 0 };
            return (running + u64::from(count) * each, settled);
        };
        let mut wait = 0;
        let mut missed = false;
        for word in 0..count {
            let at = first.wrapping_add(word * size);
            let lines = at / reads.line_bytes..=at.wrapping_add(size - 1) / reads.line_bytes;
            for line in lines {
                if self.constants.holds(line) {
                    reused.constants.insert(line);
                } else {
                    wait += if missed { 0 } else { running } + reads.waits;
                    missed = true;
                }
                self.constants.used(line, constants);
            }
        }
        (wait, settled.filter(|_| missed))
    }

    /// What is assumed to hold at the begin of every turn of a loop, of which one led from `before` to this.
    pub(crate) fn steady(&self, before: &Self) -> Self {
        let mut steady = self.clone();
        steady.weaken(before, self.ahead.max(before.ahead));
        steady.instructions = before.instructions.steady(&steady.instructions);
        steady.constants = before.constants.steady(&steady.constants);
        steady
    }

    /// Whether this, assumed at the begin of a turn, holds again behind it. If not, less is assumed from now
    /// on, so that few turns are needed to find what holds.
    pub(crate) fn holds(&mut self, after: &Self, reads: Option<Reads>) -> bool {
        let assumed = self.clone();
        let longest = reads.map_or(0, |reads| reads.waits + reads.read());
        let ahead = if after.ahead > self.ahead {
            longest.max(after.ahead)
        } else {
            self.ahead
        };
        self.weaken(after, ahead);
        self.instructions = self.instructions.steady(&after.instructions);
        self.constants = self.constants.steady(&after.constants);
        *self == assumed
    }

    fn weaken(&mut self, other: &Self, ahead: u64) {
        let same = self.line == other.line;
        self.line = self.line.filter(|_| same);
        self.again &= other.again && same;
        self.ahead = ahead;
    }

    /// What holds on both paths.
    pub(crate) fn join(&self, other: &Self) -> Self {
        let same = self.line == other.line;
        Self {
            line: self.line.filter(|_| same),
            again: self.again && other.again && same,
            ahead: self.ahead.max(other.ahead),
            instructions: self.instructions.join(&other.instructions),
            constants: self.constants.join(&other.constants),
        }
    }
}

#[cfg(test)]
mod tests;

//! Timing of the flash memory: wait states, prefetch and the line caches of the F446.
//!
//! The F446 (RM0390 3.4) reads lines of 128 bits. The instruction line buffer holds the line
//! fetched last. With PRFTEN the next line is prefetched; with ICEN a missed line enters an
//! instruction cache of 64 lines; with DCEN constants use a data cache of 8 lines. The F303 (RM0316
//! 4.2.2) reads 64 bits and has only the prefetch buffer.
//!
//! A full cache replaces the line that was unused for longest, of all lines (RM0390 3.4.2). The core
//! waits for a line that is still being read. A read that has begun is not cancelled: what is needed
//! meanwhile waits for its end. A prefetch that has not begun gives way to a constant, and to the
//! prefetch behind a later line.
//!
//! The core fetches up to three words ahead (Arm 100166 2.1). Where it jumps to another line, the model
//! lets it have fetched the two words behind the branch before, and waits for the end of that fetch.

use crate::clock::Cycles;
use crate::part::{Family, Part};
use rsemu::core::error::BusError;
use rsemu::core::space::{AccessConstraints, AccessPurpose, MemAttrs, MemOps, MemResult};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// A cache: line numbers, the most recently used first.
#[derive(Clone, Debug)]
struct Lines {
    lines: Vec<u32>,
    size: usize,
}

impl Lines {
    fn new(size: usize) -> Self {
        Self {
            lines: Vec::with_capacity(size),
            size,
        }
    }

    /// True on a hit; the line becomes the most recently used.
    fn hit(&mut self, line: u32) -> bool {
        let Some(at) = self.lines.iter().position(|&held| held == line) else {
            return false;
        };
        self.lines[..=at].rotate_right(1);
        true
    }

    fn insert(&mut self, line: u32) {
        if self.lines.len() >= self.size {
            self.lines.pop();
        }
        if self.size > 0 {
            self.lines.insert(0, line);
        }
    }
}

/// The fields of FLASH_ACR that affect timing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Control {
    wait_states: u64,
    prefetch: bool,
    instruction_cache: bool,
    data_cache: bool,
}

impl Control {
    fn from_acr(family: Family, acr: u32) -> Self {
        let bit = |n: u32| acr >> n & 1 != 0;
        match family {
            Family::F4 => Self {
                wait_states: u64::from(acr & 0xF),
                prefetch: bit(8),
                instruction_cache: bit(9),
                data_cache: bit(10),
            },
            Family::F3 => Self {
                wait_states: u64::from(acr & 7),
                prefetch: bit(4),
                ..Self::default()
            },
        }
    }
}

/// Bytes behind a branch that the core has fetched when the branch is executed.
const FETCHED_AHEAD: u32 = 8;
/// Cycles from a branch to the fetch at its target, as the emulated core counts.
const REFILL: Cycles = 2;

/// Stands for "no line". A line number is an address divided by the line size and never becomes
/// this large.
const NONE: u32 = u32::MAX;

#[derive(Clone, Debug)]
struct Accelerator {
    control: Control,
    /// Line in the instruction line buffer.
    current: u32,
    /// When the flash has ended the reads that were needed at once.
    free: Cycles,
    /// When the prefetch of the line behind the current one begins.
    next_begin: Cycles,
    instructions: Lines,
    constants: Lines,
}

impl Accelerator {
    fn new(part: &Part) -> Self {
        Self {
            control: Control::default(),
            current: NONE,
            free: 0,
            next_begin: Cycles::MAX,
            instructions: Lines::new(part.flash_access.instruction_lines),
            constants: Lines::new(part.flash_access.data_lines),
        }
    }

    /// Whether the prefetch has begun before `now`.
    fn reads_ahead(&self, now: Cycles) -> bool {
        self.control.prefetch && self.next_begin < now
    }

    /// When the flash can begin with a read that is needed at `now`.
    fn begin(&self, now: Cycles) -> Cycles {
        let running = if self.reads_ahead(now) {
            self.next_begin + self.control.wait_states + 1
        } else {
            0
        };
        now.max(self.free).max(running)
    }

    /// Cycles that the core waits for an instruction in a new line requested at `now`.
    fn fetch(&mut self, line: u32, now: Cycles) -> Cycles {
        let control = self.control;
        let ahead = control.prefetch && self.current.checked_add(1) == Some(line);
        let begin = self.begin(now);
        let wait = if control.instruction_cache && self.instructions.hit(line) {
            self.free = begin;
            0
        } else if ahead {
            let there = self.next_begin + control.wait_states;
            // The read ends in the next cycle.
            self.free = begin.max(there + 1);
            there.saturating_sub(now)
        } else {
            if control.instruction_cache {
                self.instructions.insert(line);
            }
            begin - now + control.wait_states
        };
        self.current = line;
        // The prefetch of the next line starts when this line has arrived.
        self.next_begin = (now + wait + 1).max(self.free);
        wait
    }

    /// Cycles that the core waits for a line to which it jumps at `now`, from a branch that ends before the
    /// address `end`.
    fn jump(&mut self, line: u32, now: Cycles, end: u32, line_bytes: u32) -> Cycles {
        let behind = (end + FETCHED_AHEAD - 1) / line_bytes;
        let next = self.current.checked_add(1);
        if !self.control.prefetch || next.is_none_or(|next| behind < next || line == next) {
            return self.fetch(line, now);
        }
        let branch = now.saturating_sub(REFILL);
        let ahead = next.map_or(0, |next| self.fetch(next, branch));
        let late = (branch + ahead).saturating_sub(now);
        late + self.fetch(line, now + late)
    }

    /// Cycles that the core waits for a constant requested at `now`.
    fn constant(&mut self, line: u32, now: Cycles) -> Cycles {
        if self.control.data_cache {
            if self.constants.hit(line) {
                return 0;
            }
            self.constants.insert(line);
        }
        let wait = self.begin(now) - now + self.control.wait_states;
        self.free = now + wait + 1;
        if !self.reads_ahead(now) {
            self.next_begin = self.next_begin.max(self.free);
        }
        wait
    }
}

/// The flash memory on the core's bus, with its access times.
#[derive(Debug)]
pub(crate) struct TimedFlash {
    part: &'static Part,
    image: Arc<[u8]>,
    line_bytes: u32,
    accelerator: Mutex<Accelerator>,
    /// A copy of [`Accelerator::current`] that needs no lock.
    current: AtomicU32,
    /// FLASH_ACR as last passed to [`TimedFlash::set_control`].
    acr: AtomicU32,
    now: AtomicU64,
    stall: AtomicU64,
    /// Address behind the instruction that was fetched last.
    next: AtomicU32,
}

impl TimedFlash {
    pub(crate) fn new(part: &'static Part, image: Arc<[u8]>) -> Self {
        Self {
            part,
            image,
            line_bytes: part.flash_access.line_bytes,
            accelerator: Mutex::new(Accelerator::new(part)),
            current: AtomicU32::new(NONE),
            acr: AtomicU32::new(0),
            now: AtomicU64::new(0),
            stall: AtomicU64::new(0),
            next: AtomicU32::new(0),
        }
    }

    /// The same flash in the same state.
    pub(crate) fn copy(&self) -> Self {
        let same = |number: &AtomicU64| AtomicU64::new(number.load(Ordering::Relaxed));
        let short = |number: &AtomicU32| AtomicU32::new(number.load(Ordering::Relaxed));
        Self {
            part: self.part,
            image: Arc::clone(&self.image),
            line_bytes: self.line_bytes,
            accelerator: Mutex::new(crate::peripheral::lock(&self.accelerator).clone()),
            current: short(&self.current),
            acr: short(&self.acr),
            now: same(&self.now),
            stall: same(&self.stall),
            next: short(&self.next),
        }
    }

    /// The core starts an instruction at `now`.
    #[inline]
    pub(crate) fn set_now(&self, now: Cycles) {
        self.now.store(now, Ordering::Relaxed);
    }

    /// Cycles that the core has waited since the last call.
    #[inline]
    pub(crate) fn take_stall(&self) -> Cycles {
        let stall = self.stall.load(Ordering::Relaxed);
        if stall != 0 {
            self.stall.store(0, Ordering::Relaxed);
        }
        stall
    }

    /// Applies a new FLASH_ACR. A change empties the caches.
    pub(crate) fn set_control(&self, acr: u32) {
        if self.acr.swap(acr, Ordering::Relaxed) != acr {
            let mut accelerator = crate::peripheral::lock(&self.accelerator);
            *accelerator = Accelerator::new(self.part);
            accelerator.control = Control::from_acr(self.part.family, acr);
            self.current.store(NONE, Ordering::Relaxed);
        }
    }

    /// An exception begins or ends: the core goes on elsewhere, but not by a branch.
    pub(crate) fn switch(&self) {
        self.next.store(NONE, Ordering::Relaxed);
    }

    /// Empties the caches: another program may have run before.
    pub(crate) fn empty(&self) {
        let mut accelerator = crate::peripheral::lock(&self.accelerator);
        accelerator.instructions.lines.clear();
        accelerator.constants.lines.clear();
    }

    #[inline]
    pub(crate) fn charge(&self, offset: u32, size: u32, fetch: bool) {
        let line = offset / self.line_bytes;
        let end = if fetch {
            let end = self.next.load(Ordering::Relaxed);
            self.next.store(offset + size, Ordering::Relaxed);
            end
        } else {
            offset
        };
        if fetch && line == self.current.load(Ordering::Relaxed) {
            return;
        }
        let mut accelerator = crate::peripheral::lock(&self.accelerator);
        let so_far = self.stall.load(Ordering::Relaxed);
        let now = self.now.load(Ordering::Relaxed) + so_far;
        let wait = if fetch {
            self.current.store(line, Ordering::Relaxed);
            if end == offset || end == NONE {
                accelerator.fetch(line, now)
            } else {
                accelerator.jump(line, now, end, self.line_bytes)
            }
        } else {
            accelerator.constant(line, now)
        };
        self.stall.store(so_far + wait, Ordering::Relaxed);
    }
}

impl MemOps for TimedFlash {
    fn read(&self, offset: u64, dst: &mut [u8], attrs: MemAttrs) -> MemResult {
        let start = offset as usize;
        let source = self.image.get(start..start + dst.len());
        dst.copy_from_slice(source.ok_or(BusError::BadAccess)?);
        if !attrs.debug {
            let fetch = attrs.purpose == AccessPurpose::FETCH;
            self.charge(offset as u32, dst.len() as u32, fetch);
        }
        Ok(())
    }

    fn write(&self, _offset: u64, _src: &[u8], _attrs: MemAttrs) -> MemResult {
        // What can be programmed is a region of its own.
        Err(BusError::BadAccess)
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}

#[cfg(test)]
mod tests {
    use super::{Accelerator, Control};
    use crate::part::Part;

    fn f446(acr: u32) -> Accelerator {
        let mut accelerator = Accelerator::new(Part::F446);
        accelerator.control = Control::from_acr(Part::F446.family, acr);
        accelerator
    }

    #[test]
    fn without_prefetch_and_caches_every_new_line_waits() {
        let mut flash = f446(5);
        assert_eq!(flash.fetch(10, 0), 5);
        assert_eq!(flash.fetch(11, 100), 5);
        assert_eq!(flash.fetch(10, 200), 5);
        assert_eq!((flash.constant(3, 300), flash.constant(3, 400)), (5, 5));
    }

    #[test]
    fn the_next_line_is_read_while_this_one_is_executed() {
        let mut flash = f446(5 | 1 << 8);
        assert_eq!(flash.fetch(10, 100), 5);
        // The line arrives at cycle 105, the next one 6 cycles later.
        assert_eq!(flash.fetch(11, 108), 3);
        assert_eq!(flash.fetch(12, 120), 0);
        assert_eq!(flash.fetch(14, 140), 5, "not the next line");
    }

    #[test]
    fn a_loop_waits_the_first_time_only() {
        let mut flash = f446(5 | 1 << 9);
        let mut now = 0;
        let round = |flash: &mut Accelerator, now: &mut u64| {
            (0..4).fold(0, |waits, line| {
                *now += 10;
                waits + flash.fetch(line, *now)
            })
        };
        assert_eq!(round(&mut flash, &mut now), 20);
        assert_eq!(round(&mut flash, &mut now), 0);
        for line in 100..160 {
            flash.fetch(line, now);
        }
        assert_eq!(round(&mut flash, &mut now), 0, "64 lines fit");
        for line in 200..264 {
            flash.fetch(line, now);
        }
        assert_eq!(round(&mut flash, &mut now), 20, "pushed out");
    }

    #[test]
    fn what_is_needed_waits_for_a_read_that_has_begun() {
        let mut flash = f446(5 | 7 << 8);
        assert_eq!(flash.fetch(10, 100), 5);
        // The prefetch of line 11 takes the cycles 106 to 111.
        assert_eq!(flash.fetch(40, 108), 4 + 5);
        // Its prefetch would take the cycles 118 to 123, and has not begun.
        assert_eq!(flash.constant(3, 117), 5);
        // It begins at 123, behind the constant.
        assert_eq!(flash.constant(4, 125), 4 + 5);
        assert_eq!(flash.fetch(41, 135), 0);
        // A hit does not wait, and what is read ahead for nothing delays the next line.
        assert_eq!(flash.fetch(10, 138), 0);
        assert_eq!(flash.fetch(11, 140), 142 + 5 - 140);
    }

    #[test]
    fn a_branch_waits_for_what_the_core_has_fetched_behind_it() {
        let mut flash = f446(5 | 7 << 8);
        assert_eq!(flash.fetch(10, 100), 5);
        // Line 11 comes at 111, and the read ends behind that. The branch ends at byte 10 of the line.
        let mut other = f446(5 | 7 << 8);
        assert_eq!(other.fetch(10, 100), 5);
        assert_eq!(other.jump(40, 109, 10 * 16 + 10, 16), 2 + 6);
        // The words behind this branch are in its own line, so only the running read is waited for.
        assert_eq!(flash.jump(40, 109, 10 * 16 + 8, 16), 3 + 5);
    }

    #[test]
    fn eight_lines_of_constants_are_kept() {
        let mut flash = f446(5 | 1 << 10);
        let all: u64 = (0..8)
            .map(|line| flash.constant(line, 10 * u64::from(line)))
            .sum();
        assert_eq!(all, 40);
        assert_eq!(flash.constant(0, 100), 0);
        assert_eq!(flash.constant(8, 110), 5);
        assert_eq!(flash.constant(0, 120), 0, "used last");
        assert_eq!(flash.constant(1, 130), 5, "unused longest");
    }

    #[test]
    fn the_f303_keeps_nothing_but_reads_ahead() {
        let mut flash = Accelerator::new(Part::F303);
        flash.control = Control::from_acr(Part::F303.family, 0x32);
        assert_eq!(flash.fetch(1, 0), 2);
        assert_eq!(flash.fetch(2, 5), 0);
        assert_eq!(flash.fetch(1, 10), 2);
        assert_eq!((flash.constant(7, 20), flash.constant(7, 30)), (2, 2));
    }
}

//! Timing of the flash memory: wait states, prefetch and the line caches of the F446.
//!
//! The F446 (RM0390 3.4) reads lines of 128 bits. The instruction line buffer holds the line
//! fetched last. With PRFTEN the next line is prefetched; with ICEN a missed line enters an
//! instruction cache of 64 lines; with DCEN constants use a data cache of 8 lines. The F303 (RM0316
//! 4.2.2) reads 64 bits and has only the prefetch buffer.
//!
//! The manual does not say how the caches are organised or which line they replace. The model
//! assumes full associativity and replaces the least recently used line, so a real part may miss
//! more often. The core waits for a line that is still being read. Reads of constants and
//! prefetches do not delay each other.

use crate::clock::Cycles;
use crate::part::{Family, Part};
use rsemu::core::error::BusError;
use rsemu::core::space::{AccessConstraints, AccessPurpose, MemAttrs, MemOps, MemResult};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// A cache: line numbers, the most recently used first.
#[derive(Debug)]
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

/// Stands for "no line". A line number is an address divided by the line size and never becomes
/// this large.
const NONE: u32 = u32::MAX;

#[derive(Debug)]
struct Accelerator {
    control: Control,
    /// Line in the instruction line buffer.
    current: u32,
    /// When the prefetched line is available.
    next_ready: Cycles,
    instructions: Lines,
    constants: Lines,
}

impl Accelerator {
    fn new(part: &Part) -> Self {
        Self {
            control: Control::default(),
            current: NONE,
            next_ready: 0,
            instructions: Lines::new(part.flash_access.instruction_lines),
            constants: Lines::new(part.flash_access.data_lines),
        }
    }

    /// Cycles that the core waits for an instruction in a new line requested at `now`.
    fn fetch(&mut self, line: u32, now: Cycles) -> Cycles {
        let control = self.control;
        let ahead = control.prefetch && line == self.current.wrapping_add(1);
        let wait = if control.instruction_cache && self.instructions.hit(line) {
            0
        } else if ahead {
            self.next_ready.saturating_sub(now).min(control.wait_states)
        } else {
            if control.instruction_cache {
                self.instructions.insert(line);
            }
            control.wait_states
        };
        self.current = line;
        // The prefetch of the next line starts when this line has arrived.
        self.next_ready = now + wait + control.wait_states + 1;
        wait
    }

    /// Cycles that the core waits for a constant.
    fn constant(&mut self, line: u32) -> Cycles {
        if self.control.data_cache {
            if self.constants.hit(line) {
                return 0;
            }
            self.constants.insert(line);
        }
        self.control.wait_states
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

    #[inline]
    fn charge(&self, offset: u32, fetch: bool) {
        let line = offset / self.line_bytes;
        if fetch && line == self.current.load(Ordering::Relaxed) {
            return;
        }
        let mut accelerator = crate::peripheral::lock(&self.accelerator);
        let so_far = self.stall.load(Ordering::Relaxed);
        let wait = if fetch {
            self.current.store(line, Ordering::Relaxed);
            accelerator.fetch(line, self.now.load(Ordering::Relaxed) + so_far)
        } else {
            accelerator.constant(line)
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
            self.charge(offset as u32, attrs.purpose == AccessPurpose::FETCH);
        }
        Ok(())
    }

    fn write(&self, _offset: u64, _src: &[u8], _attrs: MemAttrs) -> MemResult {
        // Programming is not modelled.
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
        assert_eq!((flash.constant(3), flash.constant(3)), (5, 5));
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
    fn eight_lines_of_constants_are_kept() {
        let mut flash = f446(5 | 1 << 10);
        let all: u64 = (0..8).map(|line| flash.constant(line)).sum();
        assert_eq!(all, 40);
        assert_eq!(flash.constant(0), 0);
        assert_eq!(flash.constant(8), 5);
        assert_eq!(flash.constant(0), 0, "used last");
        assert_eq!(flash.constant(1), 5, "unused longest");
    }

    #[test]
    fn the_f303_keeps_nothing_but_reads_ahead() {
        let mut flash = Accelerator::new(Part::F303);
        flash.control = Control::from_acr(Part::F303.family, 0x32);
        assert_eq!(flash.fetch(1, 0), 2);
        assert_eq!(flash.fetch(2, 5), 0);
        assert_eq!(flash.fetch(1, 10), 2);
        assert_eq!((flash.constant(7), flash.constant(7)), (2, 2));
    }
}

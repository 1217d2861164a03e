//! Charges against random accelerators that the manuals allow.

use std::collections::VecDeque;
use std::rc::Rc;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::{Accelerator, Cached, Reads, Reused};
use crate::part::Areas;
use crate::range::Range;

const F446: Reads = Reads {
    flash: Areas::new(&[(0, 0x0fff_ffff)]),
    line_bytes: 16,
    waits: 5,
    ram_waits: 1,
    reads_ahead: true,
    instruction_lines: 64,
    constant_lines: 8,
};
const F303: Reads = Reads {
    line_bytes: 8,
    waits: 2,
    instruction_lines: 0,
    constant_lines: 0,
    ..F446
};
/// Caches so small that lines are replaced all the time.
const SMALL: Reads = Reads {
    instruction_lines: 4,
    constant_lines: 2,
    ..F446
};

/// A cache, the line used last in front.
#[derive(Clone)]
struct Lru(VecDeque<u32>, usize);

impl Lru {
    fn take(&mut self, line: u32) -> bool {
        let at = self.0.iter().position(|held| *held == line);
        if let Some(at) = at {
            self.0.remove(at);
            self.0.push_front(line);
        }
        at.is_some()
    }

    fn put(&mut self, line: u32) {
        if !self.take(line) && self.1 > 0 {
            self.0.truncate(self.1 - 1);
            self.0.push_front(line);
        }
    }
}

/// An accelerator that does one of the things that the manuals leave open.
#[derive(Clone)]
struct Part {
    reads: Reads,
    /// Whether the core fetches ahead of a branch.
    fetches_ahead: bool,
    /// Whether a line that was read ahead and is used goes into the cache.
    keeps_ahead: bool,
    /// Whether its use there counts.
    counts_ahead: bool,
    now: u64,
    line: u32,
    /// When the read in progress ends.
    free: u64,
    /// When the reading ahead begins.
    begin: u64,
    instructions: Lru,
    constants: Lru,
}

impl Part {
    fn random(reads: Reads, random: &mut ChaCha8Rng) -> Self {
        let mut lines = |size: usize| {
            let all = (0..size).map(|_| random.next_u32() % 400).collect();
            Lru(all, size)
        };
        let (instructions, constants) =
            (lines(reads.instruction_lines), lines(reads.constant_lines));
        let mut coin = || random.next_u32() & 1 == 0;
        Self {
            reads,
            fetches_ahead: coin(),
            keeps_ahead: coin(),
            counts_ahead: coin(),
            now: 0,
            line: random.next_u32() % 400,
            free: 0,
            begin: u64::from(random.next_u32() % 2),
            instructions,
            constants,
        }
    }

    /// When the flash can begin with something that is needed now.
    fn next(&self) -> u64 {
        let running = (self.begin < self.now).then(|| self.begin + self.reads.waits + 1);
        self.now.max(self.free).max(running.unwrap_or(0))
    }

    /// Requests a line of code. Time passes until it is there.
    fn request(&mut self, line: u32) {
        if line == self.line {
            return;
        }
        let next = self.next();
        let held = self.instructions.0.contains(&line);
        let ahead = line == self.line + 1;
        if held && (!ahead || self.counts_ahead) {
            self.instructions.take(line);
        }
        if held {
            self.free = next;
        } else if ahead {
            self.now = self.now.max(self.begin + self.reads.waits);
            // The read itself ends in the next cycle.
            self.free = self.free.max(self.begin + self.reads.waits + 1);
            if self.keeps_ahead {
                self.instructions.put(line);
            }
        } else {
            self.now = next + self.reads.waits;
            self.instructions.put(line);
        }
        self.line = line;
        self.begin = self.free.max(self.now + 1);
    }

    /// Jumps to `line`, and has fetched ahead `early` cycles before, if it does so here.
    fn jump(&mut self, line: u32, early: Option<u64>) {
        if let Some(early) = early.filter(|_| self.fetches_ahead) {
            let before = self.now;
            self.now = before.saturating_sub(early).max(self.begin.min(before));
            self.request(self.line + 1);
            self.now = self.now.max(before);
        }
        self.request(line);
    }

    /// All that there is to know of it.
    fn known(&self) -> Accelerator {
        let cached = |lines: &Lru| {
            let mut lines: Vec<(u32, usize)> = lines.0.iter().copied().zip(0..).collect();
            lines.sort_unstable();
            Cached(Rc::new(lines))
        };
        Accelerator {
            line: Some(self.line),
            again: false,
            ahead: (self.begin + self.reads.waits).saturating_sub(self.now),
            instructions: cached(&self.instructions),
            constants: cached(&self.constants),
        }
    }

    fn constant(&mut self, address: u32) {
        let line = address / self.reads.line_bytes;
        if self.constants.take(line) {
            return;
        }
        self.constants.put(line);
        let begun = self.begin < self.now;
        self.now = self.next() + self.reads.waits;
        self.free = self.now + 1;
        if !begun {
            self.begin = self.begin.max(self.free);
        }
    }
}

/// A walk through code whose clock is charged, beside parts that take it.
struct Walk {
    state: Accelerator,
    charged: u64,
    reused: Reused,
    reads: Reads,
}

impl Walk {
    fn spend(&mut self, cycles: u64) {
        self.state.pass(cycles);
        self.charged += cycles;
    }
}

#[derive(Clone, Copy, Debug)]
enum Step {
    /// Instructions up to an address in this line or the next.
    On(u32),
    Jump(u32, Option<u64>),
    Constant(u32),
    Unknown(u32),
}

fn step(walk: &mut Walk, part: &mut Part, at: &mut u32, step: Step, time: u64) {
    let reads = walk.reads;
    match step {
        Step::On(bytes) => {
            *at += bytes;
            walk.charged += walk.state.follow(reads, *at, &mut walk.reused);
            walk.spend(time);
            part.request(*at / reads.line_bytes);
            part.now += time;
        }
        Step::Jump(target, early) => {
            walk.charged += walk.state.jump(reads, Some(target), &mut walk.reused) + 3;
            // The part fills its pipeline before or behind the fetch, in part at the same time.
            let before = time % 3;
            part.now += before;
            part.jump(target / reads.line_bytes, early);
            part.now += 3 - before;
            *at = target;
        }
        Step::Constant(address) | Step::Unknown(address) => {
            let known = matches!(step, Step::Constant(_));
            let range = if known {
                Range::constant(address)
            } else {
                Range::between(0, 400 * reads.line_bytes)
            };
            let (wait, settled) = walk.state.read(reads, range, (4, 1), &mut walk.reused);
            walk.spend(wait + time);
            if let Some(ahead) = settled {
                walk.state.settle(ahead);
            }
            part.constant(address);
            part.now += time;
        }
    }
    assert!(
        walk.charged >= part.now,
        "charged {}, took {}",
        walk.charged,
        part.now
    );
}

fn any_step(random: &mut ChaCha8Rng, at: u32, reads: Reads, places: &[u32]) -> Step {
    let mut below = |n: usize| random.next_u32() as usize % n;
    let place = |below: &mut dyn FnMut(usize) -> usize| places[below(places.len())];
    match below(12) {
        0..6 => Step::On(2 * (1 + below(2) as u32)),
        6 => Step::Jump(
            at + 2 * below(reads.line_bytes as usize * 2) as u32,
            Some(below(9) as u64),
        ),
        7 | 8 => {
            let early = (below(3) > 0).then(|| below(9) as u64);
            Step::Jump(place(&mut below), early)
        }
        9 | 10 => Step::Constant(place(&mut below) & !3),
        _ => Step::Unknown(place(&mut below) & !3),
    }
}

/// Walks random streams of instructions on parts that differ in all that is open. Each walk begins with
/// all knowledge of its part and is short, so that no charge hides behind the reserve of another one.
fn compare(reads: Reads, streams: u64) {
    for seed in 0..streams {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let places: Vec<u32> = (0..2 + random.next_u32() % 8)
            .map(|_| (random.next_u32() % (300 * reads.line_bytes)) & !1)
            .collect();
        let mut part = Part::random(reads, &mut random);
        let mut at = places[0];
        for _ in 0..12 {
            part.jump(at / reads.line_bytes, None);
            let mut walk = Walk {
                state: part.known(),
                charged: part.now,
                reused: Reused::default(),
                reads,
            };
            let joined = random.next_u32() % 4 == 0;
            for _ in 0..random.next_u32() % 10 {
                let next = any_step(&mut random, at, reads, &places);
                let time = u64::from(random.next_u32() % 4);
                step(&mut walk, &mut part, &mut at, next, time);
                // A path with another history meets this one.
                if joined && random.next_u32() % 6 == 0 {
                    let other = Part::random(reads, &mut random).known();
                    walk.state = walk.state.join(&other);
                }
            }
        }
    }
}

#[test]
fn no_accelerator_that_the_manual_allows_is_slower() {
    compare(F446, 4_000);
    compare(F303, 4_000);
    compare(SMALL, 12_000);
}

/// Charges of single steps: sequential code, a loop, constants.
#[test]
fn what_is_at_hand_is_not_waited_for() {
    let mut state = Accelerator::unknown(Some(F446));
    let mut reused = Reused::default();
    let mut follow = |state: &mut Accelerator, at: u32| state.follow(F446, at, &mut reused);
    // A read may be running when the handler begins.
    assert_eq!(follow(&mut state, 0x100), 7 + 5);
    assert_eq!(follow(&mut state, 0x10e), 0);
    state.pass(4);
    assert_eq!(follow(&mut state, 0x110), 2, "read ahead for 4 of 6 cycles");
    state.pass(8);
    assert_eq!(follow(&mut state, 0x120), 0);
    let mut reused = Reused::default();
    // The line behind the branch, and then the target.
    assert_eq!(state.jump(F446, Some(0x400), &mut reused), 7 + 5);
    state.pass(20);
    assert_eq!(state.jump(F446, Some(0x200), &mut reused), 5 + 5);
    state.pass(20);
    assert!(reused.instructions.is_empty());
    assert_eq!(state.jump(F446, Some(0x40e), &mut reused), 0, "cached");
    assert!(reused.instructions.contains(&0x40));
    state.pass(20);
    let constant = Range::constant(0x80);
    let mut read = |state: &mut Accelerator| state.read(F446, constant, (4, 1), &mut reused).0;
    assert_eq!((read(&mut state), read(&mut state)), (1 + 5, 0));
    assert_eq!(F446.reload(&reused), 2 * 6 + 3 * 6);
    // Elsewhere than in flash, nothing is waited for.
    let stack = Range::constant(0x2000_0000);
    assert_eq!(state.read(F446, stack, (4, 1), &mut reused), (0, None));
}

/// A loop over more lines than the cache has does not find its first one again. Each of its jumps may
/// have used the line behind the branch, too.
#[test]
fn a_line_leaves_the_cache_behind_as_many_others() {
    for (lines, found) in [(2, true), (3, false)] {
        let mut state = Accelerator::unknown(Some(SMALL));
        let mut reused = Reused::default();
        state.follow(SMALL, 0x8000, &mut reused);
        for line in (0..lines).chain([0]) {
            state.jump(SMALL, Some(0x1000 + 0x100 * line), &mut reused);
        }
        assert_eq!(!reused.instructions.is_empty(), found, "{lines}");
    }
}

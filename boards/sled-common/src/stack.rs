//! How deep the stack has ever been.
//!
//! cortex-m-rt fills the stack with a pattern before the program begins. What still holds the
//! pattern at the lower end was never used.

/// Words that one step looks at: a pass over the largest stack of the boards, 4096 words, takes 32
/// steps.
const STEP_WORDS: u16 = 128;

/// Measures the bytes of the stack that were never used, a few words in each step and pass after
/// pass: from the lower end upwards, until a word was used.
pub struct Gauge {
    /// The word with which the next step begins.
    next: u16,
    /// Bytes, of the last whole pass.
    unused: u16,
}

impl Gauge {
    /// A gauge with one whole pass behind it, which takes a few cycles for each free word.
    pub fn begin() -> Self {
        let mut gauge = Self { next: 0, unused: 0 };
        loop {
            gauge.step();
            if gauge.next == 0 {
                return gauge;
            }
        }
    }

    /// Looks at the next words. Returns the bytes that were never used when the last whole pass saw
    /// them.
    pub fn step(&mut self) -> u16 {
        self.count(memory::free(self.next))
    }

    /// `free` words of the step were never used.
    const fn count(&mut self, free: u16) -> u16 {
        self.next = self.next.saturating_add(free);
        if free < STEP_WORDS {
            self.unused = bytes(self.next);
            self.next = 0;
        }
        self.unused
    }
}

const fn bytes(words: u16) -> u16 {
    words.saturating_mul(4)
}

#[cfg(target_os = "none")]
mod memory {
    use cortex_m_rt::STACK_PAINT_VALUE;

    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }

    /// How many words of a step were never used: from the word `first` upwards, until one was used
    /// or the stack ends.
    pub(super) fn free(first: u16) -> u16 {
        let top = &raw const _stack_start;
        let mut at = (&raw const _stack_end).wrapping_add(usize::from(first));
        for free in 0..super::STEP_WORDS {
            // SAFETY: a word of the stack's memory, which always exists. The program may change it
            // at any time: one that is used just now may still count as free, until the next pass.
            if at >= top || unsafe { at.read_volatile() } != STACK_PAINT_VALUE {
                return free;
            }
            at = at.wrapping_add(1);
        }
        super::STEP_WORDS
    }
}

/// On a PC the stack carries no pattern.
#[cfg(not(target_os = "none"))]
mod memory {
    pub(super) const fn free(_first: u16) -> u16 {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step on a stack of which `unused` words were never used.
    const fn step(gauge: &mut Gauge, unused: u16) -> u16 {
        let left = unused.saturating_sub(gauge.next);
        gauge.count(if left < STEP_WORDS { left } else { STEP_WORDS })
    }

    #[test]
    fn a_pass_ends_at_the_first_used_word() {
        let mut gauge = Gauge {
            next: 0,
            unused: 4000,
        };
        for _ in 0..20 {
            assert_eq!(step(&mut gauge, 1000), 4000);
        }
        // Deeper in the middle of a pass: the pass after it, at the latest, has seen it.
        let steps = (1..20).find(|_| step(&mut gauge, 300) == 1200);
        assert!(steps.is_some_and(|steps| steps <= 1000 / STEP_WORDS + 1 + 300 / STEP_WORDS + 1));
    }

    #[test]
    fn a_stack_of_which_all_or_nothing_was_used() {
        for (unused, bytes) in [(0, 0), (STEP_WORDS, 512), (4096, 16_384)] {
            let mut gauge = Gauge { next: 0, unused: 1 };
            for _ in 0..=unused / STEP_WORDS {
                step(&mut gauge, unused);
            }
            assert_eq!(gauge.unused, bytes);
        }
    }
}

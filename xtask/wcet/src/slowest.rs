//! The slowest core that the manual allows, beside the emulated one.
//!
//! The manual gives ranges: a division takes 2 to 12 cycles, a pipeline refill 1 to 3. The emulated core takes
//! one figure of each. A bound as flashed charges the most of each, so a run that is to test it must take
//! the most, too. [`Slowest`] follows what the emulated core executes and says how much later each instruction
//! would end on that core. Waits for memories are not its matter: those are the emulated part's.

use super::instruction::{self, Instruction};
use super::register::Results;
use super::timing::Timing;

/// Follows one core.
#[derive(Debug)]
pub struct Slowest {
    timing: Timing,
    /// Address of the first halfword of `code`.
    base: u32,
    code: Vec<u16>,
    /// What is known of the instruction at each halfword, once it was executed.
    known: Vec<Option<Known>>,
    /// What the instruction before has left.
    left: Results,
}

/// An instruction, as far as it counts here.
#[derive(Debug, Clone, Copy)]
struct Known {
    instruction: Instruction,
    /// Cycles beyond those of the emulated core, if it waits for none before it.
    later: u64,
}

impl Slowest {
    /// A core with this timing as flashed, and the program that lies at `base`.
    #[must_use]
    pub fn new(timing: Timing, base: u32, program: &[u8]) -> Self {
        let halves = program.as_chunks().0.iter();
        let code: Vec<u16> = halves.map(|half| u16::from_le_bytes(*half)).collect();
        Self {
            timing,
            base,
            known: vec![None; code.len()],
            code,
            left: Results::ALL,
        }
    }

    /// By how many cycles the instruction at `at`, behind which control goes to `next`, ends later than on the
    /// emulated core, because it takes longer or waits for what the one before has left. Code outside the program
    /// takes as long as there.
    pub fn later(&mut self, at: u32, next: u32) -> u64 {
        let Some(Known { instruction, later }) = self.know(at) else {
            self.forget();
            return 0;
        };
        let waits = instruction.stall(self.left);
        self.left = instruction.results();
        let jumps = next != instruction.next();
        let refill = |timing: &Timing| if jumps { timing.taken() } else { 0 };
        later + waits + refill(&self.timing).saturating_sub(refill(&Timing::zero_wait()))
    }

    /// Something else has happened since, such as an instruction that was skipped: it leaves nothing.
    pub fn forget(&mut self) {
        self.left = Results::NONE;
    }

    fn know(&mut self, at: u32) -> Option<Known> {
        let index = at.checked_sub(self.base)? as usize / 2;
        if self.known.get(index)?.is_none() {
            let second = self.code.get(index + 1).copied();
            let instruction = instruction::of(at, *self.code.get(index)?, second)?;
            // Memory accesses are counted alike, so they are left out of both.
            let [slow, emulated] = [self.timing, Timing::zero_wait()]
                .map(|timing| timing.instruction(&instruction, None, Results::NONE));
            let later = slow.saturating_sub(emulated);
            *self.known.get_mut(index)? = Some(Known { instruction, later });
        }
        *self.known.get(index)?
    }
}

#[cfg(test)]
mod tests {
    use super::Slowest;
    use crate::timing::Timing;
    use crate::timing::tests::SLOW_PART;

    const BASE: u32 = 0x0800_0000;

    fn following(code: &[u16]) -> Slowest {
        let program: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        Slowest::new(Timing::flashed(&SLOW_PART), BASE, &program)
    }

    fn on(core: &mut Slowest, at: u32, next: u32) -> u64 {
        core.later(BASE + at, BASE + next)
    }

    #[test]
    fn what_the_manual_leaves_open_takes_the_most() {
        // sdiv r0, r1, r2; adds r1, r1, r2; ldr r0, [r1]; b .; vadd.f32 s0, s1, s2; vmul.f32 s3, s0, s4
        let mut core = following(&[
            0xfb91, 0xf0f2, 0x1889, 0x6808, 0xe7fe, 0xee30, 0x0a81, 0xee60, 0x1a02,
        ]);
        // 2 to 12 cycles, 3 on the emulated core.
        assert_eq!(on(&mut core, 0, 4), 9);
        assert_eq!(on(&mut core, 4, 6), 0);
        // The address comes a cycle later, once.
        assert_eq!(on(&mut core, 6, 8), 1);
        assert_eq!(on(&mut core, 6, 8), 0);
        // A refill of 1 to 3 cycles, 2 on the emulated core.
        assert_eq!(on(&mut core, 8, 8), 1);
        assert_eq!(on(&mut core, 10, 14), 0);
        assert_eq!(on(&mut core, 14, 18), 1);
        // Not behind something else.
        on(&mut core, 10, 14);
        core.forget();
        assert_eq!(on(&mut core, 14, 18), 0);
    }

    #[test]
    fn code_elsewhere_takes_as_long() {
        let mut core = following(&[0xfb91, 0xf0f2]);
        assert_eq!(on(&mut core, 4, 6), 0);
        assert_eq!(core.later(0x2000_0000, 0x2000_0002), 0);
        // A wide instruction of which the half is missing.
        assert_eq!(on(&mut following(&[0xfb91]), 0, 4), 0);
    }
}

//! What a real part does not allow although a program may try it.
//!
//! A model that forgives such a program proves nothing about a board. So each rule of the part's
//! documents that a program can break is checked here, and a breach is recorded as a
//! [`Violation`]: it ends the run.
//!
//! | module | rule |
//! | --- | --- |
//! | [`clocks`] | frequencies, flash wait states, voltage and converter stay within their limits, also while they change |
//! | [`gates`] | a peripheral can be used only some cycles after its clock was enabled |
//! | [`registers`] | an access suits its register: it exists, in this direction and size, and reserved bits keep their value |

pub(crate) mod clocks;
pub(crate) mod gates;
pub(crate) mod registers;

use crate::clock::Cycles;
use can_bus::SimTime;
use std::fmt;

/// Cycles of a store on the emulated core. What it brings about begins when it has ended.
pub(crate) const STORE: Cycles = 2;

/// A program did something that its part's documents do not allow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// When.
    pub at: SimTime,
    /// Address of the register that was accessed.
    pub address: u32,
    /// Its name.
    pub register: String,
    /// What the program did.
    pub what: String,
    /// The document that does not allow it, with its section.
    pub document: &'static str,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.at.as_ticks() as f64 * 1e-12;
        let Self {
            address,
            register,
            what,
            document,
            ..
        } = self;
        write!(
            f,
            "at {seconds:.6} s, {register} ({address:#010x}): {what} ({document})"
        )
    }
}

impl std::error::Error for Violation {}

/// How many violations of a node are kept. The first one ends a run, so more are of use only to
/// whoever lets a microcontroller run on.
const KEPT: usize = 64;

/// The violations of one node, oldest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Log(Vec<Violation>);

impl Log {
    /// Keeps a violation. The same one at the same register is kept once.
    pub(crate) fn record(&mut self, violation: Violation) {
        let known = |of: &Violation| of.address == violation.address && of.what == violation.what;
        if self.0.len() < KEPT && !self.0.iter().any(known) {
            self.0.push(violation);
        }
    }

    pub(crate) fn all(&self) -> &[Violation] {
        &self.0
    }
}

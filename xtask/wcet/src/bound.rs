//! The result of the analysis of one task.

use std::collections::{BTreeMap, BTreeSet};

use super::cycles::Cycles;
use super::facts::Facts;
use super::mask::Level;
use super::pend::Pend;

/// How the analysed code is entered and left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Entry {
    /// As an exception handler: exception entry and return are charged.
    Handler,
    /// As a function: only its instructions are charged.
    Function,
    /// As the handler of a fault, or another one after which the program does not go on: its time
    /// does not matter, and no loop needs a bound.
    Fault,
    /// As the program's start and idle code: critical sections count from the first time that a
    /// task can run, and only the loops that run in one need a bound.
    Program,
}

/// Why there is no bound.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Problem {
    /// A request to the debugger (semihosting) while a task is delayed by it.
    #[error(
        "the request to the debugger at {0} (semihosting) takes as long as the debugger likes: write no log by semihosting in a task, or where interrupts are masked"
    )]
    Semihosting(String),
    /// No bound was found for a loop.
    #[error(
        "the loop at {at} has no bound: write `// loop-bound: N` on the line above it, where N is the most turns that it takes{how}",
        at = .0,
        how = by_name(.0)
    )]
    LoopWithoutBound(String),
    /// No bound was found for a loop whose source is not there to be read.
    #[error(
        "the loop at {at} has no bound, and {file}, which may say one, is not there: build the program anew if its folder was moved, or bound the loop in the task table, under [bounds]"
    )]
    LoopWithoutSource {
        /// The loop.
        at: String,
        /// The file, as the program names it.
        file: String,
    },
    /// No bound was found for a loop of start-up or idle code that runs with interrupts masked.
    #[error(
        "the loop at {at} has no bound, and interrupts are masked in it since {since}: write `// loop-bound: N` on the line above it, where N is the most turns that it takes, or unmask them before it{how}",
        how = by_name(at)
    )]
    MaskedLoop {
        /// The loop.
        at: String,
        /// Where interrupts were masked.
        since: String,
    },
    /// No path leaves a loop within its bound.
    #[error(
        "no path leaves the loop at {at} within its bound ({turns}): give as many turns as it takes, and no bound to a loop without an end"
    )]
    NotLeft {
        /// Its place.
        at: String,
        /// The turns.
        turns: u64,
    },
    /// No path was followed to an end.
    #[error(
        "no path through {0} returns or ends the program: the bound of a loop in it, or the length of a copy, is too low"
    )]
    Nowhere(String),
    /// The timer's interrupt does not have priority over a task that waits for it.
    #[error(
        "the timer's interrupt at priority {timer} does not preempt the software tasks at priority {task}, so tasks may enter its queue while it empties it, and its turns have no bound: give the timer the higher priority"
    )]
    LowTimer {
        /// The priority of the timer's interrupt, in which more is more urgent.
        timer: u32,
        /// That of the task.
        task: u32,
    },
    /// The core sleeps in a task, or masks the interrupts that could wake it.
    #[error(
        "the core sleeps at {0}, in a task or where no masked interrupt wakes it: sleep in `idle` only, by `wfi`, and there not in a section that BASEPRI or FAULTMASK masks"
    )]
    Sleep(String),
    /// A handler returns without clearing a mask that it set.
    #[error(
        "the mask that is set at {0} is still set when the handler returns, so its section has no end: clear it before"
    )]
    StaysMasked(String),
    /// An interrupt is disabled in the interrupt controller.
    #[error(
        "an interrupt is disabled in the interrupt controller at {0}, and how long it stays so is not analysed: mask it by a lock, or by `interrupt::free`"
    )]
    DisabledInterrupt(String),
    /// A function calls itself, directly or not.
    #[error("recursion: {0}; its depth, and so its time and stack, has no bound")]
    Recursion(String),
    /// The target of a call or jump is unknown.
    #[error(
        "the call through a pointer at {0} may go anywhere: call the function by name, or take the pointer from a constant table"
    )]
    UnboundedPointer(String),
    /// Control reaches an address without an instruction.
    #[error("control reaches {0}, where there is no instruction of this core")]
    NotCode(String),
    /// An interrupt mask was set to an unknown level.
    #[error("the interrupt mask is set to an unknown level at {0}")]
    UnknownMask(String),
    /// The stack pointer was set to an unknown address.
    #[error("the stack pointer is unknown after {0}")]
    UnknownStack(String),
    /// The analysis exceeded its limit of steps.
    #[error("{0} takes too many steps to analyse: bound its loops by annotations")]
    TooLong(String),
}

/// How to bound a loop in a source that is not one's own. The place then begins with a crate and its
/// version.
fn by_name(place: &str) -> String {
    let (folder, _) = place.split_once('/').unwrap_or_default();
    let version = folder.rsplit_once('-').map_or("", |(_, version)| version);
    let is_foreign = folder == "core"
        || folder == "alloc"
        || folder == "compiler-builtins"
        || !place.contains(".rs:")
        || version.starts_with(|first: char| first.is_ascii_digit());
    if !is_foreign {
        return String::new();
    }
    let name = place.split(" (").next().unwrap_or(place);
    let name = name.split(" at 0x").next().unwrap_or(name);
    format!(
        "; or bound it in the task table, by `\"{name}\" = {{ turns = N, because = \"...\" }}` under [bounds]"
    )
}

impl Problem {
    /// The function in which it is, as its sentence names it.
    #[must_use]
    pub fn function(&self) -> &str {
        let place = match self {
            Self::Recursion(calls) => {
                return calls
                    .split_once(" calls ")
                    .map_or(calls, |(first, _)| first);
            }
            Self::LowTimer { .. } => "the timer's interrupt",
            Self::MaskedLoop { at, .. }
            | Self::LoopWithoutSource { at, .. }
            | Self::NotLeft { at, .. } => at,
            Self::LoopWithoutBound(place)
            | Self::Sleep(place)
            | Self::StaysMasked(place)
            | Self::DisabledInterrupt(place)
            | Self::UnboundedPointer(place)
            | Self::NotCode(place)
            | Self::UnknownMask(place)
            | Self::UnknownStack(place)
            | Self::Semihosting(place)
            | Self::Nowhere(place)
            | Self::TooLong(place) => place,
        };
        // A place is `file:line (function)`, or `function at 0x...` without line tables.
        match place.split_once(" (") {
            Some((_, function)) => function.strip_suffix(')').unwrap_or(function),
            None => place
                .split_once(" at 0x")
                .map_or(place, |(function, _)| function),
        }
    }

    /// The place of its kind among the kinds: the one to mend first has the least.
    const fn rank(&self) -> u8 {
        match self {
            Self::Semihosting(_) => 0,
            Self::LoopWithoutSource { .. } | Self::LoopWithoutBound(_) | Self::NotLeft { .. } => 1,
            Self::MaskedLoop { .. } => 2,
            Self::Sleep(_) => 3,
            Self::StaysMasked(_) => 4,
            Self::DisabledInterrupt(_) => 5,
            Self::Recursion(_) => 6,
            Self::UnboundedPointer(_) => 7,
            Self::NotCode(_) => 8,
            Self::UnknownMask(_) => 9,
            Self::UnknownStack(_) => 10,
            Self::TooLong(_) => 11,
            Self::Nowhere(_) => 12,
            Self::LowTimer { .. } => 13,
        }
    }

    /// Whether some paths were not followed to their ends. Those through a loop without a bound
    /// are: all its turns are followed, although their number is unknown.
    #[must_use]
    pub const fn hides_paths(&self) -> bool {
        match self {
            Self::LoopWithoutBound(_)
            | Self::LoopWithoutSource { .. }
            | Self::MaskedLoop { .. }
            | Self::Sleep(_)
            | Self::DisabledInterrupt(_)
            | Self::Semihosting(_)
            | Self::LowTimer { .. }
            | Self::StaysMasked(_) => false,
            Self::Recursion(_)
            | Self::NotLeft { .. }
            | Self::UnboundedPointer(_)
            | Self::NotCode(_)
            | Self::UnknownMask(_)
            | Self::UnknownStack(_)
            | Self::Nowhere(_)
            | Self::TooLong(_) => true,
        }
    }
}

/// A place from which control goes to the panic handler and never returns.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct PanicSite {
    /// Address of the call.
    pub at: u32,
    /// The function that it calls.
    pub callee: String,
}

/// How code ends that does not return.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum End {
    /// It requests a reset of the part and waits for it.
    Reset,
    /// A loop that is never left, at this place.
    Loop(String),
    /// A breakpoint or an undefined instruction, at this place.
    Stop(String),
    /// A panic, at this place.
    Panic(String),
}

impl std::fmt::Display for End {
    /// As a clause that follows a name.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Reset => write!(f, "ends in a reset"),
            Self::Loop(at) => write!(f, "ends in the endless loop at {at}"),
            Self::Stop(at) => write!(f, "ends at the breakpoint or undefined instruction at {at}"),
            Self::Panic(at) => write!(f, "ends in a panic at {at}"),
        }
    }
}

/// The longest critical section that begins at one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Section {
    /// The interrupts that are masked.
    pub level: Level,
    /// Its longest time.
    pub cycles: Cycles,
    /// Cycles, as flashed, by which one preemption, in it or before, may make it longer: lines are replaced that
    /// it has in the caches of the flash.
    pub reload: u64,
    /// Address of the instruction that masks them.
    pub at: u32,
}

/// The result of the analysis of one task.
#[derive(Debug, Clone)]
pub struct Bound {
    /// Longest time of one activation.
    pub cycles: Cycles,
    /// Cycles, as flashed, by which one preemption may make it longer: lines that it has in the caches of
    /// the flash are replaced, and read once more.
    pub reload: u64,
    /// Cycles as flashed that a job may take longer after a preemption because it repeats a
    /// store-exclusive: those of the longest such loop.
    pub retry: u64,
    /// Deepest stack below the stack pointer on entry, in bytes, without exception frames and
    /// panic paths.
    pub stack: u32,
    /// Whether a floating-point instruction may be executed.
    pub uses_fpu: bool,
    /// Critical sections.
    pub sections: Vec<Section>,
    /// Panics that the analysis does not prove impossible.
    pub panics: BTreeSet<PanicSite>,
    /// Exceptions that it may make pending.
    pub pends: BTreeSet<Pend>,
    /// Flow facts.
    pub facts: Facts,
    /// Bounds that were taken from annotations, by the first line of the loop.
    pub annotated: BTreeMap<String, u64>,
    /// Bounds of loops of libraries and of atomic operations that are known from their code, by what they
    /// are (`runtime`, [`software`](super::software)).
    pub summarised: BTreeMap<String, u64>,
    /// Whether a path returns.
    pub returns: bool,
    /// How the paths end that do not return. Endless loops are among them only where code is
    /// analysed as [`Entry::Fault`].
    pub ends: BTreeSet<End>,
    /// Why the figures above are no bounds; empty if they are.
    pub problems: Problems,
}

/// Problems of one task, each once. Those of one kind are in the order in which they were found, along the
/// paths of the task: a later one may follow from an earlier one.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Problems(Vec<Problem>);

impl Problems {
    /// Adds a problem, unless it is there.
    pub fn insert(&mut self, problem: Problem) {
        if !self.0.contains(&problem) {
            let behind = self.0.iter().take_while(|one| one.rank() <= problem.rank());
            self.0.insert(behind.count(), problem);
        }
    }

    /// The one to mend first.
    #[must_use]
    pub fn first(&self) -> Option<&Problem> {
        self.0.first()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// All of them, the one to mend first at the begin.
    pub fn iter(&self) -> std::slice::Iter<'_, Problem> {
        self.0.iter()
    }
}

impl FromIterator<Problem> for Problems {
    fn from_iter<T: IntoIterator<Item = Problem>>(all: T) -> Self {
        let mut problems = Self::default();
        for problem in all {
            problems.insert(problem);
        }
        problems
    }
}

impl<'p> IntoIterator for &'p Problems {
    type Item = &'p Problem;
    type IntoIter = std::slice::Iter<'p, Problem>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

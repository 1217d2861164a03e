//! Execution times, critical sections and stack of a node, by its image.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::arrivals::Kind;
use crate::model::{NodeModel, TaskModel};
use crate::outside::{self, Candidate, Outside};
use crate::pends::{self, Found, Pender};
use crate::table::NodeTable;
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{Bound, End, Entry, Problem, Problems};
use wcet::cycles::Cycles;
use wcet::graph::Returning;
use wcet::image::{FIRST_INTERRUPT, Image};
use wcet::ipet::Line;
use wcet::lasting::{Known, UnknownStores};
use wcet::mask;
use wcet::part::Part;
use wcet::reading::Reading;
use wcet::software::TIMER_QUEUE;
use wcet::stack::{FRAME_FPU, Stacks};
use wcet::timing::Timings;
use wcet::watch::Watch;

/// The analysis of one handler.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Handler {
    /// Bound, with exception entry and return.
    pub cycles: Cycles,
    /// The same for jobs that never call certain functions.
    pub kinds: BTreeMap<Kind, Cycles>,
    /// Exception entry and return, which the bounds include.
    pub overhead: Cycles,
    /// Cycles that a preemption by this handler costs the preempted job in addition, in the response times of the
    /// tasks of each priority.
    pub preemption: BTreeMap<u32, u64>,
    /// Cycles that a preemption of this handler may cost it: the restart of an instruction, and lines
    /// that it has in the caches of the flash.
    pub lost: u64,
    /// Why there is no bound.
    pub problems: Problems,
    /// Panics that are not proven impossible.
    pub panics: Vec<String>,
    /// Loop bounds that were taken from annotations.
    pub annotated: BTreeMap<String, u64>,
    /// Those of loops of libraries and of atomic operations, by what they are.
    pub summarised: BTreeMap<String, u64>,
    /// The longest path by source line, the costliest first.
    pub path: Vec<Line>,
    /// Bound of the integer program.
    pub program: Option<Cycles>,
    /// What a run of it is checked against, if there is a bound.
    pub watch: Option<Arc<Watch>>,
}

/// A critical section.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Section {
    /// The interrupt of the handler that masks, or `main` for start-up and idle.
    pub holder: String,
    /// Its priority.
    pub priority: u32,
    /// The highest priority that is masked.
    pub ceiling: u32,
    /// Cycles as flashed.
    pub cycles: u64,
    /// Interrupts of tasks that run in it although their priority is not above the ceiling, because only
    /// single interrupts are masked. Their time adds to that of the section.
    pub open: Vec<String>,
    /// The place of the instruction that masks.
    pub place: String,
}

/// The analysis of one image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Execution {
    /// Handlers by interrupt.
    pub handlers: BTreeMap<String, Handler>,
    /// Critical sections.
    pub sections: Vec<Section>,
    /// Who makes which task pending.
    pub pends: BTreeSet<Found>,
    /// Deepest stack with all preemptions, in bytes.
    pub stack: u32,
    /// What the stack figure does not include.
    pub stack_unknown: BTreeSet<String>,
    /// Why the critical sections of the start-up and idle code are not known.
    pub idle_problems: Problems,
    /// Loop bounds in these sections that were taken from annotations.
    pub idle_annotated: BTreeMap<String, u64>,
    /// Those of loops of libraries and of atomic operations in these sections.
    pub idle_summarised: BTreeMap<String, u64>,
    /// Handlers that are no task and do not return.
    pub outside: Vec<Outside>,
    /// Memory words that keep the address which start-up wrote to them, or hold one of a few. The bounds rely on it.
    pub known: Known,
}

/// An image does not fit the model of its node.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ExecutionError {
    /// It has no handler for an interrupt of the model.
    #[error("the image of {node} has no handler {interrupt}: is it built from this source?")]
    NoHandler {
        /// The node.
        node: String,
        /// The interrupt.
        interrupt: String,
    },
    /// It has no vector table.
    #[error(
        "the image of {0} has no vector table of cortex-m-rt (symbol `__RESET_VECTOR`), so its handlers are not known"
    )]
    NoVectors(String),
    /// It may use another vector table than its own.
    #[error(
        "the image of {0} may move its vector table (register VTOR), so its handlers are not known: accepted is the table at the begin of the image"
    )]
    VectorsMove(String),
    /// It may group priorities.
    #[error(
        "the image of {0} may group priorities (register AIRCR), so a higher one need not interrupt a lower one: leave PRIGROUP at {1} or less"
    )]
    Grouped(String, u8),
    /// A vector leads out of the image.
    #[error(
        "vector {vector} of the image of {node} leads to {address:#x}, where the image has no code, so its handler is not known"
    )]
    Stray {
        /// The node.
        node: String,
        /// The vector, as `22 (interrupt 6)`.
        vector: String,
        /// The address to which it leads.
        address: u32,
    },
    /// A handler that may return is no task.
    #[error(
        "vector {vector} of the image of {node} leads to {place}, which is neither a task nor a handler that ends in a reset: add [{rows}.{name}] with its `priority` to the task table, or remove the handler"
    )]
    Foreign {
        /// The node.
        node: String,
        /// The key of the task table that has its tasks' rows.
        rows: String,
        /// The vector, as `22 (interrupt 6)`.
        vector: String,
        /// The place of its handler.
        place: String,
        /// Name of the handler's symbol.
        name: String,
    },
    /// The handler of a fault may return.
    #[error(
        "the handler {name} of {node} may return ({place}), and its time is charged to no task: let it end in a reset or in an endless loop"
    )]
    Returns {
        /// The node.
        node: String,
        /// The handler.
        name: String,
        /// Its place.
        place: String,
    },
    /// A handler has another priority than its task.
    #[error(
        "task {task} of {node} has priority {said}, but the image gives {interrupt} {}{}",
        found(*.given), correction(*.given, .row.as_deref())
    )]
    Priority {
        /// The node.
        node: String,
        /// The task.
        task: String,
        /// Its priority in the source or in the table.
        said: u32,
        /// Its interrupt.
        interrupt: String,
        /// The one that the image gives it; `None` if there are several, or it is not a constant.
        given: Option<u32>,
        /// The heading of its row, if the priority stands there.
        row: Option<String>,
    },
}

/// What the image gives to a handler, in a sentence.
fn found(given: Option<u32>) -> String {
    given.map_or_else(
        || "different ones, or one that is not a constant".to_owned(),
        |given| format!("priority {given}"),
    )
}

/// What to write in the row of a handler, after a sentence.
fn correction(given: Option<u32>, row: Option<&str>) -> String {
    match (given, row) {
        (Some(given), Some(row)) => format!(": write `priority = {given}` under [{row}]"),
        _ => String::new(),
    }
}

impl Execution {
    /// Analyses the handlers of `node`, its start-up and its idle code. `progress` is called with
    /// the current step.
    ///
    /// # Errors
    /// The image has no handler of the model, or one that is not in the model and may return.
    pub fn of(
        node: &NodeModel,
        table: &NodeTable,
        image: &Image,
        annotations: &Annotations,
        progress: &dyn Fn(&str),
    ) -> Result<Self, ExecutionError> {
        let part = table.board.part;
        let mut analyser = Analyser {
            node,
            image,
            part,
            analysis: Analysis::new(image, annotations, &part),
            timings: Timings::of(&part),
            stacks: Stacks::new(image),
            levels: BTreeMap::new(),
            reloads: BTreeMap::new(),
            held: Vec::new(),
            main: 0,
            execution: Self::default(),
        };
        let main = image.symbol("main");
        if let Some(main) = main {
            progress("what start-up sets");
            analyser.learn(main);
        }
        analyser.add_outside()?;
        for task in &node.tasks {
            if !analyser.execution.handlers.contains_key(&task.interrupt) {
                progress(&task.name);
                analyser.add_handler(task)?;
            }
        }
        if let Some(main) = main {
            progress("start-up and idle");
            analyser.add_main(main);
            analyser.check_system_writes(table)?;
        }
        Ok(analyser.finish())
    }
}

/// The name of a vector in a sentence, by its exception number.
fn vector(number: u16) -> String {
    match number.checked_sub(FIRST_INTERRUPT) {
        Some(interrupt) => format!("{number} (interrupt {interrupt})"),
        None => number.to_string(),
    }
}

/// What a receive interrupt reads of a data frame with this identifier: the oldest one in the first FIFO of both
/// parts' bxCAN, until that is released (RM0390 30.9.2 and 30.9.3, RM0316 31.9.2 and 31.9.3).
fn received(identifier: u16) -> Reading {
    const RI0R: u32 = 0x4000_65b0;
    const RF0R: u32 = 0x4000_640c;
    /// Releases the mailbox.
    const RFOM0: u32 = 1 << 5;
    /// Where a standard identifier stands; of a data frame, the bits below it are zero.
    const STID: u32 = 21;
    Reading {
        register: RI0R,
        word: u32::from(identifier) << STID,
        until: (RF0R, RFOM0),
    }
}

/// What a preemption costs a critical section.
struct Held {
    /// The priority of its holder.
    holder: u32,
    ceiling: u32,
    /// The least priority that may preempt it.
    preempted_from: u32,
    cycles: u64,
}

/// The analysis of one image in progress.
struct Analyser<'a> {
    node: &'a NodeModel,
    image: &'a Image,
    part: Part,
    analysis: Analysis<'a>,
    timings: Timings,
    stacks: Stacks<'a>,
    /// The deepest stack of each priority's handlers, in bytes.
    levels: BTreeMap<u32, u32>,
    /// The most cycles that a preemption costs the handlers of each priority.
    reloads: BTreeMap<u32, u64>,
    held: Vec<Held>,
    /// The deepest stack of start-up and the idle code, in bytes.
    main: u32,
    execution: Execution,
}

impl Analyser<'_> {
    /// Finds the words of which the addresses are known.
    fn learn(&mut self, main: u32) {
        let handlers = self.image.handlers();
        self.execution.known = self
            .analysis
            .learn(main, &handlers, UnknownStores::SparePointers);
    }

    /// Analyses the handler of a task.
    fn add_handler(&mut self, task: &TaskModel) -> Result<(), ExecutionError> {
        let missing = || ExecutionError::NoHandler {
            node: self.node.name.clone(),
            interrupt: task.interrupt.clone(),
        };
        let entry = self.image.symbol(&task.interrupt).ok_or_else(missing)?;
        let bound = self.analysis.run(entry, Entry::Handler);
        self.add_sections(&bound, &task.interrupt, task.priority);
        self.add_pends(&bound, &Pender::Handler(task.interrupt.clone()));
        let depth = self.stacks.depth(entry);
        self.execution.stack_unknown.extend(depth.unknown);
        let level = self.levels.entry(task.priority).or_default();
        *level = (*level).max(depth.bytes).max(bound.stack);
        let reload = self.reloads.entry(task.priority).or_default();
        *reload = (*reload).max(bound.reload + bound.retry);
        let overhead = self.timings.around_handler(bound.uses_fpu);
        let longest = self.analysis.longest_path(&bound, entry);
        let program = longest.as_ref().map(|longest| longest.cycles + overhead);
        let watch = (bound.problems.is_empty())
            .then(|| Arc::new(Watch::new(&mut self.analysis, entry, &bound)));
        let image = self.image;
        let panics = bound.panics.iter();
        let panics = panics.map(|site| format!("{} -> {}", image.describe(site.at), site.callee));
        let mut problems = bound.problems;
        if let Some(problem) = self.low_timer(task, &bound.summarised) {
            problems.insert(problem);
        }
        let handler = Handler {
            kinds: self.kinds(task, entry),
            // Both are bounds, and either may be the smaller one: the search over paths knows
            // the history of each path, the integer program knows the annotations about all
            // paths together.
            cycles: program.map_or(bound.cycles, |program| bound.cycles.min(program)),
            overhead,
            // Known when all handlers are.
            preemption: BTreeMap::new(),
            lost: self.timings.flashed.exceptions().restart + bound.reload + bound.retry,
            problems,
            panics: panics.collect(),
            annotated: bound.annotated,
            summarised: bound.summarised,
            program,
            path: longest.map(|longest| longest.path).unwrap_or_default(),
            watch,
        };
        let handlers = &mut self.execution.handlers;
        handlers.insert(task.interrupt.clone(), handler);
        Ok(())
    }

    /// What is wrong if the task empties the timer queue, and software tasks may enter it meanwhile.
    fn low_timer(&self, task: &TaskModel, summarised: &BTreeMap<String, u64>) -> Option<Problem> {
        let waiting = self.node.tasks.iter().filter(|other| other.dispatched);
        let highest = waiting.map(|other| other.priority).max()?;
        let is_low = summarised.contains_key(TIMER_QUEUE) && task.priority <= highest;
        is_low.then_some(Problem::LowTimer {
            timer: task.priority,
            task: highest,
        })
    }

    /// Bounds of the jobs of a task that receive a frame, by their kind: the longest of the jobs for each of its
    /// identifiers.
    fn kinds(&mut self, task: &TaskModel, entry: u32) -> BTreeMap<Kind, Cycles> {
        let mut kinds = BTreeMap::new();
        for (kind, identifiers) in &task.received {
            let bounds = identifiers.iter().map(|identifier| {
                let bound = self.analysis.run_reading(entry, received(*identifier));
                bound.problems.is_empty().then_some(bound.cycles)
            });
            let longest = bounds
                .reduce(|a, b| a.zip(b).map(|(a, b)| a.max(b)))
                .flatten();
            kinds.extend(longest.map(|longest| (*kind, longest)));
        }
        kinds
    }

    /// Analyses start-up and the idle code.
    fn add_main(&mut self, main: u32) {
        let bound = self.analysis.run(main, Entry::Program);
        self.add_sections(&bound, "main", 0);
        self.add_pends(&bound, &Pender::Idle);
        let depth = self.stacks.depth(main);
        self.execution.stack_unknown.extend(depth.unknown);
        self.main = depth.bytes.max(bound.stack);
        self.execution.idle_problems = bound.problems;
        self.execution.idle_annotated = bound.annotated;
        self.execution.idle_summarised = bound.summarised;
    }

    /// Adds the handlers that are no task, and refuses those that may return.
    fn add_outside(&mut self) -> Result<(), ExecutionError> {
        let node = || self.node.name.clone();
        let Some(table) = self.image.vector_table() else {
            return Err(ExecutionError::NoVectors(node()));
        };
        self.check_vectors(table)?;
        if let Some((number, address)) = self.image.stray_vectors().pop_first() {
            return Err(ExecutionError::Stray {
                node: node(),
                vector: vector(number),
                address,
            });
        }
        for candidate in outside::candidates(self.node, self.image) {
            let outside = self.outside(candidate)?;
            self.execution.outside.push(outside);
        }
        Ok(())
    }

    /// Analyses a handler that is no task.
    fn outside(&mut self, candidate: Candidate) -> Result<Outside, ExecutionError> {
        let entry = candidate.entry;
        let bound = self.analysis.run(entry, Entry::Fault);
        let is_followed = !bound.problems.iter().any(Problem::hides_paths);
        let returns = bound.returns || !is_followed && Returning::default().ask(self.image, entry);
        let resets = is_followed && bound.ends.iter().all(|end| *end == End::Reset);
        let place = || self.image.describe(entry);
        let node = || self.node.name.clone();
        match candidate.interrupt() {
            Some(number) if !candidate.is_default() && (returns || !resets) => {
                return Err(ExecutionError::Foreign {
                    node: node(),
                    rows: self.node.rows.clone(),
                    vector: vector(number),
                    place: place(),
                    name: candidate.name,
                });
            }
            _ if returns => {
                return Err(ExecutionError::Returns {
                    node: node(),
                    place: place(),
                    name: candidate.name,
                });
            }
            _ => {}
        }
        let depth = self.stacks.depth(entry);
        self.execution.stack_unknown.extend(depth.unknown);
        Ok(Outside {
            name: candidate.name,
            vectors: candidate.vectors,
            ends: bound.ends,
            stack: depth.bytes.max(bound.stack),
            begins_anew: self.stacks.begins_anew(entry),
        })
    }

    /// Checks that the vector table stays where it is, as far as the program was analysed.
    fn check_vectors(&self, table: u32) -> Result<(), ExecutionError> {
        if self.analysis.system_writes().moves_vectors(table) {
            return Err(ExecutionError::VectorsMove(self.node.name.clone()));
        }
        Ok(())
    }

    /// Checks what the whole program, each handler included, writes to the registers that say
    /// which handler runs, and at which priority.
    fn check_system_writes(&self, of_node: &NodeTable) -> Result<(), ExecutionError> {
        if let Some(table) = self.image.vector_table() {
            self.check_vectors(table)?;
        }
        let bits = self.part.priority_bits;
        if self.analysis.system_writes().groups_priorities(bits.into()) {
            // The largest group that leaves each bit of a priority its say.
            let most = 7 - bits.min(7);
            return Err(ExecutionError::Grouped(self.node.name.clone(), most));
        }
        let mut tasks = self.node.tasks.iter();
        tasks.try_for_each(|task| self.check_priority(task, of_node))
    }

    /// Compares the priority of a task with that which the program gives to its handler.
    fn check_priority(&self, task: &TaskModel, table: &NodeTable) -> Result<(), ExecutionError> {
        let vectors = self.image.vectors();
        let entry = self.image.symbol(&task.interrupt);
        let mut own = vectors.iter().filter(|(_, at)| Some(**at) == entry);
        // Of a handler with several vectors it is not known which is the task's.
        let (Some((&number, _)), None) = (own.next(), own.next()) else {
            return Ok(());
        };
        let given = self.analysis.system_writes().priority(number);
        let given = given.map(|value| self.part.priority(value));
        if given == Some(task.priority) {
            return Ok(());
        }
        let row = table.task.get(&task.name);
        let row = row.filter(|row| row.priority.is_some());
        Err(ExecutionError::Priority {
            node: self.node.name.clone(),
            task: task.name.clone(),
            said: task.priority,
            interrupt: task.interrupt.clone(),
            given,
            row: row.map(|_| format!("{}.{}", self.node.rows, task.name)),
        })
    }

    /// Adds up the stacks: each priority may preempt every lower one once, and one handler that is
    /// no task may come on top of all of them. That one ends the program: another one after it has
    /// nothing left to preserve. An exception frame is charged with the floating-point registers,
    /// whether or not the preempted code uses them.
    fn finish(mut self) -> Execution {
        self.charge_preemptions();
        let tasks = self.levels.values().map(|level| level + FRAME_FPU);
        let tasks = self.main + tasks.sum::<u32>();
        let outside = self.execution.outside.iter();
        let deepest = outside.map(|one| one.depth_above(tasks)).max();
        self.execution.stack = deepest.unwrap_or(tasks);
        self.execution
    }

    /// A preemption costs the preempted job the restart of an instruction, the lines that it finds
    /// replaced, and the repetition of a store-exclusive. Each preemption is of one job; those that this one had
    /// preempted repeat theirs for its own sake. In the response time of a task, a job of its priority or
    /// above is preempted, or the section of a lower one that blocks it: what the rest of that one repeats
    /// comes later.
    fn charge_preemptions(&mut self) {
        let restart = self.timings.flashed.exceptions().restart;
        let levels: BTreeSet<u32> = self.node.tasks.iter().map(|task| task.priority).collect();
        for task in &self.node.tasks {
            let Some(handler) = self.execution.handlers.get_mut(&task.interrupt) else {
                continue;
            };
            for &level in levels.range(..=task.priority) {
                let jobs = self.reloads.range(level..task.priority.max(level));
                let jobs = jobs.map(|(_, reload)| *reload);
                let blocks = |held: &&Held| {
                    (held.holder + 1..=held.ceiling).contains(&level)
                        && held.preempted_from <= task.priority
                };
                let sections = self.held.iter().filter(blocks);
                let sections = sections.map(|held| held.cycles);
                let reload = jobs.chain(sections).max().unwrap_or(0);
                let most = handler.preemption.entry(level).or_default();
                *most = restart + reload;
            }
        }
    }

    /// Adds what makes tasks of the node pending.
    fn add_pends(&mut self, bound: &Bound, pender: &Pender) {
        let found = pends::found(self.node, self.image, pender, &bound.pends);
        self.execution.pends.extend(found);
    }

    /// Adds the critical sections of the code that runs at `priority`.
    fn add_sections(&mut self, bound: &Bound, holder: &str, priority: u32) {
        for section in &bound.sections {
            let (ceiling, open) = match section.level {
                mask::Level::All | mask::Level::Faults => (u32::MAX, Vec::new()),
                mask::Level::From(level) => (self.part.priority(level), Vec::new()),
                mask::Level::Interrupts(masked) => self.masks(masked, priority),
            };
            // A preemption before the section began may have replaced lines that it uses.
            let cycles = section.cycles.flashed + section.reload;
            let masked = if open.is_empty() { ceiling } else { priority };
            self.held.push(Held {
                holder: priority,
                ceiling,
                preempted_from: masked.saturating_add(1),
                cycles: section.reload + bound.retry,
            });
            self.execution.sections.push(Section {
                holder: holder.to_owned(),
                priority,
                ceiling,
                cycles,
                open,
                place: self.image.describe(section.at),
            });
        }
    }

    /// What masking single interrupts comes to: the highest priority of a task that is masked, and the
    /// interrupts of the tasks up to it, but above `holder`, that are not.
    fn masks(&self, masked: u32, holder: u32) -> (u32, Vec<String>) {
        let vectors = self.image.vectors();
        let is_masked = |task: &&TaskModel| {
            let entry = self.image.symbol(&task.interrupt);
            let mut numbers = vectors.iter().filter(|(_, at)| Some(**at) == entry);
            numbers.any(|(number, _)| {
                let bit = number.checked_sub(FIRST_INTERRUPT);
                bit.is_some_and(|bit| bit < 32 && masked >> bit & 1 == 1)
            })
        };
        let tasks = || self.node.tasks.iter();
        let ceiling = tasks().filter(is_masked).map(|task| task.priority).max();
        let ceiling = ceiling.unwrap_or(0);
        let between = |task: &&TaskModel| task.priority > holder && task.priority <= ceiling;
        let open = tasks().filter(between).filter(|task| !is_masked(task));
        let mut open: Vec<String> = open.map(|task| task.interrupt.clone()).collect();
        open.dedup();
        (ceiling, open)
    }
}

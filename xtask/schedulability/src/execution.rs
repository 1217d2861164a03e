//! Execution times, critical sections and stack of a node, by its image.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::arrivals::Kind;
use crate::model::{NodeModel, TaskModel};
use crate::pends::{self, Found, Pender};
use crate::table::NodeTable;
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{Bound, Entry, Problem};
use wcet::cycles::Cycles;
use wcet::image::Image;
use wcet::ipet::Line;
use wcet::lasting::{UnknownStores, Words};
use wcet::mask;
use wcet::stack::{FRAME_FPU, Stacks};
use wcet::timing::{Timing, Timings};
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
    /// Cycles that a preemption by this handler costs the preempted job in addition.
    pub preemption: u64,
    /// Why there is no bound.
    pub problems: BTreeSet<Problem>,
    /// Panics that are not proven impossible.
    pub panics: Vec<String>,
    /// Loop bounds that were taken from annotations.
    pub annotated: BTreeMap<String, u64>,
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
    /// Why the start-up and idle code could not be followed to its end.
    pub idle_problems: BTreeSet<Problem>,
    /// Memory words that keep the address which start-up wrote to them. The bounds rely on it.
    pub lasting: Words,
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
    /// It has no such function as the task table excludes.
    #[error(
        "the image of {node} has no function {function}, which the task table lists under `never` of {task}"
    )]
    NoFunction {
        /// The node.
        node: String,
        /// The task.
        task: String,
        /// The function.
        function: String,
    },
}

impl Execution {
    /// Analyses the handlers of `node`, its start-up and its idle code. `progress` is called with
    /// the current step.
    ///
    /// # Errors
    /// The image has no handler of the model, or not a function that the task table excludes.
    pub fn of(
        node: &NodeModel,
        table: &NodeTable,
        image: &Image,
        annotations: &Annotations,
        progress: &dyn Fn(&str),
    ) -> Result<Self, ExecutionError> {
        let part = Timing::flashed(table.board);
        let mut analyser = Analyser {
            node,
            image,
            analysis: Analysis::new(image, annotations, part),
            timings: Timings::of(part),
            stacks: Stacks::new(image),
            levels: BTreeMap::new(),
            main: 0,
            execution: Self::default(),
        };
        let main = image.symbol("main");
        if let Some(main) = main {
            progress("what start-up sets");
            analyser.learn(main);
        }
        for task in &node.tasks {
            if !analyser.execution.handlers.contains_key(&task.interrupt) {
                progress(&task.name);
                analyser.add_handler(task)?;
            }
        }
        if let Some(main) = main {
            progress("start-up and idle");
            analyser.add_main(main);
        }
        Ok(analyser.finish())
    }
}

/// The analysis of one image in progress.
struct Analyser<'a> {
    node: &'a NodeModel,
    image: &'a Image,
    analysis: Analysis<'a>,
    timings: Timings,
    stacks: Stacks<'a>,
    /// The deepest stack of each priority's handlers, in bytes.
    levels: BTreeMap<u32, u32>,
    /// The deepest stack of start-up and the idle code, in bytes.
    main: u32,
    execution: Execution,
}

impl Analyser<'_> {
    /// Finds the words that keep the address which start-up wrote to them.
    fn learn(&mut self, main: u32) {
        let handlers = self.image.handlers();
        let words = self
            .analysis
            .learn(main, &handlers, UnknownStores::SparePointers);
        self.execution.lasting.clone_from(words);
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
        let overhead = self.timings.exception_entry() + self.timings.exception_exit();
        let longest = self.analysis.longest_path(&bound, entry);
        let program = longest.as_ref().map(|longest| longest.cycles + overhead);
        let exceptions = self.timings.flashed.exceptions();
        let lazy = if bound.uses_fpu {
            exceptions.lazy_stacking
        } else {
            0
        };
        let watch = bound
            .problems
            .is_empty()
            .then(|| Arc::new(Watch::new(&mut self.analysis, entry, &bound)));
        let image = self.image;
        let panics = bound.panics.iter();
        let panics = panics.map(|site| format!("{} -> {}", image.describe(site.at), site.callee));
        let handler = Handler {
            kinds: self.kinds(task, entry)?,
            // Both are bounds, and either may be the smaller one: the search over paths knows
            // the history of each path, the integer program knows the annotations about all
            // paths together.
            cycles: program.map_or(bound.cycles, |program| bound.cycles.min(program)),
            overhead,
            preemption: exceptions.restart + lazy,
            problems: bound.problems,
            panics: panics.collect(),
            annotated: bound.annotated,
            program,
            path: longest.map(|longest| longest.path).unwrap_or_default(),
            watch,
        };
        let handlers = &mut self.execution.handlers;
        handlers.insert(task.interrupt.clone(), handler);
        Ok(())
    }

    /// Bounds of the jobs of a task that never call certain functions, by their kind.
    fn kinds(
        &mut self,
        task: &TaskModel,
        entry: u32,
    ) -> Result<BTreeMap<Kind, Cycles>, ExecutionError> {
        let mut kinds = BTreeMap::new();
        for (kind, names) in &task.never {
            let address = |name: &String| {
                let missing = || ExecutionError::NoFunction {
                    node: self.node.name.clone(),
                    task: task.name.clone(),
                    function: name.clone(),
                };
                self.image.function_ending(name).ok_or_else(missing)
            };
            let never = names.iter().map(address).collect::<Result<_, _>>()?;
            let without = self.analysis.run_without(entry, Entry::Handler, &never);
            if without.problems.is_empty() {
                kinds.insert(*kind, without.cycles);
            }
        }
        Ok(kinds)
    }

    /// Analyses start-up and the idle code.
    fn add_main(&mut self, main: u32) {
        let bound = self.analysis.run(main, Entry::Program);
        self.add_sections(&bound, "main", 0);
        self.add_pends(&bound, &Pender::Idle);
        let depth = self.stacks.depth(main);
        self.execution.stack_unknown.extend(depth.unknown);
        self.main = depth.bytes.max(bound.stack);
        // Start-up may wait for hardware in loops without a bound. Only a problem that may hide
        // a critical section counts.
        let problems = bound.problems.into_iter();
        let problems = problems.filter(|problem| !matches!(problem, Problem::LoopWithoutBound(_)));
        self.execution.idle_problems = problems.collect();
    }

    /// Adds up the stacks: each priority may preempt every lower one once. An exception frame is
    /// charged with the floating-point registers, whether or not the preempted code uses them.
    fn finish(mut self) -> Execution {
        let preemptions = self.levels.values().map(|level| level + FRAME_FPU);
        self.execution.stack = self.main + preemptions.sum::<u32>();
        self.execution
    }

    /// Adds what makes tasks of the node pending.
    fn add_pends(&mut self, bound: &Bound, pender: &Pender) {
        let found = pends::found(self.node, self.image, pender, &bound.pends);
        self.execution.pends.extend(found);
    }

    /// Adds the critical sections of the code that runs at `priority`.
    fn add_sections(&mut self, bound: &Bound, holder: &str, priority: u32) {
        for section in &bound.sections {
            self.execution.sections.push(Section {
                holder: holder.to_owned(),
                priority,
                ceiling: match section.level {
                    mask::Level::All => u32::MAX,
                    mask::Level::From(level) => PRIORITIES - u32::from(level >> 4),
                },
                cycles: section.cycles.flashed,
                place: self.image.describe(section.at),
            });
        }
    }
}

/// Number of interrupt priorities of the parts (four bits of `BASEPRI`).
const PRIORITIES: u32 = 16;

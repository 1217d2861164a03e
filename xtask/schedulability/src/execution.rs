//! What the image of a node says: times, critical sections and stack.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::arrivals::Kind;
use crate::model::NodeModel;
use crate::table::NodeTable;
use wcet::analysis::{Analysis, Bound, Entry, Problem};
use wcet::annotation::Annotations;
use wcet::image::Image;
use wcet::ipet;
use wcet::lasting::{Strangers, Words};
use wcet::stack::{FRAME, FRAME_FPU, Stacks};
use wcet::timing::Timing;
use wcet::watch::Watch;

/// One handler.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Handler {
    /// Bound in cycles, entry and return included: zero wait states, as flashed.
    pub cycles: [u64; 2],
    /// The same for jobs that never call certain functions.
    pub kinds: BTreeMap<Kind, [u64; 2]>,
    /// Cycles of entry and return in them.
    pub overhead: [u64; 2],
    /// What a preemption by it costs besides, in cycles.
    pub preemption: u64,
    /// Why the bound is none.
    pub problems: BTreeSet<Problem>,
    /// Panics not proven impossible.
    pub panics: Vec<String>,
    /// Loop bounds taken from annotations.
    pub annotated: BTreeMap<String, u64>,
    /// Worst path by source line: cycles as flashed, times, place.
    pub path: Vec<(u64, u64, String)>,
    /// Bound of the integer program.
    pub program: Option<[u64; 2]>,
    /// What a run of it must keep to, where there is a bound.
    pub watch: Option<Arc<Watch>>,
}

/// A stretch with interrupts masked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Section {
    /// Who masks: a handler's interrupt, or `main` for start-up and idle.
    pub holder: String,
    /// Its priority.
    pub priority: u32,
    /// The priority that it masks up to.
    pub ceiling: u32,
    /// Cycles as flashed.
    pub cycles: u64,
    /// Where it masks.
    pub place: String,
}

/// What the image of a node says.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Execution {
    /// Handlers by interrupt.
    pub handlers: BTreeMap<String, Handler>,
    /// Stretches with interrupts masked.
    pub sections: Vec<Section>,
    /// Deepest stack with all preemptions, in bytes.
    pub stack: u32,
    /// What that figure does not hold.
    pub stack_unknown: BTreeSet<String>,
    /// Where the start-up and idle code could not be followed.
    pub idle_problems: BTreeSet<Problem>,
    /// Words that start-up leaves in memory for good, as far as the bounds rest on
    /// them.
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
    /// Analyses the handlers of `node`, its start-up and its idle code.
    ///
    /// # Errors
    /// The image does not hold a handler of the model.
    pub fn of(
        node: &NodeModel,
        table: &NodeTable,
        image: &Image,
        annotations: &Annotations,
        progress: &dyn Fn(&str),
    ) -> Result<Self, ExecutionError> {
        let part = Timing::flashed(table.board);
        let mut analysis = Analysis::new(image, annotations, part);
        let main = image.symbol("main");
        let mut lasting = Words::new();
        if let Some(main) = main {
            progress("what start-up sets");
            lasting.clone_from(analysis.learn(main, &image.handlers(), Strangers::Spare));
        }
        let mut stacks = Stacks::new(image);
        let exceptions = [Timing::zero_wait(), part].map(|timing| timing.exceptions());
        let mut execution = Self {
            lasting,
            ..Self::default()
        };
        let mut levels: BTreeMap<u32, (u32, bool)> = BTreeMap::new();
        for task in &node.tasks {
            if execution.handlers.contains_key(&task.interrupt) {
                continue;
            }
            progress(&task.name);
            let entry = image
                .symbol(&task.interrupt)
                .ok_or_else(|| ExecutionError::NoHandler {
                    node: node.name.clone(),
                    interrupt: task.interrupt.clone(),
                })?;
            let bound = analysis.run(entry, Entry::Handler);
            execution.add_sections(&bound, &task.interrupt, task.priority, image);
            let depth = stacks.depth(entry);
            execution.stack_unknown.extend(depth.unknown);
            let level = levels.entry(task.priority).or_default();
            level.0 = level.0.max(depth.bytes).max(bound.stack);
            level.1 |= bound.uses_fpu;
            let program = ipet::solve(&mut analysis, &bound, entry);
            let overhead = exceptions.map(|e| e.entry + e.exit);
            let program_cycles = program
                .as_ref()
                .map(|p| [p.cycles[0] + overhead[0], p.cycles[1] + overhead[1]]);
            let watch = bound
                .problems
                .is_empty()
                .then(|| Arc::new(Watch::new(&mut analysis, entry, &bound)));
            let lazy = if bound.uses_fpu {
                exceptions[1].lazy_stacking
            } else {
                0
            };
            let mut kinds = BTreeMap::new();
            for (kind, names) in &task.never {
                let never = names
                    .iter()
                    .map(|name| {
                        image
                            .function_ending(name)
                            .ok_or_else(|| ExecutionError::NoFunction {
                                node: node.name.clone(),
                                task: task.name.clone(),
                                function: name.clone(),
                            })
                    })
                    .collect::<Result<BTreeSet<u32>, _>>()?;
                let without = analysis.run_without(entry, Entry::Handler, &never);
                if without.problems.is_empty() {
                    kinds.insert(*kind, without.cycles);
                }
            }
            execution.handlers.insert(
                task.interrupt.clone(),
                Handler {
                    kinds,
                    // Both hold: the machine's clock knows the history of each
                    // path, the program what is annotated about all of them.
                    cycles: std::array::from_fn(|model| {
                        let by_program = program_cycles.map_or(u64::MAX, |p| p[model]);
                        bound.cycles[model].min(by_program)
                    }),
                    overhead,
                    preemption: exceptions[1].restart + lazy,
                    problems: bound.problems,
                    panics: bound
                        .panics
                        .iter()
                        .map(|site| format!("{} -> {}", image.describe(site.at), site.callee))
                        .collect(),
                    annotated: bound.annotated,
                    program: program_cycles,
                    path: program.map(|p| p.path).unwrap_or_default(),
                    watch,
                },
            );
        }
        let mut fpu = levels.values().any(|(_, fpu)| *fpu);
        if let Some(main) = main {
            progress("start-up and idle");
            let bound = analysis.run(main, Entry::Program);
            execution.add_sections(&bound, "main", 0, image);
            let depth = stacks.depth(main);
            execution.stack_unknown.extend(depth.unknown);
            execution.stack = depth.bytes.max(bound.stack);
            fpu |= bound.uses_fpu;
            execution.idle_problems = bound
                .problems
                .into_iter()
                // Start-up waits for hardware; only what hides a critical
                // section of idle matters here.
                .filter(|problem| !matches!(problem, Problem::LoopWithoutBound(_)))
                .collect();
        }
        // Every priority may preempt every lower one once. A frame holds the
        // floating-point registers if anything below uses them.
        for (bytes, _) in levels.values() {
            execution.stack += bytes + if fpu { FRAME_FPU } else { FRAME };
        }
        Ok(execution)
    }

    fn add_sections(&mut self, bound: &Bound, holder: &str, priority: u32, image: &Image) {
        for section in &bound.sections {
            self.sections.push(Section {
                holder: holder.to_owned(),
                priority,
                ceiling: match section.level {
                    0 => u32::MAX,
                    level => PRIORITIES - u32::from(level >> 4),
                },
                cycles: section.cycles[1],
                place: image.describe(section.at),
            });
        }
    }
}

/// Priorities of both parts.
const PRIORITIES: u32 = 16;

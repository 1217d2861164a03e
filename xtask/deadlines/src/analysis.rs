//! The analysis of an application, and its result.

use std::path::Path;

use schedulability::assumptions::{
    OF_ANY_PROGRAM, OF_SOFTWARE_TASKS, READING_AHEAD, annotated, summarised,
};
use schedulability::execution::Execution;
use schedulability::node::{Observed, schedule};
use schedulability::pends;
use schedulability::results::NodeReport;
use schedulability::table::{LoopBound, PendedBy, unused_bound};
use wcet::annotation::Annotations;
use wcet::image::Image;

use crate::app::Source;
use crate::error::Error;
use crate::model::Model;
use crate::parts::PartFile;

/// The answers for an application.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Bounds and response times.
    pub node: NodeReport,
    /// What they rest on, one sentence or a few for each.
    pub assumptions: Vec<String>,
    /// Source file of the application, as messages show it.
    pub source: String,
    /// Lines of the tasks' attributes, by task.
    pub lines: Vec<(String, u32)>,
}

impl Answer {
    /// The first problem, in one sentence.
    #[must_use]
    pub fn first_miss(&self) -> Option<String> {
        self.node.first_miss()
    }

    /// The line of a task in its source.
    #[must_use]
    pub fn line(&self, task: &str) -> Option<u32> {
        let mut lines = self.lines.iter();
        lines.find(|(name, _)| name == task).map(|(_, line)| *line)
    }
}

/// Bounds the execution times of an image. `root` is the folder to which source paths in the image are
/// relative; `file` names the table in messages.
///
/// # Errors
/// The image does not fit the model, a mark in a source belongs to no loop, or the table bounds a loop that is
/// not reached.
pub fn execution(
    model: &Model,
    image: &Image,
    root: &Path,
    file: &str,
    progress: &dyn Fn(&str),
) -> Result<Execution, Error> {
    let annotations = Annotations::new(root).with_bounds(LoopBound::turns(&model.bounds));
    let execution = Execution::of(&model.node, &model.table, image, &annotations, progress)
        .map_err(Error::input)?;
    if let Some(misplaced) = annotations.misplaced().into_iter().next() {
        return Err(Error::input(misplaced));
    }
    match annotations.unused().into_iter().next() {
        Some(name) => Err(Error::input(unused_bound(file, &name))),
        None => Ok(execution),
    }
}

/// The answers for an application. `file` names the table in messages.
///
/// # Errors
/// The table omits who pends a task.
pub fn answer(
    source: &Source,
    model: &Model,
    execution: &Execution,
    part: &PartFile,
    observed: Option<&Observed>,
    file: &str,
) -> Result<Answer, Error> {
    pends::check(&model.node, &model.table, &execution.pends, file).map_err(Error::input)?;
    let node = schedule(&model.node, &model.table, execution, observed);
    let lines = source.app.tasks.iter();
    Ok(Answer {
        assumptions: assumptions(source, model, &node, part),
        node,
        source: source.shown.clone(),
        lines: lines.map(|task| (task.name.clone(), task.line)).collect(),
    })
}

fn assumptions(source: &Source, model: &Model, node: &NodeReport, part: &PartFile) -> Vec<String> {
    let any = OF_ANY_PROGRAM.iter();
    let mut all: Vec<String> = any.map(|one| one.granted.to_owned()).collect();
    all.push(
        "A task is not released more often than the task table says. It omits no task that pends another one, if \
         no unresolved pointer leads to the interrupt controller. Who writes the table and unsafe code makes sure."
            .to_owned(),
    );
    if model.node.tasks.iter().any(|task| task.dispatched) || !source.in_idle.is_empty() {
        all.push(OF_SOFTWARE_TASKS.granted.to_owned());
    }
    for (task, entry) in &model.table.task {
        for (pender, how) in &entry.pended_by {
            if let PendedBy::Bounded(bounded) = how {
                let because = bounded.because.trim_end_matches('.');
                all.push(format!(
                    "{pender} pends {task} {}: {because}.",
                    bounded.often()
                ));
            }
        }
    }
    let on = &model.table.board.part;
    all.push(format!(
        "The {} runs at {} MHz with {} wait states of its flash. Costs of instructions are the most that the \
         manual of the {} gives.",
        part.title,
        f64::from(on.core_hz) / 1e6,
        on.flash_waits,
        on.core.name()
    ));
    all.extend(part.assumes.clone());
    all.push(if on.reads_ahead {
        format!("`flash_accelerator` = true. {READING_AHEAD}")
    } else {
        "Flash: a line is at hand until the next one is fetched, or a constant is read; none is taken to be \
         read ahead or cached."
            .to_owned()
    });
    all.push(format!(
        "Transfers by DMA and other masters of the bus delay an access of the core to RAM by {} cycles at most, \
         and keep it from a peripheral for no longer than its wait states: {}. Who chooses the part makes sure. \
         No debugger is connected.",
        on.ram_waits, on.peripheral_waits
    ));
    let nodes = std::slice::from_ref(node);
    all.extend(annotated(nodes, false, &model.bounds));
    all.extend(summarised(nodes, false));
    let panics: usize = node.tasks.iter().map(|task| task.panics.len()).sum();
    if panics > 0 {
        all.push(format!(
            "The image does not prove {panics} panics impossible. A path is charged up to its panic."
        ));
    }
    if !source.in_idle.is_empty() {
        all.push(format!(
            "These tasks have priority 0 and run in place of idle, without a bound: {}.",
            source.in_idle.join(", ")
        ));
    }
    all
}

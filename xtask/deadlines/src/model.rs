//! The model of an application: its source and its table, put together for the analysis.

use std::collections::BTreeMap;

use schedulability::arrivals::Sporadic;
use schedulability::board::Board;
use schedulability::model::NodeModel;
use schedulability::table::{
    Clocks as RunsOn, LoopBound, NodeTable, ONCE, PendedBy, Run, Several, TaskTable,
};
use schedulability::units::MICROSECOND;
use wcet::part::Part;

use crate::app::Source;
use crate::error::Error;
use crate::table::{Row, Table};

/// The key of the tasks' rows in the table.
const ROWS: &str = "task";

/// An application, ready for the analysis.
#[derive(Debug, Clone)]
pub struct Model {
    /// Its tasks.
    pub node: NodeModel,
    /// Their rows.
    pub table: NodeTable,
    /// Bounds of loops by their names.
    pub bounds: BTreeMap<String, LoopBound>,
}

/// Takes the rows of comments into the table.
///
/// # Errors
/// A task has both.
pub fn with_comments(source: &Source, table: &Table, file: &str) -> Result<Table, Error> {
    let mut table = table.clone();
    for (task, comment) in &source.comments {
        if table
            .task
            .insert(task.clone(), comment.row.clone())
            .is_some()
        {
            return Err(Error::input(format!(
                "task {task} has a `deadline:` comment at {} and a row in {file}: keep one of them",
                comment.place
            )));
        }
    }
    Ok(table)
}

/// Builds the model of application `name` on `part`; `file` names the table in messages.
///
/// # Errors
/// Source and table do not fit together.
pub fn build(
    name: &str,
    source: &Source,
    table: &Table,
    part: &Part,
    stack_bytes: u32,
    file: &str,
) -> Result<Model, Error> {
    let highest = part.priorities();
    for task in &source.app.tasks {
        if task.priority > highest {
            return Err(Error::input(format!(
                "{}:{}: task {} has priority {}: the part has 1 to {highest}",
                source.shown, task.line, task.name, task.priority
            )));
        }
    }
    let rows = table.task.iter().map(|(task, row)| {
        let is_task = source.app.tasks.iter().any(|one| one.name == *task);
        if source.in_idle.contains(task) {
            return Err(Error::input(format!(
                "{file}: task {task} has priority 0, so it runs in place of idle and has no bound: give it a \
                 priority of 1 or more, or remove its row"
            )));
        }
        let mut entry = entry(row).ok_or_else(|| missing(file, task, row))?;
        if is_task && row.priority.is_some() {
            return Err(Error::input(format!(
                "{file}: task {task} has a `priority`, which stands in the source"
            )));
        }
        if !is_task {
            let usual = source.monotonic_priority(highest);
            entry.priority = Some(row.priority.unwrap_or(usual));
        }
        Ok((task.clone(), entry))
    });
    let node_table = NodeTable {
        board: Board {
            part: *part,
            reset_hz: part.core_hz,
            stack_bytes,
            transmit_lead: 0,
        },
        clocks: RunsOn::External,
        task: rows.collect::<Result<_, Error>>()?,
        dma: BTreeMap::new(),
    };
    if let Some(task) = source
        .app
        .tasks
        .iter()
        .find(|task| !table.task.contains_key(&task.name))
    {
        return Err(Error::input(format!(
            "{file}: task {} ({}:{}) has no row: add [task.{0}] with `every_us` or another release, and \
             `deadline_us`; or write `/// deadline: every 10 ms, within 5 ms` above it",
            task.name, source.shown, task.line
        )));
    }
    let mut node =
        NodeModel::without_bus(name, &source.app, &node_table, file, ROWS).map_err(Error::input)?;
    node.source.clone_from(&source.shown);
    Ok(Model {
        node,
        table: node_table,
        bounds: table.bounds.clone(),
    })
}

/// What a row lacks.
fn missing(file: &str, task: &str, row: &Row) -> Error {
    let what = if row.deadline_us.is_none() {
        "no `deadline_us`"
    } else {
        "no release: `every_us`, `burst` or `pended_by`"
    };
    Error::input(format!("{file}: task {task} has {what}"))
}

/// The entry of a row for the analysis; `None` if it has no deadline or nothing releases it.
fn entry(row: &Row) -> Option<TaskTable> {
    let mut derived = Vec::new();
    if let Some(burst) = row.burst {
        derived.push(Sporadic {
            period: burst.apart_us * MICROSECOND,
            jitter: 0,
            limit: Some((burst.jobs, burst.every_us * MICROSECOND)),
        });
    }
    for how in row.pended_by.values() {
        match how {
            PendedBy::Run(Run::Each) => {}
            PendedBy::Run(Run::Once) => derived.push(Sporadic::every(ONCE)),
            PendedBy::Bounded(bounded) => {
                let often = bounded.every_us.as_slice().iter();
                derived.extend(often.map(|us| Sporadic::every(us * MICROSECOND)));
            }
        }
    }
    let each = |how: &PendedBy| matches!(how, PendedBy::Run(Run::Each));
    let is_released =
        !row.every_us.is_empty() || !derived.is_empty() || row.pended_by.values().any(each);
    row.deadline_us.filter(|_| is_released)?;
    Some(TaskTable {
        every_us: Several::Many(row.every_us.clone()),
        derived,
        after: row.after.clone(),
        pended_by: row.pended_by.clone(),
        apart_us: row.apart_us,
        deadline_us: row.deadline_us,
        jitter_us: row.jitter_us,
        ..TaskTable::default()
    })
}

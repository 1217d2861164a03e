//! Observations of a probe: cycles that activations of tasks took, held against the bounds.
//!
//! The file has one line for each activation: `task,cycles`, without a heading or with that one. The
//! cycles are those from the task's first instruction to its last, as `DWT_CYCCNT` counts them; blank lines and
//! lines that begin with `#` are skipped. A software task's row is of one poll.

use std::collections::BTreeMap;

use schedulability::node::{Observed, Seen};
use wcet::cycles::Cycles;

use crate::error::Error;
use crate::model::Model;

/// Reads the longest observation of each handler, by its interrupt. `file` names the file in messages.
///
/// # Errors
/// A line is not understood, or names no task.
pub fn read(text: &str, file: &str, model: &Model) -> Result<Observed, Error> {
    let mut longest: BTreeMap<String, u64> = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.replace(' ', "") == "task,cycles" {
            continue;
        }
        let wrong = |what: String| Error::input(format!("{file}:{number}: {what}"));
        let (task, cycles) = line
            .split_once(',')
            .map(|(task, cycles)| (task.trim(), cycles.trim()))
            .ok_or_else(|| wrong("a line is `task,cycles`".to_owned()))?;
        let cycles: u64 = cycles
            .parse()
            .map_err(|_| wrong(format!("`{cycles}` is no number of cycles")))?;
        let tasks = &model.node.tasks;
        let of_task = tasks.iter().find(|one| one.name == task).ok_or_else(|| {
            let known: Vec<&str> = tasks.iter().map(|one| one.name.as_str()).collect();
            wrong(format!(
                "there is no task {task}: there are {}",
                known.join(", ")
            ))
        })?;
        let most = longest.entry(of_task.interrupt.clone()).or_default();
        *most = cycles.max(*most);
    }
    let seen = longest.into_iter().map(|(interrupt, cycles)| {
        let seen = Seen {
            // A probe sees the part as it runs. The other figure is for emulated runs.
            longest: Cycles {
                zero_wait: 0,
                flashed: cycles,
            },
            ..Seen::default()
        };
        (interrupt, seen)
    });
    Ok(seen.collect())
}

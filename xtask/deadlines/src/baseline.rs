//! A former report, against which slack may not be lost.

use serde_json::Value;

use schedulability::results::NodeReport;
use schedulability::units::time;

use crate::error::Error;

/// Compares the slack of each task with that in `text`, a former `--json`. A task may lose up to `percent` of
/// it. Returns one sentence for each that lost more; a task that is new has nothing to lose.
///
/// # Errors
/// The text is no such report; `file` names it in messages.
pub fn losses(
    node: &NodeReport,
    text: &str,
    file: &str,
    percent: u64,
) -> Result<Vec<(String, String)>, Error> {
    let wrong = |what: &str| Error::input(format!("{file}: {what}"));
    let former: Value = serde_json::from_str(text).map_err(|error| {
        wrong(&format!(
            "not a report of `cargo deadlines --json`: {error}"
        ))
    })?;
    let tasks = former["tasks"]
        .as_array()
        .ok_or_else(|| wrong("not a report of `cargo deadlines --json`: it has no `tasks`"))?;
    let mut losses = Vec::new();
    for task in &node.tasks {
        let mut same = tasks.iter().filter(|one| one["name"] == task.name.as_str());
        let Some(before) = same.next().and_then(|one| one["slack_ps"].as_u64()) else {
            continue;
        };
        let now = task.slack();
        let least = u128::from(before) * u128::from(100 - percent.min(100));
        if now.is_some_and(|now| u128::from(now) * 100 >= least) {
            continue;
        }
        let now = now.map_or_else(|| "none".to_owned(), time);
        losses.push((
            task.name.clone(),
            format!(
                "{} had {} of slack and has {now}: it may lose {percent} %",
                task.name,
                time(before)
            ),
        ));
    }
    Ok(losses)
}

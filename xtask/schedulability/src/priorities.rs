//! Deadline-monotonic priorities, and where the sources deviate from them.
//!
//! With deadlines no longer than the periods and without blocking, the deadline-monotonic
//! order is optimal: if any static order schedules a task set, this one does (Leung and
//! Whitehead 1982).

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::model::{NodeModel, TaskModel};
use crate::report::{Align, columns};
use crate::results::NodeReport;
use crate::units::{Picoseconds, time};

/// The shortest deadline of a task: its own, or that of one of its jobs in the time table.
fn shortest(task: &TaskModel) -> Picoseconds {
    let timed = task.arrivals.timed.iter().flat_map(|table| &table.jobs);
    timed
        .filter_map(|job| job.deadline)
        .chain([task.deadline])
        .min()
        .unwrap_or(task.deadline)
}

/// The proposed priority of each task of a node. The task with the shortest deadline is the
/// most urgent. Tasks with equal deadlines share a priority, and so do tasks that share a
/// handler. The lowest priority is 1.
#[must_use]
pub fn propose(node: &NodeModel) -> BTreeMap<String, u32> {
    // A handler has one priority: that of its most urgent task.
    let mut of_handler: BTreeMap<&str, u64> = BTreeMap::new();
    for task in &node.tasks {
        let deadline = of_handler.entry(&task.interrupt).or_insert(u64::MAX);
        *deadline = shortest(task).min(*deadline);
    }
    let mut deadlines: Vec<u64> = of_handler.values().copied().collect();
    deadlines.sort_unstable();
    deadlines.dedup();
    node.tasks
        .iter()
        .map(|task| {
            let deadline = of_handler[task.interrupt.as_str()];
            let longer = deadlines.iter().filter(|other| **other > deadline).count();
            (task.name.clone(), longer as u32 + 1)
        })
        .collect()
}

/// Pairs of tasks of which the first has the shorter deadline but the lower priority in the
/// source.
#[must_use]
pub fn inversions(node: &NodeModel) -> Vec<(String, String)> {
    let mut pairs = Vec::new();
    for urgent in &node.tasks {
        for other in &node.tasks {
            if shortest(urgent) < shortest(other) && urgent.priority < other.priority {
                pairs.push((urgent.name.clone(), other.name.clone()));
            }
        }
    }
    pairs
}

/// A proposed change of a priority in the source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change<'n> {
    /// The task.
    pub task: &'n TaskModel,
    /// Its new priority.
    pub to: u32,
    /// Resources that it locks and whose ceiling rises: name, old and new ceiling. Tasks of
    /// lower priority that lock them block more tasks than before.
    pub ceilings: Vec<(&'n str, u32, u32)>,
}

/// The least changes that remove every inversion: each task is raised to the highest priority
/// among the tasks with longer deadlines.
#[must_use]
pub fn changes(node: &NodeModel) -> Vec<Change<'_>> {
    let ceiling = |resource: &str| {
        let users = node.tasks.iter();
        let users = users.filter(|task| task.locks.iter().any(|of| of == resource));
        users.map(|task| task.priority).max().unwrap_or(0)
    };
    let change = |task| {
        let less_urgent = node.tasks.iter();
        let to = less_urgent
            .filter(|other| shortest(task) < shortest(other))
            .map(|other| other.priority)
            .max()
            .filter(|to| *to > task.priority)?;
        let ceilings = task.locks.iter().map(|of| (of.as_str(), ceiling(of), to));
        Some(Change {
            task,
            to,
            ceilings: ceilings.filter(|(_, from, to)| from < to).collect(),
        })
    };
    node.tasks.iter().filter_map(change).collect()
}

impl std::fmt::Display for Change<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { task, to, .. } = self;
        write!(
            f,
            "{}: `priority = {to}` instead of {}",
            task.name, task.priority
        )?;
        for (index, (resource, from, to)) in self.ceilings.iter().enumerate() {
            let word = if index == 0 { ", which raises" } else { " and" };
            write!(f, "{word} the ceiling of {resource} from {from} to {to}")?;
        }
        Ok(())
    }
}

/// What is proven for the order in the source, as sentences.
fn proof(node: &NodeModel, report: &NodeReport) -> Vec<String> {
    if report.first_miss().is_none() {
        return vec![
            "with the priorities of the source, every deadline of the node is proven too"
                .to_owned(),
        ];
    }
    let mut urgent: Vec<String> = inversions(node).into_iter().map(|pair| pair.0).collect();
    urgent.dedup();
    let answers = report.tasks.iter();
    answers
        .filter(|answer| urgent.contains(&answer.name))
        .map(|answer| match (answer.miss(&node.name), answer.response) {
            (None, Some(response)) => format!(
                "with the priorities of the source, {} is proven to respond within {} too",
                answer.name,
                time(response)
            ),
            (miss, _) => format!(
                "with the priorities of the source, {}",
                miss.unwrap_or_default()
            ),
        })
        .collect()
}

/// The tasks of a node with their deadlines and priorities, one a line.
fn order(node: &NodeModel, report: Option<&NodeReport>) -> String {
    let proposed = propose(node);
    let rows = node.tasks.iter().map(|task| {
        let mut answers = report.iter().flat_map(|report| &report.tasks);
        let answer = answers.find(|answer| answer.name == task.name);
        let response = answer.and_then(|answer| answer.response);
        let cells = [
            task.name.clone(),
            time(shortest(task)),
            response.map_or_else(|| "-".to_owned(), time),
            task.priority.to_string(),
            proposed[&task.name].to_string(),
        ];
        (true, cells)
    });
    columns(
        [
            ("task", Align::Left),
            ("deadline", Align::Right),
            ("response", Align::Right),
            ("source", Align::Right),
            ("proposed", Align::Right),
        ],
        rows,
    )
}

/// The proposal as text. With the report of a node, it also says whether the order in the
/// source meets the deadlines.
#[must_use]
pub fn show<'a>(
    nodes: impl IntoIterator<Item = (&'a NodeModel, Option<&'a NodeReport>)>,
) -> String {
    let mut text = String::new();
    for (node, report) in nodes {
        let _ = writeln!(text, "{}", node.name);
        text.push_str(&order(node, report));
        let inversions = inversions(node);
        if inversions.is_empty() {
            let _ = writeln!(text, "  the source is deadline-monotonic");
        }
        for (urgent, other) in inversions {
            let _ = writeln!(
                text,
                "  {urgent} has the shorter deadline but a lower priority than {other}"
            );
        }
        for change in changes(node) {
            let place = match change.task.line {
                Some(line) => format!("{}:{line}", node.source),
                None => node.source.clone(),
            };
            let _ = writeln!(text, "  to change, {place}: {change}");
        }
        if let Some(report) = report {
            for sentence in proof(node, report) {
                let _ = writeln!(text, "  {sentence}");
            }
        }
    }
    text
}

/// The proposal as JSON; times in picoseconds.
#[must_use]
pub fn json<'a>(nodes: impl IntoIterator<Item = (&'a NodeModel, Option<&'a NodeReport>)>) -> Value {
    let node = |(node, report): (&NodeModel, Option<&NodeReport>)| {
        let proposed = propose(node);
        let response = |task: &TaskModel| {
            let mut answers = report.iter().flat_map(|report| &report.tasks);
            answers.find(|answer| answer.name == task.name)?.response
        };
        json!({
            "name": node.name,
            "source": node.source,
            "tasks": node.tasks.iter().map(|task| json!({
                "name": task.name,
                "line": task.line,
                "deadline_ps": shortest(task),
                "response_ps": response(task),
                "source": task.priority,
                "proposed": proposed[&task.name],
            })).collect::<Vec<_>>(),
            "inversions": inversions(node).into_iter().map(|(urgent, other)| json!({
                "shorter_deadline": urgent,
                "higher_priority": other,
            })).collect::<Vec<_>>(),
            "changes": changes(node).iter().map(|change| json!({
                "task": change.task.name,
                "from": change.task.priority,
                "to": change.to,
                "ceilings": change.ceilings.iter().map(|(resource, from, to)| json!({
                    "resource": resource, "from": from, "to": to,
                })).collect::<Vec<_>>(),
            })).collect::<Vec<_>>(),
            "proven": report.map(|report| report.first_miss().is_none()),
            "miss": report.and_then(NodeReport::first_miss),
        })
    };
    json!({ "nodes": nodes.into_iter().map(node).collect::<Vec<_>>() })
}

#[cfg(test)]
mod tests {
    use super::{changes, inversions, json, propose, show};
    use crate::arrivals::{Arrivals, Job, Kind, Timetable};
    use crate::model::{NodeModel, TaskModel};

    fn task(name: &str, priority: u32, deadline: u64) -> TaskModel {
        TaskModel {
            name: name.to_owned(),
            interrupt: name.to_owned(),
            priority,
            line: Some(7),
            locks: Vec::new(),
            arrivals: Arrivals::every(deadline),
            deadline,
            jitter: 0,
            after: None,
            off_bus: false,
            coalesces: true,
            dispatched: false,
            received: std::collections::BTreeMap::new(),
        }
    }

    fn node(tasks: Vec<TaskModel>) -> NodeModel {
        NodeModel {
            rows: String::new(),
            event_triggered: false,
            name: "n".to_owned(),
            source: "n.rs".to_owned(),
            tasks,
        }
    }

    #[test]
    fn swapped_priorities_are_found() {
        let node = node(vec![
            task("slow", 3, 900),
            task("fast", 2, 100),
            task("idle", 1, 5000),
        ]);
        assert_eq!(inversions(&node), [("fast".to_owned(), "slow".to_owned())]);
        let proposed = propose(&node);
        assert_eq!(
            [proposed["fast"], proposed["slow"], proposed["idle"]],
            [3, 2, 1]
        );
        let text = show([(&node, None)]);
        assert!(
            text.contains("fast has the shorter deadline but a lower priority than slow"),
            "{text}"
        );
        assert_eq!(json([(&node, None)])["nodes"][0]["tasks"][1]["proposed"], 3);
    }

    #[test]
    fn the_proposed_changes_are_the_least() {
        let mut urgent = task("urgent", 1, 50);
        urgent.locks = vec!["state".to_owned(), "port".to_owned()];
        let mut slow = task("slow", 4, 900);
        slow.locks = vec!["port".to_owned()];
        let node = node(vec![
            slow,
            task("fast", 2, 100),
            urgent,
            task("idle", 1, 5000),
        ]);
        let lines: Vec<String> = changes(&node).iter().map(ToString::to_string).collect();
        assert_eq!(
            lines,
            [
                "fast: `priority = 4` instead of 2",
                "urgent: `priority = 4` instead of 1, which raises the ceiling of state from 1 to 4"
            ]
        );
        // With the changes made, no inversion is left.
        let mut changed = node.clone();
        for change in changes(&node) {
            let tasks = &mut changed.tasks;
            let task = tasks.iter_mut().find(|task| task.name == change.task.name);
            task.unwrap().priority = change.to;
        }
        assert!(inversions(&changed).is_empty());
        assert!(changes(&changed).is_empty());
        let text = show([(&node, None)]);
        assert!(
            text.contains("to change, n.rs:7: fast: `priority = 4`"),
            "{text}"
        );
    }

    #[test]
    fn a_release_with_a_deadline_of_its_own_makes_its_task_urgent() {
        let mut edges = task("edges", 2, 900);
        edges.arrivals.timed = vec![Timetable {
            cycle: 1000,
            spacing: 1,
            burst: 0,
            kind: Kind::Any,
            cost: None,
            jobs: vec![Job {
                id: None,
                cause: None,
                label: "own".to_owned(),
                earliest: 0,
                latest: 0,
                deadline: Some(50),
                transmits: true,
            }],
        }];
        let node = node(vec![edges, task("receive", 2, 400)]);
        let proposed = propose(&node);
        assert!(proposed["edges"] > proposed["receive"]);
        // Equal priorities in the source are no inversion.
        assert!(inversions(&node).is_empty());
    }
}

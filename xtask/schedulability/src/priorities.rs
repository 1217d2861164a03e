//! Deadline-monotonic priorities, and where the sources differ.
//!
//! With deadlines not beyond the periods, no other static order schedules a
//! set that this one does not (Leung and Whitehead 1982), blocking aside.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::model::{NodeModel, TaskModel};
use crate::results::{Picoseconds, time};

/// The shortest deadline of a task: its own, or that of one of its releases.
fn shortest(task: &TaskModel) -> Picoseconds {
    let timed = task.arrivals.timed.iter().flat_map(|table| &table.jobs);
    timed
        .filter_map(|job| job.deadline)
        .chain([task.deadline])
        .min()
        .unwrap_or(task.deadline)
}

/// The proposed priority of each task of a node: the shortest deadline is the
/// most urgent, tasks with equal deadlines and tasks that one handler runs
/// share a priority, the least is 1.
#[must_use]
pub fn propose(node: &NodeModel) -> BTreeMap<String, u32> {
    // What one handler runs has one priority: its most urgent task's.
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

/// Pairs of tasks, the first with the shorter deadline, whose priorities in
/// the source stand the other way round.
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

/// The proposal for people.
#[must_use]
pub fn show<'a>(nodes: impl IntoIterator<Item = &'a NodeModel>) -> String {
    let mut text = String::new();
    for node in nodes {
        let _ = writeln!(text, "{}", node.name);
        let _ = writeln!(
            text,
            "  {:16} {:>12} {:>7} {:>9}",
            "task", "deadline", "source", "proposed"
        );
        let proposed = propose(node);
        for task in &node.tasks {
            let _ = writeln!(
                text,
                "  {:16} {:>12} {:>7} {:>9}",
                task.name,
                time(shortest(task)),
                task.priority,
                proposed[&task.name]
            );
        }
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
    }
    text
}

/// The proposal for programs; times in picoseconds.
#[must_use]
pub fn json<'a>(nodes: impl IntoIterator<Item = &'a NodeModel>) -> Value {
    let node = |node: &NodeModel| {
        let proposed = propose(node);
        json!({
            "name": node.name,
            "tasks": node.tasks.iter().map(|task| json!({
                "name": task.name,
                "deadline_ps": shortest(task),
                "source": task.priority,
                "proposed": proposed[&task.name],
            })).collect::<Vec<_>>(),
            "inversions": inversions(node).into_iter().map(|(urgent, other)| json!({
                "shorter_deadline": urgent,
                "higher_priority": other,
            })).collect::<Vec<_>>(),
        })
    };
    json!({ "nodes": nodes.into_iter().map(node).collect::<Vec<_>>() })
}

#[cfg(test)]
mod tests {
    use super::{inversions, json, propose, show};
    use crate::arrivals::{Arrivals, Job, Timetable};
    use crate::model::{NodeModel, TaskModel};

    fn task(name: &str, priority: u32, deadline: u64) -> TaskModel {
        TaskModel {
            name: name.to_owned(),
            interrupt: name.to_owned(),
            priority,
            arrivals: Arrivals::every(deadline),
            deadline,
            jitter: 0,
            after: None,
            off_bus: false,
            hardware: true,
        }
    }

    fn node(tasks: Vec<TaskModel>) -> NodeModel {
        NodeModel {
            name: "n".to_owned(),
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
        let text = show([&node]);
        assert!(
            text.contains("fast has the shorter deadline but a lower priority than slow"),
            "{text}"
        );
        assert_eq!(json([&node])["nodes"][0]["tasks"][1]["proposed"], 3);
    }

    #[test]
    fn a_release_with_a_deadline_of_its_own_makes_its_task_urgent() {
        let mut edges = task("edges", 2, 900);
        edges.arrivals.timed = Some(Timetable {
            cycle: 1000,
            spacing: 1,
            jobs: vec![Job {
                label: "own".to_owned(),
                earliest: 0,
                latest: 0,
                deadline: Some(50),
            }],
        });
        let node = node(vec![edges, task("receive", 2, 400)]);
        let proposed = propose(&node);
        assert!(proposed["edges"] > proposed["receive"]);
        // Equal priorities in the source are no inversion.
        assert!(inversions(&node).is_empty());
    }
}

//! Deadline-monotonic priorities, and where the sources differ.
//!
//! With deadlines not beyond the periods, no other static order schedules a
//! set that this one does not (Leung and Whitehead 1982), blocking aside.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::system::{NodeReport, time};

/// The proposed priority of each task of a node: the shortest deadline is the
/// most urgent, tasks with equal deadlines and tasks that one dispatcher runs
/// share a priority, the least is 1.
#[must_use]
pub fn propose(node: &NodeReport) -> BTreeMap<String, u32> {
    // What one handler runs has one priority: its most urgent task's.
    let mut of_handler: BTreeMap<&str, u64> = BTreeMap::new();
    for task in &node.tasks {
        let deadline = of_handler.entry(&task.interrupt).or_insert(task.deadline);
        *deadline = task.deadline.min(*deadline);
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
pub fn inversions(node: &NodeReport) -> Vec<(String, String)> {
    let mut pairs = Vec::new();
    for urgent in &node.tasks {
        for other in &node.tasks {
            if urgent.deadline < other.deadline && urgent.priority < other.priority {
                pairs.push((urgent.name.clone(), other.name.clone()));
            }
        }
    }
    pairs
}

/// The proposal for people.
#[must_use]
pub fn show(nodes: &[NodeReport]) -> String {
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
                time(task.deadline),
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

#[cfg(test)]
mod tests {
    use super::{inversions, propose};
    use crate::system::{NodeReport, TaskReport};

    fn task(name: &str, priority: u32, deadline: u64) -> TaskReport {
        TaskReport {
            name: name.to_owned(),
            interrupt: name.to_owned(),
            priority,
            cycles: [0; 2],
            observed: None,
            cost: 0,
            period: deadline,
            deadline,
            blocking: 0,
            response: Some(0),
            slack: None,
            problems: Default::default(),
            panics: Vec::new(),
            annotated: Default::default(),
            path: Vec::new(),
            program: None,
        }
    }

    #[test]
    fn swapped_priorities_are_found() {
        let node = NodeReport {
            name: "n".to_owned(),
            tasks: vec![
                task("slow", 3, 900),
                task("fast", 2, 100),
                task("idle", 1, 5000),
            ],
            stack: 0,
            stack_size: 0,
            stack_unknown: Default::default(),
            utilisation_permille: 0,
            idle_problems: Default::default(),
        };
        assert_eq!(inversions(&node), [("fast".to_owned(), "slow".to_owned())]);
        let proposed = propose(&node);
        assert_eq!(
            [proposed["fast"], proposed["slow"], proposed["idle"]],
            [3, 2, 1]
        );
    }
}

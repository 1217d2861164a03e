//! Blocking by critical sections under the Stack Resource Policy (Baker 1991).

use super::task::Task;

/// A stretch of a task that runs with its resource locked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CriticalSection {
    /// Priority of the task that holds the lock.
    pub holder: u32,
    /// Ceiling: the priority to which the lock raises its holder.
    pub ceiling: u32,
    /// Longest time for which the lock is held.
    pub length: u64,
}

/// Longest blocking of a task at `priority`: the longest section that a lower priority holds
/// with a ceiling at least as high. Each job is blocked at most once.
#[must_use]
pub fn blocking(sections: &[CriticalSection], priority: u32) -> u64 {
    blocker(sections, priority).map_or(0, |at| sections[at].length)
}

/// Index of the section that causes this blocking.
#[must_use]
pub fn blocker(sections: &[CriticalSection], priority: u32) -> Option<usize> {
    sections
        .iter()
        .enumerate()
        .filter(|(_, section)| section.holder < priority && section.ceiling >= priority)
        .max_by_key(|(_, section)| section.length)
        .map(|(at, _)| at)
}

/// What a job of `priority` may still have to do again, beyond its cost, of what it lost when it was
/// preempted by a job of `tasks` that has completed since.
#[must_use]
pub(super) fn lost(tasks: &[Task], priority: u32) -> u64 {
    let above = tasks.iter().filter(|task| task.priority > priority);
    above
        .map(|task| task.preemption.at(priority))
        .max()
        .unwrap_or(0)
}

/// The same as [`blocking`] in a set of tasks: when the task is released, the holder of the section
/// may just have been preempted by a job above the ceiling.
#[must_use]
pub fn blocked(tasks: &[Task], sections: &[CriticalSection], priority: u32) -> u64 {
    match blocking(sections, priority) {
        0 => 0,
        longest => longest + lost(tasks, priority),
    }
}

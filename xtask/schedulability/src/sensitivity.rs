//! By how much the execution time of a task may grow before a task misses its deadline.

use crate::response::{Task, all_meet};

/// By how much the execution time of `tasks[index]` may grow before a task of the set, itself
/// included, misses its deadline. The result is below the exact value, by at most `step` or one
/// per cent. `None` if a deadline is missed already.
#[must_use]
pub fn slack(tasks: &[Task], index: usize, step: u64) -> Option<u64> {
    let fits = |extra: u64| {
        let mut longer = tasks.to_vec();
        let task = &mut longer[index];
        task.cost = task.cost.saturating_add(extra);
        for table in &mut task.arrivals.timed {
            table.cost = table.cost.map(|cost| cost.saturating_add(extra));
        }
        all_meet(&longer)
    };
    if !fits(0) {
        return None;
    }
    let mut low = 0;
    let mut high = tasks[index].deadline.max(1);
    if fits(high) {
        return Some(high);
    }
    while high - low > step.max(low / 100).max(1) {
        let middle = low + (high - low) / 2;
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(low)
}

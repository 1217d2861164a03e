//! Simulates one processor under static priorities, tick by tick.

use schedulability::response::CriticalSection;

/// A job to run.
pub(crate) struct Job {
    pub(crate) task: usize,
    /// Instant from which its response time counts.
    pub(crate) arrival: u64,
    pub(crate) release: u64,
    pub(crate) cost: u64,
    pub(crate) priority: u32,
}

/// Longest response time of each of `tasks` tasks up to `horizon`. Locks follow Baker's model: a job
/// runs at the ceiling from its first tick to the end of the section of its priority.
pub(crate) fn longest(
    jobs: &[Job],
    sections: &[CriticalSection],
    tasks: usize,
    horizon: u64,
) -> Vec<u64> {
    let mut done = vec![0; jobs.len()];
    let mut longest = vec![0; tasks];
    for now in 0..horizon {
        let current = |at: usize| {
            let own = jobs[at].priority;
            sections
                .iter()
                .filter(|s| s.holder == own && done[at] > 0 && done[at] < s.length)
                .map(|s| s.ceiling)
                .max()
                .unwrap_or(own)
        };
        let next = (0..jobs.len())
            .filter(|&at| jobs[at].release <= now && done[at] < jobs[at].cost)
            // A job that has started goes before others of equal priority.
            .max_by_key(|&at| {
                let first = std::cmp::Reverse((jobs[at].arrival, at));
                (current(at), done[at] > 0, first)
            });
        if let Some(at) = next {
            done[at] += 1;
            if done[at] == jobs[at].cost {
                let response = now + 1 - jobs[at].arrival;
                longest[jobs[at].task] = longest[jobs[at].task].max(response);
            }
        }
    }
    longest
}

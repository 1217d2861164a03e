//! Blocking by critical sections under the Stack Resource Policy (Baker 1991).

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

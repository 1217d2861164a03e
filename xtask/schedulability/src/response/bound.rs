//! What the response-time analysis gives: a bound, or the reason why there is none.

/// Worst response of one job of the time table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JobResponse {
    /// Earliest release of the job.
    pub earliest: u64,
    /// Latest release of the job.
    pub latest: u64,
    /// Its worst response time.
    pub response: u64,
    /// The same without the tasks that run off the bus ([`Task::off_bus`](super::Task::off_bus)).
    pub on_bus: u64,
}

/// Result of the analysis of one task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// Worst response time, measured from the nominal release time: jitter is included.
    pub worst: u64,
    /// Response times of the jobs of the longest busy period, in order.
    pub jobs: Vec<u64>,
    /// The job with the least slack.
    pub critical: Critical,
    /// Worst response of each job of the time table.
    pub by_job: Vec<JobResponse>,
}

/// The job of a task that comes closest to its deadline, or misses it by the most.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Critical {
    /// Label of the job, if it is one of the time table.
    pub job: Option<String>,
    /// Its worst response time.
    pub response: u64,
    /// Its deadline.
    pub deadline: u64,
    /// Its own execution time, which `response` includes.
    pub cost: u64,
    /// Release jitter, which `response` includes.
    pub jitter: u64,
    /// Interference that `response` includes, but for what passes before the release of the job.
    pub delayed_by: Vec<Delay>,
}

/// Interference by the jobs of one task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delay {
    /// Index of the task.
    pub task: usize,
    /// How many of its jobs.
    pub jobs: u64,
    /// How long they take in all.
    pub time: u64,
}

impl Critical {
    /// Whether every deadline of the task holds.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.response <= self.deadline
    }

    pub(super) fn has_less_slack_than(&self, other: &Self) -> bool {
        let slack = |c: &Self| i128::from(c.deadline) - i128::from(c.response);
        slack(self) < slack(other)
    }
}

/// Why no response time exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unbounded {
    /// The task and everything of its priority or above demand more than the processor has.
    #[error("the processor is overloaded: the demand at this priority is {permille} per mille")]
    Overload {
        /// Demand in thousandths of the processor, rounded up.
        permille: u64,
    },
    /// The busy period did not end within the range of the analysis.
    #[error("the busy period does not end within the range of the analysis")]
    Diverges,
    /// A task of the set has a period of zero.
    #[error("a task has a minimum inter-arrival time of zero")]
    ZeroPeriod,
    /// The task that releases this one has no bound itself.
    #[error("the task that releases it has no response time")]
    Cause,
}

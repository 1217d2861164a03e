//! Response times on one processor under static priorities.
//!
//! The model is that of RTIC. A job runs to completion at a static priority. A lock raises
//! the priority to the ceiling of its resource (Stack Resource Policy, Baker 1991), so a job
//! is blocked at most once, before it starts.
//!
//! Jobs of equal priority do not preempt one another but may be served in any order. They
//! are counted as interference, which bounds every order from above. Jobs of one task are served in
//! the order of their nominal releases.
//!
//! Time is any whole number of one unit shared by all tasks (the command uses picoseconds);
//! the recurrences do not depend on the unit.

mod analyse;
mod blocking;
mod bound;
mod busy_period;
mod carry_in;
mod counted;
mod fixed_point;
mod phases;
mod task;

pub use analyse::{all_meet, analyse};
pub use blocking::{CriticalSection, blocked, blocker, blocking};
pub use bound::{Critical, Delay, JobResponse, Response, Unbounded};
pub use busy_period::{meets, response};
pub use task::{Preemption, Task, utilisation_permille};

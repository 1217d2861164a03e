//! Random fault sequences against the release images of all four nodes.
//!
//! [`Sequence`] draws from a seed what goes wrong, where and when; [`judge`](rules::judge) says
//! which of the [`rules`] the run broke; [`run`] does that for many seeds on all cores and sums
//! them up in a [`Report`]. [`agreement`] compares the nodes' global times; [`traffic`] puts the frames of any run together and judges their
//! places by the network file.

pub mod agreement;
mod report;
pub mod rules;
mod run;
mod sequence;
pub mod traffic;

pub use report::Report;
pub use rules::Violation;
pub use run::{Options, Progress, Shard, ShardError, Verdict, replay, run, stall};
pub use sequence::{Sequence, Upset};

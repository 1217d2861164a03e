//! Random fault sequences and attacks against the release images of a vehicle.
//!
//! [`Sequence`] draws from a seed which faults and which [attacks](attack) occur, where and when; [`judge`](rules::judge) says
//! which of the [`rules`] the run broke; [`run`] does that for many seeds on all cores and sums
//! them up in a [`Report`]. [`agreement`] compares the nodes' global times; [`traffic`] puts the
//! frames of any run together and judges their places by the network file.

use std::borrow::Cow;

/// A word of this crate: of a rule, or of a kind of attack.
pub type Word = Cow<'static, str>;

pub mod agreement;
pub mod attack;
mod journal;
mod merge;
mod options;
mod report;
pub mod rules;
mod run;
mod sequence;
mod sound;
pub mod traffic;

pub use journal::{Journal, JournalError, Lines};
pub use merge::{MergeError, merge};
pub use options::{Options, Shard, ShardError, Trouble};
pub use report::{Campaign, Cause, Report, Verdict, digests, quoted};
pub use rules::Violation;
pub use run::{Progress, play, replay, run, stall};
pub use sequence::{Sequence, Upset};

/// The vehicle that the tests of this crate judge.
#[cfg(test)]
fn uagv() -> vehicle_model::Vehicle {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/vehicles/uagv");
    vehicle_model::Vehicle::read(folder.as_ref()).expect("a sound vehicle")
}

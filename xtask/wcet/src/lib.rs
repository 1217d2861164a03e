//! Worst-case execution times from the image.
//!
//! The analysis runs every path of a task at once on an abstract machine
//! ([`analysis`]): registers and stack words hold sets of values, branches
//! that no element can take are not followed, and loops are run turn by turn
//! until no element stays inside. What that teaches (which edges are possible
//! and how often) bounds an integer linear program.

pub mod analysis;
pub mod annotation;
pub mod arrays;
pub mod execute;
pub mod flags;
pub mod graph;
pub mod image;
pub mod instruction;
pub mod invariant;
pub mod ipet;
pub mod kernels;
pub mod lasting;
pub mod range;
pub mod runtime;
pub mod software;
pub mod stack;
pub mod state;
pub mod timing;
pub mod value;
pub mod watch;

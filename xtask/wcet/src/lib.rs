//! Worst-case execution times (WCET) from the image.
//!
//! [`analysis`] runs every path of a task at once on an abstract machine (`state`,
//! `execute`). Registers and stack words hold sets of values. A branch is not followed in a
//! direction that no element of its operands allows. Loops run turn by turn until no element
//! stays inside. The result is a bound, together with facts about the edges: which are possible
//! and how often (`facts`). From these, [`ipet`] builds an integer linear program whose
//! solution is the longest path. The same run finds the interrupts that stores make pending
//! ([`pend`]).
//!
//! ```text
//! image, instruction, graph, annotation -> program --+
//! range -> value, flags -> symbols -> state          +-> analysis -> bound, facts -> ipet
//! part -> timing      execute, flash ---------------+                            -> watch
//! ```

pub mod analysis;
pub mod annotation;
mod arrays;
pub mod bound;
pub mod cycles;
mod debug;
mod execute;
pub mod extent;
mod facts;
mod flags;
pub mod flash;
pub mod graph;
pub mod image;
pub mod instruction;
mod invariant;
pub mod ipet;
pub mod kernels;
pub mod lasting;
mod layout;
pub mod mask;
mod merge;
pub mod part;
pub mod pend;
mod program;
mod range;
pub mod reading;
pub mod register;
mod runtime;
mod signatures;
mod slots;
pub mod slowest;
pub mod software;
pub mod stack;
mod state;
mod symbols;
pub mod timing;
mod value;
pub mod watch;

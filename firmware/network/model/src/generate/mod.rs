//! Writes the Rust of a network: its message types and its system matrix.
//!
//! The text is meant for a build script, which puts it where the network crate
//! includes it. What it refers to (`Message`, `DecodeError`, `Signal` and, for
//! the matrix, the crate `ttcan`) is brought into scope by that crate.

mod matrix;
mod messages;
mod names;
mod types;

pub use matrix::matrix;
pub use messages::messages;

//! Writes the Rust of a network: its message types and its system matrix.
//!
//! The text is meant for a build script, which puts it where the network crate
//! includes it. That crate brings into scope what the text refers to: its own
//! `Message`, `DecodeError` and `Signal`, and the types of `ttcan`.

mod matrix;
mod messages;
mod names;
mod types;

pub use matrix::matrix;
pub use messages::messages;

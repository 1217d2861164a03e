//! `cargo deadlines`: do the tasks of an RTIC 2 application meet their deadlines?
//!
//! The application's release image says how long each task takes at most, its sources say which
//! priority it has, and a task table says what releases it. From these follow a response time for each task and
//! an answer. No board and no run is needed; where the part is emulated, a run can be held against the answer.
//!
//! ```text
//! project -> image ----------+
//! project -> source (app) ---+-> model -> analysis -> report (text, JSON, page, annotations)
//! table (TOML, comments) ----+              |
//! parts (TOML) --------------+              +-> baseline, seen, emulated
//! ```

#![forbid(unsafe_code)]

pub mod analysis;
pub mod app;
pub mod baseline;
pub mod cli;
pub mod comment;
#[cfg(feature = "emulator")]
pub mod emulated;
mod error;
pub mod init;
pub mod model;
pub mod parts;
pub mod project;
pub mod report;
pub mod seen;
pub mod table;
mod wrong;

pub use cli::run;
pub use error::Error;

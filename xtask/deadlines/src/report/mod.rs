//! The answers: as text, as JSON, as a page, and as annotations of the sources.

mod findings;
mod github;
mod json;
mod sarif;

pub use findings::{Finding, findings};
pub use github::github;
pub use json::json;
pub use sarif::sarif;

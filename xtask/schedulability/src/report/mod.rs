//! The report: as text for a terminal, as JSON for programs and as a page for a browser.

pub mod application;
mod cells;
mod columns;
mod explain;
mod html;
mod json;
mod kernels;
mod summary;
mod table;
mod timeline;

pub(crate) use columns::{Align, columns};
pub use explain::{explain, explain_as_flashed};
pub use html::html;
pub use json::{json, node as json_of_node};
pub use kernels::kernels;
pub use table::table;

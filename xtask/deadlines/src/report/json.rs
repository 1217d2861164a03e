//! The report for programs, and for `--baseline`.

use schedulability::report::json_of_node;
use serde_json::{Value, json};

use crate::analysis::Answer;

/// The whole report; times in picoseconds.
#[must_use]
pub fn json(answer: &Answer) -> Value {
    let mut report = json_of_node(&answer.node);
    report["schedulable"] = json!(answer.first_miss().is_none());
    report["first_miss"] = json!(answer.first_miss());
    report["assumptions"] = json!(answer.assumptions);
    report["source"] = json!(answer.source);
    report
}

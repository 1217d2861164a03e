//! Findings as SARIF 2.1.0 (OASIS), which code hosts show beside the source.

use serde_json::{Value, json};

use super::findings::Finding;

/// The rules: identifier and what a finding of it says.
const RULES: [(&str, &str); 4] = [
    ("deadline", "A task may miss its deadline"),
    ("bound", "Code has no bound of its execution time"),
    ("stack", "The stack may be too small"),
    ("slack", "A task lost more slack than is allowed"),
];

/// One run with these findings.
#[must_use]
pub fn sarif(findings: &[Finding]) -> Value {
    let rules = RULES.map(|(id, text)| json!({ "id": id, "shortDescription": { "text": text } }));
    let results = findings.iter().map(|finding| {
        json!({
            "ruleId": finding.rule,
            "level": "error",
            "message": { "text": finding.message },
            "locations": [{
                "physicalLocation": {
                    "artifactLocation": { "uri": finding.file },
                    "region": { "startLine": finding.line },
                },
            }],
        })
    });
    json!({
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{
            "tool": {
                "driver": {
                    "name": "cargo-deadlines",
                    "version": env!("CARGO_PKG_VERSION"),
                    "rules": rules,
                },
            },
            "results": results.collect::<Vec<_>>(),
        }],
    })
}

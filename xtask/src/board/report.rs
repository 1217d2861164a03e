//! The outcomes of a board's tests: a table, and JSON.

use serde::Serialize;

use parts::Sled;

use super::{Outcome, Verdict};

/// One line for each test, and one for all.
pub(super) fn table(sled: &Sled, place: &str, verdicts: &[Verdict]) -> String {
    let width = |of: fn(&Verdict) -> usize| verdicts.iter().map(of).max().unwrap_or(0);
    let subjects = width(|verdict| verdict.test.subject.len());
    let names = width(|verdict| verdict.test.name.len());
    let mut table = String::new();
    for verdict in verdicts {
        let outcome = match &verdict.outcome {
            Outcome::Passed => "passed".to_owned(),
            Outcome::Failed(why) => format!("FAILED: {why}"),
        };
        let time = verdict
            .seconds
            .map_or(String::new(), |seconds| format!("{:.1} ms", 1e3 * seconds));
        table += &format!(
            "{:<subjects$}  {:<names$}  {time:>10}  {outcome}\n",
            verdict.test.subject.replace('_', " "),
            verdict.test.sentence(),
        );
    }
    let passed = verdicts.iter().filter(|verdict| super::passed(verdict));
    let (passed, of) = (passed.count(), verdicts.len());
    let place = match place {
        "twin" => "on the twin (no board was involved)",
        _ => "on the board",
    };
    table + &format!("{}: {passed} of {of} tests passed {place}\n", sled.title)
}

#[derive(Serialize)]
struct Report<'a> {
    node: &'a str,
    vehicle: &'a str,
    board: &'a str,
    /// `twin` or `board`.
    on: &'a str,
    tests: Vec<Row<'a>>,
}

#[derive(Serialize)]
struct Row<'a> {
    subject: &'a str,
    name: &'a str,
    passed: bool,
    why: Option<&'a str>,
    seconds: Option<f64>,
    log: &'a [String],
}

/// The same as JSON.
pub(super) fn json(
    node: &str,
    vehicle: &str,
    sled: &Sled,
    place: &str,
    verdicts: &[Verdict],
) -> String {
    let tests = verdicts.iter().map(|verdict| Row {
        subject: &verdict.test.subject,
        name: &verdict.test.name,
        passed: super::passed(verdict),
        why: match &verdict.outcome {
            Outcome::Passed => None,
            Outcome::Failed(why) => Some(why),
        },
        seconds: verdict.seconds,
        log: &verdict.log,
    });
    let report = Report {
        node,
        vehicle,
        board: sled.name,
        on: place,
        tests: tests.collect(),
    };
    // Serialising plain numbers and texts cannot fail.
    serde_json::to_string_pretty(&report).unwrap_or_default()
}

//! The task table: `deadlines.toml` beside the manifest of the application's package.
//!
//! ```toml
//! part = "stm32f411"        # `cargo deadlines parts` lists them; or a file that ends in .toml
//! core_hz = 100_000_000     # the clock that the program sets
//!
//! [task.blink]
//! every_us = 10_000
//! deadline_us = 5_000
//! ```
//!
//! A value that is `"?"` is a question that `cargo deadlines init` left.

use std::collections::BTreeMap;

use schedulability::table::{LONGEST_US, LoopBound, OutOfRange, PendedBy, Several};
use serde::Deserialize;

use crate::error::Error;
use crate::wrong;

/// What stands where a value is still to be written.
pub const QUESTION: &str = "?";

/// The task table of one application.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Name of a part, or of a part's file relative to this one.
    pub part: Option<String>,
    /// Clock of the core, in Hz.
    pub core_hz: Option<u32>,
    /// Clock of the slowest bus of peripherals that the program uses, in Hz.
    pub bus_hz: Option<u32>,
    /// Clock of the bus of the part's fast peripherals, in Hz.
    pub fast_bus_hz: Option<u32>,
    /// Wait states of the flash, if not the fewest for the clock.
    pub flash_waits: Option<u32>,
    /// Whether the program switches on the reading ahead and the caches of its part's flash.
    #[serde(default)]
    pub flash_accelerator: bool,
    /// Bytes of the stack, if not what the image leaves for it.
    pub stack_bytes: Option<u32>,
    /// Rows of the tasks, and of handlers that are no task, by name.
    #[serde(default)]
    pub task: BTreeMap<String, Row>,
    /// Loops in sources that are not one's own, by their places as messages have them, or by their functions.
    #[serde(default)]
    pub bounds: BTreeMap<String, LoopBound>,
}

/// What releases a task, and by when it must be done; times in microseconds.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Least time between two releases, one value for each independent cause.
    #[serde(default, deserialize_with = "several")]
    pub every_us: Vec<u64>,
    /// Releases in bursts.
    pub burst: Option<Burst>,
    /// How much later than its nominal instant it may be released.
    #[serde(default)]
    pub jitter_us: u64,
    /// Least time between any two of its releases, whatever causes them; before the jitter.
    pub apart_us: Option<u64>,
    /// The task that pends it: that task's response time is its jitter.
    pub after: Option<String>,
    /// Who else pends it, by name: tasks, itself included, `init` or `idle`.
    #[serde(default)]
    pub pended_by: BTreeMap<String, PendedBy>,
    /// Deadline after the release.
    pub deadline_us: Option<u64>,
    /// Priority of a handler that is no task, if it is not RTIC's for a monotonic.
    pub priority: Option<u32>,
}

/// Releases in bursts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Burst {
    /// The most releases in one burst.
    pub jobs: u64,
    /// Least time between two of them.
    pub apart_us: u64,
    /// Least time between the begins of two bursts.
    pub every_us: u64,
}

fn several<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<u64>, D::Error> {
    Ok(Several::<u64>::deserialize(from)?.as_slice().to_vec())
}

impl Table {
    /// Reads the text of a table; `file` names it in messages.
    ///
    /// # Errors
    /// It is not understood, a question is left, or a number is out of range.
    pub fn parse(text: &str, file: &str) -> Result<Self, Error> {
        if let Some(question) = question(text) {
            return Err(Error::input(format!("{file}:{question}")));
        }
        let table: Self = toml::from_str(text).map_err(|error| {
            let line = error
                .span()
                .map(|span| 1 + text[..span.start].matches('\n').count());
            let line = line.map_or_else(String::new, |line| format!(":{line}"));
            let what = error
                .span()
                .and_then(|span| wrong::value(text, span, error.message()));
            let what = what.unwrap_or_else(|| error.message().trim().to_owned());
            Error::input(format!("{file}{line}: {what}"))
        })?;
        for (task, row) in &table.task {
            row.check()
                .map_err(|what| Error::input(format!("{file}: task {task} {what}")))?;
        }
        for (place, bound) in &table.bounds {
            let wrong = |what| Error::input(format!("{file}: the bound of {place} has {what}"));
            bound.check().map_err(wrong)?;
        }
        Ok(table)
    }
}

/// The first question in a table: its line and a sentence.
fn question(text: &str) -> Option<String> {
    let mut task = None;
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if let Some(heading) = line.strip_prefix("[task.") {
            task = heading.split(']').next();
            continue;
        }
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let value = value.split('#').next().unwrap_or_default().trim();
        if key.starts_with('#') || value.trim_matches('"') != QUESTION || value == QUESTION {
            continue;
        }
        let of = task.map_or_else(String::new, |task| format!(" of task {task}"));
        return Some(format!(
            "{number}: `{}`{of} is still a question: write a value in place of \"{QUESTION}\"",
            key.trim()
        ));
    }
    None
}

impl Row {
    /// Checks its numbers and its bounds; the error ends a sentence that begins with the task.
    ///
    /// # Errors
    /// A number is out of range, or `pended_by` says of one who pends what does not go with it.
    pub(crate) fn check(&self) -> Result<(), String> {
        let accept = |key, value, least, most| {
            OutOfRange::check(key, value, least, most).map_err(|number| format!("has {number}"))
        };
        let bounded = self.pended_by.values().filter_map(|how| match how {
            PendedBy::Bounded(bounded) => Some(bounded),
            PendedBy::Run(_) => None,
        });
        let often = bounded
            .clone()
            .flat_map(|bounded| bounded.every_us.as_slice());
        for every in self.every_us.iter().chain(often) {
            accept("every_us", *every, 1, LONGEST_US)?;
        }
        if let Some(burst) = self.burst {
            accept("burst.jobs", burst.jobs, 1, 10_000)?;
            accept("burst.apart_us", burst.apart_us, 1, LONGEST_US)?;
            accept("burst.every_us", burst.every_us, 1, LONGEST_US)?;
        }
        accept("jitter_us", self.jitter_us, 0, LONGEST_US)?;
        for (key, value) in [
            ("apart_us", self.apart_us),
            ("deadline_us", self.deadline_us),
        ] {
            if let Some(value) = value {
                accept(key, value, 1, LONGEST_US)?;
            }
        }
        for (pender, how) in &self.pended_by {
            how.check(pender).map_err(|fault| fault.to_string())?;
        }
        for bounded in bounded {
            if !bounded.every.as_slice().is_empty() {
                return Err("has `every` under `pended_by`: `every_us` is accepted".to_owned());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::Table;

    fn error(text: &str) -> String {
        Table::parse(text, "deadlines.toml")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_table_is_read() {
        let text = "part = \"stm32f1\"\ncore_hz = 72_000_000\n\
             [task.a]\nevery_us = 10_000\ndeadline_us = 5000\npended_by.init = \"once\"\n\
             [task.b]\nevery_us = [1, 2]\nburst = { jobs = 3, apart_us = 10, every_us = 100 }\n";
        let table = Table::parse(text, "t").unwrap();
        assert_eq!(table.task["a"].every_us, [10_000]);
        assert_eq!(table.task["b"].every_us, [1, 2]);
        assert_eq!(table.task["b"].burst.unwrap().jobs, 3);
    }

    #[test]
    fn a_question_is_named_with_its_line() {
        assert_eq!(
            error("part = \"stm32f1\"\n\n[task.blink]\nevery_us = \"?\" # how often?\n"),
            "deadlines.toml:4: `every_us` of task blink is still a question: write a value in place of \"?\""
        );
        assert_eq!(
            error("core_hz = \"?\""),
            "deadlines.toml:1: `core_hz` is still a question: write a value in place of \"?\""
        );
        assert!(Table::parse("# core_hz = \"?\"", "t").is_ok());
    }

    #[test]
    fn what_is_wrong_has_its_line() {
        assert!(
            error("[task.a]\nevry_us = 1\n")
                .starts_with("deadlines.toml:2: unknown field `evry_us`")
        );
        assert_eq!(
            error("[task.a]\nevery_us = 0\n"),
            "deadlines.toml: task a has `every_us` = 0: 1 to 3600000000 is accepted"
        );
        assert_eq!(
            error("[task.a]\npended_by.b = { every_us = 1, because = \" \" }\n"),
            "deadlines.toml: task a is pended by b, but `because` gives no reason"
        );
        for (pender, run) in [("b", "once"), ("init", "each"), ("idle", "once")] {
            let text = format!("[task.a]\npended_by.{pender} = \"{run}\"\n");
            assert_eq!(
                error(&text),
                format!(
                    "deadlines.toml: task a is pended by {pender} \"{run}\", but \"each\" is for other tasks and \
                     \"once\" for init: write {{ every_us = N, because = \"...\" }}"
                )
            );
        }
        assert_eq!(
            error("[bounds]\n\"a.rs:1\" = { turns = 1, because = \"\" }\n"),
            "deadlines.toml: the bound of a.rs:1 has a `because` that gives no reason"
        );
        assert_eq!(
            error("[bounds]\n\"a.rs:1\" = { turns = 0, because = \"it ends\" }\n"),
            "deadlines.toml: the bound of a.rs:1 has `turns` = 0: 1 to 999999999 is accepted"
        );
    }
}

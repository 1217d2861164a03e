//! Sentences about values of the table that have the wrong type.

use std::ops::Range;

/// What a key takes, as the begin of "... is accepted".
fn accepted(key: &str, in_burst: bool) -> Option<&'static str> {
    Some(match key {
        "part" => "a name in quotes that `cargo deadlines parts` lists, or that of a TOML file,",
        "core_hz" | "bus_hz" | "fast_bus_hz" => "a whole number of Hz from 1 to 4294967295",
        "flash_waits" => "a whole number of wait states from 0 to 255",
        "flash_accelerator" => "true or false",
        "stack_bytes" => "a whole number of bytes from 1 to those of the RAM",
        "every_us" if !in_burst => {
            "a whole number of microseconds from 1 to 3600000000, or a list of them,"
        }
        "every_us" | "apart_us" | "deadline_us" => {
            "a whole number of microseconds from 1 to 3600000000"
        }
        "jitter_us" => "a whole number of microseconds from 0 to 3600000000",
        "burst" => "{ jobs = N, apart_us = N, every_us = N }",
        "jobs" => "a whole number from 1 to 10000",
        "after" => "the name of a task in quotes",
        "pended_by" => {
            "`pended_by.NAME = \"each\"`, `\"once\"` or `{ every_us = N, because = \"...\" }`"
        }
        "priority" => "a whole number from 1 to that of the part's priorities",
        "turns" => "a whole number from 1 to 999999999",
        "because" => "a reason in quotes",
        "bounds" => {
            "a line `\"PLACE\" = { turns = N, because = \"...\" }` under [bounds] for each loop"
        }
        "task" => "a heading [task.NAME] for each task",
        _ => return None,
    })
}

/// The key before a value: its last part, and its line from the begin, for what is around it.
fn key_before(text: &str, value: usize) -> Option<(&str, &str)> {
    let before = text.get(..value)?;
    let equals = before.rfind('=')?;
    let line = &before[before[..equals].rfind('\n').map_or(0, |at| at + 1)..equals];
    let begin = line.rfind(['{', ',']).map_or(0, |at| at + 1);
    let key = line[begin..].trim();
    Some((key.rsplit('.').next().unwrap_or(key).trim(), line))
}

/// The sentence about the value at `span`, if the parser complains of its type by `message`.
pub(crate) fn value(text: &str, span: Range<usize>, message: &str) -> Option<String> {
    let (key, line) = key_before(text, span.start)?;
    let headings = text[..span.start].lines();
    let mut of = headings.filter_map(|line| line.trim().strip_prefix("[task."));
    let of = of.next_back().and_then(|task| task.split(']').next());
    let of = of.map_or_else(String::new, |task| format!(" of task {task}"));
    if let Some(field) = message.strip_prefix("missing field ") {
        let accepted = accepted(key, false)?;
        return Some(format!(
            "`{key}`{of} has no {}: {} is accepted",
            field.trim(),
            accepted.trim_end_matches(',')
        ));
    }
    let is_of_type = ["invalid type", "invalid value", "one value or a list"];
    if !is_of_type.iter().any(|begin| message.starts_with(begin)) {
        return None;
    }
    let in_burst = key != "burst" && line.contains("burst");
    let accepted = accepted(key, in_burst)?;
    let value = text.get(span)?.lines().next()?;
    Some(format!("`{key}`{of} is {value}: {accepted} is accepted"))
}

#[cfg(test)]
mod tests {
    use crate::table::Table;

    #[test]
    fn a_value_of_the_wrong_type_names_its_key_and_what_is_accepted() {
        let us = "a whole number of microseconds from 1 to 3600000000";
        for (line, what) in [
            ("every_us = -300", format!("`every_us` of task a is -300: {us}, or a list of them, is accepted")),
            (
                "every_us = [1, \"x\"]",
                format!("`every_us` of task a is [1, \"x\"]: {us}, or a list of them, is accepted"),
            ),
            ("deadline_us = \"soon\"", format!("`deadline_us` of task a is \"soon\": {us} is accepted")),
            ("deadline_us = 1.5", format!("`deadline_us` of task a is 1.5: {us} is accepted")),
            (
                "deadline_us = 99999999999999999999",
                format!("`deadline_us` of task a is 99999999999999999999: {us} is accepted"),
            ),
            (
                "burst = { jobs = 2, apart_us = 1, every_us = -5 }",
                format!("`every_us` of task a is -5: {us} is accepted"),
            ),
            (
                "burst = { jobs = 2, apart_us = 1 }",
                "`burst` of task a has no `every_us`: { jobs = N, apart_us = N, every_us = N } is accepted".to_owned(),
            ),
            ("after = 3", "`after` of task a is 3: the name of a task in quotes is accepted".to_owned()),
            (
                "pended_by.b = -1",
                "`pended_by` takes \"each\", \"once\" or { every_us = N, because = \"...\" }".to_owned(),
            ),
        ] {
            let text = format!("part = \"stm32f1\"\n[task.a]\n{line}\n");
            let said = Table::parse(&text, "deadlines.toml").unwrap_err();
            assert_eq!(said.to_string(), format!("deadlines.toml:3: {what}"));
        }
        let said = Table::parse("core_hz = -1\n", "deadlines.toml").unwrap_err();
        assert_eq!(
            said.to_string(),
            "deadlines.toml:1: `core_hz` is -1: a whole number of Hz from 1 to 4294967295 is accepted"
        );
        // What is no matter of a type is said as the parser says it.
        let said = Table::parse("core_hz =\n", "deadlines.toml").unwrap_err();
        assert!(!said.to_string().contains("is accepted"), "{said}");
    }
}

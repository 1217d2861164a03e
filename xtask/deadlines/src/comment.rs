//! Releases and deadline of a task in the comment above it:
//! `/// deadline: every 10 ms, within 5 ms`.
//!
//! Clauses, separated by commas: `every T` (one for each independent cause), `within T`, `jitter T`,
//! `after TASK`, `apart T`, `burst N apart T every T`. A time is a number and `us`, `ms` or `s`.

use syn::spanned::Spanned;

use crate::error::Error;
use crate::table::{Burst, Row};

/// What a comment says about its task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Comment {
    /// File and line.
    pub place: String,
    /// The row of the task.
    pub row: Row,
}

/// The mark of such a line.
const MARK: &str = "deadline:";

/// The comment among the attributes of a task's function, if there is one.
///
/// # Errors
/// It is not understood, a number is out of range, or there are two.
pub fn of(attributes: &[syn::Attribute], file: &str, task: &str) -> Result<Option<Comment>, Error> {
    let mut found: Option<Comment> = None;
    for attribute in attributes {
        let Some(text) = text(attribute, "doc") else {
            continue;
        };
        let Some(clauses) = text.trim().strip_prefix(MARK) else {
            continue;
        };
        let place = format!("{file}:{}", attribute.span().start().line);
        if found.is_some() {
            return Err(Error::input(format!(
                "{place}: task {task} has a second `deadline:` comment"
            )));
        }
        let wrong = |what| Error::input(format!("{place}: task {task}{what}"));
        let row = row(clauses).map_err(|what| wrong(format!(": {what}")))?;
        row.check().map_err(|what| wrong(format!(" {what}")))?;
        found = Some(Comment { place, row });
    }
    Ok(found)
}

/// The text of an attribute `#[KEY = "TEXT"]` with this key; a documentation comment is one with `doc`.
pub(crate) fn text(attribute: &syn::Attribute, key: &str) -> Option<String> {
    let syn::Meta::NameValue(pair) = &attribute.meta else {
        return None;
    };
    match &pair.value {
        syn::Expr::Lit(literal) if pair.path.is_ident(key) => match &literal.lit {
            syn::Lit::Str(text) => Some(text.value()),
            _ => None,
        },
        _ => None,
    }
}

fn row(clauses: &str) -> Result<Row, String> {
    let mut row = Row::default();
    let mut jitter = None;
    for clause in clauses.trim().trim_end_matches('.').split(',') {
        let words: Vec<&str> = clause.split_whitespace().collect();
        match words.as_slice() {
            ["every", number, unit] => row.every_us.push(time(number, unit)?),
            ["within", number, unit] if row.deadline_us.is_none() => {
                row.deadline_us = Some(time(number, unit)?);
            }
            ["jitter", number, unit] if jitter.is_none() => jitter = Some(time(number, unit)?),
            ["apart", number, unit] if row.apart_us.is_none() => {
                row.apart_us = Some(time(number, unit)?);
            }
            ["after", task] if row.after.is_none() => row.after = Some((*task).to_owned()),
            [
                "burst",
                jobs,
                "apart",
                apart,
                apart_unit,
                "every",
                every,
                every_unit,
            ] if row.burst.is_none() => {
                row.burst = Some(Burst {
                    jobs: jobs.parse().map_err(|_| not_understood(clause))?,
                    apart_us: time(apart, apart_unit)?,
                    every_us: time(every, every_unit)?,
                });
            }
            _ => return Err(not_understood(clause)),
        }
    }
    row.jitter_us = jitter.unwrap_or(0);
    Ok(row)
}

fn not_understood(clause: &str) -> String {
    format!(
        "`{}` is not understood: accepted are `every T`, `within T`, `jitter T`, `apart T`, `after TASK` and \
         `burst N apart T every T`, where T is a number and us, ms or s; each but `every T` \
         once",
        clause.trim()
    )
}

/// A time in microseconds.
fn time(number: &str, unit: &str) -> Result<u64, String> {
    let wrong = || {
        format!(
            "`{number} {unit}` is no time: accepted is a number and us, ms or s, of whole microseconds"
        )
    };
    let digits: usize = match unit {
        "us" => 0,
        "ms" => 3,
        "s" => 6,
        _ => return Err(wrong()),
    };
    let number = number.replace('_', "");
    let (whole, part) = number.split_once('.').unwrap_or((&number, ""));
    if part.len() > digits {
        return Err(wrong());
    }
    format!("{whole}{part:0<digits$}")
        .parse()
        .map_err(|_| wrong())
}

#[cfg(test)]
mod tests {
    use super::{of, row, time};

    #[test]
    fn times_have_units() {
        let us = |number, unit| time(number, unit).unwrap();
        assert_eq!(us("10", "ms"), 10_000);
        assert_eq!(us("2.5", "ms"), 2500);
        assert_eq!(us("1_000", "us"), 1000);
        assert_eq!(us("0.000001", "s"), 1);
        for (number, unit) in [("0.5", "us"), ("10", "min"), ("ten", "ms"), ("-1", "ms")] {
            assert!(time(number, unit).is_err(), "{number} {unit}");
        }
    }

    #[test]
    fn clauses_make_a_row() {
        let all =
            row(" every 10 ms, every 1 s, within 5 ms, jitter 100 us, after adc, apart 1 ms.")
                .unwrap();
        assert_eq!(all.every_us, [10_000, 1_000_000]);
        assert_eq!((all.deadline_us, all.jitter_us), (Some(5000), 100));
        assert_eq!(
            (all.after.as_deref(), all.apart_us),
            (Some("adc"), Some(1000))
        );
        let burst = row("burst 3 apart 100 us every 10 ms, within 1 ms")
            .unwrap()
            .burst
            .unwrap();
        assert_eq!(
            (burst.jobs, burst.apart_us, burst.every_us),
            (3, 100, 10_000)
        );
        for wrong in ["each 10 ms", "every 10", "within 1 ms, within 2 ms", ""] {
            assert!(
                row(wrong).unwrap_err().contains("is not understood"),
                "{wrong}"
            );
        }
    }

    #[test]
    fn a_comment_has_the_limits_of_the_table() {
        let said = |clauses: &str| {
            let function: syn::ItemFn = syn::parse_str(&format!(
                "/// Blinks.\n/// deadline: {clauses}\nfn blink() {{}}"
            ))
            .unwrap();
            of(&function.attrs, "src/main.rs", "blink").map_err(|error| {
                assert_eq!(error.exit_code(), 2);
                error.to_string()
            })
        };
        for (clauses, key, value) in [
            ("every 0 us", "every_us", "0: 1 to 3600000000"),
            (
                "every 18446744073710 us",
                "every_us",
                "18446744073710: 1 to 3600000000",
            ),
            (
                "every 18446744 s",
                "every_us",
                "18446744000000: 1 to 3600000000",
            ),
            (
                "burst 3 apart 0 us every 1 ms",
                "burst.apart_us",
                "0: 1 to 3600000000",
            ),
            (
                "burst 0 apart 87 us every 1 ms",
                "burst.jobs",
                "0: 1 to 10000",
            ),
            (
                "burst 30000 apart 87 us every 1 ms",
                "burst.jobs",
                "30000: 1 to 10000",
            ),
            (
                "burst 3 apart 8 us every 0 ms",
                "burst.every_us",
                "0: 1 to 3600000000",
            ),
            (
                "every 1 ms, jitter 18446744073709 us",
                "jitter_us",
                "18446744073709: 0 to 3600000000",
            ),
            ("every 1 ms, apart 0 us", "apart_us", "0: 1 to 3600000000"),
        ] {
            assert_eq!(
                said(&format!("{clauses}, within 300 us")).unwrap_err(),
                format!("src/main.rs:2: task blink has `{key}` = {value} is accepted")
            );
        }
        assert_eq!(
            said("every 1 ms, within 0 us").unwrap_err(),
            "src/main.rs:2: task blink has `deadline_us` = 0: 1 to 3600000000 is accepted"
        );
        assert!(said("every 3600 s, within 3600 s").unwrap().is_some());
        for twice in [
            "jitter 1 us, jitter 2 us",
            "apart 1 us, apart 2 us",
            "after a, after b",
        ] {
            let said = said(&format!("every 1 ms, within 1 ms, {twice}")).unwrap_err();
            assert!(said.contains("is not understood"), "{said}");
        }
    }
}

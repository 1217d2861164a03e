//! The tests of a board on the board, by `probe-rs run`: it writes the image once, resets the part
//! before each test and reports as the test programs of cargo do.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader},
    process::Stdio,
};

use super::{Error, Outcome, TestImage, Verdict};
use crate::{Failure, Workspace, probe};

/// Runs all tests on the board of a probe. What probe-rs prints goes to standard error as it comes.
///
/// # Errors
///
/// probe-rs cannot be run, or ends before any test has ended.
pub(super) fn run(
    workspace: &Workspace,
    image: &TestImage,
    probe: Option<&str>,
) -> Result<Vec<Verdict>, Failure> {
    let mut command = probe::command(workspace, "run", image.sled, probe, &["--verify"]);
    command.arg(&image.path);
    let mut child = command
        .stdout(Stdio::piped())
        .spawn()
        .map_err(Error::ProbeRs)?;
    let mut output = String::new();
    for line in BufReader::new(child.stdout.take().ok_or(Error::NoOutcome)?).lines() {
        let line = line.map_err(Error::ProbeRs)?;
        eprintln!("{line}");
        output.push_str(&line);
        output.push('\n');
    }
    let status = child.wait().map_err(Error::ProbeRs)?;
    let outcomes = outcomes(&output);
    if outcomes.is_empty() {
        return Err(Error::NoOutcome.into());
    }
    let tests = image.tests.iter();
    let mut verdicts: Vec<Verdict> = tests
        .map(|test| Verdict {
            test: test.clone(),
            outcome: outcomes
                .get(&(test.subject.clone(), test.name.clone()))
                .cloned()
                .unwrap_or_else(|| Outcome::Failed("it has not run".into())),
            seconds: None,
            log: Vec::new(),
        })
        .collect();
    // Whatever the lines say: probe-rs reports a failure by its exit code, too.
    let passed = |verdict: &Verdict| verdict.outcome == Outcome::Passed;
    if !status.success() && verdicts.iter().all(passed) {
        for verdict in &mut verdicts {
            verdict.outcome = Outcome::Failed(format!("probe-rs failed ({status})"));
        }
    }
    Ok(verdicts)
}

/// The outcomes in the report of a test program, by subject and name. Between the name of a test and
/// its outcome there may be lines of its log.
fn outcomes(report: &str) -> BTreeMap<(String, String), Outcome> {
    let mut outcomes = BTreeMap::new();
    let mut current: Option<&str> = None;
    for line in report.lines() {
        let mut rest = line.trim();
        if let Some((name, after)) = rest.strip_prefix("test ").and_then(split) {
            current = Some(name);
            rest = after;
        }
        let outcome = match rest {
            "ok" => Outcome::Passed,
            "FAILED" => Outcome::Failed("see the log above".into()),
            _ => continue,
        };
        if let Some((module, name)) = current.take().and_then(|name| name.rsplit_once("::")) {
            let subject = super::image::subject(module).to_owned();
            outcomes.insert((subject, name.to_owned()), outcome);
        }
    }
    outcomes
}

/// The name and what follows it in `name ... outcome`.
fn split(line: &str) -> Option<(&str, &str)> {
    let (name, after) = line.split_once(" ...")?;
    Some((name.trim_end(), after.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_are_read_between_the_lines_of_the_log() {
        let outcomes = outcomes(
            "\nrunning 3 tests\n\
             test clocks::tests::one   ... ok\n\
             test board_tests::clocks::tests::two ... [INFO] 10 of 20\n\
             [ERROR] no ... clock\n\
             FAILED\n\
             test stamps::tests::three ... \n\
             ok\n\
             \nfailures:\n\n---- two ----\nok\n\
             test result: FAILED. 2 passed; 1 failed\n",
        );
        let of = |subject: &str, name: &str| outcomes.get(&(subject.into(), name.into()));
        assert_eq!(of("clocks", "one"), Some(&Outcome::Passed));
        assert!(matches!(of("clocks", "two"), Some(Outcome::Failed(_))));
        assert_eq!(of("stamps", "three"), Some(&Outcome::Passed));
        assert_eq!(outcomes.len(), 3);
    }
}

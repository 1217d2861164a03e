//! `cargo xtask sim --experiment NAME --out DIR --resume`: an experiment that was interrupted goes on, and its files
//! are those of one that was not.

#![cfg(unix)]

use std::{
    fs,
    path::Path,
    process::{Child, Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use xtask::Workspace;

/// An experiment with its options.
struct Experiment {
    name: &'static str,
    vehicle: &'static str,
    files: &'static [&'static str],
}

impl Experiment {
    fn command(&self, seeds: &str, out: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
        command
            .args(["sim", "--experiment", self.name, "--vehicle", self.vehicle])
            .args(["--seeds", seeds, "--out"])
            .arg(out)
            .current_dir(Workspace::find().unwrap().root());
        command
    }

    fn done(&self, seeds: &str, out: &Path, more: &[&str]) -> Output {
        self.command(seeds, out).args(more).output().unwrap()
    }

    /// Starts it, and waits until so many runs are done.
    fn started(&self, seeds: &str, out: &Path, more: &[&str], runs: usize) -> Child {
        let mut run = self
            .command(seeds, out)
            .args(more)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let journal = out.join("experiment.journal");
        let begin = Instant::now();
        while fs::read_to_string(&journal).map_or(0, |text| text.lines().count()) < runs + 1 {
            assert!(begin.elapsed() < Duration::from_secs(600), "no run ends");
            assert_eq!(run.try_wait().unwrap(), None, "too short to be interrupted");
            thread::sleep(Duration::from_millis(5));
        }
        run
    }
}

fn refused(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    let last = said.lines().last().unwrap();
    assert!(last.starts_with("error: "), "{said}");
    last.to_owned()
}

/// Interrupts an experiment by each signal, and lets it go on after each.
fn goes_on(experiment: &Experiment, seeds: &str, signals: &[(&str, Option<i32>)]) {
    let folder = tempfile::tempdir().unwrap();
    let (whole, part) = (folder.path().join("whole"), folder.path().join("part"));
    let output = experiment.done(seeds, &whole, &[]);
    let code = output.status.code();
    assert!(matches!(code, Some(0 | 1)), "{output:?}");

    let mut runs = 1;
    for (signal, expected) in signals {
        let run = experiment.started(seeds, &part, &["--resume"], runs);
        let pid = run.id().to_string();
        let kill = Command::new("kill").args(["-s", signal, &pid]).status();
        assert!(kill.unwrap().success());
        let ended = run.wait_with_output().unwrap();
        assert_eq!(ended.status.code(), *expected, "{signal}");
        if expected.is_some() {
            let said = String::from_utf8_lossy(&ended.stderr);
            assert!(
                said.contains("kept in") && said.contains("--resume goes on"),
                "{said}"
            );
        }
        let journal = fs::read_to_string(part.join("experiment.journal")).unwrap();
        runs = journal.lines().count();
    }
    let said = refused(&experiment.done(seeds, &part, &[]));
    assert!(said.contains("--resume goes on with it"), "{said}");
    let others = [
        experiment.done(seeds, &part, &["--seed", "77", "--resume"]),
        experiment.done("999", &part, &["--resume"]),
    ];
    for output in others {
        let said = refused(&output);
        assert!(said.contains("another campaign or experiment"), "{said}");
    }

    let output = experiment.done(seeds, &part, &["--resume"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), code, "{said}");
    assert!(said.contains("runs were done before."), "{said}");
    for name in experiment.files {
        let read = |folder: &Path| fs::read(folder.join(name)).unwrap();
        assert!(read(&part) == read(&whole), "{name}");
    }
    // And the runs that the report is made of.
    let left = || fs::read_dir(&part).unwrap().count();
    assert_eq!(left(), experiment.files.len() + 1);

    // A complete one has its report and its verdict again, without a run; that of another one is refused.
    let again = experiment.done(seeds, &part, &["--resume"]);
    assert_eq!(again.status.code(), code, "{again:?}");
    assert_eq!(again.stdout, output.stdout);
    let said = refused(&experiment.done(seeds, &part, &["--seed", "77", "--resume"]));
    assert!(said.contains("another campaign or experiment"), "{said}");
    assert_eq!(left(), experiment.files.len() + 1);
    // One that was edited is refused by the number of its line, and nothing is left behind.
    let runs = part.join("experiment.runs");
    let text = fs::read_to_string(&runs).unwrap();
    let place = text.match_indices("\"run\":").nth(1).unwrap().0 + "\"run\":".len();
    let line = text[..place].lines().count();
    let digit = if &text[place..=place] == "1" {
        "2"
    } else {
        "1"
    };
    let edited = format!("{}{digit}{}", &text[..place], &text[place + 1..]);
    fs::write(&runs, edited).unwrap();
    let said = refused(&experiment.done(seeds, &part, &["--resume"]));
    let expected = format!("experiment.runs cannot be used: line {line} is not as it was written");
    assert!(said.contains(&expected), "{said}");
    assert_eq!(left(), experiment.files.len() + 1);
    fs::remove_file(part.join("experiment.runs")).unwrap();
    let said = refused(&experiment.done(seeds, &part, &["--resume"]));
    assert!(said.contains("whose runs were not kept"), "{said}");
}

const SIGNALS: [(&str, Option<i32>); 3] = [("INT", Some(130)), ("TERM", Some(143)), ("KILL", None)];

#[test]
fn an_experiment_without_images_goes_on() {
    let limits = Experiment {
        name: "row-limits",
        vehicle: "row-follower",
        files: &["experiment.json", "runs.csv", "row-limits.svg"],
    };
    goes_on(&limits, "1", &SIGNALS);
}

#[test]
#[ignore = "slow: two times the analysis of both buses, which takes minutes"]
fn an_experiment_on_both_buses_goes_on() {
    let buses = Experiment {
        name: "event-or-time",
        vehicle: "row-follower",
        files: &["experiment.json", "latency.svg"],
    };
    goes_on(&buses, "1", &SIGNALS[..1]);
}

#[test]
#[ignore = "slow: two times all cases of an experiment that takes minutes"]
fn the_experiments_of_the_thesis_go_on() {
    for (name, vehicle) in [("thesis-7", "uagv"), ("thesis-2", "row-follower")] {
        let thesis = Experiment {
            name,
            vehicle,
            files: &["experiment.json", "runs.csv"],
        };
        goes_on(&thesis, "1", &SIGNALS[1..]);
    }
}

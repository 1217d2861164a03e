//! What commands print where nobody reads it, or where it cannot be written.

#![cfg(unix)]

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Commands that print, some of them more than a pipe holds or with an error's exit code.
const COMMANDS: [&[&str]; 8] = [
    &["--help"],
    &["sim", "--help"],
    &["sim", "--list"],
    &["sim", "--list", "--json"],
    &["schedule"],
    &["schedule", "--json"],
    &["test", "--list"],
    &["analyse", "xtask/tests/data/straight-line.candump.log"],
];

fn root() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    root.expect("the workspace").to_owned()
}

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
    command.args(arguments).current_dir(root());
    command
}

/// As `| head` does.
#[test]
fn a_reader_who_stops_reading_is_no_failure() {
    for arguments in COMMANDS {
        let mut program = command(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(program.stdout.take());
        let done = program.wait_with_output().unwrap();
        assert!(done.status.success(), "{arguments:?}: {done:?}");
        assert_eq!(String::from_utf8(done.stderr).unwrap(), "", "{arguments:?}");
    }
}

#[test]
fn a_full_disk_is_one_sentence() {
    let Ok(full) = OpenOptions::new().write(true).open("/dev/full") else {
        // Only Linux has it.
        return;
    };
    for arguments in COMMANDS {
        let full = full.try_clone().unwrap();
        let done = command(arguments).stdout(full).output().unwrap();
        let said = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(
            said.starts_with("error: the report cannot be printed: ") && said.lines().count() == 1,
            "{arguments:?}: {said}"
        );
    }
}

/// The sentence about a wrong command line is lost, and its exit code is not.
#[test]
fn without_a_reader_of_errors_the_exit_code_stays() {
    let mut program = command(&["sim", "no-such-scenario"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(program.stderr.take());
    assert_eq!(program.wait().unwrap().code(), Some(2));
}

/// Ctrl-C and the end that a system asks for leave nothing behind.
#[test]
fn an_interrupted_run_leaves_no_folder() {
    for (name, code) in [("INT", 130), ("TERM", 143)] {
        let parent = tempfile::tempdir().unwrap();
        let out = parent.path().join("run");
        let mut run = command(&["sim", "--vehicle", "two-boards", "--seconds", "80000"])
            .arg("--out")
            .arg(&out)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let begin = Instant::now();
        while fs::read_dir(parent.path()).unwrap().count() == 0 {
            assert_eq!(run.try_wait().unwrap(), None, "it has ended");
            assert!(begin.elapsed() < Duration::from_secs(60), "no folder");
            thread::sleep(Duration::from_millis(10));
        }
        // A second run into the same folder is told so.
        let second = command(&["sim", "--vehicle", "two-boards", "--seconds", "1", "--out"])
            .arg(&out)
            .output()
            .unwrap();
        let said = String::from_utf8(second.stderr).unwrap();
        assert!(said.contains("another run writes to it"), "{said}");
        assert_eq!(second.status.code(), Some(2));

        let pid = run.id().to_string();
        let kill = Command::new("kill").args(["-s", name, &pid]).status();
        assert!(kill.unwrap().success());
        let done = run.wait().unwrap();
        assert_eq!(done.code(), Some(code), "{name}");
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0, "{name}");
    }
}

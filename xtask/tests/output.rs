//! What commands print where nobody reads it, or where it cannot be written.

#![cfg(unix)]

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

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

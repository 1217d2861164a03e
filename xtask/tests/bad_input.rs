//! Bad input of every command: one sentence that says what is wrong and what is accepted, exit code 2,
//! and nothing on the standard output.

#![cfg(target_os = "linux")]

use std::{
    env, fs,
    path::Path,
    process::{Command, Stdio},
    sync::atomic::{AtomicUsize, Ordering},
    thread,
};

use xtask::Workspace;

/// Command lines behind `$`, and below each what is said. `BAD_INPUT=renew` writes it anew.
const KEPT: &str = "xtask/tests/data/bad-input.txt";

/// What a command line is answered, with the folder of the workspace left out.
fn answer(root: &Path, line: &str) -> String {
    let done = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(line.split(' '))
        .current_dir(root)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let said = String::from_utf8(done.stderr).unwrap();
    assert_eq!(done.status.code(), Some(2), "{line}: {said}");
    assert_eq!(done.stdout, b"", "{line}: {said}");
    assert_eq!(said.lines().count(), 1, "{line}: {said}");
    assert!(said.starts_with("error: "), "{line}: {said}");
    for lost in ["panicked", "RUST_BACKTRACE", "unwrap"] {
        assert!(!said.contains(lost), "{line}: {said}");
    }
    said.replace(&format!("{}/", root.display()), "")
}

#[test]
fn bad_input_is_answered_in_a_sentence() {
    let root = Workspace::find().unwrap().root().to_owned();
    let kept = fs::read_to_string(root.join(KEPT)).unwrap();
    let lines: Vec<&str> = kept
        .lines()
        .filter_map(|line| line.strip_prefix("$ "))
        .collect();
    assert!(lines.len() >= 100, "{}", lines.len());
    let next = AtomicUsize::new(0);
    let worker = || {
        let mut answers = Vec::new();
        while let Some(line) = lines.get(next.fetch_add(1, Ordering::Relaxed)) {
            answers.push((*line, answer(&root, line)));
        }
        answers
    };
    let mut answers: Vec<(&str, String)> = thread::scope(|scope| {
        let workers = [scope.spawn(worker), scope.spawn(worker)];
        let answers = workers.into_iter().flat_map(|one| one.join().unwrap());
        answers.collect()
    });
    answers.sort_by_key(|(line, _)| lines.iter().position(|one| one == line));
    let text: String = answers
        .iter()
        .map(|(line, said)| format!("$ {line}\n{said}"))
        .collect();
    if env::var("BAD_INPUT").is_ok_and(|value| value == "renew") {
        fs::write(root.join(KEPT), text).unwrap();
    } else {
        assert_eq!(text, kept, "BAD_INPUT=renew writes the answers anew");
    }
}

//! The programs that hold the tests: builds them, then runs as many at once as there are cores.
//!
//! `cargo test` runs them one after another, so that all cores but one wait whenever a program
//! has only one long test left.

use std::{
    collections::VecDeque,
    fmt::Write as _,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    sync::{Mutex, PoisonError},
    thread,
    time::Instant,
};

use serde_json::Value;

use crate::workspace::typed;

/// A program with tests.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Binary {
    /// Its name behind that of its package: `control/tests/path.rs`.
    name: String,
    path: PathBuf,
    /// The folder of its package, where it runs.
    package: PathBuf,
}

/// Builds with `build` and runs all programs with `arguments`. Returns one sentence for each
/// that failed.
pub(super) fn run(mut build: Command, arguments: &[&str]) -> Vec<String> {
    let what = format!("`{}`", typed(&build));
    eprintln!("{what}");
    build.args(["--no-run", "--message-format=json-render-diagnostics"]);
    let built = match build.stderr(Stdio::inherit()).output() {
        Ok(built) if built.status.success() => built,
        Ok(built) => return vec![format!("{what} built no tests ({})", built.status)],
        Err(error) => return vec![format!("{what} cannot be run: {error}")],
    };
    let found = binaries(&String::from_utf8_lossy(&built.stdout));
    if found.is_empty() {
        return vec![format!("{what} built no tests")];
    }
    let cores = thread::available_parallelism().map_or(1, usize::from);
    each(found, cores, |binary| test(&build, binary, arguments))
}

/// The programs with tests among cargo's messages. Last comes first: what links most crates is
/// built last and runs longest.
fn binaries(messages: &str) -> VecDeque<Binary> {
    let messages = messages.lines().rev();
    messages
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["reason"] == "compiler-artifact")
        .filter(|message| message["profile"]["test"] == true)
        .filter_map(|message| {
            let path = PathBuf::from(message["executable"].as_str()?);
            let package = Path::new(message["manifest_path"].as_str()?).parent()?;
            let source = Path::new(message["target"]["src_path"].as_str()?);
            let folder = package.file_name()?.to_string_lossy();
            let source = source.strip_prefix(package).unwrap_or(source);
            Some(Binary {
                name: format!("{folder}/{}", source.display()),
                path,
                package: package.into(),
            })
        })
        .collect()
}

/// Calls `test` for all of them, so many at once, and collects what failed.
fn each(
    binaries: VecDeque<Binary>,
    at_once: usize,
    test: impl Fn(&Binary) -> Option<String> + Sync,
) -> Vec<String> {
    let queue = Mutex::new(binaries);
    let failures = Mutex::new(Vec::new());
    let work = || {
        loop {
            let next = queue
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .pop_front();
            let Some(binary) = next else { return };
            if let Some(failure) = test(&binary) {
                let mut failures = failures.lock().unwrap_or_else(PoisonError::into_inner);
                failures.push(failure);
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(work);
        }
    });
    failures
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner)
}

/// Runs one program as cargo would: in its package's folder, which it also names.
fn test(build: &Command, binary: &Binary, arguments: &[&str]) -> Option<String> {
    let start = Instant::now();
    let mut command = Command::new(&binary.path);
    command
        .args(arguments)
        .current_dir(&binary.package)
        .env("CARGO_MANIFEST_DIR", &binary.package);
    for (name, value) in build.get_envs() {
        if let Some(value) = value {
            command.env(name, value);
        }
    }
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => return Some(format!("{} cannot be run: {error}", binary.name)),
    };
    eprint!(
        "{}",
        shown(&binary.name, &output, start.elapsed().as_secs_f64())
    );
    (!output.status.success()).then(|| format!("{} failed ({})", binary.name, output.status))
}

/// What the screen shows of a program that has ended: all that it printed if it failed, else
/// how many tests passed.
fn shown(name: &str, output: &Output, seconds: f64) -> String {
    let printed = String::from_utf8_lossy(&output.stdout);
    let mut text = String::new();
    if !output.status.success() {
        text += &printed;
        text += &String::from_utf8_lossy(&output.stderr);
    }
    let result = printed
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix("test result: "))
        .map_or("no result", |result| {
            result.split("; 0 measured").next().unwrap_or(result)
        });
    // Writing to a string does not fail.
    let _ = writeln!(text, "{name:<48}{seconds:>7.1} s  {result}");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Output {
        Command::new("sh").args(["-c", script]).output().unwrap()
    }

    #[test]
    fn programs_with_tests_are_found_last_first() {
        let messages = r#"
{"reason":"compiler-artifact","manifest_path":"/w/control/Cargo.toml","target":{"src_path":"/w/control/src/lib.rs"},"profile":{"test":false},"executable":null}
{"reason":"compiler-artifact","manifest_path":"/w/control/Cargo.toml","target":{"src_path":"/w/control/tests/path.rs"},"profile":{"test":true},"executable":"/t/path-1"}
{"reason":"compiler-artifact","manifest_path":"/w/can/Cargo.toml","target":{"src_path":"/w/can/examples/log.rs"},"profile":{"test":false},"executable":"/t/log"}
{"reason":"compiler-artifact","manifest_path":"/w/xtask/Cargo.toml","target":{"src_path":"/w/xtask/src/lib.rs"},"profile":{"test":true},"executable":"/t/xtask-2"}
{"reason":"build-finished","success":true}
"#;
        let found = binaries(messages);
        let names: Vec<&str> = found.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(names, ["xtask/src/lib.rs", "control/tests/path.rs"]);
        assert_eq!(found[1].path, Path::new("/t/path-1"));
        assert_eq!(found[1].package, Path::new("/w/control"));
    }

    #[test]
    fn all_run_and_every_failure_is_kept() {
        let binary = |name: &str| Binary {
            name: name.into(),
            path: PathBuf::new(),
            package: PathBuf::new(),
        };
        let all = ["one", "two", "three", "four"].map(binary);
        let ran = Mutex::new(0);
        let failures = each(all.into(), 2, |binary| {
            *ran.lock().unwrap() += 1;
            binary.name.starts_with('t').then(|| binary.name.clone())
        });
        assert_eq!(*ran.lock().unwrap(), 4);
        assert_eq!(failures.len(), 2, "{failures:?}");
    }

    #[test]
    fn a_failure_shows_what_was_printed_and_success_one_line() {
        let result = "test result: ok. 3 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out";
        let good = shown("it", &shell(&format!("echo noise; echo '{result}'")), 1.25);
        assert!(good.starts_with("it "), "{good}");
        assert!(
            good.ends_with("1.2 s  ok. 3 passed; 0 failed; 0 ignored\n"),
            "{good}"
        );
        let bad = shown("it", &shell("echo why; echo and how >&2; exit 1"), 0.0);
        assert!(bad.starts_with("why\nand how\nit "), "{bad}");
        assert!(bad.ends_with("no result\n"), "{bad}");
    }

    #[test]
    fn a_program_that_cannot_be_run_is_a_failure() {
        let binary = Binary {
            name: "it".into(),
            path: "no-such-program".into(),
            package: ".".into(),
        };
        let failure = test(&Command::new("cargo"), &binary, &[]).unwrap();
        assert!(failure.starts_with("it cannot be run: "), "{failure}");
    }
}

//! `cargo xtask sim --faults` in parts, interrupted and put together; `cargo xtask campaign`.

use std::{
    fs,
    path::Path,
    process::{Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal};
use xtask::Workspace;

/// Six sequences of the vehicle that is simulated in the least time.
const SEQUENCES: [&str; 7] = [
    "sim",
    "--vehicle",
    "two-boards",
    "--faults",
    "6",
    "--seed",
    "40",
];

fn xtask(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
    command
        .args(arguments)
        .current_dir(Workspace::find().unwrap().root());
    command
}

fn done(command: &mut Command) -> Output {
    command.output().unwrap()
}

fn sentence(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    // Lines of cargo about the images may stand before it.
    let last = said.lines().last().unwrap();
    assert!(last.starts_with("error: "), "{said}");
    last.to_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn parts_and_an_interrupted_run_make_the_same_report() {
    let folder = tempfile::tempdir().unwrap();
    let (parts, whole) = (folder.path().join("parts"), folder.path().join("whole"));
    for shard in ["1/2", "2/2"] {
        let out = ["--shard", shard, "--out", text(&parts)];
        let output = done(xtask(&SEQUENCES).args(out));
        assert!(output.status.success(), "{output:?}");
    }
    let (one, two) = (
        parts.join("faults-1-of-2.json"),
        parts.join("faults-2-of-2.json"),
    );
    let merged = folder.path().join("merged.json");
    let merge = [
        "campaign",
        "merge",
        text(&two),
        text(&one),
        "--out",
        text(&merged),
    ];
    let output = done(&mut xtask(&merge));
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("6 fault sequences"), "{said}");

    assert_eq!(interrupted(&whole), fs::read_to_string(&merged).unwrap());

    let said = sentence(&done(&mut xtask(&["campaign", "merge", text(&one)])));
    assert!(said.contains("parts are missing: 2/2"), "{said}");
    // What goes on for ever is no part, and what a file says does nothing to a terminal.
    let said = sentence(&done(&mut xtask(&["campaign", "merge", "/dev/zero"])));
    assert!(said.contains("is larger than"), "{said}");
    let escape = folder.path().join("escape.json");
    fs::write(&escape, "{\"\u{1b}[31m\": 1}").unwrap();
    let said = sentence(&done(&mut xtask(&["campaign", "merge", text(&escape)])));
    assert!(!said.contains('\u{1b}'), "{said}");
    let manifest = ["campaign", "merge", "Cargo.toml"];
    let said = sentence(&done(&mut xtask(&manifest)));
    assert!(
        said.starts_with("error: Cargo.toml is no part of a campaign"),
        "{said}"
    );
}

/// A bus guardian sends nothing, so it is no node that a campaign finds silent.
#[test]
fn a_guardian_that_follows_the_time_breaks_no_rule() {
    let faults = ["sim", "--vehicle", "sentry", "--faults", "1"];
    let output = done(&mut xtask(&faults));
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("0 broke a rule"), "{said}");
}

/// The report of a run that is killed and goes on.
fn interrupted(whole: &Path) -> String {
    let out = ["--out", text(whole)];
    let mut run = xtask(&SEQUENCES);
    let mut run = run
        .args(out)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let journal = whole.join("faults.journal");
    let begin = Instant::now();
    while fs::read_to_string(&journal).map_or(0, |text| text.lines().count()) < 2 {
        assert!(
            begin.elapsed() < Duration::from_secs(300),
            "no sequence ends"
        );
        assert_eq!(run.try_wait().unwrap(), None, "too short to be interrupted");
        thread::sleep(Duration::from_millis(20));
    }
    // It stands still, or its last sequence could end before the next commands have begun.
    let process = Pid::from_child(&run);
    rustix::process::kill_process(process, Signal::STOP).unwrap();
    assert_eq!(run.try_wait().unwrap(), None, "too short to be interrupted");
    let said = sentence(&done(xtask(&SEQUENCES).args(out)));
    assert!(said.contains("--resume goes on with it"), "{said}");
    let said = sentence(&done(xtask(&SEQUENCES).args(out).arg("--resume")));
    assert!(said.contains("another run writes it"), "{said}");
    run.kill().unwrap();
    run.wait().unwrap();
    let said = done(
        xtask(&[
            "sim",
            "--vehicle",
            "two-boards",
            "--faults",
            "7",
            "--resume",
        ])
        .args(out),
    );
    assert!(sentence(&said).contains("another campaign"));

    let output = done(xtask(&SEQUENCES).args(out).arg("--resume"));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && said.contains("were done before"),
        "{said}"
    );
    let report = fs::read_to_string(whole.join("faults.json")).unwrap();
    assert!(!journal.exists());
    let output = done(xtask(&SEQUENCES).args(out).arg("--resume"));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("is complete"),
        "{output:?}"
    );
    // An old report is not that of another campaign.
    let other = [
        "sim",
        "--vehicle",
        "two-boards",
        "--faults",
        "6",
        "--seed",
        "41",
        "--resume",
    ];
    let said = sentence(&done(xtask(&other).args(out)));
    assert!(said.contains("is the report of another campaign"), "{said}");
    report
}

/// The script for GNU parallel, if that is installed.
#[test]
fn gnu_parallel_runs_the_parts_and_collects_them() {
    if Command::new("parallel").arg("--version").output().is_err() {
        eprintln!("skipped: no GNU parallel runs the parts");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (script, dir) = (
        folder.path().join("campaign.sh"),
        folder.path().join("parts"),
    );
    let batch = [
        "campaign",
        "batch",
        "--engine",
        "parallel",
        "--faults",
        "3",
        "--shards",
        "3",
        "--vehicle",
        "two-boards",
        "--dir",
        text(&dir),
        "--out",
        text(&script),
    ];
    let output = done(&mut xtask(&batch));
    assert!(output.status.success(), "{output:?}");
    let root = Workspace::find().unwrap().root().to_owned();
    let output = done(Command::new("sh").arg(&script).current_dir(root));
    let said = String::from_utf8_lossy(&output.stdout);
    let trouble = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said} {trouble}");
    assert!(said.contains("3 fault sequences"), "{said}");
    assert!(dir.join("faults.json").exists());
}

/// A full disk ends a campaign at its next sequence, in a sentence, and what was done is kept.
#[cfg(target_os = "linux")]
#[test]
fn a_campaign_ends_when_nothing_can_be_kept() {
    if Command::new("prlimit").arg("--version").output().is_err() {
        eprintln!("skipped: no prlimit makes files too large");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let journal = out.join("faults.journal");
    // Ignored, the signal for a file that is too large leaves the error of the system.
    let mut run = Command::new("sh")
        .args(["-c", "trap '' XFSZ; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_xtask"))
        .args([
            "sim",
            "--vehicle",
            "two-boards",
            "--faults",
            "100000",
            "--out",
        ])
        .arg(&out)
        .current_dir(Workspace::find().unwrap().root())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    let kept = || fs::read_to_string(&journal).unwrap_or_default();
    while kept().lines().count() < 2 {
        assert_eq!(run.try_wait().unwrap(), None);
        assert!(
            begin.elapsed() < Duration::from_secs(300),
            "no sequence ends"
        );
        thread::sleep(Duration::from_millis(20));
    }
    let pid = format!("--pid={}", run.id());
    let limit = format!("--fsize={}", kept().len() + 10);
    let limited = Command::new("prlimit").args([pid, limit]).status();
    assert!(limited.unwrap().success());
    while run.try_wait().unwrap().is_none() {
        assert!(begin.elapsed() < Duration::from_secs(600), "it goes on");
        thread::sleep(Duration::from_millis(50));
    }
    let output = run.wait_with_output().unwrap();
    let said = sentence(&output);
    assert!(said.contains("faults.journal cannot be used"), "{said}");
    let report = String::from_utf8_lossy(&output.stdout);
    assert!(
        report.contains("sequences"),
        "what was done is told: {report}"
    );
    assert!(kept().lines().count() >= 2);
}

//! `cargo xtask monitor`: what it says of nodes that behave, that fall silent and that do not behave.

use std::{
    fs,
    path::PathBuf,
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use can_bus::{Frame, candump::Line};
use xtask::{
    Workspace,
    analyse::analyse,
    monitor::{Class, Picture, Watch},
    vehicle,
};

/// The first 10 s of `cargo xtask sim`.
const DRIVE: &str = "xtask/tests/data/straight-line.candump.log";

fn root() -> PathBuf {
    Workspace::find().unwrap().root().to_owned()
}

fn watch() -> Watch {
    Watch::new(&vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap())
}

/// The frames of the drive with their times.
fn drive() -> Vec<(Duration, Frame)> {
    let log = fs::read_to_string(root().join(DRIVE)).unwrap();
    let lines = log.lines().map(|line| line.parse::<Line>().unwrap());
    lines
        .map(|line| (Duration::from_nanos(line.at.as_ticks() / 1000), line.frame))
        .collect()
}

fn class(picture: &Picture, name: &str) -> Class {
    let node = picture.nodes.iter().find(|node| node.node == name);
    node.unwrap().class
}

#[test]
fn nodes_that_keep_to_their_windows_are_present() {
    let mut watch = watch();
    assert_eq!(class(&watch.picture(Duration::ZERO), "gps"), Class::Unheard);
    for (at, frame) in drive() {
        watch.take(at, &frame);
    }
    let picture = watch.picture(Duration::from_secs(10));
    for node in ["gps", "controller", "steering", "drive"] {
        assert_eq!(class(&picture, node), Class::Present, "{node}");
    }
    assert_eq!(picture.mode.as_deref(), Some("AutonomousRun"));
    assert!(picture.foreign.is_empty());
    let command = picture.messages.iter().find(|one| one.id == 300).unwrap();
    assert_eq!((command.per_second, command.outside), (10.0, 0));
    let behind = command.behind_window_us.unwrap();
    assert!((-50.0..50.0).contains(&behind), "{behind}");
    // The last second is busy as the whole log is.
    let uagv = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
    let whole = analyse(&uagv, &[root().join(DRIVE)], None).unwrap();
    let difference = picture.load_percent - whole.log.load_percent;
    assert!(difference.abs() < 0.3, "{difference}");
    let text = picture.text();
    assert!(text.contains("drive       present"), "{text}");
}

/// The motors of the row follower send no message of their own, except reports of a self-test.
#[test]
fn a_node_that_seldom_sends_is_quiet_and_not_dead() {
    let workspace = Workspace::find().unwrap();
    let vehicle = vehicle::find(&workspace, "row-follower").unwrap();
    let mut watch = Watch::new(&vehicle);
    let messages = &vehicle.network().messages;
    for node in ["motors", "feedback"] {
        let mut own = messages.iter().filter(|message| message.sender == node);
        let frame = Frame::standard(own.next().unwrap().id, &[0; 8]).unwrap();
        watch.take(Duration::from_millis(10), &frame);
    }
    let soon = watch.picture(Duration::from_millis(11));
    let later = watch.picture(Duration::from_secs(5));
    for (node, class_later) in [("motors", Class::Quiet), ("feedback", Class::Dead)] {
        assert_eq!(class(&soon, node), Class::Present, "{node}");
        assert_eq!(class(&later, node), class_later, "{node}");
    }
}

#[test]
fn nodes_that_do_not_behave_are_named() {
    let mut watch = watch();
    let from = Duration::from_secs(9);
    let is_of_drive = |frame: &Frame| {
        let line = format!("{:?}", frame.id());
        line.contains("(208)") || line.contains("(514)")
    };
    for (at, frame) in drive() {
        let late = at > from;
        let moved = format!("{:?}", frame.id()).contains("(206)");
        match (late, is_of_drive(&frame), moved) {
            // The drive node falls silent; the steering node sends 20 ms late.
            (true, true, _) => {}
            (true, _, true) => watch.take(at + Duration::from_millis(20), &frame),
            _ => watch.take(at, &frame),
        }
    }
    let foreign = Frame::standard(0x7A0, &[]).unwrap();
    watch.take(Duration::from_secs(10), &foreign);
    let picture = watch.picture(Duration::from_secs(10));
    assert_eq!(class(&picture, "drive"), Class::Dead);
    assert_eq!(class(&picture, "steering"), Class::Lost);
    assert_eq!(class(&picture, "gps"), Class::Present);
    assert_eq!(picture.foreign["0x7A0"], 1);
    assert!(picture.line().contains("drive dead"), "{}", picture.line());

    let command = Frame::standard(300, &[0; 8]).unwrap();
    for millis in 0..200 {
        watch.take(Duration::from_millis(10_000 + 4 * millis), &command);
    }
    let picture = watch.picture(Duration::from_millis(10_800));
    assert_eq!(class(&picture, "controller"), Class::Babbling);
}

/// Ctrl-C ends the watch, and what was seen is printed.
#[cfg(unix)]
#[test]
fn a_watch_that_is_ended_prints_what_it_saw() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("bus.log");
    let run = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args([
            "monitor",
            "twin",
            "--vehicle",
            "two-boards",
            "--json",
            "--record",
        ])
        .arg(&record)
        .current_dir(root())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while fs::read_to_string(&record).map_or(0, |text| text.lines().count()) < 10 {
        thread::sleep(Duration::from_millis(20));
    }
    let pid = run.id().to_string();
    let kill = Command::new("kill").args(["-s", "INT", &pid]).status();
    assert!(kill.unwrap().success());
    let done = run.wait_with_output().unwrap();
    assert!(done.status.success(), "{done:?}");
    let picture: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert!(picture["frames"].as_u64().unwrap() >= 10);
}

#[test]
fn the_virtual_bus_is_watched_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("bus.log");
    let mut command = Command::new(env!("CARGO_BIN_EXE_xtask"));
    command
        .args([
            "monitor",
            "twin",
            "--vehicle",
            "two-boards",
            "--seconds",
            "2",
            "--json",
            "--record",
        ])
        .arg(&record)
        .current_dir(root());
    let done = command.output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{done:?}");
    let picture: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(picture["nodes"][0]["class"], "present", "{said}");
    assert_eq!(picture["nodes"][1]["class"], "present", "{said}");
    let lines = fs::read_to_string(&record).unwrap();
    assert_eq!(
        lines.lines().count() as u64,
        picture["frames"].as_u64().unwrap()
    );
    assert!(lines.lines().all(|line| line.parse::<Line>().is_ok()));
    // A record is never replaced.
    let done = command.output().unwrap();
    assert_eq!(done.status.code(), Some(2));
    assert_eq!(fs::read_to_string(&record).unwrap(), lines);
}

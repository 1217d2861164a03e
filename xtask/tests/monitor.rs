//! `cargo xtask monitor`: what it says of nodes that behave, that fall silent and that do not behave.

use std::{
    fs,
    io::{Read, Write},
    path::PathBuf,
    process::{Command, Output, Stdio},
    thread,
    time::Duration,
};

use can_bus::{Frame, candump::Line};
use embedded_can::StandardId;
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
fn nobody_waits_to_hear_a_guardian() {
    let vehicle = vehicle::find(&Workspace::find().unwrap(), "sentry").unwrap();
    let picture = Watch::new(&vehicle).picture(Duration::ZERO);
    let nodes: Vec<&str> = picture.nodes.iter().map(|one| one.node.as_str()).collect();
    assert_eq!(nodes, ["gps", "controller", "steering", "drive"]);
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

/// Any node may ask for a message: that it was asked for says nothing of its sender.
#[test]
fn remote_frames_are_none_of_the_sender() {
    let mut watch = watch();
    let remote = StandardId::new(206).and_then(|id| Frame::new_remote(id, 2));
    for millis in 0..20 {
        watch.take(Duration::from_millis(50 * millis), &remote.unwrap());
    }
    let picture = watch.picture(Duration::from_secs(1));
    assert_eq!(class(&picture, "steering"), Class::Unheard);
    assert!(picture.messages.is_empty() && picture.foreign.is_empty());
    assert_eq!((picture.remote["0x0CE"], picture.frames), (20, 20));
    assert!(picture.load_percent > 0.3);
    assert!(
        picture.text().contains("remote frames"),
        "{}",
        picture.text()
    );
}

/// What waited in a queue until the bus was opened is stamped when it is read.
#[test]
fn windows_are_judged_from_two_references_in_order_on() {
    let mut watch = watch();
    let opened = Duration::from_millis(1_530);
    for (at, frame) in drive() {
        watch.take(at.max(opened), &frame);
    }
    let picture = watch.picture(Duration::from_secs(10));
    let outside: u64 = picture.messages.iter().map(|one| one.outside).sum();
    assert_eq!(outside, 0, "{}", picture.text());
}

/// An adapter on a pseudo-terminal: answers what the command asks, then plays what it is given, and goes away.
#[cfg(unix)]
fn adapter(play: impl FnOnce(&mut fs::File) + Send + 'static, extra: &[&str]) -> Output {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let end = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&end).unwrap();
    unlockpt(&end).unwrap();
    let path = ptsname(&end, Vec::new()).unwrap().into_string().unwrap();
    // Without echo, as a serial line.
    let port = serial2::SerialPort::open(&path, 115_200).unwrap();
    let mut end = fs::File::from(end);
    let playing = thread::spawn(move || {
        let (mut said, mut byte) = (String::new(), [0]);
        while !said.ends_with("O\r") {
            end.read_exact(&mut byte).unwrap();
            said.push(char::from(byte[0]));
            if byte[0] == b'\r' {
                end.write_all(b"\r").unwrap();
            }
        }
        drop(port);
        // The command is behind the answer before the first frame comes.
        thread::sleep(Duration::from_millis(100));
        play(&mut end);
    });
    let done = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args([
            "monitor",
            &format!("slcan:{path}"),
            "--vehicle",
            "two-boards",
        ])
        .args(extra)
        .current_dir(root())
        .output()
        .unwrap();
    playing.join().unwrap();
    done
}

/// The adapter says `t` with the stamp of that many milliseconds.
#[cfg(unix)]
fn stamped(id: u16, data: &str, millis: u64) -> String {
    format!("t{id:03X}{}{data}{:04X}\r", data.len() / 2, millis % 60_000)
}

/// A simulated bus that is slower than time is judged by its own.
#[cfg(unix)]
#[test]
fn a_bus_that_is_slower_than_time_is_alive() {
    let done = adapter(
        |end| {
            // At a tenth of time: three basic cycles last over three seconds.
            for cycle in 0..30 {
                let at = 59_000 + 20 * cycle;
                let lines = stamped(100, &format!("00000000{:02X}000000", cycle % 64), at)
                    + &stamped(300, "0000000000000000", at + 7);
                end.write_all(lines.as_bytes()).unwrap();
                thread::sleep(Duration::from_millis(200));
            }
        },
        &["--json", "--seconds", "5"],
    );
    assert!(done.status.success(), "{done:?}");
    let picture: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(picture["nodes"][0]["class"], "present", "{picture}");
    let pace = picture["pace"].as_f64().unwrap();
    assert!((0.08..0.12).contains(&pace), "{picture}");
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(said.contains("the bus runs at 0.1 of time"), "{said}");
}

#[cfg(unix)]
#[test]
fn an_adapter_that_goes_away_leaves_the_last_picture_and_whole_lines() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("bus.log");
    let done = adapter(
        |end| {
            let lines = stamped(100, "0000000000000000", 5) + "t0ZZ\r" + &"x".repeat(50) + "\r";
            let all = lines + &stamped(300, "0000000000000000", 12) + "t12C8000";
            end.write_all(all.as_bytes()).unwrap();
            thread::sleep(Duration::from_millis(300));
        },
        &["--json", "--record", record.to_str().unwrap()],
    );
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(said.contains(" has ended: "), "{said}");
    let picture: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(picture["frames"], 2);
    assert_eq!(picture["unreadable_lines"], 2);
    let lines = fs::read_to_string(&record).unwrap();
    assert!(
        lines.ends_with('\n') && lines.lines().count() == 2,
        "{lines}"
    );
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

/// The drive node falls silent in the log from 2 s to 4 s.
#[test]
fn a_log_tells_when_a_node_fell_silent() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("drive.log");
    let uagv = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
    let messages = uagv.network().messages.iter();
    let own: Vec<u16> = messages
        .filter(|message| message.sender == "drive")
        .map(|message| message.id)
        .collect();
    let begin = drive()[0].0;
    let lines = fs::read_to_string(root().join(DRIVE)).unwrap();
    let kept = lines.lines().zip(drive()).filter(|(_, (at, frame))| {
        let silent = (2.0..4.0).contains(&(*at - begin).as_secs_f64());
        let is_own = own
            .iter()
            .any(|id| frame.id() == StandardId::new(*id).unwrap().into());
        !(silent && is_own)
    });
    let kept: Vec<&str> = kept.map(|(line, _)| line).collect();
    fs::write(&log, kept.join("\n")).unwrap();
    let watched = |more: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_xtask"))
            .current_dir(root())
            .args(["monitor", log.to_str().unwrap(), "--json"])
            .args(more)
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    let whole = watched(&[]);
    let changes = whole["changes"].as_array().unwrap();
    let class = |change: &serde_json::Value| change["class"].as_str().unwrap().to_owned();
    let (of_drive, others): (Vec<_>, Vec<_>) =
        changes.iter().partition(|change| change["node"] == "drive");
    let told: Vec<String> = of_drive.iter().map(|change| class(change)).collect();
    assert_eq!(told, ["present", "dead", "present"]);
    let at = |change: usize| of_drive[change]["at"].as_f64().unwrap();
    // Dead three basic cycles behind its last frame.
    assert!((2.2..2.5).contains(&at(1)), "{changes:?}");
    assert!((3.9..4.3).contains(&at(2)), "{changes:?}");
    assert_eq!(others.len(), 3);
    assert!(others.iter().all(|change| class(change) == "present"));
    let drive = |picture: &serde_json::Value| {
        let nodes = picture["nodes"].as_array().unwrap();
        class(nodes.iter().find(|node| node["node"] == "drive").unwrap())
    };
    assert_eq!(drive(&whole), "present");
    let part = watched(&["--seconds", "3"]);
    assert_eq!(drive(&part), "dead");
    assert_eq!(part["watched_seconds"].as_f64(), Some(3.0));
}

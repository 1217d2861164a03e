//! `cargo xtask sim --can`: other programs on the virtual bus.

#![cfg(unix)]

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use can_bus::Frame;
use embedded_can::{Id, StandardId};
use xtask::{
    Workspace,
    selftest::{Port, Slcan, Transport},
};

/// A run at the pace of time, with its bus behind a link.
fn run(folder: &Path, seconds: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["sim", "--vehicle", "two-boards", "--seconds", seconds])
        .arg("--can")
        .arg(format!("slcan:{}", folder.join("bus").display()))
        .arg("--out")
        .arg(folder.join("run"))
        .current_dir(Workspace::find().unwrap().root())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until the bus is there. Before, the run may have to build the images.
fn wait_for(link: &Path, run: &mut Child) {
    let begin = Instant::now();
    // Of a killed run the old link is there at first, but leads nowhere.
    while !link.exists() {
        assert_eq!(run.try_wait().unwrap(), None, "the run has ended");
        assert!(begin.elapsed() < Duration::from_secs(900), "no link");
        thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn another_program_hears_the_bus_and_sends() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("bus");
    let mut run = run(folder.path(), "10");
    wait_for(&link, &mut run);
    let port = serial2::SerialPort::open(&link, 115_200).unwrap();
    let mut adapter = Slcan::open(Port::new(port), "bus", 250_000).unwrap();
    let mut heard: BTreeMap<u16, usize> = BTreeMap::new();
    let end = adapter.now() + Duration::from_secs(100);
    while heard.get(&300).is_none_or(|count| *count < 50) {
        let received = adapter.receive(end).unwrap().expect("the bus is silent");
        if let Id::Standard(id) = received.frame.id() {
            *heard.entry(id.as_raw()).or_default() += 1;
        }
    }
    assert!(heard[&100] > 40 && heard[&200] > 40, "{heard:?}");
    let own = Frame::standard(0x7A0, &[1, 2, 3]).unwrap();
    adapter.send(&own).unwrap();
    // Asks for the command: no data, and no signals that nobody sent.
    let remote = StandardId::new(300).and_then(|id| Frame::from_parts(id.into(), true, 8, &[]));
    adapter.send(&remote.unwrap()).unwrap();
    let second = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["sim", "--vehicle", "two-boards", "--can"])
        .arg(format!("slcan:{}", link.display()))
        .current_dir(Workspace::find().unwrap().root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&second.stderr);
    assert_eq!(second.status.code(), Some(2), "{said}");
    assert!(said.contains("name a link that is not there yet"), "{said}");

    let done = run.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(said.contains("The virtual bus is at "), "{said}");
    let log = fs::read_to_string(folder.path().join("run/bus.log")).unwrap();
    assert!(log.contains(" can0 7A0#010203"), "{said}");
    assert!(log.contains(" can0 12C#R8"), "{said}");
    let mcap = fs::read(folder.path().join("run/run.mcap")).unwrap();
    let (mut commands, mut frames) = (0, 0);
    for message in mcap::MessageStream::new(&mcap).unwrap() {
        let message = message.unwrap();
        commands += usize::from(message.channel.topic == "/signals/Command");
        let text = String::from_utf8_lossy(&message.data).into_owned();
        let is_data = text.contains("\"id\":300") && text.contains("\"remote\":false");
        frames += usize::from(message.channel.topic == "/bus/frames" && is_data);
    }
    assert_eq!(commands, frames);
    assert_eq!(frames, log.matches(" can0 12C#").count() - 1);
    assert!(!link.is_symlink(), "the link is removed");
}

/// Ctrl-C takes the link away, and the next run gets it even if the last one was killed.
#[test]
fn a_link_is_left_by_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("bus");
    for (signal, left) in [("INT", false), ("KILL", true), ("TERM", false)] {
        let mut run = run(folder.path(), "60");
        wait_for(&link, &mut run);
        let pid = run.id().to_string();
        let kill = Command::new("kill").args(["-s", signal, &pid]).status();
        assert!(kill.unwrap().success());
        run.wait().unwrap();
        assert_eq!(link.is_symlink(), left, "{signal}");
    }
}

/// What somebody has put in the place of the link is not the run's.
#[test]
fn a_file_in_place_of_the_link_stays() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("bus");
    for signal in ["INT", ""] {
        let _ = fs::remove_file(&link);
        let mut run = run(folder.path(), if signal.is_empty() { "1" } else { "60" });
        wait_for(&link, &mut run);
        fs::remove_file(&link).unwrap();
        fs::write(&link, "mine").unwrap();
        if !signal.is_empty() {
            let pid = run.id().to_string();
            let kill = Command::new("kill").args(["-s", signal, &pid]).status();
            assert!(kill.unwrap().success());
        }
        run.wait().unwrap();
        assert_eq!(fs::read_to_string(&link).unwrap(), "mine", "{signal}");
    }
}

/// `python-can` of PyPI, if it is installed with `pyserial`.
#[test]
fn python_can_hears_the_bus() {
    let folder = tempfile::tempdir().unwrap();
    let known = Command::new("python3")
        .args(["-c", "import can, serial"])
        .output();
    if !known.is_ok_and(|done| done.status.success()) {
        eprintln!("skipped: PyPI's python-can and pyserial are not installed");
        return;
    }
    let link = folder.path().join("bus");
    let mut run = run(folder.path(), "12");
    wait_for(&link, &mut run);
    let script = "\
import can, sys
bus = can.Bus(interface='slcan', channel=sys.argv[1], bitrate=250000)
ids = set()
for _ in range(100):
    message = bus.recv(30)
    ids.add(message.arbitration_id)
print(sorted(ids))
bus.send(can.Message(arbitration_id=0x7A1, data=[4], is_extended_id=False))
bus.shutdown()
";
    let heard = Command::new("python3")
        .args(["-c", script])
        .arg(&link)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&heard.stdout);
    assert!(said.contains("100, 200, 300"), "{heard:?}");
    run.wait_with_output().unwrap();
    let log = fs::read_to_string(folder.path().join("run/bus.log")).unwrap();
    assert!(log.contains(" can0 7A1#04"));
}

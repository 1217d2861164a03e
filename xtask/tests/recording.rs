//! `cargo xtask sim --out`: what is in the folder of a run, read by programs that are not Furrow's
//! where they are installed.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use mcap::MessageStream;
use serde_json::Value;
use xtask::{Workspace, vehicle};

/// A run of three seconds in which an error frame destroys a frame.
const SCENARIO: &str = "\
    summary = \"it drives, and a frame is destroyed\"\n\
    duration = \"3 s\"\n\
    [[press]]\nat = \"1 s\"\nbutton = \"C\"\n\
    [[press]]\nat = \"2 s\"\nbutton = \"C\"\n\
    [[bus]]\nwhat = \"corrupt\"\nat = \"1500 ms\"\nid = 300\n";

/// The files of a run of the UAGV.
const FILES: [&str; 15] = [
    "bus.log",
    "console-controller.txt",
    "console-drive.txt",
    "console-gps.txt",
    "console-steering.txt",
    "display.txt",
    "log-controller.txt",
    "log-drive.txt",
    "log-gps.txt",
    "log-steering.txt",
    "motors.csv",
    "run.html",
    "run.mcap",
    "states.csv",
    "summary.json",
];

fn sim(folder: &Path) -> PathBuf {
    let scenario = folder.join("destroyed.toml");
    fs::write(&scenario, SCENARIO).unwrap();
    let out = folder.join("run");
    let done = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .arg("sim")
        .arg(&scenario)
        .arg("--out")
        .arg(&out)
        .current_dir(Workspace::find().unwrap().root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    out
}

/// The standard output of a program; `None` if it is not installed.
fn output(command: &mut Command) -> Option<Output> {
    command.output().ok()
}

#[test]
fn a_run_is_kept_whole() {
    let folder = tempfile::tempdir().unwrap();
    let run = sim(folder.path());
    for file in FILES {
        let length = fs::metadata(run.join(file)).map(|data| data.len());
        assert!(length.is_ok_and(|length| length > 0), "{file}");
    }
    texts(&run);
    let topics = channels(&fs::read(run.join("run.mcap")).unwrap());
    let states = fs::read_to_string(run.join("states.csv")).unwrap();
    assert_eq!(topics["/states"], states.lines().count() - 1);
    foreign_readers(&run, &topics);
    in_a_browser(&run);
}

/// An error frame counts in report and log alike, also one that destroys no frame.
#[test]
fn report_and_log_count_the_same_error_frames() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("held.toml");
    let text = "summary = \"the bus is held\"\nduration = \"1 s\"\n\
        [[bus]]\nwhat = \"dominant\"\nat = \"503 ms\"\nhold = \"1 ms\"\n\
        [[bus]]\nwhat = \"dominant\"\nat = \"650 ms\"\nhold = \"1 ms\"\n";
    fs::write(&scenario, text).unwrap();
    let out = folder.path().join("run");
    let done = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["sim", "--vehicle", "two-boards"])
        .arg(&scenario)
        .arg("--out")
        .arg(&out)
        .current_dir(Workspace::find().unwrap().root())
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let bus = fs::read_to_string(out.join("bus.log")).unwrap();
    let logged = bus.lines().filter(|line| line.contains(" can0 2000"));
    let logged = logged.count();
    let summary = fs::read(out.join("summary.json")).unwrap();
    let summary: Value = serde_json::from_slice(&summary).unwrap();
    assert_eq!(summary["bus"]["error_frames"], logged);
    assert_eq!(logged, 2);
}

fn texts(run: &Path) {
    let read = |name: &str| fs::read_to_string(run.join(name)).unwrap();
    let log = read("log-controller.txt");
    assert!(log.contains("INFO Mode(AutonomousRun, ButtonC)"), "{log}");
    assert!(log.contains("INFO Start(Power)"), "{log}");
    let console = read("console-controller.txt");
    assert!(console.contains("uagv run"), "{console}");
    let display = read("display.txt");
    assert!(display.contains("run XTE"), "{display}");
    let motors = read("motors.csv");
    assert!(motors.contains(",drive,relay,closed,"), "{motors}");
    assert!(motors.lines().any(|line| line.contains(",drive,byte,")));

    let bus = read("bus.log");
    let errors: Vec<&str> = bus
        .lines()
        .filter(|line| line.contains(" can0 2000"))
        .collect();
    assert_eq!(errors.len(), 1, "{errors:?}");
    let states = read("states.csv");
    let last = states.lines().last().unwrap();
    assert_eq!(
        last.split(',').filter(|cell| !cell.is_empty()).count(),
        16,
        "{last}"
    );
}

/// The number of messages of each topic. Every message has the fields of its schema only, and the
/// messages are in order of time.
fn channels(bytes: &[u8]) -> BTreeMap<String, usize> {
    let mut topics = BTreeMap::new();
    let mut last = 0;
    for message in MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        assert!(message.log_time >= last);
        last = message.log_time;
        let channel = &message.channel;
        let schema = channel.schema.as_ref().unwrap();
        let schema: Value = serde_json::from_slice(&schema.data).unwrap();
        let value: Value = serde_json::from_slice(&message.data).unwrap();
        for (name, field) in value.as_object().unwrap() {
            let kind = match field {
                Value::Bool(_) => "boolean",
                Value::String(_) => "string",
                Value::Object(_) => "object",
                Value::Number(_) => "number",
                other => panic!("{other}"),
            };
            let told = &schema["properties"][name]["type"];
            let fits = told == kind || (told == "integer" && field.as_u64().is_some());
            assert!(fits, "{} of {}: {told}, {field}", name, channel.topic);
        }
        if channel.topic.starts_with("/load/") {
            adds_up(&value);
        }
        *topics.entry(channel.topic.clone()).or_default() += 1;
    }
    for topic in [
        "/bus/frames",
        "/signals/Command",
        "/log/gps",
        "/display",
        "/mode",
        "/load/controller",
        "/events",
    ] {
        assert!(topics.contains_key(topic), "{topic}: {topics:?}");
    }
    assert_eq!(topics["/bus/errors"], 1);
    assert_eq!(topics["/load/controller"], topics["/load/drive"]);
    topics
}

/// The times of all tasks are the load of the basic cycle of 100 ms.
fn adds_up(load: &Value) {
    let fields = load.as_object().unwrap().iter();
    let tasks = fields.filter(|(name, _)| *name != "load");
    let sum: f64 = tasks.map(|(_, micros)| micros.as_f64().unwrap()).sum();
    let told = load["load"].as_f64().unwrap();
    assert!((sum / 1000.0 - told).abs() < 0.01, "{sum} {told}");
    assert!((0.1..100.0).contains(&told), "{told}");
}

/// The `mcap` and `python-can` of PyPI count what is in the files.
fn foreign_readers(run: &Path, topics: &BTreeMap<String, usize>) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recording/read.py");
    let root = Workspace::find().unwrap().root().to_owned();
    let network = root.join("firmware/vehicles/uagv/network.dbc");
    let mut python = Command::new("python3");
    let Some(done) = output(python.arg(script).arg(run).arg(network)) else {
        eprintln!("skipped: no python3 reads the files");
        return;
    };
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let read: Value = serde_json::from_str(&said).unwrap();
    match read["mcap"].as_object() {
        None => eprintln!("skipped: PyPI's mcap is not installed"),
        Some(read) => {
            let read = read
                .iter()
                .map(|(topic, count)| (topic.clone(), count.as_u64()));
            let expected = topics
                .iter()
                .map(|(topic, count)| (topic.clone(), Some(*count as u64)));
            assert_eq!(read.collect::<Vec<_>>(), expected.collect::<Vec<_>>());
        }
    }
    match read["cantools"].as_array() {
        None => eprintln!("skipped: PyPI's cantools is not installed"),
        Some(read) => {
            let (frames, numbers) = (read[0].as_u64().unwrap(), read[1].as_u64().unwrap());
            assert!(frames > 200 && numbers > 3 * frames, "{frames} {numbers}");
        }
    }
    match read["canmatrix"].as_array() {
        None => eprintln!("skipped: PyPI's canmatrix is not installed"),
        Some(read) => {
            let uagv = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
            let messages = uagv.network().messages.iter();
            let mut names: Vec<Value> = messages.map(|one| one.name.clone().into()).collect();
            names.sort_by_key(ToString::to_string);
            assert_eq!(read, &names);
        }
    }
    match read["can"].as_array() {
        None => eprintln!("skipped: PyPI's python-can is not installed"),
        Some(read) => {
            let frames = fs::read_to_string(run.join("bus.log")).unwrap();
            let frames = frames.lines().count() as u64 - 1;
            assert_eq!(read, &[Value::from(frames), Value::from(1)]);
        }
    }
}

/// Chromium shows the page, and nothing in it fails.
fn in_a_browser(run: &Path) {
    let profile = tempfile::tempdir().unwrap();
    let page = format!("file://{}#2.5", run.join("run.html").display());
    let mut chromium = Command::new("chromium");
    chromium
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
        ])
        .args([
            "--disable-background-networking",
            "--disable-component-update",
        ])
        .args(["--disable-sync", "--virtual-time-budget=8000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(page);
    let Some(done) = output(&mut chromium) else {
        eprintln!("skipped: no chromium shows the page");
        return;
    };
    let shown = String::from_utf8_lossy(&done.stdout);
    assert!(shown.contains("data-state=\"ready\""), "{shown}");
    for text in [
        "2.500 s of 3.0 s",
        "<dt>mode</dt><dd>AutonomousRun</dd>",
        "run XTE",
        "Basic cycle 24",
        "SteeringEnabled 1",
        "INFO Start(Power)",
    ] {
        assert!(shown.contains(text), "{text}: {shown}");
    }
}

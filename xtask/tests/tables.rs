//! `cargo xtask analyse`: MCAP files as logs, and tables as Parquet, beside programs that are not Furrow's where they
//! are installed.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use mcap::{WriteOptions, records::MessageHeader};
use serde_json::Value;
use xtask::{Workspace, analyse::analyse, vehicle};

/// The first 10 s of `cargo xtask sim`.
const DRIVE: &str = "xtask/tests/data/straight-line.candump.log";

fn root() -> PathBuf {
    Workspace::find().unwrap().root().to_owned()
}

fn xtask(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(words)
        .current_dir(root())
        .output()
        .unwrap()
}

/// Analyses a log into a folder of that name beside it. Returns the folder.
fn analysed(log: &Path, name: &str) -> PathBuf {
    let out = log.with_file_name(name);
    let (log, to) = (log.display().to_string(), out.display().to_string());
    let done = xtask(&["analyse", &log, "--out", &to]);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    out
}

/// The figures, without what says where they come from.
fn figures(folder: &Path) -> Value {
    let text = fs::read(folder.join("analysis.json")).unwrap();
    let mut figures: Value = serde_json::from_slice(&text).unwrap();
    for name in ["files", "interface", "interfaces"] {
        figures["log"][name].take();
    }
    figures
}

/// What a script of the folder of this test prints; `None` without python3.
fn python(script: &str, arguments: &[&Path]) -> Option<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tables");
    let done = Command::new("python3")
        .arg(folder.join(script))
        .args(arguments)
        .output()
        .ok()?;
    assert!(done.status.success(), "{done:?}");
    Some(String::from_utf8(done.stdout).unwrap())
}

/// The recording of a run tells what its log tells, up to the microseconds of the log.
#[test]
fn the_recording_of_a_run_is_read_as_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("destroyed.toml");
    let text = "summary = \"a frame is destroyed\"\nduration = \"2 s\"\n\
        [[bus]]\nwhat = \"corrupt\"\nat = \"1500 ms\"\nid = 300\n";
    fs::write(&scenario, text).unwrap();
    let run = folder.path().join("run");
    let (scenario, to) = (scenario.display().to_string(), run.display().to_string());
    let done = xtask(&["sim", &scenario, "--out", &to]);
    assert!(done.status.success(), "{done:?}");
    let rows = |name: &str| -> Vec<(f64, String)> {
        let folder = analysed(&run.join(name), &format!("of-{name}"));
        let found = figures(&folder);
        assert_eq!(found["log"]["skipped"]["error frames"], 1, "{name}");
        let messages = fs::read_to_string(folder.join("messages.csv")).unwrap();
        let lines = messages.lines().skip(1);
        lines
            .map(|line| {
                let (time, rest) = line.split_once(',').unwrap();
                (time.parse().unwrap(), rest.to_owned())
            })
            .collect()
    };
    let (log, recording) = (rows("bus.log"), rows("run.mcap"));
    assert!(log.len() > 500);
    assert_eq!(log.len(), recording.len());
    for (one, other) in log.iter().zip(&recording) {
        assert!((one.0 - other.0).abs() < 2.5e-6, "{one:?} {other:?}");
        assert_eq!(one.1, other.1);
    }
}

/// The `mcap` of PyPI writes the frames of a log as a recorder of ROS 2 does.
#[test]
fn a_recording_of_ros_is_read_as_the_candump_of_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("bus.log");
    let drive = fs::read_to_string(root().join(DRIVE)).unwrap();
    let remote = "(0000000010.500000) can0 12C#R8\n(0000000010.600000) can0 0000012C#01\n";
    fs::write(&log, format!("{drive}{remote}")).unwrap();
    let of_log = analysed(&log, "log");
    let read = |folder: &Path, name: &str| fs::read(folder.join(name)).unwrap();
    for compression in ["NONE", "LZ4", "ZSTD"] {
        let file = folder.path().join(format!("{compression}.mcap"));
        match python("write_mcap.py", &[&log, &file, Path::new(compression)]).as_deref() {
            None | Some("absent\n") => {
                eprintln!("skipped: PyPI's mcap is not installed");
                return;
            }
            Some(_) => {}
        }
        let of_file = analysed(&file, compression);
        assert_eq!(figures(&of_file), figures(&of_log), "{compression}");
        for name in ["messages.csv", "events.csv", "messages.parquet"] {
            assert!(read(&of_file, name) == read(&of_log, name), "{name}");
        }
        let page = String::from_utf8(read(&of_file, "analysis.html")).unwrap();
        assert!(page.contains("/from_can_bus"), "the topic is the interface");
    }
}

/// `pyarrow` of PyPI finds the same rows in both forms of a table.
#[test]
fn parquet_has_the_rows_of_csv() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("bus.log");
    fs::copy(root().join(DRIVE), &log).unwrap();
    let out = analysed(&log, "out");
    for name in ["messages.parquet", "events.parquet"] {
        let table = fs::read(out.join(name)).unwrap();
        assert!(
            table.starts_with(b"PAR1") && table.ends_with(b"PAR1"),
            "{name}"
        );
    }
    let messages = fs::read_to_string(out.join("messages.csv")).unwrap();
    match python("read_parquet.py", &[&out]).as_deref() {
        None | Some("absent\n") => eprintln!("skipped: PyPI's pyarrow is not installed"),
        Some(said) => {
            let rows = messages.lines().count() - 1;
            assert!(said.starts_with(&format!("messages {rows}\n")), "{said}");
        }
    }
}

/// A small file with a chunk of frames.
fn small() -> Vec<u8> {
    let options = WriteOptions::new().compression(None).library("test");
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let schema = writer
        .add_schema("furrow.Frame", "jsonschema", b"{}")
        .unwrap();
    let channel = writer
        .add_channel(
            schema,
            "/bus/frames",
            "json",
            &std::collections::BTreeMap::new(),
        )
        .unwrap();
    for at in 0..4 {
        let header = MessageHeader {
            channel_id: channel,
            sequence: at,
            log_time: u64::from(at) * 1_000_000,
            publish_time: 0,
        };
        let message = br#"{"id":300,"data":"0000000000000000"}"#;
        writer.write_to_known_channel(&header, message).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// A broken file is refused in a sentence, wherever it is broken.
#[test]
fn a_broken_recording_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.mcap");
    let uagv = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
    let of = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        analyse(&uagv, std::slice::from_ref(&path), None)
    };
    let whole = small();
    assert_eq!(of(&whole).unwrap().log.frames, 4);
    for cut in 8..whole.len() {
        let error = of(&whole[..cut]).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let said = error.to_string();
        assert!(said.contains("no whole MCAP file"), "{cut}: {said}");
        assert!(!said.contains('\n'), "{said}");
    }
    let mut refused = 0;
    for place in 8..whole.len() {
        for bit in [0, 7] {
            let mut bytes = whole.clone();
            bytes[place] ^= 1 << bit;
            // What no check value covers may change unseen.
            if let Err(error) = of(&bytes) {
                assert_eq!(error.exit_code(), 2, "{place}: {error}");
                assert!(!error.to_string().contains('\n'), "{place}: {error}");
                refused += 1;
            }
        }
    }
    assert!(refused > whole.len() / 2, "{refused} of {}", whole.len());
}

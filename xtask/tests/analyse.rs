//! `cargo xtask analyse`: reports of real logs, counts of skipped lines, and refusals.

use std::{
    collections::BTreeSet,
    env, fs,
    path::{Path, PathBuf},
    process,
};

use vehicle_model::Vehicle;
use xtask::{
    Failure, Workspace,
    analyse::{EventKind, Summary, analyse, text},
    vehicle,
};

/// The logged basic period of the thesis (Figure 6.33), in `firmware/vehicles/uagv/tests/data`.
const THESIS: &str = "firmware/vehicles/uagv/tests/data/thesis_fig6_33.candump.log";
/// The first 10 s of `cargo xtask sim`.
const DRIVE: &str = "xtask/tests/data/straight-line.candump.log";

fn root() -> PathBuf {
    Workspace::find().unwrap().root().to_owned()
}

fn uagv() -> Vehicle {
    vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap()
}

fn of_file(path: &Path) -> Result<Summary, Failure> {
    analyse(&uagv(), &[path.to_owned()], None)
}

/// The analysis of a log with this text.
fn of_text(log: impl AsRef<[u8]>) -> Summary {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bus.log");
    fs::write(&path, log).unwrap();
    of_file(&path).unwrap()
}

/// Compares a report with the one that is kept; `ANALYSES=renew` writes it instead.
fn compare(log: &str, kept: &str) {
    let mut summary = of_file(&root().join(log)).unwrap();
    log.clone_into(&mut summary.log.files[0].file);
    let report = text(&summary);
    let path = root().join("xtask/tests/data").join(kept);
    if env::var("ANALYSES").is_ok_and(|value| value == "renew") {
        fs::write(path, report).unwrap();
        return;
    }
    let kept = fs::read_to_string(path).unwrap();
    assert_eq!(report, kept, "ANALYSES=renew writes the report anew");
}

#[test]
fn the_report_of_the_thesis_log_is_the_kept_one() {
    compare(THESIS, "analyse-thesis.txt");
}

#[test]
fn the_report_of_a_drive_is_the_kept_one() {
    compare(DRIVE, "analyse-straight-line.txt");
}

/// `summary.json` of the run says: settled in 3.96 s, then -0.09 cm in the mean over 60 s, no
/// missed window, no frame outside its window. The positions have a noise of 1 cm.
#[test]
fn the_figures_of_a_drive_are_those_of_the_run() {
    let summary = of_file(&root().join(DRIVE)).unwrap();
    let guidance = summary.guidance.unwrap();
    let [run] = &guidance.runs[..] else {
        panic!("{:?}", guidance.runs);
    };
    assert!((run.initial_cross_track_error_cm - 100.0).abs() < 3.0);
    assert!((run.settling_seconds.unwrap() - 3.96).abs() < 0.3);
    assert!(run.mean_cross_track_error_cm.abs() < 0.8);
    assert!((0.8..1.6).contains(&run.standard_deviation_cm));
    // The estimator takes most of the noise away.
    assert!(run.estimated_mean_cm.unwrap().abs() < 0.8);
    assert!(run.estimated_deviation_cm.unwrap() < run.standard_deviation_cm);
    let bars = guidance.histogram.unwrap();
    let counted: u64 = bars.positions.iter().sum();
    assert!(counted > 30 && counted < run.positions);
    let schedule = summary.schedule.unwrap();
    assert_eq!(schedule.missed_windows, 0);
    assert_eq!(schedule.frames_outside_their_window, 0);
    assert!(schedule.foreign.is_empty());
    let modes: Vec<&str> = summary
        .modes
        .iter()
        .map(|mode| mode.mode.as_str())
        .collect();
    assert_eq!(modes, ["Idle", "AutonomousReady", "AutonomousRun"]);
    let buttons = summary.events.iter();
    let buttons = buttons.filter(|event| event.kind == EventKind::Button);
    assert_eq!(buttons.count(), 4);
}

fn drive() -> String {
    fs::read_to_string(root().join(DRIVE)).unwrap()
}

#[test]
fn what_is_no_frame_of_the_bus_is_counted_and_changes_nothing() {
    let clean = of_text(drive());
    let mut messy = b"\xEF\xBB\xBF".to_vec();
    for (index, line) in drive().lines().enumerate() {
        messy.extend_from_slice(line.as_bytes());
        messy.extend_from_slice(b"\r\n");
        let stamp = &line[..20];
        if index % 100 == 0 {
            for extra in [
                &b"can1 12C#0000000000000000"[..],
                b"can0 20000004#0004000000000000",
                b"can0 064##100112233",
                b"can0 064#\xFF",
                b"can0 064#0",
            ] {
                messy.extend_from_slice(stamp.as_bytes());
                messy.extend_from_slice(extra);
                messy.push(b'\n');
            }
        }
    }
    messy.extend_from_slice(b"(0000000010.0000");
    let found = of_text(&messy);
    let times = found.log.frames_of_other_interfaces;
    assert_eq!(times, 13);
    let skipped = [
        ("CAN FD frames", times),
        ("cut last lines", 1),
        ("error frames", times),
        ("lines that are not UTF-8", times),
        ("unreadable lines", times),
    ];
    assert_eq!(found.log.skipped, skipped.into());
    let report = text(&found);
    assert!(report.contains("can1: 13"), "{report}");
    for (name, count) in skipped {
        assert!(report.contains(&format!("{name}: {count}")), "{report}");
    }
    assert_eq!(found.messages, clean.messages);
    assert_eq!(found.schedule, clean.schedule);
    assert_eq!(found.guidance, clean.guidance);
    assert_eq!(found.events, clean.events);
}

#[test]
fn unknown_identifiers_remote_frames_and_wrong_lengths_are_counted() {
    let log = format!(
        "{}(9.999991) can0 7F0#01\n(9.999992) can0 18FF0102#02\n(9.999993) can0 12C#R8\n\
         (9.999994) can0 12C#00\n",
        drive()
    );
    let clean = of_text(drive());
    let found = of_text(log);
    let unknown: Vec<_> = found
        .unknown
        .iter()
        .map(|one| (one.id, one.extended))
        .collect();
    assert_eq!(unknown, [(0x7F0, false), (0x18FF_0102, true)]);
    assert_eq!((found.log.remote_frames, found.log.wrong_length), (1, 1));
    let [asked] = &found.remote[..] else {
        panic!("{:?}", found.remote);
    };
    assert_eq!((asked.id, asked.message.as_deref()), (300, Some("Command")));
    assert!(
        text(&found).contains("1 remote frame for 300"),
        "{}",
        text(&found)
    );
    assert_eq!(found.log.frames, clean.log.frames + 4);
    assert_eq!(found.steering, clean.steering);
}

/// Any node may ask for a message: that it was asked for is no frame of its sender, nor of a window.
#[test]
fn remote_frames_have_no_share_in_messages_and_windows() {
    let mut log = String::new();
    for line in drive().lines() {
        log += line;
        log.push('\n');
        if line.contains(" can0 0CE#") {
            // In the middle of another message's window.
            let at: f64 = line[1..18].parse().unwrap();
            log += &format!("({:.6}) can0 0CE#R2\n", at + 0.000_01);
            log += &format!("({:.6}) can0 064#R8\n", at + 0.000_02);
        }
    }
    let (clean, found) = (of_text(drive()), of_text(log));
    assert!(found.log.remote_frames > 100);
    assert_eq!(found.messages, clean.messages);
    assert_eq!(found.schedule, clean.schedule);
    assert_eq!(found.events, clean.events);
    assert!(found.unknown.is_empty());
    assert_eq!(found.remote.len(), 2);
}

/// The log of another vehicle: its frames are those of a schedule that this one does not have.
#[test]
fn a_log_of_another_vehicle_names_it() {
    let workspace = Workspace::find().unwrap();
    let network = vehicle::find(&workspace, "two-boards").unwrap();
    let network = network.network();
    let mut log = String::new();
    for cycle in 0..100_u32 {
        let mut messages: Vec<_> = network.messages.iter().collect();
        messages.sort_by_key(|message| message.window.start_us);
        for message in messages.iter().filter(|one| one.window.start_us < 15_000) {
            let at = cycle * network.basic_cycle_us + message.window.start_us + 1000;
            let data = "00".repeat(usize::from(message.length));
            log += &format!(
                "({:.6}) can0 {:03X}#{}\n",
                f64::from(at) * 1e-6,
                message.id,
                data
            );
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bus.log");
    fs::write(&file, log).unwrap();
    let done = process::Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["analyse", file.to_str().unwrap()])
        .current_dir(root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(said.contains("--vehicle two-boards fits better"), "{said}");
    let clean = process::Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["analyse", DRIVE])
        .current_dir(root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&clean.stderr);
    assert!(!said.contains("note:"), "{said}");
}

/// Times count from the first stamp, and the first frame began before it.
#[test]
fn no_event_is_before_the_first_stamp() {
    let log: String = drive()
        .lines()
        .filter(|line| !(0.25..0.45).contains(&line[1..18].parse::<f64>().unwrap()))
        .flat_map(|line| [line, "\n"])
        .collect();
    let found = of_text(log);
    let missing = found.events.iter();
    let missing = missing.filter(|event| event.kind == EventKind::MissingReference);
    assert_eq!(missing.count(), 1);
    assert!(found.events.iter().all(|event| event.at_seconds >= 0.0));
}

/// What waited in a queue until the logger read it is stamped late, all at once.
#[test]
fn nothing_is_judged_before_two_references_are_in_order() {
    let opened = 1.53;
    let log: String = drive()
        .lines()
        .map(|line| {
            let at: f64 = line[1..18].parse().unwrap();
            format!("({:.6}) {}\n", at.max(opened), &line[20..])
        })
        .collect();
    let schedule = of_text(log).schedule.unwrap();
    assert_eq!(schedule.frames_outside_their_window, 0);
    assert_eq!(
        (schedule.missed_windows, schedule.missing_references),
        (0, 0)
    );
    assert!(schedule.frames_without_reference > 10);
    assert!(schedule.shortest_cycle_us.unwrap() > 90_000.0);
}

#[test]
fn gaps_missing_references_and_a_time_that_goes_back_are_events() {
    let keep = |from: f64, until: f64| {
        drive()
            .lines()
            .filter(|line| (from..until).contains(&line[1..18].parse().unwrap()))
            .flat_map(|line| [line, "\n"])
            .collect::<String>()
    };
    let log = format!("{}{}{}", keep(0.0, 3.0), keep(4.0, 5.0), keep(4.5, 6.0));
    let found = of_text(log);
    let of_kind = |kind| {
        let events = found.events.iter().filter(move |event| event.kind == kind);
        events.map(|event| event.what.as_str()).collect::<Vec<_>>()
    };
    let gaps = of_kind(EventKind::Gap);
    assert!(
        gaps.len() == 1 && gaps[0].starts_with("no frame for 1.0"),
        "{gaps:?}"
    );
    let missing = of_kind(EventKind::MissingReference);
    assert_eq!(missing, ["10 reference messages missing after this one"]);
    let back = of_kind(EventKind::Time);
    assert!(back.len() == 1 && back[0].contains("earlier"), "{back:?}");
    assert_eq!(found.log.time_goes_back, 1);
}

/// A logger that loses frames: the nodes have heard the reference that it has not.
#[test]
fn frames_behind_a_lost_reference_are_in_their_windows() {
    let without = |lost: std::ops::Range<usize>| {
        let mut references = 0;
        let kept = |line: &&str| {
            let is_reference = &line[25..28] == "064";
            references += usize::from(is_reference);
            !(is_reference && lost.contains(&references))
        };
        let log: Vec<&str> = drive().leak().lines().filter(kept).collect();
        of_text(log.join("\n") + "\n").schedule.unwrap()
    };
    let all = without(0..0);
    let one = without(50..51);
    assert_eq!(one.missing_references, 1);
    assert_eq!(one.basic_cycles + 1, all.basic_cycles);
    assert_eq!(
        (one.frames_outside_their_window, one.missed_windows),
        (0, 0)
    );
    assert_eq!(one.frames_without_reference, all.frames_without_reference);
    // Without two in a row nobody leads any more, as far as the log tells.
    let two = without(50..52);
    assert_eq!(
        (two.missing_references, two.frames_outside_their_window),
        (2, 0)
    );
    assert!(two.frames_without_reference > all.frames_without_reference + 5);
}

/// The lines of the drive, each stamp so many seconds later.
fn later(seconds: f64) -> String {
    drive()
        .lines()
        .map(|line| {
            let at: f64 = line[1..18].parse().unwrap();
            format!("({:017.6}){}\n", at + seconds, &line[19..])
        })
        .collect()
}

/// Two drives in one log, as a logger has them whose vehicle was switched off in between.
#[test]
fn nothing_is_carried_over_a_gap_or_a_time_that_goes_back() {
    let one = of_text(drive());
    for (seconds, back) in [(15.0, 0), (10_800.0, 0), (0.0, 1), (-5.0, 1)] {
        let log = format!("{}{}", later(20.0), later(20.0 + seconds));
        let both = of_text(log);
        assert_eq!(both.log.time_goes_back, back, "{seconds}");
        let (alone, runs) = (one.guidance.as_ref().unwrap(), both.guidance.unwrap().runs);
        assert_eq!(runs.len(), 2, "{seconds}: {runs:?}");
        for run in &runs {
            assert_eq!(
                run.settling_seconds, alone.runs[0].settling_seconds,
                "{seconds}"
            );
            assert_eq!(
                run.mean_cross_track_error_cm, alone.runs[0].mean_cross_track_error_cm,
                "{seconds}"
            );
        }
        let (schedule, alone) = (both.schedule.unwrap(), one.schedule.as_ref().unwrap());
        assert_eq!(
            schedule.shortest_cycle_us, alone.shortest_cycle_us,
            "{seconds}"
        );
        assert_eq!(
            schedule.longest_cycle_us, alone.longest_cycle_us,
            "{seconds}"
        );
        assert_eq!(schedule.frames_outside_their_window, 0, "{seconds}");
        let away = both.log.load_percent - one.log.load_percent;
        assert!(away.abs() < 0.01, "{seconds}: {} %", both.log.load_percent);
        // Of a pause of hours nothing is known.
        let missing = schedule.missing_references;
        assert!(missing < 60, "{seconds}: {missing} references missing");
    }
}

/// A node that falls silent, one that never sends, and a stranger: when, not only how often.
#[test]
fn what_is_missing_or_misplaced_has_its_time() {
    let log: String = drive()
        .lines()
        .flat_map(|line| {
            let at: f64 = line[1..18].parse().unwrap();
            let kept = match &line[25..28] {
                // The steering node falls silent, and returns.
                "0CE" => !(5.0..7.0).contains(&at),
                // The drive node never sends.
                "0D0" => false,
                _ => true,
            };
            let stranger = (&line[25..28] == "12C" && at > 8.0)
                .then(|| format!("({:017.6}) can0 123#00\n", at - 0.001));
            let own = kept.then(|| format!("{line}\n"));
            stranger.into_iter().chain(own)
        })
        .collect();
    let found = of_text(log);
    let of_kind = |kind| {
        let events = found.events.iter().filter(move |event| event.kind == kind);
        events
            .map(|event| (event.at_seconds.floor(), event.what.as_str()))
            .collect::<Vec<_>>()
    };
    let start = found.log.start_seconds;
    let empty = of_kind(EventKind::EmptyWindow);
    assert_eq!(empty.len(), 1, "{empty:?}");
    assert!(
        empty[0]
            .1
            .starts_with("SteeringPot of steering: 20 windows"),
        "{empty:?}"
    );
    assert!(
        (empty[0].0 - (5.0 - start).floor()).abs() < 1.5,
        "{empty:?}"
    );
    let misplaced = of_kind(EventKind::Misplaced);
    assert_eq!(misplaced.len(), 1, "{misplaced:?}");
    assert!(
        misplaced[0].1.starts_with("first frame of 291"),
        "{misplaced:?}"
    );
    assert!(text(&found).contains("never came, and is not counted as missed: DriveState (drive)"));
}

#[test]
fn relative_stamps_are_refused() {
    let mut last = 0.0;
    let relative = drive()
        .lines()
        .map(|line| {
            let at: f64 = line[1..18].parse().unwrap();
            let since = at - std::mem::replace(&mut last, at);
            format!("({since:017.6}){}\n", &line[19..])
        })
        .collect::<String>();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("relative.log");
    fs::write(&path, relative).unwrap();
    let error = of_file(&path).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("candump -t d"), "{error}");
}

/// Neither a log nor the report of a run is replaced.
#[test]
fn the_folder_of_a_log_keeps_what_is_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let out = folder.path().to_str().unwrap().to_owned();
    fs::write(path("summary.json"), "of the run").unwrap();
    fs::write(path("bus.log"), drive()).unwrap();
    run(&[path("bus.log").to_str().unwrap(), "--out", &out]);
    assert_eq!(
        fs::read_to_string(path("summary.json")).unwrap(),
        "of the run"
    );
    fs::write(path("messages.csv"), drive()).unwrap();
    let log = path("messages.csv");
    let done = process::Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["analyse", log.to_str().unwrap(), "--out", &out])
        .current_dir(root())
        .output()
        .unwrap();
    assert_eq!(done.status.code(), Some(2), "{done:?}");
    assert_eq!(fs::read_to_string(log).unwrap(), drive());
}

/// Opening a pipe would wait for its writer.
#[cfg(unix)]
#[test]
fn a_pipe_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    let made = process::Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    let error = of_file(&pipe).unwrap_err();
    assert!(
        error.to_string().contains("a pipe is not accepted"),
        "{error}"
    );
}

/// Stamps up to the end of 64 bits of nanoseconds, in both directions.
#[test]
fn impossible_times_are_analysed_too() {
    let stamps = [
        "0.0",
        "18446744073.709551615",
        "9223372036.854775807",
        "1.0",
        "18446744073.0",
    ];
    for first in stamps {
        let lines = stamps.iter().flat_map(|second| [first, second]);
        let log: String = lines
            .flat_map(|at| {
                ["064#0000000000000000", "12C#0000000000000000"].map(|frame| (at, frame))
            })
            .map(|(at, frame)| format!("({at}) can0 {frame}\n"))
            .collect();
        let found = of_text(log);
        assert_eq!(found.log.frames, 20);
        assert!(found.log.time_goes_back > 0);
        assert!(!text(&found).is_empty());
    }
}

/// A bus in trouble: the mode changes with every command, and a neighbour has a new identifier for
/// each of its frames.
#[test]
fn a_restless_bus_gives_a_report_that_can_be_read() {
    let mut log = String::new();
    for cycle in 0..3000 {
        let (second, tenth) = (cycle / 10, cycle % 10);
        let mode = 2 + cycle % 2;
        log += &format!(
            "({second}.{tenth}00000) can0 064#000000000000{:02X}00\n\
             ({second}.{tenth}07000) can0 12C#00000000{mode:02X}000000\n\
             ({second}.{tenth}20000) can0 18FF{cycle:04X}#00\n",
            cycle % 64
        );
    }
    let found = of_text(&log);
    assert_eq!((found.modes.len(), found.unknown.len()), (3000, 3000));
    let changes = found.events.iter();
    let changes = changes.filter(|event| event.kind == EventKind::Mode);
    assert_eq!(changes.count(), 2999);
    let report = text(&found);
    assert!(report.lines().count() < 200, "{}", report.lines().count());
    assert!(
        report.contains("and 2960 more: --json has them all"),
        "{report}"
    );

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bus.log");
    fs::write(&path, &log).unwrap();
    let out = folder.path().join("out");
    let words = [path.to_str().unwrap(), "--out", out.to_str().unwrap()];
    run(&words);
    let page = fs::read_to_string(out.join("analysis.html")).unwrap();
    assert!(page.contains("1000 more rows are in analysis.json."));
    assert!(page.len() < 2_000_000, "{}", page.len());
    let picture = fs::read_to_string(out.join("analysis-windows.svg")).unwrap();
    assert!(picture.starts_with("<svg xmlns=") && picture.ends_with("</svg>"));
    assert_eq!(picture.matches("<svg").count(), 1);
}

#[test]
fn a_backup_master_is_one_event() {
    let references = |id: &'static str, from: u32| {
        (from..from + 20).map(move |cycle| {
            let (second, tenth) = (cycle / 10, cycle % 10);
            format!(
                "({second}.{tenth}00000) can0 {id}#0000000000{:02X}0000\n",
                cycle % 64
            )
        })
    };
    let log: String = references("064", 0).chain(references("065", 20)).collect();
    let found = of_text(log);
    let [event] = &found.events[..] else {
        panic!("{:?}", found.events);
    };
    assert_eq!(event.kind, EventKind::Master);
    assert_eq!(event.what, "controller leads the bus with reference 101");
    let schedule = found.schedule.unwrap();
    assert_eq!(
        (schedule.basic_cycles, schedule.missing_references),
        (40, 0)
    );
}

#[test]
fn a_drive_in_several_logs_is_one_drive() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one.log"), folder.path().join("two.log"));
    let all = drive();
    let middle = all.match_indices('\n').nth(600).unwrap().0 + 1;
    fs::write(&one, &all[..middle]).unwrap();
    fs::write(&two, &all[middle..]).unwrap();
    let whole = of_text(&all);
    let parts = analyse(&uagv(), &[one.clone(), two.clone()], None).unwrap();
    assert_eq!(parts.messages, whole.messages);
    assert_eq!(parts.schedule, whole.schedule);
    assert_eq!(parts.guidance, whole.guidance);
    let error = analyse(&uagv(), &[two, one], None).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("in order of time"), "{error}");
}

#[test]
fn what_cannot_be_analysed_is_refused_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let errors = "(1.0) can0 20000004#0004000000000000\n";
    for (path, named) in [
        (
            folder.path().join("absent.log"),
            "absent.log: it cannot be read",
        ),
        (folder.path().to_owned(), "it is a folder"),
        (file("empty.log", b""), "it is empty"),
        (
            file("words.log", b"hello\nworld\n"),
            "no line is one of a log: candump",
        ),
        (
            file("zeros.log", &[0; 20_000]),
            "no line is one of a log: candump",
        ),
        (
            file("errors.log", errors.as_bytes()),
            "there is no frame of classical CAN",
        ),
    ] {
        let error = of_file(&path).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(named), "{error}");
        assert!(!error.to_string().contains('\n'), "{error}");
    }
    let log = [root().join(THESIS)];
    let error = analyse(&uagv(), &log, Some("can7")).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert_eq!(
        error.to_string(),
        "no frame is of interface \"can7\": can0 is accepted"
    );
}

/// Time in seconds, identifier and data of the drive's frames, in hexadecimal.
fn frames(log: &str) -> Vec<(&str, &str, Vec<&str>)> {
    log.lines()
        .map(|line| {
            let (id, data) = line[25..].split_once('#').unwrap();
            let data = (0..data.len()).step_by(2).map(|at| &data[at..at + 2]);
            (&line[1..18], id, data.collect())
        })
        .collect()
}

/// The drive as Vector ASC.
fn asc(log: &str) -> String {
    let mut text =
        String::from("date Fri Nov 27 07:50:46.555 2026\nbase hex  timestamps absolute\n");
    for (at, id, data) in frames(log) {
        text += &format!("{at} 1  {id} Rx   d {} {}\n", data.len(), data.join(" "));
    }
    text
}

/// The drive as the text log of CanKing.
fn canking(log: &str) -> String {
    let mut text = String::from(
        "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n",
    );
    for (at, id, data) in frames(log) {
        text += &format!(
            " 0    {id:0>8}         {}  {}  {at} R\n",
            data.len(),
            data.join("  ")
        );
    }
    text
}

/// The drive as the text of a Memorator's log.
fn memorator(log: &str) -> String {
    let mut text = String::from(
        "Kvaser Memorator Log\nSettings:\n   Format of data field: HEX\n   Format of id field:   HEX\n",
    );
    for (at, id, data) in frames(log) {
        text += &format!(
            " {at}  1  {id}     Rx   {}  {}  7\n",
            data.len(),
            data.join(" ")
        );
    }
    text
}

/// The drive as the CSV of a Memorator's log.
fn csv(log: &str) -> String {
    let mut text = String::from(
        "CSV CAN data\nFormat of data field,HEX\nFormat of id field,HEX\nTime,Channel,id,Flags,DLC,Data0\n",
    );
    for (at, id, data) in frames(log) {
        text += &format!("{at},1,{id},2,{},{},7\n", data.len(), data.join(","));
    }
    text
}

#[test]
fn a_drive_has_the_same_figures_in_every_format() {
    let drive = drive();
    let expected = of_text(&drive);
    for (format, log) in [
        ("Vector ASC", asc(&drive)),
        ("Kvaser CanKing text", canking(&drive)),
        ("Kvaser Memorator text", memorator(&drive)),
        ("Kvaser CSV", csv(&drive)),
    ] {
        let found = of_text(log);
        assert_eq!(found.log.files[0].format, format);
        assert_eq!(found.log.start_seconds, expected.log.start_seconds);
        assert_eq!(found.messages, expected.messages, "{format}");
        assert_eq!(found.schedule, expected.schedule, "{format}");
        assert_eq!(found.modes, expected.modes, "{format}");
        assert_eq!(found.guidance, expected.guidance, "{format}");
        assert_eq!(found.steering, expected.steering, "{format}");
        assert_eq!(found.events, expected.events, "{format}");
    }
}

#[test]
fn a_vehicle_without_machine_or_schedule_is_analysed_too() {
    let workspace = Workspace::find().unwrap();
    let log = [root().join(DRIVE)];
    for (name, set) in [
        ("two-boards", ""),
        ("row-follower", ""),
        ("two-boards", "bus.protocol=event-triggered"),
    ] {
        let overrides = vehicle_model::Overrides::parse(set).unwrap();
        let vehicle = vehicle::with(&workspace, name, &overrides).unwrap();
        let found = analyse(&vehicle, &log, None).unwrap();
        assert_eq!(found.guidance, None);
        assert_eq!(found.schedule.is_none(), !set.is_empty());
        assert!(text(&found).contains("Messages of"));
    }
}

/// Runs the command, which must succeed.
fn run(words: &[&str]) {
    let program = process::Command::new(env!("CARGO_BIN_EXE_xtask"))
        .arg("analyse")
        .args(words)
        .current_dir(root())
        .output()
        .unwrap();
    assert!(program.status.success(), "{program:?}");
}

#[test]
fn the_folder_has_tables_and_figures() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let log = root().join(DRIVE);
    let words = [log.to_str().unwrap(), "--out", out.to_str().unwrap()];
    run(&words);
    let read = |name| fs::read_to_string(out.join(name)).unwrap();

    let messages = read("messages.csv");
    let mut lines = messages.lines();
    assert_eq!(lines.next(), Some("time_s,message,signal,value,unit"));
    assert!(
        messages.contains("\n1.806869,Command,Mode,3,\n"),
        "{}",
        &messages[..2000]
    );
    let columns = |line: &str| line.split(',').count();
    assert!(messages.lines().all(|line| columns(line) == 5));
    let events = read("events.csv");
    assert!(
        events.contains(",mode,\"AutonomousReady to AutonomousRun, reason ButtonC\"\n"),
        "{events}"
    );
    let json: serde_json::Value = serde_json::from_str(&read("analysis.json")).unwrap();
    assert_eq!(json["log"]["frames"], 1255);
    assert_eq!(json["schedule"]["missed_windows"], 0);
}

/// The values of an attribute of a page.
fn attributes<'p>(page: &'p str, name: &str) -> Vec<&'p str> {
    let begin = format!(" {name}=\"");
    let values = page.split(begin.as_str()).skip(1);
    values.map(|rest| rest.split('"').next().unwrap()).collect()
}

#[test]
fn the_page_stands_alone_and_can_be_read_without_seeing_it() {
    for (vehicle, charts) in [("uagv", 8), ("two-boards", 1), ("row-follower", 1)] {
        let folder = tempfile::tempdir().unwrap();
        let log = root().join(DRIVE);
        let out = folder.path().to_str().unwrap();
        let words = [log.to_str().unwrap(), "--vehicle", vehicle, "--out", out];
        run(&words);
        let page = fs::read_to_string(folder.path().join("analysis.html")).unwrap();
        for foreign in ["http", "<script", "<link", "<img", "@import", "src="] {
            assert!(!page.contains(foreign), "{vehicle}: {foreign}");
        }
        assert!(page.contains("<html lang=\"en\">"));
        assert_eq!(
            page.matches("<svg role=\"img\"").count(),
            charts,
            "{vehicle}"
        );
        let ids = attributes(&page, "id");
        let unique: BTreeSet<&str> = ids.iter().copied().collect();
        assert_eq!(unique.len(), ids.len(), "{vehicle}: {ids:?}");
        let links = attributes(&page, "href");
        let targets = links.iter().map(|link| link.strip_prefix('#').unwrap());
        let named = attributes(&page, "aria-labelledby");
        let named = named.iter().flat_map(|names| names.split(' '));
        for target in targets.chain(named) {
            assert!(unique.contains(target), "{vehicle}: {target}");
        }
        let tables = page.matches("<table").count();
        assert!(tables >= 2);
        assert_eq!(page.matches("<caption>").count(), tables);
        assert_eq!(page.matches("tabindex=\"0\"").count(), tables);
    }
}

/// A million frames; the time is measured by hand: `cargo test -p xtask --test analyse -- --ignored
/// --nocapture`.
#[test]
#[ignore = "slow: it writes a log of a million frames"]
fn a_million_frames_are_analysed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("million.log");
    let lines: Vec<(f64, String)> = drive()
        .lines()
        .map(|line| (line[1..18].parse().unwrap(), line[19..].to_owned()))
        .collect();
    let mut log = String::new();
    for turn in 0..800 {
        for (at, rest) in &lines {
            let at = at + f64::from(turn) * 10.0;
            log += &format!("({at:017.6}){rest}\n");
        }
    }
    fs::write(&path, &log).unwrap();
    let start = std::time::Instant::now();
    let found = of_file(&path).unwrap();
    println!("{} frames in {:?}", found.log.frames, start.elapsed());
    assert_eq!(found.log.frames, 800 * lines.len() as u64);
}

/// Adapters that stamp frames in milliseconds, and a clock that is corrected now and then: what is a
/// millisecond beside its window for the stamps is in it for the bus.
#[test]
fn stamps_in_milliseconds_put_no_frame_outside_its_window() {
    let log = fs::read_to_string(root().join(DRIVE)).unwrap();
    let coarse: String = log
        .lines()
        .enumerate()
        .map(|(number, line)| {
            let (stamp, rest) = line.split_once(')').unwrap();
            let seconds: f64 = stamp.trim_start_matches('(').parse().unwrap();
            let corrected = if number < 300 { 0.000_336 } else { 0.000_269 };
            let millis = (seconds * 1000.0).floor() / 1000.0 + corrected;
            format!("({millis:.6}){rest}\n")
        })
        .collect();
    let fine = of_text(&log).schedule.unwrap();
    let found = of_text(&coarse).schedule.unwrap();
    assert_eq!((fine.tolerance_us, found.tolerance_us), (0.0, 1000.0));
    assert_eq!(found.basic_cycles, fine.basic_cycles);
    assert_eq!(
        found.frames_outside_their_window,
        fine.frames_outside_their_window
    );
    assert_eq!(found.missed_windows, fine.missed_windows);
}

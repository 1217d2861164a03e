//! `flash`, `attach` and `run` with a stand-in for probe-rs, which lists the probes that a test
//! says and notes its arguments.

#![cfg(unix)]

use firmware::e2e::{RECORD, Secret};
use parts::Sled;
use serde_json::Value;
use std::{
    env, fs,
    os::unix::fs::PermissionsExt,
    process::{Command, Output},
};
use xtask::{Workspace, board::TestImage};

/// Two boards, as probe-rs 0.31 lists them.
const TWO: &str = "The following debug probes were found:\n\
    [0]: STLink V2-1 -- 0483:374b:066EFF575755846687183908 (ST-LINK)\n\
    [1]: STLink V2-1 -- 0483:374b:0670FF514853826687112233 (ST-LINK)\n";

/// A folder with the stand-in.
struct StandIn(tempfile::TempDir);

impl StandIn {
    /// Lists these probes.
    fn listing(list: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("probe-rs");
        fs::write(folder.path().join("list"), list).unwrap();
        let version = "probe-rs 0.31.0 (git commit: 3d2b8b5)\n";
        fs::write(folder.path().join("version"), version).unwrap();
        let script = "#!/bin/sh\n\
            here=$(dirname \"$0\")\n\
            case \"$1\" in\n\
            list) cat \"$here/list\"; \
            if [ -f \"$here/error\" ]; then cat \"$here/error\" >&2; exit 1; fi;;\n\
            --version) cat \"$here/version\";;\n\
            *) echo \"$@\" >> \"$here/calls\";;\n\
            esac\n\
            case \"$*\" in *--binary-format*) \
            for last; do :; done; cat \"$last\" >> \"$here/written\";; esac\n\
            if [ \"$1\" = run ] && [ -f \"$here/report\" ]; then\n\
            cat \"$here/report\"; ! grep -q FAILED \"$here/report\"; fi\n";
        fs::write(&program, script).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        Self(folder)
    }

    /// Fails to list probes, and prints this on standard error.
    fn failing(error: &str) -> Self {
        let this = Self::listing("");
        fs::write(this.0.path().join("error"), error).unwrap();
        this
    }

    /// Reports this when it runs tests, and fails if one of them did.
    fn reporting(&self, report: &str) {
        fs::write(self.0.path().join("report"), report).unwrap();
    }

    /// Runs `cargo xtask`.
    fn xtask(&self, arguments: &[&str]) -> Output {
        let path = env::var("PATH").unwrap_or_default();
        Command::new(env!("CARGO_BIN_EXE_xtask"))
            .args(arguments)
            .env("PATH", format!("{}:{path}", self.0.path().display()))
            .output()
            .unwrap()
    }

    /// The sentence with which a command is refused, and the exit code.
    fn refused(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let output = self.xtask(arguments);
        assert_eq!(self.calls(), Vec::<String>::new());
        let text = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), text.trim_end().to_owned())
    }

    /// What probe-rs was asked to do.
    fn calls(&self) -> Vec<String> {
        let calls = fs::read_to_string(self.0.path().join("calls")).unwrap_or_default();
        calls.lines().map(String::from).collect()
    }
}

#[test]
fn two_probes_without_a_choice_are_listed() {
    let two = StandIn::listing(TWO);
    for command in [&["flash"][..], &["attach"], &["run"], &["test", "--board"]] {
        let master = ["master", "--vehicle", "two-boards"];
        assert_eq!(
            two.refused(&[command, &master].concat()),
            (
                Some(2),
                "error: 2 debug probes are connected: which one has the board of master, \
                 --probe 066EFF575755846687183908 (STLink V2-1) or \
                 --probe 0670FF514853826687112233 (STLink V2-1)?"
                    .into()
            )
        );
    }
}

#[test]
fn without_probe_rs_it_is_said_how_to_install_it() {
    let empty = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["flash", "steering"])
        .env("PATH", empty.path())
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(
        (output.status.code(), text.trim_end()),
        (
            Some(1),
            "error: probe-rs is not installed: `cargo install probe-rs-tools --locked` installs it"
        )
    );
}

#[test]
fn a_probe_rs_that_fails_is_not_taken_for_a_missing_one() {
    for (error, told) in [
        (
            " WARN probe_rs: a warning\nError: Failed to list\n\nCaused by:\n    access\n",
            "error: `probe-rs list` failed: Failed to list",
        ),
        (
            "probe-rs: error while loading shared libraries: libudev.so.1\n",
            "error: `probe-rs list` failed: probe-rs: error while loading shared libraries: \
             libudev.so.1",
        ),
        ("", "error: `probe-rs list` failed: exit status: 1"),
    ] {
        let failing = StandIn::failing(error);
        for command in [
            &["flash", "steering"][..],
            &["attach", "steering"],
            &["test", "--board", "steering"],
        ] {
            assert_eq!(failing.refused(command), (Some(1), told.into()));
        }
    }
}

#[test]
fn an_old_probe_rs_is_refused_with_the_version_that_is_needed() {
    let old = StandIn::listing(TWO.lines().nth(1).unwrap());
    fs::write(old.0.path().join("version"), "probe-rs 0.29.1\n").unwrap();
    assert_eq!(
        old.refused(&["attach", "steering"]),
        (
            Some(1),
            "error: probe-rs is 0.29.1, but 0.30 or newer is needed: `cargo install \
             probe-rs-tools --locked` installs it"
                .into()
        )
    );
}

#[test]
fn a_probe_that_is_not_there_is_refused_with_those_that_are() {
    let two = StandIn::listing(TWO);
    let (code, text) = two.refused(&["run", "steering", "--probe", "0670"]);
    assert_eq!(code, Some(2));
    assert_eq!(
        text,
        "error: no connected debug probe is named 0670: \
         --probe 066EFF575755846687183908 (STLink V2-1) or \
         --probe 0670FF514853826687112233 (STLink V2-1) is accepted"
    );
    let none = StandIn::listing("No debug probes were found.\n");
    let (code, text) = none.refused(&["attach", "steering"]);
    assert_eq!(code, Some(1));
    assert!(
        text.contains("connect the board of steering by USB"),
        "{text}"
    );
    assert_eq!(
        text.contains("needs its udev rules"),
        cfg!(target_os = "linux")
    );
}

/// The image of the changed manifest is in a folder of its own; a wrong value is refused at once.
#[test]
fn a_board_gets_the_image_of_a_changed_manifest() {
    let two = StandIn::listing(TWO);
    let node = ["flash", "motor", "--vehicle", "two-boards", "--dry-run"];
    let (code, text) = two.refused(&[&node[..], &["--bus", "token-ring"]].concat());
    assert!(code == Some(2) && text.contains("token-ring"), "{text}");
    let (code, text) = two.refused(&[&node[..], &["--set", "bus.speed=3"]].concat());
    assert!(code == Some(2) && text.contains("bus.speed"), "{text}");
    let shown = two.xtask(&[&node[..], &["--bus", "event-triggered"]].concat());
    let shown = String::from_utf8(shown.stdout).unwrap();
    let image = shown.lines().next().unwrap();
    assert!(!image.ends_with("images/two-boards/motor"), "{shown}");
    assert!(image.contains("event-triggered/motor"), "{shown}");
}

/// Builds an image of the smallest vehicle.
#[test]
fn the_chosen_probe_gets_the_image_of_the_node() {
    let two = StandIn::listing(TWO);
    let serial = "0670ff514853826687112233";
    for command in ["flash", "attach", "run"] {
        let node = [
            command,
            "motor",
            "--vehicle",
            "two-boards",
            "--probe",
            serial,
        ];
        let output = two.xtask(&node);
        assert!(output.status.success(), "{output:?}");
        let shown = two.xtask(&[&node[..], &["--dry-run"]].concat());
        let shown = String::from_utf8(shown.stdout).unwrap();
        let shown: Vec<&str> = shown.lines().collect();
        let done: Vec<String> = two
            .calls()
            .iter()
            .map(|call| format!("probe-rs {call}"))
            .collect();
        assert!(done.ends_with(&shown.iter().map(ToString::to_string).collect::<Vec<_>>()));
    }
    let calls: Vec<Vec<String>> = two
        .calls()
        .iter()
        .map(|call| call.split(' ').map(String::from).collect())
        .collect();
    let verbs: Vec<&str> = calls.iter().map(|call| call[0].as_str()).collect();
    assert_eq!(verbs, ["download", "reset", "attach", "run"]);
    for call in &calls {
        let on = [
            "--chip",
            "STM32F303K8Tx",
            "--probe",
            "0483:374b:0670FF514853826687112233",
        ];
        assert_eq!(call[1..5], on);
        let image = call.last().unwrap();
        assert!(
            call[0] == "reset" || image.ends_with("images/two-boards/motor"),
            "{image}"
        );
    }
}

/// From a new key to the record in its place on a board, and back.
#[test]
fn a_key_gets_onto_a_board_and_is_shown_nowhere() {
    let one = StandIn::listing(TWO.rsplit_once("[1]").unwrap().0);
    let file = one.0.path().join("keys").join("two-boards.key");
    let file = file.to_str().unwrap();
    let keys = |arguments: &[&str], place: &[&str]| {
        one.xtask(&[&["keys"], arguments, place, &["--file", file]].concat())
    };
    let vehicle = ["--vehicle", "two-boards"];
    let missing = keys(&["flash", "motor"], &vehicle);
    assert_eq!(missing.status.code(), Some(2));
    let told = String::from_utf8(missing.stderr).unwrap();
    let options = format!("--vehicle two-boards --file {file}");
    let command = format!("`cargo xtask keys new {options}`");
    assert!(told.contains(&command), "{told}");
    let made = keys(&["new"], &vehicle);
    assert!(made.status.success(), "{made:?}");
    let told = String::from_utf8_lossy(&made.stdout);
    let command = format!("`cargo xtask keys flash NODE {options}`");
    assert!(told.contains(&command), "{told}");
    let again = keys(&["new"], &vehicle);
    assert_eq!(again.status.code(), Some(2));
    let secret = fs::read_to_string(file).unwrap();
    let secret = secret.trim_end().rsplit_once(' ').unwrap().1.to_owned();
    let number = |output: &Output| {
        let shown: Value = serde_json::from_slice(&output.stdout).unwrap();
        shown["key"].as_str().unwrap().to_owned()
    };
    let shown = keys(&["show", "--json"], &vehicle);
    let flashed = keys(&["flash", "motor"], &vehicle);
    let erased = keys(&["erase", "motor"], &vehicle);
    assert!(flashed.status.success() && erased.status.success());
    let written = fs::read(one.0.path().join("written")).unwrap();
    let words: Vec<u32> = written
        .chunks_exact(4)
        .map(|word| u32::from_le_bytes(word.try_into().unwrap()))
        .collect();
    let (record, rest) = words.split_at(RECORD);
    let Secret::Key(key) = Secret::read(record.try_into().unwrap()) else {
        panic!("a key: {record:08X?}");
    };
    assert_eq!(number(&shown), format!("{:08X}", key.number()));
    assert_eq!(Secret::read(rest.try_into().unwrap()), Secret::None);
    let rotated = keys(&["rotate"], &vehicle);
    assert!(rotated.status.success());
    assert_ne!(number(&keys(&["show", "--json"], &vehicle)), number(&shown));
    assert!(!fs::read_to_string(file).unwrap().contains(&secret));
    for output in [made, shown, flashed, erased, rotated] {
        let text = [output.stdout, output.stderr].concat();
        assert!(!String::from_utf8(text).unwrap().contains(&secret));
    }
    let calls = one.calls();
    let verbs: Vec<&str> = calls
        .iter()
        .filter_map(|call| call.split(' ').next())
        .collect();
    assert_eq!(verbs, ["download", "reset", "download", "reset"]);
    // The record is gone when the command is.
    let record = calls[0].rsplit(' ').next().unwrap();
    assert!(!fs::exists(record).unwrap(), "{record}");
}

#[test]
fn a_file_of_a_key_is_refused_in_one_sentence() {
    let one = StandIn::listing("");
    let folder = one.0.path();
    fs::write(folder.join("text.key"), "password").unwrap();
    let private = fs::Permissions::from_mode(0o600);
    fs::set_permissions(folder.join("text.key"), private).unwrap();
    let refused = |arguments: &[&str]| {
        let (code, told) = one.refused(&[&["keys"], arguments].concat());
        assert_eq!((code, told.lines().count()), (Some(2), 1), "{told}");
        told
    };
    let text = folder.join("text.key");
    let text = text.to_str().unwrap();
    assert!(refused(&["show", "--file", text]).contains("is no key"));
    assert!(refused(&["rotate", "--file", text]).contains("is no key"));
    assert_eq!(fs::read_to_string(text).unwrap(), "password");
    let folder = folder.to_str().unwrap();
    refused(&["show", "--file", folder]);
    refused(&["new", "--file", folder]);
    refused(&[
        "new",
        "--file",
        concat!(env!("CARGO_MANIFEST_DIR"), "/a.key"),
    ]);
    refused(&["new", "--file", "/dev/full"]);
    refused(&["new", "--vehicle", "tank"]);
    refused(&["flash", "cannon", "--file", text]);
    refused(&["flash", "drive", "--file", text]);
    let sentry = ["flash", "sentry", "--vehicle", "sentry", "--file", text];
    assert!(refused(&sentry).contains("the bus guardian, which uses no key"));
}

const MOTOR: [&str; 6] = [
    "test",
    "--board",
    "motor",
    "--vehicle",
    "two-boards",
    "--json",
];

/// The outcomes that `test --board --json` prints, and the exit code.
fn outcomes(output: &Output) -> (Value, Option<i32>) {
    let report = serde_json::from_slice(&output.stdout);
    (
        report.unwrap_or_else(|_| panic!("{output:?}")),
        output.status.code(),
    )
}

fn passed(report: &Value) -> Vec<bool> {
    let tests = report["tests"].as_array().unwrap();
    tests
        .iter()
        .map(|test| test["passed"].as_bool().unwrap())
        .collect()
}

/// Builds the tests of a board.
#[test]
fn a_boards_tests_run_on_it_where_a_probe_is() {
    let workspace = Workspace::find().unwrap();
    let image = TestImage::build(&workspace, Sled::F303).unwrap();
    let line = |outcome: &str, (subject, name): (&str, &str)| {
        format!("test board_tests::{subject}::tests::{name} ... {outcome}\n")
    };
    let tests = image.tests.iter().map(|test| (&*test.subject, &*test.name));
    let two = StandIn::listing(TWO);
    let command = [&MOTOR[..], &["--probe", "0670FF514853826687112233"]].concat();

    let report: String = tests.clone().map(|test| line("ok", test)).collect();
    two.reporting(&report);
    let (report, code) = outcomes(&two.xtask(&command));
    assert_eq!((report["on"].as_str(), code), (Some("board"), Some(0)));
    assert_eq!(passed(&report), vec![true; image.tests.len()]);
    let [call] = &two.calls()[..] else {
        panic!("one call");
    };
    let probe = "0483:374b:0670FF514853826687112233";
    let expected = format!("run --chip STM32F303K8Tx --probe {probe} --verify ");
    assert!(call.starts_with(&expected), "{call}");
    assert!(call.ends_with("images/board-tests/f303"), "{call}");

    // The first one fails, and the last one does not run at all.
    let some = tests.clone().take(image.tests.len() - 1).enumerate();
    let of = |number| if number == 0 { "FAILED" } else { "ok" };
    let report: String = some.map(|(number, test)| line(of(number), test)).collect();
    two.reporting(&report);
    let (report, code) = outcomes(&two.xtask(&command));
    let mut expected = vec![true; image.tests.len()];
    expected[0] = false;
    expected[image.tests.len() - 1] = false;
    assert_eq!((passed(&report), code), (expected, Some(1)));

    two.reporting("error: the probe does not answer\n");
    let output = two.xtask(&command);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(text.contains("error: probe-rs has run no test"), "{text}");
}

/// Runs all tests of a board.
#[test]
fn without_a_probe_a_boards_tests_run_on_the_twin() {
    let none = StandIn::listing("No debug probes were found.\n");
    let output = none.xtask(&MOTOR);
    let (report, code) = outcomes(&output);
    assert_eq!((report["on"].as_str(), code), (Some("twin"), Some(0)));
    assert!(passed(&report).into_iter().all(|passed| passed));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("run on the virtual STM32F303K8"), "{said}");
    // A probe that is asked for must be there.
    let (code, text) = none.refused(&[
        "test",
        "--board",
        "motor",
        "--vehicle",
        "two-boards",
        "--probe",
        "7",
    ]);
    assert_eq!(code, Some(1));
    assert!(text.contains("no debug probe is found"), "{text}");
}

#[test]
fn wrong_options_of_a_boards_tests_are_refused() {
    let none = StandIn::listing("No debug probes were found.\n");
    for (arguments, part) in [
        (
            &["test", "--board", "rudder"][..],
            "there is no node rudder: there are",
        ),
        (&["test", "--twin"], "--board <NODE>"),
        (&["test", "--board", "gps", "--list"], "cannot be used with"),
    ] {
        let (code, text) = none.refused(arguments);
        assert_eq!(code, Some(2), "{text}");
        assert!(text.contains(part), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
    }
}

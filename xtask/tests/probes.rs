//! `flash`, `attach` and `run` with a stand-in for probe-rs, which lists the probes that a test
//! says and notes its arguments.

#![cfg(unix)]

use std::{
    env, fs,
    os::unix::fs::PermissionsExt,
    process::{Command, Output},
};

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
        let script = "#!/bin/sh\n\
            here=$(dirname \"$0\")\n\
            if [ \"$1\" = list ]; then cat \"$here/list\"; else echo \"$@\" >> \"$here/calls\"; fi\n";
        fs::write(&program, script).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        Self(folder)
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
    for command in ["flash", "attach", "run"] {
        assert_eq!(
            two.refused(&[command, "master", "--vehicle", "two-boards"]),
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

//! `flash`, `attach` and `run`: write a node's image to a board, and show the node's log, by
//! probe-rs.

mod list;

use std::{
    io,
    path::Path,
    process::{Command, Output},
};

use parts::Sled;

use crate::{
    Failure, Workspace, build,
    cli::OnBoard,
    vehicle,
    workspace::{output, succeed, typed},
};

use list::Probe;

/// The oldest release of probe-rs, major and minor number, that has all options of the commands.
const OLDEST: (u32, u32) = (0, 30);

/// Where probe-rs needs rights to USB devices, the advice to install them.
const UDEV_RULES: &str = if cfg!(target_os = "linux") {
    "; on Linux probe-rs also needs its udev rules, https://probe.rs/docs/getting-started/probe-setup/"
} else {
    ""
};

/// Why a board cannot be reached.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// probe-rs is not there.
    #[error("probe-rs is not installed: `cargo install probe-rs-tools --locked` installs it")]
    NotInstalled,
    /// probe-rs cannot list the probes.
    #[error("`probe-rs list` failed: {0}")]
    List(String),
    /// probe-rs lacks options that the commands use.
    #[error(
        "probe-rs is {found}, but {}.{} or newer is needed: `cargo install probe-rs-tools --locked` \
         installs it",
        OLDEST.0,
        OLDEST.1
    )]
    TooOld {
        /// The version that is there.
        found: String,
    },
    /// No debug probe is there.
    #[error("no debug probe is found: connect the board of {node} by USB{UDEV_RULES}")]
    NoProbe {
        /// The node on the board.
        node: String,
    },
    /// Several probes are there and none is named.
    #[error("{count} debug probes are connected: which one has the board of {node}, {choices}?")]
    WhichProbe {
        /// How many there are.
        count: usize,
        /// The node on the board.
        node: String,
        /// The options that name each of them.
        choices: String,
    },
    /// The named probe is not there.
    #[error("no connected debug probe is named {probe}: {choices} is accepted")]
    UnknownProbe {
        /// The name.
        probe: String,
        /// The options that name those that are there.
        choices: String,
    },
}

impl Error {
    /// Whether the command line is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(self, Self::WhichProbe { .. } | Self::UnknownProbe { .. })
    }
}

/// What is done with a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Write the image, verify and start it.
    Flash,
    /// Show the log of the running node.
    Attach,
    /// Write the image, verify and start it, and show the log.
    Run,
}

/// Runs one of the commands.
///
/// # Errors
///
/// There is no such node, or more than one; there is no such probe, or more than one and none
/// is named (exit code 2). The image does not build, probe-rs is not installed or too old, no
/// probe is connected, or probe-rs fails.
pub fn run(workspace: &Workspace, action: Action, options: &OnBoard) -> Result<(), Failure> {
    let (vehicle, node) = vehicle::with_node(
        workspace,
        &options.node,
        options.vehicle.as_deref(),
        &options.changes.overrides(),
    )?;
    // A missing probe is reported before a build that takes time.
    let probe = probe(workspace, options)?;
    for image in build::images(workspace, &vehicle, &[node])? {
        let probe = probe.as_deref();
        for mut command in commands(workspace, action, image.board, probe, &image.path) {
            if options.dry_run {
                println!("{}", typed(&command));
            } else {
                succeed(&mut command, "probe-rs")?;
            }
        }
    }
    Ok(())
}

/// What probe-rs takes for the probe; `None` if there is only one. A dry run needs no probe: it
/// takes the name as it is when no connected probe has it.
fn probe(workspace: &Workspace, options: &OnBoard) -> Result<Option<String>, Error> {
    match find(workspace, &options.node, options.probe.as_deref()) {
        Err(_) if options.dry_run => Ok(options.probe.clone()),
        result => result,
    }
}

/// The debug probe of a node's board: what probe-rs takes for it, `None` if there is only one.
///
/// # Errors
///
/// probe-rs is not installed, fails or is too old, no probe is connected; several are and none is
/// named, or there is none of that name (exit code 2).
pub(crate) fn find(
    workspace: &Workspace,
    node: &str,
    wanted: Option<&str>,
) -> Result<Option<String>, Error> {
    let list = workspace.program("probe-rs").arg("list").output();
    let probe = choose(&listed(list)?, node, wanted)?;
    let version = output(workspace.program("probe-rs").arg("--version"));
    match version.as_deref().and_then(too_old) {
        Some(found) => Err(Error::TooOld { found }),
        None => Ok(probe),
    }
}

/// What `probe-rs list` lists.
fn listed(list: io::Result<Output>) -> Result<String, Error> {
    let list = list.map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Error::NotInstalled,
        _ => Error::List(error.to_string()),
    })?;
    if list.status.success() {
        return Ok(String::from_utf8_lossy(&list.stdout).into_owned());
    }
    let told = String::from_utf8_lossy(&list.stderr);
    let why = complaint(&told).map_or_else(|| list.status.to_string(), String::from);
    Err(Error::List(why))
}

/// The first line that tells of an error, or the first one of all. Warnings may stand before it.
fn complaint(told: &str) -> Option<&str> {
    const ERROR: &str = "error: ";
    let mut lines = told.lines().map(str::trim).filter(|line| !line.is_empty());
    let error = |line: &str| {
        let begin = line.get(..ERROR.len())?;
        begin.eq_ignore_ascii_case(ERROR).then(|| ERROR.len())
    };
    let first = lines.clone().next()?;
    let said = lines.find_map(|line| line.get(error(line)?..));
    Some(said.unwrap_or(first))
}

/// The version that `probe-rs --version` prints, such as `probe-rs 0.31.0 (git commit: 3d2b8b5)`,
/// if it is too old. `None` for a text that names no version.
fn too_old(text: &str) -> Option<String> {
    let version = text.strip_prefix("probe-rs ")?.split_whitespace().next()?;
    let mut numbers = version.split('.').map(str::parse::<u32>);
    let (major, minor) = (numbers.next()?.ok()?, numbers.next()?.ok()?);
    ((major, minor) < OLDEST).then(|| version.to_owned())
}

/// The probe that is meant.
fn choose(list: &str, node: &str, wanted: Option<&str>) -> Result<Option<String>, Error> {
    let probes = list::read(list);
    let meant: Vec<&Probe> = match wanted {
        Some(wanted) => probes.iter().filter(|probe| probe.is(wanted)).collect(),
        None => probes.iter().collect(),
    };
    let choices = |probes: &[&Probe]| {
        let choices: Vec<String> = probes.iter().map(ToString::to_string).collect();
        choices.join(" or ")
    };
    match (meant.as_slice(), wanted) {
        _ if probes.is_empty() => Err(Error::NoProbe { node: node.into() }),
        ([_], None) => Ok(None),
        ([probe], Some(_)) => Ok(Some(probe.selector.clone())),
        ([], _) => Err(Error::UnknownProbe {
            probe: wanted.unwrap_or_default().into(),
            choices: choices(&probes.iter().collect::<Vec<_>>()),
        }),
        (several, _) => Err(Error::WhichProbe {
            count: several.len(),
            node: node.into(),
            choices: choices(several),
        }),
    }
}

/// Lets faults and resets take their course: since release 0.28 probe-rs by itself halts the
/// processor there, and the node could not stop its actuator.
const NO_CATCH: [&str; 2] = ["--no-catch-reset", "--no-catch-hardfault"];

/// A command of probe-rs for a board.
pub(crate) fn command(
    workspace: &Workspace,
    name: &str,
    board: &Sled,
    probe: Option<&str>,
    options: &[&str],
) -> Command {
    let mut command = workspace.program("probe-rs");
    command.args([name, "--chip", board.part.chip]);
    command.args(probe.iter().flat_map(|probe| ["--probe", probe]));
    command.args(options);
    command
}

/// The commands of an action, with the image that is on the board or is written to it.
fn commands(
    workspace: &Workspace,
    action: Action,
    board: &Sled,
    probe: Option<&str>,
    image: &Path,
) -> Vec<Command> {
    let command = |name: &str, options: &[&str]| command(workspace, name, board, probe, options);
    let with_image = |mut command: Command| {
        command.arg(image);
        command
    };
    match action {
        Action::Flash => vec![
            with_image(command("download", &["--verify"])),
            command("reset", &[]),
        ],
        Action::Attach => vec![with_image(command("attach", &NO_CATCH))],
        Action::Run => {
            let mut run = command("run", &["--verify"]);
            run.args(NO_CATCH);
            vec![with_image(run)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "[0]: STLink V2-1 -- 0483:374b:066EFF57 (ST-LINK)\n";
    const TWO: &str = "The following debug probes were found:\n\
        [0]: STLink V2-1 -- 0483:374b:066EFF57 (ST-LINK)\n\
        [1]: STLink V2-1 -- 0483:374b:0670FF51 (ST-LINK)\n";

    fn typed_commands(action: Action, board: &Sled, probe: Option<&str>) -> Vec<String> {
        let workspace = Workspace::find().unwrap();
        let commands = commands(&workspace, action, board, probe, Path::new("t/node"));
        commands.iter().map(typed).collect()
    }

    #[test]
    fn each_image_goes_onto_its_part() {
        assert_eq!(
            typed_commands(Action::Flash, Sled::F446, None),
            [
                "probe-rs download --chip STM32F446RETx --verify t/node",
                "probe-rs reset --chip STM32F446RETx"
            ]
        );
        let [download, _] = &typed_commands(Action::Flash, Sled::F303, None)[..] else {
            panic!("two commands");
        };
        assert!(download.contains("--chip STM32F303K8Tx"));
    }

    #[test]
    fn the_log_is_shown_by_the_chosen_probe() {
        let probe = Some("0483:374b:066EFF57");
        assert_eq!(
            typed_commands(Action::Attach, Sled::F303, probe),
            [
                "probe-rs attach --chip STM32F303K8Tx --probe 0483:374b:066EFF57 \
                 --no-catch-reset --no-catch-hardfault t/node"
            ]
        );
        assert_eq!(
            typed_commands(Action::Run, Sled::F446, probe),
            [
                "probe-rs run --chip STM32F446RETx --probe 0483:374b:066EFF57 --verify \
                 --no-catch-reset --no-catch-hardfault t/node"
            ]
        );
    }

    #[test]
    fn one_probe_needs_no_name_and_two_do() {
        assert_eq!(choose(ONE, "gps", None), Ok(None));
        let second = choose(TWO, "gps", Some("0670ff51"));
        assert_eq!(second, Ok(Some("0483:374b:0670FF51".into())));
        let refused = |list, wanted| {
            let failure = Failure::from(choose(list, "gps", wanted).unwrap_err());
            (failure.exit_code(), failure.to_string())
        };
        assert_eq!(
            refused(TWO, None),
            (
                2,
                "2 debug probes are connected: which one has the board of gps, \
                 --probe 066EFF57 (STLink V2-1) or --probe 0670FF51 (STLink V2-1)?"
                    .into()
            )
        );
        assert_eq!(
            refused(ONE, Some("42")),
            (
                2,
                "no connected debug probe is named 42: --probe 066EFF57 (STLink V2-1) is accepted"
                    .into()
            )
        );
        let (code, text) = refused("No debug probes were found.\n", Some("42"));
        assert_eq!(code, 1);
        assert!(text.starts_with("no debug probe is found"), "{text}");
    }

    #[test]
    fn an_old_release_is_told_by_its_version() {
        for (text, old) in [
            ("probe-rs 0.29.1 (git commit: 3d2b8b5)\n", Some("0.29.1")),
            ("probe-rs 0.9", Some("0.9")),
            ("probe-rs 0.30.0 (git commit: 3d2b8b5)\n", None),
            ("probe-rs 0.31.0-alpha.1", None),
            ("probe-rs 1.0.0", None),
            ("probe-rs nightly", None),
            ("probe-rs", None),
            ("", None),
        ] {
            assert_eq!(too_old(text).as_deref(), old, "{text}");
        }
    }

    #[test]
    fn the_line_that_tells_of_the_error_is_found() {
        for (told, line) in [
            (
                " WARN a\nError: no access\n\nCaused by:\n  b\n",
                Some("no access"),
            ),
            (
                "\nprobe-rs: no libudev.so.1\n",
                Some("probe-rs: no libudev.so.1"),
            ),
            ("ERROR: é", Some("é")),
            ("\n", None),
        ] {
            assert_eq!(complaint(told), line);
        }
    }
}

//! `flash`: writes a node's image to a board.

use std::{path::Path, process::Command};

use parts::Sled;

use crate::{
    Failure, Workspace, build,
    cli::Flash,
    vehicle,
    workspace::{output, succeed, typed},
};

/// Why a board cannot be flashed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// probe-rs is not there.
    #[error("probe-rs is not installed: `cargo install probe-rs-tools --locked` installs it")]
    NotInstalled,
    /// No debug probe is there.
    #[error("no debug probe is connected: connect the board of {node} by USB")]
    NoProbe {
        /// The node whose board it would flash.
        node: String,
    },
}

/// Runs the command.
///
/// # Errors
///
/// There is no such node, or more than one (exit code 2). The image does not build, probe-rs is
/// not installed, no probe is connected, or probe-rs fails.
pub fn run(workspace: &Workspace, options: &Flash) -> Result<(), Failure> {
    let (vehicle, node) = vehicle::with_node(workspace, &options.node, options.vehicle.as_deref())?;
    if !options.dry_run {
        ready(workspace, &options.node)?;
    }
    for image in build::images(workspace, &vehicle, &[node])? {
        for mut command in commands(workspace, image.board, &image.path) {
            if options.dry_run {
                println!("{}", typed(&command));
            } else {
                succeed(&mut command, "probe-rs")?;
            }
        }
    }
    Ok(())
}

/// The commands that write, verify and start an image.
fn commands(workspace: &Workspace, board: &Sled, image: &Path) -> [Command; 2] {
    let probe = |command: &str| {
        let mut probe = workspace.program("probe-rs");
        probe.args([command, "--chip", board.part.chip]);
        probe
    };
    let mut download = probe("download");
    download.arg("--verify").arg(image);
    [download, probe("reset")]
}

/// Checks that probe-rs is installed and a probe is connected, before a build that takes time.
fn ready(workspace: &Workspace, node: &str) -> Result<(), Error> {
    match output(workspace.program("probe-rs").arg("list")) {
        None => Err(Error::NotInstalled),
        Some(list) if !has_probe(&list) => Err(Error::NoProbe { node: node.into() }),
        Some(_) => Ok(()),
    }
}

/// Whether `probe-rs list` lists a probe: a line such as `[0]: STLink V2-1 (..)`.
fn has_probe(list: &str) -> bool {
    list.lines()
        .any(|line| line.trim_start().starts_with("[0]"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_image_goes_onto_its_part() {
        let workspace = Workspace::find().unwrap();
        let [download, reset] = commands(&workspace, Sled::F446, Path::new("t/gps"));
        assert_eq!(
            typed(&download),
            "probe-rs download --chip STM32F446RETx --verify t/gps"
        );
        assert_eq!(typed(&reset), "probe-rs reset --chip STM32F446RETx");
        let [download, _] = commands(&workspace, Sled::F303, Path::new("t/drive"));
        assert!(typed(&download).contains("--chip STM32F303K8Tx"));
    }

    #[test]
    fn an_empty_list_of_probes_is_recognised() {
        assert!(!has_probe("No debug probes were found.\n"));
        let list = "The following debug probes were found:\n[0]: STLink V2-1 (ST-LINK)\n";
        assert!(has_probe(list));
    }
}

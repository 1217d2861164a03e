//! The oldest compiler that `ttcan` promises: whoever uses the crate alone may not have this
//! workspace's.

use std::process::Command;

use crate::{Workspace, target};

/// What `rust-version` in the crate's manifest says.
const OLDEST: &str = "1.88";

/// Checks of the crate with this compiler, which rustup fetches: everything on a PC, and on a board
/// without what needs an operating system.
pub(super) fn checks(workspace: &Workspace) -> Vec<Command> {
    let add = {
        let mut rustup = workspace.program("rustup");
        rustup.args(["toolchain", "install", OLDEST, "--profile", "minimal"]);
        rustup.args(["--target", target::TRIPLE]);
        rustup
    };
    let check = |rest: &[&str]| {
        let mut rustup = workspace.program("rustup");
        rustup.args(["run", OLDEST, "cargo", "check", "--package", "ttcan"]);
        rustup.args(rest);
        rustup
    };
    vec![
        add,
        check(&["--all-features", "--examples"]),
        check(&[
            "--features",
            "masks,embedded-can",
            "--target",
            target::TRIPLE,
        ]),
        check(&["--no-default-features", "--target", target::TRIPLE]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Clippy holds the library's calls against the manifest's version; the language is not its matter.
    #[test]
    fn the_manifest_promises_the_compiler_that_the_step_tries() {
        let workspace = Workspace::find().expect("the workspace");
        let manifest = workspace.root().join("ttcan/Cargo.toml");
        let manifest = std::fs::read_to_string(manifest).expect("the manifest");
        let manifest: toml::Table = manifest.parse().expect("TOML");
        let promised = manifest["package"]["rust-version"].as_str();
        assert_eq!(promised, Some(OLDEST));
    }
}

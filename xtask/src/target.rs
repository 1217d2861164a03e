//! The compilation target of the images: found or, if missing, installed by rustup.

use std::{env, fs, path::Path, process::Command};

use crate::{Workspace, workspace::output};

/// The target of both boards: Cortex-M4 with its floating point unit.
pub const TRIPLE: &str = "thumbv7em-none-eabihf";

/// The target of cores without `BASEPRI`, for which tests of the analysis build little applications.
pub const SMALL: &str = "thumbv6m-none-eabi";

/// The target is not installed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Missing {
    /// There is no rustup that could install it.
    #[error(
        "the target {0} is missing and there is no rustup: install it with `rustup target add {0}` where the network allows it"
    )]
    NoRustup(&'static str),
    /// Rustup cannot install it.
    #[error(
        "the target {0} is missing and rustup cannot fetch it: install it with `rustup target add {0}` where the network allows it"
    )]
    NotFetched(&'static str),
}

/// A cargo command (`build`, `clippy`, `doc`) for the target.
pub fn cargo(workspace: &Workspace, command: &str) -> Command {
    workspace.forget_moved();
    let mut cargo = workspace.cargo();
    cargo.arg(command).args(["--target", TRIPLE]);
    cargo
}

/// Finds the target; rustup installs it when it is missing.
///
/// # Errors
///
/// It is missing and rustup does not install it.
pub fn ensure(workspace: &Workspace) -> Result<(), Missing> {
    ensure_one(workspace, TRIPLE)
}

/// The same for [`SMALL`].
///
/// # Errors
///
/// As [`ensure`].
pub fn ensure_small(workspace: &Workspace) -> Result<(), Missing> {
    ensure_one(workspace, SMALL)
}

fn ensure_one(workspace: &Workspace, triple: &'static str) -> Result<(), Missing> {
    if has_core(workspace, triple) {
        return Ok(());
    }
    eprintln!("The target {triple} is not installed.");
    if output(workspace.program("rustup").arg("--version")).is_none() {
        return Err(Missing::NoRustup(triple));
    }
    eprintln!("Installing it: rustup target add {triple}");
    let added = workspace
        .program("rustup")
        .args(["target", "add", triple])
        .status();
    if added.is_ok_and(|status| status.success()) && has_core(workspace, triple) {
        Ok(())
    } else {
        Err(Missing::NotFetched(triple))
    }
}

/// Whether the toolchain has the core library of the target.
fn has_core(workspace: &Workspace, triple: &str) -> bool {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let printed =
        output(
            workspace
                .program(rustc)
                .args(["--print", "target-libdir", "--target", triple]),
        );
    printed.is_some_and(|folder| holds_core(Path::new(folder.trim())))
}

fn holds_core(folder: &Path) -> bool {
    let Ok(entries) = fs::read_dir(folder) else {
        return false;
    };
    entries.flatten().any(|entry| {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        name.starts_with("libcore-") && name.ends_with(".rlib")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_core_library_is_recognised() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!holds_core(folder.path()));
        assert!(!holds_core(&folder.path().join("absent")));
        fs::write(folder.path().join("libcore-1f2e.rmeta"), "").unwrap();
        assert!(!holds_core(folder.path()));
        fs::write(folder.path().join("libcore-1f2e.rlib"), "").unwrap();
        assert!(holds_core(folder.path()));
    }

    #[test]
    fn the_sentence_says_what_to_do() {
        for missing in [Missing::NoRustup(SMALL), Missing::NotFetched(TRIPLE)] {
            let sentence = missing.to_string();
            assert!(sentence.contains("rustup target add"), "{sentence}");
            assert!(!sentence.contains('\n'));
        }
    }
}

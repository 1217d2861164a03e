//! The compilation target of the images, found or installed.
//!
//! In this order: it is there; rustup installs it; Debian's packages hold the
//! core library's source for Debian's compiler, which builds it with the image.

use std::{env, ffi::OsString, fs, path::Path, process::Command};

use crate::{Failure, Workspace, debian, workspace::output};

/// The target of both boards: Cortex-M4 with its floating point unit.
pub const TRIPLE: &str = "thumbv7em-none-eabihf";

/// How cargo builds for the target on this machine.
///
/// The default is a toolchain that has the target installed.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Target {
    environment: Vec<(OsString, OsString)>,
    arguments: Vec<OsString>,
}

impl Target {
    /// A cargo command (`build`, `clippy`, `doc`) for the target.
    pub fn cargo(&self, workspace: &Workspace, command: &str) -> Command {
        let mut cargo = workspace.cargo();
        cargo.arg(command).args(["--target", TRIPLE]);
        cargo.args(&self.arguments);
        cargo.envs(self.environment.iter().map(|(name, value)| (name, value)));
        cargo
    }

    /// Whether clippy and rustdoc work for the target: they belong to the pinned
    /// toolchain and read no other compiler's libraries.
    pub fn has_tools(&self) -> bool {
        self.arguments.is_empty()
    }
}

/// Finds the target, installing it if need be.
///
/// # Errors
///
/// It is not there and nothing on this machine can install it.
pub fn ensure(workspace: &Workspace) -> Result<Target, Failure> {
    if has_core(workspace) {
        return Ok(Target::default());
    }
    eprintln!("The target {TRIPLE} is not installed.");
    if output(workspace.program("rustup").arg("--version")).is_some() {
        eprintln!("Installing it: rustup target add {TRIPLE}");
        let added = workspace
            .program("rustup")
            .args(["target", "add", TRIPLE])
            .status();
        if added.is_ok_and(|status| status.success()) && has_core(workspace) {
            return Ok(Target::default());
        }
    }
    if !debian::is_here() {
        return Err(missing("rustup cannot fetch it"));
    }
    let environment = debian::environment(workspace).map_err(|why| {
        missing(&format!(
            "rustup cannot fetch it, nor can Debian's compiler: {why}"
        ))
    })?;
    Ok(Target {
        environment,
        arguments: debian::arguments(),
    })
}

fn missing(why: &str) -> Failure {
    Failure::Failed(format!(
        "the target {TRIPLE} is missing and {why}: install it with `rustup target add {TRIPLE}` where the network allows it"
    ))
}

/// Whether the toolchain has the core library of the target.
fn has_core(workspace: &Workspace) -> bool {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let printed =
        output(
            workspace
                .program(rustc)
                .args(["--print", "target-libdir", "--target", TRIPLE]),
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
    fn the_recipe_of_debian_builds_the_core_library() {
        let workspace = Workspace::find().unwrap();
        let target = Target {
            environment: vec![("RUSTC".into(), "/usr/bin/rustc".into())],
            arguments: debian::arguments(),
        };
        let cargo = target.cargo(&workspace, "build");
        let arguments: Vec<_> = cargo.get_args().collect();
        assert_eq!(arguments[..3], ["build", "--target", TRIPLE]);
        assert!(arguments.contains(&"-Zbuild-std=core".as_ref()));
        assert_eq!(cargo.get_envs().count(), 1);
        assert!(!target.has_tools());
    }

    #[test]
    fn the_sentence_says_what_to_do() {
        let sentence = missing("nobody has it").to_string();
        assert!(sentence.contains("rustup target add"), "{sentence}");
        assert!(!sentence.contains('\n'));
    }
}

//! The compilation target of the images, found or installed.
//!
//! In this order: it is there; rustup installs it; Debian's packages hold the
//! core library's source for Debian's compiler, which builds it with the image.

use std::{
    env,
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    Failure, Workspace,
    workspace::{output, succeed},
};

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

    /// Debian's compiler, which builds the core library from Debian's source, and
    /// rustup's linker. The compiler is older than the workspace asks for; that
    /// the images build with it nevertheless is what `--ignore-rust-version` says.
    fn debian(linker: &Path) -> Self {
        let set = |name: &str, value: &str| (OsString::from(name), OsString::from(value));
        Self {
            environment: vec![
                set("RUSTC", DEBIAN_COMPILER),
                set("RUSTC_BOOTSTRAP", "1"),
                (
                    "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER".into(),
                    linker.into(),
                ),
            ],
            arguments: vec!["-Zbuild-std=core".into(), "--ignore-rust-version".into()],
        }
    }
}

const DEBIAN_COMPILER: &str = "/usr/bin/rustc";
const DEBIAN_SOURCE: &str = "/usr/lib/rustlib/src/rust/library/core/Cargo.toml";
const DEBIAN_PACKAGES: [&str; 2] = ["rustc-web", "rust-web-src"];

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
    if Path::new("/etc/debian_version").exists() {
        return debian(workspace);
    }
    Err(missing("rustup cannot be run or cannot fetch it"))
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

fn debian(workspace: &Workspace) -> Result<Target, Failure> {
    let there = || Path::new(DEBIAN_COMPILER).exists() && Path::new(DEBIAN_SOURCE).exists();
    if !there() {
        let mut install = installer(workspace);
        install.args(["install", "--yes", "--no-install-recommends"]);
        install.args(DEBIAN_PACKAGES);
        eprintln!(
            "Installing Debian's packages {}.",
            DEBIAN_PACKAGES.join(" and ")
        );
        let installed = succeed(&mut install, "installing them");
        if installed.is_err() || !there() {
            return Err(missing(&format!(
                "neither rustup nor `apt-get install {}` could provide it",
                DEBIAN_PACKAGES.join(" ")
            )));
        }
    }
    let linker =
        linker(workspace).ok_or_else(|| missing("the toolchain has no rust-lld to link with"))?;
    Ok(Target::debian(&linker))
}

/// apt-get, by sudo unless we are root; sudo must not ask for a password.
fn installer(workspace: &Workspace) -> Command {
    let root = output(Command::new("id").arg("-u")).is_some_and(|id| id.trim() == "0");
    if root {
        workspace.program("apt-get")
    } else {
        let mut sudo = workspace.program("sudo");
        sudo.args(["--non-interactive", "apt-get"]);
        sudo
    }
}

/// The linker in the toolchain's own folder.
fn linker(workspace: &Workspace) -> Option<PathBuf> {
    let root = output(workspace.program("rustc").args(["--print", "sysroot"]))?;
    let version = output(workspace.program("rustc").arg("-vV"))?;
    let host = version
        .lines()
        .find_map(|line| line.strip_prefix("host: "))?;
    let linker = Path::new(root.trim())
        .join("lib/rustlib")
        .join(host)
        .join("bin/rust-lld");
    linker.is_file().then_some(linker)
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
        let cargo = Target::debian(Path::new("/lld")).cargo(&workspace, "build");
        let arguments: Vec<_> = cargo.get_args().collect();
        assert_eq!(
            arguments,
            [
                "build",
                "--target",
                TRIPLE,
                "-Zbuild-std=core",
                "--ignore-rust-version"
            ]
        );
        let linker = OsString::from("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER");
        let value = cargo.get_envs().find(|(name, _)| *name == linker);
        assert_eq!(value.and_then(|(_, value)| value), Some("/lld".as_ref()));
    }

    #[test]
    fn the_sentence_says_what_to_do() {
        let sentence = missing("nobody has it").to_string();
        assert!(sentence.contains("rustup target add"), "{sentence}");
        assert!(!sentence.contains('\n'));
    }
}

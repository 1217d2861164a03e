//! Debian's compiler with Debian's source of the core library, for machines to
//! which rustup brings no target.
//!
//! That compiler (1.85 in Debian 12) is older than the workspace's. What the
//! workspace and its dependencies use of later versions it knows as unstable
//! features; as cargo's compiler wrapper this program turns them on, see [`wrap`].

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use crate::{
    Failure, Workspace,
    workspace::{output, succeed},
};

const COMPILER: &str = "/usr/bin/rustc";
const SOURCE: &str = "/usr/lib/rustlib/src/rust/library/core/Cargo.toml";
const PACKAGES: [&str; 2] = ["rustc-web", "rust-web-src"];

/// Set in the environment of a cargo for which this program is the wrapper.
const WRAPPER: &str = "FURROW_COMPILER_WRAPPER";

/// Stable since 1.88, 1.87, 1.88 and 1.87; the compiler ignores those it knows as
/// stable.
const FEATURES: [&str; 4] = [
    "let_chains",
    "integer_sign_cast",
    "slice_as_chunks",
    "unsigned_is_multiple_of",
];

/// Crates of the standard library name their features themselves.
const STANDARD: [&str; 3] = ["core", "alloc", "compiler_builtins"];

/// Whether this is Debian or a descendant.
pub fn is_here() -> bool {
    Path::new("/etc/debian_version").exists()
}

/// Arguments that make cargo build the core library with the image.
pub fn arguments() -> Vec<OsString> {
    vec!["-Zbuild-std=core".into(), "--ignore-rust-version".into()]
}

/// Environment of such a cargo.
///
/// # Errors
///
/// The packages are neither there nor can be installed, or there is no linker.
pub fn environment(workspace: &Workspace) -> Result<Vec<(OsString, OsString)>, Failure> {
    let there = || Path::new(COMPILER).exists() && Path::new(SOURCE).exists();
    let packages = PACKAGES.join(" ");
    if !there() {
        eprintln!("Installing Debian's packages: apt-get install {packages}");
        let mut install = installer(workspace);
        install.args(["install", "--yes", "--no-install-recommends"]);
        install.args(PACKAGES);
        succeed(&mut install, "`apt-get install`")?;
        if !there() {
            return Err(Failure::Failed(format!("{packages} hold no {SOURCE}")));
        }
    }
    let linker = linker(workspace)
        .ok_or_else(|| Failure::Failed("the toolchain has no rust-lld to link with".into()))?;
    let wrapper = env::current_exe()
        .map_err(|error| Failure::Failed(format!("this program is not found: {error}")))?;
    Ok(variables(&linker, &wrapper))
}

fn variables(linker: &Path, wrapper: &Path) -> Vec<(OsString, OsString)> {
    vec![
        ("RUSTC".into(), COMPILER.into()),
        ("RUSTC_BOOTSTRAP".into(), "1".into()),
        ("RUSTC_WRAPPER".into(), wrapper.into()),
        (WRAPPER.into(), "1".into()),
        (
            "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER".into(),
            linker.into(),
        ),
    ]
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

/// Runs the compiler if cargo called this program as its wrapper: the compiler
/// and its arguments are the arguments, the program's own name first.
pub fn wrap(arguments: &[OsString]) -> Option<ExitCode> {
    env::var_os(WRAPPER)?;
    let [_, compiler, arguments @ ..] = arguments else {
        return None;
    };
    let status = Command::new(compiler)
        .args(arguments)
        .args(features(arguments))
        .status();
    match status.map(|status| status.code()) {
        Ok(Some(code)) => Some(ExitCode::from(u8::try_from(code).unwrap_or(1))),
        Ok(None) | Err(_) => Some(ExitCode::FAILURE),
    }
}

/// The features for the crate that these arguments compile; none for questions
/// that cargo asks the compiler.
fn features(arguments: &[OsString]) -> Vec<String> {
    let mut following = arguments
        .iter()
        .skip_while(|a| *a != "--crate-name")
        .skip(1);
    match following.next().and_then(|name| name.to_str()) {
        None | Some("___") => Vec::new(),
        Some(name) if STANDARD.contains(&name) => Vec::new(),
        Some(_) => FEATURES
            .iter()
            .map(|feature| format!("-Zcrate-attr=feature({feature})"))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<OsString> {
        line.split(' ').map(OsString::from).collect()
    }

    #[test]
    fn crates_get_the_features_and_the_standard_library_does_not() {
        let ours = features(&words("--crate-name network --edition=2024 src/lib.rs"));
        assert_eq!(ours.len(), FEATURES.len());
        assert!(ours.contains(&"-Zcrate-attr=feature(let_chains)".to_owned()));
        assert!(features(&words("--crate-name core src/lib.rs")).is_empty());
        assert!(features(&words("- --crate-name ___ --print=cfg")).is_empty());
        assert!(features(&words("-vV")).is_empty());
    }

    #[test]
    fn without_its_variable_this_program_is_no_compiler() {
        assert!(wrap(&words("xtask build gps")).is_none());
    }

    #[test]
    fn cargo_is_told_compiler_wrapper_and_linker() {
        let variables = variables(Path::new("/lld"), Path::new("/xtask"));
        let value = |name: &str| {
            let found = variables.iter().find(|(of, _)| of == name);
            found.map(|(_, value)| value.to_str().unwrap())
        };
        assert_eq!(value("RUSTC"), Some(COMPILER));
        assert_eq!(value("RUSTC_WRAPPER"), Some("/xtask"));
        assert_eq!(
            value("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER"),
            Some("/lld")
        );
    }
}

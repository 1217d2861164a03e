//! The project: its binaries, and the release image of one of them, by cargo.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Deserialize;

use crate::error::Error;

/// The task table of a package with one binary.
const TABLE: &str = "deadlines.toml";

/// Which binary of which package.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Choice {
    /// The package's manifest; that of the current folder or one above without it.
    pub manifest_path: Option<PathBuf>,
    /// The package of a workspace.
    pub package: Option<String>,
    /// A binary.
    pub bin: Option<String>,
    /// An example.
    pub example: Option<String>,
    /// The compiler's target; the project's own without it.
    pub target: Option<String>,
    /// Features to switch on, separated by commas.
    pub features: Option<String>,
    /// Whether to leave the default features off.
    pub no_default_features: bool,
}

/// A binary of a project.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Binary {
    /// Its name.
    pub name: String,
    /// Its first source file.
    pub source: PathBuf,
    /// Folder of its package.
    pub folder: PathBuf,
    /// Folder of its workspace, to which paths in images and messages are relative.
    pub root: PathBuf,
    /// Whether it is an example.
    pub is_example: bool,
    /// Whether other binaries of the package need tables, too.
    pub has_siblings: bool,
    manifest: PathBuf,
    package: String,
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    workspace_root: PathBuf,
    workspace_default_members: Option<Vec<String>>,
}

#[derive(Deserialize)]
struct Package {
    id: String,
    name: String,
    manifest_path: PathBuf,
    targets: Vec<Target>,
}

#[derive(Deserialize)]
struct Target {
    name: String,
    kind: Vec<String>,
    src_path: PathBuf,
}

/// What cargo says of a file that it has built.
#[derive(Deserialize)]
struct Message {
    reason: String,
    target: Option<Target>,
    executable: Option<PathBuf>,
}

/// The `cargo` that runs this command, or the one on the path.
fn cargo() -> Command {
    Command::new(std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo")))
}

/// What the command wrote, or the last line of its complaint.
fn output(command: &mut Command, what: &str) -> Result<String, Error> {
    let output = command
        .output()
        .map_err(|error| Error::Build(format!("cannot run cargo: {error}")))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let complaint = String::from_utf8_lossy(&output.stderr);
    let error = complaint
        .lines()
        .find_map(|line| line.strip_prefix("error: "));
    Err(Error::input(format!(
        "{what}: {}",
        error.unwrap_or("cargo says no more")
    )))
}

/// The packages among which the binary is.
fn chosen<'a>(metadata: &'a Metadata, choice: &Choice) -> Result<Vec<&'a Package>, Error> {
    let manifest = choice.manifest_path.as_deref().map(absolute);
    let here = std::env::current_dir().unwrap_or_default();
    let is_chosen = |package: &&Package| match (&choice.package, &manifest) {
        (Some(name), _) => package.name == *name,
        (None, Some(path)) => package.manifest_path == *path,
        (None, None) => package
            .manifest_path
            .parent()
            .is_some_and(|at| here.starts_with(at)),
    };
    let mut packages: Vec<&Package> = metadata.packages.iter().filter(is_chosen).collect();
    if let (true, Some(name)) = (packages.is_empty(), &choice.package) {
        let known: Vec<&str> = metadata
            .packages
            .iter()
            .map(|one| one.name.as_str())
            .collect();
        return Err(Error::input(format!(
            "there is no package {name}: there are {}",
            known.join(", ")
        )));
    }
    if packages.is_empty() && choice.package.is_none() {
        let default = metadata
            .workspace_default_members
            .as_deref()
            .unwrap_or_default();
        let packages_of = metadata.packages.iter();
        packages = packages_of
            .filter(|package| default.contains(&package.id))
            .collect();
    }
    // Of packages in each other's folders, the innermost.
    packages.sort_by_key(|package| std::cmp::Reverse(package.manifest_path.components().count()));
    if choice.package.is_none() && manifest.is_none() && here != metadata.workspace_root {
        packages.truncate(1);
    }
    Ok(packages)
}

/// What packages have in place of targets of a kind, after a sentence.
fn others(packages: &[&Package], kind: &str) -> String {
    let other = if kind == "bin" { "example" } else { "bin" };
    let targets = packages.iter().flat_map(|package| &package.targets);
    let of_other = targets.filter(|target| target.kind.iter().any(|one| one == other));
    let names: Vec<&str> = of_other.map(|target| target.name.as_str()).collect();
    if names.is_empty() {
        return String::new();
    }
    format!(", but by --{other}: {}", names.join(", "))
}

impl Binary {
    /// Finds the binary, without a build.
    ///
    /// # Errors
    /// There is no project, no such binary, or several and none is named.
    pub fn find(choice: &Choice) -> Result<Self, Error> {
        let mut command = cargo();
        command.args(["metadata", "--format-version", "1", "--no-deps"]);
        if let Some(path) = &choice.manifest_path {
            command.arg("--manifest-path").arg(path);
        }
        let text = output(&mut command, "cargo finds no project")?;
        let metadata: Metadata = serde_json::from_str(&text).map_err(|error| {
            Error::Build(format!("cargo's metadata are not understood: {error}"))
        })?;
        Self::among(&metadata, choice)
    }

    fn among(metadata: &Metadata, choice: &Choice) -> Result<Self, Error> {
        let packages = chosen(metadata, choice)?;
        let kind = if choice.example.is_some() {
            "example"
        } else {
            "bin"
        };
        let wanted = choice.example.as_ref().or(choice.bin.as_ref());
        let all = packages.iter().flat_map(|package| {
            let targets = package.targets.iter();
            let of_kind = targets.filter(|target| target.kind.iter().any(|one| one == kind));
            of_kind.map(|target| (*package, target))
        });
        let all: Vec<_> = all.collect();
        let mut found = all
            .iter()
            .filter(|(_, target)| wanted.is_none_or(|wanted| target.name == *wanted));
        let names: Vec<&str> = all.iter().map(|(_, target)| target.name.as_str()).collect();
        let names = names.join(", ");
        match (found.next(), found.next(), wanted) {
            (Some((package, target)), None, _) => Ok(Self {
                name: target.name.clone(),
                source: target.src_path.clone(),
                folder: package
                    .manifest_path
                    .parent()
                    .unwrap_or(Path::new("."))
                    .to_owned(),
                root: metadata.workspace_root.clone(),
                is_example: choice.example.is_some(),
                has_siblings: choice.example.is_some() || all.len() > 1,
                manifest: package.manifest_path.clone(),
                package: package.name.clone(),
            }),
            (None, _, Some(wanted)) if names.is_empty() => Err(Error::input(format!(
                "there is no {kind} {wanted}: the package has none{}",
                others(&packages, kind)
            ))),
            (None, _, Some(wanted)) => Err(Error::input(format!(
                "there is no {kind} {wanted}: there are {names}"
            ))),
            (None, _, None) => Err(Error::input(
                "the package has no binary: name an example by --example, or a package by --package",
            )),
            (Some(_), Some(_), _) => Err(Error::input(format!(
                "there are several binaries: choose one by --bin: {names}"
            ))),
        }
    }

    /// Builds the release image by the project's own settings, and gives its path.
    ///
    /// # Errors
    /// It does not build.
    pub fn build(&self, choice: &Choice) -> Result<PathBuf, Error> {
        let mut command = cargo();
        let kind = if self.is_example {
            "--example"
        } else {
            "--bin"
        };
        command
            .current_dir(&self.folder)
            .args([
                "build",
                "--release",
                "--message-format",
                "json-render-diagnostics",
            ])
            .arg("--manifest-path")
            .arg(&self.manifest)
            .args(["--package", &self.package, kind, &self.name])
            // Symbols and line tables tell where tasks, loops and locks are; they change no instruction.
            .env("CARGO_PROFILE_RELEASE_DEBUG", "2")
            .env("CARGO_PROFILE_RELEASE_STRIP", "none")
            .stderr(std::process::Stdio::inherit());
        if let Some(target) = &choice.target {
            command.args(["--target", target]);
        }
        if let Some(features) = &choice.features {
            command.args(["--features", features]);
        }
        if choice.no_default_features {
            command.arg("--no-default-features");
        }
        let output = command
            .output()
            .map_err(|error| Error::Build(format!("cannot run cargo: {error}")))?;
        if !output.status.success() {
            return Err(Error::Build(format!("{} does not build", self.name)));
        }
        let text = String::from_utf8_lossy(&output.stdout);
        let messages = text
            .lines()
            .filter_map(|line| serde_json::from_str::<Message>(line).ok());
        let mut built = messages.filter(|message| {
            let is_it = |target: &Target| target.name == self.name;
            message.reason == "compiler-artifact" && message.target.as_ref().is_some_and(is_it)
        });
        built
            .find_map(|message| message.executable)
            .ok_or_else(|| Error::Build(format!("cargo names no image of {}", self.name)))
    }

    /// The task table: `deadlines-NAME.toml` beside the manifest if there is one, else `deadlines.toml`.
    #[must_use]
    pub fn table(&self) -> PathBuf {
        let own = self.own_table();
        if own.is_file() {
            own
        } else {
            self.folder.join(TABLE)
        }
    }

    /// Where a new task table goes: `deadlines-NAME.toml` for an example, or one of several binaries.
    #[must_use]
    pub fn new_table(&self) -> PathBuf {
        if self.has_siblings {
            self.own_table()
        } else {
            self.folder.join(TABLE)
        }
    }

    fn own_table(&self) -> PathBuf {
        self.folder.join(format!("deadlines-{}.toml", self.name))
    }
}

fn absolute(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

//! What images are made of, as one number that tells whether they must be built again.
//!
//! Cargo keeps one image for each name. Where commands and tests want a node with several sets of values in turn, it
//! would build that node again each time.

use std::{
    collections::BTreeMap,
    env,
    ffi::{OsStr, OsString},
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
    process::Command,
};

use sha2::{Digest as _, Sha256};

use crate::Workspace;

/// What the workspace has of images: their crates, and what cargo reads of all crates.
const SOURCES: [&str; 8] = [
    "Cargo.lock",
    "Cargo.toml",
    "boards",
    "control",
    "firmware",
    "rust-toolchain.toml",
    "ttcan",
    ".cargo",
];

/// How the names of variables begin that change what cargo, the compiler or a build script makes.
const VARIABLES: [&str; 8] = [
    "CARGO_BUILD_",
    "CARGO_ENCODED_RUSTFLAGS",
    "CARGO_PROFILE_",
    "CARGO_TARGET_THUMB",
    "CARGO_UNSTABLE_",
    "DEFMT_",
    "FURROW_",
    "RUST",
];

/// Variables that begin so and change nothing in an image.
const OTHERS: [&str; 5] = [
    "RUST_BACKTRACE",
    "RUST_LIB_BACKTRACE",
    "RUST_LOG",
    "RUST_TEST_THREADS",
    "RUST_RECURSION_COUNT",
];

/// Options of cargo that choose an image and do not change it.
const CHOOSES: &str = "--bin";

/// A digest over all that an image is made of: sources, lock file, compiler, values, variables, and how it is sealed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Inputs(String);

impl Inputs {
    /// Those of the images that this command of cargo builds. Taken before it runs: a change while it builds is
    /// a change afterwards.
    ///
    /// # Errors
    ///
    /// A source cannot be read, or there is no compiler.
    pub(super) fn of(workspace: &Workspace, cargo: &Command) -> io::Result<Self> {
        let mut digest = Sha256::new();
        let mut add = |what: &[u8]| {
            digest.update(what.len().to_le_bytes());
            digest.update(what);
        };
        add(include_bytes!("../seal.rs"));
        add(workspace.root().as_os_str().as_encoded_bytes());
        add(&compiler(workspace)?);
        for argument in arguments(cargo) {
            add(argument.as_encoded_bytes());
        }
        for (name, value) in variables(cargo) {
            add(name.as_encoded_bytes());
            add(value.as_encoded_bytes());
        }
        for path in files(workspace)? {
            add(path.as_os_str().as_encoded_bytes());
            add(&fs::read(&path)?);
        }
        Ok(Self(hexadecimal(&digest.finalize())))
    }

    /// True if the image of `node` in this folder is as it was when it was made of the same.
    pub(super) fn made(&self, folder: &Path, node: &str) -> bool {
        let Ok(image) = fs::read(folder.join(node)) else {
            return false;
        };
        let noted = fs::read_to_string(note(folder, node));
        noted.is_ok_and(|noted| noted == self.noted(&image))
    }

    /// Notes that the image of `node` in this folder is made of them.
    ///
    /// # Errors
    ///
    /// The image cannot be read, or the note not be written.
    pub(super) fn keep(&self, folder: &Path, node: &str) -> io::Result<()> {
        let image = fs::read(folder.join(node))?;
        fs::write(note(folder, node), self.noted(&image))
    }

    fn noted(&self, image: &[u8]) -> String {
        format!("{}\n{}\n", self.0, hexadecimal(&Sha256::digest(image)))
    }
}

/// The file beside the image of `node` that says what it is made of.
fn note(folder: &Path, node: &str) -> PathBuf {
    folder.join(format!(".{node}.inputs"))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// What the compiler says of itself.
fn compiler(workspace: &Workspace) -> io::Result<Vec<u8>> {
    let name = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = workspace.program(name).arg("-vV").output()?;
    if !output.status.success() {
        return Err(io::Error::other("the compiler does not tell its version"));
    }
    Ok(output.stdout)
}

/// The arguments of a command without those that choose one of several images.
fn arguments(cargo: &Command) -> Vec<&OsStr> {
    let mut kept = Vec::new();
    let mut arguments = cargo.get_args();
    while let Some(argument) = arguments.next() {
        if argument == CHOOSES {
            arguments.next();
        } else {
            kept.push(argument);
        }
    }
    kept
}

/// The variables that count and that a command runs with, by their names.
fn variables(cargo: &Command) -> BTreeMap<OsString, OsString> {
    let mut variables: BTreeMap<OsString, OsString> = env::vars_os().collect();
    for (name, value) in cargo.get_envs() {
        match value {
            Some(value) => variables.insert(name.into(), value.into()),
            None => variables.remove(name),
        };
    }
    let begins =
        |name: &OsString, with: &&str| name.as_encoded_bytes().starts_with(with.as_bytes());
    variables.retain(|name, _| {
        VARIABLES.iter().any(|with| begins(name, with))
            && !OTHERS.iter().any(|with| begins(name, with))
    });
    variables
}

/// All files that images are made of, in an order that is always the same.
fn files(workspace: &Workspace) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for source in SOURCES {
        collect(&workspace.root().join(source), &mut files)?;
    }
    files.extend(
        settings(workspace)
            .into_iter()
            .filter(|path| path.is_file()),
    );
    Ok(files)
}

/// Where cargo looks for settings outside the workspace.
fn settings(workspace: &Workspace) -> Vec<PathBuf> {
    let above = workspace.root().ancestors().skip(1);
    let mut folders: Vec<PathBuf> = above.map(|folder| folder.join(".cargo")).collect();
    folders.extend(env::var_os("CARGO_HOME").map(PathBuf::from));
    folders.extend(env::home_dir().map(|home| home.join(".cargo")));
    let files = folders
        .iter()
        .flat_map(|folder| ["config", "config.toml"].map(|name| folder.join(name)));
    files.collect()
}

/// Adds a file, or all files of a folder but those that cargo has built. One that does not exist adds nothing.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_file() {
        files.push(path.into());
        return Ok(());
    }
    if !path.is_dir() || path.file_name() == Some(OsStr::new("target")) {
        return Ok(());
    }
    let entries = fs::read_dir(path)?.map(|entry| Ok(entry?.path()));
    let mut entries = entries.collect::<io::Result<Vec<_>>>()?;
    entries.sort();
    entries.iter().try_for_each(|entry| collect(entry, files))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workspace() -> Workspace {
        Workspace::find().unwrap()
    }

    fn cargo() -> Command {
        let mut cargo = Command::new("cargo");
        cargo.args(["build", "--release", "--package", "uagv"]);
        cargo
    }

    fn inputs(cargo: &Command) -> Inputs {
        Inputs::of(&workspace(), cargo).unwrap()
    }

    #[test]
    fn other_values_features_and_variables_are_other_inputs() {
        let usual = inputs(&cargo());
        assert_eq!(usual, inputs(&cargo()));
        let mut value = cargo();
        value.env("FURROW_SET", "mission.enabled=true");
        let mut feature = cargo();
        feature.args(["--features", "guardian"]);
        let mut level = cargo();
        level.env("DEFMT_LOG", "trace");
        let mut flags = cargo();
        flags.env("RUSTFLAGS", "-Copt-level=3");
        for other in [value, feature, level, flags] {
            assert_ne!(usual, inputs(&other), "{other:?}");
        }
        let mut same = cargo();
        same.args(["--bin", "gps"]).env("RUST_BACKTRACE", "1");
        assert_eq!(usual, inputs(&same));
    }

    #[test]
    fn a_changed_added_or_renamed_source_is_another_input() {
        let folder = tempfile::tempdir().unwrap();
        let collected = || {
            let mut files = Vec::new();
            collect(folder.path(), &mut files).unwrap();
            let names = files
                .iter()
                .map(|file| file.strip_prefix(folder.path()).unwrap().to_owned());
            names.collect::<Vec<PathBuf>>()
        };
        let write = |name: &str| {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        };
        write("src/lib.rs");
        write("src/node/mod.rs");
        write("target/release/built.rs");
        assert_eq!(
            collected(),
            [Path::new("src/lib.rs"), Path::new("src/node/mod.rs")]
        );
        fs::rename(
            folder.path().join("src/lib.rs"),
            folder.path().join("src/main.rs"),
        )
        .unwrap();
        assert_eq!(
            collected(),
            [Path::new("src/main.rs"), Path::new("src/node/mod.rs")]
        );
    }

    #[test]
    fn an_image_that_somebody_changed_is_built_again() {
        let folder = tempfile::tempdir().unwrap();
        let image = folder.path().join("gps");
        let inputs = Inputs("0".into());
        assert!(!inputs.made(folder.path(), "gps"));
        fs::write(&image, "an image").unwrap();
        assert!(!inputs.made(folder.path(), "gps"));
        inputs.keep(folder.path(), "gps").unwrap();
        assert!(inputs.made(folder.path(), "gps"));
        assert!(!Inputs("1".into()).made(folder.path(), "gps"));
        fs::write(&image, "another image").unwrap();
        assert!(!inputs.made(folder.path(), "gps"));
    }

    /// What cargo says of an image's sources is the witness that none is left out.
    #[test]
    fn every_source_that_cargo_names_is_an_input() {
        let workspace = workspace();
        let vehicle = crate::vehicle::find(&workspace, crate::vehicle::SMALLEST).unwrap();
        let nodes: Vec<_> = vehicle.nodes().collect();
        let images = super::super::images(&workspace, &vehicle, &nodes).unwrap();
        let files = files(&workspace).unwrap();
        let built = images[0].path.ancestors().nth(3).unwrap().join("release");
        let named = fs::read_to_string(built.join(format!("{}.d", images[0].name))).unwrap();
        let (_, sources) = named.split_once(": ").unwrap();
        let sources: Vec<&str> = sources.split_whitespace().collect();
        assert!(sources.len() > 50, "{sources:?}");
        let made = workspace.root().join("target");
        for source in sources {
            let path = Path::new(source);
            assert!(
                files.contains(&path.into()) || path.starts_with(&made),
                "{source}"
            );
        }
    }
}

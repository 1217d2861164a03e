//! Applications that were not written here: `strangers/list.toml` says which, from which commit of whose
//! repository, and what their images are. Their sources are not ours to keep, so this test is run by hand, with a
//! folder that has a checkout of each repository under its name in the list, prepared as the list says and built once
//! with the network:
//!
//! ```sh
//! STRANGERS=FOLDER cargo test -p cargo-deadlines --test strangers -- --ignored
//! ```
//!
//! With `STRANGER=NAME` beside it, only that one. It builds them without the network, compares the images, and holds the reports against those kept here.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Deserialize;
use sha2::{Digest, Sha256};
use wcet::image::Image;

#[derive(Deserialize)]
struct List {
    repository: BTreeMap<String, Repository>,
    stranger: Vec<Stranger>,
}

#[derive(Deserialize)]
struct Repository {
    of: String,
    commit: String,
    prepare: String,
}

#[derive(Deserialize)]
struct Stranger {
    name: String,
    repository: String,
    folder: String,
    target: String,
    binary: String,
    #[serde(default)]
    example: bool,
    features: Option<String>,
    #[serde(default)]
    run: Vec<String>,
    image: String,
}

fn here() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/strangers")
}

fn list() -> List {
    toml::from_str(&fs::read_to_string(here().join("list.toml")).unwrap()).unwrap()
}

/// A command without what a test run adds to its environment.
fn clean(program: &str, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .current_dir(folder)
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .env("CARGO_NET_OFFLINE", "true");
    command
}

impl Stranger {
    /// What chooses it, for cargo and for the command.
    fn choice(&self) -> Vec<&str> {
        let kind = if self.example { "--example" } else { "--bin" };
        let mut choice = vec![kind, &self.binary, "--target", &self.target];
        choice.extend(
            self.features
                .iter()
                .flat_map(|features| ["--features", features]),
        );
        choice
    }

    /// Builds it, with paths in its text that do not depend on the machine, and gives its image.
    fn build(&self, strangers: &Path, folder: &Path) -> PathBuf {
        let built = strangers.join("target");
        let home = std::env::var("CARGO_HOME").map_or_else(
            |_| PathBuf::from(std::env::var("HOME").unwrap()).join(".cargo"),
            PathBuf::from,
        );
        let flags = format!(
            "--remap-path-prefix={}=/cargo --remap-path-prefix={}=/strangers --remap-path-scope=macro",
            home.display(),
            strangers.display()
        );
        let triple = self.target.to_uppercase().replace(['-', '.'], "_");
        let status = clean(env!("CARGO"), folder)
            .args(["build", "--quiet", "--release"])
            .args(self.choice())
            .env("CARGO_TARGET_DIR", &built)
            .env("CARGO_PROFILE_RELEASE_DEBUG", "2")
            .env(format!("CARGO_TARGET_{triple}_RUSTFLAGS"), flags)
            .status()
            .unwrap();
        assert!(status.success(), "{} does not build", self.name);
        let kind = if self.example {
            "release/examples"
        } else {
            "release"
        };
        built.join(&self.target).join(kind).join(&self.binary)
    }
}

/// The digest of what an image loads.
fn digest(image: &Path) -> String {
    let mut digest = Sha256::new();
    for (address, bytes) in Image::read(image).unwrap().contents() {
        digest.update(address.to_le_bytes());
        digest.update(bytes);
    }
    let bytes = digest.finalize();
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

#[test]
#[ignore = "needs checkouts: STRANGERS=FOLDER"]
fn strangers_have_their_reports() {
    let Some(strangers) = std::env::var_os("STRANGERS") else {
        // A run of all tests, the slow ones included, does not have them.
        eprintln!("left out: STRANGERS names no folder");
        return;
    };
    let strangers = PathBuf::from(strangers).canonicalize().unwrap();
    let list = list();
    for (name, repository) in &list.repository {
        let output = clean("git", &strangers.join(name))
            .args(["rev-parse", "HEAD"])
            .output();
        let commit = String::from_utf8(output.unwrap().stdout).unwrap();
        let Repository { of, prepare, .. } = repository;
        assert_eq!(
            commit.trim(),
            repository.commit,
            "{name} is no checkout of {of} at that commit, prepared by: {prepare}"
        );
    }
    let mut other = Vec::new();
    let only = std::env::var("STRANGER").ok();
    let is_wanted = |stranger: &&Stranger| only.as_ref().is_none_or(|name| *name == stranger.name);
    for stranger in list.stranger.iter().filter(is_wanted) {
        let name = &stranger.name;
        let folder = strangers.join(&stranger.repository).join(&stranger.folder);
        let image = stranger.build(&strangers, &folder);
        let digest = digest(&image);
        if digest != stranger.image {
            other.push(format!("{name}: {digest}"));
        }
        let output = clean(env!("CARGO_BIN_EXE_cargo-deadlines"), &folder)
            .arg("deadlines")
            .args(stranger.choice())
            .arg("--image")
            .arg(&image)
            .arg("--table")
            .arg(here().join(format!("{name}.toml")))
            .args(&stranger.run)
            .output()
            .unwrap();
        let said = format!(
            "exit code {}\n{}{}",
            output.status.code().unwrap(),
            String::from_utf8(output.stdout).unwrap(),
            String::from_utf8(output.stderr).unwrap()
        );
        let said = said.replace(&strangers.display().to_string(), "/strangers");
        let said = said.replace(&here().display().to_string(), "strangers");
        insta::assert_snapshot!(name.as_str(), said);
    }
    assert!(
        other.is_empty(),
        "other images than in the list: {other:#?}"
    );
}

/// No table has more than ten entries that its author had to find out, and each has its report.
#[test]
fn each_stranger_needs_ten_annotations_at_most() {
    #[derive(Deserialize)]
    struct Table {
        #[serde(default)]
        bounds: BTreeMap<String, toml::Value>,
    }
    for Stranger { name, .. } in list().stranger {
        let table = fs::read_to_string(here().join(format!("{name}.toml"))).unwrap();
        let table: Table = toml::from_str(&table).unwrap();
        assert!(table.bounds.len() <= 10, "{name}");
        let report = here().join(format!("../snapshots/strangers__{name}.snap"));
        assert!(report.is_file(), "{name} has no expected report");
    }
}

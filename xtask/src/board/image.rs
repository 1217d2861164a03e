//! The image of the board tests: built for a board, and the list of the tests in it.
//!
//! `embedded-test` 0.7 leaves the list in the ELF file, as probe-rs reads it too: one symbol a test
//! in the section `.embedded_test`. Its name is JSON, its value the address of the test and its
//! module's name.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Stdio,
};

use object::{Object, ObjectSection, ObjectSymbol};
use serde::Deserialize;

use parts::Sled;

use super::Error;
use crate::{Failure, ReadError, Workspace, build, target};

/// The package, and its binary.
const PACKAGE: &str = "board-tests";

/// The version of the list that is understood.
const VERSION: u32 = 1;

/// The tests of a board, built.
#[derive(Debug, Clone)]
pub struct TestImage {
    /// The board.
    pub sled: &'static Sled,
    /// The ELF file.
    pub path: PathBuf,
    /// What is in it.
    pub elf: Vec<u8>,
    /// Its tests, by subject and name.
    pub tests: Vec<BoardTest>,
}

/// A test in an image.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct BoardTest {
    /// What it tests: the module.
    pub subject: String,
    /// Its name.
    pub name: String,
    /// The function that runs it.
    pub address: u32,
    /// Its time at most, in seconds.
    pub timeout: u32,
}

impl BoardTest {
    /// Its name as a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        self.name.replace('_', " ")
    }
}

/// The name of a symbol.
#[derive(Deserialize)]
struct Entry {
    name: String,
    #[serde(default)]
    ignored: bool,
    timeout: Option<u32>,
}

/// Time of a test that says nothing about it, in seconds, as with probe-rs.
const TIMEOUT: u32 = 60;

impl TestImage {
    /// Builds the tests of a board.
    ///
    /// # Errors
    ///
    /// The target is missing, the image does not build or holds no list of tests.
    pub fn build(workspace: &Workspace, sled: &'static Sled) -> Result<Self, Failure> {
        target::ensure(workspace)?;
        let mut cargo = target::cargo(workspace, "build");
        cargo.args(["--release", "--package", PACKAGE, "--bin", PACKAGE]);
        cargo.args(["--features", sled.name]);
        cargo.arg("--message-format=json-render-diagnostics");
        let _alone = workspace.builds_alone();
        let output = cargo
            .stderr(Stdio::inherit())
            .output()
            .map_err(build::Error::NoCargo)?;
        if !output.status.success() {
            return Err(Error::NotBuilt { board: sled.name }.into());
        }
        let messages = String::from_utf8_lossy(&output.stdout);
        let built =
            build::executable(&messages, PACKAGE).ok_or(Error::NotBuilt { board: sled.name })?;
        // Cargo has one place for both boards.
        let folder = build::images_folder(&built).join(PACKAGE);
        let path = build::keep(&built, &folder, sled.name)
            .map_err(|error| Error::NotKept { folder, error })?;
        Self::read(sled, &path)
    }

    /// Reads the image of a board.
    ///
    /// # Errors
    ///
    /// The file cannot be read or holds no list of tests.
    pub fn read(sled: &'static Sled, path: &Path) -> Result<Self, Failure> {
        let elf = fs::read(path).map_err(ReadError::of(path))?;
        let tests = list(&elf).map_err(|why| Error::NoList {
            path: path.to_owned(),
            why,
        })?;
        Ok(Self {
            sled,
            path: path.to_owned(),
            elf,
            tests,
        })
    }
}

/// The tests in an image.
fn list(elf: &[u8]) -> Result<Vec<BoardTest>, String> {
    let file = object::File::parse(elf).map_err(|error| error.to_string())?;
    let section = file
        .section_by_name(".embedded_test")
        .ok_or("it has no section .embedded_test")?;
    let words = |address: u64, count: usize| -> Option<Vec<u32>> {
        let bytes = section.data_range(address, 4 * count as u64).ok()??;
        let words = bytes.as_chunks().0.iter();
        Some(words.map(|word| u32::from_le_bytes(*word)).collect())
    };
    let version = file
        .symbol_by_name("EMBEDDED_TEST_VERSION")
        .and_then(|symbol| words(symbol.address(), 1));
    if version.as_deref() != Some(&[VERSION]) {
        return Err(format!("its list of tests is not of version {VERSION}"));
    }
    let mut tests = Vec::new();
    for symbol in file.symbols() {
        let name = symbol.name().unwrap_or_default();
        if symbol.section_index() != Some(section.index()) || !name.starts_with('{') {
            continue;
        }
        let entry: Entry = serde_json::from_str(name).map_err(|error| error.to_string())?;
        let value = words(symbol.address(), 3);
        let Some(&[address, path, length]) = value.as_deref() else {
            return Err(format!("the entry of {} is cut off", entry.name));
        };
        let module = text(&file, path, length).ok_or("the name of a module is missing")?;
        if entry.ignored {
            continue;
        }
        tests.push(BoardTest {
            subject: subject(&module).to_owned(),
            name: entry.name,
            address,
            timeout: entry.timeout.unwrap_or(TIMEOUT),
        });
    }
    tests.sort();
    Ok(tests)
}

/// The module of `crate::module::tests`.
pub(super) fn subject(module: &str) -> &str {
    let module = module.strip_suffix("::tests").unwrap_or(module);
    module.rsplit("::").next().unwrap_or(module)
}

/// A text in the image's constants.
fn text(file: &object::File<'_>, address: u32, length: u32) -> Option<String> {
    let bytes = file.sections().find_map(|section| {
        let bytes = section.data_range(address.into(), length.into());
        bytes.ok().flatten()
    })?;
    String::from_utf8(bytes.to_vec()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_is_the_module_around_the_tests() {
        assert_eq!(subject("board_tests::clocks::tests"), "clocks");
        assert_eq!(subject("board_tests::clocks"), "clocks");
    }

    #[test]
    fn what_holds_no_tests_is_refused() {
        assert!(list(b"no ELF file").is_err());
        let path = std::env::current_exe().unwrap();
        let error = TestImage::read(Sled::F303, &path).unwrap_err().to_string();
        assert!(error.contains("no section .embedded_test"), "{error}");
    }
}

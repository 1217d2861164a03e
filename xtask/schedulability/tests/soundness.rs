//! The page about the proof names sources and tests that exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The folder of all analysis packages.
fn packages() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .into()
}

/// The Rust sources below a folder, outside of build folders.
fn sources(folder: &Path, all: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") {
            sources(&path, all);
        } else if path.extension().is_some_and(|end| end == "rs") {
            all.push(path);
        }
    }
}

/// The names of all functions that follow `#[test]`.
fn tests() -> BTreeSet<String> {
    let mut all = Vec::new();
    sources(&packages(), &mut all);
    let mut names = BTreeSet::new();
    for path in all {
        let text = fs::read_to_string(path).unwrap();
        for behind in text.split("#[test]").skip(1) {
            let name = behind
                .split_once("fn ")
                .and_then(|(_, name)| name.split_once('('));
            names.extend(name.map(|(name, _)| name.to_owned()));
        }
    }
    names
}

/// What stands between back-quotes.
fn quoted(cell: &str) -> impl Iterator<Item = &str> {
    cell.split('`').skip(1).step_by(2)
}

#[test]
fn sources_and_tests_of_the_page_exist() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("SOUNDNESS.md");
    let page = fs::read_to_string(page).unwrap();
    let tests = tests();
    let mut rows = 0;
    for row in page.lines().filter(|line| line.starts_with("| ")) {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").collect();
        let [_, from, by] = cells.as_slice() else {
            panic!("three cells: {row}");
        };
        for source in quoted(from) {
            assert!(packages().join(source).is_file(), "{source}");
        }
        for test in quoted(by) {
            assert!(tests.contains(test), "no test {test}");
        }
        rows += usize::from(quoted(by).next().is_some());
    }
    assert!(rows > 20, "{rows} rows with tests");
}

//! The command and the crates of this repository that it needs can be packaged, each with its licences.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn cargo(arguments: &[&str]) -> Output {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("package");
    Command::new(env!("CARGO"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(arguments)
        .arg("--offline")
        .env("CARGO_TARGET_DIR", target)
        .output()
        .unwrap()
}

fn lines(output: &Output) -> String {
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{error}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The crates of the workspace that a package of it needs, to build or to test it, and itself.
fn needed(name: &str) -> BTreeSet<String> {
    let metadata = lines(&cargo(&["metadata", "--no-deps", "--format-version", "1"]));
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let mut needed = BTreeSet::new();
    let mut open = vec![name.to_owned()];
    while let Some(name) = open.pop() {
        let mut packages = packages.iter();
        let package = packages.find(|package| package["name"] == *name).unwrap();
        let all = package["dependencies"].as_array().unwrap().iter();
        let own = all.filter(|dependency| dependency["path"].is_string());
        let own = own.map(|dependency| dependency["name"].as_str().unwrap().to_owned());
        if needed.insert(name) {
            open.extend(own);
        }
    }
    needed
}

#[test]
fn all_of_them_can_be_packaged() {
    let needed = needed("cargo-deadlines");
    assert!(needed.contains("wcet"), "{needed:?}");
    let chosen: Vec<&str> = needed.iter().flat_map(|name| ["-p", name]).collect();
    let package = ["package", "--allow-dirty", "--no-verify"];
    lines(&cargo(&[&package[..], &chosen].concat()));
    for name in &needed {
        let list = ["package", "--allow-dirty", "--list", "-p", name];
        let list = lines(&cargo(&list));
        let files: BTreeSet<&str> = list.lines().collect();
        for licence in ["LICENSE-APACHE", "LICENSE-MIT"] {
            assert!(files.contains(licence), "{name} has no {licence}");
        }
    }
}

/// The tests of the command need the whole repository, so no file of them is in its package.
#[test]
fn the_package_has_parts_and_no_tests() {
    let list = [
        "package",
        "--allow-dirty",
        "--list",
        "-p",
        "cargo-deadlines",
    ];
    let list = lines(&cargo(&list));
    let files: BTreeSet<&str> = list.lines().collect();
    assert!(files.contains("parts/stm32f446.toml"), "{files:?}");
    assert!(files.contains("README.md"), "{files:?}");
    assert!(!list.contains("tests/"), "{files:?}");
}

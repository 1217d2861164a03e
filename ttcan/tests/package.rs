//! The package is complete: every file that another one includes is in it.

use std::fs;
use std::path::{Path, PathBuf};

/// The source files of the package: those below folders that are no package of their own.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.join("Cargo.toml").exists() || path.ends_with("target") {
            continue;
        }
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// The texts between quotes that follow `before` in a source.
fn quoted<'a>(source: &'a str, before: &'a str) -> impl Iterator<Item = &'a str> {
    let behind = source.split(before).skip(1);
    behind.filter_map(|rest| rest.split('"').next())
}

#[test]
fn no_file_includes_one_that_is_not_packaged() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = fs::canonicalize(root).expect("the package's folder");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut included = 0;
    for file in &files {
        let source = fs::read_to_string(file).expect("a source");
        let folder = file.parent().expect("a folder");
        // In two pieces, so that this file has none of them.
        let path = ["#[path", " = \""].concat();
        let text = ["include_str!", "(\""].concat();
        for name in quoted(&source, &path).chain(quoted(&source, &text)) {
            let target = fs::canonicalize(folder.join(name));
            let target =
                target.unwrap_or_else(|error| panic!("{}: {name}: {error}", file.display()));
            let inside = target.strip_prefix(&root);
            let inside = inside.unwrap_or_else(|_| panic!("{}: {name}", file.display()));
            let mut folders = inside.ancestors().skip(1);
            let foreign = folders.find(|folder| {
                *folder != Path::new("") && root.join(folder).join("Cargo.toml").exists()
            });
            assert_eq!(foreign, None, "{} includes {name}", file.display());
            included += 1;
        }
    }
    assert!(included >= 5, "{included}");
}

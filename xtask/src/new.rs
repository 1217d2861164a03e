//! `new`: the folder of a new vehicle, copied from another one.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde_json::json;
use vehicle_model::Vehicle;

use crate::{Failure, Workspace, cli::New, vehicle};

pub mod variant;

/// Why no vehicle is made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The name is not accepted.
    #[error("vehicle name {name:?}: {why}")]
    Name {
        /// The name.
        name: String,
        /// What is wrong with it.
        #[source]
        why: NameError,
    },
    /// The folder to copy cannot be read.
    #[error("{} cannot be copied: {error}", folder.display())]
    Copy {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// A variant has nothing to copy but numbers.
    #[error(
        "--like {model}: it is a variant of {of} and has no nodes of its own: --like {of} is accepted"
    )]
    Variant {
        /// Its name.
        model: String,
        /// The vehicle that has the nodes.
        of: String,
    },
    /// There are no numbers in which a variant could differ.
    #[error(
        "{model} has no machine whose numbers a variant could have: --like uagv or another vehicle with [machine] \
         or [rover] is accepted"
    )]
    NoMachine {
        /// The vehicle.
        model: String,
    },
    /// The new folder cannot be written.
    #[error("{} cannot be written: {error}", folder.display())]
    Write {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
}

impl Error {
    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Name { .. } | Self::Variant { .. } | Self::NoMachine { .. }
        )
    }
}

/// What is wrong with the name of a vehicle.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// It cannot be that of a package, or is too long.
    #[error(
        "up to {LONGEST} lower-case letters, digits and single hyphens between them are \
         accepted, a letter first"
    )]
    Form,
    /// It is a keyword.
    #[error("a keyword of Rust is no name of a crate")]
    Keyword,
    /// A crate of Rust has it.
    #[error("a crate of Rust itself has this name")]
    BuiltIn,
    /// A folder has it.
    #[error("there is such a folder already")]
    Folder,
    /// A package has it.
    #[error("the workspace has such a package already")]
    Package,
    /// The vehicle to copy uses it for something else.
    #[error("the word {word} means something else in {model} already")]
    Word {
        /// The name in one of its forms.
        word: String,
        /// The vehicle.
        model: String,
    },
}

/// Longest name of a vehicle. Longer ones do not fit a line of the console.
const LONGEST: usize = 24;
/// Crates that every program has, beside those of the workspace.
const BUILT_IN: [&str; 5] = ["alloc", "core", "proc-macro", "std", "test"];
/// Folders of a vehicle that are not copied: its tests state facts about that one vehicle, and its variants are
/// other vehicles.
const LEFT_OUT: [&str; 3] = ["target", "tests", "variants"];

/// Runs the command.
///
/// # Errors
///
/// The name is not accepted, or the vehicle to copy does not exist (exit code 2). A
/// folder cannot be read or written.
pub fn run(workspace: &Workspace, options: &New) -> Result<(), Failure> {
    let model = vehicle::find(workspace, &options.like)?;
    if let Some(of) = model.variant_of() {
        let (model, of) = (model.name().to_owned(), of.to_owned());
        return Err(Error::Variant { model, of }.into());
    }
    let (vehicle, what) = match options.variant {
        false => (create(workspace, &model, &options.name)?, "a copy"),
        true => (
            variant::create(workspace, &model, &options.name)?,
            "a variant",
        ),
    };
    let nodes = vehicle::node_names(&vehicle);
    let folder = vehicle.folder();
    let shown = folder.strip_prefix(workspace.root()).unwrap_or(folder);
    if options.json {
        let report = json!({
            "vehicle": vehicle.name(),
            "like": model.name(),
            "folder": shown,
            "nodes": nodes,
        });
        println!("{report:#}");
    } else {
        let name = vehicle.name();
        println!(
            "Wrote {}, {what} of {} with the nodes {}.\n\n  \
             cargo xtask build --vehicle {name}\n  \
             cargo xtask sim --vehicle {name}\n  \
             cargo xtask schedulability --vehicle {name}\n\n\
             firmware/PORTING.md leads through the usual changes.",
            shown.display(),
            model.name(),
            nodes.join(", ")
        );
    }
    Ok(())
}

/// Copies the folder of `model` to that of a new vehicle. It is there whole or not at all.
///
/// # Errors
///
/// As [`run`].
pub fn create(workspace: &Workspace, model: &Vehicle, name: &str) -> Result<Vehicle, Failure> {
    let refused = |why| Error::Name {
        name: name.into(),
        why,
    };
    is_package_name(name).map_err(refused)?;
    let folder = workspace.vehicles().join(name);
    let names = vehicle::names(workspace)?;
    if folder.exists() || names.iter().any(|other| other == name) {
        return Err(refused(NameError::Folder).into());
    }
    if packages(workspace).iter().any(|package| package == name) {
        return Err(refused(NameError::Package).into());
    }
    let package = vehicle::package(model)?;
    let (from, to) = (Names::of(&package), Names::of(name));

    let unreadable = |error| Error::Copy {
        folder: model.folder().into(),
        error,
    };
    let files = files(model.folder()).map_err(unreadable)?;
    let texts = files.iter().filter_map(|file| file.text());
    if let Some(word) = texts.flat_map(words).find(|word| to.has(word)) {
        let word = word.to_owned();
        let model = model.name().to_owned();
        return Err(refused(NameError::Word { word, model }).into());
    }

    let unwritable = |error| Error::Write {
        folder: folder.clone(),
        error,
    };
    // Beside the vehicles and not among them, where cargo would take it for a package.
    let temporary = tempfile::tempdir_in(workspace.root().join("firmware")).map_err(unwritable)?;
    let draft = temporary.path().join(name);
    for file in &files {
        file.write(&draft, &from, &to).map_err(unwritable)?;
    }
    vehicle::read(&draft)?;
    fs::rename(&draft, &folder).map_err(unwritable)?;
    Ok(vehicle::find(workspace, name)?)
}

/// Whether a name can be that of a package and of its crate; why not, if it cannot.
fn is_package_name(name: &str) -> Result<(), NameError> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit();
    let words = name.split('-');
    let form = name.starts_with(|c: char| c.is_ascii_lowercase())
        && words.into_iter().all(|word| !word.is_empty())
        && name.chars().all(|c| plain(c) || c == '-');
    if !form || name.len() > LONGEST {
        return Err(NameError::Form);
    }
    // A crate's name must be an identifier, and keywords are none; `syn` takes `gen`, a keyword
    // since the edition of 2024, for a name.
    if name == "gen" || syn::parse_str::<syn::Ident>(&name.replace('-', "_")).is_err() {
        return Err(NameError::Keyword);
    }
    if BUILT_IN.contains(&name) {
        return Err(NameError::BuiltIn);
    }
    Ok(())
}

/// The packages that the workspace is built from; none before its first build.
fn packages(workspace: &Workspace) -> Vec<String> {
    let lock = fs::read_to_string(workspace.root().join("Cargo.lock")).unwrap_or_default();
    let lock: toml::Table = lock.parse().unwrap_or_default();
    let packages = lock.get("package").and_then(toml::Value::as_array);
    let names = packages.into_iter().flatten();
    names
        .filter_map(|package| Some(package.get("name")?.as_str()?.to_owned()))
        .collect()
}

/// The forms in which a vehicle's name is written.
#[derive(Debug)]
struct Names {
    /// Of the package: `two-boards`.
    package: String,
    /// Of the crate: `two_boards`.
    crate_name: String,
    /// Of types: `TwoBoards`.
    type_name: String,
}

impl Names {
    fn of(package: &str) -> Self {
        let capitalised = |word: &str| {
            let mut letters = word.chars();
            let first = letters.next().map(|first| first.to_ascii_uppercase());
            first.into_iter().chain(letters).collect::<String>()
        };
        Self {
            package: package.to_owned(),
            crate_name: package.replace('-', "_"),
            type_name: package.split('-').map(capitalised).collect(),
        }
    }

    fn has(&self, word: &str) -> bool {
        [&self.package, &self.crate_name, &self.type_name]
            .iter()
            .any(|name| *name == word)
    }
}

/// Whether a character is part of a word.
fn in_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_' || c == '-'
}

/// The words of a text.
fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c| !in_word(c)).filter(|word| !word.is_empty())
}

/// The text with another vehicle's name in each of its forms. Package and crate may be
/// written alike; what a path goes on from is the crate.
fn renamed(text: &str, from: &Names, to: &Names) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(in_word) {
        let (before, word) = rest.split_at(start);
        let end = word.find(|c| !in_word(c)).unwrap_or(word.len());
        let (word, after) = word.split_at(end);
        out.push_str(before);
        out.push_str(if word == from.crate_name && after.starts_with("::") {
            &to.crate_name
        } else if word == from.package {
            &to.package
        } else if word == from.crate_name {
            &to.crate_name
        } else if word == from.type_name {
            &to.type_name
        } else {
            word
        });
        rest = after;
    }
    out.push_str(rest);
    out
}

/// A file of a vehicle's folder.
struct File {
    /// Path in the folder.
    path: PathBuf,
    contents: Vec<u8>,
}

impl File {
    /// Its text; `None` when it holds something else.
    fn text(&self) -> Option<&str> {
        str::from_utf8(&self.contents).ok()
    }

    /// Writes it below `folder` with another vehicle's name.
    fn write(&self, folder: &Path, from: &Names, to: &Names) -> io::Result<()> {
        let path = folder.join(&self.path);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        match self.text() {
            Some(text) => fs::write(path, renamed(text, from, to)),
            None => fs::write(path, &self.contents),
        }
    }
}

/// The files of a vehicle's folder that a copy needs, in alphabetical order.
fn files(folder: &Path) -> io::Result<Vec<File>> {
    let mut files = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(below) = folders.pop() {
        for entry in fs::read_dir(folder.join(&below))? {
            let entry = entry?;
            let name = entry.file_name();
            let hidden = name.to_string_lossy().starts_with('.');
            let left_out = LEFT_OUT.iter().any(|other| name == *other);
            let path = below.join(name);
            if entry.path().is_dir() {
                if !hidden && !left_out {
                    folders.push(path);
                }
            } else if !hidden {
                let contents = fs::read(entry.path())?;
                files.push(File { path, contents });
            }
        }
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The manifest of a vehicle.
    pub(super) fn text_of(vehicle: &Vehicle) -> String {
        fs::read_to_string(vehicle.manifest_file()).unwrap()
    }

    /// A workspace with copies of the vehicles.
    pub(super) fn workspace() -> (tempfile::TempDir, Workspace) {
        let folder = tempfile::tempdir().unwrap();
        let own = Workspace::find().unwrap();
        let workspace = Workspace::at(folder.path());
        fs::copy(
            own.root().join("Cargo.lock"),
            folder.path().join("Cargo.lock"),
        )
        .unwrap();
        for name in ["two-boards", "uagv"] {
            let names = Names::of(name);
            for file in files(&own.vehicles().join(name)).unwrap() {
                let to = workspace.vehicles().join(name);
                file.write(&to, &names, &names).unwrap();
            }
        }
        (folder, workspace)
    }

    fn refusal(workspace: &Workspace, name: &str) -> String {
        let model = vehicle::find(workspace, "two-boards").unwrap();
        let failure = create(workspace, &model, name).unwrap_err();
        assert_eq!(failure.exit_code(), 2, "{failure}");
        failure.to_string()
    }

    #[test]
    fn each_form_of_the_name_is_replaced_and_nothing_else() {
        let text = "name = \"uagv\"; use uagv::{Uagv, x}; // uagvs, my-uagv, ../uagv/a, UAGV";
        let to = Names::of("small-plough");
        assert_eq!(
            renamed(text, &Names::of("uagv"), &to),
            "name = \"small-plough\"; use small_plough::{SmallPlough, x}; \
             // uagvs, my-uagv, ../small-plough/a, UAGV"
        );
        assert_eq!(
            renamed(
                "two_boards two-boards TwoBoards",
                &Names::of("two-boards"),
                &to
            ),
            "small_plough small-plough SmallPlough"
        );
    }

    #[test]
    fn a_new_vehicle_has_the_nodes_of_the_old_one_under_its_own_name() {
        let (folder, workspace) = workspace();
        for like in ["two-boards", "uagv"] {
            let model = vehicle::find(&workspace, like).unwrap();
            let name = format!("plough-{}", model.nodes().len());
            let vehicle = create(&workspace, &model, &name).unwrap();
            assert_eq!(vehicle::package(&vehicle).unwrap(), name);
            assert_eq!(vehicle::node_names(&vehicle), vehicle::node_names(&model));
            for file in files(vehicle.folder()).unwrap() {
                let text = file.text().unwrap();
                // Where the fields of the task table are explained.
                let text = text.replace("../uagv/tasks.toml", "");
                let names = Names::of(like);
                assert!(!words(&text).any(|word| names.has(word)), "{:?}", file.path);
            }
        }
        let firmware = folder.path().join("firmware");
        assert_eq!(fs::read_dir(firmware).unwrap().count(), 1);
    }

    #[test]
    fn a_name_that_cannot_be_is_refused_in_one_sentence() {
        let (_folder, workspace) = workspace();
        for (name, why) in [
            ("Plough", "lower-case letters, digits and single hyphens"),
            ("my_plough", "lower-case letters"),
            ("2-ploughs", "a letter first"),
            ("plough-", "lower-case letters"),
            ("a--b", "single hyphens"),
            ("", "lower-case letters"),
            ("../plough", "lower-case letters"),
            ("a-name-of-more-letters-than-fit", "up to 24"),
            ("match", "a keyword of Rust"),
            ("gen", "a keyword of Rust"),
            ("core", "a crate of Rust itself"),
            ("uagv", "there is such a folder already"),
            ("firmware", "the workspace has such a package already"),
            (
                "motor",
                "the word motor means something else in two-boards already",
            ),
        ] {
            let told = refusal(&workspace, name);
            assert!(told.contains(why), "{told}");
            assert!(!told.contains('\n'), "{told}");
        }
        assert_eq!(Vehicle::names(&workspace.vehicles()).unwrap().len(), 2);
    }

    #[test]
    fn nothing_is_left_of_a_vehicle_that_makes_no_sense() {
        let (folder, workspace) = workspace();
        let model = vehicle::find(&workspace, "two-boards").unwrap();
        fs::write(model.manifest_file(), "summary = 1").unwrap();
        let failure = create(&workspace, &model, "plough").unwrap_err();
        assert!(failure.to_string().contains("summary"), "{failure}");
        let firmware = folder.path().join("firmware");
        assert_eq!(fs::read_dir(&firmware).unwrap().count(), 1);
        assert_eq!(fs::read_dir(workspace.vehicles()).unwrap().count(), 2);
    }
}

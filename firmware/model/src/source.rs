//! Where the manifest of a vehicle comes from: its own text, or that of a variant over another vehicle's.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::{Table, Value};

use crate::error::VehicleError;
use crate::manifest::Manifest;
use crate::overrides::Overrides;
use crate::text;

/// Name of the manifest in a vehicle's folder.
pub(crate) const MANIFEST: &str = "vehicle.toml";

/// Folder of its variants in a vehicle's folder.
const VARIANTS: &str = "variants";

/// Key of a variant's manifest: what of the other vehicle's manifest it does not have.
const WITHOUT: &str = "without";

/// Keys of a machine on which the weights of its steering depend.
const WEIGHED: [&str; 5] = [
    "rear_to_antenna",
    "antenna_to_front",
    "cruise",
    "limits",
    "sensors",
];

/// The folder of a vehicle's variants.
pub(crate) fn variants_of(folder: &Path) -> PathBuf {
    folder.join(VARIANTS)
}

/// The folder of the vehicle of which the folder is a variant's, if it is one.
fn varied(folder: &Path) -> Option<&Path> {
    let variants = folder.parent()?;
    let vehicle = variants.parent()?;
    (variants.file_name()? == VARIANTS).then_some(vehicle)
}

/// The manifest of a vehicle before it is read.
#[derive(Debug)]
pub(crate) struct Source {
    /// The folder of network file, task table, nodes and crate.
    pub(crate) crate_folder: PathBuf,
    manifest: Text,
}

/// What a manifest is made of.
#[derive(Debug)]
enum Text {
    /// Its own text.
    Own(String),
    /// That of another vehicle, with the tables of a variant put into it.
    Varied(Table),
}

impl Source {
    /// The source of the manifest that has this text in its vehicle's folder.
    ///
    /// # Errors
    /// The folder is that of a variant, and the manifest of the other vehicle is wrong, or the variant leaves out
    /// what that does not have.
    pub(crate) fn of(folder: &Path, manifest: &str) -> Result<Self, VehicleError> {
        let Some(vehicle) = varied(folder) else {
            return Ok(Self {
                crate_folder: folder.into(),
                manifest: Text::Own(manifest.into()),
            });
        };
        let other = text(vehicle, MANIFEST)?;
        let wrong = |folder: &Path, what| refused(folder, &Overrides::default(), what);
        // What is wrong there is told as that file's.
        read(&other).map_err(|what| wrong(vehicle, what))?;
        let other = table(&other).map_err(|what| wrong(vehicle, what))?;
        let merged = table(manifest).and_then(|own| vary(other, own));
        Ok(Self {
            crate_folder: vehicle.into(),
            manifest: Text::Varied(merged.map_err(|what| wrong(folder, what))?),
        })
    }

    /// The manifest with other values than its text has, and those of them that change something.
    ///
    /// # Errors
    /// It makes no sense, or one of the values leads nowhere; the folder is told.
    pub(crate) fn manifest_with(
        &self,
        folder: &Path,
        overrides: &Overrides,
    ) -> Result<(Manifest, Overrides), VehicleError> {
        let wrong = |what| refused(folder, overrides, what);
        let own = self.read();
        let (mut manifest, overrides) = if overrides.is_empty() {
            (own.map_err(wrong)?, overrides)
        } else {
            let changed = self.changed(overrides).map_err(wrong)?;
            match own {
                Ok(own) if own == changed => (own, &Overrides::default()),
                _ => (changed, overrides),
            }
        };
        manifest.complete();
        Ok((manifest, overrides.clone()))
    }

    fn read(&self) -> Result<Manifest, String> {
        match &self.manifest {
            Text::Own(text) => read(text),
            Text::Varied(table) => read_table(table.clone(), table),
        }
    }

    /// The manifest with other values.
    fn changed(&self, overrides: &Overrides) -> Result<Manifest, String> {
        let own = match &self.manifest {
            Text::Own(text) => table(text)?,
            Text::Varied(table) => table.clone(),
        };
        let mut manifest = own.clone();
        overrides.apply(&mut manifest)?;
        read_table(manifest, &own)
    }
}

/// The manifest of a variant: that of the other vehicle without what the variant leaves out, and with the
/// variant's own values. Tables are taken together, everything else replaces what the other one has.
fn vary(mut manifest: Table, mut own: Table) -> Result<Table, String> {
    let wrong = || {
        format!(
            "{WITHOUT}: a list of keys of the other vehicle is accepted, as in [\"machine.weights\"]"
        )
    };
    let without = match own.remove(WITHOUT) {
        None => Vec::new(),
        Some(keys) => Vec::<String>::deserialize(keys).map_err(|_| wrong())?,
    };
    for key in without {
        remove(&mut manifest, &key)
            .ok_or_else(|| format!("{WITHOUT}: the other vehicle has no {key:?}"))?;
    }
    weights(&manifest, &own)?;
    put(&mut manifest, own);
    Ok(manifest)
}

/// Refuses the weights of another vehicle's steering for a machine that they were not found for.
fn weights(other: &Table, own: &Table) -> Result<(), String> {
    let machine = |manifest: &Table| manifest.get("machine")?.as_table().cloned();
    let has_weights = |machine: &Table| machine.contains_key("weights");
    let Some(own) = machine(own).filter(|own| !has_weights(own)) else {
        return Ok(());
    };
    let changed = WEIGHED.into_iter().find(|key| own.contains_key(*key));
    match (changed, machine(other).filter(has_weights)) {
        (Some(key), Some(_)) => Err(format!(
            "machine.{key}: the other vehicle's machine.weights were found for its own: {WITHOUT} = \
             [\"machine.weights\"], or weights for this machine, are accepted"
        )),
        _ => Ok(()),
    }
}

/// Removes what a key with its tables in front of it names; `None` if there is nothing.
fn remove(manifest: &mut Table, key: &str) -> Option<Value> {
    let mut parts: Vec<&str> = key.split('.').collect();
    let last = parts.pop()?;
    let mut table = manifest;
    for part in parts {
        table = table.get_mut(part)?.as_table_mut()?;
    }
    table.remove(last)
}

fn put(manifest: &mut Table, own: Table) {
    for (key, value) in own {
        match (manifest.get_mut(&key), value) {
            (Some(Value::Table(other)), Value::Table(own)) => put(other, own),
            (_, value) => {
                manifest.insert(key, value);
            }
        }
    }
}

/// The text of a file of a folder.
pub(crate) fn text(folder: &Path, file: &str) -> Result<String, VehicleError> {
    let file = folder.join(file);
    fs::read_to_string(&file).map_err(|error| VehicleError::Unreadable { file, error })
}

/// Why the manifest of a folder is refused, with the values that it would have.
pub(crate) fn refused(folder: &Path, overrides: &Overrides, what: String) -> VehicleError {
    VehicleError::Manifest {
        file: folder.join(MANIFEST),
        what: match overrides.is_empty() {
            true => what,
            false => format!("with {overrides}: {what}"),
        },
    }
}

/// Reads the text of a manifest.
fn read(text: &str) -> Result<Manifest, String> {
    let manifest = toml::Deserializer::parse(text).map_err(|error| syntax(text, &error))?;
    serde_path_to_error::deserialize(manifest).map_err(|error| field(text, &error))
}

/// The text of a manifest as a table.
fn table(text: &str) -> Result<Table, String> {
    text.parse().map_err(|error| syntax(text, &error))
}

/// Reads a manifest that is no text any more, with `own` as it was before values were changed.
fn read_table(manifest: Table, own: &Table) -> Result<Manifest, String> {
    serde_path_to_error::deserialize(manifest).map_err(|error| {
        let path = error.path().to_string();
        match absent_table(own, &path) {
            // A table that has nothing but the other values lacks its other fields.
            Some(table) if error.inner().message().starts_with("missing field") => {
                format!("the manifest has no [{table}], so no value of it can be set")
            }
            // The errors have no place in the text.
            _ => field("", &error),
        }
    })
}

/// The outermost table on a path of keys that a manifest does not have.
fn absent_table<'p>(manifest: &toml::Table, path: &'p str) -> Option<&'p str> {
    let mut table = manifest;
    let mut end = 0;
    for key in path.split('.') {
        end += key.len();
        match table.get(key) {
            None => return Some(&path[..end]),
            Some(toml::Value::Table(inner)) => table = inner,
            Some(_) => return None,
        }
        end += 1;
    }
    None
}

/// Why a text is not TOML: line, key and the parser's message, without the excerpt that it draws.
fn syntax(text: &str, error: &toml::de::Error) -> String {
    let start = error.span().map_or(0, |span| span.start);
    let line = text::line(text, start);
    let key = text::key(text, start).map_or(String::new(), |key| format!(", {key}"));
    let what = text::phrase(error.message());
    format!("line {line}{key}: this is not TOML: {what}")
}

/// Why a value is refused: its line, its path and what is accepted.
fn field(text: &str, error: &serde_path_to_error::Error<toml::de::Error>) -> String {
    let path = error.path().to_string();
    let what = text::phrase(error.inner().message());
    let line = error
        .inner()
        .span()
        .map(|span| text::line(text, span.start));
    match (line, path.as_str()) {
        (None, "." | "?") => what,
        (None, path) => format!("{path}: {what}"),
        (Some(line), "." | "?") => format!("line {line}: {what}"),
        (Some(line), path) => format!("line {line}, {path}: {what}"),
    }
}

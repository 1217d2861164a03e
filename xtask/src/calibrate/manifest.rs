//! Writes a calibration into a vehicle's manifest and keeps its comments and its order.

use std::fs;

use serde::Serialize;
use toml_edit::{DocumentMut, Item, Value};
use vehicle_model::Vehicle;

use super::fit::Calibration;

/// An old and a new value of the manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Change {
    /// Path of the value, such as `machine.potentiometer.centre`.
    pub(super) field: &'static str,
    /// The old value.
    pub(super) from: String,
    /// The new value.
    pub(super) to: String,
}

/// A manifest with a calibration written into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Edited {
    /// Its text.
    pub(super) text: String,
    /// The changed values.
    pub(super) changes: Vec<Change>,
}

/// The values of a calibration, as the manifest writes them.
fn values(found: &Calibration) -> [(&'static str, String); 6] {
    let percent = |share: f64| format!("{:.2} %", share * 100.0);
    let rate = |rate: f64| format!("{rate:.3} deg/s");
    [
        (
            "machine.potentiometer.centre",
            format!("{:.2} counts", found.centre),
        ),
        (
            "machine.potentiometer.slope",
            format!("{:.3} counts/deg", found.counts_per_degree),
        ),
        (
            "machine.steering.right.dead_band",
            percent(found.right.dead_band),
        ),
        (
            "machine.steering.right.full_rate",
            rate(found.right.full_rate),
        ),
        (
            "machine.steering.left.dead_band",
            percent(found.left.dead_band),
        ),
        (
            "machine.steering.left.full_rate",
            rate(found.left.full_rate),
        ),
    ]
}

/// Whether the result of the same log was written before. The readings of the potentiometer depend
/// on the drive alone, so they are then equal to the last digit. The figures of the actuator are
/// computed with the manifest's values, so they are not, and each time they would drift further.
pub(super) fn is_repeated(changes: &[Change]) -> bool {
    let equal = |change: &Change| change.from == change.to;
    let (pot, actuator): (Vec<_>, Vec<_>) = changes
        .iter()
        .partition(|change| change.field.starts_with("machine.potentiometer."));
    pot.into_iter().all(equal) && !actuator.into_iter().all(equal)
}

/// Writes a calibration into the vehicle's manifest, then reads the result back and checks it.
///
/// # Errors
///
/// A sentence: a file cannot be read, or the manifest with the new values is not valid.
pub(super) fn edit(vehicle: &Vehicle, found: &Calibration) -> Result<Edited, String> {
    let path = vehicle.manifest_file();
    let read = |path: &std::path::Path| {
        fs::read_to_string(path)
            .map_err(|error| format!("{} cannot be read: {error}", path.display()))
    };
    let (manifest, network) = (read(&path)?, read(&vehicle.network_file())?);
    let wrong = |what: &str| format!("{}: {what}", path.display());
    let document = |text: &str| -> Result<DocumentMut, String> {
        let syntax = |error: toml_edit::TomlError| wrong(&error.message().replace('\n', "; "));
        text.parse().map_err(syntax)
    };
    // What a variant does not say is as in the manifest of the other vehicle.
    let mut other = match vehicle.variant_of() {
        Some(_) => document(&read(&vehicle.crate_folder().join("vehicle.toml"))?)?,
        None => DocumentMut::new(),
    };
    let mut document = document(&manifest)?;
    let mut changes = Vec::new();
    for (field, to) in values(found) {
        if value(&mut document, field).is_none()
            && let Some(same) = value(&mut other, field)
        {
            insert(&mut document, field, same.as_str().unwrap_or_default());
        }
        let value =
            value(&mut document, field).ok_or_else(|| wrong(&format!("{field} is missing")))?;
        let from = value.as_str().unwrap_or_default().to_owned();
        let mut new = Value::from(to.as_str());
        // The decoration around a value holds its comment.
        *new.decor_mut() = value.decor().clone();
        *value = new;
        changes.push(Change { field, from, to });
    }
    let text = with_ends_of(&manifest, &document.to_string());
    Vehicle::parse(vehicle.name(), vehicle.folder(), &text, &network)
        .map_err(|error| format!("what was found is not accepted: {error}"))?;
    Ok(Edited { text, changes })
}

/// The new text with the line ends and the byte order mark of the old one, which `toml_edit`
/// does not keep.
fn with_ends_of(old: &str, new: &str) -> String {
    let mark = if old.starts_with('\u{feff}') {
        "\u{feff}"
    } else {
        ""
    };
    let new = new.replace("\r\n", "\n");
    if old.contains("\r\n") {
        format!("{mark}{}", new.replace('\n', "\r\n"))
    } else {
        format!("{mark}{new}")
    }
}

/// Puts a value at a path of keys with dots between them, in tables that may be missing.
fn insert(document: &mut DocumentMut, field: &str, to: &str) {
    let (tables, key) = field.rsplit_once('.').unwrap_or(("", field));
    let mut place: &mut Item = document.as_item_mut();
    for table in tables.split('.') {
        let missing = place.get(table).is_none();
        place = &mut place[table];
        if missing {
            *place = toml_edit::table();
        }
    }
    place[key] = toml_edit::value(to);
}

/// The value at a path of keys with dots between them.
fn value<'d>(document: &'d mut DocumentMut, field: &str) -> Option<&'d mut Value> {
    let mut item: &mut Item = document.as_item_mut();
    for key in field.split('.') {
        item = item.get_mut(key)?;
    }
    item.as_value_mut()
}

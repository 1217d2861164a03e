//! The folder of a variant: the numbers of a machine that has the nodes of another vehicle.

use std::fs;

use toml_edit::DocumentMut;
use vehicle_model::Vehicle;

use super::{Error, NameError, is_package_name};
use crate::{Failure, Workspace, vehicle};

/// What of a manifest is about the machine and its way.
const NUMBERS: [&str; 4] = ["machine", "rover", "mission", "waypoint"];

/// Weights of the steering, which were found for one machine.
const WEIGHTS: &str = "weights";

/// Writes the folder of a variant of `model`, with the numbers of the machine that it has.
///
/// # Errors
///
/// The name is not accepted, or `model` has no machine (exit code 2). A folder cannot be read or written.
pub fn create(workspace: &Workspace, model: &Vehicle, name: &str) -> Result<Vehicle, Failure> {
    let refused = |why| Error::Name {
        name: name.into(),
        why,
    };
    is_package_name(name).map_err(refused)?;
    if vehicle::names(workspace)?.iter().any(|other| other == name) {
        return Err(refused(NameError::Folder).into());
    }
    let file = model.manifest_file();
    let text = fs::read_to_string(&file).map_err(|error| Error::Copy {
        folder: model.folder().into(),
        error,
    })?;
    let text = numbers(&text, model.name(), name).ok_or_else(|| Error::NoMachine {
        model: model.name().into(),
    })?;
    let folder = model.folder().join("variants").join(name);
    let unwritable = |error| Error::Write {
        folder: folder.clone(),
        error,
    };
    fs::create_dir_all(&folder).map_err(unwritable)?;
    fs::write(folder.join("vehicle.toml"), text).map_err(unwritable)?;
    let made = vehicle::read(&folder);
    if made.is_err() {
        // It would be in the way of every command. What cannot be removed is told by the next one.
        let _ = fs::remove_dir_all(&folder);
    }
    Ok(made?)
}

/// The manifest of a variant: the numbers in the manifest of the other vehicle, with their comments.
fn numbers(manifest: &str, model: &str, name: &str) -> Option<String> {
    // It was read as a vehicle's before.
    let mut document: DocumentMut = manifest.parse().ok()?;
    document.retain(|key, _| NUMBERS.contains(&key));
    let machine = document.get_mut("machine");
    let machine = machine.and_then(|machine| machine.as_table_like_mut());
    let weights = machine.and_then(|machine| machine.remove(WEIGHTS));
    if !document.contains_key("machine") && !document.contains_key("rover") {
        return None;
    }
    let without = match weights {
        None => "",
        Some(_) => {
            "# The weights of the steering were found for the other machine; without them, they are derived from\n\
             # the numbers below.\nwithout = [\"machine.weights\"]\n\n"
        }
    };
    Some(format!(
        "# A variant of {model}: what stands here counts in place of what ../../vehicle.toml says; everything else\n\
         # is as there, and may be left out here.\nsummary = \"{name}, a variant of {model}\"\n\n{without}{}",
        document.to_string().trim_start()
    ))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{text_of, workspace};
    use super::*;

    #[test]
    fn a_variant_has_the_numbers_of_the_other_machine_and_may_differ() {
        let (_folder, workspace) = workspace();
        let uagv = vehicle::find(&workspace, "uagv").unwrap();
        let made = create(&workspace, &uagv, "long-one").unwrap();
        assert_eq!((made.name(), made.variant_of()), ("long-one", Some("uagv")));
        let text = text_of(&made);
        for kept in ["rear_to_antenna = \"0.255 m\"", "[mission]", "[[waypoint]]"] {
            assert!(text.contains(kept), "{kept}");
        }
        for left in ["[machine.weights", "[[node]]", "[planner]"] {
            assert!(!text.contains(left), "{left}");
        }
        let mut own = uagv.manifest().machine.clone().unwrap();
        own.weights = None;
        assert_eq!(made.manifest().machine, Some(own));

        let longer = text.replace("0.845 m", "1.5 m");
        fs::write(made.manifest_file(), longer).unwrap();
        let made = vehicle::find(&workspace, "long-one").unwrap();
        let machine = made.manifest().machine.as_ref().unwrap();
        assert!((machine.antenna_to_front.get() - 1.5).abs() < 1e-12);
        assert_eq!(vehicle::package(&made).unwrap(), "uagv");
    }

    #[test]
    fn a_variant_that_cannot_be_is_refused_in_one_sentence() {
        let (_folder, workspace) = workspace();
        let refusal = |model: &str, name: &str| {
            let model = vehicle::find(&workspace, model).unwrap();
            let failure = create(&workspace, &model, name).unwrap_err();
            assert_eq!(failure.exit_code(), 2, "{failure}");
            failure.to_string()
        };
        assert!(refusal("uagv", "A").contains("lower-case letters"));
        assert!(refusal("uagv", "two-boards").contains("there is such a folder already"));
        let told = refusal("two-boards", "bench");
        assert_eq!(
            told,
            "two-boards has no machine whose numbers a variant could have: --like uagv or another vehicle \
                          with [machine] or [rover] is accepted"
        );
        assert_eq!(vehicle::names(&workspace).unwrap().len(), 2);
    }
}

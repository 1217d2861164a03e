//! The vehicles of the workspace and their nodes, by the names on the command line.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use parts::Sled;
use vehicle_model::{NetworkText, NodeIndex, Overrides, Vehicle, VehicleError};

use crate::Workspace;

/// Why a vehicle or a node cannot be used: the command line or the vehicle's folder is wrong.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no such vehicle, or its folder is wrong.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The vehicle has no such node.
    #[error("vehicle {vehicle} has no node {node}, but {known}; {remedy}")]
    NoNode {
        /// The vehicle.
        vehicle: String,
        /// The name.
        node: String,
        /// The nodes that there are.
        known: String,
        /// How to name another vehicle, or to switch the node on.
        remedy: String,
    },
    /// A bus guardian takes no part in what is asked.
    #[error("{node} is the bus guardian, which {why}: {known} are accepted")]
    Guardian {
        /// The guardian.
        node: String,
        /// Why it does not take part, as "has no self-test".
        why: &'static str,
        /// The nodes that do.
        known: String,
    },
    /// No vehicle has such a node.
    #[error("there is no node {node}: there are {known}{remedy}")]
    NoNodeAnywhere {
        /// The name.
        node: String,
        /// The nodes of each vehicle.
        known: String,
        /// How to name a variant that has it, or to switch it on; empty if nothing does.
        remedy: String,
    },
    /// Several vehicles have such a node.
    #[error("more than one vehicle has a node {node}: which one, {choices}?")]
    WhichVehicle {
        /// The name.
        node: String,
        /// The options that name each vehicle.
        choices: String,
    },
    /// Several vehicles may be on a bus.
    #[error("more than one vehicle may be on {bus}: which one, {choices}?")]
    WhichOnBus {
        /// The bus.
        bus: String,
        /// The options that name each vehicle.
        choices: String,
    },
    /// A node's program is for another board.
    #[error(
        "{key}: the program of {node} is written for {accepted}, and {board} is no board of it"
    )]
    Board {
        /// The key of its board in the manifest.
        key: String,
        /// The node.
        node: String,
        /// The board that it is to be built for.
        board: &'static str,
        /// Those that its program is for.
        accepted: String,
    },
    /// The package of a vehicle cannot be read.
    #[error("{}: {why}", path.display())]
    Package {
        /// Its manifest.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        why: PackageError,
    },
}

/// What is wrong with the manifest of a package.
#[derive(Debug, thiserror::Error)]
pub enum PackageError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] io::Error),
    /// It is no TOML.
    #[error("{}", .0.to_string().replace('\n', "; "))]
    Syntax(#[from] toml::de::Error),
    /// A name is missing.
    #[error("it names no package")]
    NoName,
}

/// The vehicle of a command that names none.
pub const DEFAULT: &str = "uagv";

/// The vehicle with the fewest nodes: what a new one is copied from when nothing else is named.
pub const SMALLEST: &str = "two-boards";

/// Reads the vehicle of that name.
///
/// # Errors
///
/// There is none, or its folder is wrong.
pub fn find(workspace: &Workspace, name: &str) -> Result<Vehicle, Error> {
    Ok(Vehicle::find(&workspace.vehicles(), name)?)
}

/// Reads the vehicle of that name, with other values than its manifest has.
///
/// # Errors
///
/// There is none, its folder is wrong, or one of the values makes no sense.
pub fn with(workspace: &Workspace, name: &str, overrides: &Overrides) -> Result<Vehicle, Error> {
    Ok(Vehicle::find_with(&workspace.vehicles(), name, overrides)?)
}

/// The only vehicle, which is therefore on this bus, with other values than its manifest has.
///
/// # Errors
///
/// There are several vehicles, the folder of the only one is wrong, or one of the values makes no
/// sense.
pub fn on_bus(workspace: &Workspace, bus: &str, overrides: &Overrides) -> Result<Vehicle, Error> {
    match names(workspace)?.as_slice() {
        [] => find(workspace, DEFAULT),
        [only] => with(workspace, only, overrides),
        several => Err(Error::WhichOnBus {
            bus: bus.into(),
            choices: choices(several.iter().map(String::as_str)),
        }),
    }
}

/// The options that name each of the vehicles.
fn choices<'v>(names: impl Iterator<Item = &'v str>) -> String {
    let options: Vec<String> = names.map(|name| format!("--vehicle {name}")).collect();
    options.join(" or ")
}

/// The network file of the vehicle `name` of the workspace; its messages may have no windows.
///
/// # Errors
///
/// There is no vehicle of that name, or its folder is wrong.
pub fn network_text(
    workspace: &Workspace,
    name: &str,
    overrides: &Overrides,
) -> Result<NetworkText, Error> {
    Ok(Vehicle::network_text_of(
        &workspace.vehicles(),
        name,
        overrides,
    )?)
}

/// The names of the workspace's vehicles.
///
/// # Errors
///
/// Their folder cannot be read.
pub fn names(workspace: &Workspace) -> Result<Vec<String>, Error> {
    Ok(Vehicle::names(&workspace.vehicles())?)
}

/// Reads the vehicle of a folder.
///
/// # Errors
///
/// The folder is wrong.
pub fn read(folder: &Path) -> Result<Vehicle, Error> {
    Ok(Vehicle::read(folder)?)
}

/// The nodes of these names in the order of the manifest; all when none is named.
///
/// # Errors
///
/// The vehicle has no node of one of the names.
pub fn nodes(vehicle: &Vehicle, names: &[String]) -> Result<Vec<NodeIndex>, Error> {
    if names.is_empty() {
        return Ok(vehicle.nodes().collect());
    }
    let mut nodes = Vec::new();
    for name in names {
        let node = vehicle.find_node(name);
        nodes.push(node.ok_or_else(|| no_node(vehicle, name))?);
    }
    nodes.sort();
    nodes.dedup();
    Ok(nodes)
}

/// As [`nodes`], of those that send: all but the bus guardian when none is named. `why` says why a guardian is
/// refused, as "has no self-test".
///
/// # Errors
///
/// The vehicle has no node of one of the names, or that node is the bus guardian.
pub fn participants(
    vehicle: &Vehicle,
    names: &[String],
    why: &'static str,
) -> Result<Vec<NodeIndex>, Error> {
    if names.is_empty() {
        return Ok(vehicle.participants().collect());
    }
    let nodes = nodes(vehicle, names)?;
    let mut named = nodes.iter();
    named.try_for_each(|&node| no_guardian(vehicle, node, why))?;
    Ok(nodes)
}

/// Refuses the bus guardian. `why` says why it does not take part, as "has no self-test".
///
/// # Errors
///
/// The node is the bus guardian.
pub fn no_guardian(vehicle: &Vehicle, node: NodeIndex, why: &'static str) -> Result<(), Error> {
    if vehicle.guardian() != Some(node) {
        return Ok(());
    }
    let name = |node| vehicle.node(node).name.clone();
    let known: Vec<String> = vehicle.participants().map(name).collect();
    Err(Error::Guardian {
        node: name(node),
        why,
        known: known.join(", "),
    })
}

/// The names of a vehicle's nodes, in order.
#[must_use]
pub fn node_names(vehicle: &Vehicle) -> Vec<String> {
    let nodes = vehicle.manifest().nodes.iter();
    nodes.map(|node| node.name.clone()).collect()
}

/// The one vehicle that has a node of this name, and the node. `vehicle` names the vehicle when
/// several have one; a variant is meant only when it is named. The vehicle has other values than its manifest,
/// which may switch the node on.
///
/// # Errors
///
/// No vehicle has such a node, several have one and none is named, or a value makes no sense.
pub fn with_node(
    workspace: &Workspace,
    node: &str,
    vehicle: Option<&str>,
    overrides: &Overrides,
) -> Result<(Vehicle, NodeIndex), Error> {
    if let Some(name) = vehicle {
        let vehicle = with(workspace, name, overrides)?;
        let index = vehicle.find_node(node);
        let index = index.ok_or_else(|| no_node(&vehicle, node))?;
        return Ok((vehicle, index));
    }
    let mut having = Vec::new();
    let mut known = Vec::new();
    let mut remedies = Vec::new();
    for name in names(workspace)? {
        // The values are another vehicle's if this one refuses them.
        let changed = with(workspace, &name, overrides);
        let refused = changed.is_err();
        let vehicle = changed.or_else(|_| find(workspace, &name))?;
        if vehicle.variant_of().is_some() {
            if vehicle.find_node(node).is_some() {
                remedies.push(names_variant(&name));
            }
            continue;
        }
        remedies.extend(switch(&vehicle, node));
        known.push(format!("{} of {name}", node_names(&vehicle).join(", ")));
        if let Some(index) = vehicle.find_node(node) {
            having.push((vehicle, index, refused));
        }
    }
    let choices = choices(having.iter().map(|(vehicle, _, _)| vehicle.name()));
    match (having.pop(), having.is_empty()) {
        (Some((vehicle, index, false)), true) => Ok((vehicle, index)),
        (Some((vehicle, index, true)), true) => {
            Ok((with(workspace, vehicle.name(), overrides)?, index))
        }
        (Some(_), false) => Err(Error::WhichVehicle {
            node: node.into(),
            choices,
        }),
        (None, _) => Err(Error::NoNodeAnywhere {
            node: node.into(),
            known: known.join("; "),
            remedy: match remedies.as_slice() {
                [] => String::new(),
                some => format!("; {}", some.join(" or ")),
            },
        }),
    }
}

/// Says that a variant has the node.
fn names_variant(name: &str) -> String {
    format!("--vehicle {name} names a variant that has it")
}

/// Names the option that switches a node on which is off in the vehicle's manifest.
fn switch(vehicle: &Vehicle, node: &str) -> Option<String> {
    let manifest = vehicle.manifest();
    let rows = manifest.row_guidance.as_ref();
    let rows = rows.map(|rows| ("row_guidance", rows.enabled, &rows.node));
    let guardian = manifest.guardian.as_ref();
    let guardian = guardian.map(|guardian| ("guardian", guardian.enabled, &guardian.node));
    let mut switches = rows.into_iter().chain(guardian);
    let (table, ..) = switches.find(|(_, on, of)| !on && of.name == node)?;
    Some(format!("--set {table}.enabled=true switches it on"))
}

/// Says that a vehicle has no node of this name, and what to write instead.
fn no_node(vehicle: &Vehicle, node: &str) -> Error {
    let variants = variants_with(vehicle, node);
    let remedies: Vec<String> = switch(vehicle, node).into_iter().chain(variants).collect();
    Error::NoNode {
        vehicle: vehicle.name().into(),
        node: node.into(),
        known: node_names(vehicle).join(", "),
        remedy: match remedies.as_slice() {
            [] => "--vehicle chooses another vehicle".into(),
            some => some.join(" or "),
        },
    }
}

/// Names the options for those variants of a vehicle that have a node of this name.
fn variants_with(vehicle: &Vehicle, node: &str) -> Vec<String> {
    let base = vehicle.variant_of().unwrap_or(vehicle.name());
    // The folder of all vehicles. One that cannot be read has no remedy to offer.
    let Some(all) = vehicle.crate_folder().parent() else {
        return Vec::new();
    };
    let names = Vehicle::names(all).unwrap_or_default().into_iter();
    let found = names.filter_map(|name| Vehicle::find(all, &name).ok());
    let having =
        found.filter(|one| one.variant_of() == Some(base) && one.find_node(node).is_some());
    having.map(|one| names_variant(one.name())).collect()
}

/// The board of a node.
///
/// # Panics
///
/// Never for a vehicle that was read: its boards are checked.
#[must_use]
pub fn board(vehicle: &Vehicle, node: NodeIndex) -> &'static Sled {
    vehicle.board(node)
}

/// The package that builds a vehicle's images.
///
/// # Errors
///
/// Its manifest cannot be read.
pub fn package(vehicle: &Vehicle) -> Result<String, Error> {
    let manifest = vehicle.crate_folder().join("Cargo.toml");
    let table = package_table(&manifest)?;
    let name = table
        .get("package")
        .and_then(|package| package.get("name")?.as_str());
    name.map(str::to_owned).ok_or(Error::Package {
        path: manifest,
        why: PackageError::NoName,
    })
}

/// The manifest of a package.
fn package_table(manifest: &Path) -> Result<toml::Table, Error> {
    let wrong = |why| Error::Package {
        path: manifest.to_owned(),
        why,
    };
    let text = fs::read_to_string(manifest).map_err(|error| wrong(PackageError::Read(error)))?;
    text.parse()
        .map_err(|error| wrong(PackageError::Syntax(error)))
}

/// The key of a node's board in the manifest: a node that is switched on has a table of its own.
fn board_key(vehicle: &Vehicle, node: NodeIndex) -> String {
    let rows = vehicle.manifest().guidance_by_rows();
    let is_rows = rows.is_some_and(|rows| rows.node.name == vehicle.node(node).name);
    if vehicle.guardian() == Some(node) {
        "guardian.node.board".into()
    } else if is_rows {
        "row_guidance.node.board".into()
    } else {
        format!("node.{}.board", node.0)
    }
}

/// Checks that the programs of these nodes are written for their boards: the package says it in the features that
/// a program requires.
///
/// # Errors
///
/// One is not, or the package cannot be read.
pub fn check_boards(vehicle: &Vehicle, nodes: &[NodeIndex]) -> Result<(), Error> {
    let table = package_table(&vehicle.crate_folder().join("Cargo.toml"))?;
    let programs = table.get("bin").and_then(toml::Value::as_array);
    for &node in nodes {
        let (name, board) = (&vehicle.node(node).name, board(vehicle, node).name);
        let mut programs = programs.into_iter().flatten();
        let of_node =
            |one: &&toml::Value| one.get("name").and_then(toml::Value::as_str) == Some(name);
        let features = programs
            .find(of_node)
            .and_then(|program| program.get("required-features")?.as_array());
        let features = features
            .into_iter()
            .flatten()
            .filter_map(toml::Value::as_str);
        let boards: Vec<&str> = features
            .filter(|feature| Sled::ALL.iter().any(|sled| sled.name == *feature))
            .collect();
        if !boards.is_empty() && !boards.contains(&board) {
            return Err(Error::Board {
                key: board_key(vehicle, node),
                node: name.clone(),
                board,
                accepted: boards.join(" and "),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Failure;

    fn uagv() -> Vehicle {
        find(&Workspace::find().unwrap(), DEFAULT).unwrap()
    }

    /// A workspace with copies of the vehicle under these names.
    fn workspace(names: &[&str]) -> (tempfile::TempDir, Workspace) {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            let to = folder.path().join("firmware/vehicles").join(name);
            fs::create_dir_all(to.join("nodes")).unwrap();
            let mut files = vec![uagv().manifest_file(), uagv().network_file()];
            files.extend(uagv().nodes().map(|node| uagv().source(node)));
            for file in files {
                let inside = file.strip_prefix(uagv().folder()).unwrap().to_owned();
                fs::copy(file, to.join(inside)).unwrap();
            }
        }
        let workspace = Workspace::at(folder.path());
        (folder, workspace)
    }

    #[test]
    fn nodes_are_named_in_any_order() {
        let vehicle = uagv();
        let named = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            nodes(&vehicle, &names)
        };
        assert_eq!(named(&[]).unwrap().len(), 4);
        assert_eq!(
            named(&["drive", "gps", "drive"]).unwrap(),
            [NodeIndex(0), NodeIndex(3)]
        );
        let failure = Failure::from(named(&["gps", "rudder"]).unwrap_err());
        assert_eq!(failure.exit_code(), 2);
        assert_eq!(
            failure.to_string(),
            "vehicle uagv has no node rudder, but gps, controller, steering, drive; --vehicle \
             chooses another vehicle"
        );
    }

    #[test]
    fn a_node_is_found_in_the_vehicle_that_has_it() {
        let (_folder, workspace) = workspace(&["uagv"]);
        let none = &Overrides::default();
        let (vehicle, node) = with_node(&workspace, "steering", None, none).unwrap();
        assert_eq!((vehicle.name(), node), ("uagv", NodeIndex(2)));
        let failure = with_node(&workspace, "rudder", None, none).unwrap_err();
        assert!(
            failure.to_string().contains("steering, drive of uagv"),
            "{failure}"
        );
        let failure = with_node(&workspace, "gps", Some("plough"), none).unwrap_err();
        assert!(
            failure.to_string().contains("there is no vehicle"),
            "{failure}"
        );
    }

    #[test]
    fn what_gives_a_vehicle_the_node_is_named() {
        let workspace = Workspace::find().unwrap();
        let none = &Overrides::default();
        let refused = |node: &str, vehicle: Option<&str>| {
            let error = with_node(&workspace, node, vehicle, none).unwrap_err();
            error.to_string()
        };
        let text = refused("sentry", None);
        assert!(
            text.ends_with("uagv; --vehicle sentry names a variant that has it"),
            "{text}"
        );
        let text = refused("guardian", None);
        let switch = "--set guardian.enabled=true switches it on";
        assert!(text.ends_with(&format!("uagv; {switch}")), "{text}");
        let text = refused("rows", Some("uagv"));
        let switch_rows = "drive; --set row_guidance.enabled=true switches it on";
        assert!(text.ends_with(switch_rows), "{text}");
        let text = nodes(&uagv(), &["guardian".into()])
            .unwrap_err()
            .to_string();
        assert!(text.ends_with(&format!("drive; {switch}")), "{text}");
        let text = refused("sentry", Some("uagv"));
        assert!(
            text.ends_with("drive; --vehicle sentry names a variant that has it"),
            "{text}"
        );
        let text = refused("rudder", Some("uagv"));
        assert!(
            text.ends_with("--vehicle chooses another vehicle"),
            "{text}"
        );
    }

    #[test]
    fn all_nodes_but_the_guardian_take_part() {
        let workspace = Workspace::find().unwrap();
        let sentry = find(&workspace, "sentry").unwrap();
        let asked = |names: &[String]| participants(&sentry, names, "has no self-test");
        let four: Vec<NodeIndex> = (0..4).map(NodeIndex).collect();
        assert_eq!(asked(&[]).unwrap(), four);
        assert_eq!(asked(&["drive".into()]).unwrap(), [NodeIndex(3)]);
        assert_eq!(
            asked(&["gps".into(), "sentry".into()])
                .unwrap_err()
                .to_string(),
            "sentry is the bus guardian, which has no self-test: gps, controller, steering, drive are accepted"
        );
    }

    #[test]
    fn a_node_that_two_vehicles_have_is_asked_back() {
        let (_folder, workspace) = workspace(&["one", "two"]);
        let none = &Overrides::default();
        let failure = Failure::from(with_node(&workspace, "gps", None, none).unwrap_err());
        assert_eq!(failure.exit_code(), 2);
        assert_eq!(
            failure.to_string(),
            "more than one vehicle has a node gps: which one, --vehicle one or --vehicle two?"
        );
        let (vehicle, _) = with_node(&workspace, "gps", Some("two"), none).unwrap();
        assert_eq!(vehicle.name(), "two");
    }

    #[test]
    fn a_node_that_a_value_switches_on_is_found() {
        let workspace = Workspace::find().unwrap();
        let set = |text| Overrides::parse(text).unwrap();
        let on = set("row_guidance.enabled=true");
        for vehicle in [None, Some("uagv")] {
            let (found, node) = with_node(&workspace, "rows", vehicle, &on).unwrap();
            assert_eq!(
                (found.name(), &*found.node(node).name, found.overrides()),
                ("uagv", "rows", &on)
            );
        }
        with_node(&workspace, "rows", None, &Overrides::default()).unwrap_err();
        // Only one vehicle accepts the value, but only its own nodes are built with it.
        let law = set("rover.law=thesis");
        let (found, _) = with_node(&workspace, "feedback", None, &law).unwrap();
        assert_eq!((found.name(), found.overrides()), ("row-follower", &law));
        let failure = Failure::from(with_node(&workspace, "gps", None, &law).unwrap_err());
        assert_eq!(failure.exit_code(), 2);
        assert!(
            failure.to_string().contains("rover.law=thesis"),
            "{failure}"
        );
    }

    #[test]
    fn only_one_vehicle_can_be_on_a_bus_without_a_choice() {
        let (_folder, workspace) = workspace(&["plough"]);
        let vehicle = on_bus(&workspace, "socketcan:can0", &Overrides::default()).unwrap();
        assert_eq!(vehicle.name(), "plough");
    }

    /// Before cargo says it in words that nobody understands who only chose a board.
    #[test]
    fn a_board_that_a_program_is_not_written_for_is_refused() {
        let workspace = Workspace::find().unwrap();
        let set = vehicle_model::Override::parse("node.0.board=f303").into_iter();
        let vehicle = with(&workspace, SMALLEST, &set.collect()).unwrap();
        let nodes: Vec<NodeIndex> = vehicle.nodes().collect();
        let error = check_boards(&vehicle, &nodes).unwrap_err();
        assert_eq!(
            error.to_string(),
            "node.0.board: the program of master is written for f446, and f303 is no board of it"
        );
        assert_eq!(Failure::from(error).exit_code(), 2);
        for name in Vehicle::names(&workspace.vehicles()).unwrap() {
            let vehicle = find(&workspace, &name).unwrap();
            let nodes: Vec<NodeIndex> = vehicle.nodes().collect();
            assert!(check_boards(&vehicle, &nodes).is_ok(), "{name}");
        }
    }
}

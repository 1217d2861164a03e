//! `build`: builds the release images of the nodes, measures and audits them.

mod inputs;

use std::{
    fs, io,
    path::{Path, PathBuf},
    process::{self, Command, Stdio},
};

use serde_json::Value;

use parts::Sled;
use vehicle_model::{
    NodeIndex, Vehicle,
    build::{OVERRIDES, VARIANT},
};

use crate::{
    Failure, ReadError, Workspace, audit,
    build::inputs::Inputs,
    cli::Build,
    interrupt, seal,
    size::{self, Size},
    target, vehicle,
};

/// Why a build fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The images break rules, one sentence each.
    #[error("{}", .0.join("; "))]
    Complaints(Vec<String>),
    /// There is no cargo to build with.
    #[error("cargo cannot be run: {0}")]
    NoCargo(#[source] io::Error),
    /// The compiler refused them.
    #[error("{} did not build", nodes.join(", "))]
    NotBuilt {
        /// The nodes.
        nodes: Vec<String>,
    },
    /// The build left nothing.
    #[error("cargo built no image for {node}")]
    NoImage {
        /// The node.
        node: String,
    },
    /// The image cannot be put in its vehicle's folder.
    #[error("the image of {node} cannot be put in {}: {error}", folder.display())]
    NotKept {
        /// The node.
        node: String,
        /// The folder.
        folder: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
}

/// A release image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// The node it is for.
    pub node: NodeIndex,
    /// The node's name.
    pub name: String,
    /// The node's board.
    pub board: &'static Sled,
    /// The ELF file.
    pub path: PathBuf,
}

/// Runs the command for the named nodes, or for all of them.
///
/// # Errors
///
/// The vehicle or a node does not exist (exit code 2); an image does not build, is larger
/// than its board's budget, or may panic.
pub fn run(workspace: &Workspace, options: &Build) -> Result<(), Failure> {
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
    let nodes = vehicle::nodes(&vehicle, &options.nodes)?;
    let images = images(workspace, &vehicle, &nodes)?;
    let Checked { sizes, complaints } = check(&vehicle, &images)?;
    if options.json {
        println!("{}", size::json(&sizes));
    } else {
        print!("{}", size::table(&sizes));
    }
    match complaints.as_slice() {
        [] => Ok(()),
        complaints => Err(Error::Complaints(complaints.to_vec()).into()),
    }
}

/// Result of measuring and auditing images.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Checked {
    /// The size of each image.
    pub sizes: Vec<Size>,
    /// Findings, one sentence each.
    pub complaints: Vec<String>,
}

/// Measures and audits images.
///
/// # Errors
///
/// A file cannot be read or is not an image for its node's board.
pub fn check(vehicle: &Vehicle, images: &[Image]) -> Result<Checked, Failure> {
    let mut sizes = Vec::new();
    let mut complaints = Vec::new();
    for image in images {
        let mut usage = size::measure(&image.path, image.board)?;
        let source = vehicle.source(image.node);
        let app = audit::application(&source)?;
        let audit = audit::audit(&image.path, &app)?;
        usage.deepest = audit.deepest;
        let of_node = |complaint| format!("{}: {complaint}", image.name);
        complaints.extend(audit.complaints.into_iter().map(of_node));
        sizes.push(Size {
            node: image.name.clone(),
            board: image.board,
            usage,
        });
    }
    complaints.extend(size::excess(&sizes));
    Ok(Checked { sizes, complaints })
}

/// Builds the release images of these nodes. The result is in the order of the manifest.
///
/// # Errors
///
/// The target is missing, or an image does not build.
pub fn images(
    workspace: &Workspace,
    vehicle: &Vehicle,
    nodes: &[NodeIndex],
) -> Result<Vec<Image>, Failure> {
    vehicle::check_boards(vehicle, nodes)?;
    target::ensure(workspace)?;
    let mut images = Vec::new();
    for board in Sled::ALL {
        let on_board = |node: &NodeIndex| vehicle::board(vehicle, *node) == board;
        let nodes: Vec<NodeIndex> = nodes.iter().copied().filter(on_board).collect();
        if !nodes.is_empty() {
            let cargo = command(workspace, vehicle, &nodes)?;
            images.extend(finish(workspace, cargo, vehicle, &nodes)?);
        }
    }
    images.sort_by_key(|image| image.node);
    Ok(images)
}

/// The feature of a vehicle's crate without which it does not build the node that measures rows.
const ROW_GUIDANCE: &str = "row-guidance";

/// The same for the bus guardian.
const GUARDIAN: &str = "guardian";

/// The cargo command that builds the images of nodes that have one board.
///
/// # Errors
///
/// The vehicle's package cannot be read.
pub fn command(
    workspace: &Workspace,
    vehicle: &Vehicle,
    nodes: &[NodeIndex],
) -> Result<Command, Failure> {
    let mut cargo = target::cargo(workspace, "build");
    cargo.arg("--release");
    let Some(&first) = nodes.first() else {
        cargo.args(["--package", &vehicle::package(vehicle)?]);
        return Ok(cargo);
    };
    let mut cargo = with_features(cargo, vehicle, first)?;
    for &node in nodes {
        cargo.args(["--bin", &vehicle.node(node).name]);
    }
    Ok(cargo)
}

/// A command of cargo on a vehicle's package, with the features and the values of the images that have
/// the board of `node`.
///
/// # Errors
///
/// The vehicle's package cannot be read.
pub(crate) fn with_features(
    mut cargo: Command,
    vehicle: &Vehicle,
    node: NodeIndex,
) -> Result<Command, Failure> {
    cargo.args(["--package", &vehicle::package(vehicle)?]);
    match vehicle.overrides() {
        none if none.is_empty() => cargo.env_remove(OVERRIDES),
        overrides => cargo.env(OVERRIDES, overrides.environment()),
    };
    match vehicle.variant_of() {
        None => cargo.env_remove(VARIANT),
        Some(_) => cargo.env(VARIANT, vehicle.name()),
    };
    cargo.args(["--features", vehicle::board(vehicle, node).name]);
    if vehicle.manifest().guidance_by_rows().is_some() {
        cargo.args(["--features", ROW_GUIDANCE]);
    }
    if vehicle.manifest().bus_guardian().is_some() {
        cargo.args(["--features", GUARDIAN]);
    }
    Ok(cargo)
}

/// The images that a [`command`] builds: those that are there if they are made of the same, else it runs.
///
/// # Errors
///
/// It does not succeed.
pub(crate) fn finish(
    workspace: &Workspace,
    mut cargo: Command,
    vehicle: &Vehicle,
    nodes: &[NodeIndex],
) -> Result<Vec<Image>, Failure> {
    // Without them, cargo decides.
    let inputs = Inputs::of(workspace, &cargo).ok();
    let images = workspace.target().join(target::TRIPLE).join(IMAGES);
    let there = images.join(folder_name(vehicle));
    let name = |node: NodeIndex| vehicle.node(node).name.clone();
    let image = |node, path| Image {
        node,
        name: name(node),
        board: vehicle::board(vehicle, node),
        path,
    };
    let made = || -> Option<Vec<Image>> {
        let inputs = inputs.as_ref()?;
        let made = |&node: &NodeIndex| inputs.made(&there, &name(node));
        let images = nodes
            .iter()
            .map(|&node| image(node, there.join(name(node))));
        nodes.iter().all(made).then(|| images.collect())
    };
    if let Some(images) = made() {
        return Ok(images);
    }
    let _alone = workspace.builds_alone();
    // Another program may have built them meanwhile.
    if let Some(images) = made() {
        return Ok(images);
    }
    cargo.arg("--message-format=json-render-diagnostics");
    let messages = messages(cargo)?.ok_or_else(|| Error::NotBuilt {
        nodes: nodes.iter().map(|&node| name(node)).collect(),
    })?;
    let keep = |&node: &NodeIndex| {
        let node_name = name(node);
        let Some(built) = executable(&messages, &node_name) else {
            return Err(Error::NoImage { node: node_name });
        };
        let folder = images_folder(&built).join(folder_name(vehicle));
        let kept = keep(&built, &folder, &node_name).and_then(|path| {
            if let Some(inputs) = &inputs {
                inputs.keep(&folder, &node_name)?;
            }
            Ok(path)
        });
        let node_name = name(node);
        let path = kept.map_err(|error| Error::NotKept {
            node: node_name,
            folder,
            error,
        })?;
        Ok(image(node, path))
    };
    Ok(nodes.iter().map(keep).collect::<Result<Vec<_>, Error>>()?)
}

/// What a command of cargo prints; `None` if it does not succeed.
fn messages(mut cargo: Command) -> Result<Option<String>, Error> {
    let cargo = cargo
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .map_err(Error::NoCargo)?;
    let pid = cargo.id();
    interrupt::end_together(pid);
    let output = cargo.wait_with_output().map_err(Error::NoCargo);
    interrupt::end_alone(pid);
    let output = output?;
    let succeeded = output.status.success();
    Ok(succeeded.then(|| String::from_utf8_lossy(&output.stdout).into_owned()))
}

/// Name of the folder of all images, beside those in which cargo builds.
const IMAGES: &str = "images";

/// Name of the folder of a vehicle's images. Cargo has one place for all vehicles, in which a node
/// of the same name overwrites another vehicle's. Images of other values than the manifest's have a
/// folder of their own.
fn folder_name(vehicle: &Vehicle) -> String {
    match vehicle.overrides() {
        none if none.is_empty() => vehicle.name().into(),
        overrides => format!("{}+{}", vehicle.name(), overrides.folder_name()),
    }
}

/// The folder of all images, beside that in which cargo has `built` one.
pub(crate) fn images_folder(built: &Path) -> PathBuf {
    let target = built.ancestors().nth(2).unwrap_or(built);
    target.join(IMAGES)
}

/// Copies an image into a folder, and seals it for its self-test. Nobody there sees half of it.
pub(crate) fn keep(built: &Path, folder: &Path, node: &str) -> io::Result<PathBuf> {
    fs::create_dir_all(folder)?;
    let path = folder.join(node);
    let draft = folder.join(format!(".{node}.{}", process::id()));
    let mut image = fs::read(built)?;
    seal::seal(&mut image).map_err(io::Error::other)?;
    fs::write(&draft, image)?;
    fs::rename(&draft, &path)?;
    Ok(path)
}

/// Reads images for the virtual vehicle. There must be one for each node.
///
/// # Errors
///
/// A file cannot be read.
pub fn read(images: &[Image]) -> Result<twin::Images, Failure> {
    let read = |image: &Image| fs::read(&image.path).map_err(ReadError::of(&image.path));
    let files: Result<Vec<_>, ReadError> = images.iter().map(read).collect();
    Ok(twin::Images::new(files?))
}

/// The executable of this name among cargo's messages, one JSON object a line.
pub(crate) fn executable(messages: &str, name: &str) -> Option<PathBuf> {
    messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["reason"] == "compiler-artifact")
        .filter(|message| message["target"]["name"] == name)
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle_model::{Overrides, Protocol};

    #[test]
    fn nodes_of_one_name_keep_their_images_apart() {
        let workspace = Workspace::find().unwrap();
        let target = tempfile::tempdir().unwrap();
        let built = target.path().join("release/gps");
        fs::create_dir(target.path().join("release")).unwrap();
        // Images of different size: an ELF file without anything in it, and bytes behind it.
        let image = |behind: usize| {
            let mut file = b"\x7fELF\x01\x01\x01".to_vec();
            file.resize(52 + behind, 0);
            // An executable for ARM, version 1, with a header of 52 bytes.
            file[16..24].copy_from_slice(&[2, 0, 40, 0, 1, 0, 0, 0]);
            file[40] = 52;
            file
        };
        let keep = |name: &str, behind: usize| {
            fs::write(&built, image(behind)).unwrap();
            let vehicle = vehicle::find(&workspace, name).unwrap();
            let folder = images_folder(&built).join(folder_name(&vehicle));
            super::keep(&built, &folder, "gps").unwrap()
        };
        let (one, other) = (keep("uagv", 1), keep("two-boards", 2));
        let event = Overrides::default().on(Protocol::EventTriggered);
        let event = vehicle::with(&workspace, "two-boards", &event).unwrap();
        assert_eq!(
            folder_name(&event),
            "two-boards+bus.protocol=event-triggered"
        );
        assert_eq!(one, target.path().join("images/uagv/gps"));
        assert_eq!(fs::read(&one).unwrap(), image(1));
        assert_eq!(fs::read(&other).unwrap(), image(2));
        let images = fs::read_dir(one.parent().unwrap()).unwrap();
        assert_eq!(images.count(), 1, "a draft is left");
    }

    #[test]
    fn the_executable_is_found_among_the_messages_of_cargo() {
        let messages = r#"
{"reason":"compiler-artifact","target":{"name":"gps"},"executable":null}
{"reason":"compiler-artifact","target":{"name":"drive"},"executable":"/t/drive"}
{"reason":"compiler-artifact","target":{"name":"gps"},"executable":"/t/gps"}
{"reason":"build-finished","success":true}
"#;
        assert_eq!(executable(messages, "gps"), Some(PathBuf::from("/t/gps")));
        assert_eq!(executable(messages, "steering"), None);
    }
}

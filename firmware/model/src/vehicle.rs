//! A vehicle as its folder describes it.

use std::fs;
use std::path::{Path, PathBuf};

use network_model::Network;
use parts::Sled;

use crate::check;
use crate::design;
use crate::error::VehicleError;
use crate::manifest::{Device, MISSION, Manifest, Node, Protocol};
use crate::overrides::Overrides;
use crate::text;

/// Name of the manifest in a vehicle's folder.
const MANIFEST: &str = "vehicle.toml";
/// Name of the network file in it.
const NETWORK: &str = "network.dbc";

/// The index of a node in [`Manifest::nodes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeIndex(pub usize);

/// A vehicle, read and checked.
#[derive(Clone, Debug)]
pub struct Vehicle {
    name: String,
    folder: PathBuf,
    manifest: Manifest,
    network: Network,
    /// Values in place of the manifest's.
    overrides: Overrides,
}

impl Vehicle {
    /// Names of the vehicles below `vehicles`, in alphabetical order: every folder with a
    /// manifest.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn names(vehicles: &Path) -> Result<Vec<String>, VehicleError> {
        let unreadable = |error| VehicleError::Unreadable {
            file: vehicles.into(),
            error,
        };
        let entries = fs::read_dir(vehicles).map_err(unreadable)?;
        let folders = entries.flatten().map(|entry| entry.path());
        let mut names: Vec<String> = folders
            .filter(|folder| folder.join(MANIFEST).is_file())
            .filter_map(|folder| Some(folder.file_name()?.to_str()?.to_owned()))
            .collect();
        names.sort();
        Ok(names)
    }

    /// Reads the vehicle `name` below `vehicles`.
    ///
    /// # Errors
    /// There is none of that name, or its folder is wrong.
    pub fn find(vehicles: &Path, name: &str) -> Result<Self, VehicleError> {
        Self::find_with(vehicles, name, &Overrides::default())
    }

    /// The same with other values than its manifest has.
    ///
    /// # Errors
    /// As [`Vehicle::find`], or one of the values makes no sense.
    pub fn find_with(
        vehicles: &Path,
        name: &str,
        overrides: &Overrides,
    ) -> Result<Self, VehicleError> {
        Self::read_with(&Self::folder_of(vehicles, name)?, overrides)
    }

    /// The network file of the vehicle `name` below `vehicles`, with what a switched-on node adds
    /// to it. Its messages may still have no windows: they are not looked at.
    ///
    /// # Errors
    /// There is no vehicle of that name, a file cannot be read, or the manifest makes no sense.
    pub fn network_text_of(
        vehicles: &Path,
        name: &str,
        overrides: &Overrides,
    ) -> Result<NetworkText, VehicleError> {
        let folder = Self::folder_of(vehicles, name)?;
        let (manifest, _) = Self::manifest_with(&folder, &text(&folder, MANIFEST)?, overrides)?;
        Ok(NetworkText {
            text: supplemented(&folder, &manifest, &text(&folder, NETWORK)?)?,
            supplements: network_supplements(&folder, &manifest),
            file: folder.join(NETWORK),
        })
    }

    fn folder_of(vehicles: &Path, name: &str) -> Result<PathBuf, VehicleError> {
        let known = Self::names(vehicles)?;
        if known.iter().any(|other| other == name) {
            Ok(vehicles.join(name))
        } else {
            Err(VehicleError::Unknown {
                name: name.into(),
                known,
            })
        }
    }

    /// Reads the vehicle of a folder; the folder's name is the vehicle's.
    ///
    /// # Errors
    /// A file is missing, the source of a node included, or its contents make no sense.
    pub fn read(folder: &Path) -> Result<Self, VehicleError> {
        Self::read_with(folder, &Overrides::default())
    }

    /// The same with other values than its manifest has.
    ///
    /// # Errors
    /// As [`Vehicle::read`], or one of the values makes no sense.
    pub fn read_with(folder: &Path, overrides: &Overrides) -> Result<Self, VehicleError> {
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let (manifest, network) = (text(folder, MANIFEST)?, text(folder, NETWORK)?);
        let vehicle = Self::parse_with(&name, folder, &manifest, &network, overrides)?;
        let mut nodes = vehicle.nodes();
        match nodes.find(|&node| !vehicle.source(node).is_file()) {
            None => Ok(vehicle),
            Some(node) => Err(VehicleError::NoSource {
                file: vehicle.manifest_file(),
                node: vehicle.node(node).name.clone(),
            }),
        }
    }

    /// Makes a vehicle from the texts of its two files; errors name them below `folder`. The
    /// sources of the nodes are not looked for.
    ///
    /// # Errors
    /// Their contents make no sense.
    pub fn parse(
        name: &str,
        folder: &Path,
        manifest: &str,
        network: &str,
    ) -> Result<Self, VehicleError> {
        Self::parse_with(name, folder, manifest, network, &Overrides::default())
    }

    /// The same with other values than the manifest has. Values that change nothing do not count as
    /// such.
    ///
    /// # Errors
    /// As [`Vehicle::parse`], or one of the values makes no sense.
    pub fn parse_with(
        name: &str,
        folder: &Path,
        manifest: &str,
        network: &str,
        overrides: &Overrides,
    ) -> Result<Self, VehicleError> {
        let wrong = |what| refused(folder, overrides, what);
        let (manifest, effective) = Self::manifest_with(folder, manifest, overrides)?;
        check::guide(&manifest).map_err(wrong)?;
        let network = supplemented(folder, &manifest, network)?;
        let network = Network::parse(&network).map_err(|error| VehicleError::Network {
            file: folder.join(NETWORK),
            what: error.to_string().replace('\n', "; "),
        })?;
        check::check(&manifest, &network).map_err(wrong)?;
        check::bit_rate(&manifest, &network).map_err(|what| VehicleError::Network {
            file: folder.join(NETWORK),
            what,
        })?;
        let vehicle = Self {
            name: name.into(),
            folder: folder.into(),
            manifest,
            network,
            overrides: effective,
        };
        design::check(&vehicle).map_err(wrong)?;
        Ok(vehicle)
    }

    /// A manifest with other values than its text has, and those of them that change something.
    fn manifest_with(
        folder: &Path,
        manifest: &str,
        overrides: &Overrides,
    ) -> Result<(Manifest, Overrides), VehicleError> {
        let wrong = |what| refused(folder, overrides, what);
        let own = read_manifest(manifest);
        let (mut manifest, overrides) = if overrides.is_empty() {
            (own.map_err(wrong)?, overrides)
        } else {
            let changed = changed_manifest(manifest, overrides).map_err(wrong)?;
            match own {
                Ok(own) if own == changed => (own, &Overrides::default()),
                _ => (changed, overrides),
            }
        };
        manifest.complete();
        Ok((manifest, overrides.clone()))
    }

    /// When its messages are sent.
    #[must_use]
    pub fn protocol(&self) -> Protocol {
        self.manifest.bus.protocol
    }

    /// Whether its nodes send at once, without the schedule.
    #[must_use]
    pub fn is_event_triggered(&self) -> bool {
        self.protocol() == Protocol::EventTriggered
    }

    /// The values in place of its manifest's.
    #[must_use]
    pub fn overrides(&self) -> &Overrides {
        &self.overrides
    }

    /// Its name: the name of its folder.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What its manifest says.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What its network file says.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Time between two bursts of its satellite receiver, in whole microseconds; `None` if it
    /// has no receiver.
    #[must_use]
    pub fn receiver_period_us(&self) -> Option<u64> {
        let receiver = self.manifest.receiver.as_ref()?;
        Some(receiver.period.micros().into())
    }

    /// Path of its manifest.
    #[must_use]
    pub fn manifest_file(&self) -> PathBuf {
        self.folder.join(MANIFEST)
    }

    /// Path of its network file.
    #[must_use]
    pub fn network_file(&self) -> PathBuf {
        self.folder.join(NETWORK)
    }

    /// Paths of what adds to its network file because the manifest switches it on.
    #[must_use]
    pub fn network_supplements(&self) -> Vec<PathBuf> {
        network_supplements(&self.folder, &self.manifest)
    }

    /// Paths of what switched-on nodes add to its task table.
    #[must_use]
    pub fn task_supplements(&self) -> Vec<PathBuf> {
        let rows = self.manifest.guidance_by_rows();
        let rows = rows.map(|rows| rows.node.name.as_str());
        let guardian = self.manifest.bus_guardian();
        let guardian = guardian.map(|guardian| guardian.node.name.as_str());
        let mission = self.manifest.missions().map(|_| MISSION);
        let added = rows.into_iter().chain(guardian).chain(mission);
        added
            .map(|name| self.folder.join(format!("{name}.tasks.toml")))
            .collect()
    }

    /// The bus guardian, if it is on.
    #[must_use]
    pub fn guardian(&self) -> Option<NodeIndex> {
        self.find_node(&self.manifest.bus_guardian()?.node.name)
    }

    /// The nodes that the bus guardian guards, in the order of its board's taps; none if it is off.
    #[must_use]
    pub fn guarded(&self) -> Vec<NodeIndex> {
        let guardian = self.manifest.bus_guardian();
        let names = guardian.into_iter().flat_map(|guardian| &guardian.guards);
        names.filter_map(|name| self.find_node(name)).collect()
    }

    /// The nodes of the network file: all but the bus guardian, which sends nothing.
    pub fn participants(&self) -> impl Iterator<Item = NodeIndex> + use<> {
        let guardian = self.guardian();
        self.nodes().filter(move |&node| Some(node) != guardian)
    }

    /// Path of its task table.
    #[must_use]
    pub fn task_table(&self) -> PathBuf {
        self.folder.join("tasks.toml")
    }

    /// Path of a node's source.
    #[must_use]
    pub fn source(&self, node: NodeIndex) -> PathBuf {
        self.folder
            .join("nodes")
            .join(format!("{}.rs", self.node(node).name))
    }

    /// The indices of its nodes, in order.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = NodeIndex> + use<> {
        (0..self.manifest.nodes.len()).map(NodeIndex)
    }

    /// A node.
    ///
    /// # Panics
    /// If the index is another vehicle's and this vehicle has fewer nodes.
    #[must_use]
    pub fn node(&self, index: NodeIndex) -> &Node {
        &self.manifest.nodes[index.0]
    }

    /// The board of a node.
    ///
    /// # Panics
    /// If the index is another vehicle's and this vehicle has fewer nodes.
    #[must_use]
    pub fn board(&self, index: NodeIndex) -> &'static Sled {
        let name = &self.node(index).board;
        Sled::named(name).expect("the manifest's boards are checked")
    }

    /// The index of the node of that name.
    #[must_use]
    pub fn find_node(&self, name: &str) -> Option<NodeIndex> {
        self.nodes().find(|&node| self.node(node).name == name)
    }

    /// The node that a device is wired to.
    #[must_use]
    pub fn node_of(&self, device: Device) -> Option<NodeIndex> {
        self.nodes()
            .find(|&node| self.node(node).connector(device).is_some())
    }
}

/// The network file of a vehicle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkText {
    /// Its path.
    pub file: PathBuf,
    /// Paths of what adds to it because the manifest switches it on.
    pub supplements: Vec<PathBuf>,
    /// The text of all.
    pub text: String,
}

/// The text of a file of a folder.
fn text(folder: &Path, file: &str) -> Result<String, VehicleError> {
    let file = folder.join(file);
    fs::read_to_string(&file).map_err(|error| VehicleError::Unreadable { file, error })
}

/// Why the manifest of a folder is refused, with the values that it would have.
fn refused(folder: &Path, overrides: &Overrides, what: String) -> VehicleError {
    VehicleError::Manifest {
        file: folder.join(MANIFEST),
        what: match overrides.is_empty() {
            true => what,
            false => format!("with {overrides}: {what}"),
        },
    }
}

fn network_supplements(folder: &Path, manifest: &Manifest) -> Vec<PathBuf> {
    let names = manifest.supplements();
    names
        .map(|name| folder.join(format!("{name}.dbc")))
        .collect()
}

/// The text of the network file with what adds to it because the manifest switches it on.
fn supplemented(folder: &Path, manifest: &Manifest, network: &str) -> Result<String, VehicleError> {
    let mut files = network_supplements(folder, manifest).into_iter();
    files.try_fold(
        network.to_owned(),
        |network, file| match fs::read_to_string(&file) {
            Ok(text) => network_model::supplemented(&network, &text)
                .map_err(|what| VehicleError::Network { file, what }),
            Err(error) => Err(VehicleError::Unreadable { file, error }),
        },
    )
}

/// Reads the text of a manifest.
fn read_manifest(text: &str) -> Result<Manifest, String> {
    let manifest = toml::Deserializer::parse(text).map_err(|error| syntax(text, &error))?;
    serde_path_to_error::deserialize(manifest).map_err(|error| field(text, &error))
}

/// Reads the text of a manifest with other values.
fn changed_manifest(text: &str, overrides: &Overrides) -> Result<Manifest, String> {
    let own: toml::Table = text.parse().map_err(|error| syntax(text, &error))?;
    let mut manifest = own.clone();
    overrides.apply(&mut manifest)?;
    serde_path_to_error::deserialize(manifest).map_err(|error| {
        let path = error.path().to_string();
        match absent_table(&own, &path) {
            // A table that has nothing but the other values lacks its other fields.
            Some(table) if error.inner().message().starts_with("missing field") => {
                format!("the manifest has no [{table}], so no value of it can be set")
            }
            // The errors have no place in the text.
            _ => field(text, &error),
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

//! A vehicle as its folder describes it.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs;
use std::path::{Path, PathBuf};

use network_model::Network;
use parts::Sled;

use crate::check;
use crate::design;
use crate::error::VehicleError;
use crate::manifest::{Device, MISSION, Manifest, Node, Protocol, TILT};
use crate::overrides::Overrides;
use crate::source::{MANIFEST, Source, refused, text, variants_of};

/// Name of the network file in a vehicle's folder.
const NETWORK: &str = "network.dbc";

/// The index of a node in [`Manifest::nodes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeIndex(pub usize);

/// A vehicle, read and checked.
#[derive(Clone, Debug)]
pub struct Vehicle {
    name: String,
    folder: PathBuf,
    /// The folder of what its images are made of: its own, or that of the vehicle of which it is a variant.
    crate_folder: PathBuf,
    manifest: Manifest,
    network: Network,
    /// Values in place of the manifest's.
    overrides: Overrides,
}

impl Vehicle {
    /// Names of the vehicles below `vehicles`, in alphabetical order: every folder with a
    /// manifest, and the variants in these folders.
    ///
    /// # Errors
    /// The folder cannot be read, or two vehicles have one name.
    pub fn names(vehicles: &Path) -> Result<Vec<String>, VehicleError> {
        Ok(Self::folders(vehicles)?.into_keys().collect())
    }

    /// The folder of each vehicle below `vehicles`, by its name.
    ///
    /// # Errors
    /// As [`Vehicle::names`].
    pub fn folders(vehicles: &Path) -> Result<BTreeMap<String, PathBuf>, VehicleError> {
        let unreadable = |error| VehicleError::Unreadable {
            file: vehicles.into(),
            error,
        };
        let entries = fs::read_dir(vehicles).map_err(unreadable)?;
        let own: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        // A folder without variants has no folder for them.
        let variants = own
            .iter()
            .flat_map(|folder| fs::read_dir(variants_of(folder)))
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .collect::<Vec<_>>();
        let mut all = BTreeMap::new();
        for folder in own.into_iter().chain(variants) {
            let name = folder.file_name().and_then(|name| name.to_str());
            let Some(name) = name.filter(|_| folder.join(MANIFEST).is_file()) else {
                continue;
            };
            match all.entry(name.to_owned()) {
                Entry::Vacant(entry) => entry.insert(folder),
                Entry::Occupied(entry) => {
                    return Err(VehicleError::Twice {
                        name: name.into(),
                        one: entry.get().clone(),
                        other: folder,
                    });
                }
            };
        }
        Ok(all)
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
        let source = Source::of(&folder, &text(&folder, MANIFEST)?)?;
        let (manifest, _) = source.manifest_with(&folder, overrides)?;
        let folder = source.crate_folder;
        Ok(NetworkText {
            text: supplemented(&folder, &manifest, &text(&folder, NETWORK)?)?,
            supplements: network_supplements(&folder, &manifest),
            file: folder.join(NETWORK),
        })
    }

    fn folder_of(vehicles: &Path, name: &str) -> Result<PathBuf, VehicleError> {
        let mut known = Self::folders(vehicles)?;
        known.remove(name).ok_or_else(|| VehicleError::Unknown {
            name: name.into(),
            known: known.into_keys().collect(),
        })
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
        let source = Source::of(folder, &text(folder, MANIFEST)?)?;
        let network = text(&source.crate_folder, NETWORK)?;
        let vehicle = Self::made(&name, folder, source, &network, overrides)?;
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
    /// sources of the nodes are not looked for. If `folder` is that of a variant, what the manifest
    /// leaves out is read from the other vehicle's.
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
        Self::made(
            name,
            folder,
            Source::of(folder, manifest)?,
            network,
            overrides,
        )
    }

    /// A vehicle of its manifest and the text of its network file.
    fn made(
        name: &str,
        folder: &Path,
        source: Source,
        network: &str,
        overrides: &Overrides,
    ) -> Result<Self, VehicleError> {
        let wrong = |what| refused(folder, overrides, what);
        let (manifest, effective) = source.manifest_with(folder, overrides)?;
        let crate_folder = source.crate_folder;
        check::guide(&manifest).map_err(wrong)?;
        let network = supplemented(&crate_folder, &manifest, network)?;
        let network = Network::parse(&network).map_err(|error| VehicleError::Network {
            file: crate_folder.join(NETWORK),
            what: error.to_string().replace('\n', "; "),
        })?;
        check::check(&manifest, &network).map_err(wrong)?;
        check::bit_rate(&manifest, &network).map_err(|what| VehicleError::Network {
            file: crate_folder.join(NETWORK),
            what,
        })?;
        let vehicle = Self {
            name: name.into(),
            folder: folder.into(),
            crate_folder,
            manifest,
            network,
            overrides: effective,
        };
        design::check(&vehicle).map_err(wrong)?;
        Ok(vehicle)
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

    /// The folder of its crate, network file, task table and nodes: its own, or that of the vehicle of
    /// which it is a variant.
    #[must_use]
    pub fn crate_folder(&self) -> &Path {
        &self.crate_folder
    }

    /// The name of the vehicle of which it is a variant; `None` if it has a crate of its own.
    #[must_use]
    pub fn variant_of(&self) -> Option<&str> {
        let other = Some(&self.crate_folder).filter(|folder| **folder != self.folder)?;
        other.file_name()?.to_str()
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
        self.crate_folder.join(NETWORK)
    }

    /// Paths of what adds to its network file because the manifest switches it on.
    #[must_use]
    pub fn network_supplements(&self) -> Vec<PathBuf> {
        network_supplements(&self.crate_folder, &self.manifest)
    }

    /// Paths of what switched-on nodes add to its task table.
    #[must_use]
    pub fn task_supplements(&self) -> Vec<PathBuf> {
        let rows = self.manifest.guidance_by_rows();
        let rows = rows.map(|rows| rows.node.name.as_str());
        let guardian = self.manifest.bus_guardian();
        let guardian = guardian.map(|guardian| guardian.node.name.as_str());
        let mission = self.manifest.missions().map(|_| MISSION);
        let tilt = self.manifest.inertial().map(|_| TILT);
        let added = rows.into_iter().chain(guardian).chain(mission).chain(tilt);
        added
            .map(|name| self.crate_folder.join(format!("{name}.tasks.toml")))
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
        self.crate_folder.join("tasks.toml")
    }

    /// Path of a node's source.
    #[must_use]
    pub fn source(&self, node: NodeIndex) -> PathBuf {
        self.crate_folder
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

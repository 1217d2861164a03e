//! A vehicle with a rover, in the UAGV's network.

#![allow(dead_code)]

use vehicle_model::Vehicle;
use world::{NodeIndex, Scenario};

/// Remote control.
pub(crate) const REMOTE: NodeIndex = NodeIndex(1);
/// Distance sensors.
pub(crate) const SENSORS: NodeIndex = NodeIndex(2);
/// Motor drivers.
pub(crate) const MOTORS: NodeIndex = NodeIndex(3);

const MANIFEST: &str = include_str!("vehicle.toml");

/// The vehicle.
pub(crate) fn vehicle() -> Vehicle {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/vehicles/uagv");
    let uagv = Vehicle::read(folder.as_ref()).unwrap();
    let network = std::fs::read_to_string(uagv.network_file()).unwrap();
    Vehicle::parse("rover", "rover".as_ref(), MANIFEST, &network).unwrap()
}

/// A row of poles.
pub(crate) const POLES: &str = "[[row.section]]\nkind = \"poles\"\nlength = \"20 m\"\n";

/// A scenario of the vehicle in a row of poles, with more tables.
pub(crate) fn scenario(more: &str) -> Scenario {
    Scenario::parse(&vehicle(), "test", "test", &format!("{POLES}{more}")).unwrap()
}

/// Why a scenario of the vehicle is refused.
pub(crate) fn refused(text: &str) -> String {
    let refused = Scenario::parse(&vehicle(), "row", "row.toml", text);
    refused.unwrap_err().to_string()
}

//! The vehicle that the tests of this crate use.

#![allow(dead_code)]

use vehicle_model::Vehicle;
use world::vehicle::Parameters;
use world::{NodeIndex, Scenario};

/// Receiver and time master.
pub(crate) const GPS: NodeIndex = NodeIndex(0);
/// Modes, control law, operator's devices.
pub(crate) const CONTROLLER: NodeIndex = NodeIndex(1);
/// Steering actuator and its potentiometer.
pub(crate) const STEERING: NodeIndex = NodeIndex(2);
/// Drive motor.
pub(crate) const DRIVE: NodeIndex = NodeIndex(3);
/// All of them.
pub(crate) const ALL: [NodeIndex; 4] = [GPS, CONTROLLER, STEERING, DRIVE];

/// The vehicle.
pub(crate) fn vehicle() -> Vehicle {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/vehicles/uagv");
    Vehicle::read(folder.as_ref()).unwrap()
}

/// The vehicle with text replacements in its manifest.
pub(crate) fn changed(changes: &[(&str, &str)]) -> Vehicle {
    let vehicle = vehicle();
    let read = |file: &str| std::fs::read_to_string(vehicle.folder().join(file)).unwrap();
    let mut manifest = read("vehicle.toml");
    for (from, to) in changes {
        assert!(manifest.contains(from), "{from}");
        manifest = manifest.replace(from, to);
    }
    Vehicle::parse("changed", vehicle.folder(), &manifest, &read("network.dbc")).unwrap()
}

/// Its machine.
pub(crate) fn parameters() -> Parameters {
    Parameters::from(vehicle().manifest().machine.as_ref().unwrap())
}

/// A scenario from its text.
pub(crate) fn scenario(text: &str) -> Scenario {
    Scenario::parse(&vehicle(), "test", "test", text).unwrap()
}

/// A scenario of the vehicle.
pub(crate) fn find(name: &str) -> Scenario {
    Scenario::find(&vehicle(), name).unwrap()
}

/// The name of a node.
pub(crate) fn name(node: NodeIndex) -> String {
    vehicle().node(node).name.clone()
}

//! The vehicle that the tests of the world are made for.

#![allow(dead_code)]

use vehicle_model::Vehicle;
use world::vehicle::Parameters;
use world::{NodeIndex, Scenario};

/// Receiver and time master.
pub const GPS: NodeIndex = NodeIndex(0);
/// Modes, control law, operator's devices.
pub const CONTROLLER: NodeIndex = NodeIndex(1);
/// Steering actuator and its potentiometer.
pub const STEERING: NodeIndex = NodeIndex(2);
/// Drive motor.
pub const DRIVE: NodeIndex = NodeIndex(3);
/// All of them.
pub const ALL: [NodeIndex; 4] = [GPS, CONTROLLER, STEERING, DRIVE];

/// The vehicle.
pub fn vehicle() -> Vehicle {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/vehicles/uagv");
    Vehicle::read(folder.as_ref()).unwrap()
}

/// The vehicle with other texts in its manifest.
pub fn changed(changes: &[(&str, &str)]) -> Vehicle {
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
pub fn parameters() -> Parameters {
    Parameters::from(vehicle().manifest().machine.as_ref().unwrap())
}

/// A scenario from its text.
pub fn scenario(text: &str) -> Scenario {
    Scenario::parse(&vehicle(), "test", "test", text).unwrap()
}

/// A scenario of the vehicle.
pub fn find(name: &str) -> Scenario {
    Scenario::find(&vehicle(), name).unwrap()
}

/// The name of a node.
pub fn name(node: NodeIndex) -> String {
    vehicle().node(node).name.clone()
}

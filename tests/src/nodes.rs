//! Indices of the tested vehicle's nodes in its manifest.

use vehicle_model::NodeIndex;

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

/// The name of a node.
#[must_use]
pub fn name(node: NodeIndex) -> &'static str {
    &crate::vehicle().node(node).name
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_places_are_those_of_the_manifest() {
        let names = super::ALL.map(super::name);
        assert_eq!(names, ["gps", "controller", "steering", "drive"]);
        assert_eq!(crate::vehicle().nodes().len(), names.len());
    }
}

//! The vehicle's nodes and the boards they run on.

use clap::ValueEnum;
use parts::Sled;

/// A node of the vehicle: one image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Node {
    /// RTK receiver and time master, on the F446 sled.
    Gps,
    /// States, control law, modes and user interface, on the F446 sled.
    Controller,
    /// Steering actuator and potentiometer, on the F303 sled.
    Steering,
    /// Drive motor, on the F303 sled.
    Drive,
}

impl Node {
    /// All nodes, in the order in which they are listed.
    pub const ALL: [Node; 4] = [Node::Gps, Node::Controller, Node::Steering, Node::Drive];

    /// Name of the node and of its image.
    pub const fn name(self) -> &'static str {
        match self {
            Node::Gps => "gps",
            Node::Controller => "controller",
            Node::Steering => "steering",
            Node::Drive => "drive",
        }
    }

    /// The board that the node runs on (thesis 5.2.3).
    pub const fn board(self) -> &'static Sled {
        match self {
            Node::Gps | Node::Controller => Sled::F446,
            Node::Steering | Node::Drive => Sled::F303,
        }
    }
}

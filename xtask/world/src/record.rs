//! Recordings of a run.

use crate::receiver::Fix;
use crate::time::SimTime;
use vehicle_model::{Device, NodeIndex};

/// The vehicle at one instant.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct StateSample {
    /// When.
    pub at: SimTime,
    /// True northing of the point of the centre line beside the antenna, metres.
    pub north: f64,
    /// True easting of the same point, metres.
    pub east: f64,
    /// Heading of the body, radians clockwise from north, not wrapped.
    pub heading: f64,
    /// Steering angle that the potentiometer sees, radians, positive right.
    pub steering: f64,
    /// Speed of the rear wheels, metres per second.
    pub speed: f64,
    /// Effort of the steering motor driver, -1 to 1.
    pub steering_effort: f64,
    /// Effort of the drive motor driver, -1 to 1.
    pub drive_effort: f64,
    /// Quality of the receiver's solution.
    pub fix: Fix,
}

/// The effort at a motor changes.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct EffortChange {
    /// End of the byte, or time of the relay's change, that changed the effort.
    pub at: SimTime,
    /// The node that the motor driver is wired to.
    pub node: NodeIndex,
    /// The driver's last byte.
    pub byte: u8,
    /// The effort from then on, -1 to 1; 0 while the relay is open.
    pub effort: f64,
}

/// A node closes or opens the relay in its motor's lead.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct RelayChange {
    /// When.
    pub at: SimTime,
    /// The node that the relay is wired to.
    pub node: NodeIndex,
    /// Whether the node lets it conduct from then on. One that sticks conducts all the same.
    pub closed: bool,
}

/// The text on the display changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScreenChange {
    /// When it was looked at.
    pub at: SimTime,
    /// Its four rows, and one with the colours of the lamps, as
    /// [`Display::text`](crate::lcd::Display::text) tells them.
    pub text: String,
}

/// A character on the line between a node and one of its devices.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct Character {
    /// End of its stop bit.
    pub at: SimTime,
    /// The node.
    pub node: NodeIndex,
    /// The device.
    pub device: Device,
    /// The byte.
    pub byte: u8,
    /// Whether the node sent it.
    pub from_node: bool,
}

/// A motor driver read something that was not sent to it.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct Garble {
    /// End of the character, as the driver sees it.
    pub at: SimTime,
    /// The node that the motor driver is wired to.
    pub node: NodeIndex,
    /// The byte; `None` for a framing error, which the driver ignores.
    pub byte: Option<u8>,
    /// Whether the relay in the motor's lead was closed.
    pub closed: bool,
}

/// Traffic between the nodes and their devices.
#[derive(Copy, Clone, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Bytes the receiver sent.
    pub receiver_bytes: u64,
    /// Bytes that the motor drivers accepted.
    pub motor_bytes: u64,
    /// Bytes and framing errors that the motor drivers read and that were not sent so.
    pub motor_garbled: u64,
    /// Commands that the display executed.
    pub lcd_commands: u64,
    /// Commands that the display did not understand.
    pub lcd_refused: u64,
    /// Bytes lost at the display because of a wrong baud rate.
    pub lcd_wrong_baud: u64,
    /// Bytes sent to a device that ignores its input, such as the receiver.
    pub unheard_bytes: u64,
}

//! The voltages and logic levels that devices put on the nodes' pins.

use vehicle_model::{Device, NodeIndex};

use crate::rover::Side;

/// An analogue voltage that a node converts.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Analog {
    /// Joystick, sideways: right is positive.
    JoystickX,
    /// Joystick, fore and aft: forward is positive.
    JoystickY,
    /// Potentiometer of the steering actuator.
    SteeringPot,
    /// A knob at the `pot` connector of this node.
    Knob(NodeIndex),
    /// The distance sensor that is mounted on this side of the robot.
    Distance(Side),
}

/// A logic level that the operator controls.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Input {
    /// Remote button A, high while pressed.
    RemoteA,
    /// Remote button B, high while pressed.
    RemoteB,
    /// Remote button C, high while pressed.
    RemoteC,
    /// Remote button D, high while pressed.
    RemoteD,
    /// Switch of the joystick, low while pressed.
    JoystickSwitch,
    /// Emergency-stop loop, normally closed to ground: high means stop.
    StopLoop,
    /// Output "run" of the pin remote, high while on.
    PinRun,
    /// Output "stop" of the pin remote, high while on.
    PinStop,
}

impl Input {
    /// All inputs.
    pub const ALL: [Self; 8] = [
        Self::RemoteA,
        Self::RemoteB,
        Self::RemoteC,
        Self::RemoteD,
        Self::JoystickSwitch,
        Self::StopLoop,
        Self::PinRun,
        Self::PinStop,
    ];

    /// The device that it belongs to.
    #[must_use]
    pub const fn device(self) -> Device {
        match self {
            Self::PinRun | Self::PinStop => Device::PinRemote,
            _ => Device::OperatorSwitches,
        }
    }

    /// The level while it is not operated.
    #[must_use]
    pub const fn idle(self) -> bool {
        matches!(self, Self::JoystickSwitch)
    }

    pub(crate) const fn index(self) -> usize {
        self as usize
    }
}

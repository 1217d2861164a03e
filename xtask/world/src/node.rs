//! The nodes of the vehicle and what is wired to them.

use serde::{Deserialize, Serialize};

/// A node of the vehicle (thesis 5.2.3).
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Node {
    /// Receiver and time master.
    Gps,
    /// Modes, control law, operator's devices.
    Controller,
    /// Steering actuator and its potentiometer.
    Steering,
    /// Drive motor.
    Drive,
}

impl Node {
    /// All nodes, in the order that reports list them.
    pub const ALL: [Self; 4] = [Self::Gps, Self::Controller, Self::Steering, Self::Drive];

    /// The node's name, as images and reports spell it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gps => "gps",
            Self::Controller => "controller",
            Self::Steering => "steering",
            Self::Drive => "drive",
        }
    }

    pub(crate) const fn index(self) -> usize {
        self as usize
    }
}

impl core::fmt::Display for Node {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

/// A serial line between a node and a device.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Port {
    /// The positioning receiver at the gps node, 1 Mbaud.
    Receiver,
    /// The display at the controller node, 115200 baud.
    Lcd,
    /// The motor driver at the steering or the drive node, 38400 baud.
    Motor,
}

/// An analogue voltage that a node converts.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Analog {
    /// Joystick, sideways: right is positive.
    JoystickX,
    /// Joystick, fore and aft: forward is positive.
    JoystickY,
    /// Potentiometer of the steering actuator.
    SteeringPot,
}

/// A logic level at the controller node.
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
}

impl Input {
    /// All inputs.
    pub const ALL: [Self; 6] = [
        Self::RemoteA,
        Self::RemoteB,
        Self::RemoteC,
        Self::RemoteD,
        Self::JoystickSwitch,
        Self::StopLoop,
    ];

    /// The level while nobody touches it.
    #[must_use]
    pub const fn idle(self) -> bool {
        matches!(self, Self::JoystickSwitch)
    }

    pub(crate) const fn index(self) -> usize {
        self as usize
    }
}

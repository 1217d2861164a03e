//! The devices connected to the pins of a vehicle's nodes, from its manifest and its boards.

use parts::{Pin, Role, Sled};
use vehicle_model::{Device, NodeIndex, Vehicle};
use world::rover::Side;
use world::{Analog, Input};

/// The connection of a device to the microcontroller of its node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Plug {
    /// The device.
    pub(crate) device: Device,
    /// Number of the USART at the connector, from 1.
    pub(crate) usart: Option<u8>,
}

/// The wiring of one node.
#[derive(Clone, Debug)]
pub(crate) struct Wiring {
    sled: &'static Sled,
    /// The devices that are plugged in, with the names of their connectors.
    plugs: Vec<Plug>,
    /// Pin of the relay in the motor's lead; high closes it.
    pub(crate) relay: Option<Pin>,
    /// Pin that reads the relay back; low while it conducts.
    pub(crate) sense: Option<Pin>,
    /// Pins of the servo pulses, with the side whose motors they drive.
    servos: Vec<(Pin, Side)>,
}

/// Why a node cannot be wired as the manifest says.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WiringError {
    /// The board does not have that connector.
    #[error("board {board:?} has no connector {connector:?}")]
    Connector {
        /// The board.
        board: &'static str,
        /// The connector.
        connector: String,
    },
}

impl Wiring {
    /// The wiring of a node.
    pub(crate) fn new(vehicle: &Vehicle, node: NodeIndex) -> Result<Self, WiringError> {
        let sled = vehicle.board(node);
        let node = vehicle.node(node);
        let mut plugs = Vec::new();
        let (mut relay, mut sense) = (None, None);
        let mut servos = Vec::new();
        for (name, &device) in &node.wiring {
            let connector = sled.connector(name).ok_or_else(|| WiringError::Connector {
                board: sled.name,
                connector: name.clone(),
            })?;
            if device.has_relay() {
                relay = connector.signal("relay").map(|line| line.pin);
                sense = connector.signal("sense").map(|line| line.pin);
            }
            if device == Device::DriveMotors {
                let lines = [("left", Side::Left), ("right", Side::Right)];
                let pins = lines.map(|(line, side)| Some((connector.signal(line)?.pin, side)));
                servos.extend(pins.into_iter().flatten());
            }
            plugs.push(Plug {
                device,
                usart: connector.usart(),
            });
        }
        Ok(Self {
            sled,
            plugs,
            relay,
            sense,
            servos,
        })
    }

    /// The board of the node.
    pub(crate) fn sled(&self) -> &'static Sled {
        self.sled
    }

    /// The USART of the console.
    pub(crate) fn console(&self) -> Option<u8> {
        self.sled.connector("console")?.usart()
    }

    /// The USART that a device is wired to.
    pub(crate) fn usart_of(&self, device: Device) -> Option<u8> {
        self.plugs.iter().find(|plug| plug.device == device)?.usart
    }

    /// The device that is wired to a USART.
    pub(crate) fn device_at(&self, usart: u8) -> Option<Device> {
        let mut plugs = self.plugs.iter();
        Some(plugs.find(|plug| plug.usart == Some(usart))?.device)
    }

    /// Whether a distance sensor is wired to an ADC channel.
    pub(crate) fn samples(&self, channel: usize) -> bool {
        let wired = self
            .plugs
            .iter()
            .any(|plug| plug.device == Device::DistanceSensors);
        let mut sides = [Side::Left, Side::Right].into_iter();
        wired && sides.any(|side| self.channel(Analog::Distance(side)) == Some(channel))
    }

    /// The side whose motor driver reads servo pulses at a pin.
    pub(crate) fn servo(&self, pin: Pin) -> Option<Side> {
        let mut servos = self.servos.iter();
        servos.find(|(one, _)| *one == pin).map(|(_, side)| *side)
    }

    /// The pin that one of the operator's inputs is wired to.
    pub(crate) fn input(&self, input: Input) -> Option<Pin> {
        let name = match input {
            Input::RemoteA => "a",
            Input::RemoteB => "b",
            Input::RemoteC => "c",
            Input::RemoteD => "d",
            Input::JoystickSwitch => "joystick-switch",
            Input::StopLoop => "stop-loop",
            Input::PinRun => "run",
            Input::PinStop => "stop",
        };
        let connector = self.sled.connector(input.device().connector())?;
        Some(connector.signal(name)?.pin)
    }

    /// The ADC channel that converts a voltage.
    pub(crate) fn channel(&self, analog: Analog) -> Option<usize> {
        let (device, name) = match analog {
            Analog::JoystickX => (Device::Joystick, "x"),
            Analog::JoystickY => (Device::Joystick, "y"),
            Analog::SteeringPot => (Device::SteeringPotentiometer, "wiper"),
            Analog::Knob(_) => (Device::Knob, "wiper"),
            Analog::Distance(Side::Left) => (Device::DistanceSensors, "left"),
            Analog::Distance(Side::Right) => (Device::DistanceSensors, "right"),
        };
        let signal = self.sled.connector(device.connector())?.signal(name)?;
        match signal.role {
            Role::Analog(channel) => Some(usize::from(channel)),
            _ => None,
        }
    }
}

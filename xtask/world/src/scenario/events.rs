//! Things that happen at stated times.

use serde::Deserialize;

use crate::units::{Ratio, Time};
use vehicle_model::NodeIndex;

/// A button that the operator can press.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
pub enum Button {
    /// Remote: idle, and release of an emergency stop.
    A,
    /// Remote: manual.
    B,
    /// Remote: autonomous, ready then run.
    C,
    /// Remote: emergency stop.
    D,
    /// Switch of the joystick, which means the same as D (thesis 5.2.5).
    J,
}

/// A button is pressed and released.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ButtonPress {
    /// When it goes down.
    pub at: Time,
    /// Which one.
    pub button: Button,
    /// How long it stays down, 1 ms to 60 s. Default 200 ms.
    #[serde(default = "default_hold")]
    pub hold: Time,
    /// How long its contact bounces after each edge, 0 to 50 ms. Default 2 ms.
    #[serde(default = "default_bounce")]
    pub bounce: Time,
}

fn default_hold() -> Time {
    Time::new(0.2)
}

fn default_bounce() -> Time {
    Time::new(0.002)
}

/// The joystick is moved and stays there.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JoystickMove {
    /// When.
    pub at: Time,
    /// Share of the way to the right, -100 to 100 %. Default 0 %.
    #[serde(default = "centre")]
    pub right: Ratio,
    /// Share of the way forward, -100 to 100 %. Default 0 %.
    #[serde(default = "centre")]
    pub forward: Ratio,
}

fn centre() -> Ratio {
    Ratio::new(0.0)
}

/// The emergency-stop loop opens or closes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopLoopChange {
    /// When.
    pub at: Time,
    /// True opens the loop, which stops the vehicle.
    pub open: bool,
}

/// The supply of the remote control's receiver fails or returns.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupplyChange {
    /// When.
    pub at: Time,
    /// False: all outputs fall to the level to which their inputs pull them. Presses do nothing
    /// until it is true again.
    pub on: bool,
}

/// A knob is turned and stays there.
#[derive(Clone, Debug, PartialEq)]
pub struct KnobTurn {
    /// The node that the knob is wired to.
    pub node: NodeIndex,
    /// When.
    pub at: Time,
    /// Share of the way from one end to the other, 0 to 100 %.
    pub position: Ratio,
}

/// The 8 MHz clock of a node stops, or comes.
#[derive(Clone, Debug, PartialEq)]
pub struct ClockChange {
    /// Which node.
    pub node: NodeIndex,
    /// When.
    pub at: Time,
    /// Whether the clock is there from then on.
    pub present: bool,
}

/// Noise on the line to a motor driver reads as a byte.
#[derive(Clone, Debug, PartialEq)]
pub struct WireNoise {
    /// The node that the motor driver is wired to.
    pub node: NodeIndex,
    /// When.
    pub at: Time,
    /// The byte that the driver reads.
    pub byte: u8,
}

/// A node's reset line is pulled low.
#[derive(Clone, Debug, PartialEq)]
pub struct ResetEvent {
    /// Which node.
    pub node: NodeIndex,
    /// When.
    pub at: Time,
    /// When it is released; never if left out.
    pub until: Option<Time>,
}

/// The supply of a node dips so far that it loses its memory.
#[derive(Clone, Debug, PartialEq)]
pub struct BrownOut {
    /// Which node.
    pub node: NodeIndex,
    /// When the supply is gone.
    pub at: Time,
    /// When it is back.
    pub until: Time,
}

/// Something foreign happens on the bus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "what", rename_all = "lowercase", deny_unknown_fields)]
pub enum BusEvent {
    /// A foreign node sends a frame, perhaps again and again.
    Frame {
        /// When it is first queued.
        at: Time,
        /// Standard identifier, 0 to 2047.
        id: u16,
        /// 0 to 8 bytes.
        #[serde(default)]
        data: Vec<u8>,
        /// Interval to the next frame, at least 100 us; the frame is sent once if left out.
        every: Option<Time>,
        /// No frames are queued from this time on; the end of the run if left out.
        until: Option<Time>,
    },
    /// The next frames are hit by a wrong bit and end in an error frame.
    Corrupt {
        /// When.
        at: Time,
        /// Only frames with this identifier; any frame if left out.
        id: Option<u16>,
        /// How many, 1 to 1000. Default 1.
        #[serde(default = "once")]
        count: u32,
    },
    /// The bus is held dominant.
    Dominant {
        /// When.
        at: Time,
        /// How long, above 0 to 1 s.
        hold: Time,
    },
}

fn once() -> u32 {
    1
}

//! Things that happen at stated times.

use serde::Deserialize;

use crate::time::{SimDuration, from_seconds};
use crate::units::{Ratio, Time, Voltage};

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
    /// Pin remote: run.
    #[serde(rename = "run")]
    Run,
    /// Pin remote: stop.
    #[serde(rename = "stop")]
    Stop,
}

impl Button {
    /// All of them.
    pub(super) const ALL: [Self; 7] = [
        Self::A,
        Self::B,
        Self::C,
        Self::D,
        Self::J,
        Self::Run,
        Self::Stop,
    ];

    /// Its name in a file.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
            Self::C => "C",
            Self::D => "D",
            Self::J => "J",
            Self::Run => "run",
            Self::Stop => "stop",
        }
    }
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

/// The relay in the lead of a node's motor fails: it conducts from then on, whatever the node says.
#[derive(Clone, Debug, PartialEq)]
pub struct RelayFault {
    /// The node.
    pub node: NodeIndex,
    /// When.
    pub at: Time,
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

/// A node's CAN controller is broken, or what drives its TX line: it takes the bus from all others.
#[derive(Clone, Debug, PartialEq)]
pub struct Babble {
    /// Which node. What it does otherwise goes on.
    pub node: NodeIndex,
    /// When it begins.
    pub at: Time,
    /// When it ends.
    pub until: Time,
    /// Standard identifier of the frame that it sends again and again, 0 to 2047. Its line is held dominant
    /// if left out.
    pub id: Option<u16>,
}

/// The supply of a node dips. It falls and rises by 5 mV each microsecond, as 20 uF do that feed
/// 100 mA.
#[derive(Clone, Debug, PartialEq)]
pub struct BrownOut {
    /// Which node.
    pub node: NodeIndex,
    /// When the supply begins to fall.
    pub at: Time,
    /// When it begins to rise.
    pub until: Time,
    /// How low it falls.
    pub lowest: Voltage,
}

impl BrownOut {
    /// Supply outside a dip, mV.
    pub const NOMINAL_MV: u16 = 3_300;
    /// Distance of two values on the slopes, mV.
    const STEP_MV: u16 = 50;
    /// Time between them, us.
    const STEP_US: u16 = 10;

    /// Whether this dip and one of the same node between two times, in seconds, have an instant in
    /// common: a supply has risen again 1 ms after its dip.
    #[must_use]
    pub fn overlaps(&self, from: f64, until: f64) -> bool {
        // Less 1 ns: sums of times in seconds are rounded.
        const RISEN: f64 = 0.001 - 1e-9;
        self.at.get() < until + RISEN && from < self.until.get() + RISEN
    }

    /// The course of the supply: values in mV, each from the time that stands with it on. A dip that
    /// is too short for its depth turns back earlier.
    pub(crate) fn course(&self) -> impl Iterator<Item = (SimDuration, u16)> {
        let lowest = ((self.lowest.get() * 1e3).round() as u16).min(Self::NOMINAL_MV);
        let depth = (Self::NOMINAL_MV - lowest).div_ceil(Self::STEP_MV);
        let (at, until) = (self.at.get(), self.until.get());
        let after = |from: f64, step: u16| from + f64::from(step * Self::STEP_US) * 1e-6;
        let reached = (0..depth)
            .take_while(|step| after(at, *step) < until)
            .count() as u16;
        let level = move |steps: u16| {
            let millivolts = Self::NOMINAL_MV.saturating_sub(steps * Self::STEP_MV);
            millivolts.max(lowest)
        };
        let falling = (0..reached).map(move |step| (after(at, step), level(step + 1)));
        let rising = (0..reached).map(move |step| (after(until, step), level(reached - 1 - step)));
        let whole = falling.chain(rising);
        whole.map(|(seconds, millivolts)| (from_seconds(seconds), millivolts))
    }
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
        /// From the middle of the next frame with this identifier on; at once if left out.
        id: Option<u16>,
        /// How long, above 0 to 1 s.
        hold: Time,
    },
}

impl BusEvent {
    /// When it begins.
    pub(super) fn at(&self) -> Time {
        match self {
            Self::Frame { at, .. } | Self::Corrupt { at, .. } | Self::Dominant { at, .. } => *at,
        }
    }
}

fn once() -> u32 {
    1
}

#[cfg(test)]
mod tests {
    use super::BrownOut;
    use crate::time::span_seconds;
    use crate::units::{Time, Voltage};
    use vehicle_model::NodeIndex;

    /// The course of a dip from 1 s on: microseconds after its beginning, mV.
    fn course(micros: f64, lowest: f64) -> Vec<(u32, u16)> {
        let dip = BrownOut {
            node: NodeIndex(0),
            at: Time::new(1.0),
            until: Time::new(1.0 + micros * 1e-6),
            lowest: Voltage::new(lowest),
        };
        let course = dip.course();
        course
            .map(|(after, millivolts)| {
                let micros = (span_seconds(after) - 1.0) * 1e6;
                (micros.round() as u32, millivolts)
            })
            .collect()
    }

    #[test]
    fn a_supply_falls_and_rises_with_its_slope() {
        assert_eq!(
            course(1000.0, 3.18),
            [
                (0, 3250),
                (10, 3200),
                (20, 3180),
                (1000, 3200),
                (1010, 3250),
                (1020, 3300)
            ]
        );
        let deep = course(2000.0, 0.0);
        assert_eq!(deep[65], (650, 0));
        assert_eq!(deep.last(), Some(&(2650, 3300)));
    }

    #[test]
    fn a_short_dip_turns_back_before_its_lowest_value() {
        assert_eq!(
            course(15.0, 0.0),
            [(0, 3250), (10, 3200), (15, 3250), (25, 3300)]
        );
        assert_eq!(course(100.0, 3.3), []);
    }
}

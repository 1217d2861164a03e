//! Roll and pitch: from the inertial sensor of the satellite receiver over the bus to the law that steers.

use control::tilt::{self, TiltWatch};
use firmware::convert;
use firmware::link::{Link, Port, WindowTimer};
use firmware::machine::Machine;
use firmware::pilot::Inputs;
use firmware::sbp::{self, Frame, Orientation};
use network::Message;

use crate::design::TILT_AGE;
use crate::matrix::window;
use crate::messages::{Tilt, TiltState};
use crate::{Pilot, Uagv};

/// A unit of message 203, rad.
const UNIT: f32 = 1e-4;

/// What the receiver's frames of a step of the gps node say about roll and pitch.
#[derive(Clone, Copy, Debug, Default)]
pub struct News(Option<Orientation>);

impl News {
    /// Looks at a frame of the receiver.
    #[inline(always)]
    pub fn see(&mut self, frame: Frame<'_>) {
        self.0 = sbp::orientation(&frame).or(self.0);
    }

    /// The data for message 203 if a measurement came. Its `None` removes what was enqueued: the sensor does not know roll and
    /// pitch, or they are not plausible.
    pub fn data(&self) -> Option<Option<[u8; 8]>> {
        self.0.map(data)
    }
}

/// Data of message 203.
fn data(measured: Orientation) -> Option<[u8; 8]> {
    let message = Tilt {
        roll: convert::from_microdegrees(measured.roll),
        pitch: convert::from_microdegrees(measured.pitch),
    };
    let sound = measured.valid && tilt(&message).is_plausible();
    sound.then(|| firmware::link::padded(message.encode()))
}

/// Roll and pitch of message 203.
fn tilt(message: &Tilt) -> tilt::Tilt<f32> {
    tilt::Tilt {
        roll: f32::from(message.roll) * UNIT,
        pitch: f32::from(message.pitch) * UNIT,
    }
}

/// Roll and pitch of this basic cycle.
pub type Seen = Option<Tilt>;

/// Takes the message that has come.
pub fn take<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
) -> Seen {
    link.message(window::TILT)
}

/// What the controller knows of roll and pitch.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    watch: TiltWatch<f32>,
    lapses: u8,
}

impl Watch {
    /// On ground that counts as level until the first message comes.
    #[must_use]
    pub fn new() -> Self {
        Self {
            watch: TiltWatch::new(TILT_AGE),
            lapses: 0,
        }
    }

    /// Tells the law where the antenna is. Call it before each step of the pilot, with that step's inputs: it takes out
    /// of their velocity what roll and pitch add to it.
    pub fn step(&mut self, pilot: &mut Pilot, inputs: &mut Inputs, seen: Seen) {
        let before = self.watch.is_measured();
        let seen = seen.as_ref().map(tilt);
        let law = pilot.law_mut();
        inputs.velocity = self.watch.step(law, seen, inputs.velocity, Uagv::PERIOD);
        if before && !self.watch.is_measured() {
            self.lapses = self.lapses.wrapping_add(1);
        }
    }

    /// The message about it.
    #[must_use]
    pub fn state(&self) -> TiltState {
        TiltState {
            measured: self.watch.is_measured(),
            lapses: self.lapses,
        }
    }

    /// Puts this message into its window.
    pub fn put<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
        link: &mut Link<P, T, WINDOWS, NODES>,
        state: TiltState,
    ) {
        link.put(window::TILT_STATE, firmware::link::padded(state.encode()));
    }
}

impl Default for Watch {
    fn default() -> Self {
        Self::new()
    }
}

//! What guides an autonomous run besides the path: nothing, the rows of a crop while the receiver has no fix, or
//! the commands of a planner.
//!
//! The manifest chooses. The choice is a type, so that a vehicle without such a guide has no trace of it in its
//! images.

mod planner;
mod rows;

pub use planner::ByPlanner;
pub use rows::ByRows;

use control::controller::{Settings, Tracking};
use control::demand::DemandError;
use control::mode::Mode;
use control::safety::Command;
use control::takeover::TakeoverError;
use network::Message;

use crate::e2e::{self, Secret};
use crate::pilot::Reason;

/// What a step of the pilot knows.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// The mode before the step.
    pub mode: Mode,
    /// Whether the receiver has an RTK-fixed solution and its position is recent.
    pub fixed: bool,
    /// Where the vehicle was at the last step.
    pub tracking: Tracking<f32>,
    /// Time since the last step, s.
    pub dt: f32,
}

/// What a command depends on.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Where the vehicle is.
    pub tracking: Tracking<f32>,
    /// The command that has been applied since the last step.
    pub applied: Command<f32>,
    /// Steering angle by the potentiometer, rad; `None` without a plausible reading.
    pub steering_angle: Option<f32>,
    /// The real steering rate as a share of the commanded one.
    pub effectiveness: f32,
    /// Time since the last step, s.
    pub dt: f32,
}

/// Who leads a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lead {
    /// The law by the satellites, along the path.
    #[default]
    Satellites,
    /// The rows, along the path.
    Rows,
    /// A planner, wherever it wants to go. It may also begin a run.
    Planner,
    /// Nobody: the run must end.
    Nobody,
}

/// Why there is no guide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuideError {
    /// The settings of the guidance by rows.
    Rows(TakeoverError),
    /// The settings of the guidance by a planner.
    Planner(DemandError),
}

/// What guides a run besides the path.
pub trait Guidance: Sized {
    /// What it is made of.
    type Settings: 'static;

    /// Why a run ends that nobody leads any more.
    const LOST: Reason;

    /// Guidance that has seen nothing, for a vehicle with these settings of its controller.
    ///
    /// # Errors
    /// Which setting is unusable.
    fn new(settings: &Self::Settings, controller: &Settings<f32>) -> Result<Self, GuideError>;

    /// Decides who leads the run from now on, once in each step and in every mode.
    fn step(&mut self, known: &Known) -> Lead;

    /// The command in place of the controller's; `None` while that one counts.
    fn drive(&mut self, motion: &Motion) -> Option<Command<f32>>;
}

/// The path alone.
#[derive(Clone, Copy, Debug)]
pub struct Without;

impl Guidance for Without {
    type Settings = ();

    const LOST: Reason = Reason::FixLost;

    #[inline(always)]
    fn new((): &(), _: &Settings<f32>) -> Result<Self, GuideError> {
        Ok(Self)
    }

    #[inline(always)]
    fn step(&mut self, _: &Known) -> Lead {
        Lead::Satellites
    }

    #[inline(always)]
    fn drive(&mut self, _: &Motion) -> Option<Command<f32>> {
        None
    }
}

/// The protected messages of another node, of which each one counts once.
#[derive(Clone, Debug)]
struct Sealed<T> {
    protection: e2e::Receiver,
    /// System time of the basic cycle of the last step, ms.
    time: u32,
    last: Option<T>,
}

impl<T> Sealed<T> {
    const fn new() -> Self {
        Self {
            protection: e2e::Receiver::new(Secret::None),
            time: 0,
            last: None,
        }
    }

    /// Takes a frame in the basic cycle that began at system time `time` (ms). It came in the cycle before, of which
    /// its check value is. `read` gives what its data say. A frame whose protection does not hold is none.
    /// Returns whether such a frame came.
    fn see<M: Message>(
        &mut self,
        data: Option<&[u8]>,
        time: u32,
        read: impl FnOnce(&[u8; 8]) -> Option<T>,
    ) -> bool {
        let sent = core::mem::replace(&mut self.time, time);
        let whole = data.and_then(|data| <&[u8; 8]>::try_from(data).ok());
        let sound = whole.filter(|data| self.protection.judge::<M>(sent, data).is_ok());
        self.last = sound.and_then(read);
        data.is_some() && sound.is_none()
    }
}

//! What guides an autonomous run while the receiver has no fix: nothing, or the rows of a crop.
//!
//! The manifest chooses. The choice is a type, so that a vehicle without guidance by rows has no trace
//! of it in its images.

use control::controller::{Settings, Tracking};
use control::mode::Mode;
use control::safety::Command;
use control::takeover::{Guide, RowSighting, Situation, Takeover, TakeoverError, TakeoverSettings};

use network::Message;

use crate::e2e::{self, Secret};

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

/// What guides a run besides the satellites.
pub trait Guidance: Sized {
    /// What it is made of.
    type Settings: 'static;

    /// Guidance that has seen nothing, for a vehicle with these settings of its controller.
    ///
    /// # Errors
    /// Which setting is unusable.
    fn new(settings: &Self::Settings, controller: &Settings<f32>) -> Result<Self, TakeoverError>;

    /// Decides what guides the run from now on, once in each step and in every mode.
    fn step(&mut self, known: &Known) -> Guide;

    /// The command in place of the controller's; `None` while that one counts.
    fn drive(&mut self, motion: &Motion) -> Option<Command<f32>>;
}

/// The satellites alone.
#[derive(Clone, Copy, Debug)]
pub struct Without;

impl Guidance for Without {
    type Settings = ();

    #[inline(always)]
    fn new((): &(), _: &Settings<f32>) -> Result<Self, TakeoverError> {
        Ok(Self)
    }

    #[inline(always)]
    fn step(&mut self, _: &Known) -> Guide {
        Guide::Satellites
    }

    #[inline(always)]
    fn drive(&mut self, _: &Motion) -> Option<Command<f32>> {
        None
    }
}

/// The rows of a crop.
#[derive(Clone, Debug)]
pub struct ByRows {
    takeover: Takeover<f32>,
    protection: e2e::Receiver,
    /// System time of the basic cycle of the last step, ms.
    time: u32,
    sighting: Option<RowSighting<f32>>,
}

impl ByRows {
    /// Takes a frame of the node that measures the rows, in the basic cycle that began at system time
    /// `time` (ms). The frame came in the cycle before, of which its check value is. `read` gives what
    /// its data say. A frame whose protection does not hold is none.
    pub fn see<M: Message>(
        &mut self,
        data: Option<&[u8]>,
        time: u32,
        read: impl FnOnce(&[u8; 8]) -> Option<RowSighting<f32>>,
    ) {
        let sent = core::mem::replace(&mut self.time, time);
        let data = data.and_then(|data| <&[u8; 8]>::try_from(data).ok());
        let sound = data.filter(|data| self.protection.judge::<M>(sent, data).is_ok());
        self.sighting = sound.and_then(read);
    }

    /// The secret of the node, by which it knows true frames. [`Secret::None`] at first.
    pub fn set_secret(&mut self, secret: Secret) {
        self.protection = e2e::Receiver::new(secret);
    }

    /// The takeover, for messages.
    pub const fn takeover(&self) -> &Takeover<f32> {
        &self.takeover
    }
}

impl Guidance for ByRows {
    type Settings = TakeoverSettings<f32>;

    fn new(
        settings: &TakeoverSettings<f32>,
        controller: &Settings<f32>,
    ) -> Result<Self, TakeoverError> {
        Ok(Self {
            takeover: Takeover::new(*settings, *controller)?,
            protection: e2e::Receiver::new(Secret::None),
            time: 0,
            sighting: None,
        })
    }

    fn step(&mut self, known: &Known) -> Guide {
        self.takeover.step(&Situation {
            running: known.mode == Mode::AutonomousRun,
            fixed: known.fixed,
            tracking: known.tracking,
            sighting: self.sighting.take(),
            dt: known.dt,
        })
    }

    fn drive(&mut self, motion: &Motion) -> Option<Command<f32>> {
        let guides = matches!(self.takeover.guide(), Guide::Rows | Guide::Returning);
        guides.then(|| {
            let (command, _) = self.takeover.drive(
                &motion.tracking,
                motion.applied,
                motion.steering_angle,
                motion.effectiveness,
                motion.dt,
            );
            command
        })
    }
}

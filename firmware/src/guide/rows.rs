//! The rows of a crop guide a run while the receiver has no fix.

use control::controller::Settings;
use control::mode::Mode;
use control::safety::Command;
use control::takeover::{Guide, RowSighting, Situation, Takeover, TakeoverSettings};
use network::Message;

use super::{Guidance, GuideError, Known, Lead, Motion, Sealed};
use crate::e2e::Secret;
use crate::pilot::Reason;

/// The rows of a crop.
#[derive(Clone, Debug)]
pub struct ByRows {
    takeover: Takeover<f32>,
    sightings: Sealed<RowSighting<f32>>,
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
        self.sightings.see::<M>(data, time, read);
    }

    /// The secret of the session, by which it knows true frames; without one none is true. [`Secret::None`] at
    /// first.
    pub fn set_secret(&mut self, secret: Option<Secret>) {
        self.sightings.protection.set_secret(secret);
    }

    /// The takeover, for messages.
    pub const fn takeover(&self) -> &Takeover<f32> {
        &self.takeover
    }
}

impl Guidance for ByRows {
    type Settings = TakeoverSettings<f32>;

    const LOST: Reason = Reason::FixLost;

    fn new(
        settings: &TakeoverSettings<f32>,
        controller: &Settings<f32>,
    ) -> Result<Self, GuideError> {
        Ok(Self {
            takeover: Takeover::new(*settings, *controller).map_err(GuideError::Rows)?,
            sightings: Sealed::new(),
        })
    }

    fn step(&mut self, known: &Known) -> Lead {
        let guide = self.takeover.step(&Situation {
            running: known.mode == Mode::AutonomousRun,
            fixed: known.fixed,
            tracking: known.tracking,
            sighting: self.sightings.last.take(),
            dt: known.dt,
        });
        match guide {
            Guide::Satellites | Guide::Returning => Lead::Satellites,
            Guide::Rows => Lead::Rows,
            Guide::Nothing => Lead::Nobody,
        }
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

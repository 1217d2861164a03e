//! A planner leads runs: a computer above the control layer, which asks for a curvature and a speed.

use control::controller::Settings;
use control::demand::{self, Demand, DemandLaw, DemandSettings};
use control::mode::Mode;
use control::safety::Command;
use network::Message;

use super::{Guidance, GuideError, Known, Lead, Motion, Sealed};
use crate::e2e::Secret;
use crate::pilot::Reason;

/// A planner.
#[derive(Clone, Debug)]
pub struct ByPlanner {
    law: DemandLaw<f32>,
    demands: Sealed<Demand<f32>>,
    /// Frames whose protection did not hold; wraps.
    refused: u8,
}

impl ByPlanner {
    /// Takes a frame of the planner, in the basic cycle that began at system time `time` (ms). The frame came in the
    /// cycle before, of which its check value is. `read` gives what its data say. A frame whose protection does not
    /// hold is none.
    pub fn see<M: Message>(
        &mut self,
        data: Option<&[u8]>,
        time: u32,
        read: impl FnOnce(&[u8; 8]) -> Option<Demand<f32>>,
    ) {
        let refused = self.demands.see::<M>(data, time, read);
        self.refused = self.refused.wrapping_add(refused.into());
    }

    /// The secret of the session, by which it knows true frames; without one none is true. [`Secret::None`] at
    /// first.
    pub fn set_secret(&mut self, secret: Option<Secret>) {
        self.demands.protection.set_secret(secret);
    }

    /// The law, for messages.
    pub const fn law(&self) -> &DemandLaw<f32> {
        &self.law
    }

    /// Frames so far whose protection did not hold; wraps.
    pub const fn refused(&self) -> u8 {
        self.refused
    }
}

impl Guidance for ByPlanner {
    type Settings = DemandSettings<f32>;

    const LOST: Reason = Reason::NoCommands;

    fn new(settings: &DemandSettings<f32>, controller: &Settings<f32>) -> Result<Self, GuideError> {
        Ok(Self {
            law: DemandLaw::new(*settings, *controller).map_err(GuideError::Planner)?,
            demands: Sealed::new(),
            refused: 0,
        })
    }

    fn step(&mut self, known: &Known) -> Lead {
        let running = known.mode == Mode::AutonomousRun;
        match self.law.step(running, self.demands.last.take(), known.dt) {
            demand::Lead::Path => Lead::Satellites,
            demand::Lead::Demands => Lead::Planner,
            demand::Lead::Nobody => Lead::Nobody,
        }
    }

    fn drive(&mut self, motion: &Motion) -> Option<Command<f32>> {
        (self.law.lead() == demand::Lead::Demands).then(|| {
            self.law.drive(
                motion.applied,
                motion.tracking.steering_angle,
                motion.steering_angle,
                motion.tracking.speed,
                motion.effectiveness,
                motion.dt,
            )
        })
    }
}

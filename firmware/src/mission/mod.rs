//! Missions: their record in the flash, and the task that plans them.
//!
//! A mission lies in a part of the flash of its own. [`Stored`] reads it, and is a [`control::mission::Mission`]. A task of
//! low priority makes the path of it a little ahead of the vehicle ([`Work`]); the control step follows that.

mod record;
#[cfg(feature = "f446")]
mod replace;
mod sections;
mod shown;
pub mod store;
pub mod transport;
pub mod upload;
mod work;

pub use record::{FORMAT, Head, Kept, Recorded, Stored, Verification, dropped, words};
pub use sections::{NEVER, Told, lead, told};
pub use shown::{Shown, Stage};
pub use work::{At, FAR, Standing, State, Stray, Work};

#[cfg(feature = "f446")]
pub use replace::replace;

use control::controller::Settings;
use control::fence::Footprint;
use control::mission::MissionSettings;

/// What a vehicle brings to its missions, beside the settings of its law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Speed in headland turns, m/s.
    pub turn_speed: f32,
    /// Share of the steering's angle and rate that no path uses.
    pub reserve: f32,
    /// Half of its width, m.
    pub half_width: f32,
    /// From the rear axle to the front, m.
    pub ahead: f32,
    /// From the rear axle to the rear, m.
    pub behind: f32,
    /// How far paths stay away from fence and obstacles beside this ground, m.
    pub clearance: f32,
    /// How far beside its path the vehicle may work: farther off it, all sections are off, m.
    pub aside: f32,
    /// Largest acceleration of its drive, m/s^2.
    pub acceleration: f32,
}

impl Design {
    /// The ground that the vehicle covers.
    pub const fn footprint(&self) -> Footprint<f32> {
        Footprint {
            half_width: self.half_width,
            ahead: self.ahead,
            behind: self.behind,
        }
    }

    /// What a mission may ask of a vehicle with these settings of its law.
    pub fn settings(&self, controller: &Settings<f32>) -> MissionSettings<f32> {
        let mut settings = MissionSettings::for_controller(
            controller,
            self.footprint(),
            self.turn_speed,
            self.reserve,
        );
        settings.clearance = self.clearance;
        // A mission accelerates gently, and no faster than the drive.
        settings.pace.acceleration = settings.pace.acceleration.min(self.acceleration);
        settings
    }
}

#[cfg(test)]
#[path = "../../tests/support/missions.rs"]
#[expect(unreachable_pub, reason = "the fuzz target has it, too")]
mod example;

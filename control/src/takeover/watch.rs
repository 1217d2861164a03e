//! The place between the rows, for a vehicle that something else steers.

use crate::row::{
    RowDistances, RowEstimator, RowPose, RowSettings, RowSettingsError, SideHealth, WheelSpeeds,
};
use crate::scalar::Scalar;

/// What is known of the rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Presence {
    /// No rows have been found.
    #[default]
    Searching,
    /// The vehicle is between rows.
    Following,
    /// The rows have ended, and no others have been found.
    End,
    /// Both sensors are faulty.
    Faulty,
}

/// Where the vehicle is between the rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowSighting<T> {
    /// What is known of the rows. Without rows the other fields mean nothing.
    pub presence: Presence,
    /// Place of the point about which the vehicle turns, its rear axle.
    pub pose: RowPose<T>,
    /// Standard deviation of the offset that the vehicle would have where the beams
    /// meet the rows, m.
    pub deviation: T,
}

/// Finds the vehicle's place between the rows.
#[derive(Clone, Copy, Debug)]
pub struct RowWatch<T> {
    settings: RowSettings<T>,
    estimator: RowEstimator<T>,
    presence: Presence,
    /// Way along rows since they were found, m; up to what makes them certain.
    seen: T,
}

impl<T: Scalar> RowWatch<T> {
    /// A watch that has seen nothing. Of the settings, the estimator and the two ways
    /// count.
    ///
    /// # Errors
    /// [`RowSettingsError`] names the setting that is unusable.
    pub fn new(settings: RowSettings<T>) -> Result<Self, RowSettingsError> {
        settings.check()?;
        Ok(Self::of(settings))
    }

    /// The same, with settings that were checked before.
    #[must_use]
    pub fn of(settings: RowSettings<T>) -> Self {
        Self {
            settings,
            estimator: RowEstimator::of(settings.estimator),
            presence: Presence::Searching,
            seen: T::zero(),
        }
    }

    /// The part of a step that a message waits for, `dt` seconds after the last one: the
    /// vehicle drove at `speed` (m/s) and turned at `turn` (rad/s, to the right) since
    /// then, and measures `distances` now.
    pub fn observe(
        &mut self,
        distances: &RowDistances<T>,
        speed: T,
        turn: T,
        dt: T,
    ) -> RowSighting<T> {
        let lead = turn * self.settings.estimator.motion.track * T::lit(0.5);
        let wheels = WheelSpeeds {
            left: speed + lead,
            right: speed - lead,
        };
        let estimate = self.estimator.observe(distances, &wheels, dt);
        let faulty =
            |side: SideHealth| matches!(side, SideHealth::Frozen | SideHealth::Implausible);
        // Rows are certain after a way on which nothing but rows prevents a new start.
        let certain = self.settings.end_way * T::lit(1.5);
        if estimate.open_way >= self.settings.end_way {
            self.lose(match self.presence {
                Presence::Following | Presence::End => Presence::End,
                Presence::Searching | Presence::Faulty => Presence::Searching,
            });
        } else if faulty(estimate.left) && faulty(estimate.right) {
            self.presence = Presence::Faulty;
            self.seen = T::zero();
        } else if estimate.blind_way >= self.settings.lost_way {
            self.lose(Presence::Searching);
        } else if self.seen < certain {
            self.seen += (speed * dt).abs();
        } else {
            self.presence = Presence::Following;
        }
        RowSighting {
            presence: self.presence,
            pose: estimate.pose,
            deviation: estimate.deviation,
        }
    }

    /// The rest of a step, due before the next one.
    pub fn correct(&mut self) {
        self.estimator.correct();
    }

    /// Begins anew.
    fn lose(&mut self, presence: Presence) {
        self.presence = presence;
        self.seen = T::zero();
        self.estimator.restart();
    }
}

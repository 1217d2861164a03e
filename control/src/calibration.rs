//! Calibrations of the steering (thesis 5.2.6): potentiometer counts to
//! steering angle, steering rate to actuator effort.

use crate::scalar::Scalar;

/// The straight line from potentiometer counts to steering angle (thesis
/// Figure 5.18).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Potentiometer<T> {
    /// Reading with the wheels straight, counts.
    pub centre: T,
    /// Counts for one radian to the right; negative when the potentiometer
    /// runs the other way; not zero.
    pub counts_per_radian: T,
    /// Smallest reading of an intact potentiometer, counts.
    pub lowest: u16,
    /// Largest reading of an intact potentiometer, counts.
    pub highest: u16,
}

/// A reading that no intact potentiometer gives: a broken or shorted wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadingOutOfRange {
    /// The reading, counts.
    pub counts: u16,
}

impl core::fmt::Display for ReadingOutOfRange {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "potentiometer reading {} is outside its range",
            self.counts
        )
    }
}

impl core::error::Error for ReadingOutOfRange {}

impl<T: Scalar> Potentiometer<T> {
    /// Steering angle for a reading, rad, positive to the right.
    ///
    /// # Errors
    /// [`ReadingOutOfRange`] outside `lowest..=highest`.
    pub fn angle(&self, counts: u16) -> Result<T, ReadingOutOfRange> {
        if counts < self.lowest || counts > self.highest {
            return Err(ReadingOutOfRange { counts });
        }
        Ok((T::integer(i32::from(counts)) - self.centre) / self.counts_per_radian)
    }

    /// The reading that a steering angle (rad) gives, counts, unrounded.
    #[must_use]
    pub fn counts(&self, angle: T) -> T {
        self.centre + angle * self.counts_per_radian
    }
}

/// One direction of the actuator: no motion up to a dead band, then a
/// straight line (thesis Figure 5.20).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction<T> {
    /// Effort at which motion starts, in [0, 1).
    pub dead_band: T,
    /// Rate at full effort, rad/s for steering, m/s for a drive motor;
    /// positive.
    pub full_rate: T,
}

/// The actuator's calibration: one first-order line for each sign of the
/// commanded rate (thesis 5.2.6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Actuator<T> {
    /// Positive rates (to the right, forward).
    pub positive: Direction<T>,
    /// Negative rates (to the left, backward).
    pub negative: Direction<T>,
}

impl<T: Scalar> Direction<T> {
    fn effort(&self, rate: T) -> T {
        let effort = self.dead_band + (T::one() - self.dead_band) * rate / self.full_rate;
        if effort < T::one() { effort } else { T::one() }
    }

    fn rate(&self, effort: T) -> T {
        if effort > self.dead_band {
            (effort - self.dead_band) / (T::one() - self.dead_band) * self.full_rate
        } else {
            T::zero()
        }
    }
}

impl<T: Scalar> Actuator<T> {
    /// Effort in [-1, 1] that gives `rate`; the dead band is jumped over.
    /// Zero and NaN give zero; rates beyond reach give full effort.
    #[must_use]
    pub fn effort(&self, rate: T) -> T {
        if rate > T::zero() {
            self.positive.effort(rate)
        } else if rate < T::zero() {
            -self.negative.effort(-rate)
        } else {
            T::zero()
        }
    }

    /// Rate that an `effort` in [-1, 1] gives; zero inside the dead band.
    #[must_use]
    pub fn rate(&self, effort: T) -> T {
        if effort >= T::zero() {
            self.positive.rate(effort)
        } else {
            -self.negative.rate(-effort)
        }
    }
}

//! Settings of the estimator between two rows.

use super::beams::{Beams, RowPose, Side};
use crate::scalar::Scalar;

/// Settings of the estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowEstimatorSettings<T> {
    /// The sensors' beams.
    pub beams: Beams<T>,
    /// The rows.
    pub rows: Rows<T>,
    /// The readings.
    pub readings: Readings<T>,
    /// The robot's motion.
    pub motion: Motion<T>,
}

/// What is known of the rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rows<T> {
    /// Half the distance between the stalks of both rows, m.
    pub half_width: T,
    /// Standard deviation of `half_width` from row to row, m.
    pub tolerance: T,
    /// Distance from either row to the next one behind it, m; 0 if there is none.
    pub spacing: T,
    /// Way over which the width changes by about its tolerance, m.
    pub width_way: T,
    /// Standard deviation of the stalks beside their row's line, m. It includes
    /// what the sensors add.
    pub scatter: T,
    /// The same for the stalks of the next row, m. It includes how well the distance of the
    /// rows is known.
    pub far_scatter: T,
    /// How much the bend of the rows is corrected for each metre that a stalk of the next
    /// row stands beside its place, 1/m^2; 0 keeps the rows straight.
    pub bend_gain: T,
}

/// How readings are judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readings<T> {
    /// Smallest reading of an intact sensor, m.
    pub least: T,
    /// Readings from here on mean that no plant is within range, m.
    pub open: T,
    /// Two successive readings that differ by more than this come from two surfaces, m.
    pub agreement: T,
    /// Width of a stalk as the beam sees it, m. What is seen for less than a sixth of it
    /// does not count.
    pub run: T,
    /// Way along one surface after which it is a wall and counts, again and again, m: more
    /// than the longest leaf.
    pub surface: T,
    /// Way over which the share of leaves at a side is averaged, m.
    pub leaf_way: T,
    /// Width of a surface, across the beam, from which on it is more likely a leaf than
    /// its place alone says, m.
    pub wide: T,
    /// Factor by which a surface is more likely a leaf than its place alone says for each
    /// of its ends at which something else near by follows without a space.
    pub touching: T,
    /// What a run comes from where leaves hide little of a side.
    pub clear: Odds<T>,
    /// What a run comes from where leaves hide more than half of a side.
    pub leafy: Odds<T>,
    /// Weight with which each run also speaks for a robot that may be anywhere,
    /// in (0, 0.5]: so a wrong estimate is left again.
    pub doubt: T,
    /// Way with the same reading, or with none that is possible, after which
    /// a sensor counts as faulty, m.
    pub fault_way: T,
    /// Way without a stalk after which a side no longer carries the estimate, m.
    pub fresh_way: T,
}

/// What a run of readings comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odds<T> {
    /// Probability of a stalk, in (0, 1].
    pub stalk: T,
    /// Probability density of anything nearer than the row, 1/m, positive.
    pub near: T,
    /// Probability density of anything that stands behind the row and is no stalk of
    /// the next one, 1/m, positive. The smaller it is, the sooner a leaf that was
    /// taken for a stalk is given up when stalks are seen behind it.
    pub far: T,
}

impl<T: Scalar> Odds<T> {
    fn are_sound(&self) -> bool {
        is_positive(self.stalk)
            && self.stalk <= T::one()
            && is_positive(self.near)
            && is_positive(self.far)
    }
}

/// How the robot moves, and how far that is uncertain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<T> {
    /// Distance between left and right wheels that makes the turn rate of the
    /// difference of both speeds, m. With wheels that slip sideways in a turn it
    /// is larger than the distance by construction.
    pub track: T,
    /// Largest speed of a wheel, m/s. Larger commands count as this one.
    pub wheel_speed: T,
    /// Time constant with which the wheels follow their command, s; may be 0.
    pub lag: T,
    /// Standard deviation of the heading that a metre of ground adds, rad.
    pub heading_walk: T,
    /// Standard deviation of the offset that a metre of ground adds, m.
    pub offset_walk: T,
    /// Standard deviation of the heading that a commanded turn by 1 rad adds, rad.
    pub turn_error: T,
    /// Standard deviation of the curvature from motors that differ and from
    /// rows that bend, 1/m.
    pub curvature: T,
    /// Way over which this curvature changes, m.
    pub curvature_way: T,
}

/// The setting of the estimator that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowEstimatorError {
    /// The half width is not positive.
    HalfWidth,
    /// The width's tolerance is not positive or not below the half width.
    Tolerance,
    /// The distance to the next row is negative.
    Spacing,
    /// A scatter is not positive.
    Scatter,
    /// The gain of the bend is negative.
    BendGain,
    /// The least reading is negative or not below the open one.
    Range,
    /// The row is farther than the open reading.
    OutOfRange,
    /// The agreement is not positive.
    Agreement,
    /// Odds are not positive, or a probability is above 1.
    Odds,
    /// The weight of doubt is outside (0, 0.5].
    Doubt,
    /// A way is not positive.
    Way,
    /// The track is not positive.
    Track,
    /// The largest wheel speed is not positive.
    WheelSpeed,
    /// The lag is negative.
    Lag,
    /// A standard deviation of the motion is not positive.
    Walk,
}

impl core::fmt::Display for RowEstimatorError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::HalfWidth => "half the width between the rows is not a positive number",
            Self::Tolerance => {
                "the tolerance of the width is not a positive number below half the width"
            }
            Self::Spacing => "the distance to the next row is not a number of at least 0",
            Self::Scatter => "the scatter of the stalks is not a positive number",
            Self::BendGain => "the gain of the rows' bend is not a number of at least 0",
            Self::Range => "the least reading is negative or not below the open one",
            Self::OutOfRange => "the rows are farther from the sensors than the open reading",
            Self::Agreement => "the agreement of readings is not a positive number",
            Self::Odds => "odds of a run are not positive, or a probability is above 1",
            Self::Doubt => "the weight of doubt is not between 0 and 0.5",
            Self::Way => "a way of the row estimator is not a positive number",
            Self::Track => "the track between the wheels is not a positive number",
            Self::WheelSpeed => "the largest wheel speed is not a positive number",
            Self::Lag => "the lag of the wheels is not a number of at least 0",
            Self::Walk => "a standard deviation of the motion is not a positive number",
        })
    }
}

impl core::error::Error for RowEstimatorError {}

fn is_positive<T: Scalar>(value: T) -> bool {
    value.is_finite() && value > T::zero()
}

impl<T: Scalar> RowEstimatorSettings<T> {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`RowEstimatorError`] names the setting that is unusable.
    pub fn check(&self) -> Result<(), RowEstimatorError> {
        let Self {
            rows,
            readings,
            motion,
            ..
        } = self;
        if !is_positive(rows.half_width) {
            return Err(RowEstimatorError::HalfWidth);
        }
        if !(is_positive(rows.tolerance) && rows.tolerance < rows.half_width) {
            return Err(RowEstimatorError::Tolerance);
        }
        if !(rows.spacing.is_finite() && rows.spacing >= T::zero()) {
            return Err(RowEstimatorError::Spacing);
        }
        if !(is_positive(rows.scatter) && is_positive(rows.far_scatter)) {
            return Err(RowEstimatorError::Scatter);
        }
        if !(rows.bend_gain.is_finite() && rows.bend_gain >= T::zero()) {
            return Err(RowEstimatorError::BendGain);
        }
        if !(readings.least >= T::zero()
            && readings.open.is_finite()
            && readings.least < readings.open)
        {
            return Err(RowEstimatorError::Range);
        }
        let middle = RowPose {
            offset: T::zero(),
            heading: T::zero(),
            half_width: rows.half_width,
        };
        let seen = self.beams.predict(Side::Left, &middle);
        if !seen.is_some_and(|row| row.distance < readings.open && row.distance > readings.least) {
            return Err(RowEstimatorError::OutOfRange);
        }
        if !is_positive(readings.agreement) {
            return Err(RowEstimatorError::Agreement);
        }
        if !(readings.clear.are_sound() && readings.leafy.are_sound()) {
            return Err(RowEstimatorError::Odds);
        }
        if !(is_positive(readings.doubt) && readings.doubt <= T::lit(0.5)) {
            return Err(RowEstimatorError::Doubt);
        }
        let ways = [
            rows.width_way,
            readings.run,
            readings.wide,
            readings.touching,
            readings.surface,
            readings.leaf_way,
            readings.fault_way,
            readings.fresh_way,
            motion.curvature_way,
        ];
        if !ways.into_iter().all(is_positive) {
            return Err(RowEstimatorError::Way);
        }
        if !is_positive(motion.track) {
            return Err(RowEstimatorError::Track);
        }
        if !is_positive(motion.wheel_speed) {
            return Err(RowEstimatorError::WheelSpeed);
        }
        if !(motion.lag.is_finite() && motion.lag >= T::zero()) {
            return Err(RowEstimatorError::Lag);
        }
        let walks = [
            motion.heading_walk,
            motion.offset_walk,
            motion.turn_error,
            motion.curvature,
        ];
        if !walks.into_iter().all(is_positive) {
            return Err(RowEstimatorError::Walk);
        }
        Ok(())
    }
}

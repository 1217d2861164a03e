//! The geometry of two distance sensors between two rows of plants.
//!
//! Both sensors sit at the front, one on each side of the middle, and look
//! across the middle: the right one measures the distance to the left row, the
//! left one that to the right row (thesis 2.2.1, Figure 2.3). A beam that meets
//! no plant in its row goes on to whatever is behind it, and at 45 degrees it
//! does so most of the time: stalks of 25 mm every 0.2 m cover a sixth of the
//! row as such a beam sees it.

use crate::scalar::Scalar;

/// One of the two rows, seen in the direction of travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The row on the left.
    Left,
    /// The row on the right.
    Right,
}

/// Where the sensors are mounted. Both are mounted alike, mirrored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting<T> {
    /// Aperture ahead of the point about which the robot turns, m.
    pub ahead: T,
    /// Aperture beside the robot's centre line, m, positive.
    pub beside: T,
    /// Angle from straight ahead by which each beam looks across the centre line,
    /// rad, above 0 and at most a right angle.
    pub angle: T,
}

/// The number of a [`Mounting`] that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountingError {
    /// The distance ahead is not a number.
    Ahead,
    /// The distance beside the centre line is not positive.
    Beside,
    /// The angle is not between 10 and 90 degrees.
    Angle,
}

impl core::fmt::Display for MountingError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Ahead => "the sensors' distance ahead of the turning point is not a number",
            Self::Beside => "the sensors' distance from the centre line is not a positive number",
            Self::Angle => "the sensors' angle is not between 10 and 90 degrees",
        })
    }
}

impl core::error::Error for MountingError {}

/// Place of the robot between two parallel rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPose<T> {
    /// The point about which the robot turns, right of the middle between the
    /// rows, m.
    pub offset: T,
    /// Heading clockwise from the direction of the rows, rad.
    pub heading: T,
    /// Half the distance between the rows, m.
    pub half_width: T,
}

/// A predicted distance and how it changes with the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction<T> {
    /// From the aperture along the beam to the row line, m.
    pub distance: T,
    /// Change of the distance with the offset, m/m.
    pub by_offset: T,
    /// Change of the distance with the heading, m/rad.
    pub by_heading: T,
    /// Change of the distance with half the width, m/m.
    pub by_half_width: T,
}

/// The beams of two sensors with a sound [`Mounting`], as [`Beams::new`] makes them. Its fields are
/// public so that a program may have them as a constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beams<T> {
    /// Where the sensors are mounted.
    pub mounting: Mounting<T>,
    /// Sine of the beams' angle.
    pub sine: T,
    /// Cosine of the beams' angle.
    pub cosine: T,
}

/// Least sine of the angle between a beam and the row. A beam that is closer to
/// parallel does not meet the row within a useful distance.
const LEAST_SINE: f64 = 0.15;

impl<T: Scalar> Beams<T> {
    /// The beams of sensors that are mounted so.
    ///
    /// # Errors
    /// [`MountingError`] names the number that is unusable.
    pub fn new(mounting: Mounting<T>) -> Result<Self, MountingError> {
        if !mounting.ahead.is_finite() {
            return Err(MountingError::Ahead);
        }
        if !(mounting.beside.is_finite() && mounting.beside > T::zero()) {
            return Err(MountingError::Beside);
        }
        let least = T::pi() / T::lit(18.0);
        // Half a thousandth beyond a right angle allows for a rounded pi.
        if !(mounting.angle >= least * T::lit(0.9995)
            && mounting.angle <= T::frac_pi_2() * T::lit(1.0005))
        {
            return Err(MountingError::Angle);
        }
        let (sine, cosine) = mounting.angle.sine_cosine();
        Ok(Self {
            mounting,
            sine,
            cosine,
        })
    }

    /// Where the sensors are mounted.
    #[must_use]
    pub fn mounting(&self) -> Mounting<T> {
        self.mounting
    }

    /// Distance from the turning point to the place ahead at which both beams
    /// meet rows of this half width, when the robot is in the middle and points
    /// along the rows, m. Half the difference of both distances is, for small
    /// headings, the offset of this place from the middle.
    #[must_use]
    pub fn reach(&self, half_width: T) -> T {
        let across = self.mounting.beside + half_width;
        self.mounting.ahead + across * self.cosine / self.sine
    }

    /// How far the beam towards the row at `side` sweeps across what it meets at
    /// `distance` (m), while the robot drives `ahead` (m) and turns by `turned`
    /// (rad, clockwise), m. A short way, to which the sweep is at a right angle.
    #[must_use]
    pub fn swept(&self, side: Side, distance: T, ahead: T, turned: T) -> T {
        let turned = match side {
            Side::Left => turned,
            Side::Right => -turned,
        };
        let Mounting {
            ahead: arm, beside, ..
        } = self.mounting;
        let lever = distance + arm * self.cosine - beside * self.sine;
        ahead * self.sine + turned * lever
    }

    /// Distance to the straight line of the row at `side`, as the sensor at the
    /// other side measures it. `None` if the beam does not meet that line within
    /// a useful distance: the heading turns the beam nearly parallel to it, or
    /// the aperture is beyond it.
    #[must_use]
    pub fn predict(&self, side: Side, pose: &RowPose<T>) -> Option<Prediction<T>> {
        self.view(side, pose, T::zero(), pose.heading.sine_cosine())
            .predict(T::zero(), T::zero(), T::zero())
    }

    /// The row at `side`, with its `bend` to the right (1/m), from a pose of which sine and
    /// cosine of the heading are known.
    pub(super) fn view(
        &self,
        side: Side,
        pose: &RowPose<T>,
        bend: T,
        (sine, cosine): (T, T),
    ) -> View<T> {
        // The right row is the left one in a mirror.
        let mirror = match side {
            Side::Left => T::one(),
            Side::Right => -T::one(),
        };
        let sine = sine * mirror;
        let Mounting { ahead, beside, .. } = self.mounting;
        View {
            mirror,
            across: pose.half_width + pose.offset * mirror + ahead * sine + beside * cosine,
            by_heading: ahead * cosine - beside * sine,
            steep: self.sine * cosine - self.cosine * sine,
            along: self.cosine * cosine + self.sine * sine,
            ahead,
            bend,
        }
    }
}

/// One row from one pose. It predicts the distance for poses near by without
/// angular functions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct View<T> {
    mirror: T,
    /// From the aperture to the row, across it, m.
    across: T,
    /// Change of that with the mirrored heading, m/rad.
    by_heading: T,
    /// Sine and cosine of the angle between beam and row.
    steep: T,
    along: T,
    /// From the turning point to the apertures, m.
    ahead: T,
    /// Curvature of the rows, to the right, 1/m.
    bend: T,
}

impl<T: Scalar> View<T> {
    /// Distance for a pose that differs by these (m, rad, m). The third power of
    /// the heading's difference is left out.
    pub(super) fn predict(&self, offset: T, heading: T, half_width: T) -> Option<Prediction<T>> {
        let heading = heading * self.mirror;
        let across = self.across + half_width + offset * self.mirror + self.by_heading * heading;
        let steep = self.steep - (self.along + self.steep * heading * T::lit(0.5)) * heading;
        if !(across > T::zero() && steep > T::lit(LEAST_SINE)) {
            return None;
        }
        let by_width = T::one() / steep;
        // A bend moves the row aside by half its curvature times the square of the
        // distance ahead.
        let ahead = self.ahead + across * by_width * self.along;
        let across = across - self.mirror * self.bend * ahead * ahead * T::lit(0.5);
        let distance = across * by_width;
        let along = self.along + self.steep * heading;
        let by_offset = by_width * self.mirror;
        Some(Prediction {
            distance,
            by_offset,
            by_heading: (self.by_heading + distance * along) * by_offset,
            by_half_width: by_width,
        })
    }
}

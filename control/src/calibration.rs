//! Calibrations of the steering (thesis 5.2.6): from potentiometer counts to
//! steering angle, and from steering rate to actuator effort.

use crate::model::{Antenna, Geometry};
use crate::scalar::Scalar;

/// Calibration of the steering potentiometer: the steering angle is a linear
/// function of the counts (thesis Figure 5.18).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Potentiometer<T> {
    /// Reading with the wheels straight ahead, counts.
    pub centre: T,
    /// Counts per radian to the right. Negative if the counts fall towards the
    /// right; never zero.
    pub counts_per_radian: T,
    /// Smallest reading of an intact potentiometer, counts.
    pub lowest: u16,
    /// Largest reading of an intact potentiometer, counts.
    pub highest: u16,
}

/// A reading outside the range of an intact potentiometer, as from a broken or
/// shorted wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadingOutOfRange {
    /// The reading, counts.
    pub counts: u16,
}

impl core::fmt::Display for ReadingOutOfRange {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "potentiometer reading {} is outside the range of an intact one",
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

    /// The reading for a steering angle (rad), counts, not rounded.
    #[must_use]
    pub fn counts(&self, angle: T) -> T {
        self.centre + angle * self.counts_per_radian
    }
}

/// Calibration of one direction of an actuator: no motion within the dead
/// band, then a rate that grows linearly with the effort (thesis Figure 5.20).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction<T> {
    /// Effort at which motion starts, in [0, 1).
    pub dead_band: T,
    /// Rate at full effort, rad/s for steering, m/s for a drive motor;
    /// positive.
    pub full_rate: T,
}

/// Calibration of an actuator, with a line for each sign of the commanded rate
/// (thesis 5.2.6).
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
    /// Effort in [-1, 1] for `rate`, with the dead band compensated. Zero and
    /// NaN give zero. A rate above the full rate gives full effort.
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

    /// Rate at an `effort` in [-1, 1]; zero inside the dead band.
    #[must_use]
    pub fn rate(&self, effort: T) -> T {
        if effort >= T::zero() {
            self.positive.rate(effort)
        } else {
            -self.negative.rate(-effort)
        }
    }
}

/// Why a fit has no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitError {
    /// Too few samples: this many.
    TooFew(u32),
    /// The samples do not determine the fit: they all lie at one point, or all
    /// on one line.
    NoSpread,
    /// The result describes no real device: a rate that falls with the effort,
    /// or a dead band outside [0, 1).
    Implausible,
}

impl core::fmt::Display for FitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooFew(count) => write!(f, "{count} samples are too few for a fit"),
            Self::NoSpread => f.write_str("the samples lie too close together for a fit"),
            Self::Implausible => f.write_str(
                "the fit describes no real device: a wrong sign, or a dead band out of range",
            ),
        }
    }
}

impl core::error::Error for FitError {}

/// A straight line through samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedLine<T> {
    /// Growth of y with x.
    pub slope: T,
    /// y at x = 0.
    pub offset: T,
    /// Root mean square of the residuals, in units of y.
    pub residual: T,
    /// Number of samples.
    pub count: u32,
}

/// Recursive least squares for y = slope x + offset. It uses Welford's update,
/// which loses no digits when the means are large.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFit<T> {
    count: u32,
    mean_x: T,
    mean_y: T,
    xx: T,
    xy: T,
    yy: T,
}

impl<T: Scalar> LineFit<T> {
    /// A fit without samples.
    #[must_use]
    pub fn new() -> Self {
        let zero = T::zero();
        Self {
            count: 0,
            mean_x: zero,
            mean_y: zero,
            xx: zero,
            xy: zero,
            yy: zero,
        }
    }

    /// Adds a sample. A sample that is not finite is ignored.
    pub fn add(&mut self, x: T, y: T) {
        if !(x.is_finite() && y.is_finite()) {
            return;
        }
        self.count = self.count.saturating_add(1);
        let share = T::one() / T::lit(f64::from(self.count));
        let (dx, dy) = (x - self.mean_x, y - self.mean_y);
        self.mean_x += dx * share;
        self.mean_y += dy * share;
        self.xx += dx * (x - self.mean_x);
        self.xy += dx * (y - self.mean_y);
        self.yy += dy * (y - self.mean_y);
    }

    /// The fitted line.
    ///
    /// # Errors
    /// [`FitError::TooFew`] below three samples, [`FitError::NoSpread`] if all x
    /// are equal.
    pub fn solve(&self) -> Result<FittedLine<T>, FitError> {
        if self.count < 3 {
            return Err(FitError::TooFew(self.count));
        }
        let size = self.mean_x * self.mean_x * T::lit(f64::from(self.count));
        if !(self.xx > size * T::default_epsilon()) || !(self.xx > T::zero()) {
            return Err(FitError::NoSpread);
        }
        let slope = self.xy / self.xx;
        let rest = self.yy - slope * self.xy;
        let rest = if rest > T::zero() { rest } else { T::zero() };
        Ok(FittedLine {
            slope,
            offset: self.mean_y - slope * self.mean_x,
            residual: (rest / T::lit(f64::from(self.count))).root(),
            count: self.count,
        })
    }
}

/// A fitted circle: the track of an antenna while the steering is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedCircle<T> {
    /// Centre, in the coordinates of the samples, m.
    pub north: T,
    /// Centre, in the coordinates of the samples, m.
    pub east: T,
    /// Radius, m.
    pub radius: T,
}

/// Recursive least squares for a circle (Kasa, IEEE Trans. Instrum. Meas. 25,
/// 1976). Positions are taken relative to the first one.
///
/// Drive at least a third of the circle: from a short arc this method
/// underestimates the radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleFit<T> {
    count: u32,
    first: (T, T),
    normal: nalgebra::SMatrix<T, 3, 3>,
    right: nalgebra::SVector<T, 3>,
}

impl<T: Scalar> CircleFit<T> {
    /// A fit without samples.
    #[must_use]
    pub fn new() -> Self {
        Self {
            count: 0,
            first: (T::zero(), T::zero()),
            normal: nalgebra::SMatrix::zeros(),
            right: nalgebra::SVector::zeros(),
        }
    }

    /// Adds a position (m). A position that is not finite is ignored.
    pub fn add(&mut self, north: T, east: T) {
        if !(north.is_finite() && east.is_finite()) {
            return;
        }
        if self.count == 0 {
            self.first = (north, east);
        }
        self.count = self.count.saturating_add(1);
        let (x, y) = (north - self.first.0, east - self.first.1);
        let row = nalgebra::SVector::<T, 3>::new(x, y, T::one());
        self.normal += row * row.transpose();
        self.right += row * (x * x + y * y);
    }

    /// The fitted circle.
    ///
    /// # Errors
    /// [`FitError::TooFew`] below four samples, [`FitError::NoSpread`] if they
    /// lie on one point or one line.
    pub fn solve(&self) -> Result<FittedCircle<T>, FitError> {
        if self.count < 4 {
            return Err(FitError::TooFew(self.count));
        }
        let found = crate::linear::solve(self.normal, self.right).ok_or(FitError::NoSpread)?;
        let half = T::lit(0.5);
        let (x, y) = (found[0] * half, found[1] * half);
        let square = found[2] + x * x + y * y;
        if !(square > T::zero() && square.is_finite()) {
            return Err(FitError::NoSpread);
        }
        Ok(FittedCircle {
            north: x + self.first.0,
            east: y + self.first.1,
            radius: square.root(),
        })
    }
}

impl<T: Scalar> Default for CircleFit<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// Steering angle (rad) with which a vehicle drives a circle on which its
/// antenna runs at `radius` (m). Both are positive for a turn to the right.
/// `None` if no such circle exists because the antenna is farther than
/// `radius` from the rear axle.
#[must_use]
pub fn angle_on_circle<T: Scalar>(
    geometry: &Geometry<T>,
    antenna: &Antenna<T>,
    radius: T,
) -> Option<T> {
    let rear = radius * radius - geometry.l1 * geometry.l1;
    let left = radius < T::zero();
    // On the inside of the turn the antenna is nearer to the centre than the
    // centre line is.
    let beside = if left { -antenna.right } else { antenna.right };
    if !(rear > T::zero() && rear.root() + beside > T::zero()) {
        return None;
    }
    let angle = geometry.wheelbase().angle_of(rear.root() + beside);
    Some(if left { -angle } else { angle })
}

impl<T: Scalar> Potentiometer<T> {
    /// Fits a potentiometer by least squares to samples of steering angle (rad,
    /// x) and reading (counts, y) (thesis Figure 5.18). `lowest` and `highest`
    /// bound the readings of an intact one.
    ///
    /// # Errors
    /// [`FitError`]; [`FitError::Implausible`] if the counts do not change with
    /// the angle.
    pub fn fit(samples: &LineFit<T>, lowest: u16, highest: u16) -> Result<Self, FitError> {
        let line = samples.solve()?;
        // Any real potentiometer changes by more than one count per radian.
        if !(line.slope.abs() > T::one()) {
            return Err(FitError::Implausible);
        }
        Ok(Self {
            centre: line.offset,
            counts_per_radian: line.slope,
            lowest,
            highest,
        })
    }
}

/// Fits an [`Actuator`] to samples of effort and rate, with a line for each
/// sign (thesis Figure 5.20).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorFit<T> {
    still: T,
    positive: LineFit<T>,
    negative: LineFit<T>,
}

impl<T: Scalar> ActuatorFit<T> {
    /// A fit without samples. Rates up to `still` (rad/s) count as standstill
    /// and are ignored: inside the dead band the linear model does not hold.
    #[must_use]
    pub fn new(still: T) -> Self {
        Self {
            still,
            positive: LineFit::new(),
            negative: LineFit::new(),
        }
    }

    /// Adds an effort in [-1, 1] and the steady rate that it caused (rad/s).
    /// Samples at full effort are ignored: there the commanded rate may have
    /// been higher than the actuator can give.
    pub fn add(&mut self, effort: T, rate: T) {
        if !(effort.abs() < T::one()) {
            return;
        }
        if effort > T::zero() && rate > self.still {
            self.positive.add(effort, rate);
        } else if effort < T::zero() && rate < -self.still {
            self.negative.add(-effort, -rate);
        }
    }

    /// The fitted calibration.
    ///
    /// # Errors
    /// [`FitError`] of the direction that could not be fitted; of the positive
    /// one if both could not.
    pub fn solve(&self) -> Result<Actuator<T>, FitError> {
        Ok(Actuator {
            positive: Self::direction(&self.positive)?,
            negative: Self::direction(&self.negative)?,
        })
    }

    fn direction(samples: &LineFit<T>) -> Result<Direction<T>, FitError> {
        let line = samples.solve()?;
        if !(line.slope > T::zero()) {
            return Err(FitError::Implausible);
        }
        let dead_band = -line.offset / line.slope;
        if !(dead_band >= T::zero() && dead_band < T::one()) {
            return Err(FitError::Implausible);
        }
        Ok(Direction {
            dead_band,
            full_rate: line.slope + line.offset,
        })
    }
}

//! The place of a robot between two rows, estimated from two distance sensors
//! and the commanded wheel speeds.
//!
//! The states are the offset from the middle, the heading, half the width
//! between the rows, and a curvature. The curvature stands for all that turns
//! the robot against its rows steadily: motors that differ, and rows that bend.
//!
//! A reading is a mixture. It comes from a stalk, from a leaf in front of the
//! stalks, or from something behind the row, and most readings meet no plant at
//! all. Four measures separate them:
//!
//! * Readings of one surface agree with each other. Only runs of readings that
//!   agree are used, and each surface once, however long the beam stays on it.
//! * Whether a run comes from a stalk is not decided at once. Several hypotheses
//!   are kept ([`super::mixture`]), and what comes next decides: stalks lie on
//!   one line, leaves do not.
//! * Leaves hang in front of stalks. The larger the share of the way along which
//!   a side is hidden, the less is a run of this side believed to be a stalk,
//!   and the more to be a leaf if it is nearer than predicted.
//! * The width between the rows is known within a tolerance. So one side alone
//!   carries the estimate while leaves or a gap hide the other.
//!
//! Without stalks the estimate goes on by the wheel speeds, and its deviation
//! grows with the way.

use super::beams::{RowPose, Side};
use super::health::SideHealth;
use super::mixture::{Hypothesis, Matrix, Mixture, STATES, Seen, Vector, diagonal, transposed};
use super::runs::RowMemory;
use super::settings::{RowEstimatorError, RowEstimatorSettings, Rows};
use crate::scalar::{Scalar, clamp_symmetric};

const OFFSET: usize = 0;
const HEADING: usize = 1;
const HALF_WIDTH: usize = 2;
const CURVATURE: usize = 3;

/// Largest heading of the estimate, rad. The beams are of no use beyond.
const LARGEST_HEADING: f64 = 0.6;
/// Largest offset of the estimate as a share of half the width.
const LARGEST_OFFSET: f64 = 0.9;
/// Standard deviations of the offset, as a share of half the width, and of the
/// heading (rad), of a robot at its start, and of one that may be anywhere.
const AT_START: (f64, f64) = (0.15, 0.1);
const ANYWHERE: (f64, f64) = (0.2, 0.2);
/// Longest time step, s. A longer one counts as this one.
const LONGEST_STEP: f64 = 0.1;

/// Speeds of the wheels over ground, m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelSpeeds<T> {
    /// Left wheels.
    pub left: T,
    /// Right wheels.
    pub right: T,
}

/// Distances from the sensors to both rows, m. Values that are not finite stand
/// for a reading that is missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowDistances<T> {
    /// To the left row, measured by the right sensor.
    pub left: T,
    /// To the right row, measured by the left sensor.
    pub right: T,
}

/// The estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowEstimate<T> {
    /// Offset, heading and width.
    pub pose: RowPose<T>,
    /// Curvature by which the robot turns to the right against its rows although
    /// no command asks for it, 1/m.
    pub curvature: T,
    /// Standard deviation of the offset that the robot would have where the
    /// beams meet the rows, m.
    pub deviation: T,
    /// Health of the left row's readings.
    pub left: SideHealth,
    /// Health of the right row's readings.
    pub right: SideHealth,
    /// Way since the last stalk of either side, m.
    pub blind_way: T,
    /// Way since the last plant of any kind at either side, m.
    pub open_way: T,
}

/// The estimator.
#[derive(Clone, Copy, Debug)]
pub struct RowEstimator<T> {
    settings: RowEstimatorSettings<T>,
    mixture: Mixture<T>,
    /// Mean of the mixture.
    mean: Vector<T>,
    /// Speed along the robot (m/s) and turn rate (rad/s) after the lag.
    speed: T,
    turn: T,
    left: RowMemory<T>,
    right: RowMemory<T>,
}

impl<T: Scalar> RowEstimator<T> {
    /// An estimator of a robot that stands about in the middle and points about
    /// along the rows.
    ///
    /// # Errors
    /// [`RowEstimatorError`] names the setting that is unusable.
    pub fn new(settings: RowEstimatorSettings<T>) -> Result<Self, RowEstimatorError> {
        settings.check()?;
        let (state, covariance) = start(&settings, AT_START);
        Ok(Self {
            settings,
            mixture: Mixture::of(state, covariance),
            mean: state,
            speed: T::zero(),
            turn: T::zero(),
            left: RowMemory::new(),
            right: RowMemory::new(),
        })
    }

    /// Forgets everything.
    pub fn restart(&mut self) {
        let (state, covariance) = start(&self.settings, AT_START);
        self.mixture = Mixture::of(state, covariance);
        self.mean = state;
        self.speed = T::zero();
        self.turn = T::zero();
        self.left = RowMemory::new();
        self.right = RowMemory::new();
    }

    /// One step, `dt` seconds after the last one: the robot was commanded
    /// `wheels` since then, and measures `distances` now.
    pub fn step(
        &mut self,
        distances: &RowDistances<T>,
        wheels: &WheelSpeeds<T>,
        dt: T,
    ) -> RowEstimate<T> {
        let way = self.predict(wheels, dt);
        let left = self.measure(Side::Left, distances.left, way);
        let right = self.measure(Side::Right, distances.right, way);
        if let Some(distance) = left {
            self.judge(Side::Left, distance);
        }
        if let Some(distance) = right {
            self.judge(Side::Right, distance);
        }
        self.limit();
        self.settle();
        self.estimate()
    }

    /// The present estimate.
    #[must_use]
    pub fn estimate(&self) -> RowEstimate<T> {
        let pose = pose(&self.mean);
        let reach = self.settings.beams.reach(pose.half_width);
        let variance = self
            .mixture
            .variance(&[T::one(), reach, T::zero(), T::zero()]);
        let readings = &self.settings.readings;
        let health = |row: &RowMemory<T>| {
            row.watch
                .health(readings.fault_way, row.blind_way < readings.fresh_way)
        };
        RowEstimate {
            pose,
            curvature: self.mean[CURVATURE],
            deviation: if variance > T::zero() {
                variance.root()
            } else {
                T::zero()
            },
            left: health(&self.left),
            right: health(&self.right),
            blind_way: smallest(self.left.blind_way, self.right.blind_way),
            open_way: smallest(self.left.open.way(), self.right.open.way()),
        }
    }

    /// Time update. Returns the way driven, m.
    fn predict(&mut self, wheels: &WheelSpeeds<T>, dt: T) -> T {
        let motion = self.settings.motion;
        let dt = within(dt, T::zero(), T::lit(LONGEST_STEP));
        let sound = |speed: T| within(speed, -motion.wheel_speed, motion.wheel_speed);
        let (left, right) = (sound(wheels.left), sound(wheels.right));
        let follow = dt / (motion.lag + dt + T::lit(1e-9));
        self.speed += ((left + right) * T::lit(0.5) - self.speed) * follow;
        self.turn += ((left - right) / motion.track - self.turn) * follow;
        let ahead = self.speed * dt;
        let turned = self.turn * dt;
        for hypothesis in &mut self.mixture.hypotheses {
            advance(hypothesis, &self.settings, ahead, turned);
        }
        self.mean = self.mixture.mean();
        ahead.abs()
    }

    /// Takes a reading of the row at `side`. Returns the distance of the run that
    /// it ends, as it would be measured now.
    fn measure(&mut self, side: Side, reading: T, way: T) -> Option<T> {
        let readings = &self.settings.readings;
        let prediction = self.settings.beams.predict(side, &pose(&self.mean));
        let row = match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        };
        let possible = reading.is_finite() && reading >= readings.least;
        let plant = possible && reading < readings.open;
        row.watch.add(reading, possible, plant, way);
        row.blind_way += way;
        let usable = plant && !row.watch.is_faulty(readings.fault_way);
        row.open.add(usable, way);

        let excess = match prediction {
            Some(prediction) if usable => Some(reading - prediction.distance),
            _ => None,
        };
        let run = row.extend(excess, way, readings)?;
        Some(run + prediction?.distance)
    }

    /// Corrects the estimate by a run at this distance.
    fn judge(&mut self, side: Side, distance: T) {
        let settings = &self.settings;
        let row = match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        };
        let odds = row.odds();
        let (state, covariance) = start(settings, ANYWHERE);
        let fresh = Hypothesis {
            weight: settings.readings.doubt,
            state,
            covariance,
        };
        let probability = self.mixture.meet(
            settings.beams.reach(settings.rows.half_width),
            &fresh,
            |state| {
                let seen = settings.beams.predict(side, &pose(state))?;
                let scatter = settings.rows.scatter * seen.by_half_width;
                let excess = distance - seen.distance;
                Some(Seen {
                    row: [
                        seen.by_offset,
                        seen.by_heading,
                        seen.by_half_width,
                        T::zero(),
                    ],
                    excess,
                    variance: scatter * scatter,
                    stalk: odds.stalk,
                    clutter: if excess < T::zero() {
                        odds.near
                    } else {
                        odds.far
                    },
                })
            },
        );
        if probability > T::lit(0.5) {
            row.blind_way = T::zero();
        }
    }

    /// Computes the mean anew. What the readings of unfinished runs exceed their
    /// predictions by follows it.
    fn settle(&mut self) {
        let mean = self.mixture.mean();
        let beams = self.settings.beams;
        for (side, row) in [(Side::Left, &mut self.left), (Side::Right, &mut self.right)] {
            let before = beams.predict(side, &pose(&self.mean));
            let after = beams.predict(side, &pose(&mean));
            if let (Some(before), Some(after)) = (before, after) {
                row.shift(after.distance - before.distance);
            }
        }
        self.mean = mean;
    }

    /// Keeps all hypotheses within what can be.
    fn limit(&mut self) {
        let bounds = bounds(&self.settings);
        let centre = [
            T::zero(),
            T::zero(),
            self.settings.rows.half_width,
            T::zero(),
        ];
        let mut finite = true;
        for hypothesis in &mut self.mixture.hypotheses {
            for ((state, centre), bound) in hypothesis.state.iter_mut().zip(centre).zip(bounds) {
                finite &= state.is_finite();
                *state = centre + clamp_symmetric(*state - centre, bound);
            }
            finite &= hypothesis.weight.is_finite();
            finite &= bound_covariance(hypothesis, &bounds);
        }
        if !finite {
            let (state, covariance) = start(&self.settings, AT_START);
            self.mixture = Mixture::of(state, covariance);
        }
    }
}

/// State and covariance of a robot that has not seen anything, with these
/// deviations of its offset and heading.
fn start<T: Scalar>(
    settings: &RowEstimatorSettings<T>,
    (offset, heading): (f64, f64),
) -> (Vector<T>, Matrix<T>) {
    let Rows {
        half_width,
        tolerance,
        ..
    } = settings.rows;
    let deviations = [
        half_width * T::lit(offset),
        T::lit(heading),
        tolerance,
        settings.motion.curvature,
    ];
    let [offset, heading, width, curvature] = deviations.map(|deviation| deviation * deviation);
    let mut covariance = [[T::zero(); STATES]; STATES];
    covariance[OFFSET][OFFSET] = offset;
    covariance[HEADING][HEADING] = heading;
    covariance[HALF_WIDTH][HALF_WIDTH] = width;
    covariance[CURVATURE][CURVATURE] = curvature;
    ([T::zero(), T::zero(), half_width, T::zero()], covariance)
}

/// Largest deviation of each state from the middle.
fn bounds<T: Scalar>(settings: &RowEstimatorSettings<T>) -> Vector<T> {
    let three = T::lit(3.0);
    [
        settings.rows.half_width * T::lit(LARGEST_OFFSET),
        T::lit(LARGEST_HEADING),
        settings.rows.tolerance * three,
        settings.motion.curvature * three,
    ]
}

/// Keeps a covariance symmetric and its variances between bounds, so that single
/// precision suffices. False if it is not finite.
fn bound_covariance<T: Scalar>(hypothesis: &mut Hypothesis<T>, bounds: &Vector<T>) -> bool {
    let covariance = &mut hypothesis.covariance;
    let mut finite = true;
    let mut scales = [T::one(); STATES];
    for ((scale, variance), bound) in scales.iter_mut().zip(diagonal(covariance)).zip(bounds) {
        finite &= variance.is_finite();
        let most = *bound * *bound;
        if variance > most {
            // Scaling row and column alike keeps the matrix positive.
            *scale = (most / variance).root();
        }
    }
    let mirrored = transposed(covariance);
    for ((line, mirrored), row) in covariance.iter_mut().zip(mirrored).zip(scales) {
        for ((entry, mirrored), column) in line.iter_mut().zip(mirrored).zip(scales) {
            *entry = (*entry + mirrored) * T::lit(0.5) * row * column;
            finite &= entry.is_finite();
        }
    }
    let floor = |variance: &mut T, bound: T| {
        let least = bound * bound * T::lit(1e-7);
        if !(*variance > least) {
            *variance = least;
        }
    };
    let [offset, heading, half_width, curvature] = *bounds;
    floor(&mut covariance[OFFSET][OFFSET], offset);
    floor(&mut covariance[HEADING][HEADING], heading);
    floor(&mut covariance[HALF_WIDTH][HALF_WIDTH], half_width);
    floor(&mut covariance[CURVATURE][CURVATURE], curvature);
    finite
}

/// Moves a hypothesis by `ahead` (m) and the commanded turn `turned` (rad).
fn advance<T: Scalar>(
    hypothesis: &mut Hypothesis<T>,
    settings: &RowEstimatorSettings<T>,
    ahead: T,
    turned: T,
) {
    let RowEstimatorSettings { rows, motion, .. } = settings;
    let way = ahead.abs();
    let [offset, heading, half_width, curvature] = hypothesis.state;
    let (sine, cosine) = heading.sine_cosine();
    // Width and curvature return to what is known of them, along their ways.
    let keep = |length: T| T::one() - smallest(way / length, T::one());
    let (keep_width, keep_curvature) = (keep(rows.width_way), keep(motion.curvature_way));
    hypothesis.state = [
        offset + ahead * sine,
        heading + turned + ahead * curvature,
        rows.half_width + (half_width - rows.half_width) * keep_width,
        curvature * keep_curvature,
    ];
    // F P F' as operations on rows and columns.
    let drift = ahead * cosine;
    let covariance = &mut hypothesis.covariance;
    let [offsets, headings, half_widths, curvatures] = covariance;
    let columns = offsets.iter_mut().zip(headings);
    let columns = columns.zip(half_widths).zip(curvatures);
    for (((offset, heading), half_width), curvature) in columns {
        *offset += drift * *heading;
        *heading += ahead * *curvature;
        *half_width *= keep_width;
        *curvature *= keep_curvature;
    }
    for line in covariance.iter_mut() {
        line[OFFSET] += drift * line[HEADING];
        line[HEADING] += ahead * line[CURVATURE];
        line[HALF_WIDTH] *= keep_width;
        line[CURVATURE] *= keep_curvature;
    }
    let square = |value: T| value * value;
    let renewed = |keep: T| T::one() - keep * keep;
    covariance[OFFSET][OFFSET] += square(motion.offset_walk) * way;
    covariance[HEADING][HEADING] +=
        square(motion.heading_walk) * way + square(motion.turn_error) * turned.abs();
    covariance[HALF_WIDTH][HALF_WIDTH] += square(rows.tolerance) * renewed(keep_width);
    covariance[CURVATURE][CURVATURE] += square(motion.curvature) * renewed(keep_curvature);
}

fn pose<T: Scalar>(state: &Vector<T>) -> RowPose<T> {
    RowPose {
        offset: state[OFFSET],
        heading: state[HEADING],
        half_width: state[HALF_WIDTH],
    }
}

/// The smaller value; `b` if `a` is NaN.
fn smallest<T: Scalar>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// `value` clamped to [`least`, `most`], a range that holds zero; NaN gives zero.
fn within<T: Scalar>(value: T, least: T, most: T) -> T {
    if value > most {
        most
    } else if value < least {
        least
    } else if value.is_finite() {
        value
    } else {
        T::zero()
    }
}

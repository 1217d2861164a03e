//! The place of a robot between two rows, estimated from two distance sensors
//! and the commanded wheel speeds.
//!
//! The states are the offset from the middle, the heading, half the width
//! between the rows, and a curvature. The curvature stands for all that turns
//! the robot against its rows steadily: motors that differ, and rows that bend.
//!
//! A reading is a mixture. It comes from a stalk, from a leaf in front of the
//! stalks, or from something behind the row, and most readings meet no plant at
//! all. Six measures separate them:
//!
//! * Readings of one surface agree with each other. Only runs of readings that
//!   agree are used, and each surface once, when the beam has left it.
//! * Stalks are narrow, and there is space beside them. What is wider, or touches
//!   something else near by, is less believed to be one.
//! * Whether a run comes from a stalk is not decided at once. Several hypotheses
//!   are kept ([`super::mixture`]), and what comes next decides: stalks lie on
//!   one line, leaves do not.
//! * Leaves hang in front of stalks. The larger the share of the way along which
//!   a side is hidden, the less is a run of this side believed to be a stalk,
//!   and the more to be a leaf if it is nearer than predicted.
//! * The width between the rows is known within a tolerance. So one side alone
//!   carries the estimate while leaves or a gap hide the other.
//! * The next rows show between the stalks and in gaps, as far away again. They
//!   carry the estimate too, and tell how the rows bend.
//!
//! Rows may also be walls, as barriers are. Then the width is measured: long surfaces at both
//! sides that are farther apart than expected, or nearer, are the row from there on.
//!
//! Without stalks the estimate goes on by the wheel speeds, and its deviation
//! grows with the way.

use super::beams::{RowPose, Side, View};
use super::health::SideHealth;
use super::mixture::{Bounds, Finding, Hypothesis, Mixture};
use super::motion::{Covariance, Drift, State};
use super::runs::{RowMemory, Run, Step, is_near};
use super::settings::{RowEstimatorError, RowEstimatorSettings};
use crate::scalar::{Scalar, clamp_symmetric};

/// Largest heading of the estimate, rad. The beams are of no use beyond.
const LARGEST_HEADING: f64 = 0.6;
/// Largest offset of the estimate as a share of half the width.
const LARGEST_OFFSET: f64 = 0.9;
/// Standard deviations of the offset, as a share of half the width, and of the
/// heading (rad), of a robot at its start, and of one that may be anywhere.
const AT_START: (f64, f64) = (0.15, 0.1);
const ANYWHERE: (f64, f64) = (0.2, 0.2);
/// Sharpest bend of the rows, 1/m.
const LARGEST_BEND: f64 = 1.0 / 16.0;
/// Largest distance of a stalk of the next row from where it is expected that counts for
/// the bend, m.
const LARGEST_SURPRISE: f64 = 0.1;
/// Longest time step, s. A longer one counts as this one.
const LONGEST_STEP: f64 = 0.1;
/// Largest difference from the width of the settings that walls may have to be the row, as a share
/// of that width.
const OTHER: f64 = 0.5;
/// Standard deviations of the rows' width within which a width is usual.
const USUAL: f64 = 3.0;
/// Largest difference of the ways along walls at both sides, m, that began together: the robot may
/// come to them with another heading than theirs.
const TOGETHER: f64 = 0.3;
/// Way (m) and commanded turn (rad) after which the hypotheses are moved though
/// no run has come.
const LONGEST_DRIFT: (f64, f64) = (0.1, 0.1);

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
    /// Turn rate that the wheels make of the commands so far, rad/s.
    pub turn: T,
    /// Health of the left row's readings.
    pub left: SideHealth,
    /// Health of the right row's readings.
    pub right: SideHealth,
    /// Way since the last stalk of either side, m.
    pub blind_way: T,
    /// Way since the last plant of any kind at either side, m.
    pub open_way: T,
}

/// How far a correction has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// There is none.
    Waiting,
    /// The hypotheses have met a run.
    Split,
    /// Their number is as before again.
    Reduced,
}

/// What walls at both sides say about the width of the rows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum OtherWidth<T> {
    /// Nothing else than the estimate.
    None,
    /// Half of it is this, m.
    Of(T),
    /// It is smaller or larger than rows can be.
    NotOfRows,
}

/// The estimator.
///
/// [`RowEstimator::observe`] is short. What a run of readings corrects is left to
/// [`RowEstimator::correct`], which can follow when the robot has got its command.
#[derive(Clone, Copy, Debug)]
pub struct RowEstimator<T> {
    settings: RowEstimatorSettings<T>,
    bounds: Bounds<T>,
    /// Errors of `state` as of the last correction.
    mixture: Mixture<T>,
    /// What has happened to them since then.
    drift: Drift<T>,
    /// How far the present correction has come.
    stage: Stage,
    /// Mean of the mixture.
    state: State<T>,
    /// Sine and cosine of its heading.
    direction: (T, T),
    /// Speed along the robot (m/s) and turn rate (rad/s) after the lag.
    speed: T,
    turn: T,
    left: RowMemory<T>,
    right: RowMemory<T>,
    /// The side whose run is looked at first.
    next: Side,
    /// Curvature of the rows, to the right, 1/m.
    bend: T,
    /// What half the width is expected to be, m: that of the settings until walls show another
    /// one.
    half_width: T,
}

impl<T: Scalar> RowEstimator<T> {
    /// An estimator of a robot that stands about in the middle and points about
    /// along the rows.
    ///
    /// # Errors
    /// [`RowEstimatorError`] names the setting that is unusable.
    pub fn new(settings: RowEstimatorSettings<T>) -> Result<Self, RowEstimatorError> {
        settings.check()?;
        Ok(Self::of(settings))
    }

    /// The same, with settings that were checked before.
    #[must_use]
    pub fn of(settings: RowEstimatorSettings<T>) -> Self {
        let mut estimator = Self {
            settings,
            bounds: bounds(&settings),
            mixture: Mixture::of(Covariance::zero()),
            drift: Drift::none(),
            stage: Stage::Waiting,
            state: State::zero(),
            direction: (T::zero(), T::one()),
            speed: T::zero(),
            turn: T::zero(),
            left: RowMemory::new(),
            right: RowMemory::new(),
            next: Side::Left,
            bend: T::zero(),
            half_width: settings.rows.half_width,
        };
        estimator.restart();
        estimator
    }

    /// Forgets everything.
    pub fn restart(&mut self) {
        self.forget();
        self.speed = T::zero();
        self.turn = T::zero();
        self.left = RowMemory::new();
        self.right = RowMemory::new();
        self.bend = T::zero();
    }

    /// Begins anew with the state of a robot that has seen nothing.
    fn forget(&mut self) {
        self.mixture = Mixture::of(covariance(&self.settings, AT_START));
        self.drift = Drift::none();
        self.stage = Stage::Waiting;
        self.half_width = self.settings.rows.half_width;
        self.state = self.middle();
        self.direction = (T::zero(), T::one());
    }

    /// One step, `dt` seconds after the last one: the robot was commanded
    /// `wheels` since then, and measures `distances` now. The same as
    /// [`RowEstimator::observe`] and then [`RowEstimator::correct`].
    pub fn step(
        &mut self,
        distances: &RowDistances<T>,
        wheels: &WheelSpeeds<T>,
        dt: T,
    ) -> RowEstimate<T> {
        let estimate = self.observe(distances, wheels, dt);
        self.correct();
        estimate
    }

    /// Moves the estimate and takes the readings. A run of readings that ends here
    /// waits for [`RowEstimator::correct`].
    pub fn observe(
        &mut self,
        distances: &RowDistances<T>,
        wheels: &WheelSpeeds<T>,
        dt: T,
    ) -> RowEstimate<T> {
        let motion = self.predict(wheels, dt);
        self.measure(Side::Left, distances.left, motion);
        self.measure(Side::Right, distances.right, motion);
        self.estimate()
    }

    /// The present estimate.
    #[must_use]
    pub fn estimate(&self) -> RowEstimate<T> {
        let pose = self.pose();
        let variance = self
            .drift
            .variance_ahead(self.mixture.covariance(), self.reach());
        let readings = &self.settings.readings;
        let health = |row: &RowMemory<T>| {
            row.watch
                .health(readings.fault_way, row.blind_way < readings.fresh_way)
        };
        RowEstimate {
            pose,
            curvature: self.state.curvature,
            turn: self.turn,
            deviation: if variance > T::zero() {
                variance * variance.reciprocal_root()
            } else {
                T::zero()
            },
            left: health(&self.left),
            right: health(&self.right),
            blind_way: smallest(self.left.blind_way, self.right.blind_way),
            open_way: smallest(self.left.open.way(), self.right.open.way()),
        }
    }

    /// State of a robot that knows nothing but the width.
    fn middle(&self) -> State<T> {
        State {
            half_width: self.half_width,
            ..State::zero()
        }
    }

    fn pose(&self) -> RowPose<T> {
        RowPose {
            offset: self.state.offset,
            heading: self.state.heading,
            half_width: self.state.half_width,
        }
    }

    fn row(&mut self, side: Side) -> &mut RowMemory<T> {
        match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        }
    }

    fn view(&self, side: Side) -> View<T> {
        self.settings
            .beams
            .view(side, &self.pose(), self.bend, self.direction)
    }

    /// Distance to the row as the estimate has it, m.
    fn expected(&self, side: Side) -> Option<T> {
        let zero = T::zero();
        let seen = self.view(side).predict(zero, zero, zero)?;
        Some(seen.distance)
    }

    /// Time update. Returns the way driven (m) and the turn (rad).
    fn predict(&mut self, wheels: &WheelSpeeds<T>, dt: T) -> (T, T) {
        let motion = self.settings.motion;
        let dt = within(dt, T::zero(), T::lit(LONGEST_STEP));
        let sound = |speed: T| within(speed, -motion.wheel_speed, motion.wheel_speed);
        let (left, right) = (sound(wheels.left), sound(wheels.right));
        let follow = dt / (motion.lag + dt + T::lit(1e-9));
        self.speed += ((left + right) * T::lit(0.5) - self.speed) * follow;
        self.turn += ((left - right) / motion.track - self.turn) * follow;
        let ahead = self.speed * dt;
        let turned = self.turn * dt;
        let (sine, cosine) = self.direction;
        let drift = Drift::step(&self.settings, ahead, turned, cosine);
        let centre = self.middle();
        let carried = drift.carry(&State {
            offset: self.state.offset,
            // The lever is that of small changes of the heading.
            heading: T::zero(),
            half_width: self.state.half_width - centre.half_width,
            curvature: self.state.curvature,
        });
        self.state = State {
            offset: carried.offset + ahead * sine,
            heading: self.state.heading + turned + carried.heading,
            half_width: carried.half_width + centre.half_width,
            curvature: carried.curvature,
        };
        self.drift.extend(&drift);
        self.limit();
        (ahead, turned + self.state.curvature * ahead)
    }

    /// Takes a reading of the row at `side`, after the `way` (m).
    fn measure(&mut self, side: Side, reading: T, (ahead, turned): (T, T)) {
        let way = ahead.abs();
        let swept = self.settings.beams.swept(side, reading, ahead, turned);
        let expected = self.expected(side);
        let readings = self.settings.readings;
        let between = self.is_between_walls();
        let rows_walls = between && self.has_usual_width();
        let row = self.row(side);
        let possible = reading.is_finite() && reading >= readings.least;
        let plant = possible && reading < readings.open;
        row.watch.add(reading, possible, plant, rows_walls, way);
        row.blind_way += way;
        let usable = plant && !row.watch.is_faulty(readings.fault_way);
        let excess = match expected {
            Some(expected) if usable => Some(reading - expected),
            _ => None,
        };
        row.open.add(excess.is_some_and(is_near), way);
        row.extend(excess, &Step { way, swept }, between, &readings);
    }

    /// Whether both sides have had a surface for a while, and these are as far apart as
    /// the rows. Leaves seldom are.
    fn is_between_walls(&self) -> bool {
        let (Some(left), Some(right)) = (self.left.long_surface(), self.right.long_surface())
        else {
            return false;
        };
        (left + right).abs() <= self.same_width()
    }

    /// Whether the rows are as wide as the settings say, within the tolerance. Another width was
    /// found by long surfaces at both sides, so it does not prove that these are no readings of
    /// frozen sensors.
    fn has_usual_width(&self) -> bool {
        let rows = &self.settings.rows;
        (self.half_width - rows.half_width).abs() <= rows.tolerance * T::lit(USUAL)
    }

    /// Largest difference of the sum of both distances, m, between walls of the width that
    /// is expected.
    fn same_width(&self) -> T {
        let RowEstimatorSettings {
            beams,
            rows,
            readings,
            ..
        } = &self.settings;
        readings.agreement + T::lit(4.0) * rows.tolerance / beams.sine
    }

    /// Corrects the estimate by runs of readings that have ended. A run takes three
    /// calls, so that each of them is short: the first splits the hypotheses, the
    /// second reduces their number, and the third corrects the estimate.
    pub fn correct(&mut self) {
        match self.stage {
            Stage::Waiting => self.begin(),
            Stage::Split => {
                self.mixture.reduce(self.reach());
                self.stage = Stage::Reduced;
            }
            Stage::Reduced => {
                self.stage = Stage::Waiting;
                match self.mixture.settle(&self.bounds) {
                    // The estimate has gone on since the hypotheses were moved.
                    Some(mean) => self.shift(&self.drift.carry(&mean)),
                    None => self.forget(),
                }
            }
        }
    }

    /// What the walls at both sides say about the width. They are believed if they began together
    /// and are not seen through the rows: an opening in one of two walls is no wider row, nor is the
    /// reading of a frozen sensor. An offset of the robot makes one side farther and the other one
    /// nearer, and so leaves the sum as it is.
    fn other_width(&self) -> OtherWidth<T> {
        let (Some(left), Some(right)) = (self.left.sure_wall(), self.right.sure_wall()) else {
            return OtherWidth::None;
        };
        let more = left.excess + right.excess;
        let mean = more * T::lit(0.5);
        let together = (left.way - right.way).abs() <= T::lit(TOGETHER);
        if more.abs() <= self.same_width() || !is_near(mean) || !together {
            return OtherWidth::None;
        }
        let RowEstimatorSettings { beams, rows, .. } = &self.settings;
        let found = self.state.half_width + mean * beams.sine;
        if (found - rows.half_width).abs() <= rows.half_width * T::lit(OTHER) {
            OtherWidth::Of(found)
        } else {
            OtherWidth::NotOfRows
        }
    }

    /// Goes on between walls of another width, where the robot may be anywhere.
    fn change_width(&mut self, half_width: T) {
        self.half_width = half_width;
        self.mixture = Mixture::of(covariance(&self.settings, ANYWHERE));
        self.drift = Drift::none();
        self.shift(&State {
            half_width: half_width - self.state.half_width,
            ..State::zero()
        });
    }

    /// Takes the next run, if there is one, and splits the hypotheses by it.
    fn begin(&mut self) {
        let side = self.next;
        let other = match side {
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        };
        let (side, run) = match self.other_width() {
            OtherWidth::Of(half_width) => {
                self.change_width(half_width);
                return;
            }
            OtherWidth::NotOfRows => (side, None),
            OtherWidth::None => match self.row(side).take_ended() {
                Some(run) => (side, Some(run)),
                None => (other, self.row(other).take_ended()),
            },
        };
        let (way, turn) = LONGEST_DRIFT;
        let is_due = self.drift.way() >= T::lit(way) || self.drift.turned() >= T::lit(turn);
        if run.is_none() && !is_due {
            return;
        }
        self.mixture.advance(&self.drift);
        self.drift = Drift::none();
        self.stage = Stage::Reduced;
        if let Some(run) = run {
            self.next = match side {
                Side::Left => Side::Right,
                Side::Right => Side::Left,
            };
            self.stage = Stage::Split;
            if !self.judge(side, &run) {
                self.forget();
            }
        }
    }

    /// Distance ahead at which the beams meet the rows, m.
    fn reach(&self) -> T {
        self.settings.beams.reach(self.settings.rows.half_width)
    }

    /// Splits the hypotheses by a run that exceeds the expected distance by `excess`
    /// (m). False if none of them can explain it.
    fn judge(&mut self, side: Side, run: &Run<T>) -> bool {
        let view = self.view(side);
        let zero = T::zero();
        let Some(seen) = view.predict(zero, zero, zero) else {
            return true;
        };
        let settings = &self.settings;
        let fresh = Hypothesis {
            weight: settings.readings.doubt,
            state: self.middle().minus(&self.state),
            covariance: covariance(settings, ANYWHERE),
        };
        let row = match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        };
        let finding = Finding {
            view,
            distance: seen.distance + run.excess,
            scatter: settings.rows.scatter,
            far_scatter: settings.rows.far_scatter,
            spacing: settings.rows.spacing,
            odds: row.odds(run.doubt, &settings.readings),
        };
        let Some(probability) = self.mixture.meet(&finding, fresh) else {
            return false;
        };
        if probability > T::lit(0.5) {
            row.blind_way = T::zero();
            self.follow_bend(&finding);
        }
        true
    }

    /// Learns from a stalk of the next row how the rows bend: where the near row is
    /// known, a straight next row would be elsewhere.
    fn follow_bend(&mut self, finding: &Finding<T>) {
        let zero = T::zero();
        let (Some(near), Some(far)) = (
            finding.view.predict(zero, zero, zero),
            finding.view.predict(zero, zero, finding.spacing),
        ) else {
            return;
        };
        // Nearer to the near row than to the next one.
        if finding.distance < (near.distance + far.distance) * T::lit(0.5) {
            return;
        }
        let beyond = clamp_symmetric(
            (finding.distance - far.distance) / far.by_offset,
            T::lit(LARGEST_SURPRISE),
        );
        self.bend = clamp_symmetric(
            self.bend - self.settings.rows.bend_gain * beyond,
            T::lit(LARGEST_BEND),
        );
    }

    /// Moves the estimate. What the readings of unfinished runs exceed their
    /// predictions by follows it.
    fn shift(&mut self, by: &State<T>) {
        let before = (self.expected(Side::Left), self.expected(Side::Right));
        self.state = self.state.plus(by);
        self.limit();
        let after = (self.expected(Side::Left), self.expected(Side::Right));
        if let (Some(before), Some(after)) = (before.0, after.0) {
            self.left.shift(after - before);
        }
        if let (Some(before), Some(after)) = (before.1, after.1) {
            self.right.shift(after - before);
        }
    }

    /// Keeps the estimate within what can be.
    fn limit(&mut self) {
        let settings = &self.settings;
        let (half_width, three) = (settings.rows.half_width, T::lit(3.0));
        let State {
            offset,
            heading,
            half_width: width,
            curvature,
        } = self.state;
        self.state = State {
            offset: clamp_symmetric(offset, half_width * T::lit(LARGEST_OFFSET)),
            heading: clamp_symmetric(heading, T::lit(LARGEST_HEADING)),
            half_width: self.half_width
                + clamp_symmetric(width - self.half_width, settings.rows.tolerance * three),
            curvature: clamp_symmetric(curvature, settings.motion.curvature * three),
        };
        self.direction = self.state.heading.sine_cosine();
    }
}

/// Covariance of such a robot, with these deviations of its offset and heading.
fn covariance<T: Scalar>(
    settings: &RowEstimatorSettings<T>,
    (offset, heading): (f64, f64),
) -> Covariance<T> {
    let square = |deviation: T| deviation * deviation;
    Covariance::diagonal(&State {
        offset: square(settings.rows.half_width * T::lit(offset)),
        heading: square(T::lit(heading)),
        half_width: square(settings.rows.tolerance),
        curvature: square(settings.motion.curvature),
    })
}

/// Bounds of the variances: those of the largest deviations, and small shares of
/// these, so that single precision suffices.
fn bounds<T: Scalar>(settings: &RowEstimatorSettings<T>) -> Bounds<T> {
    let square = |deviation: T| deviation * deviation;
    let three = T::lit(3.0);
    let most = State {
        offset: square(settings.rows.half_width * T::lit(LARGEST_OFFSET)),
        heading: square(T::lit(LARGEST_HEADING)),
        half_width: square(settings.rows.tolerance * three),
        curvature: square(settings.motion.curvature * three),
    };
    Bounds {
        most,
        least: most.times(T::lit(1e-7)),
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

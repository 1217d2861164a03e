//! What the description of a vehicle has wrong: the wheelbase that acts, and the age of GPS data.
//!
//! Both show only while the vehicle turns. With a wheelbase that is too long the vehicle turns more than expected; with
//! an age that is too small its course seems to lag behind by the turn of that time. An error of either settles in the
//! other states: a heading that is wrong in turns, and a steering bias that is none.
//!
//! They are estimated beside the filter and not as two more states of it, which would cost twice its time. This is the
//! two-stage filter of B. Friedland, "Treatment of bias in recursive filtering", IEEE Transactions on Automatic Control,
//! 1969: for each of the two, the filter's error as a multiple of that one's error is followed through predictions and
//! corrections. A course is then a measurement of both. The errors of the steering bias are taken for those of the
//! steering angle turned round, since the potentiometer holds their sum.

use crate::covariance::{
    EAST, HEADING, HEADING_BIAS, NORTH, STATES, STEERING, STEERING_BIAS, Transition,
};
use crate::scalar::{Scalar, clamp_symmetric};

/// How far the wheelbase and the age of GPS data may be from their described values: standard deviations, not negative.
/// Zero takes the described value as exact; if both are zero, nothing is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected<T> {
    /// Of the curvature, as a share of that which the steering angle makes with the described wheelbase.
    pub curvature: T,
    /// Of the age of GPS data, s.
    pub age: T,
}

/// Least and largest curvature, as a share: a wheelbase from 3/4 to 4/3 of the described one.
const CURVATURE: (f64, f64) = (0.75, 1.33);
/// Largest age, s.
const AGE: f64 = 0.25;
/// Deviations that are not acted upon: a share of the curvature, and a time, s. In straight driving a description that
/// is right is better than what the last turn has shown. Twice as much is acted upon in full.
const IGNORED: (f64, f64) = (0.06, 0.01);
/// How much less a course is trusted here than by the filter: in the first turn other errors, such as that of a steering
/// bias, look like one of these.
const DOUBT: f64 = 2.0;
/// By how much the variance of the curvature grows in a step, and that of the age (s^2): in an hour by a fifth of a
/// percent and a hundredth of a second.
const DRIFT: (f64, f64) = (1e-7, 1e-8);

/// What is acted upon of a deviation: nothing up to `ignored`, and all from twice that on.
fn acted_upon<T: Scalar>(found: T, ignored: f64) -> T {
    let ignored = T::lit(ignored);
    let beyond = found - clamp_symmetric(found, ignored);
    beyond + clamp_symmetric(beyond, ignored)
}

/// What the measurements of an update tell about both.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown<T> {
    /// For northing and easting: the covariances of the states with what was measured, one over the variance of its
    /// innovation, and its derivatives with respect to heading and steering angle.
    pub(crate) north: Option<([T; STATES], T, [T; 2])>,
    pub(crate) east: Option<([T; STATES], T, [T; 2])>,
    pub(crate) course: Option<Course<T>>,
}

impl<T> Shown<T> {
    pub(crate) const fn nothing() -> Self {
        Self {
            north: None,
            east: None,
            course: None,
        }
    }
}

/// A course that corrected the estimate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Course<T> {
    /// Covariances of the states with it, and one over the variance of its innovation.
    pub(crate) cross: [T; STATES],
    pub(crate) inverse: T,
    /// Measured minus expected course, rad.
    pub(crate) innovation: T,
    /// Its derivative with respect to the steering angle.
    pub(crate) steering: T,
    /// Angle by which it leads the rear axle's, rad.
    pub(crate) lead: T,
    /// How fast it turned, rad/s.
    pub(crate) turning: T,
}

/// Errors of northing, easting, heading, steering angle and heading bias, as multiples of the error of one of the two.
#[derive(Clone, Copy, Debug)]
struct Follows<T> {
    north: T,
    east: T,
    heading: T,
    steering: T,
    bias: T,
}

impl<T: Scalar> Follows<T> {
    fn none() -> Self {
        let zero = T::zero();
        Self {
            north: zero,
            east: zero,
            heading: zero,
            steering: zero,
            bias: zero,
        }
    }

    /// A prediction, in which an error of one adds `turn` (rad) to the turn.
    #[inline(always)]
    fn advance(&mut self, by: &Transition<T>, turn: T) {
        let turned = by.turn * self.steering + turn;
        let middle = self.heading + turned * T::lit(0.5);
        self.north += by.north * middle;
        self.east += by.east * middle;
        self.heading += turned;
    }

    /// A correction whose measurement depends by `seen` on an error of one.
    #[inline(always)]
    fn correct(&mut self, cross: &[T; STATES], inverse: T, seen: T) {
        let share = inverse * seen;
        self.north -= cross[NORTH] * share;
        self.east -= cross[EAST] * share;
        self.heading -= cross[HEADING] * share;
        self.steering -= cross[STEERING] * share;
        self.bias -= cross[HEADING_BIAS] * share;
    }

    /// The correction by a coordinate of the position, of which `own` is the error.
    #[inline(always)]
    fn see(&mut self, own: T, (cross, inverse, [heading, steering]): &([T; STATES], T, [T; 2])) {
        let seen = own + *heading * self.heading + *steering * self.steering;
        self.correct(cross, *inverse, seen);
    }

    /// Adds these errors to the states for a `change` of one.
    #[inline(always)]
    fn add(&self, state: &mut [T; STATES], change: T) {
        state[NORTH] += self.north * change;
        state[EAST] += self.east * change;
        state[HEADING] += self.heading * change;
        state[STEERING] += self.steering * change;
        state[STEERING_BIAS] -= self.steering * change;
        state[HEADING_BIAS] += self.bias * change;
    }
}

/// The estimate of both.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Habits<T> {
    expected: Expected<T>,
    /// Deviation of the curvature, as a share, as found and as acted upon; and that of the age, s.
    curvature: [T; 2],
    older: [T; 2],
    /// Variances of curvature and age, and their covariance.
    variances: [T; 2],
    covariance: T,
    /// What follows from an error of the curvature's share, and from one of the age (s).
    bent: Follows<T>,
    aged: Follows<T>,
    /// What their errors add to the variance of the place after the last prediction, north plus east, m^2.
    place: T,
}

impl<T: Scalar> Habits<T> {
    pub(crate) fn new(expected: Expected<T>) -> Self {
        Self {
            expected,
            curvature: [T::zero(); 2],
            older: [T::zero(); 2],
            variances: [
                expected.curvature * expected.curvature,
                expected.age * expected.age,
            ],
            covariance: T::zero(),
            bent: Follows::none(),
            aged: Follows::none(),
            place: T::zero(),
        }
    }

    /// Whether one of them is estimated.
    pub(crate) fn are_estimated(&self) -> bool {
        self.expected.curvature > T::zero() || self.expected.age > T::zero()
    }

    /// The filter has begun anew: its errors have other causes.
    pub(crate) fn restart(&mut self) {
        self.bent = Follows::none();
        self.aged = Follows::none();
        self.place = T::zero();
    }

    /// A prediction with a turn, rad.
    pub(crate) fn advance(&mut self, by: &Transition<T>, turn: T) {
        if self.are_estimated() {
            self.bent.advance(by, turn / (T::one() + self.curvature[1]));
            self.aged.advance(by, T::zero());
            let (bent, aged) = (&self.bent, &self.aged);
            self.place = self.added(bent.north, aged.north) + self.added(bent.east, aged.east);
        }
    }

    /// What errors of both add to the variance of a state that follows them by `bent` and `aged`.
    #[inline(always)]
    fn added(&self, bent: T, aged: T) -> T {
        let [of_bend, of_age] = self.variances;
        bent * bent * of_bend + aged * aged * of_age + T::lit(2.0) * bent * aged * self.covariance
    }

    /// What their errors added to the variance of the place before the last update lowered it, north plus east, m^2.
    pub(crate) fn place_variance(&self) -> T {
        self.place
    }

    /// What their errors add to the variances of the states.
    pub(crate) fn variances(&self) -> [T; STATES] {
        let added = |bent: T, aged: T| self.added(bent, aged);
        let (bent, aged) = (&self.bent, &self.aged);
        let steering = added(bent.steering, aged.steering);
        let mut variances = [T::zero(); STATES];
        variances[NORTH] = added(bent.north, aged.north);
        variances[EAST] = added(bent.east, aged.east);
        variances[HEADING] = added(bent.heading, aged.heading);
        variances[STEERING] = steering;
        variances[HEADING_BIAS] = added(bent.bias, aged.bias);
        variances[STEERING_BIAS] = steering;
        variances
    }

    /// A variance that is at most that of the beginning.
    fn held(&mut self, variance: T, most: T) -> T {
        if variance > most {
            self.covariance *= most / variance;
            most
        } else {
            variance
        }
    }

    /// The curvature to act upon as a share of the described one, and the age, s, where `told` is the one that was told.
    pub(crate) fn found(&self, told: T) -> (T, T) {
        (T::one() + self.curvature[1], told + self.older[1])
    }

    /// Takes what an update showed, and adds what follows to the states. The age that was told is `told` (s).
    #[inline(never)]
    pub(crate) fn learn(&mut self, shown: &Shown<T>, state: &mut [T; STATES], told: T) {
        if let Some(north) = &shown.north {
            self.bent.see(self.bent.north, north);
            self.aged.see(self.aged.north, north);
        }
        if let Some(east) = &shown.east {
            self.bent.see(self.bent.east, east);
            self.aged.see(self.aged.east, east);
        }
        let Some(course) = &shown.course else {
            return;
        };
        let seen = |follows: &Follows<T>| {
            follows.heading + follows.bias + course.steering * follows.steering
        };
        let bent = seen(&self.bent) + course.lead;
        let aged = seen(&self.aged) - course.turning;
        self.bent.correct(&course.cross, course.inverse, bent);
        self.aged.correct(&course.cross, course.inverse, aged);

        let [of_bend, of_age] = self.variances;
        let cross_bend = of_bend * bent + self.covariance * aged;
        let cross_age = self.covariance * bent + of_age * aged;
        let spread = T::lit(DOUBT) / course.inverse + bent * cross_bend + aged * cross_age;
        let per = T::one() / spread;
        // The filter acts upon less than was found: so much of the innovation is known.
        let [curvature, bend] = self.curvature;
        let [older, age] = self.older;
        let known = bent * (curvature - bend) + aged * (older - age);
        let change = per * (course.innovation - known);
        let within = |value: T, least: T, most: T| {
            if !(value > least) {
                least
            } else if value > most {
                most
            } else {
                value
            }
        };
        let (least, most) = CURVATURE;
        let curvature = within(
            curvature + cross_bend * change,
            T::lit(least - 1.0),
            T::lit(most - 1.0),
        );
        let older = within(older + cross_age * change, -told, T::lit(AGE) - told);
        let (ignored, ignored_time) = IGNORED;
        self.curvature = [curvature, acted_upon(curvature, ignored)];
        self.older = [older, acted_upon(older, ignored_time)];
        self.bent.add(state, self.curvature[1] - bend);
        self.aged.add(state, self.older[1] - age);
        self.covariance -= cross_bend * cross_age * per;
        let square = |value: T| value * value;
        let (bend_drift, age_drift) = DRIFT;
        let of_bend = self.held(
            of_bend - square(cross_bend) * per + T::lit(bend_drift),
            square(self.expected.curvature),
        );
        let of_age = self.held(
            of_age - square(cross_age) * per + T::lit(age_drift),
            square(self.expected.age),
        );
        self.variances = [of_bend, of_age];
    }
}

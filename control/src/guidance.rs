//! The steering law: from where the vehicle stands to the steering angle it
//! should have.
//!
//! Near the path it is the linear quadratic regulator, exactly. Read as a
//! cascade, u = -K x says: the cross-track error wants a heading, the heading
//! wants a steering angle, the steering angle wants a rate. Far from the path
//! each of these wishes is limited to what the vehicle can do and can stop
//! doing in time:
//!
//! * the heading to the one from which an arc at nearly full lock, begun when
//!   the steering needs to begin, ends on the path (and never more than square
//!   to it);
//! * the steering angle to its limit, and to what can be taken back before
//!   the heading is reached;
//! * the rate to its limit.
//!
//! That is the structure of a proximate time-optimal servo (Workman, Kosut and
//! Franklin, "Adaptive proximate time-optimal servomechanisms", American
//! Control Conference 1987): from anywhere the vehicle turns at full lock until
//! it is square to the path, drives straight, and swings onto it, which is the
//! shortest path of Dubins but for the time the steering needs. No error is
//! large enough to ask for more than the actuator has, so nothing winds up
//! behind a saturated actuator.
//!
//! Two regulators are blended: a firm one that brings the vehicle onto the
//! path and a gentle one that keeps it there, so that noise moves the
//! steering little.

use crate::feedback::{LimitError, Limits};
use crate::scalar::{Scalar, clamp_symmetric, wrap_angle};

/// What the law needs to know beside the gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuidanceSettings<T> {
    /// Wheelbase, m, positive.
    pub wheelbase: T,
    /// Actuator limits.
    pub limits: Limits<T>,
    /// Share of the steering angle limit that a swing onto the path uses, in
    /// (0, 1]; the rest corrects.
    pub swing: T,
    /// Time by which a swing is begun early, s: what the steering needs to
    /// reach half its angle.
    pub lead: T,
    /// Share of the lead by which the regulator looks ahead when it asks for
    /// half as much again as the steering rate limit, in [0, 1].
    pub foresight: T,
    /// Rate assumed for taking back the steering angle near the path and
    /// during a swing, as shares of the rate limit, positive.
    pub brake: Brake<T>,
    /// Cross-track error up to which only the gentle regulator works, m; the
    /// firm one has taken over at twice that.
    pub near: T,
    /// The same for the heading error, rad.
    pub aligned: T,
    /// Largest correction that the integral of the cross-track error may make,
    /// as a cross-track error, m.
    pub integral_limit: T,
    /// Cross-track error beyond which nothing is integrated, m.
    pub integral_zone: T,
}

/// Shares of the steering rate limit that the law plans with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brake<T> {
    /// Under the regulators.
    pub regulating: T,
    /// During an approach, when the vehicle's motion is looked at `lead`
    /// seconds ahead.
    pub approaching: T,
}

/// Which setting of the law is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuidanceError {
    /// The wheelbase is not a positive number.
    Wheelbase,
    /// A limit.
    Limit(LimitError),
    /// The swing's share is not in (0, 1], the foresight not in [0, 1], or a
    /// brake's share not positive.
    Share,
    /// The lead is negative or not a number.
    Lead,
    /// A zone or the integral's limit is not a positive number.
    Zone,
}

impl core::fmt::Display for GuidanceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Wheelbase => f.write_str("the wheelbase is not a positive number"),
            Self::Limit(error) => error.fmt(f),
            Self::Share => {
                f.write_str("a share of a steering limit or of the lead is out of range")
            }
            Self::Lead => f.write_str("the steering's lead is negative or not a number"),
            Self::Zone => f.write_str("a zone of the steering law is not a positive number"),
        }
    }
}

impl core::error::Error for GuidanceError {}

impl<T: Scalar> GuidanceSettings<T> {
    /// Checks that every setting is usable.
    ///
    /// # Errors
    /// [`GuidanceError`] names the setting that is not.
    pub fn check(&self) -> Result<(), GuidanceError> {
        let positive = |value: T| value.is_finite() && value > T::zero();
        if !positive(self.wheelbase) {
            return Err(GuidanceError::Wheelbase);
        }
        self.limits.check().map_err(GuidanceError::Limit)?;
        let shares = positive(self.swing)
            && self.swing <= T::one()
            && self.foresight >= T::zero()
            && self.foresight <= T::one()
            && positive(self.brake.regulating)
            && positive(self.brake.approaching);
        if !shares {
            return Err(GuidanceError::Share);
        }
        if !(self.lead.is_finite() && self.lead >= T::zero()) {
            return Err(GuidanceError::Lead);
        }
        let zones = positive(self.near)
            && positive(self.aligned)
            && positive(self.integral_limit)
            && positive(self.integral_zone);
        if zones {
            Ok(())
        } else {
            Err(GuidanceError::Zone)
        }
    }
}

/// Gains at one speed: on the integral of the cross-track error (1/(m s^2)),
/// the cross-track error at the rear axle (1/(m s)), the heading error (1/s)
/// and the steering angle (1/s), for u = -K x. The last three are positive.
pub type Gains<T> = [T; 4];

/// Where the vehicle stands relative to its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation<T> {
    /// Distance of the rear axle to the right of the path, m.
    pub cross_track: T,
    /// Heading less the direction of the path, rad.
    pub heading: T,
    /// Steering angle, rad.
    pub steering_angle: T,
    /// Speed, m/s, not negative.
    pub speed: T,
    /// Curvature of the path where the vehicle is, 1/m, positive right.
    pub curvature: T,
    /// Curvature to steer for, 1/m: that of the path a little ahead, smoothed
    /// over the way the steering needs to get there.
    pub curvature_ahead: T,
    /// Real steering rate as a share of the commanded one, positive.
    pub effectiveness: T,
}

/// A steering angle to go to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish<T> {
    /// Steering angle, rad, within the limit.
    pub angle: T,
    /// Rate for each radian still to go, 1/s.
    pub follow: T,
}

/// A swing onto the path at one distance from it.
struct Swing<T> {
    /// Heading towards the path, rad, positive.
    heading: T,
    /// Growth of that heading with the distance, 1/m.
    bend: T,
}

/// The law and its memory: the integral and the side to which it turns.
#[derive(Clone, Copy, Debug)]
pub struct Guidance<T> {
    settings: GuidanceSettings<T>,
    integral: T,
    turning: T,
    saturated: bool,
}

/// `value` brought into [0, 1].
fn clamp_share<T: Scalar>(value: T) -> T {
    if value < T::zero() {
        T::zero()
    } else if value < T::one() {
        value
    } else {
        T::one()
    }
}

/// Heading deviation beyond which the direction of turn, once chosen, is kept,
/// rad (150 degrees): with the vehicle facing away both ways round are equally
/// long, and noise must not choose anew in every step.
const REVERSAL: f64 = 2.618;

impl<T: Scalar> Guidance<T> {
    /// A law with an empty memory.
    ///
    /// # Errors
    /// [`GuidanceError`] names the setting that is unusable.
    pub fn new(settings: GuidanceSettings<T>) -> Result<Self, GuidanceError> {
        settings.check()?;
        Ok(Self {
            settings,
            integral: T::zero(),
            turning: T::zero(),
            saturated: false,
        })
    }

    /// Forgets the integral and the direction of turn.
    pub fn reset(&mut self) {
        self.integral = T::zero();
        self.turning = T::zero();
        self.saturated = false;
    }

    /// What the integral adds to the cross-track error, m.
    #[must_use]
    pub fn integral(&self) -> T {
        self.integral
    }

    /// Way over which the steering reaches a swing's angle at `speed` (m/s)
    /// and `effectiveness`, m.
    #[must_use]
    pub fn steering_way(&self, speed: T, effectiveness: T) -> T {
        let settings = &self.settings;
        let angle = settings.swing * settings.limits.steering_angle;
        speed.abs() * angle / (settings.limits.steering_rate * effectiveness)
    }

    /// The steering angle wished for and the gain with which the rate follows
    /// it, under the `firm` and the `gentle` regulator. `dt` is the time since
    /// the last call, s.
    pub fn wish(
        &mut self,
        at: &Deviation<T>,
        firm: &Gains<T>,
        gentle: &Gains<T>,
        dt: T,
    ) -> Wish<T> {
        let settings = self.settings;
        let share = self.firm_share(at);
        let mut gains = *gentle;
        for (gain, &firm) in gains.iter_mut().zip(firm) {
            *gain += (firm - *gain) * share;
        }
        let [k_integral, k_cross, k_heading, k_steering] = gains;
        self.integrate(at.cross_track, k_integral, k_cross, dt);
        let cross = at.cross_track + self.integral;
        let feed = self.angle_for(at.curvature_ahead);

        // Where the vehicle will be when the steering has had its time.
        let lead = settings.lead / at.effectiveness;
        let way = at.speed * lead;
        let turn = (at.steering_angle.tangent() / settings.wheelbase - at.curvature) * way;
        let heading_soon = at.heading + turn;
        let cross_soon = cross + way * (at.heading + turn * T::lit(0.5)).sine_cosine().0;
        let swing = self.swing(cross_soon.abs(), at);

        let slope = k_cross / k_heading;
        let larger = if cross.abs() > cross_soon.abs() {
            cross.abs()
        } else {
            cross_soon.abs()
        };
        let approaching = slope * larger > swing.heading;
        let (hold, error, brake) = if approaching {
            let wanted = if cross_soon > T::zero() {
                -swing.heading
            } else {
                swing.heading
            };
            // The swing itself asks for a steering angle.
            let curvature = at.curvature_ahead - swing.bend * heading_soon.sine_cosine().0;
            (
                self.angle_for(curvature),
                heading_soon - wanted,
                settings.brake.approaching,
            )
        } else {
            let linear = k_steering * at.steering_angle + k_heading * at.heading + k_cross * cross;
            let early = self.anticipation(at, linear) * share;
            let heading = at.heading + turn * early;
            let cross = cross + (cross_soon - cross) * early;
            (feed, heading + slope * cross, settings.brake.regulating)
        };
        let error = self.turn_towards(error);
        let wanted = error * k_heading / k_steering;
        let allowed = self.brake(error, at, brake);
        let angle = hold - clamp_symmetric(wanted, allowed);
        let largest = settings.limits.steering_angle;
        let limited = clamp_symmetric(angle, largest);
        let rate = k_steering * (limited - at.steering_angle);
        self.saturated = approaching
            || limited != angle
            || wanted.abs() > allowed
            || rate.abs() > settings.limits.steering_rate;
        Wish {
            angle: limited,
            follow: k_steering,
        }
    }

    /// How much of the firm regulator is at work: none near the path, all away
    /// from it, a share between.
    fn firm_share(&self, at: &Deviation<T>) -> T {
        let off = at.cross_track.abs() / self.settings.near;
        let askew = at.heading.abs() / self.settings.aligned;
        clamp_share(if off > askew { off } else { askew } - T::one())
    }

    /// Share of the lead by which the regulator looks ahead.
    ///
    /// None while the actuator keeps up, for then the gains are the optimal
    /// ones. When `linear`, the rate that they ask for (rad/s), is more than
    /// the actuator has, the angle comes late, and without looking ahead the
    /// vehicle would swing from side to side at full lock for ever. The same
    /// goes for a steering that is slow for the speed: one that needs a good
    /// part of the turning radius to reach its angle.
    fn anticipation(&self, at: &Deviation<T>, linear: T) -> T {
        let beyond = linear.abs() / self.settings.limits.steering_rate - T::one();
        let saturated = self.settings.foresight * clamp_share(beyond * T::lit(2.0));
        let way = self.steering_way(at.speed, at.effectiveness);
        let slowness = way * self.swing_curvature();
        let slow = T::lit(0.7) * clamp_share((slowness - T::lit(0.33)) / T::lit(0.2));
        if saturated > slow { saturated } else { slow }
    }

    /// Curvature of a swing's arc, 1/m.
    fn swing_curvature(&self) -> T {
        let settings = &self.settings;
        (settings.swing * settings.limits.steering_angle).tangent() / settings.wheelbase
    }

    /// Adds to the integral while the vehicle is near the path and nothing
    /// saturates (anti-windup by conditional integration). It is kept as the
    /// cross-track error that it stands for, so that a change of gains does
    /// not move the steering.
    fn integrate(&mut self, cross: T, k_integral: T, k_cross: T, dt: T) {
        if self.saturated || !(cross.abs() < self.settings.integral_zone) {
            return;
        }
        let sum = self.integral + cross * dt * k_integral / k_cross;
        self.integral = clamp_symmetric(sum, self.settings.integral_limit);
    }

    /// Steering angle that holds a curvature (1/m), rad.
    fn angle_for(&self, curvature: T) -> T {
        (curvature * self.settings.wheelbase).angle_of(T::one())
    }

    /// Steering angle that can be taken back at a `share` of the rate limit
    /// before a heading error of `error` (rad) is used up: over the time d / r
    /// it takes, the vehicle turns by V d^2 / (2 r L).
    fn brake(&self, error: T, at: &Deviation<T>, share: T) -> T {
        let settings = &self.settings;
        let rate = settings.limits.steering_rate * at.effectiveness * share;
        // At a crawl the heading hardly changes: no limit worth the name.
        let speed = at.speed + T::lit(0.05);
        (T::lit(2.0) * rate * settings.wheelbase * error.abs() / speed).root()
    }

    /// `error` as a turn to make, in the direction already begun when it is
    /// nearly half a circle.
    fn turn_towards(&mut self, error: T) -> T {
        let error = wrap_angle(error);
        let sign = if error < T::zero() {
            -T::one()
        } else {
            T::one()
        };
        if error.abs() < T::lit(REVERSAL) {
            self.turning = T::zero();
            error
        } else if self.turning == T::zero() || self.turning == sign {
            self.turning = sign;
            error
        } else {
            error - sign * T::two_pi()
        }
    }

    /// The heading towards the path from which an arc still ends on it, at
    /// `distance` (m) from it.
    fn swing(&self, distance: T, at: &Deviation<T>) -> Swing<T> {
        let square = Swing {
            heading: T::frac_pi_2(),
            bend: T::zero(),
        };
        let curvature = self.swing_curvature();
        // Straightening out takes a way, over which the arc becomes a spiral
        // that lands beside the arc's own end by this much (the shift of a
        // clothoid, way^2 / (24 R)).
        let way = self.steering_way(at.speed, at.effectiveness);
        let shift = way * way * curvature / T::lit(24.0);
        if distance < T::lit(4.0) * shift {
            // Inside the spiral the regulator is the gentler one.
            return square;
        }
        let versine = (distance - shift) * curvature;
        if !(versine < T::one()) {
            return square;
        }
        let cosine = T::one() - versine;
        let sine = (versine * (T::one() + cosine)).root();
        if !(sine > T::zero()) {
            return square;
        }
        Swing {
            heading: sine.angle_of(cosine),
            bend: curvature / sine,
        }
    }
}

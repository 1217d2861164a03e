//! The steering law: computes the target steering angle from the vehicle's
//! deviation from its path.
//!
//! Near the path the law is exactly the linear quadratic regulator u = -K x,
//! written as a cascade: the cross-track error sets a target heading, the
//! heading error sets a target steering angle, and the steering angle error
//! sets a steering rate. Far from the path each target is limited:
//!
//! * the heading, to the one from which an arc at nearly full steering angle
//!   still ends on the path, started early enough for the steering to travel.
//!   It is never more than square to the path. The text calls this arc the
//!   swing;
//! * the steering angle, to its limit, and to the angle that can be taken back
//!   before the target heading is reached;
//! * the rate, to its limit.
//!
//! This is the structure of a proximate time-optimal servo (Workman, Kosut and
//! Franklin, "Adaptive proximate time-optimal servomechanisms", American
//! Control Conference 1987). From anywhere the vehicle turns at full steering
//! angle until it is square to the path, drives straight, and swings onto the
//! path. Apart from the travel time of the steering, that is the shortest path
//! of Dubins. No target exceeds what the actuator can do, so no integrator
//! winds up.
//!
//! Two regulators are blended. The firm one brings the vehicle onto the path.
//! The gentle one keeps it there with little steering movement from noise.

use crate::angle::{Direction, is_near};
use crate::feedback::{LimitError, Limits};
use crate::scalar::{Scalar, clamp_symmetric, wrap_angle};

/// Settings of the law other than the gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuidanceSettings<T> {
    /// Wheelbase, m, positive.
    pub wheelbase: T,
    /// Actuator limits.
    pub limits: Limits<T>,
    /// Share of the steering angle limit that a swing onto the path uses, in
    /// (0, 1]. The rest is left for corrections.
    pub swing: T,
    /// Time by which a swing starts early, s: about the time in which the
    /// steering reaches half of the swing's angle.
    pub lead: T,
    /// Look-ahead of the regulator, as a share of `lead`, reached when it demands
    /// 1.5 times the rate limit. In [0, 1].
    pub foresight: T,
    /// Steering rates at which the law plans to take back a steering angle, as
    /// shares of the rate limit, positive.
    pub brake: Brake<T>,
    /// Cross-track error up to which only the gentle regulator acts, m. Beyond
    /// it the firm one is blended in; from twice this error it acts alone.
    pub near: T,
    /// The same limit for the heading error, rad.
    pub aligned: T,
    /// Largest correction by the integral of the cross-track error, expressed as
    /// a cross-track error, m.
    pub integral_limit: T,
    /// Cross-track error from which on the integral is held, m.
    pub integral_zone: T,
}

/// Shares of the steering rate limit at which the law plans to take back a
/// steering angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brake<T> {
    /// While a regulator steers, near the path.
    pub regulating: T,
    /// During an approach, where the law predicts the motion over `lead`
    /// seconds.
    pub approaching: T,
}

/// The setting of the law that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuidanceError {
    /// The wheelbase is not a positive number.
    Wheelbase,
    /// A limit of the actuators.
    Limit(LimitError),
    /// The swing's share is not in (0, 1], the foresight not in [0, 1], or a
    /// brake's share not positive.
    Share,
    /// The lead is negative or not a finite number.
    Lead,
    /// The limit of the gentle regulator or of the integral is not a positive
    /// number.
    Zone,
}

impl core::fmt::Display for GuidanceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Wheelbase => f.write_str("the wheelbase is not a positive number"),
            Self::Limit(error) => error.fmt(f),
            Self::Share => f.write_str("the swing, the foresight or a brake share is out of range"),
            Self::Lead => f.write_str("the lead of the steering law is negative or not a number"),
            Self::Zone => f.write_str(
                "a cross-track or heading limit of the steering law is not a positive number",
            ),
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

/// State of the vehicle relative to its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation<T> {
    /// Distance of the rear axle to the right of the path, m.
    pub cross_track: T,
    /// Heading minus the direction of the path, rad.
    pub heading: T,
    /// Steering angle, rad.
    pub steering_angle: T,
    /// Speed, m/s, not negative.
    pub speed: T,
    /// Curvature of the path beside the vehicle, 1/m, positive to the right.
    pub curvature: T,
    /// Curvature of the path a little ahead, 1/m, averaged over the distance that
    /// the vehicle drives while the steering travels.
    pub curvature_ahead: T,
    /// Real steering rate as a share of the commanded one, positive.
    pub effectiveness: T,
}

/// The target of the steering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target<T> {
    /// Target steering angle, rad, within the limit.
    pub angle: T,
    /// Steering rate per radian of remaining angle, 1/s.
    pub follow: T,
}

/// The swing onto the path, at one distance from it.
struct Swing<T> {
    /// Heading error towards the path, rad, positive.
    heading: T,
    /// Derivative of that heading with respect to the distance, 1/m.
    bend: T,
}

/// What follows from the settings, computed once.
#[derive(Clone, Copy, Debug)]
struct Derived<T> {
    /// Curvature of a swing's arc, 1/m.
    swing: T,
    /// Time in which the steering travels to a swing's angle at its calibrated rate, s.
    travel: T,
    /// One over the wheelbase, 1/m.
    per_wheelbase: T,
    /// One over the steering rate limit, s/rad.
    per_rate: T,
    /// One over `near`, 1/m.
    per_near: T,
    /// One over `aligned`, 1/rad.
    per_aligned: T,
}

impl<T: Scalar> Derived<T> {
    fn of(settings: &GuidanceSettings<T>) -> Self {
        let angle = settings.swing * settings.limits.steering_angle;
        Self {
            swing: angle.tangent() / settings.wheelbase,
            travel: angle / settings.limits.steering_rate,
            per_wheelbase: T::one() / settings.wheelbase,
            per_rate: T::one() / settings.limits.steering_rate,
            per_near: T::one() / settings.near,
            per_aligned: T::one() / settings.aligned,
        }
    }
}

/// The law and its state: the integral and the direction of a turn.
#[derive(Clone, Copy, Debug)]
pub struct Guidance<T> {
    settings: GuidanceSettings<T>,
    derived: Derived<T>,
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

/// Gains of which the firm regulator has this share.
pub(crate) fn blended<T: Scalar>(firm: &Gains<T>, gentle: &Gains<T>, share: T) -> Gains<T> {
    core::array::from_fn(|gain| gentle[gain] + (firm[gain] - gentle[gain]) * share)
}

/// Sine of an angle (rad), from a direction that is close to it as a rule.
fn sine_near<T: Scalar>(direction: &Direction<T>, angle: T) -> T {
    if is_near(direction.angle, angle) {
        direction.near(angle).sine
    } else {
        angle.sine_cosine().0
    }
}

/// Heading error from which on the direction of a turn is kept once chosen, rad
/// (150 degrees). If the vehicle faces away from the path, both directions are
/// equally long, and noise must not change the choice in every step.
const REVERSAL: f64 = 2.618;

impl<T: Scalar> Guidance<T> {
    /// A law with no integral and no direction of turn.
    ///
    /// # Errors
    /// [`GuidanceError`] names the setting that is unusable.
    pub fn new(settings: GuidanceSettings<T>) -> Result<Self, GuidanceError> {
        settings.check()?;
        Ok(Self {
            settings,
            derived: Derived::of(&settings),
            integral: T::zero(),
            turning: T::zero(),
            saturated: false,
        })
    }

    /// Clears the integral and the direction of turn.
    pub fn reset(&mut self) {
        self.integral = T::zero();
        self.turning = T::zero();
        self.saturated = false;
    }

    /// Correction by the integral, added to the cross-track error, m.
    #[must_use]
    pub fn integral(&self) -> T {
        self.integral
    }

    /// Distance that the vehicle drives at `speed` (m/s) while the steering
    /// travels to a swing's angle, m. `effectiveness` is the real steering rate
    /// as a share of the commanded one.
    #[must_use]
    pub fn steering_way(&self, speed: T, effectiveness: T) -> T {
        speed.abs() * self.derived.travel / effectiveness
    }

    /// The target steering angle and the gain with which the rate follows it,
    /// from the gains of the `firm` and the `gentle` regulator. `dt` is the time
    /// since the last call, s.
    pub fn target(
        &mut self,
        at: &Deviation<T>,
        firm: &Gains<T>,
        gentle: &Gains<T>,
        dt: T,
    ) -> Target<T> {
        let share = self.firm_share(at);
        self.steer(at, share, &blended(firm, gentle, share), dt)
    }

    /// The same with the gains of both regulators blended by [`Self::firm_share`].
    pub(crate) fn steer(
        &mut self,
        at: &Deviation<T>,
        share: T,
        gains: &Gains<T>,
        dt: T,
    ) -> Target<T> {
        let &[k_integral, k_cross, k_heading, k_steering] = gains;
        self.integrate(at.cross_track, k_integral, k_cross, dt);
        let cross = at.cross_track + self.integral;

        // Predicted deviation after the lead.
        let slowness = T::one() / at.effectiveness;
        let way = at.speed * self.settings.lead * slowness;
        let turn = (at.steering_angle.tangent() * self.derived.per_wheelbase - at.curvature) * way;
        let heading_soon = at.heading + turn;
        let middle = Direction::of(at.heading + turn * T::lit(0.5));
        let cross_soon = cross + way * middle.sine;
        let steering_way = at.speed * self.derived.travel * slowness;
        let swing = self.swing(cross_soon.abs(), steering_way);

        let slope = k_cross / k_heading;
        let larger = if cross.abs() > cross_soon.abs() {
            cross.abs()
        } else {
            cross_soon.abs()
        };
        let approaching = slope * larger > swing.heading;
        let (curvature, error, brake) = if approaching {
            let wanted = if cross_soon > T::zero() {
                -swing.heading
            } else {
                swing.heading
            };
            (
                // With the swing's own curvature.
                at.curvature_ahead - swing.bend * sine_near(&middle, heading_soon),
                heading_soon - wanted,
                self.settings.brake.approaching,
            )
        } else {
            let linear = k_steering * at.steering_angle + k_heading * at.heading + k_cross * cross;
            let early = self.anticipation(linear, steering_way) * share;
            let heading = at.heading + turn * early;
            let cross = cross + (cross_soon - cross) * early;
            (
                at.curvature_ahead,
                heading + slope * cross,
                self.settings.brake.regulating,
            )
        };
        let hold = self.angle_for(curvature);
        let error = self.turn_towards(error);
        let wanted = error * k_heading / k_steering;
        let square = self.brake(error, at, brake);
        // Written so that a square of NaN takes the root.
        let within = wanted * wanted <= square;
        let change = if within {
            wanted
        } else {
            clamp_symmetric(wanted, square.root())
        };
        let angle = hold - change;
        let limits = &self.settings.limits;
        let limited = clamp_symmetric(angle, limits.steering_angle);
        let rate = k_steering * (limited - at.steering_angle);
        self.saturated =
            approaching || limited != angle || !within || rate.abs() > limits.steering_rate;
        Target {
            angle: limited,
            follow: k_steering,
        }
    }

    /// Share of the firm regulator: 0 near the path, 1 away from it, a value in
    /// between in the transition.
    pub(crate) fn firm_share(&self, at: &Deviation<T>) -> T {
        let off = at.cross_track.abs() * self.derived.per_near;
        let askew = at.heading.abs() * self.derived.per_aligned;
        clamp_share(if off > askew { off } else { askew } - T::one())
    }

    /// Look-ahead of the regulator, as a share of the lead.
    ///
    /// It is zero while the actuator can follow: then the gains are optimal. If
    /// `linear`, the rate that the gains demand (rad/s), exceeds the rate limit,
    /// the steering angle comes late. Without look-ahead the vehicle would then
    /// oscillate at full steering angle without end. The same holds for a
    /// steering that is slow for the speed: one that travels to its angle over a
    /// considerable part of the turning radius.
    fn anticipation(&self, linear: T, steering_way: T) -> T {
        let beyond = linear.abs() * self.derived.per_rate - T::one();
        let saturated = self.settings.foresight * clamp_share(beyond * T::lit(2.0));
        let slowness = steering_way * self.derived.swing;
        let slow = T::lit(0.7) * clamp_share((slowness - T::lit(0.33)) * T::lit(5.0));
        if saturated > slow { saturated } else { slow }
    }

    /// Integrates the cross-track error while the vehicle is near the path and
    /// nothing saturates (anti-windup by conditional integration). The integral
    /// is stored as an equivalent cross-track error, so that a change of gains
    /// does not move the steering.
    fn integrate(&mut self, cross: T, k_integral: T, k_cross: T, dt: T) {
        if self.saturated || !(cross.abs() < self.settings.integral_zone) {
            return;
        }
        let sum = self.integral + cross * dt * k_integral / k_cross;
        self.integral = clamp_symmetric(sum, self.settings.integral_limit);
    }

    /// Steering angle for a curvature (1/m), rad.
    pub(crate) fn angle_for(&self, curvature: T) -> T {
        if curvature == T::zero() {
            return T::zero();
        }
        (curvature * self.settings.wheelbase).angle_of(T::one())
    }

    /// Square of the largest steering angle that can be taken back at a `share` of the rate
    /// limit before the heading has turned by `error` (rad). Taking back an angle
    /// d at the rate r takes d / r, and meanwhile the vehicle turns by
    /// V d^2 / (2 r L).
    fn brake(&self, error: T, at: &Deviation<T>, share: T) -> T {
        let settings = &self.settings;
        let rate = settings.limits.steering_rate * at.effectiveness * share;
        // Near standstill the heading hardly changes. The offset avoids a
        // division by zero.
        let speed = at.speed + T::lit(0.05);
        T::lit(2.0) * rate * settings.wheelbase * error.abs() / speed
    }

    /// The turn that removes the heading error `error` (rad). If it is nearly half
    /// a circle, the direction already begun is kept.
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

    /// The swing at `distance` (m) from the path: the heading towards the path
    /// from which an arc still ends on it.
    /// `way` (m) is the distance that the vehicle drives while the steering travels.
    fn swing(&self, distance: T, way: T) -> Swing<T> {
        let square = Swing {
            heading: T::frac_pi_2(),
            bend: T::zero(),
        };
        let curvature = self.derived.swing;
        // While the steering straightens, the arc becomes a clothoid. It ends
        // beside the arc's own end by the shift of a clothoid, way^2 / (24 R).
        let shift = way * way * curvature * T::lit(1.0 / 24.0);
        if distance < T::lit(4.0) * shift {
            // Within the clothoid the regulator steers: a limit of square to
            // the path does not act.
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

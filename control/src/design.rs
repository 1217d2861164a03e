//! Designs steering gains for a range of speeds. This runs on the host, in
//! double precision; the target carries the resulting table.

use crate::discretise::{DiscretiseError, zero_order_hold};
use crate::lqr::{RegulatorError, dlqr};
use crate::model::{Continuous, Geometry, GeometryError};
use crate::scalar::Scalar;
use crate::schedule::GainSchedule;
use nalgebra::{SMatrix, SVector};

/// Weights of the steering regulator. Each is the inverse square of a
/// deviation; deviations of that size matter equally (Bryson's rule).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteeringWeights<T> {
    /// On the integral of the cross-track error, 1/(m s)^2; not negative. Zero
    /// gives a law without an integral.
    pub integral: T,
    /// On the cross-track error, 1/m^2; not negative, and positive if `integral`
    /// is zero: else no gain holds the vehicle on its line.
    pub cross_track: T,
    /// On the heading error, 1/rad^2; not negative.
    pub heading: T,
    /// On the steering angle, 1/rad^2; not negative.
    pub steering_angle: T,
    /// On the steering rate, s^2/rad^2; positive.
    pub steering_rate: T,
}

/// Why no gain schedule could be designed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DesignError<T> {
    /// The vehicle's geometry is unusable.
    Geometry(GeometryError),
    /// The speed spacing or the slowest speed is not a positive number.
    Speed,
    /// The model cannot be discretised at this period.
    Discretise(DiscretiseError),
    /// No regulator exists at a speed.
    Regulator {
        /// The speed, m/s.
        speed: T,
        /// Why there is none.
        error: RegulatorError,
    },
}

impl<T: core::fmt::Display> core::fmt::Display for DesignError<T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Geometry(error) => error.fmt(f),
            Self::Speed => {
                f.write_str("the speed spacing or the slowest speed is not a positive number")
            }
            Self::Discretise(error) => error.fmt(f),
            Self::Regulator { speed, error } => write!(f, "at {speed} m/s: {error}"),
        }
    }
}

impl<T: core::fmt::Display + core::fmt::Debug> core::error::Error for DesignError<T> {}

/// The steering model extended by the integral of the cross-track error (thesis
/// Figure 7.12). The states are integral (m s), cross-track error (m), heading
/// error (rad) and steering angle (rad).
#[must_use]
pub fn with_integral<T: Scalar>(model: &Continuous<T, 3, 1>) -> Continuous<T, 4, 1> {
    let mut a = SMatrix::<T, 4, 4>::zeros();
    a[(0, 1)] = T::one();
    a.fixed_view_mut::<3, 3>(1, 1).copy_from(&model.a);
    let mut b = SMatrix::<T, 4, 1>::zeros();
    b.fixed_view_mut::<3, 1>(1, 0).copy_from(&model.b);
    Continuous { a, b }
}

/// Designs steering gains at the P speeds 0, `spacing`, 2 `spacing`, ... (m/s)
/// for a controller with a period of `period` seconds.
///
/// Row k holds [K_integral, K_cross, K_heading, K_steering] of u = -K x at the
/// speed k `spacing`. `geometry.l1` is the distance of the controlled point
/// ahead of the rear axle. At standstill the steering moves nothing and no gain
/// exists, so speeds below `slowest` (m/s, positive) get the gains of
/// `slowest`.
///
/// # Errors
/// [`DesignError`] names the speed and the input at fault.
pub fn steering_gains<T: Scalar, const P: usize>(
    geometry: &Geometry<T>,
    weights: &SteeringWeights<T>,
    period: T,
    spacing: T,
    slowest: T,
) -> Result<GainSchedule<T, 4, P>, DesignError<T>> {
    geometry.check().map_err(DesignError::Geometry)?;
    let positive = |value: T| value.is_finite() && value > T::zero();
    if !(positive(spacing) && positive(slowest)) {
        return Err(DesignError::Speed);
    }
    let mut gains = [[T::zero(); 4]; P];
    let mut speed = T::zero();
    for row in &mut gains {
        let design = if speed > slowest { speed } else { slowest };
        *row = gains_at(&geometry.steering_model(design), design, weights, period)?;
        speed += spacing;
    }
    Ok(GainSchedule { spacing, gains })
}

/// The row of gains for the steering model at `speed` (m/s).
///
/// An integral without weight costs nothing and moves no other state, so the best
/// gain ignores it.
fn gains_at<T: Scalar>(
    model: &Continuous<T, 3, 1>,
    speed: T,
    weights: &SteeringWeights<T>,
    period: T,
) -> Result<[T; 4], DesignError<T>> {
    let rate = weights.steering_rate;
    let rest = [weights.cross_track, weights.heading, weights.steering_angle];
    let [cross_track, heading, steering_angle] = rest;
    if weights.integral == T::zero() {
        let [k_cross, k_heading, k_steering] = regulate(model, speed, rest, rate, period)?;
        return Ok([T::zero(), k_cross, k_heading, k_steering]);
    }
    let all = [weights.integral, cross_track, heading, steering_angle];
    regulate(&with_integral(model), speed, all, rate, period)
}

/// The gain for a diagonal state weight.
fn regulate<T: Scalar, const N: usize>(
    model: &Continuous<T, N, 1>,
    speed: T,
    weights: [T; N],
    rate: T,
    period: T,
) -> Result<[T; N], DesignError<T>> {
    let q = SMatrix::<T, N, N>::from_diagonal(&SVector::from(weights));
    let r = SMatrix::<T, 1, 1>::new(rate);
    let sampled = zero_order_hold(model, period).map_err(DesignError::Discretise)?;
    let regulator =
        dlqr(&sampled, &q, &r).map_err(|error| DesignError::Regulator { speed, error })?;
    Ok(regulator.gain.transpose().into())
}

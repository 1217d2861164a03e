//! Linear models of a vehicle (thesis 7.2).

use crate::scalar::Scalar;
use nalgebra::SMatrix;

/// A continuous linear time-invariant system dx/dt = A x + B u with N states
/// and M inputs (thesis equation 7.1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Continuous<T, const N: usize, const M: usize> {
    /// System matrix, N x N, in units of state per second per unit of state.
    pub a: SMatrix<T, N, N>,
    /// Input matrix, N x M, in units of state per second per unit of input.
    pub b: SMatrix<T, N, M>,
}

/// A discrete linear time-invariant system x' = F x + G u with N states and
/// M inputs (thesis equation 7.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discrete<T, const N: usize, const M: usize> {
    /// State transition over one period, N x N.
    pub f: SMatrix<T, N, N>,
    /// Effect over one period of an input held constant, N x M.
    pub g: SMatrix<T, N, M>,
}

/// Axles and the antenna's place along the vehicle (O'Connor's L1 and L2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry<T> {
    /// Distance from the rear axle forward to the antenna, m; negative if the
    /// antenna is behind it.
    pub l1: T,
    /// Distance from the antenna forward to the front axle, m.
    pub l2: T,
}

/// The antenna's place beside and above the vehicle. [`Geometry::l1`] gives its
/// place along it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Antenna<T> {
    /// Distance to the right of the centre line, m; negative to the left.
    pub right: T,
    /// Height above the ground, m. Roll and pitch move a high antenna beside its
    /// place; the height counts where an inertial sensor measures them
    /// ([`crate::tilt`]).
    pub height: T,
}

/// Why a geometry describes no vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GeometryError {
    /// A length is NaN or infinite.
    NotFinite,
    /// L1 + L2, the wheelbase, is not positive.
    NoWheelbase,
}

impl core::fmt::Display for GeometryError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "a length of the vehicle is not a finite number",
            Self::NoWheelbase => "the wheelbase L1 + L2 is not positive",
        })
    }
}

impl core::error::Error for GeometryError {}

impl<T: Scalar> Geometry<T> {
    /// Distance between the axles, L1 + L2, m.
    #[must_use]
    pub fn wheelbase(&self) -> T {
        self.l1 + self.l2
    }

    /// Checks that the lengths describe a vehicle.
    ///
    /// # Errors
    /// [`GeometryError`] names the condition that fails.
    pub fn check(&self) -> Result<(), GeometryError> {
        if !(self.l1.is_finite() && self.l2.is_finite()) {
            Err(GeometryError::NotFinite)
        } else if self.wheelbase() > T::zero() {
            Ok(())
        } else {
            Err(GeometryError::NoWheelbase)
        }
    }

    /// O'Connor's kinematic steering model at `speed` (m/s) (thesis Figure 7.8).
    /// The states are the cross-track error of the point L1 ahead of the rear
    /// axle (m, positive to the right of the line), the heading error (rad,
    /// clockwise) and the steering angle (rad, positive to the right). The input
    /// is the steering rate (rad/s).
    #[must_use]
    pub fn steering_model(&self, speed: T) -> Continuous<T, 3, 1> {
        let length = self.wheelbase();
        let (o, i) = (T::zero(), T::one());
        Continuous {
            a: SMatrix::<T, 3, 3>::new(
                o,
                speed,
                speed * self.l1 / length,
                o,
                o,
                speed / length,
                o,
                o,
                o,
            ),
            b: SMatrix::<T, 3, 1>::new(o, o, i),
        }
    }

    /// [`Self::steering_model`] discretised with a zero-order hold over `period`
    /// (s), in closed form: A is nilpotent, so its exponential is a polynomial.
    #[must_use]
    pub fn steering_model_sampled(&self, speed: T, period: T) -> Discrete<T, 3, 1> {
        let length = self.wheelbase();
        let (o, i) = (T::zero(), T::one());
        let way = speed * period;
        let half = T::lit(0.5);
        Discrete {
            f: SMatrix::<T, 3, 3>::new(
                i,
                way,
                (self.l1 * way + half * way * way) / length,
                o,
                i,
                way / length,
                o,
                o,
                i,
            ),
            g: SMatrix::<T, 3, 1>::new(
                (half * self.l1 * way + way * way / T::lit(6.0)) * period / length,
                half * way * period / length,
                period,
            ),
        }
    }
}

//! Angles of one step, with their functions.
//!
//! In a step the same angles are needed at several times, which lie close together. Their sines,
//! cosines and tangents follow from those of the first one by the addition theorems, with series
//! for the small differences. That takes a third of the time of computing them anew.

use crate::scalar::Scalar;

/// Differences up to which the series are as exact as single precision, rad.
const NEAR: f64 = 0.2;

/// Whether two angles (rad) are so close.
pub(crate) fn is_near<T: Scalar>(one: T, other: T) -> bool {
    (one - other).abs() < T::lit(NEAR)
}

/// A direction with its sine and cosine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Direction<T> {
    pub(crate) angle: T,
    pub(crate) sine: T,
    pub(crate) cosine: T,
}

impl<T: Scalar> Direction<T> {
    /// The direction of an angle of zero.
    pub(crate) fn north() -> Self {
        Self {
            angle: T::zero(),
            sine: T::zero(),
            cosine: T::one(),
        }
    }

    /// The direction of an angle, rad.
    pub(crate) fn of(angle: T) -> Self {
        let (sine, cosine) = angle.sine_cosine();
        Self {
            angle,
            sine,
            cosine,
        }
    }

    /// The direction of an angle (rad) close to this one. The error is below 2e-8 up to a quarter
    /// of a radian away, and below 2e-6 up to half a radian.
    #[inline(always)]
    pub(crate) fn near(&self, angle: T) -> Self {
        let by = angle - self.angle;
        let square = by * by;
        // Series up to the sixth power.
        let cosine = T::one()
            - square * (T::lit(0.5) - square * (T::lit(1.0 / 24.0) - square * T::lit(1.0 / 720.0)));
        let sine = by - by * square * (T::lit(1.0 / 6.0) - square * T::lit(1.0 / 120.0));
        Self {
            angle,
            sine: self.sine * cosine + self.cosine * sine,
            cosine: self.cosine * cosine - self.sine * sine,
        }
    }
}

/// An angle of the wheels with its tangent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wheels<T> {
    pub(crate) angle: T,
    pub(crate) tangent: T,
}

impl<T: Scalar> Wheels<T> {
    /// Wheels at an angle, rad.
    pub(crate) fn at(angle: T) -> Self {
        Self {
            angle,
            tangent: angle.tangent(),
        }
    }

    /// Wheels at an angle (rad) close to this one. The error of the difference's tangent is below
    /// 2e-7 up to a quarter of a radian, and below 6e-5 up to half a radian.
    #[inline(always)]
    pub(crate) fn near(&self, angle: T) -> Self {
        let by = angle - self.angle;
        let square = by * by;
        // Series up to the seventh power.
        let tangent = by
            + by * square
                * (T::lit(1.0 / 3.0)
                    + square * (T::lit(2.0 / 15.0) + square * T::lit(17.0 / 315.0)));
        Self {
            angle,
            tangent: (self.tangent + tangent) / (T::one() - self.tangent * tangent),
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{Direction, Wheels};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn near_directions_are_those_of_their_angles(from in -3.2..3.2_f64, by in -0.5..0.5_f64) {
            let found = Direction::of(from).near(from + by);
            let (sine, cosine) = (from + by).sin_cos();
            let error = (found.sine - sine).hypot(found.cosine - cosine);
            // The first terms that are left out.
            let limit = by.powi(8) / 40_320.0 + by.abs().powi(7) / 5040.0;
            prop_assert!(error <= limit + 1e-15, "{error} {limit}");
        }

        #[test]
        fn near_tangents_are_those_of_their_angles(from in -0.6..0.6_f64, by in -0.5..0.5_f64) {
            let found = Wheels::at(from).near(from + by);
            let error = (found.tangent - (from + by).tan()).abs();
            let limit = by.abs().powi(9) * 0.03 * (1.0 + (from + by).tan().powi(2)) * 1.3;
            prop_assert!(error <= limit + 1e-15, "{error} {limit}");
        }

        #[test]
        fn single_precision_is_kept(from in -3.2..3.2_f32, by in -0.1..0.1_f32, angle in -0.6..0.6_f32) {
            let exact = f64::from(from + by);
            let found = Direction::of(from).near(from + by);
            prop_assert!((f64::from(found.sine) - exact.sin()).abs() < 6e-7);
            prop_assert!((f64::from(found.cosine) - exact.cos()).abs() < 6e-7);
            let wheels = Wheels::at(angle).near(angle + by);
            prop_assert!((f64::from(wheels.tangent) - f64::from(angle + by).tan()).abs() < 6e-7);
        }
    }
}

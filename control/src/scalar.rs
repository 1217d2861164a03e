//! The number type over which the crate is generic.

use nalgebra::RealField;

/// A real number: `f64` on the host, and `f32` on the target, whose
/// floating-point unit has only single precision.
///
/// The functions below replace nalgebra's. Those use `libm`, which evaluates
/// `sinf`, `cosf` and `tanf` in double precision; the target would emulate that
/// in some thousand cycles a call. The `f32` versions here use only single
/// precision.
pub trait Scalar: RealField + Copy {
    /// The representable value nearest to `value`. The compiler evaluates it for
    /// constants.
    fn lit(value: f64) -> Self;

    /// The representable value nearest to the integer `value`.
    fn integer(value: i32) -> Self;

    /// This value in double precision (exact).
    fn as_f64(self) -> f64;

    /// Sine and cosine of an angle in radians.
    ///
    /// For `f32` the error is within 2 units in the last place of 1 up to an angle
    /// of 1000 rad, and grows with the angle beyond. An angle that is not finite
    /// gives NaN.
    fn sine_cosine(self) -> (Self, Self);

    /// Angle of the finite vector (`x`, `y` = self) in radians, in [-pi, pi];
    /// zero for the zero vector.
    ///
    /// For `f32` the error is below 4e-7 rad, and relative to angles below
    /// pi/8 below 3e-7.
    fn angle_of(self, x: Self) -> Self;

    /// Square root; NaN for negative values.
    ///
    /// For `f32` the error is within one unit in the last place.
    fn root(self) -> Self;

    /// One over the square root of a positive number.
    ///
    /// For `f32` the relative error is below 1e-6 for normal numbers.
    fn reciprocal_root(self) -> Self;

    /// Tangent of an angle in radians.
    ///
    /// For `f32` the relative error is below 4e-7 up to an angle of 1 rad.
    fn tangent(self) -> Self {
        let (sine, cosine) = self.sine_cosine();
        sine / cosine
    }

    /// Angle in [0, pi] whose cosine is `self`. Values beyond [-1, 1] are clamped.
    fn arccosine(self) -> Self {
        let limited = clamp_symmetric(self, Self::one());
        let sine = ((Self::one() - limited) * (Self::one() + limited)).root();
        sine.angle_of(limited)
    }

    /// The nearest whole number, with ties to even, for magnitudes below 2^22.
    fn nearest(self) -> Self;

    /// The largest whole number that is not above `self`; zero for negative values
    /// and NaN.
    fn whole(self) -> usize;
}

impl Scalar for f64 {
    fn lit(value: f64) -> Self {
        value
    }

    fn integer(value: i32) -> Self {
        f64::from(value)
    }

    fn as_f64(self) -> f64 {
        self
    }

    fn sine_cosine(self) -> (Self, Self) {
        libm::sincos(self)
    }

    fn angle_of(self, x: Self) -> Self {
        libm::atan2(self, x)
    }

    fn root(self) -> Self {
        libm::sqrt(self)
    }

    fn reciprocal_root(self) -> Self {
        1.0 / libm::sqrt(self)
    }

    fn nearest(self) -> Self {
        libm::rint(self)
    }

    fn whole(self) -> usize {
        // `as` saturates and takes NaN to zero.
        self as usize
    }
}

impl Scalar for f32 {
    #[inline(always)]
    fn lit(value: f64) -> Self {
        value as f32
    }

    #[inline(always)]
    fn integer(value: i32) -> Self {
        value as f32
    }

    fn as_f64(self) -> f64 {
        f64::from(self)
    }

    fn sine_cosine(self) -> (Self, Self) {
        let (quadrant, r) = quadrant_and_rest(self);
        let z = r * r;
        // Minimax polynomials on [-pi/4, pi/4] (S. L. Moshier, Cephes, sinf.c).
        let sine = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 1.666_665_5e-1) * z * r + r;
        let cosine =
            ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
        match quadrant & 3 {
            0 => (sine, cosine),
            1 => (cosine, -sine),
            2 => (-sine, -cosine),
            _ => (-cosine, sine),
        }
    }

    // Not inlined, nor are those below: a step calls each of them several times, and in flash
    // memory, code that is in the cache already is faster than a copy of its own.
    #[inline(never)]
    fn tangent(self) -> Self {
        // As a rule the angle is one of the wheels. It is the rest itself, then.
        let (quadrant, r) = if self.abs() < core::f32::consts::FRAC_PI_4 {
            (0, self)
        } else {
            quadrant_and_rest(self)
        };
        let z = r * r;
        // Minimax polynomial on [-pi/4, pi/4] (S. L. Moshier, Cephes, tanf.c).
        let tangent =
            (((((9.385_402e-3 * z + 3.119_922_3e-3) * z + 2.443_013_5e-2) * z + 5.341_128e-2) * z
                + 1.333_879_9e-1)
                * z
                + 3.333_315_7e-1)
                * z
                * r
                + r;
        if quadrant & 1 == 0 {
            tangent
        } else {
            -1.0 / tangent
        }
    }

    #[inline(never)]
    fn angle_of(self, x: Self) -> Self {
        use core::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
        // Tangent of pi/8: beyond it the angle is taken from the diagonal.
        const EIGHTH: f32 = 0.414_213_56;
        let (along, across) = (x.abs(), self.abs());
        let steep = across > along;
        let (large, small) = if steep {
            (across, along)
        } else {
            (along, across)
        };
        if large == 0.0 {
            return 0.0;
        }
        let (numerator, denominator, from) = if small > EIGHTH * large {
            (small - large, small + large, FRAC_PI_4)
        } else {
            (small, large, 0.0)
        };
        let t = numerator / denominator;
        let z = t * t;
        // Minimax polynomial on [-tan(pi/8), tan(pi/8)] (S. L. Moshier, Cephes, atanf.c).
        let rest = (((8.053_744_5e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z
            - 3.333_295e-1)
            * z
            * t
            + t;
        let acute = from + rest;
        let first = if steep { FRAC_PI_2 - acute } else { acute };
        let upper = if x < 0.0 { PI - first } else { first };
        upper.copysign(self)
    }

    #[inline(never)]
    fn root(self) -> Self {
        // The steps below need a normal number. Powers of four keep the root exact.
        const UP: f32 = 16_777_216.0;
        let (scaled, back) = if self < f32::MIN_POSITIVE {
            (self * UP, 1.0 / 4096.0)
        } else {
            (self, 1.0)
        };
        if scaled > 0.0 && scaled < f32::INFINITY {
            let inverse = reciprocal_root_step(reciprocal_root_guess(scaled), scaled);
            let inverse = reciprocal_root_step(inverse, scaled);
            let root = scaled * inverse;
            (root + 0.5 * inverse * (scaled - root * root)) * back
        } else if self >= 0.0 {
            // Zero and infinity.
            self
        } else {
            f32::NAN
        }
    }

    fn reciprocal_root(self) -> Self {
        let root = reciprocal_root_step(reciprocal_root_guess(self), self);
        let root = reciprocal_root_step(root, self);
        reciprocal_root_step(root, self)
    }

    #[inline(always)]
    fn nearest(self) -> Self {
        (self + SHIFT) - SHIFT
    }

    #[inline(always)]
    fn whole(self) -> usize {
        // `as` saturates and takes NaN to zero.
        self as usize
    }
}

/// Adding and subtracting 1.5 * 2^23 rounds to a whole number. The low bits of the sum are those of
/// the number.
const SHIFT: f32 = 12_582_912.0;

/// Number of the quadrant about the nearest multiple of pi/2 in the two lowest bits, and the angle
/// (rad) from there, in [-pi/4, pi/4].
#[inline(always)]
fn quadrant_and_rest(angle: f32) -> (u32, f32) {
    // Cody and Waite reduction: pi/2 is split in three parts. The first two
    // are so short that their products with the quadrant number are exact.
    const HIGH: f32 = 1.570_312_5;
    const MIDDLE: f32 = 4.837_513e-4;
    const LOW: f32 = 7.549_79e-8;
    let shifted = angle * core::f32::consts::FRAC_2_PI + SHIFT;
    let quadrant = shifted - SHIFT;
    let rest = ((angle - quadrant * HIGH) - quadrant * MIDDLE) - quadrant * LOW;
    (shifted.to_bits(), rest)
}

/// One over the square root of a positive normal number, within 4 %: halves the exponent (C.
/// Lomont, Fast inverse square root, 2003).
#[inline(always)]
fn reciprocal_root_guess(square: f32) -> f32 {
    f32::from_bits(0x5f37_5a86_u32.wrapping_sub(square.to_bits() >> 1))
}

/// A Newton step for one over the square root, which squares the error of `root`.
#[inline(always)]
fn reciprocal_root_step(root: f32, square: f32) -> f32 {
    root * (1.5 - 0.5 * square * root * root)
}

/// An angle in radians wrapped into (-pi, pi].
///
/// NaN stays NaN. The result is exact except for rounding up to some thousand
/// turns.
#[must_use]
pub fn wrap_angle<T: Scalar>(angle: T) -> T {
    if angle > -T::pi() && angle <= T::pi() {
        return angle;
    }
    let turn = T::two_pi();
    let turns = angle * (T::frac_1_pi() * T::lit(0.5));
    let wrapped = angle - turn * turns.nearest();
    if wrapped <= -T::pi() {
        wrapped + turn
    } else if wrapped > T::pi() {
        wrapped - turn
    } else {
        wrapped
    }
}

/// `value` clamped to [-`limit`, `limit`]; NaN stays NaN.
#[must_use]
pub fn clamp_symmetric<T: Scalar>(value: T, limit: T) -> T {
    if value > limit {
        limit
    } else if value < -limit {
        -limit
    } else {
        value
    }
}

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

    /// Angle of the vector (`x`, `y` = self) in radians, in [-pi, pi];
    /// zero for the zero vector.
    fn angle_of(self, x: Self) -> Self;

    /// Square root; NaN for negative values.
    fn root(self) -> Self;

    /// One over the square root of a positive number.
    ///
    /// For `f32` the relative error is below 1e-6 for normal numbers.
    fn reciprocal_root(self) -> Self;

    /// Tangent of an angle in radians.
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
        // Cody and Waite reduction: pi/2 is split in three parts. The first two
        // are so short that their products with the quadrant number are exact.
        const HIGH: f32 = 1.570_312_5;
        const MIDDLE: f32 = 4.837_513e-4;
        const LOW: f32 = 7.549_79e-8;
        let quadrant = (self * core::f32::consts::FRAC_2_PI).nearest();
        let r = ((self - quadrant * HIGH) - quadrant * MIDDLE) - quadrant * LOW;
        let z = r * r;
        // Minimax polynomials on [-pi/4, pi/4] (S. L. Moshier, Cephes, sinf.c).
        let sine = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 1.666_665_5e-1) * z * r + r;
        let cosine =
            ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
        match (quadrant as i32) & 3 {
            0 => (sine, cosine),
            1 => (cosine, -sine),
            2 => (-sine, -cosine),
            _ => (-cosine, sine),
        }
    }

    fn angle_of(self, x: Self) -> Self {
        libm::atan2f(self, x)
    }

    fn root(self) -> Self {
        libm::sqrtf(self)
    }

    fn reciprocal_root(self) -> Self {
        // Halving the exponent gives a first guess within 4 % (C. Lomont, Fast
        // inverse square root, 2003); each Newton step squares the error.
        let mut root = f32::from_bits(0x5f37_5a86_u32.wrapping_sub(self.to_bits() >> 1));
        let half = 0.5 * self;
        root *= 1.5 - half * root * root;
        root *= 1.5 - half * root * root;
        root * (1.5 - half * root * root)
    }

    #[inline(always)]
    fn nearest(self) -> Self {
        // Adding and subtracting 1.5 * 2^23 rounds to a whole number.
        const SHIFT: f32 = 12_582_912.0;
        (self + SHIFT) - SHIFT
    }
}

/// An angle in radians wrapped into (-pi, pi].
///
/// NaN stays NaN. The result is exact except for rounding up to some thousand
/// turns.
#[must_use]
pub fn wrap_angle<T: Scalar>(angle: T) -> T {
    let turn = T::two_pi();
    let wrapped = angle - turn * (angle / turn).nearest();
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

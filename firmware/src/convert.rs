//! The only place where raw codes are converted to physical units and back. A vehicle's crate
//! puts the codes into its messages.

use control::scalar::Scalar as _;

use crate::design;

/// Degrees in a radian.
const DEGREES: f32 = 180.0 / core::f32::consts::PI;

/// Rounds to the nearest whole number, halves away from zero; out of range saturates, NaN
/// gives zero.
pub fn rounded(value: f32) -> i32 {
    // `as` from a float saturates and takes NaN to zero.
    (if value < 0.0 {
        value - 0.5
    } else {
        value + 0.5
    }) as i32
}

/// Like [`rounded`]. Not by `clamp`: the compiler would move it before the conversion, where the
/// core has no instruction for it, and call a function.
fn rounded_i16(value: f32) -> i16 {
    let whole = rounded(value);
    i16::try_from(whole).unwrap_or(if whole < 0 { i16::MIN } else { i16::MAX })
}

/// Angle in microdegrees, in 1E-4 rad.
pub fn from_microdegrees(angle: i32) -> i16 {
    rounded_i16(angle as f32 * (0.01 / DEGREES))
}

/// Rate, rad/s, in hundredths of a degree a second.
pub fn centidegrees_per_second(rate: f32) -> i16 {
    rounded_i16(rate * DEGREES * 100.0)
}

/// Rate in hundredths of a degree a second, rad/s.
pub fn from_centidegrees_per_second(raw: i16) -> f32 {
    f32::from(raw) / (100.0 * DEGREES)
}

/// Speed, m/s, in centimetres a second.
pub fn centimetres_per_second(speed: f32) -> i16 {
    rounded_i16(speed * 100.0)
}

/// Speed in centimetres a second, m/s.
pub fn from_centimetres_per_second(raw: i16) -> f32 {
    f32::from(raw) / 100.0
}

/// Length, m, in millimetres.
pub fn millimetres(length: f32) -> i32 {
    rounded(length * 1000.0)
}

/// Angle, rad, in thousandths of a degree.
pub fn millidegrees(angle: f32) -> i32 {
    rounded(angle * DEGREES * 1000.0)
}

/// Angle, rad, in 1/256 degree; rate, rad/s, in 1/256 degree a second.
pub fn degrees_q8(angle: f32) -> i32 {
    rounded(angle * DEGREES * 256.0)
}

/// Heading, rad in (-pi, pi], in 1/256 degree of [0, 360).
pub fn heading_q8(heading: f32) -> i32 {
    degrees_q8(heading).rem_euclid(360 * 256)
}

/// Heading of a velocity over ground, thousandths of a degree clockwise from north in [0, 360
/// 000). `north` and `east` are in mm/s. `None` if the vehicle is too slow for the velocity to
/// show a heading.
pub fn heading_of(north: i32, east: i32) -> Option<i32> {
    // As floats, so that nothing overflows; exact below 16 m/s.
    let (north, east) = (north as f32, east as f32);
    let least = design::HEADING_SPEED as f32;
    if north * north + east * east < least * least {
        return None;
    }
    Some(millidegrees(east.angle_of(north)).rem_euclid(360_000))
}

/// An angle on the earth, split into the parts that the messages carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geodetic {
    /// Whole degrees, truncated towards zero.
    pub whole: i16,
    /// Magnitude of the decimal places, in units of 1e-10 degrees.
    pub fraction: u64,
    /// Whether the angle is negative.
    pub negative: bool,
}

/// Splits an angle in degrees, rounded to 1e-10 degrees. `None` if it is not within -180..=180.
///
/// Computed in integers: the core has a floating-point unit for `f32` only, so the
/// multiplication, division and comparisons of `f64` would cost ten times as much.
pub fn geodetic(degrees: f64) -> Option<Geodetic> {
    /// Fraction bits of the fixed-point magnitude: with eight integer bits they fill 64.
    const POINT: u32 = 56;
    const LIMIT: u64 = 180 << POINT;
    /// Bits of a double's fraction, and the biased exponent of values from 1 to 2.
    const FRACTION: u32 = 52;
    const ONE: u32 = 1023;
    let bits = degrees.to_bits();
    let exponent = (bits >> FRACTION) as u32 & 0x7FF;
    let significand = bits & ((1 << FRACTION) - 1) | 1 << FRACTION;
    // 2^8 and above are refused. Infinities and NaN have larger exponents still.
    if exponent > ONE + 7 {
        return None;
    }
    // Bits that the shift drops are below the resolution, and so are all subnormal numbers.
    let up = exponent + POINT;
    let magnitude = if up >= ONE + FRACTION {
        significand << (up - ONE - FRACTION)
    } else {
        significand.checked_shr(ONE + FRACTION - up).unwrap_or(0)
    };
    if magnitude > LIMIT {
        return None;
    }
    // 10^10 / 2^56 = 5^10 / 2^46. The product is computed in two parts of 28 bits: exact to
    // 2^-18, then rounded.
    const SCALE: u64 = 9_765_625;
    let part = |bits: u64| bits & ((1 << 28) - 1);
    let scaled = part(magnitude >> 28) * SCALE + ((part(magnitude) * SCALE) >> 28);
    let fraction = (scaled + (1 << 17)) >> 18;
    let whole = (magnitude >> POINT) as i16;
    let (whole, fraction) = if fraction < 10_000_000_000 {
        (whole, fraction)
    } else {
        (whole + 1, 0)
    };
    let negative = degrees.is_sign_negative() && bits << 1 != 0;
    Some(Geodetic {
        whole: if negative { -whole } else { whole },
        fraction,
        negative,
    })
}

/// Effort, -1..=1, as the motor driver's byte: 127 is stop, with 127 steps to each side (the
/// byte 255 would be a 128th step and is left out for symmetry). `full_is_forward` says which
/// way 255 turns.
pub fn motor_byte(effort: f32, full_is_forward: bool) -> u8 {
    let steps = rounded(effort * 127.0).clamp(-127, 127);
    let steps = if full_is_forward { steps } else { -steps };
    (127 + steps) as u8
}

/// A joystick axis as a share of its full travel, -1..=1: zero within the dead zone, continuous
/// at its edge.
pub fn joystick(count: u16) -> f32 {
    let centre = i32::from(design::JOYSTICK_CENTRE);
    let dead = i32::from(design::JOYSTICK_DEAD_ZONE);
    let way = i32::from(count.min(4095)) - centre;
    let beyond = (way.abs() - dead).max(0);
    let part = (beyond as f32 / (2047 - dead) as f32).min(1.0);
    if way < 0 { -part } else { part }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use core::f32::consts::PI;
    use proptest::prelude::*;

    #[test]
    fn the_motor_driver_s_three_marks() {
        // SyRen 50 manual, simplified serial: 127 stop, 0 and 255 the full speeds.
        let byte = |effort| motor_byte(effort, true);
        assert_eq!(byte(0.0), 127);
        assert_eq!(byte(-1.0), 0);
        assert_eq!(byte(1.0), 254);
        assert_eq!(byte(f32::NAN), 127);
        assert_eq!(byte(1e9), 254);
        assert_eq!(motor_byte(1.0, false), 0);
    }

    #[test]
    fn headings_are_those_of_the_compass() {
        let heading = heading_of;
        assert_eq!(heading(1000, 0), Some(0));
        assert_eq!(heading(0, 1000), Some(90_000));
        assert_eq!(heading(-1000, 0), Some(180_000));
        assert_eq!(heading(0, -1000), Some(270_000));
        assert_eq!(heading(100, 100), None);
        // The log of thesis Figure 6.33: -22, 54 mm/s is too slow to show a heading.
        assert_eq!(heading(-22, 54), None);
    }

    #[test]
    fn negative_angles_truncate_towards_zero() {
        let angle = geodetic(-96.617_089_234_7).unwrap();
        assert_eq!(angle.whole, -96);
        assert_eq!(angle.fraction, 6_170_892_347);
        assert!(angle.negative);
        let angle = geodetic(-0.25).unwrap();
        assert_eq!(
            (angle.whole, angle.fraction, angle.negative),
            (0, 2_500_000_000, true)
        );
        assert_eq!(geodetic(f64::NAN), None);
        assert_eq!(geodetic(180.1), None);
    }

    /// Magnitude of an angle in 1e-10 degrees, rounded to the nearest in whole numbers.
    fn scaled(degrees: f64) -> u64 {
        let bits = degrees.to_bits();
        let significand = u128::from(bits & ((1 << 52) - 1) | 1 << 52);
        let down = 1075 - (bits >> 52 & 0x7FF) as u32;
        match (significand * 10_000_000_000).checked_shr(down.saturating_sub(1)) {
            Some(doubled) => (doubled as u64).div_ceil(2),
            None => 0,
        }
    }

    #[test]
    fn angles_at_the_ends_of_their_range() {
        for edge in [180.0, f64::from_bits(180f64.to_bits() - 1)] {
            let angle = geodetic(-edge).unwrap();
            assert_eq!((angle.whole, angle.fraction), (-180, 0));
        }
        for beyond in [
            f64::from_bits(180f64.to_bits() + 1),
            256.0,
            f64::INFINITY,
            f64::NAN,
        ] {
            assert_eq!((geodetic(beyond), geodetic(-beyond)), (None, None));
        }
        for small in [f64::from_bits(1), f64::MIN_POSITIVE, 1e-300, 4.9e-11] {
            let angle = geodetic(-small).unwrap();
            assert_eq!((angle.whole, angle.fraction), (0, 0));
            assert!(angle.negative);
        }
        assert!(!geodetic(-0.0).unwrap().negative);
        assert_eq!(geodetic(5.1e-11).unwrap().fraction, 1);
    }

    proptest! {
        #[test]
        fn angles_are_rounded_to_the_nearest(degrees in -180.0f64..=180.0, down in 0u8..40) {
            let degrees = degrees / f64::from(down).exp2();
            let angle = geodetic(degrees).unwrap();
            let magnitude = u64::from(angle.whole.unsigned_abs()) * 10_000_000_000 + angle.fraction;
            prop_assert_eq!(magnitude, scaled(degrees));
            prop_assert_eq!(angle.negative, degrees < 0.0);
        }

        #[test]
        fn commands_survive_the_bus_to_half_a_count(rate in -3.0f32..3.0, metres in -3.0f32..3.0) {
            let back = from_centidegrees_per_second(centidegrees_per_second(rate));
            prop_assert!((back - rate).abs() < 0.006 / DEGREES);
            let back = from_centimetres_per_second(centimetres_per_second(metres));
            prop_assert!((back - metres).abs() < 0.0051);
        }

        #[test]
        fn efforts_are_monotonic_and_symmetric(a in -2.0f32..2.0, b in -2.0f32..2.0) {
            let (low, high) = if a < b { (a, b) } else { (b, a) };
            prop_assert!(motor_byte(low, true) <= motor_byte(high, true));
            let byte = |effort| i32::from(motor_byte(effort, true));
            prop_assert_eq!(byte(a) - 127, 127 - byte(-a));
        }

        #[test]
        fn the_joystick_is_odd_and_bounded(count in 1u16..=4095) {
            let part = joystick(count);
            prop_assert!((-1.0..=1.0).contains(&part));
            let mirrored = joystick(4096 - count);
            prop_assert!((part + mirrored).abs() < 1e-6);
        }

        #[test]
        fn headings_stay_within_their_signal(heading in -PI..=PI) {
            prop_assert!((0..360 * 256).contains(&heading_q8(heading)));
        }
    }
}

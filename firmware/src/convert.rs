//! The one place where raw codes and physical units meet.

use control::scalar::Scalar as _;
use network::messages::{
    CentidegreesPerSecond, CentimetresPerSecond, Degrees, DegreesE10, DegreesPerSecondQ8,
    DegreesQ8, Millidegrees, Millimetres,
};

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

fn rounded_i16(value: f32) -> i16 {
    rounded(value).clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
}

/// Steering rate, rad/s, for message 300.
pub fn steering_rate(rate: f32) -> CentidegreesPerSecond {
    CentidegreesPerSecond(rounded_i16(rate * DEGREES * 100.0))
}

/// Steering rate of message 300, rad/s.
pub fn steering_rate_of(raw: CentidegreesPerSecond) -> f32 {
    f32::from(raw.0) / (100.0 * DEGREES)
}

/// Speed, m/s, for messages 300, 451 and 452.
pub fn speed(speed: f32) -> CentimetresPerSecond {
    CentimetresPerSecond(rounded_i16(speed * 100.0))
}

/// Speed of message 300, m/s.
pub fn speed_of(raw: CentimetresPerSecond) -> f32 {
    f32::from(raw.0) / 100.0
}

/// Length, m, in millimetres.
pub fn millimetres(length: f32) -> Millimetres {
    Millimetres(rounded(length * 1000.0))
}

/// Angle, rad, in thousandths of a degree.
pub fn millidegrees(angle: f32) -> Millidegrees {
    Millidegrees(rounded(angle * DEGREES * 1000.0))
}

/// Angle, rad, in 1/256 degree.
pub fn degrees_q8(angle: f32) -> DegreesQ8 {
    DegreesQ8(rounded(angle * DEGREES * 256.0))
}

/// Heading, rad in (-pi, pi], in 1/256 degree of [0, 360).
pub fn heading_q8(heading: f32) -> DegreesQ8 {
    let DegreesQ8(raw) = degrees_q8(heading);
    DegreesQ8(raw.rem_euclid(360 * 256))
}

/// Rate, rad/s, in 1/256 degree a second.
pub fn degrees_per_second_q8(rate: f32) -> DegreesPerSecondQ8 {
    DegreesPerSecondQ8(rounded(rate * DEGREES * 256.0))
}

/// Heading of a velocity over ground, thousandths of a degree clockwise from north in
/// [0, 360 000); `None` when it is too slow to have one.
pub fn heading_of(north: i32, east: i32) -> Option<Millidegrees> {
    // As floats, so that nothing overflows; exact below 16 m/s.
    let (north, east) = (north as f32, east as f32);
    let least = design::HEADING_SPEED as f32;
    if north * north + east * east < least * least {
        return None;
    }
    let Millidegrees(raw) = millidegrees(east.angle_of(north));
    Some(Millidegrees(raw.rem_euclid(360_000)))
}

/// An angle on the earth as messages 401 and 402 carry it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geodetic {
    /// Whole degrees, truncated towards zero.
    pub whole: Degrees,
    /// Magnitude of the part after the point, 1e-10 degrees.
    pub fraction: DegreesE10,
    /// Whether the angle is negative.
    pub negative: bool,
}

/// Takes an angle in degrees apart, rounded to the nearest unit of its fraction; `None` when
/// it is not within -180..=180.
///
/// In whole numbers: a double's multiplication, division and comparisons cost the core, which
/// computes with floats only, ten times as much.
pub fn geodetic(degrees: f64) -> Option<Geodetic> {
    /// Bits behind the point of the magnitude: with eight before it they fill 64.
    const POINT: u32 = 56;
    const LIMIT: u64 = 180 << POINT;
    /// Bits of a double's fraction, and its exponent for values from 1 to 2.
    const FRACTION: u32 = 52;
    const ONE: u32 = 1023;
    let bits = degrees.to_bits();
    let exponent = (bits >> FRACTION) as u32 & 0x7FF;
    let significand = bits & ((1 << FRACTION) - 1) | 1 << FRACTION;
    // The highest exponent below 2^8; infinities and NaN have the highest of all.
    if exponent > ONE + 7 {
        return None;
    }
    // What is cut off below the last bit, and all of a subnormal number, is nothing here.
    let up = exponent + POINT;
    let magnitude = if up >= ONE + FRACTION {
        significand << (up - ONE - FRACTION)
    } else {
        significand.checked_shr(ONE + FRACTION - up).unwrap_or(0)
    };
    if magnitude > LIMIT {
        return None;
    }
    // 10^10 / 2^56 = 5^10 / 2^46, in two parts of 28 bits; exact to 2^-18, rounded there.
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
        whole: Degrees(if negative { -whole } else { whole }),
        fraction: DegreesE10(fraction),
        negative,
    })
}

/// Effort, -1..=1, as the motor driver's byte: 127 stop, 127 steps to each side (the 128th
/// forward step, 255, is left out for symmetry).
pub fn motor_byte(effort: f32) -> u8 {
    let steps = rounded(effort * 127.0).clamp(-127, 127);
    let steps = if design::FULL_BYTE_IS_FORWARD {
        steps
    } else {
        -steps
    };
    (127 + steps) as u8
}

/// A joystick axis as a part of its way, -1..=1, zero within the dead zone and continuous
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
    use network::Message;
    use network::messages::{Latitude, Longitude};
    use proptest::prelude::*;

    #[test]
    fn the_motor_driver_s_three_marks() {
        // SyRen 50 manual, simplified serial: 127 stop, 0 and 255 the full speeds.
        assert_eq!(motor_byte(0.0), 127);
        assert_eq!(motor_byte(-1.0), 0);
        assert_eq!(motor_byte(1.0), 254);
        assert_eq!(motor_byte(f32::NAN), 127);
        assert_eq!(motor_byte(1e9), 254);
    }

    #[test]
    fn headings_are_those_of_the_compass() {
        let heading = |north, east| heading_of(north, east).map(|Millidegrees(raw)| raw);
        assert_eq!(heading(1000, 0), Some(0));
        assert_eq!(heading(0, 1000), Some(90_000));
        assert_eq!(heading(-1000, 0), Some(180_000));
        assert_eq!(heading(0, -1000), Some(270_000));
        assert_eq!(heading(100, 100), None);
        // The log of thesis Figure 6.33: -22, 54 mm/s is too slow to have one.
        assert_eq!(heading(-22, 54), None);
    }

    /// The thesis's logged longitude byte 84 is -96 degrees, truncated towards zero.
    #[test]
    fn negative_angles_truncate_towards_zero() {
        let angle = geodetic(-96.617_089_234_7).unwrap();
        assert_eq!(angle.whole, Degrees(-96));
        assert_eq!(angle.fraction, DegreesE10(6_170_892_347));
        assert!(angle.negative);
        let data = Longitude {
            fraction: angle.fraction,
            whole: angle.whole,
            negative: true,
        }
        .encode();
        assert_eq!(data[5], 84);
        let angle = geodetic(-0.25).unwrap();
        assert_eq!(
            (angle.whole, angle.fraction, angle.negative),
            (Degrees(0), DegreesE10(2_500_000_000), true)
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
            assert_eq!(
                (angle.whole, angle.fraction),
                (Degrees(-180), DegreesE10(0))
            );
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
            assert_eq!((angle.whole, angle.fraction), (Degrees(0), DegreesE10(0)));
            assert!(angle.negative);
        }
        assert!(!geodetic(-0.0).unwrap().negative);
        assert_eq!(geodetic(5.1e-11).unwrap().fraction, DegreesE10(1));
    }

    proptest! {
        #[test]
        fn angles_are_rounded_to_the_nearest(degrees in -180.0f64..=180.0, down in 0u8..40) {
            let degrees = degrees / f64::from(down).exp2();
            let angle = geodetic(degrees).unwrap();
            let magnitude = u64::from(angle.whole.0.unsigned_abs()) * 10_000_000_000 + angle.fraction.0;
            prop_assert_eq!(magnitude, scaled(degrees));
            prop_assert_eq!(angle.negative, degrees < 0.0);
        }

        #[test]
        fn angles_survive_the_bus(degrees in -90.0f64..=90.0) {
            let angle = geodetic(degrees).unwrap();
            let message = Latitude { fraction: angle.fraction, whole: angle.whole, negative: angle.negative };
            let back = Latitude::decode(message.encode().as_ref()).unwrap();
            let magnitude = f64::from(back.whole.0.abs()) + back.fraction.0 as f64 * 1e-10;
            let value = if back.negative { -magnitude } else { magnitude };
            prop_assert!((value - degrees).abs() < 1e-10);
        }

        #[test]
        fn commands_survive_the_bus_to_half_a_count(rate in -3.0f32..3.0, metres in -3.0f32..3.0) {
            prop_assert!((steering_rate_of(steering_rate(rate)) - rate).abs() < 0.006 / DEGREES);
            prop_assert!((speed_of(speed(metres)) - metres).abs() < 0.0051);
        }

        #[test]
        fn efforts_are_monotonic_and_symmetric(a in -2.0f32..2.0, b in -2.0f32..2.0) {
            let (low, high) = if a < b { (a, b) } else { (b, a) };
            prop_assert!(motor_byte(low) <= motor_byte(high));
            prop_assert_eq!(i32::from(motor_byte(a)) - 127, 127 - i32::from(motor_byte(-a)));
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
            let DegreesQ8(raw) = heading_q8(heading);
            prop_assert!((0..360 * 256).contains(&raw));
        }
    }
}

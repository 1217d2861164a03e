//! Physical quantities as scenario files write them: a number and a unit, such as `"1 m/s"`.
//!
//! Inside, every quantity is held in its base unit (metres, seconds, radians, plain ratios).

use core::fmt;
use core::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, Visitor};

/// A kind of quantity: its name and the units it may be written in.
pub trait Kind {
    /// What it is called, with its article.
    const NAME: &'static str;
    /// Units, each with the factor and the divisor that convert it to the base unit; messages
    /// use the first one. Dividing by a power of ten gives the `f64` nearest to the number in
    /// the text, but multiplying by the inverse of that power would not.
    const UNITS: &'static [(&'static str, f64, f64)];
}

macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident, $alias:ident: $name:literal, $($unit:literal = $factor:tt / $divisor:tt),+;)+) => {$(
        $(#[$doc])*
        #[derive(Copy, Clone, Debug, PartialEq)]
        pub struct $kind;

        impl Kind for $kind {
            const NAME: &'static str = $name;
            const UNITS: &'static [(&'static str, f64, f64)] = &[$(($unit, $factor, $divisor)),+];
        }

        $(#[$doc])*
        pub type $alias = Quantity<$kind>;
    )+};
}

const DEGREE: f64 = core::f64::consts::PI / 180.0;

kinds! {
    /// A time span, in seconds.
    TimeKind, Time: "a time", "s" = 1.0 / 1.0, "ms" = 1.0 / 1e3, "us" = 1.0 / 1e6, "min" = 60.0 / 1.0;
    /// A length or coordinate, in metres.
    LengthKind, Length: "a length", "m" = 1.0 / 1.0, "cm" = 1.0 / 1e2, "mm" = 1.0 / 1e3;
    /// A speed, in metres per second.
    SpeedKind, Speed: "a speed", "m/s" = 1.0 / 1.0, "cm/s" = 1.0 / 1e2, "mm/s" = 1.0 / 1e3, "km/h" = 1.0 / 3.6;
    /// An acceleration, in metres per second squared.
    AccelerationKind, Acceleration: "an acceleration", "m/s2" = 1.0 / 1.0;
    /// An angle, in radians.
    AngleKind, Angle: "an angle", "deg" = DEGREE / 1.0, "rad" = 1.0 / 1.0;
    /// An angular rate, in radians per second.
    RateKind, Rate: "an angular rate", "deg/s" = DEGREE / 1.0, "rad/s" = 1.0 / 1.0;
    /// A share of a whole, as a plain ratio.
    RatioKind, Ratio: "a share", "%" = 1.0 / 1e2;
    /// A relative error of a clock, in parts per million.
    PpmKind, Ppm: "a clock error", "ppm" = 1.0 / 1.0;
    /// A change of a clock's error over time, in parts per million per second.
    DriftKind, Drift: "a clock's drift", "ppm/s" = 1.0 / 1.0;
    /// A voltage, in volts.
    VoltageKind, Voltage: "a voltage", "V" = 1.0 / 1.0, "mV" = 1.0 / 1e3;
    /// A converter reading, in counts.
    CountKind, Count: "a converter reading", "counts" = 1.0 / 1.0, "count" = 1.0 / 1.0;
    /// Counts for an angle, in counts per radian.
    SlopeKind, CountSlope: "a slope", "counts/deg" = 1.0 / DEGREE, "counts/rad" = 1.0 / 1.0;
    /// Slip angle of a tyre for a lateral load, in radians per unit of the vehicle's weight.
    ComplianceKind, Compliance: "a tyre's slip", "deg/g" = DEGREE / 1.0, "rad/g" = 1.0 / 1.0;
    /// How many of something stand along a way, in one per metre.
    DensityKind, Density: "a density", "/m" = 1.0 / 1.0;
}

/// A number with its unit, stored in the base unit of its kind.
pub struct Quantity<K> {
    value: f64,
    kind: PhantomData<K>,
}

impl<K> Quantity<K> {
    /// The quantity of `value` base units.
    #[must_use]
    pub const fn new(value: f64) -> Self {
        Self {
            value,
            kind: PhantomData,
        }
    }

    /// The value in base units.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.value
    }
}

impl Time {
    /// The time in microseconds, rounded to a whole number.
    #[must_use]
    pub const fn micros(self) -> u32 {
        (self.value * 1e6).round() as u32
    }
}

impl Angle {
    /// The angle of `degrees`.
    #[must_use]
    pub const fn degrees(degrees: f64) -> Self {
        Self::new(degrees * DEGREE)
    }
}

impl Rate {
    /// The rate of `degrees` each second.
    #[must_use]
    pub const fn degrees(degrees: f64) -> Self {
        Self::new(degrees * DEGREE)
    }
}

impl<K> Default for Quantity<K> {
    fn default() -> Self {
        Self::new(0.0)
    }
}

impl<K> Copy for Quantity<K> {}

impl<K> Clone for Quantity<K> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<K> PartialEq for Quantity<K> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<K> PartialOrd for Quantity<K> {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        self.value.partial_cmp(&other.value)
    }
}

impl<K: Kind> fmt::Display for Quantity<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, factor, divisor) = K::UNITS[0];
        // Rounding to twelve decimals hides the error of the conversion in the last bit.
        let value = (self.value / factor * divisor * 1e12).round() / 1e12;
        write!(f, "{value} {unit}")
    }
}

impl<K: Kind> fmt::Debug for Quantity<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// The factor from a unit of `K` to the base unit; `None` when it is no unit of `K`.
#[must_use]
pub fn factor<K: Kind>(unit: &str) -> Option<f64> {
    let mut units = K::UNITS.iter();
    let (_, factor, divisor) = units.find(|(name, ..)| *name == unit)?;
    Some(factor / divisor)
}

/// The units of `K` as a list for error messages: `s, ms, us or min`.
pub(crate) fn units_of<K: Kind>() -> String {
    let names: Vec<&str> = K::UNITS.iter().map(|(unit, ..)| *unit).collect();
    match names.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        Some((only, _)) => (*only).to_owned(),
        None => String::new(),
    }
}

impl<K: Kind> core::str::FromStr for Quantity<K> {
    type Err = String;

    /// Reads a number, a blank and a unit.
    ///
    /// # Errors
    /// A phrase that names the text and the units that are accepted.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refuse = || {
            format!(
                "{text:?} is not {}: write a number, a blank and the unit {}, such as \"1 {}\"",
                K::NAME,
                units_of::<K>(),
                K::UNITS[0].0
            )
        };
        let (number, unit) = text
            .trim()
            .split_once(char::is_whitespace)
            .ok_or_else(refuse)?;
        let value: f64 = number.parse().map_err(|_| refuse())?;
        let (_, factor, divisor) = K::UNITS
            .iter()
            .find(|(name, ..)| *name == unit.trim())
            .ok_or_else(refuse)?;
        if !value.is_finite() {
            return Err(refuse());
        }
        Ok(Self::new(value * factor / divisor))
    }
}

impl<'de, K: Kind> Deserialize<'de> for Quantity<K> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader<K>(PhantomData<K>);

        impl<K: Kind> Reader<K> {
            fn bare<E: Error>(number: impl fmt::Display) -> E {
                E::custom(format!(
                    "{number} has no unit: write {} as a string with the unit {}, such as \"{number} {}\"",
                    K::NAME,
                    units_of::<K>(),
                    K::UNITS[0].0
                ))
            }
        }

        impl<K: Kind> Visitor<'_> for Reader<K> {
            type Value = Quantity<K>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{} such as \"1 {}\"", K::NAME, K::UNITS[0].0)
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Self::Value, E> {
                text.parse().map_err(E::custom)
            }

            fn visit_i64<E: Error>(self, number: i64) -> Result<Self::Value, E> {
                Err(Self::bare(number))
            }

            fn visit_f64<E: Error>(self, number: f64) -> Result<Self::Value, E> {
                Err(Self::bare(number))
            }
        }

        deserializer.deserialize_any(Reader(PhantomData))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn units_convert_to_the_base_unit() {
        assert_eq!("36 km/h".parse::<Speed>().unwrap().get(), 10.0);
        assert_eq!("250 cm".parse::<Length>().unwrap().get(), 2.5);
        assert_eq!(
            "180 deg".parse::<Angle>().unwrap().get(),
            core::f64::consts::PI
        );
        assert_eq!("10 ms".parse::<Time>().unwrap().get(), 0.01);
        assert_eq!("10 %".parse::<Ratio>().unwrap().get(), 0.1);
        assert_eq!("100 us".parse::<Time>().unwrap().get(), 100e-6);
    }

    #[test]
    fn wrong_units_are_named() {
        assert_eq!(
            "1 deg".parse::<Speed>().unwrap_err(),
            "\"1 deg\" is not a speed: write a number, a blank and the unit m/s, cm/s, mm/s or \
             km/h, such as \"1 m/s\""
        );
        assert!("1m".parse::<Length>().is_err());
        assert!("nan m".parse::<Length>().is_err());
        assert!("inf s".parse::<Time>().is_err());
        assert!("".parse::<Time>().is_err());
    }

    proptest! {
        #[test]
        fn what_is_printed_reads_back(value in -1e6_f64..1e6) {
            let angle = Angle::degrees(value);
            let again: Angle = angle.to_string().parse().unwrap();
            prop_assert!((again.get() - angle.get()).abs() <= 1e-9 * angle.get().abs() + 1e-12);
        }

        #[test]
        fn no_text_makes_the_reader_panic(text in ".{0,24}") {
            let _ = text.parse::<Time>();
        }
    }
}

//! Which Rust type carries which signal.

use crate::{network::Network, signal::Signal};

/// An integer type of Rust.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Integer {
    pub signed: bool,
    /// 8, 16, 32 or 64.
    pub bits: u8,
}

impl Integer {
    /// The smallest type that holds all counts from `least` to `greatest`.
    pub(super) fn holding(least: i128, greatest: i128) -> Integer {
        let signed = least < 0;
        let bits = [8, 16, 32]
            .into_iter()
            .find(|&bits| {
                let integer = Integer { signed, bits };
                integer.least() <= least && greatest <= integer.greatest()
            })
            .unwrap_or(64);
        Integer { signed, bits }
    }

    /// The unsigned type of the same width.
    pub(super) fn unsigned(bits: u8) -> Integer {
        Integer {
            signed: false,
            bits,
        }
    }

    pub(super) fn name(self) -> String {
        format!("{}{}", if self.signed { 'i' } else { 'u' }, self.bits)
    }

    pub(super) fn least(self) -> i128 {
        if self.signed {
            -(1 << (self.bits - 1))
        } else {
            0
        }
    }

    pub(super) fn greatest(self) -> i128 {
        (1 << (self.bits - u8::from(self.signed))) - 1
    }
}

/// The Rust type of a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Field {
    Bool,
    /// An enumeration, by its value table.
    Values(String),
    /// A quantity with a unit: its newtype and the integer inside.
    Quantity(&'static str, Integer),
    Plain(Integer),
}

impl Field {
    pub(super) fn of(network: &Network, signal: &Signal) -> Field {
        let (least, greatest) = counts(signal);
        if let Some(table) = &signal.values {
            Field::Values(table.clone())
        } else if let Some(quantity) = Quantity::of(signal) {
            Field::Quantity(quantity.name, quantity.integer(network))
        } else if signal.size == 1 && !signal.signed {
            Field::Bool
        } else {
            Field::Plain(Integer::holding(least, greatest))
        }
    }

    pub(super) fn name(&self) -> String {
        match self {
            Field::Bool => "bool".into(),
            Field::Values(table) => table.clone(),
            Field::Quantity(name, _) => (*name).into(),
            Field::Plain(integer) => integer.name(),
        }
    }
}

/// Least and greatest count of a checked signal.
pub(super) fn counts(signal: &Signal) -> (i128, i128) {
    signal.count_range().unwrap_or((0, 0))
}

/// A unit and the size of a count in it, and the newtype that carries both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quantity {
    pub unit: &'static str,
    pub factor: f64,
    pub name: &'static str,
    pub doc: &'static str,
}

/// The quantities that have a newtype; a signal in any other unit is a plain number.
const QUANTITIES: [Quantity; 14] = [
    quantity("mm", 1.0, "Millimetres", "A length in millimetres."),
    quantity(
        "mm/s",
        1.0,
        "MillimetresPerSecond",
        "A speed in millimetres per second.",
    ),
    quantity(
        "cm/s",
        1.0,
        "CentimetresPerSecond",
        "A speed in centimetres per second.",
    ),
    quantity("deg", 1.0, "Degrees", "An angle in whole degrees."),
    quantity(
        "deg",
        0.001,
        "Millidegrees",
        "An angle in thousandths of a degree.",
    ),
    quantity("deg", 1e-10, "DegreesE10", "An angle in 1E-10 of a degree."),
    quantity(
        "deg",
        1.0 / 256.0,
        "DegreesQ8",
        "An angle in 1/256 of a degree.",
    ),
    quantity(
        "deg/s",
        0.01,
        "CentidegreesPerSecond",
        "An angular rate in hundredths of a degree per second.",
    ),
    quantity(
        "deg/s",
        1.0 / 256.0,
        "DegreesPerSecondQ8",
        "An angular rate in 1/256 of a degree per second.",
    ),
    quantity("ms", 1.0, "Milliseconds", "A time in milliseconds."),
    quantity(
        "us",
        1.0 / 32.0,
        "MicrosecondsQ5",
        "A time in 1/32 of a microsecond.",
    ),
    quantity("us", 1.0, "Microseconds", "A time in microseconds."),
    quantity("mV", 1.0, "Millivolts", "A voltage in millivolts."),
    quantity(
        "count",
        1.0,
        "AdcCount",
        "A count of an analogue to digital converter.",
    ),
];

const fn quantity(
    unit: &'static str,
    factor: f64,
    name: &'static str,
    doc: &'static str,
) -> Quantity {
    Quantity {
        unit,
        factor,
        name,
        doc,
    }
}

impl Quantity {
    /// The quantity of a signal, if it has one.
    pub(super) fn of(signal: &Signal) -> Option<Quantity> {
        QUANTITIES
            .into_iter()
            .find(|q| q.unit == signal.unit && q.factor == signal.factor)
    }

    /// The quantities that a network uses.
    pub(super) fn used(network: &Network) -> Vec<Quantity> {
        QUANTITIES
            .into_iter()
            .filter(|quantity| quantity.signals(network).next().is_some())
            .collect()
    }

    /// The one integer type that holds every signal of the quantity.
    pub(super) fn integer(&self, network: &Network) -> Integer {
        let (least, greatest) = self
            .signals(network)
            .map(counts)
            .fold((0, 0), |(least, greatest), (l, g)| {
                (least.min(l), greatest.max(g))
            });
        Integer::holding(least, greatest)
    }

    fn signals<'n>(&self, network: &'n Network) -> impl Iterator<Item = &'n Signal> {
        let quantity = *self;
        network
            .messages
            .iter()
            .flat_map(|message| &message.signals)
            .filter(move |signal| Quantity::of(signal) == Some(quantity))
    }
}

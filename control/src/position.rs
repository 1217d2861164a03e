//! Positions and velocities as the bus carries them.

use crate::scalar::Scalar;

/// A position in the local north-east frame, in millimetres, as message 200
/// carries it (thesis 6.2.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// Northing, mm.
    pub north: i32,
    /// Easting, mm.
    pub east: i32,
}

impl Position {
    /// A position from northing and easting in millimetres.
    #[must_use]
    pub const fn new(north: i32, east: i32) -> Self {
        Self { north, east }
    }

    /// North and east distance from `origin` to this position, m.
    ///
    /// The integers are subtracted before the conversion, so single precision is
    /// exact to the millimetre within 16 km of `origin`. The difference saturates
    /// at 2147 km.
    #[must_use]
    pub fn metres_from<T: Scalar>(self, origin: Self) -> (T, T) {
        let millimetre = T::lit(1e-3);
        (
            T::integer(self.north.saturating_sub(origin.north)) * millimetre,
            T::integer(self.east.saturating_sub(origin.east)) * millimetre,
        )
    }
}

/// A velocity over ground, in millimetres a second, as message 201 carries it
/// (thesis 6.2.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Velocity {
    /// North component, mm/s.
    pub north: i32,
    /// East component, mm/s.
    pub east: i32,
}

impl Velocity {
    /// A velocity from its components in millimetres a second.
    #[must_use]
    pub const fn new(north: i32, east: i32) -> Self {
        Self { north, east }
    }

    /// North and east components in metres a second.
    #[must_use]
    pub fn metres_per_second<T: Scalar>(self) -> (T, T) {
        let millimetre = T::lit(1e-3);
        (
            T::integer(self.north) * millimetre,
            T::integer(self.east) * millimetre,
        )
    }
}

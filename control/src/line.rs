//! Lines between two waypoints, and the vehicle's position relative to them.

use crate::position::Position;
use crate::scalar::{Scalar, wrap_angle};

/// The directed line from one waypoint through another (thesis Figure 7.7, Wa
/// to Wb).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line<T> {
    origin: Position,
    bearing: T,
    north: T,
    east: T,
    length: T,
}

/// Why two waypoints define no line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineError {
    /// Both waypoints are the same point, so the line has no direction.
    CoincidentWaypoints(Position),
}

impl core::fmt::Display for LineError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::CoincidentWaypoints(at) => write!(
                f,
                "both waypoints are at north {} mm, east {} mm: the line has no direction",
                at.north, at.east
            ),
        }
    }
}

impl core::error::Error for LineError {}

/// A position relative to a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePosition<T> {
    /// Distance along the line from the first waypoint, m.
    pub along: T,
    /// Distance to the right of the line, m: the cross-track error.
    pub cross_track: T,
}

impl<T: Scalar> Line<T> {
    /// The line from `from` to `to`.
    ///
    /// # Errors
    /// [`LineError::CoincidentWaypoints`] if both are the same point.
    pub fn new(from: Position, to: Position) -> Result<Self, LineError> {
        let (north, east) = to.metres_from::<T>(from);
        let length = (north * north + east * east).root();
        if length > T::zero() {
            Ok(Self {
                origin: from,
                bearing: east.angle_of(north),
                north: north / length,
                east: east / length,
                length,
            })
        } else {
            Err(LineError::CoincidentWaypoints(from))
        }
    }

    /// The first waypoint.
    #[must_use]
    pub fn origin(&self) -> Position {
        self.origin
    }

    /// Direction of the line, radians clockwise from north.
    #[must_use]
    pub fn bearing(&self) -> T {
        self.bearing
    }

    /// Distance between the waypoints, m.
    #[must_use]
    pub fn length(&self) -> T {
        self.length
    }

    /// `position` relative to the line, which continues straight beyond both
    /// waypoints.
    #[must_use]
    pub fn locate(&self, position: Position) -> LinePosition<T> {
        let (north, east) = position.metres_from::<T>(self.origin);
        let (along, cross_track) = self.locate_metres(north, east);
        LinePosition { along, cross_track }
    }

    /// Like [`Self::locate`] for a point `north` and `east` metres from the
    /// first waypoint: distance along the line and to its right, m.
    #[must_use]
    pub fn locate_metres(&self, north: T, east: T) -> (T, T) {
        (
            self.north * north + self.east * east,
            self.north * east - self.east * north,
        )
    }

    /// `heading` (radians clockwise from north) minus the direction of the line,
    /// in (-pi, pi]; positive if the vehicle points to the right of the line.
    #[must_use]
    pub fn heading_error(&self, heading: T) -> T {
        wrap_angle(heading - self.bearing)
    }
}

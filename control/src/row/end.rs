//! Detection of the row's end.

use crate::scalar::Scalar;

/// Consecutive readings of something within range that make a plant. Fewer may
/// be a disturbed reading.
const READINGS: u8 = 3;

/// How far the beam of one sensor has passed no plant.
///
/// Leaves and weeds count as plants: they, too, say that the row goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OpenWay<T> {
    way: T,
    readings: u8,
}

impl<T: Scalar> OpenWay<T> {
    /// A way that begins now.
    pub(super) fn new() -> Self {
        Self {
            way: T::zero(),
            readings: 0,
        }
    }

    /// Adds the `way` (m) driven since the last reading. `plant` says whether
    /// the present reading shows something within range.
    pub(super) fn add(&mut self, plant: bool, way: T) {
        self.readings = if plant {
            self.readings.saturating_add(1)
        } else {
            0
        };
        if self.readings >= READINGS {
            self.way = T::zero();
        } else {
            self.way += way;
        }
    }

    /// Way since the last plant, m.
    pub(super) fn way(&self) -> T {
        self.way
    }
}

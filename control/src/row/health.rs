//! Health of a distance sensor.

use crate::scalar::Scalar;

/// Health of the readings of one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SideHealth {
    /// Stalks were seen lately: this side carries the estimate.
    Fresh,
    /// No stalk was seen for a while: a gap, or leaves that hide the row.
    Hidden,
    /// The reading has hardly changed while the robot drove, and the other side does not
    /// look like a wall: the sensor is frozen.
    Frozen,
    /// The readings are below the sensor's range or no numbers: the sensor is
    /// shorted or broken.
    Implausible,
}

/// Readings that differ by no more than this may be of one voltage, m: with the noise of a
/// converter, whole centimetres are one more or less.
const STILL: f64 = 0.021;

/// Watches the readings of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Watch<T> {
    /// Least and largest of the readings that may be of one voltage, m.
    least: T,
    most: T,
    /// Way with the same reading, m.
    same: T,
    /// Way with readings that may be of one voltage, m.
    still: T,
    /// Way with readings that cannot be, m.
    impossible: T,
}

impl<T: Scalar> Watch<T> {
    pub(super) fn new() -> Self {
        Self {
            least: T::zero(),
            most: T::zero(),
            same: T::zero(),
            still: T::zero(),
            impossible: T::zero(),
        }
    }

    /// Takes a reading, after the `way` (m). It is `possible` if it is a number
    /// within the sensor's range, and a `plant` if it is not beyond the rows.
    /// Nothing within range may well last unchanged, and so may the distance `between`
    /// two walls, but not to the count.
    pub(super) fn add(&mut self, reading: T, possible: bool, plant: bool, between: bool, way: T) {
        if plant && reading == self.least && reading == self.most {
            self.same += way;
        } else {
            self.same = T::zero();
        }
        let least = if reading < self.least {
            reading
        } else {
            self.least
        };
        let most = if reading > self.most {
            reading
        } else {
            self.most
        };
        if plant && !between && most - least <= T::lit(STILL) {
            self.still += way;
            (self.least, self.most) = (least, most);
        } else {
            self.still = T::zero();
            (self.least, self.most) = (reading, reading);
        }
        if possible {
            self.impossible = T::zero();
        } else {
            self.impossible += way;
        }
    }

    pub(super) fn is_faulty(&self, fault_way: T) -> bool {
        self.same >= fault_way || self.still >= fault_way || self.impossible >= fault_way
    }

    pub(super) fn health(&self, fault_way: T, fresh: bool) -> SideHealth {
        if self.impossible >= fault_way {
            SideHealth::Implausible
        } else if self.same >= fault_way || self.still >= fault_way {
            SideHealth::Frozen
        } else if fresh {
            SideHealth::Fresh
        } else {
            SideHealth::Hidden
        }
    }
}

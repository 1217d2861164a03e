//! Health of a distance sensor.

use crate::scalar::Scalar;

/// Health of the readings of one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SideHealth {
    /// Stalks were seen lately: this side carries the estimate.
    Fresh,
    /// No stalk was seen for a while: a gap, or leaves that hide the row.
    Hidden,
    /// The reading has not changed by a single count while the robot drove: the
    /// sensor is frozen.
    Frozen,
    /// The readings are below the sensor's range or no numbers: the sensor is
    /// shorted or broken.
    Implausible,
}

/// Watches the readings of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Watch<T> {
    last: T,
    /// Way with the same reading, m.
    same: T,
    /// Way with readings that cannot be, m.
    impossible: T,
}

impl<T: Scalar> Watch<T> {
    pub(super) fn new() -> Self {
        Self {
            last: T::zero(),
            same: T::zero(),
            impossible: T::zero(),
        }
    }

    /// Takes a reading, after the `way` (m). It is `possible` if it is a number
    /// within the sensor's range, and a `plant` if it is not beyond the rows.
    /// Nothing within range may well last unchanged.
    pub(super) fn add(&mut self, reading: T, possible: bool, plant: bool, way: T) {
        if plant && reading == self.last {
            self.same += way;
        } else {
            self.same = T::zero();
        }
        self.last = reading;
        if possible {
            self.impossible = T::zero();
        } else {
            self.impossible += way;
        }
    }

    pub(super) fn is_faulty(&self, fault_way: T) -> bool {
        self.same >= fault_way || self.impossible >= fault_way
    }

    pub(super) fn health(&self, fault_way: T, fresh: bool) -> SideHealth {
        if self.impossible >= fault_way {
            SideHealth::Implausible
        } else if self.same >= fault_way {
            SideHealth::Frozen
        } else if fresh {
            SideHealth::Fresh
        } else {
            SideHealth::Hidden
        }
    }
}

//! Settings of the takeover.

use crate::scalar::Scalar;

/// Settings of the takeover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TakeoverSettings<T> {
    /// Speed while the rows guide, m/s.
    pub speed: T,
    /// Longest age of the last sound sighting, s.
    pub longest_age: T,
    /// Longest way without a fix, m.
    pub longest_way: T,
    /// How long the fix must be back before the satellites guide again, s; may be 0.
    pub settle: T,
    /// Rate at which the distance between the row's middle and the line is taken back
    /// after a change of the guide, m/s.
    pub take_back: T,
    /// Half the distance between the rows, m.
    pub half_width: T,
    /// Its standard deviation from row to row, m.
    pub tolerance: T,
}

/// The setting of the takeover that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TakeoverError {
    /// The speed is not a positive number.
    Speed,
    /// The longest age is not a positive number.
    Age,
    /// The longest way is not a positive number.
    Way,
    /// The time of the returned fix is negative or not a number.
    Settle,
    /// The rate of the handover is not a positive number.
    TakeBack,
    /// The half width or its tolerance is not a positive number.
    Width,
    /// A setting of the controller's steering law.
    Controller,
}

impl core::fmt::Display for TakeoverError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Speed => "the speed between the rows is not a positive number",
            Self::Age => "the longest age of a sighting is not a positive number",
            Self::Way => "the longest way without a fix is not a positive number",
            Self::Settle => "the time of the returned fix is negative or not a number",
            Self::TakeBack => "the rate of the handover is not a positive number",
            Self::Width => "the width between the rows or its tolerance is not a positive number",
            Self::Controller => "a setting of the controller's steering law is out of range",
        })
    }
}

impl core::error::Error for TakeoverError {}

impl<T: Scalar> TakeoverSettings<T> {
    /// Checks that every setting is usable.
    ///
    /// # Errors
    /// [`TakeoverError`] names the setting that is not.
    pub fn check(&self) -> Result<(), TakeoverError> {
        let positive = |value: T| value.is_finite() && value > T::zero();
        let rules = [
            (positive(self.speed), TakeoverError::Speed),
            (positive(self.longest_age), TakeoverError::Age),
            (positive(self.longest_way), TakeoverError::Way),
            (
                self.settle.is_finite() && self.settle >= T::zero(),
                TakeoverError::Settle,
            ),
            (positive(self.take_back), TakeoverError::TakeBack),
            (
                positive(self.half_width) && positive(self.tolerance),
                TakeoverError::Width,
            ),
        ];
        match rules.into_iter().find(|(sound, _)| !sound) {
            Some((_, error)) => Err(error),
            None => Ok(()),
        }
    }
}

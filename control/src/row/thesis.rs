//! The signal chain of the thesis for following a crop row (thesis chapter 2).
//!
//! The sensors look 45 degrees forward to either side. The right distance minus
//! the left one grows if the robot is left of the middle, and also if it points
//! to the left, so this one number steers it (thesis equation 2.1). The signal
//! chain is that of thesis Figure 2.18: hold the last plausible reading, filter
//! it, take the difference, apply a P or PI controller with saturated input and
//! output, and steer by different efforts of both sides.

use crate::scalar::{Scalar, clamp_symmetric};

/// Conditional zero-order hold: passes plausible samples and replaces all
/// others by the last plausible one (thesis 2.2.5.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionalHold<T> {
    least: T,
    most: T,
    held: T,
}

/// The range of plausible samples is empty or not a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmptyRange;

impl core::fmt::Display for EmptyRange {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the range of plausible samples is empty or not a number")
    }
}

impl core::error::Error for EmptyRange {}

impl<T: Scalar> ConditionalHold<T> {
    /// A hold for which samples from `least` to `most` are plausible. Its
    /// initial value is the middle of that range.
    ///
    /// # Errors
    /// [`EmptyRange`] unless both are finite and `least` is below `most`.
    pub fn new(least: T, most: T) -> Result<Self, EmptyRange> {
        if least.is_finite() && most.is_finite() && least < most {
            Ok(Self::within(least, most))
        } else {
            Err(EmptyRange)
        }
    }

    /// The same, with a range that was checked before.
    #[must_use]
    pub fn within(least: T, most: T) -> Self {
        Self {
            least,
            most,
            held: (least + most) * T::lit(0.5),
        }
    }

    /// `sample` if it is plausible, otherwise the last plausible one.
    pub fn pass(&mut self, sample: T) -> T {
        if sample >= self.least && sample <= self.most {
            self.held = sample;
        }
        self.held
    }
}

/// Scalar Kalman filter of a random walk: an exponential filter with a high
/// gain at the start (thesis 2.2.5.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarKalman<T> {
    process: T,
    measurement: T,
    estimate: T,
    variance: T,
}

/// The variance that is not a positive number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VarianceError {
    /// The process variance.
    Process,
    /// The measurement variance.
    Measurement,
}

impl core::fmt::Display for VarianceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Process => "the process variance is not a positive number",
            Self::Measurement => "the measurement variance is not a positive number",
        })
    }
}

impl core::error::Error for VarianceError {}

impl<T: Scalar> ScalarKalman<T> {
    /// A filter with the variance `process` that the quantity gains between two
    /// samples and the variance `measurement` of a sample, both in its unit
    /// squared. The first estimate equals the first sample.
    ///
    /// # Errors
    /// [`VarianceError`] names the variance that is not a positive number.
    pub fn new(process: T, measurement: T) -> Result<Self, VarianceError> {
        let positive = |value: T| value.is_finite() && value > T::zero();
        if !positive(process) {
            return Err(VarianceError::Process);
        }
        if !positive(measurement) {
            return Err(VarianceError::Measurement);
        }
        Ok(Self::of(process, measurement))
    }

    /// The same, with variances that were checked before.
    #[must_use]
    pub fn of(process: T, measurement: T) -> Self {
        Self {
            process,
            measurement,
            estimate: T::zero(),
            // Large enough for the first sample to replace the estimate.
            variance: measurement * T::lit(1e9),
        }
    }

    /// The estimate after `sample`. A sample that is not finite is ignored.
    pub fn step(&mut self, sample: T) -> T {
        self.variance += self.process;
        if sample.is_finite() {
            let gain = self.variance / (self.variance + self.measurement);
            self.estimate += gain * (sample - self.estimate);
            self.variance *= T::one() - gain;
            if self.variance > self.measurement {
                self.variance = self.measurement;
            }
        }
        self.estimate
    }

    /// Variance of the estimate.
    #[must_use]
    pub fn variance(&self) -> T {
        self.variance
    }
}

/// A proportional-integral controller with saturated input and output (thesis
/// 2.2.6.1). With an integral gain of zero it is a proportional controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProportionalIntegral<T> {
    /// Output per unit of error.
    pub proportional: T,
    /// Output per unit of error and second.
    pub integral: T,
    /// Magnitude to which the error is limited.
    pub input_limit: T,
    /// Magnitude to which the output is limited.
    pub output_limit: T,
}

/// The integral of a [`ProportionalIntegral`] controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntegralState<T> {
    sum: T,
}

impl<T: Scalar> IntegralState<T> {
    /// An integral of zero.
    #[must_use]
    pub fn new() -> Self {
        Self { sum: T::zero() }
    }

    /// The integral, in units of output.
    #[must_use]
    pub fn sum(&self) -> T {
        self.sum
    }
}

impl<T: Scalar> Default for IntegralState<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Scalar> ProportionalIntegral<T> {
    /// The output for `error`, `dt` seconds after the last step. The integral
    /// does not grow while the output is saturated in the direction of the error
    /// (anti-windup). An error that is not finite counts as zero.
    pub fn step(&self, state: &mut IntegralState<T>, error: T, dt: T) -> T {
        let error = if error.is_finite() {
            clamp_symmetric(error, self.input_limit)
        } else {
            T::zero()
        };
        let sum = state.sum + self.integral * error * dt;
        let wanted = self.proportional * error + sum;
        let output = clamp_symmetric(wanted, self.output_limit);
        if output == wanted || error * wanted < T::zero() {
            state.sum = clamp_symmetric(sum, self.output_limit);
        }
        output
    }
}

/// Motor efforts of both sides of a differentially steered vehicle, each in
/// [-1, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sides<T> {
    /// Left wheels.
    pub left: T,
    /// Right wheels.
    pub right: T,
}

/// Differential steering (thesis 2.2.2): the left side gets `forward` plus
/// `turn`, the right side `forward` minus `turn`. If a side would exceed full
/// effort, `forward` is reduced, so that the turn is kept.
#[must_use]
pub fn differential<T: Scalar>(forward: T, turn: T) -> Sides<T> {
    let turn = clamp_symmetric(turn, T::one());
    let forward = clamp_symmetric(forward, T::one() - turn.abs());
    Sides {
        left: forward + turn,
        right: forward - turn,
    }
}

/// The signal chain of a row-following robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowFollower<T> {
    left: (ConditionalHold<T>, ScalarKalman<T>),
    right: (ConditionalHold<T>, ScalarKalman<T>),
    law: ProportionalIntegral<T>,
    state: IntegralState<T>,
}

impl<T: Scalar> RowFollower<T> {
    /// A follower. Each sensor gets its own copy of `hold` and `filter`.
    #[must_use]
    pub fn new(
        hold: ConditionalHold<T>,
        filter: ScalarKalman<T>,
        law: ProportionalIntegral<T>,
    ) -> Self {
        Self {
            left: (hold, filter),
            right: (hold, filter),
            law,
            state: IntegralState::new(),
        }
    }

    /// One step, `dt` seconds after the last one. `left` and `right` are the
    /// distances to the rows, in the unit of the hold (the thesis's bus carries
    /// centimetres); `forward` is an effort in [-1, 1]. Returns the efforts of
    /// both sides.
    pub fn step(&mut self, left: T, right: T, forward: T, dt: T) -> Sides<T> {
        let left = self.left.1.step(self.left.0.pass(left));
        let right = self.right.1.step(self.right.0.pass(right));
        let turn = self.law.step(&mut self.state, right - left, dt);
        differential(forward, turn)
    }
}

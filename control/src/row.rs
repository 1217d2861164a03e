//! Following a crop row by two distance sensors (thesis chapter 2).
//!
//! The sensors look 45 degrees forward to either side. Their difference,
//! right less left, grows both when the robot stands left of the middle and
//! when it points to the left, so one number steers it (thesis equation 2.1).
//! The chain is the thesis's Figure 2.18: hold the last plausible reading,
//! smooth it, take the difference, P or PI with saturation on both sides,
//! differential steering.

use crate::scalar::{Scalar, clamp_symmetric};

/// The conditional zero-order hold: passes plausible samples on and repeats
/// the last one in place of the others (thesis 2.2.5.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionalHold<T> {
    least: T,
    most: T,
    held: T,
}

/// A hold whose range is empty or not a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmptyRange;

impl core::fmt::Display for EmptyRange {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the range of plausible samples is empty or not a number")
    }
}

impl core::error::Error for EmptyRange {}

impl<T: Scalar> ConditionalHold<T> {
    /// A hold that takes samples from `least` to `most` for plausible; it
    /// begins with the middle of that range.
    ///
    /// # Errors
    /// [`EmptyRange`] unless both are finite and `least` is below `most`.
    pub fn new(least: T, most: T) -> Result<Self, EmptyRange> {
        if least.is_finite() && most.is_finite() && least < most {
            Ok(Self {
                least,
                most,
                held: (least + most) * T::lit(0.5),
            })
        } else {
            Err(EmptyRange)
        }
    }

    /// The sample if it is plausible, else the last one that was.
    pub fn pass(&mut self, sample: T) -> T {
        if sample >= self.least && sample <= self.most {
            self.held = sample;
        }
        self.held
    }
}

/// The scalar Kalman filter of a quantity that stays where it is but for
/// noise: an exponential smoother that starts fast (thesis 2.2.5.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarKalman<T> {
    process: T,
    measurement: T,
    estimate: T,
    variance: T,
}

/// A variance that is not a positive number.
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
    /// A filter with the variance that the quantity gains between samples and
    /// that of a sample, both in its unit squared. The first sample is taken
    /// as it is.
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
        Ok(Self {
            process,
            measurement,
            estimate: T::zero(),
            // So uncertain that the first sample replaces it.
            variance: measurement * T::lit(1e9),
        })
    }

    /// The estimate after `sample`; a sample that is not finite is skipped.
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
/// 2.2.6.1). With an integral gain of zero it is the proportional one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProportionalIntegral<T> {
    /// Output for each unit of error.
    pub proportional: T,
    /// Output for each unit of error and second.
    pub integral: T,
    /// Largest magnitude of the error that is looked at.
    pub input_limit: T,
    /// Largest magnitude of the output.
    pub output_limit: T,
}

/// The sum that a [`ProportionalIntegral`] controller remembers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntegralState<T> {
    sum: T,
}

impl<T: Scalar> IntegralState<T> {
    /// An empty sum.
    #[must_use]
    pub fn new() -> Self {
        Self { sum: T::zero() }
    }

    /// The sum, in units of output.
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
    /// The output for `error` after `dt` seconds. The sum does not grow while
    /// the output is saturated in the direction of the error. An error that is
    /// not finite counts as none.
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

/// Efforts of the two sides of a differentially steered vehicle, each in
/// [-1, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sides<T> {
    /// Left wheels.
    pub left: T,
    /// Right wheels.
    pub right: T,
}

/// Differential steering (thesis 2.2.2): `forward` effort for both sides plus
/// and minus `turn`, positive to the right. When a side would exceed full
/// effort both give way, so that the turn is kept at the cost of speed.
#[must_use]
pub fn differential<T: Scalar>(forward: T, turn: T) -> Sides<T> {
    let turn = clamp_symmetric(turn, T::one());
    let forward = clamp_symmetric(forward, T::one() - turn.abs());
    Sides {
        left: forward + turn,
        right: forward - turn,
    }
}

/// The whole chain of one robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowFollower<T> {
    left: (ConditionalHold<T>, ScalarKalman<T>),
    right: (ConditionalHold<T>, ScalarKalman<T>),
    law: ProportionalIntegral<T>,
    state: IntegralState<T>,
}

impl<T: Scalar> RowFollower<T> {
    /// A follower whose two sensors share `hold` and `filter`.
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

    /// One step: distances to the left and the right row (in the unit of the
    /// hold, centimetres on the thesis's bus), `forward` effort in [-1, 1],
    /// `dt` seconds since the last step. Returns the efforts of both sides.
    pub fn step(&mut self, left: T, right: T, forward: T, dt: T) -> Sides<T> {
        let left = self.left.1.step(self.left.0.pass(left));
        let right = self.right.1.step(self.right.0.pass(right));
        let turn = self.law.step(&mut self.state, right - left, dt);
        differential(forward, turn)
    }
}

//! A small model predictive controller for the steering. It minimises the
//! regulator's cost over N steps under the limits of steering angle and rate.
//!
//! It exists for comparison with [`crate::guidance`], the law that drives the
//! vehicle (`tests/mpc.rs`). Its model is linear, so it works within about 45
//! degrees of the path's direction.

use crate::feedback::{LimitError, Limits};
use crate::linear::solve;
use crate::lqr::{RegulatorError, dlqr};
use crate::model::{Geometry, GeometryError};
use crate::scalar::{Scalar, clamp_symmetric};
use nalgebra::{SMatrix, SVector};

/// Weights on cross-track error (1/m^2), heading error (1/rad^2), steering
/// angle (1/rad^2) and steering rate (s^2/rad^2).
pub type Weights<T> = [T; 4];

/// Why no predictive controller could be designed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MpcError {
    /// The vehicle's geometry.
    Geometry(GeometryError),
    /// A limit.
    Limit(LimitError),
    /// The regulator whose cost-to-go is the terminal cost.
    Regulator(RegulatorError),
    /// The quadratic program is singular.
    Singular,
}

impl core::fmt::Display for MpcError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Geometry(error) => error.fmt(f),
            Self::Limit(error) => error.fmt(f),
            Self::Regulator(error) => error.fmt(f),
            Self::Singular => f.write_str("the quadratic program is singular"),
        }
    }
}

impl core::error::Error for MpcError {}

/// A predictive controller and its last solution, the warm start of the next.
///
/// The quadratic program in the N steering rates is solved by the alternating
/// direction method of multipliers (Stellato et al., "OSQP", Mathematical
/// Programming Computation 12, 2020). Its only matrix is inverted once, in
/// [`Self::design`]. An iteration takes about N^2 + 10 N multiplications.
#[derive(Clone, Copy, Debug)]
pub struct Mpc<T, const N: usize> {
    limits: Limits<T>,
    period: T,
    penalty: T,
    inverse: SMatrix<T, N, N>,
    linear: SMatrix<T, N, 3>,
    rates: SVector<T, N>,
    angles: SVector<T, N>,
    rate_prices: SVector<T, N>,
    angle_prices: SVector<T, N>,
}

impl<T: Scalar, const N: usize> Mpc<T, N> {
    /// Designs a controller for the steering model of `geometry` at `speed`
    /// (m/s), with N steps of `period` seconds. The controlled point is L1 ahead
    /// of the rear axle.
    ///
    /// # Errors
    /// [`MpcError`] names the input that is unusable.
    pub fn design(
        geometry: &Geometry<T>,
        limits: Limits<T>,
        weights: &Weights<T>,
        speed: T,
        period: T,
    ) -> Result<Self, MpcError> {
        geometry.check().map_err(MpcError::Geometry)?;
        limits.check().map_err(MpcError::Limit)?;
        let model = geometry.steering_model_sampled(speed, period);
        let [cross, heading, steering, rate] = *weights;
        let q = SMatrix::<T, 3, 3>::from_diagonal(&SVector::<T, 3>::new(cross, heading, steering));
        let r = SMatrix::<T, 1, 1>::new(rate);
        let terminal = dlqr(&model, &q, &r).map_err(MpcError::Regulator)?.cost;

        // Effect of each steering rate, and of the initial state, on the
        // predicted states.
        let mut quadratic = SMatrix::<T, N, N>::identity() * rate;
        let mut linear = SMatrix::<T, N, 3>::zeros();
        let mut effects = SMatrix::<T, 3, N>::zeros();
        let mut transition = SMatrix::<T, 3, 3>::identity();
        for step in 0..N {
            effects = model.f * effects;
            effects.set_column(step, &model.g);
            transition = model.f * transition;
            let weight = if step + 1 == N { terminal } else { q };
            quadratic += effects.transpose() * weight * effects;
            linear += effects.transpose() * weight * transition;
        }
        // The steering angle is the sum of the rates so far, times the period.
        let mut sums = SMatrix::<T, N, N>::zeros();
        for row in 0..N {
            for column in 0..=row {
                sums[(row, column)] = T::one();
            }
        }
        let penalty = quadratic.trace() / T::lit(N as f64) * T::lit(0.1);
        let constraint = SMatrix::<T, N, N>::identity() + sums.transpose() * sums;
        let inverse = solve(quadratic + constraint * penalty, SMatrix::identity())
            .ok_or(MpcError::Singular)?;
        Ok(Self {
            limits,
            period,
            penalty,
            inverse,
            linear,
            rates: SVector::zeros(),
            angles: SVector::zeros(),
            rate_prices: SVector::zeros(),
            angle_prices: SVector::zeros(),
        })
    }

    /// The steering rate (rad/s) to command at `state` (cross-track error m,
    /// heading error rad, steering angle rad): the first of the N optimal rates.
    /// The solver starts from the last call's solution and runs `iterations`
    /// iterations.
    pub fn solve(&mut self, state: &SVector<T, 3>, iterations: u32) -> T {
        let most = self.limits.steering_rate;
        // Angles are divided by the period, so that they are sums of rates.
        let start = state[2] / self.period;
        let reach = self.limits.steering_angle / self.period;
        let gradient = self.linear * state;
        for _ in 0..iterations {
            let angles = self.angles - self.angle_prices - SVector::repeat(start);
            let pull = self.rates - self.rate_prices + sums_from_end(&angles);
            let moves = self.inverse * (pull * self.penalty - gradient);
            let sums = sums_from_start(&moves) + SVector::repeat(start);
            self.rates = (moves + self.rate_prices).map(|rate| clamp_symmetric(rate, most));
            self.angles = (sums + self.angle_prices).map(|angle| clamp_symmetric(angle, reach));
            self.rate_prices += moves - self.rates;
            self.angle_prices += sums - self.angles;
        }
        self.rates.iter().next().copied().unwrap_or(T::zero())
    }

    /// All N steering rates of the last solution, rad/s.
    #[must_use]
    pub fn plan(&self) -> &SVector<T, N> {
        &self.rates
    }
}

fn sums_from_start<T: Scalar, const N: usize>(values: &SVector<T, N>) -> SVector<T, N> {
    let mut sum = T::zero();
    values.map(|value| {
        sum += value;
        sum
    })
}

fn sums_from_end<T: Scalar, const N: usize>(values: &SVector<T, N>) -> SVector<T, N> {
    let mut rest = values.sum();
    values.map(|value| {
        let now = rest;
        rest -= value;
        now
    })
}

//! The linear quadratic regulator in discrete time (thesis 7.2.3, `dlqr`).

use crate::linear::{is_finite, is_positive, is_symmetric, solve, symmetric_part};
use crate::model::Discrete;
use crate::scalar::Scalar;
use nalgebra::SMatrix;

/// A designed regulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regulator<T, const N: usize, const M: usize> {
    /// State feedback gain for u = -K x, M x N, in units of input per unit of
    /// state.
    pub gain: SMatrix<T, M, N>,
    /// Stabilising solution S of the Riccati equation, N x N: x' S x is the
    /// cost-to-go from state x.
    pub cost: SMatrix<T, N, N>,
}

/// Why no regulator exists, or none could be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegulatorError {
    /// An entry of F or G is NaN or infinite.
    ModelNotFinite,
    /// The state weight Q is not finite, symmetric and positive semidefinite.
    StateWeight,
    /// The input weight R is not finite, symmetric and positive definite.
    InputWeight,
    /// No stabilising solution exists: an unstable mode is not controllable, or
    /// the state weight does not observe a mode on the unit circle.
    NotStabilisable,
    /// The data are so badly conditioned that the solution found does not
    /// satisfy the Riccati equation.
    IllConditioned,
}

impl core::fmt::Display for RegulatorError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::ModelNotFinite => "an entry of F or G is not a finite number",
            Self::StateWeight => "the state weight Q is not symmetric and positive semidefinite",
            Self::InputWeight => "the input weight R is not symmetric and positive definite",
            Self::NotStabilisable => {
                "no stabilising gain: an unstable mode is not controllable, \
                 or a mode on the unit circle has no weight"
            }
            Self::IllConditioned => "the data are too badly conditioned for a reliable gain",
        })
    }
}

impl core::error::Error for RegulatorError {}

/// Designs the regulator u = -K x that minimises the sum of x' Q x + u' R u.
///
/// `model` has N states and M inputs; `q` is N x N positive semidefinite,
/// `r` M x M positive definite.
///
/// The Riccati equation is solved by the structure-preserving doubling
/// algorithm (Chu, Fan, Lin and Wang, "Structure-preserving algorithms for
/// periodic discrete-time algebraic Riccati equations", Int. J. Control 77(8),
/// 2004). It converges quadratically and stays accurate for unstable and for
/// singular F. Two steps of Newton's method refine the result (Hewer, IEEE TAC
/// 16(4), 1971).
///
/// # Errors
/// [`RegulatorError`] names the matrix or the condition at fault.
pub fn dlqr<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, M, M>,
) -> Result<Regulator<T, N, M>, RegulatorError> {
    if !(is_finite(&model.f) && is_finite(&model.g)) {
        return Err(RegulatorError::ModelNotFinite);
    }
    if !(is_finite(q) && is_symmetric(q) && is_positive(q, false)) {
        return Err(RegulatorError::StateWeight);
    }
    if !(is_finite(r) && is_symmetric(r) && is_positive(r, true)) {
        return Err(RegulatorError::InputWeight);
    }
    let mut cost = doubling(model, q, r)?;
    let mut gain = gain_of(model, r, &cost).ok_or(RegulatorError::IllConditioned)?;
    for _ in 0..2 {
        let closed = model.f - model.g * gain;
        let weight = q + gain.transpose() * r * gain;
        let Some(next) = lyapunov_cost(&closed, &weight) else {
            return Err(RegulatorError::NotStabilisable);
        };
        let Some(next_gain) = gain_of(model, r, &next) else {
            return Err(RegulatorError::IllConditioned);
        };
        cost = next;
        gain = next_gain;
    }
    let found = riccati_map(model, q, r, &cost).ok_or(RegulatorError::IllConditioned)?;
    let tolerance = T::default_epsilon().root() * cost.amax();
    if (found - cost).amax() <= tolerance {
        Ok(Regulator { gain, cost })
    } else {
        Err(RegulatorError::IllConditioned)
    }
}

/// Solution of the Riccati equation: the fixed point of the doubling
/// recursion.
fn doubling<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, M, M>,
) -> Result<SMatrix<T, N, N>, RegulatorError> {
    let identity = SMatrix::<T, N, N>::identity();
    let weighted = solve(*r, model.g.transpose()).ok_or(RegulatorError::InputWeight)?;
    let mut a = model.f;
    let mut g = symmetric_part(&(model.g * weighted));
    let mut h = *q;
    for _ in 0..60 {
        let w = identity + g * h;
        let solved_a = solve(w, a).ok_or(RegulatorError::IllConditioned)?;
        let solved_g = solve(w, g).ok_or(RegulatorError::IllConditioned)?;
        let step = symmetric_part(&(a.transpose() * h * solved_a));
        g = symmetric_part(&(g + a * solved_g * a.transpose()));
        h += step;
        a *= solved_a;
        if !(is_finite(&h) && is_finite(&g) && is_finite(&a)) {
            return Err(RegulatorError::NotStabilisable);
        }
        if step.amax() <= h.amax() * T::default_epsilon() {
            return Ok(h);
        }
    }
    Err(RegulatorError::NotStabilisable)
}

/// K = (R + G' S G)^-1 G' S F.
fn gain_of<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    r: &SMatrix<T, M, M>,
    cost: &SMatrix<T, N, N>,
) -> Option<SMatrix<T, M, N>> {
    let projected = model.g.transpose() * cost;
    solve(r + projected * model.g, projected * model.f)
}

/// F' S F - F' S G K + Q.
fn riccati_map<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, M, M>,
    cost: &SMatrix<T, N, N>,
) -> Option<SMatrix<T, N, N>> {
    let gain = gain_of(model, r, cost)?;
    Some(symmetric_part(
        &(model.f.transpose() * cost * (model.f - model.g * gain) + q),
    ))
}

/// The sum of (F^k)' W F^k over all k, computed by repeated squaring; `None` if
/// F is not stable.
fn lyapunov_cost<T: Scalar, const N: usize>(
    f: &SMatrix<T, N, N>,
    weight: &SMatrix<T, N, N>,
) -> Option<SMatrix<T, N, N>> {
    let mut a = *f;
    let mut sum = symmetric_part(weight);
    for _ in 0..60 {
        let step = symmetric_part(&(a.transpose() * sum * a));
        sum += step;
        a *= a;
        if !is_finite(&sum) {
            return None;
        }
        if step.amax() <= sum.amax() * T::default_epsilon() {
            return Some(sum);
        }
    }
    None
}

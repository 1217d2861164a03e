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
    /// No stabilising gain exists: a mode that does not decay is not controllable.
    NotStabilisable,
    /// The best gain does not stabilise: the state weight does not see a mode on
    /// the unit circle, so leaving it alone costs nothing.
    UnweightedMode,
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
                "no stabilising gain: a mode that does not decay is not controllable"
            }
            Self::UnweightedMode => {
                "the state weight does not see a mode on the unit circle, \
                 so the best gain leaves it alone"
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
/// The result is the stabilising solution: the powers of F - G K fall to zero.
/// It exists if every mode of F that does not decay is controllable, and the state
/// weight sees every mode on the unit circle (Lancaster and Rodman, Algebraic
/// Riccati Equations, 1995, chapter 13). The pair need not be detectable: an
/// unstable mode without weight is stabilised at the least effort, which mirrors
/// its pole into the unit circle. A mode on the unit circle that the weight sees
/// only as weakly as rounding errors do is refused.
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
    let Regulator { gain, cost } = match from_doubling(model, q, r) {
        Ok(regulator) => regulator,
        Err(_) => from_heavier_weight(model, q, r)?,
    };
    let found = riccati_map(model, q, r, &cost).ok_or(RegulatorError::IllConditioned)?;
    let tolerance = T::default_epsilon().root() * cost.amax();
    if (found - cost).amax() <= tolerance {
        Ok(Regulator { gain, cost })
    } else {
        Err(RegulatorError::IllConditioned)
    }
}

/// The solution of the doubling algorithm, refined by two steps of Newton's
/// method; an error if its closed loop does not decay. It finds the smallest
/// semidefinite solution, and that is the stabilising one only if the state
/// weight sees every mode that does not decay by itself.
fn from_doubling<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, M, M>,
) -> Result<Regulator<T, N, M>, RegulatorError> {
    let cost = doubling(model, q, r)?;
    let gain = gain_of(model, r, &cost).ok_or(RegulatorError::IllConditioned)?;
    let mut regulator = Regulator { gain, cost };
    for _ in 0..2 {
        regulator = newton_step(model, q, r, &regulator.gain)?;
    }
    if stabilises(model, r, &regulator) {
        Ok(regulator)
    } else {
        Err(RegulatorError::NotStabilisable)
    }
}

/// The stabilising solution by Newton's method alone. It starts from the
/// regulator for a weight on all states: from any stabilising gain the costs
/// fall towards the largest solution, which is the stabilising one (Hewer 1971).
///
/// Where that does not exist, each step halves the product of the distances of the
/// closed loop's poles to the unit circle. One pole cannot be told from the circle
/// after some 45 steps. With a chain of integrators the distances are alike, and the
/// steps end before: a solution that still changes is none. One that has been
/// found changes by rounding errors alone, for the last steps square its error.
fn from_heavier_weight<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, M, M>,
) -> Result<Regulator<T, N, M>, RegulatorError> {
    // A state that an input can move by one unit weighs as much as that input.
    let reach = model.g.amax();
    let weight = if reach > T::zero() {
        r.amax() / (reach * reach)
    } else {
        T::one()
    };
    let heavier = q + SMatrix::<T, N, N>::identity() * weight;
    let cost = doubling(model, &heavier, r)?;
    let gain = gain_of(model, r, &cost).ok_or(RegulatorError::IllConditioned)?;
    // The cost of this gain is finite if it stabilises.
    let mut regulator = newton_step(model, q, r, &gain)?;
    let mut found = false;
    for _ in 0..64 {
        let next = newton_step(model, q, r, &regulator.gain).map_err(|error| match error {
            RegulatorError::NotStabilisable => RegulatorError::UnweightedMode,
            other => other,
        })?;
        let change = (next.cost - regulator.cost).amax();
        regulator = next;
        let size = regulator.cost.amax();
        found = change <= size * T::default_epsilon().root();
        if change <= size * T::default_epsilon() * T::lit(4.0) {
            break;
        }
    }
    if found && stabilises(model, r, &regulator) {
        Ok(regulator)
    } else {
        Err(RegulatorError::UnweightedMode)
    }
}

/// One step of Newton's method for the Riccati equation: the cost of `gain`, and
/// the gain for that cost.
fn newton_step<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, M, M>,
    gain: &SMatrix<T, M, N>,
) -> Result<Regulator<T, N, M>, RegulatorError> {
    let closed = model.f - model.g * gain;
    if !decays(&closed, T::one() / T::default_epsilon()) {
        return Err(RegulatorError::NotStabilisable);
    }
    let weight = q + gain.transpose() * r * gain;
    let cost = lyapunov_cost(&closed, &weight).ok_or(RegulatorError::NotStabilisable)?;
    let gain = gain_of(model, r, &cost).ok_or(RegulatorError::IllConditioned)?;
    Ok(Regulator { gain, cost })
}

/// True if the closed loop of `regulator` decays, and not by rounding alone.
///
/// If the weight does not see a mode on the unit circle, rounding errors of the
/// cost act as a weight on it. They move its pole inwards by the square root of
/// their share of the input weight. A loop that decays no faster than that counts
/// as not stabilised, unless F decays by itself.
fn stabilises<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    r: &SMatrix<T, M, M>,
    regulator: &Regulator<T, N, M>,
) -> bool {
    let exact = T::one() / T::default_epsilon();
    let reach = model.g.abs();
    let touched = reach.transpose() * regulator.cost.abs() * reach;
    let Some(shares) = solve(*r, touched) else {
        return false;
    };
    let rounding = (shares.trace().abs() * T::default_epsilon()).root();
    let most = if rounding * exact > T::one() && !decays(&model.f, exact) {
        T::one() / rounding
    } else {
        exact
    };
    decays(&(model.f - model.g * regulator.gain), most)
}

/// True if the powers of F fall to zero within about `most` steps: a power with a
/// norm below one proves it.
///
/// Rounding moves a pole by some units in the last place. A pole that needs more
/// steps to decay than there are such units in one cannot be told from the unit
/// circle, and counts as not decaying.
fn decays<T: Scalar, const N: usize>(f: &SMatrix<T, N, N>, most: T) -> bool {
    let order = T::lit(N as f64);
    let units = T::one() / (T::default_epsilon() * T::lit(16.0) * order);
    let most = if most < units { most } else { units };
    let mut power = *f;
    let mut steps = T::one();
    while steps < most {
        // The row sums are at most N times the largest entry.
        if power.amax() * order < T::one() {
            return true;
        }
        power *= power;
        if !is_finite(&power) {
            return false;
        }
        steps += steps;
    }
    false
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

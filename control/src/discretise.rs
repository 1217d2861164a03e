//! Zero-order hold: discretises a continuous model (thesis equations 7.5 and
//! 7.6).

use crate::linear::{balance, is_finite};
use crate::model::{Continuous, Discrete};
use crate::scalar::Scalar;
use nalgebra::SMatrix;

/// Why a model cannot be discretised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiscretiseError {
    /// An entry of A or B is NaN or infinite.
    ModelNotFinite,
    /// The period is NaN, infinite, zero or negative.
    Period,
    /// The matrix exponential overflows: the period is far longer than the time
    /// constant of the fastest growing mode.
    Overflow,
}

impl core::fmt::Display for DiscretiseError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::ModelNotFinite => "an entry of A or B is not a finite number",
            Self::Period => "the sampling period is not a positive number",
            Self::Overflow => "the state transition overflows over this period",
        })
    }
}

impl core::error::Error for DiscretiseError {}

/// The exact zero-order hold of `model` over `period` seconds, for any A, B.
///
/// F = exp(A T) and G = (integral of exp(A s) ds from 0 to T) B. The method is
/// scaling and squaring (Van Loan, "Computing integrals involving the matrix
/// exponential", IEEE TAC 23(3), 1978): the period is halved until the Taylor
/// series converges quickly, and the result is doubled as often. A singular A
/// needs no special case. The states have balanced units meanwhile ([`balance`]):
/// units that differ by much would need many doublings, which lose digits.
///
/// # Errors
/// [`DiscretiseError`] if the input is not finite, the period is not positive,
/// or the result overflows.
pub fn zero_order_hold<T: Scalar, const N: usize, const M: usize>(
    model: &Continuous<T, N, M>,
    period: T,
) -> Result<Discrete<T, N, M>, DiscretiseError> {
    if !(is_finite(&model.a) && is_finite(&model.b)) {
        return Err(DiscretiseError::ModelNotFinite);
    }
    if !(period.is_finite() && period > T::zero()) {
        return Err(DiscretiseError::Period);
    }
    let units = balance(&(model.a * period), &SMatrix::<T, N, 1>::zeros());
    let a = SMatrix::<T, N, N>::from_fn(|row, column| {
        model.a[(row, column)] * (units[row] / units[column])
    });
    let mut step = period;
    let mut doublings = 0_u32;
    let size = row_sum_norm(&a);
    while size * step > T::lit(0.5) {
        step *= T::lit(0.5);
        doublings += 1;
        if doublings > 64 {
            return Err(DiscretiseError::Overflow);
        }
    }
    let scaled = a * step;
    let mut f = SMatrix::<T, N, N>::identity();
    let mut integral = SMatrix::<T, N, N>::identity() * step;
    let mut term = SMatrix::<T, N, N>::identity();
    // At a norm of 1/2 or less the 18th term is below 1e-21 of the first.
    for order in 1..=18 {
        term = term * scaled / T::lit(f64::from(order));
        f += term;
        integral += term * (step / T::lit(f64::from(order + 1)));
    }
    for _ in 0..doublings {
        integral += f * integral;
        f = f * f;
    }
    let back = |matrix: SMatrix<T, N, N>| {
        SMatrix::<T, N, N>::from_fn(|row, column| {
            matrix[(row, column)] * (units[column] / units[row])
        })
    };
    let f = back(f);
    let g = back(integral) * model.b;
    if is_finite(&f) && is_finite(&g) {
        Ok(Discrete { f, g })
    } else {
        Err(DiscretiseError::Overflow)
    }
}

fn row_sum_norm<T: Scalar, const N: usize>(matrix: &SMatrix<T, N, N>) -> T {
    let mut largest = T::zero();
    for row in matrix.row_iter() {
        let mut sum = T::zero();
        for entry in row.iter() {
            sum += entry.abs();
        }
        if sum > largest {
            largest = sum;
        }
    }
    largest
}

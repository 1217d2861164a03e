//! Linear algebra that nalgebra does not provide for matrices of any static
//! size.

use crate::scalar::Scalar;
use nalgebra::SMatrix;

/// Solves `a` X = `b` by Gaussian elimination with partial pivoting on rows
/// scaled to unit size (Golub and Van Loan, Matrix Computations, 3.4).
///
/// `a` is N x N, `b` N x M. Returns `None` if `a` is singular to working
/// precision: a pivot falls below N times the rounding unit.
#[must_use]
pub fn solve<T: Scalar, const N: usize, const M: usize>(
    mut a: SMatrix<T, N, N>,
    mut b: SMatrix<T, N, M>,
) -> Option<SMatrix<T, N, M>> {
    let smallest = T::default_epsilon() * T::lit(N as f64);
    for row in 0..N {
        let size = a.row(row).amax();
        if !(size > T::zero() && size.is_finite()) {
            return None;
        }
        for column in 0..N {
            a[(row, column)] /= size;
        }
        for column in 0..M {
            b[(row, column)] /= size;
        }
    }
    for column in 0..N {
        let mut best = column;
        for row in column + 1..N {
            if a[(row, column)].abs() > a[(best, column)].abs() {
                best = row;
            }
        }
        let pivot = a[(best, column)];
        if !(pivot.abs() > smallest) {
            return None;
        }
        if best != column {
            a.swap_rows(best, column);
            b.swap_rows(best, column);
        }
        for row in column + 1..N {
            let factor = a[(row, column)] / pivot;
            for k in column..N {
                let step = factor * a[(column, k)];
                a[(row, k)] -= step;
            }
            for k in 0..M {
                let step = factor * b[(column, k)];
                b[(row, k)] -= step;
            }
        }
    }
    for column in (0..N).rev() {
        for k in 0..M {
            let mut sum = b[(column, k)];
            for j in column + 1..N {
                sum -= a[(column, j)] * b[(j, k)];
            }
            b[(column, k)] = sum / a[(column, column)];
        }
    }
    Some(b)
}

/// True if every entry of `matrix` is a finite number.
#[must_use]
pub fn is_finite<T: Scalar, const N: usize, const M: usize>(matrix: &SMatrix<T, N, M>) -> bool {
    matrix.iter().all(|entry| entry.is_finite())
}

/// True if `matrix` is symmetric to a relative tolerance of 1000 rounding
/// units.
#[must_use]
pub fn is_symmetric<T: Scalar, const N: usize>(matrix: &SMatrix<T, N, N>) -> bool {
    let tolerance = matrix.amax() * T::default_epsilon() * T::lit(1000.0);
    (matrix - matrix.transpose()).amax() <= tolerance
}

/// The symmetric part of `matrix`.
#[must_use]
pub fn symmetric_part<T: Scalar, const N: usize>(matrix: &SMatrix<T, N, N>) -> SMatrix<T, N, N> {
    (matrix + matrix.transpose()) * T::lit(0.5)
}

/// True if a symmetric `matrix` is positive definite (`strict`) or positive
/// semidefinite (otherwise), decided by an LDL^T elimination that tolerates
/// rounding.
///
/// The units of the rows do not matter to `strict`: what the elimination leaves of
/// a diagonal entry is compared with that entry, because no rounding error is
/// larger than its share of it.
#[must_use]
pub fn is_positive<T: Scalar, const N: usize>(matrix: &SMatrix<T, N, N>, strict: bool) -> bool {
    let mut a = *matrix;
    let share = T::default_epsilon() * T::lit(100.0 * N as f64);
    let tolerance = matrix.amax() * share;
    for k in 0..N {
        let pivot = a[(k, k)];
        if strict {
            if !(pivot > T::zero() && pivot > matrix[(k, k)] * share) {
                return false;
            }
        } else if !(pivot >= -tolerance) {
            return false;
        } else if pivot <= tolerance {
            // In a semidefinite matrix the row of a zero diagonal entry is zero.
            let root = (tolerance * matrix.amax()).root();
            for j in k + 1..N {
                if a[(k, j)].abs() > root {
                    return false;
                }
            }
            continue;
        }
        for i in k + 1..N {
            let factor = a[(i, k)] / pivot;
            for j in k..N {
                let step = factor * a[(k, j)];
                a[(i, j)] -= step;
            }
        }
    }
    true
}

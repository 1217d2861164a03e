//! Linear algebra that nalgebra does not provide for matrices of any static
//! size.

use crate::scalar::Scalar;
use nalgebra::{SMatrix, SVector};

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

/// Units of the states in which rows and columns of `a` (N x N) have sums of a like
/// size.
///
/// Returns the factors d, powers of two, so that a change of units is exact: the
/// entries become d_i a_ij / d_j and d_i b_ik. They make the sum of all entries
/// small, by one unit after the other (E. E. Osborne, On pre-conditioning of
/// matrices, J. ACM 7, 1960). The inputs, the columns of `b` (N x M), have units
/// too. The sum goes on over 1/d_i for a state that moves no other, d_i for one that
/// nothing moves, and one over the unit of each input: without those terms their
/// units would have no bound.
///
/// An entry within 16 rounding units of the largest in its row or column of `a`, or
/// in its column of `b`, counts as zero: else the units would lift rounding errors to
/// the size of entries. So units may differ by about 2^40 in double and 2^16 in single
/// precision.
#[must_use]
pub fn balance<T: Scalar, const N: usize, const M: usize>(
    a: &SMatrix<T, N, N>,
    b: &SMatrix<T, N, M>,
) -> SVector<T, N> {
    let rounding = T::default_epsilon() * T::lit(16.0);
    let entry = |value: T, largest: T| {
        if value.abs() > largest * rounding {
            value
        } else {
            T::zero()
        }
    };
    let (rows, columns) = (
        SVector::<T, N>::from_fn(|row, _| a.row(row).amax()),
        SVector::<T, N>::from_fn(|column, _| a.column(column).amax()),
    );
    let a = SMatrix::<T, N, N>::from_fn(|row, column| {
        entry(entry(a[(row, column)], rows[row]), columns[column])
    });
    let b = SMatrix::<T, N, M>::from_fn(|state, input| {
        entry(b[(state, input)], b.column(input).amax())
    });
    let mut units = SVector::<T, N>::repeat(T::one());
    for _ in 0..SWEEPS {
        let mut settled = true;
        let or_one = |sum: T| if sum > T::zero() { sum } else { T::one() };
        let shares = SVector::<T, M>::from_fn(|input, _| {
            let column = units.component_mul(&b.column(input).abs()).sum();
            T::one() / or_one(column).root()
        });
        for state in 0..N {
            let mut row = T::zero();
            let mut column = T::zero();
            for other in (0..N).filter(|&other| other != state) {
                row += a[(state, other)].abs() / units[other];
                column += a[(other, state)].abs() * units[other];
            }
            for input in 0..M {
                row += b[(state, input)].abs() * shares[input];
            }
            if !(row > T::zero() || column > T::zero()) {
                continue;
            }
            let best = (or_one(column) / or_one(row)).root();
            let unit = power_of_two(best, units[state]);
            if unit != units[state] {
                units[state] = unit;
                settled = false;
            }
        }
        if settled {
            break;
        }
    }
    units
}

/// Most sweeps of [`balance`]. A chain of N states takes some N^2 of them.
const SWEEPS: usize = 200;

/// The power of two nearest to `value`, reached from the power `from`; `from` where
/// that is within a factor of two, so that rounding has no play.
fn power_of_two<T: Scalar>(value: T, from: T) -> T {
    let two = T::lit(2.0);
    let half = T::lit(0.5);
    let mut power = from;
    // Beyond this the square of a unit has no place in single precision.
    for _ in 0..60 {
        if value >= power * two {
            power *= two;
        } else if value <= power * half {
            power *= half;
        } else {
            break;
        }
    }
    power
}

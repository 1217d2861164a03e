//! Analysis of linear systems: controllability, observability, poles, and
//! simulated responses (thesis 7.2.2).

use crate::linear::{balance, is_finite};
use crate::model::Discrete;
use crate::scalar::Scalar;
use nalgebra::allocator::Allocator;
use nalgebra::{Const, DefaultAllocator, DimDiff, DimSub, SMatrix, SVector, U1};

/// Dimension of the controllable subspace: the rank of [B, AB, ..., A^(N-1) B]
/// for an N x N `a` and an N x M `b`. The system is controllable if the rank
/// is N.
///
/// The subspace is built from orthogonal directions (Arnoldi iteration). The
/// powers of A would not do: their columns become nearly parallel even for
/// small N. A direction counts as new if its component orthogonal to the
/// subspace exceeds 10^-9 (f64) or 10^-3 (f32) of its length. Lengths are those in
/// balanced units ([`balance`]), so that the units of `a` and `b` do not matter.
#[must_use]
pub fn controllability_rank<T: Scalar, const N: usize, const M: usize>(
    a: &SMatrix<T, N, N>,
    b: &SMatrix<T, N, M>,
) -> usize {
    let tolerance = if T::default_epsilon() < T::lit(1e-10) {
        T::lit(1e-9)
    } else {
        T::lit(1e-3)
    };
    let units = balance(a, b);
    let a =
        &SMatrix::<T, N, N>::from_fn(|row, column| a[(row, column)] * (units[row] / units[column]));
    let mut basis = SMatrix::<T, N, N>::zeros();
    let mut rank = 0;
    let add = |basis: &mut SMatrix<T, N, N>, rank: &mut usize, direction: SVector<T, N>| {
        let length = direction.norm();
        if !(length > T::zero()) || *rank >= N {
            return;
        }
        let mut rest = direction / length;
        // Orthogonalising twice is enough (Kahan, in Parlett, The Symmetric
        // Eigenvalue Problem).
        for _ in 0..2 {
            for known in basis.column_iter().take(*rank) {
                let share = known.dot(&rest);
                rest -= known * share;
            }
        }
        let norm = rest.norm();
        if norm > tolerance {
            basis.set_column(*rank, &(rest / norm));
            *rank += 1;
        }
    };
    for column in b.column_iter() {
        add(&mut basis, &mut rank, column.component_mul(&units));
    }
    let mut done = 0;
    while done < rank {
        let next = a * basis.column(done);
        // An image that is zero except for rounding adds no direction.
        if next.norm() > a.norm() * T::default_epsilon() * T::lit(100.0) {
            add(&mut basis, &mut rank, next);
        }
        done += 1;
    }
    rank
}

/// Dimension of the observable subspace: the rank of [C; CA; ...; CA^(N-1)]
/// for an N x N `a` and a P x N `c`. The system is observable if the rank is
/// N.
#[must_use]
pub fn observability_rank<T: Scalar, const N: usize, const P: usize>(
    a: &SMatrix<T, N, N>,
    c: &SMatrix<T, P, N>,
) -> usize {
    controllability_rank(&a.transpose(), &c.transpose())
}

/// A pole in the complex plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pole<T> {
    /// Real part.
    pub re: T,
    /// Imaginary part.
    pub im: T,
}

impl<T: Scalar> Pole<T> {
    /// Distance from the origin. A mode of a discrete system decays if it is
    /// below one.
    #[must_use]
    pub fn magnitude(&self) -> T {
        (self.re * self.re + self.im * self.im).root()
    }
}

/// Why poles could not be found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolesError {
    /// An entry of the matrix is NaN or infinite.
    NotFinite,
    /// The QR iteration did not converge.
    NotConverged,
}

impl core::fmt::Display for PolesError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "an entry of the matrix is not a finite number",
            Self::NotConverged => "the search for the poles did not converge",
        })
    }
}

impl core::error::Error for PolesError {}

/// The poles of a system: the eigenvalues of its N x N system or transition
/// matrix `a`, in no particular order.
///
/// # Errors
/// [`PolesError`] when `a` is not finite or the iteration does not converge.
pub fn poles<T: Scalar, const N: usize>(a: &SMatrix<T, N, N>) -> Result<[Pole<T>; N], PolesError>
where
    Const<N>: DimSub<U1>,
    DefaultAllocator: Allocator<Const<N>, DimDiff<Const<N>, U1>> + Allocator<DimDiff<Const<N>, U1>>,
{
    if !is_finite(a) {
        return Err(PolesError::NotFinite);
    }
    let schur = a
        .try_schur(T::default_epsilon(), 1000 * N)
        .ok_or(PolesError::NotConverged)?;
    let mut found = [Pole {
        re: T::zero(),
        im: T::zero(),
    }; N];
    for (pole, value) in found.iter_mut().zip(schur.complex_eigenvalues().iter()) {
        *pole = Pole {
            re: value.re,
            im: value.im,
        };
    }
    Ok(found)
}

/// Simulates `model` from the state `start`. Returns an endless iterator over
/// the states x, F x + G u, ...; `input` gives u from the step number and the
/// state.
pub fn simulate<'a, T: Scalar, const N: usize, const M: usize>(
    model: &'a Discrete<T, N, M>,
    start: SVector<T, N>,
    mut input: impl FnMut(usize, &SVector<T, N>) -> SVector<T, M> + 'a,
) -> impl Iterator<Item = SVector<T, N>> + 'a {
    let mut state = start;
    (0..).map(move |step| {
        let now = state;
        state = model.f * now + model.g * input(step, &now);
        now
    })
}

/// Response of `model`, initially at rest, to a unit step on input number
/// `input` (from zero; a number of M or more leaves all inputs zero). Returns
/// an endless iterator over the states.
pub fn step_response<T: Scalar, const N: usize, const M: usize>(
    model: &Discrete<T, N, M>,
    input: usize,
) -> impl Iterator<Item = SVector<T, N>> + '_ {
    let mut one = SVector::<T, M>::zeros();
    if let Some(entry) = one.get_mut(input) {
        *entry = T::one();
    }
    simulate(model, SVector::zeros(), move |_, _| one)
}

//! Properties of the linear algebra.

use control::linear::is_positive;
use nalgebra::SMatrix;
use proptest::prelude::*;

/// L diag(1, 1, `last`) L', with each row and column in a unit of its own.
fn scaled(entries: &[f32], diagonal: &[f32], last: f32, units: &[i32]) -> SMatrix<f32, 3, 3> {
    let mut lower = SMatrix::<f32, 3, 3>::zeros();
    let mut below = entries.iter();
    for row in 0..3 {
        for column in 0..row {
            lower[(row, column)] = *below.next().unwrap();
        }
        lower[(row, row)] = diagonal[row];
    }
    let weights = SMatrix::<f32, 3, 3>::from_diagonal(&[1.0, 1.0, last].into());
    let matrix = lower * weights * lower.transpose();
    SMatrix::from_fn(|row, column| {
        let (row, column) = (row.min(column), row.max(column));
        matrix[(row, column)] * 2.0_f32.powi(units[row] + units[column])
    })
}

proptest! {
    /// Whether a matrix is positive definite does not depend on the units.
    #[test]
    fn units_do_not_decide_whether_a_matrix_is_positive(
        entries in proptest::collection::vec(-1.0_f32..1.0, 3),
        diagonal in proptest::collection::vec(0.3_f32..1.0, 3),
        last in 0.1_f32..1.0,
        units in proptest::collection::vec(-20..20, 3),
    ) {
        prop_assert!(is_positive(&scaled(&entries, &diagonal, last, &units), true));
        prop_assert!(!is_positive(&scaled(&entries, &diagonal, -last, &units), true));
    }
}

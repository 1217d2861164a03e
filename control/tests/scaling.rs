//! The units of the states do not change ranks and discretised models.

use control::analysis::{controllability_rank, observability_rank};
use control::discretise::zero_order_hold;
use control::model::Continuous;
use nalgebra::{SMatrix, SVector};

const N: usize = 5;
const SYSTEMS: usize = 200;

/// Small whole numbers (Knuth's linear congruential generator).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, from: i32, to: i32) -> i32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let span = (to - from + 1) as u64;
        from + ((self.0 >> 33) % span) as i32
    }

    fn matrix(&mut self) -> SMatrix<f64, N, N> {
        SMatrix::from_fn(|_, _| f64::from(self.next(-8, 8)) / 8.0)
    }

    /// A matrix with whole entries and determinant one, and its inverse.
    fn basis(&mut self) -> (SMatrix<f64, N, N>, SMatrix<f64, N, N>) {
        let mut lower = SMatrix::<f64, N, N>::identity();
        let mut upper = SMatrix::<f64, N, N>::identity();
        for row in 0..N {
            for column in 0..row {
                lower[(row, column)] = f64::from(self.next(-1, 1));
                upper[(column, row)] = f64::from(self.next(-1, 1));
            }
        }
        let there = lower * upper;
        let back: SMatrix<f64, N, N> = there.try_inverse().unwrap().map(f64::round);
        assert_eq!(there * back, SMatrix::<f64, N, N>::identity());
        (there, back)
    }
}

/// A system, and the same one with each state in a unit of its own: a power of two,
/// so that both are exact.
struct Pair {
    plain: Continuous<f64, N, 1>,
    scaled: Continuous<f64, N, 1>,
    units: SVector<f64, N>,
    /// Dimension of the controllable subspace.
    rank: usize,
}

fn pairs() -> Vec<Pair> {
    let mut numbers = Numbers(5);
    let mut pairs = Vec::new();
    while pairs.len() < SYSTEMS {
        // The first states are controllable. The others move them, but not the
        // other way round, and have no input.
        let rank = 1 + pairs.len() % N;
        let mut a = numbers.matrix();
        let mut b = SVector::<f64, N>::from_fn(|_, _| f64::from(numbers.next(-8, 8)) / 8.0);
        for row in rank..N {
            b[row] = 0.0;
            for column in 0..rank {
                a[(row, column)] = 0.0;
            }
        }
        // In every second system no state is known to be one of them.
        if pairs.len() % 2 == 0 {
            let (there, back) = numbers.basis();
            a = there * a * back;
            b = there * b;
        }
        if controllability_rank(&a, &b) != rank {
            continue;
        }
        let units = SVector::<f64, N>::from_fn(|_, _| 2.0_f64.powi(numbers.next(-20, 20)));
        pairs.push(Pair {
            plain: Continuous { a, b },
            scaled: Continuous {
                a: SMatrix::from_fn(|row, column| a[(row, column)] * units[row] / units[column]),
                b: b.component_mul(&units),
            },
            units,
            rank,
        });
    }
    pairs
}

#[test]
fn units_do_not_change_ranks() {
    let pairs = pairs();
    let wrong = |pair: &&Pair| {
        let Continuous { a, b } = pair.scaled;
        controllability_rank(&a, &b) != pair.rank
            || observability_rank(&a.transpose(), &b.transpose()) != pair.rank
    };
    assert_eq!(pairs.iter().filter(wrong).count(), 0, "of {SYSTEMS}");
}

/// Rounding errors where a system without a basis of its own has zeros.
#[test]
fn rounding_errors_are_no_entries() {
    let mut numbers = Numbers(7);
    let mut noise = |value: f64| {
        let error = f64::from(numbers.next(-8, 8)) * 1e-17;
        if value == 0.0 { error } else { value }
    };
    let mut wrong = 0;
    for pair in pairs().iter().skip(1).step_by(2) {
        let Continuous { a, b } = pair.plain;
        let a = a.map(&mut noise);
        if controllability_rank(&a, &b) != pair.rank {
            wrong += 1;
        }
    }
    assert_eq!(wrong, 0, "of {}", SYSTEMS / 2);
}

#[test]
fn units_do_not_change_discretised_models() {
    let mut wrong = 0;
    for pair in pairs() {
        let plain = zero_order_hold(&pair.plain, 0.1).unwrap();
        let scaled = zero_order_hold(&pair.scaled, 0.1).unwrap();
        let units = &pair.units;
        let f = SMatrix::<f64, N, N>::from_fn(|row, column| {
            scaled.f[(row, column)] / units[row] * units[column]
        });
        let g = scaled.g.component_div(units);
        if !((f - plain.f).amax() <= 1e-13 && (g - plain.g).amax() <= 1e-13) {
            wrong += 1;
        }
    }
    assert_eq!(wrong, 0, "of {SYSTEMS}");
}

//! Compares the design functions with python-control on random systems, stable
//! and unstable, of order one to six. `fixtures/generate.py` writes the expected
//! results.

use control::analysis::{controllability_rank, observability_rank, poles};
use control::discretise::zero_order_hold;
use control::kalman::steady_state;
use control::lqr::dlqr;
use control::model::{Continuous, Discrete};
use nalgebra::{SMatrix, SVector};
use serde::Deserialize;

#[derive(Deserialize)]
struct System {
    order: usize,
    inputs: usize,
    a: Vec<f64>,
    b: Vec<f64>,
    f: Vec<f64>,
    g: Vec<f64>,
    q: Vec<f64>,
    r: Vec<f64>,
    gain: Vec<f64>,
    held_f: Vec<f64>,
    held_g: Vec<f64>,
    predicted: Vec<f64>,
    poles: Vec<f64>,
}

fn systems() -> Vec<System> {
    serde_json::from_str(include_str!("fixtures/random_systems.json")).unwrap()
}

/// Largest difference, relative to the largest entry.
fn difference<const N: usize, const M: usize>(found: &SMatrix<f64, N, M>, known: &[f64]) -> f64 {
    let known = SMatrix::<f64, N, M>::from_row_slice(known);
    (found - known).amax() / known.amax()
}

/// Checks one system. Returns the largest relative differences of gain,
/// transition matrix, input matrix, covariance and pole magnitudes.
fn check<const N: usize, const M: usize>(system: &System) -> [f64; 5]
where
    nalgebra::Const<N>: nalgebra::DimSub<nalgebra::U1>,
    nalgebra::DefaultAllocator: nalgebra::allocator::Allocator<
            nalgebra::Const<N>,
            nalgebra::DimDiff<nalgebra::Const<N>, nalgebra::U1>,
        > + nalgebra::allocator::Allocator<nalgebra::DimDiff<nalgebra::Const<N>, nalgebra::U1>>,
{
    let f = SMatrix::<f64, N, N>::from_row_slice(&system.f);
    let g = SMatrix::<f64, N, M>::from_row_slice(&system.g);
    let q = SMatrix::<f64, N, N>::from_diagonal(&SVector::from_row_slice(&system.q));
    let r = SMatrix::<f64, M, M>::from_diagonal(&SVector::from_row_slice(&system.r));
    let regulator = dlqr(&Discrete { f, g }, &q, &r).unwrap();

    let held = zero_order_hold(
        &Continuous {
            a: SMatrix::<f64, N, N>::from_row_slice(&system.a),
            b: SMatrix::<f64, N, M>::from_row_slice(&system.b),
        },
        0.1,
    )
    .unwrap();

    let filter = steady_state(&f, &g.transpose(), &q, &r).unwrap_or_else(|error| {
        panic!("order {N}: {error}");
    });
    let mut magnitudes = poles(&f).unwrap().map(|pole| pole.magnitude());
    magnitudes.sort_by(f64::total_cmp);

    assert_eq!(controllability_rank(&f, &g), N);
    assert_eq!(observability_rank(&f.transpose(), &g.transpose()), N);
    let closed = poles(&(f - g * regulator.gain)).unwrap();
    assert!(closed.iter().all(|pole| pole.magnitude() < 1.0));

    [
        difference(&regulator.gain, &system.gain),
        difference(&held.f, &system.held_f),
        difference(&held.g, &system.held_g),
        difference(&filter.predicted.diagonal(), &system.predicted),
        difference(&SVector::<f64, N>::from(magnitudes), &system.poles),
    ]
}

#[test]
fn random_systems_agree_to_eight_digits() {
    let systems = systems();
    assert!(systems.len() >= 200);
    assert!(
        systems
            .iter()
            .any(|system| system.poles.last() > Some(&1.2))
    );
    let mut worst = [0.0_f64; 5];
    for (number, system) in systems.iter().enumerate() {
        let found = match (system.order, system.inputs) {
            (1, 1) => check::<1, 1>(system),
            (2, 1) => check::<2, 1>(system),
            (3, 1) => check::<3, 1>(system),
            (4, 1) => check::<4, 1>(system),
            (5, 1) => check::<5, 1>(system),
            (6, 1) => check::<6, 1>(system),
            (1, 2) => check::<1, 2>(system),
            (2, 2) => check::<2, 2>(system),
            (3, 2) => check::<3, 2>(system),
            (4, 2) => check::<4, 2>(system),
            (5, 2) => check::<5, 2>(system),
            (6, 2) => check::<6, 2>(system),
            other => panic!("system {number} has order and inputs {other:?}"),
        };
        for (worst, found) in worst.iter_mut().zip(found) {
            assert!(found < 1e-8, "system {number}: {found:e} in {worst:?}");
            *worst = worst.max(found);
        }
    }
    println!("largest relative differences: {worst:?}");
}

/// Gain in single precision, against python-control's in double precision,
/// relative to the largest entry.
fn single_precision<const N: usize, const M: usize>(system: &System) -> f64 {
    let f = SMatrix::<f64, N, N>::from_row_slice(&system.f);
    let g = SMatrix::<f64, N, M>::from_row_slice(&system.g);
    let q = SVector::<f64, N>::from_row_slice(&system.q);
    let r = SVector::<f64, M>::from_row_slice(&system.r);
    let model = Discrete {
        f: f.cast::<f32>(),
        g: g.cast::<f32>(),
    };
    let regulator = dlqr(
        &model,
        &SMatrix::from_diagonal(&q.cast()),
        &SMatrix::from_diagonal(&r.cast()),
    )
    .unwrap();
    difference(&regulator.gain.cast::<f64>(), &system.gain)
}

#[test]
fn single_precision_agrees_to_three_digits() {
    for (number, system) in systems().iter().enumerate() {
        let found = match (system.order, system.inputs) {
            (1, 1) => single_precision::<1, 1>(system),
            (2, 1) => single_precision::<2, 1>(system),
            (3, 1) => single_precision::<3, 1>(system),
            (4, 1) => single_precision::<4, 1>(system),
            (1, 2) => single_precision::<1, 2>(system),
            (2, 2) => single_precision::<2, 2>(system),
            (3, 2) => single_precision::<3, 2>(system),
            (4, 2) => single_precision::<4, 2>(system),
            _ => continue,
        };
        assert!(found < 1e-3, "system {number}: {found:e}");
    }
}

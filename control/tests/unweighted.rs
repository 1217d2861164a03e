//! Regulators and filters whose state weight, or process noise, is zero in some
//! mode. `fixtures/generate_unweighted.py` writes the expected gains.

use control::kalman::{Kalman, KalmanError, steady_state, with_biases};
use control::lqr::{RegulatorError, dlqr};
use control::model::{Discrete, Geometry};
use nalgebra::{Matrix1, SMatrix, SVector};
use serde::Deserialize;

#[derive(Deserialize)]
struct System {
    order: usize,
    f: Vec<f64>,
    g: Vec<f64>,
    q: Vec<f64>,
    r: f64,
    gain: Option<Vec<f64>>,
}

fn systems() -> Vec<System> {
    serde_json::from_str(include_str!("fixtures/unweighted_systems.json")).unwrap()
}

/// Relative difference of the gain from python-control's. An unseen mode on the
/// unit circle must be refused.
fn check<const N: usize>(system: &System) -> Result<f64, String> {
    let model = Discrete {
        f: SMatrix::<f64, N, N>::from_row_slice(&system.f),
        g: SMatrix::<f64, N, 1>::from_row_slice(&system.g),
    };
    let q = SMatrix::<f64, N, N>::from_row_slice(&system.q);
    let found = dlqr(&model, &q, &Matrix1::new(system.r));
    match (&system.gain, found) {
        (None, Err(RegulatorError::UnweightedMode)) => Ok(0.0),
        (Some(known), Ok(found)) => {
            let known = SMatrix::<f64, 1, N>::from_row_slice(known);
            Ok((found.gain - known).amax() / known.amax())
        }
        (known, found) => Err(format!("{found:?} is not {known:?}")),
    }
}

#[test]
fn unweighted_modes_are_stabilised_or_refused() {
    let mut wrong = [0; 2];
    let systems = systems();
    for (number, system) in systems.iter().enumerate() {
        let found = match system.order {
            1 => check::<1>(system),
            2 => check::<2>(system),
            3 => check::<3>(system),
            4 => check::<4>(system),
            other => panic!("order {other}"),
        };
        if !found.as_ref().is_ok_and(|&difference| difference < 1e-9) {
            println!("system {number}: {found:?}");
            wrong[usize::from(system.gain.is_some())] += 1;
        }
    }
    assert_eq!(systems.len(), 40);
    assert_eq!(wrong, [0, 0], "of 20 on the unit circle and 20 unstable");
}

/// Chains of integrators without a weight: nothing is to be gained by moving them. The steps of Newton's method
/// approach that by a factor of 0.7 or 0.8 each, for they halve the product of all distances to the unit circle.
#[test]
fn unweighted_chains_are_refused() {
    let geometry = Geometry {
        l1: 0.255,
        l2: 0.845,
    };
    for speed in [0.3_f64, 1.0, 3.0] {
        let model = geometry.steering_model_sampled(speed, 0.1);
        for weight in [0.0, 5e-324, 1e-300, 1e-60] {
            let q = SMatrix::<f64, 3, 3>::identity() * weight;
            let found = dlqr(&model, &q, &Matrix1::new(1.0));
            let refused = Err(RegulatorError::UnweightedMode);
            assert_eq!(found, refused, "{weight} at {speed} m/s");
        }
        // A weight that a regulator can be designed for, if a slow one: by the low-frequency asymptote the gain of
        // the cross-track error is the root of its weight.
        let q = SMatrix::<f64, 3, 3>::identity() * 1e-20;
        let found = dlqr(&model, &q, &Matrix1::new(1.0)).unwrap();
        assert!((found.gain[0] / 1e-10 - 1.0).abs() < 1e-3, "{found:?}");
    }
    let double = Discrete {
        f: SMatrix::<f64, 2, 2>::new(1.0, 0.1, 0.0, 1.0),
        g: SMatrix::<f64, 2, 1>::new(0.005, 0.1),
    };
    let nothing = SMatrix::<f64, 2, 2>::zeros();
    let found = dlqr(&double, &nothing, &Matrix1::new(1.0));
    assert_eq!(found, Err(RegulatorError::UnweightedMode));
    // The dual: a place whose velocity is constant, measured without process noise.
    let h = double.g.transpose();
    let found = steady_state(&double.f.transpose(), &h, &nothing, &Matrix1::new(1.0));
    assert_eq!(found, Err(KalmanError::NoiseFreeMode));
}

/// F = 2, G = 1, Q = 0, R = 1: the stabilising solution of S = 4 S - 4 S^2 / (1 + S)
/// is 3, not 0.
#[test]
fn an_unweighted_unstable_mode_is_mirrored() {
    let one = Matrix1::new(1.0_f64);
    let model = Discrete {
        f: one * 2.0,
        g: one,
    };
    let found = dlqr(&model, &(one * 0.0), &one).unwrap();
    assert!((found.gain[0] - 1.5).abs() < 1e-12, "{found:?}");
    assert!((found.cost[0] - 3.0).abs() < 1e-12, "{found:?}");
}

/// Biases without process noise have no steady gain. The error says so, and does not
/// blame the measurements, which observe them.
#[test]
fn constant_biases_are_named() {
    let geometry = Geometry { l1: 0.3, l2: 0.8 };
    let (model, h) = with_biases(&geometry.steering_model(1.0_f64));
    let sampled = control::discretise::zero_order_hold(&model, 0.1).unwrap();
    let r = SMatrix::<f64, 3, 3>::from_diagonal(&SVector::<f64, 3>::new(1e-4, 1e-3, 1e-5));
    let with = |heading: f64, steering: f64| {
        let noise = SVector::<f64, 5>::new(1e-6, 1e-6, 1e-5, heading, steering);
        steady_state(&sampled.f, &h, &SMatrix::from_diagonal(&noise), &r)
    };
    assert_eq!(with(0.0, 1e-8), Err(KalmanError::NoiseFreeMode));
    assert_eq!(with(1e-8, 0.0), Err(KalmanError::NoiseFreeMode));
    assert_eq!(with(0.0, 0.0), Err(KalmanError::NoiseFreeMode));
    let filter = with(1e-12, 1e-12).unwrap();
    assert!(filter.gain[(3, 1)] > 0.0 && filter.gain[(4, 2)] > 0.0);
}

/// A constant measured k times with unit noise, from no knowledge: the variance is 1 / k
/// (up to the initial one), so that the steady gain is zero.
#[test]
fn the_gain_of_a_constant_falls_as_one_over_k() {
    let one = Matrix1::new(1.0_f64);
    let nothing = one * 0.0;
    assert_eq!(
        steady_state(&one, &one, &nothing, &one),
        Err(KalmanError::NoiseFreeMode)
    );
    let mut filter = Kalman {
        state: SVector::<f64, 1>::zeros(),
        covariance: one * 1e9,
    };
    for _ in 0..1000 {
        filter.correct(&one, &one, &one).unwrap();
    }
    assert!((filter.covariance[0] - 1e-3).abs() < 1e-11);
}

/// An unstable mode without noise is tracked: for F = 2, H = 1, R = 1 the predicted
/// variance is 3, the dual of the regulator above.
#[test]
fn an_unstable_mode_needs_no_noise() {
    let one = Matrix1::new(1.0_f64);
    let filter = steady_state(&(one * 2.0), &one, &(one * 0.0), &one).unwrap();
    assert!((filter.predicted[0] - 3.0).abs() < 1e-12);
    assert!((filter.gain[0] - 0.75).abs() < 1e-12);
}

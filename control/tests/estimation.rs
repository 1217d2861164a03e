//! Kalman filters, the model with biases, and special cases of the estimator.

#[path = "common/example.rs"]
mod example;

use control::analysis::{controllability_rank, observability_rank, poles, simulate, step_response};
use control::design::with_integral;
use control::discretise::zero_order_hold;
use control::estimator::{Estimator, EstimatorError, EstimatorSettings, Observation, Update};
use control::kalman::{Kalman, KalmanError, steady_state, with_biases};
use control::model::Discrete;
use control::position::{Position, Velocity};
use nalgebra::{Matrix1, SMatrix, SVector};

/// Thesis 7.2.4 and Figure 7.11: the model is controllable, and the biases are
/// observable only while the vehicle moves.
#[test]
fn ranks_of_the_steering_models() {
    for speed in [0.25, 1.0, 2.0] {
        let model = example::VEHICLE.geometry.steering_model(speed);
        assert_eq!(controllability_rank(&model.a, &model.b), 3);
        let (augmented, shows) = with_biases(&model);
        assert_eq!(observability_rank(&augmented.a, &shows), 5);
        assert_eq!(controllability_rank(&augmented.a, &augmented.b), 3);
        // The integral of Figure 7.12 is not observable from the other states.
        let integral = with_integral(&model);
        assert_eq!(controllability_rank(&integral.a, &integral.b), 4);
        let mut rest = SMatrix::<f64, 3, 4>::zeros();
        rest.fixed_view_mut::<3, 3>(0, 1).fill_with_identity();
        assert_eq!(observability_rank(&integral.a, &rest), 3);
    }
    let standing = example::VEHICLE.geometry.steering_model(0.0);
    assert_eq!(controllability_rank(&standing.a, &standing.b), 1);
    let (augmented, shows) = with_biases(&standing);
    assert_eq!(observability_rank(&augmented.a, &shows), 3);
}

/// A random walk measured with noise has a known gain: for q = r, the inverse of
/// the golden ratio.
#[test]
fn steady_gain_of_a_random_walk() {
    let one = Matrix1::new(1.0_f64);
    let filter = steady_state(&one, &one, &one, &one).unwrap();
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    assert!((filter.gain[0] - golden).abs() < 1e-12);
    assert!((filter.corrected[0] - golden).abs() < 1e-12);
}

/// The time-varying filter of the five-state model converges to the steady-state
/// filter, and its estimate to the biases.
#[test]
fn time_varying_filter_converges_to_the_steady_one() {
    let (model, h) = with_biases(&example::VEHICLE.geometry.steering_model(1.0));
    let sampled = zero_order_hold(&model, 0.1).unwrap();
    let q =
        SMatrix::<f64, 5, 5>::from_diagonal(&SVector::<f64, 5>::new(1e-6, 1e-6, 1e-5, 1e-8, 1e-8));
    let r = SMatrix::<f64, 3, 3>::from_diagonal(&SVector::<f64, 3>::new(1e-4, 1e-3, 1e-5));
    let steady = steady_state(&sampled.f, &h, &q, &r).unwrap();

    let mut truth = SVector::<f64, 5>::new(0.5, 0.0, 0.0, 0.02, 0.035);
    let mut filter = Kalman {
        state: SVector::zeros(),
        covariance: SMatrix::identity(),
    };
    for step in 0..3000 {
        let u = SVector::<f64, 1>::new(0.2 * (f64::from(step) * 0.05).sin());
        truth = sampled.f * truth + sampled.g * u;
        filter.predict(&sampled, &u, &q).unwrap();
        filter.correct(&(h * truth), &h, &r).unwrap();
    }
    let difference = (filter.covariance - steady.corrected).amax() / steady.corrected.amax();
    assert!(difference < 1e-6, "{difference}");
    assert!((filter.state - truth).amax() < 1e-3);
    assert_eq!(
        filter.correct(&SVector::<f64, 3>::repeat(f64::NAN), &h, &r),
        Err(KalmanError::MeasurementNotFinite)
    );
}

/// Two measurements of very different noise are independent: each gain is that of the
/// scalar filter, P / (P + R).
#[test]
fn unequal_measurement_noise_in_single_precision() {
    let mut filter = Kalman {
        state: SVector::<f32, 2>::zeros(),
        covariance: SMatrix::identity(),
    };
    let r = SMatrix::<f32, 2, 2>::from_diagonal(&SVector::<f32, 2>::new(1.0, 1e-5));
    let z = SVector::<f32, 2>::new(1.0, 1.0);
    assert_eq!(filter.correct(&z, &SMatrix::identity(), &r), Ok(()));
    assert!((filter.state - SVector::<f32, 2>::new(0.5, 0.99999)).amax() < 2e-7);
    assert!((filter.covariance[(0, 0)] - 0.5).abs() < 1e-7);
    assert!((filter.covariance[(1, 1)] / 0.99999e-5 - 1.0).abs() < 1e-3);
}

#[test]
fn filters_that_cannot_be_are_named() {
    let one = Matrix1::new(1.0_f64);
    let zero = Matrix1::new(0.0_f64);
    assert_eq!(
        steady_state(&one, &zero, &one, &one),
        Err(KalmanError::NotDetectable)
    );
    assert_eq!(
        steady_state(&one, &one, &-one, &one),
        Err(KalmanError::ProcessNoise)
    );
    assert_eq!(
        steady_state(&one, &one, &one, &zero),
        Err(KalmanError::MeasurementNoise)
    );
}

/// A step of the filter whose input or result is no number is refused by name, and leaves the filter as it was.
#[test]
fn steps_that_cannot_be_are_named_and_change_nothing() {
    let one = Matrix1::new(1.0_f64);
    let model = Discrete { f: one, g: one };
    let first = Kalman {
        state: SVector::<f64, 1>::new(2.0),
        covariance: one,
    };
    let lost = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(Matrix1::new);
    let predicted = |model: Discrete<f64, 1, 1>, u, q| {
        let mut filter = first;
        let result = filter.predict(&model, &u, &q);
        assert!(result.is_ok() || filter == first, "{filter:?}");
        result
    };
    let corrected = |first: Kalman<f64, 1>, z, h, r| {
        let mut filter = first;
        let result = filter.correct(&z, &h, &r);
        // A state of NaN is not equal to itself.
        let bits =
            |filter: &Kalman<f64, 1>| [filter.state[0], filter.covariance[0]].map(f64::to_bits);
        assert!(
            result.is_ok() || bits(&filter) == bits(&first),
            "{filter:?}"
        );
        result
    };
    for x in lost {
        let lost_model = Discrete { f: x, g: one };
        assert_eq!(predicted(model, x, one), Err(KalmanError::InputNotFinite));
        assert_eq!(predicted(model, one, x), Err(KalmanError::ProcessNoise));
        assert_eq!(
            predicted(lost_model, one, one),
            Err(KalmanError::ModelNotFinite)
        );
        assert_eq!(
            corrected(first, one, x, one),
            Err(KalmanError::ModelNotFinite)
        );
        for (state, covariance) in [(x, one), (one, x)] {
            let found = corrected(Kalman { state, covariance }, one, one, one);
            assert_eq!(found, Err(KalmanError::EstimateNotFinite));
        }
    }
    assert_eq!(predicted(model, one, -one), Err(KalmanError::ProcessNoise));
    let huge = Discrete {
        f: one * f64::MAX,
        g: one,
    };
    assert_eq!(
        predicted(huge, one, one),
        Err(KalmanError::EstimateNotFinite)
    );
    assert_eq!(predicted(model, one, one), Ok(()));
}

/// The loop of thesis Figure 7.9 (Euler model) diverges at V = 2 with
/// K = [5, 4, 3].
#[test]
fn the_printed_gain_diverges_at_two_metres_a_second() {
    let model = example::VEHICLE.geometry.steering_model(2.0);
    let f = SMatrix::<f64, 3, 3>::identity() + model.a * 0.1;
    let closed = f - model.b * 0.1 * SMatrix::<f64, 1, 3>::new(5.0, 4.0, 3.0);
    let largest = poles(&closed)
        .unwrap()
        .iter()
        .map(|p| p.magnitude())
        .fold(0.0, f64::max);
    assert!((largest - 1.004).abs() < 5e-4, "{largest}");
}

#[test]
fn simulations_follow_the_model() {
    let model = example::VEHICLE.geometry.steering_model_sampled(1.0, 0.1);
    let steps: Vec<_> = step_response(&model, 0).take(11).collect();
    // A steering rate of 1 rad/s for one second.
    assert!((steps[10][2] - 1.0).abs() < 1e-12);
    let start = SVector::<f64, 3>::new(1.0, 0.0, 0.0);
    let gain = SMatrix::<f64, 1, 3>::new(0.889, 2.041, 2.199);
    let last = simulate(&model, start, |_, x| -gain * x).nth(200).unwrap();
    assert!(last.amax() < 1e-3);
}

fn standing() -> Observation<f32> {
    Observation {
        position: Some(Position::new(1000, 2000)),
        velocity: Some(Velocity::new(5, -8)),
        steering_angle: Some(0.1),
        steering_rate: 0.0,
        speed: 0.0,
        dt: 0.1,
    }
}

/// At standstill the biases and their variances stay constant, however long it
/// lasts.
#[test]
fn biases_are_frozen_at_standstill() {
    let mut estimator =
        Estimator::<f32>::new(example::settings().estimator, Position::new(0, 0)).unwrap();
    // Drive first, so that the biases have values.
    for step in 0..200 {
        estimator.step(&Observation {
            position: Some(Position::new(step * 100, 0)),
            velocity: Some(Velocity::new(1000, 30)),
            steering_angle: Some(0.03),
            steering_rate: 0.0,
            speed: 1.0,
            dt: 0.1,
        });
    }
    assert!(estimator.is_ready());
    let stop = |estimator: &mut Estimator<f32>| {
        estimator.step(&Observation {
            position: Some(Position::new(20_000, 0)),
            ..standing()
        })
    };
    for _ in 0..30 {
        stop(&mut estimator);
    }
    let before = (estimator.estimate(), estimator.deviations());
    for _ in 0..3000 {
        stop(&mut estimator);
    }
    let after = (estimator.estimate(), estimator.deviations());
    assert!(before.0.steering_bias.abs() > 0.005, "it had learnt a bias");
    assert_eq!(before.0.heading_bias, after.0.heading_bias);
    assert_eq!(before.0.steering_bias, after.0.steering_bias);
    assert!((before.1[4] - after.1[4]).abs() < 1e-4 && (before.1[5] - after.1[5]).abs() < 1e-4);
}

#[test]
fn no_heading_without_motion_and_none_from_bad_input() {
    let mut estimator =
        Estimator::<f32>::new(example::settings().estimator, Position::new(0, 0)).unwrap();
    for _ in 0..50 {
        assert_eq!(estimator.step(&standing()), Update::NoHeading);
    }
    let before = estimator.estimate();
    for bad in [
        Observation {
            dt: 0.0,
            ..standing()
        },
        Observation {
            dt: f32::NAN,
            ..standing()
        },
        Observation {
            steering_rate: f32::INFINITY,
            ..standing()
        },
        Observation {
            speed: f32::NAN,
            ..standing()
        },
        Observation {
            steering_angle: Some(f32::NAN),
            ..standing()
        },
    ] {
        assert_eq!(estimator.step(&bad), Update::BadInput);
        assert_eq!(estimator.estimate(), before);
    }
}

/// A single outlier is ignored; a lasting jump is accepted.
#[test]
fn outliers_and_jumps() {
    let mut estimator =
        Estimator::<f32>::new(example::settings().estimator, Position::new(0, 0)).unwrap();
    let mut drive = |step: i32, east: i32| {
        let update = estimator.step(&Observation {
            position: Some(Position::new(step * 100, east)),
            velocity: Some(Velocity::new(1000, 0)),
            steering_angle: Some(0.0),
            steering_rate: 0.0,
            speed: 1.0,
            dt: 0.1,
        });
        (update, estimator.estimate().east)
    };
    for step in 0..100 {
        drive(step, 0);
    }
    let (_, east) = drive(100, 3000);
    assert!(east.abs() < 0.02, "one outlier moved it to {east}");
    let mut restarted = false;
    for step in 101..120 {
        restarted |= drive(step, 3000).0 == Update::Restarted;
    }
    let (_, east) = drive(120, 3000);
    assert!(restarted && (east - 3.0).abs() < 0.05, "{east}");
}

/// A vehicle that drives north at 1 m/s, at each step from its beginning on.
fn northward(step: i32) -> Observation<f32> {
    Observation {
        position: Some(Position::new(step * 100, 0)),
        velocity: Some(Velocity::new(1000, 0)),
        steering_angle: Some(0.0),
        steering_rate: 0.0,
        speed: 1.0,
        dt: 0.1,
    }
}

/// One velocity that no vehicle has is ignored. Two make no reverse of a drive that goes forward.
#[test]
fn velocities_that_leap() {
    for (count, most) in [(1, 0.01), (2, 0.5)] {
        for wrong in [
            Velocity::new(100_000, 0),
            Velocity::new(-40_000, 0),
            Velocity::new(0, 100_000),
            Velocity::new(i32::MAX, i32::MIN),
        ] {
            let settings = example::settings().estimator;
            let mut estimator = Estimator::<f32>::new(settings, Position::new(0, 0)).unwrap();
            for step in 0..100 {
                estimator.step(&northward(step));
            }
            for step in 100..100 + count {
                estimator.step(&Observation {
                    velocity: Some(wrong),
                    ..northward(step)
                });
                let estimate = estimator.estimate();
                let off = (estimate.speed - 1.0).abs() + estimate.heading.abs();
                assert!(count > 1 || off < most, "{wrong:?}: {estimate:?}");
            }
            for step in 100 + count..200 {
                estimator.step(&northward(step));
            }
            let estimate = estimator.estimate();
            let off = (estimate.speed - 1.0).abs() + estimate.heading.abs();
            assert!(off < 0.05, "{count} of {wrong:?}: {estimate:?}");
        }
    }
}

/// Readings at the limits of their types leave no estimate that cannot recover.
#[test]
fn limits_of_the_types_do_no_lasting_harm() {
    let settings = example::settings().estimator;
    let largest = [f32::MAX, -f32::MAX, 1e19, -1e19, 1e4];
    let far = [i32::MAX, i32::MIN, 1_000_000_000];
    let mut bad: Vec<Observation<f32>> = Vec::new();
    for value in largest {
        bad.extend([
            Observation {
                speed: value,
                ..northward(100)
            },
            Observation {
                steering_rate: value,
                ..northward(100)
            },
            Observation {
                steering_angle: Some(value),
                ..northward(100)
            },
            Observation {
                dt: value.abs(),
                ..northward(100)
            },
        ]);
    }
    for value in far {
        bad.push(Observation {
            velocity: Some(Velocity::new(value, value)),
            ..northward(100)
        });
        bad.push(Observation {
            position: Some(Position::new(value, value)),
            ..northward(100)
        });
    }
    for bad in bad {
        let mut estimator = Estimator::<f32>::new(settings, Position::new(0, 0)).unwrap();
        for step in 0..100 {
            estimator.step(&northward(step));
        }
        for _ in 0..10 {
            estimator.step(&bad);
        }
        estimator.set_gps_delay(1e38);
        for step in 111..400 {
            estimator.step(&northward(step));
        }
        let estimate = estimator.estimate();
        assert!(estimator.is_ready(), "{bad:?}");
        assert!(estimator.antenna_variance() < 0.01, "{bad:?}");
        let along = (estimate.north + settings.geometry.l1 - 39.9).abs();
        assert!(
            along < 0.2 && estimate.heading.abs() < 0.02,
            "{bad:?}: {estimate:?}"
        );
        assert!((estimator.drive() - 1.0).abs() < 0.1, "{bad:?}");
        assert!((estimator.effectiveness() - 1.0).abs() < 0.8, "{bad:?}");
    }
}

#[test]
fn unusable_settings_are_named() {
    let good = example::settings::<f64>().estimator;
    let origin = Position::new(0, 0);
    let mut bad = good;
    bad.noise.position = 0.0;
    assert_eq!(
        Estimator::new(bad, origin).err(),
        Some(EstimatorError::Noise)
    );
    let bad = EstimatorSettings {
        gps_delay: -0.1,
        ..good
    };
    assert_eq!(
        Estimator::new(bad, origin).err(),
        Some(EstimatorError::Delay)
    );
    let bad = EstimatorSettings {
        drive_lag: f64::NAN,
        ..good
    };
    assert_eq!(
        Estimator::new(bad, origin).err(),
        Some(EstimatorError::Drive)
    );
    let bad = EstimatorSettings {
        rear_slip: -0.01,
        ..good
    };
    assert_eq!(
        Estimator::new(bad, origin).err(),
        Some(EstimatorError::Slip)
    );
}

//! The steering model, compared with known results.

#[path = "common/example.rs"]
mod example;

use control::discretise::{DiscretiseError, zero_order_hold};
use control::lqr::{RegulatorError, dlqr};
use control::model::{Geometry, GeometryError};
use nalgebra::{Matrix1, SMatrix};
use proptest::prelude::*;

/// The gain that `dlqr` of MATLAB and of python-control gives for the thesis's
/// vehicle at 1 m/s with Q = I, R = 1 at 10 Hz.
#[test]
fn regulator_at_one_metre_a_second() {
    let model = example::VEHICLE.geometry.steering_model_sampled(1.0, 0.1);
    let regulator = dlqr(&model, &SMatrix::identity(), &Matrix1::new(1.0)).unwrap();
    let known = [
        0.888_975_001_406_838,
        2.040_969_866_222_82,
        2.198_962_922_897_80,
    ];
    for (found, known) in regulator.gain.iter().zip(known) {
        assert!((found - known).abs() < 1e-10, "{found} is not {known}");
    }
}

/// The same design in single precision is exact to single precision.
#[test]
fn regulator_in_single_precision() {
    let model = example::settings::<f32>()
        .estimator
        .geometry
        .steering_model_sampled(1.0, 0.1);
    let regulator = dlqr(&model, &SMatrix::identity(), &Matrix1::new(1.0_f32)).unwrap();
    let known = [0.888_975_f32, 2.040_97, 2.198_963];
    for (found, known) in regulator.gain.iter().zip(known) {
        assert!((found - known).abs() < 2e-4, "{found} is not {known}");
    }
}

proptest! {
    /// The closed form and the general method agree.
    #[test]
    fn closed_form_hold_is_the_general_one(
        l1 in -1.0_f64..2.0,
        l2 in 1.1_f64..4.0,
        speed in -3.0_f64..3.0,
        period in 0.001_f64..1.0,
    ) {
        let vehicle = Geometry { l1, l2 };
        let closed = vehicle.steering_model_sampled(speed, period);
        let general = zero_order_hold(&vehicle.steering_model(speed), period).unwrap();
        prop_assert!((closed.f - general.f).amax() < 1e-13);
        prop_assert!((closed.g - general.g).amax() < 1e-13);
    }

    /// Semigroup property: two periods with the same input equal one period of
    /// twice the length, for any A and B.
    #[test]
    fn two_half_periods_make_one(entries in proptest::collection::vec(-3.0_f64..3.0, 20)) {
        let model = control::model::Continuous {
            a: SMatrix::<f64, 4, 4>::from_iterator(entries[..16].iter().copied()),
            b: SMatrix::<f64, 4, 1>::from_iterator(entries[16..].iter().copied()),
        };
        let whole = zero_order_hold(&model, 0.5).unwrap();
        let half = zero_order_hold(&model, 0.25).unwrap();
        let f = half.f * half.f;
        let g = half.f * half.g + half.g;
        let scale = 1.0 + whole.f.amax();
        prop_assert!((whole.f - f).amax() < 1e-12 * scale);
        prop_assert!((whole.g - g).amax() < 1e-12 * scale);
    }
}

/// The scalar system has the solution F = exp(a T), G = b (F - 1) / a.
#[test]
fn hold_of_a_first_order_lag() {
    let model = control::model::Continuous {
        a: Matrix1::new(-2.0_f64),
        b: Matrix1::new(3.0),
    };
    let sampled = zero_order_hold(&model, 0.7).unwrap();
    let decay = (-1.4_f64).exp();
    assert!((sampled.f[0] - decay).abs() < 1e-15);
    assert!((sampled.g[0] - 3.0 * (1.0 - decay) / 2.0).abs() < 1e-15);
}

#[test]
fn unusable_designs_are_named() {
    let vehicle = example::VEHICLE.geometry;
    assert_eq!(
        Geometry { l1: 0.5, l2: -0.5 }.check(),
        Err(GeometryError::NoWheelbase)
    );
    assert_eq!(
        Geometry {
            l1: f64::NAN,
            l2: 1.0
        }
        .check(),
        Err(GeometryError::NotFinite)
    );
    assert_eq!(
        zero_order_hold(&vehicle.steering_model(f64::NAN), 0.1),
        Err(DiscretiseError::ModelNotFinite)
    );
    assert_eq!(
        zero_order_hold(&vehicle.steering_model(1.0), 0.0),
        Err(DiscretiseError::Period)
    );
    let identity = SMatrix::<f64, 3, 3>::identity();
    let at = |speed| vehicle.steering_model_sampled(speed, 0.1);
    assert_eq!(
        dlqr(&at(0.0), &identity, &Matrix1::new(1.0)),
        Err(RegulatorError::NotStabilisable),
        "at standstill the steering moves nothing but itself"
    );
    assert_eq!(
        dlqr(&at(f64::NAN), &identity, &Matrix1::new(1.0)),
        Err(RegulatorError::ModelNotFinite)
    );
    assert_eq!(
        dlqr(&at(1.0), &-identity, &Matrix1::new(1.0)),
        Err(RegulatorError::StateWeight)
    );
    assert_eq!(
        dlqr(&at(1.0), &identity, &Matrix1::new(0.0)),
        Err(RegulatorError::InputWeight)
    );
}

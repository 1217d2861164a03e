//! Unusable settings are refused, and the error names them.

#[path = "common/example.rs"]
mod example;

use control::controller::{Controller, Settings, SettingsError};
use control::design::{DesignError, SteeringWeights, steering_gains};
use control::estimator::EstimatorError;
use control::feedback::LimitError;
use control::guidance::GuidanceError;
use control::line::Line;
use control::lqr::RegulatorError;
use control::model::GeometryError;
use control::position::Position;

fn refusal(change: impl FnOnce(&mut Settings<f64>)) -> Option<SettingsError> {
    let line = Line::new(Position::new(0, 0), Position::new(1000, 0)).unwrap();
    let mut settings = example::settings();
    change(&mut settings);
    Controller::new(settings, line).err()
}

#[test]
fn each_group_is_named() {
    use SettingsError::{Estimator, Gains, Guidance, Hold, Limit, Number};
    assert_eq!(refusal(|_| ()), None);
    assert_eq!(
        refusal(|s| s.estimator.geometry.l2 = f64::NAN),
        Some(Estimator(EstimatorError::Geometry(
            GeometryError::NotFinite
        )))
    );
    assert_eq!(
        refusal(|s| s.limits.steering_rate = 0.0),
        Some(Limit(LimitError::SteeringRate))
    );
    assert_eq!(
        refusal(|s| s.guidance.swing = 1.5),
        Some(Guidance(GuidanceError::Share))
    );
    assert_eq!(refusal(|s| s.firm.gains[3][1] = f64::INFINITY), Some(Gains));
    assert_eq!(refusal(|s| s.gentle.gains[0][3] = 0.0), Some(Gains));
    assert_eq!(refusal(|s| s.hold.begin = s.hold.end), Some(Hold));
    assert_eq!(refusal(|s| s.cruise = -1.0), Some(Number));
    assert_eq!(refusal(|s| s.lost = f64::NAN), Some(Number));
}

#[test]
fn designs_say_at_which_speed_they_fail() {
    let vehicle = example::VEHICLE.geometry;
    let weights = SteeringWeights {
        integral: 1.0,
        cross_track: 1.0,
        heading: 1.0,
        steering_angle: 1.0,
        steering_rate: 0.0,
    };
    assert_eq!(
        steering_gains::<f64, 3>(&vehicle, &weights, 0.1, 0.5, 0.25),
        Err(DesignError::Regulator {
            speed: 0.25,
            error: RegulatorError::InputWeight
        })
    );
    assert_eq!(
        steering_gains::<f64, 3>(&vehicle, &weights, 0.1, 0.5, 0.0),
        Err(DesignError::Speed)
    );
}

/// Rows at standstill and 1 m/s, in double precision.
fn rows(weights: [f64; 4]) -> Result<[[f64; 4]; 2], DesignError<f64>> {
    let [integral, cross_track, heading, steering_angle] = weights;
    let weights = SteeringWeights {
        integral,
        cross_track,
        heading,
        steering_angle,
        steering_rate: 1.0,
    };
    let vehicle = example::VEHICLE.geometry;
    steering_gains::<f64, 2>(&vehicle, &weights, 0.1, 1.0, 1.0).map(|schedule| schedule.gains)
}

/// Gains of python-control 0.10.2 (`c2d` and `dlqr`) at 1 m/s and 10 Hz; without an
/// integral the gain of the three-state model.
#[test]
fn weights_may_be_zero() {
    let cases = [
        (
            [0.0, 1.0, 1.0, 1.0],
            [0.0, 0.888_975_001_407, 2.040_969_866_22, 2.198_962_922_90],
        ),
        (
            [1.0, 0.0, 1.0, 1.0],
            [
                0.863_472_794_695,
                2.335_199_689_28,
                3.157_689_288_15,
                2.710_906_658_27,
            ],
        ),
        (
            [1.0, 0.0, 0.0, 0.0],
            [
                0.879_871_594_727,
                2.194_029_256_58,
                2.735_492_546_62,
                2.404_400_223_22,
            ],
        ),
    ];
    for (weights, known) in cases {
        let [slow, found] = rows(weights).unwrap();
        assert_eq!(slow, found);
        for (found, known) in found.iter().zip(known) {
            assert!(
                (found - known).abs() < 1e-9,
                "{weights:?}: {found} is not {known}"
            );
        }
    }
    // Nothing holds the vehicle on its line.
    assert_eq!(
        rows([0.0, 0.0, 1.0, 1.0]),
        Err(DesignError::Regulator {
            speed: 1.0,
            error: RegulatorError::UnweightedMode
        })
    );
}

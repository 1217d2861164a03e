//! The example vehicle of tests and benchmarks: that of the thesis, with a
//! wheelbase of 1.1 m and 25 degrees of steering at 25 degrees/s, at 1 m/s.

use control::controller::Settings;
use control::design::SteeringWeights;
use control::feedback::Limits;
use control::model::{Antenna, Geometry};
use control::scalar::Scalar;
use control::vehicle::{Description, Misalignment, Sensors, Weights, degrees};

pub(crate) const VEHICLE: Description = Description {
    geometry: Geometry {
        l1: 0.255,
        l2: 0.845,
    },
    antenna: Antenna {
        right: 0.0,
        height: 0.0,
    },
    limits: Limits {
        steering_angle: degrees(25.0),
        steering_rate: degrees(25.0),
        speed: 2.0,
    },
    cruise: 1.0,
    period: 0.1,
    sensors: Sensors {
        position: 0.01,
        velocity: 0.03,
        steering: degrees(0.1),
        age: 0.055,
        interval: 0.1,
    },
    drive_lag: 0.3,
    acceleration: 2.0,
    cornering: 4.0,
    misalignment: Misalignment {
        heading: degrees(1.0),
        steering: degrees(2.0),
    },
    weights: Some(Weights {
        firm: SteeringWeights {
            integral: 6.0,
            cross_track: 84.0,
            heading: 25.0,
            steering_angle: 0.13,
            steering_rate: 1.0,
        },
        // An error of 1 cm calls for about a third of a degree of steering.
        gentle: SteeringWeights {
            integral: 0.0095,
            cross_track: 0.47,
            heading: 1.28,
            steering_angle: 3.34,
            steering_rate: 1.0,
        },
    }),
};

/// Settings of [`VEHICLE`].
pub(crate) fn settings<T: Scalar>() -> Settings<T> {
    Settings::for_vehicle(&VEHICLE).expect("a sound vehicle")
}

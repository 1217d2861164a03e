//! The vehicle as its controller knows it. The build script derives the control law's
//! settings from these numbers and writes them as constants.

use control::design::SteeringWeights;
use control::feedback::Limits;
use control::model::{Antenna, Geometry};
use control::vehicle::{Description, Misalignment, Sensors, Weights, degrees};

/// The UAGV of the thesis with an RTK-fixed receiver.
pub const VEHICLE: Description = Description {
    // Thesis 7.2.4.
    geometry: Geometry {
        l1: 0.255,
        l2: 0.845,
    },
    antenna: Antenna {
        right: 0.0,
        height: 0.0,
    },
    // Thesis 5.3.
    limits: Limits {
        steering_angle: degrees(25.0),
        steering_rate: degrees(25.0),
        speed: 2.0,
    },
    // The speed of the track tests (thesis 7.3).
    cruise: 1.0,
    // The basic cycle (thesis 6.2.2).
    period: 0.1,
    sensors: Sensors {
        position: 0.01,
        velocity: 0.03,
        steering: degrees(0.1),
        // The firmware replaces it by what its schedule gives, `design::RECEIVER_AGE`.
        age: 0.055,
    },
    drive_lag: 0.3,
    cornering: 4.0,
    misalignment: Misalignment {
        heading: degrees(1.0),
        steering: degrees(2.0),
    },
    // Found by a search over simulated runs of this vehicle.
    weights: Some(Weights {
        firm: SteeringWeights {
            integral: 6.0,
            cross_track: 84.0,
            heading: 25.0,
            steering_angle: 0.13,
            steering_rate: 1.0,
        },
        // A centimetre may cost a third of a degree of steering.
        gentle: SteeringWeights {
            integral: 0.0095,
            cross_track: 0.47,
            heading: 1.28,
            steering_angle: 3.34,
            steering_rate: 1.0,
        },
    }),
};

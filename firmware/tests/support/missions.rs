//! Missions of straight legs, and what a vehicle of 1.1 m takes.

use control::dubins::Pose;
use control::fence::Footprint;
use control::mission::{Join, Leg, MissionSettings, Pace};
use control::turn::TurnSettings;

/// What a mission may ask of a vehicle of 1.1 m.
pub fn settings() -> MissionSettings<f32> {
    MissionSettings {
        wheelbase: 1.1,
        curvature: 0.35,
        steering_rate: 0.37,
        slowest: 0.29,
        top_speed: 2.0,
        turn: TurnSettings::for_steering(1.1, 0.43, 0.43, 0.8, 0.15),
        turn_speed: 0.8,
        footprint: Footprint {
            half_width: 0.35,
            ahead: 1.4,
            behind: 0.3,
        },
        clearance: 0.1,
        pace: Pace::of_drive(0.3),
    }
}

/// A leg of 10 m due north, which continues the one of the number before. With a curvature it bends.
pub fn northwards(number: u16, curvature: f32) -> Leg<f32> {
    Leg {
        start: Pose {
            north: 10.0 * f32::from(number),
            east: 0.0,
            heading: 0.0,
        },
        curvature,
        sharpness: 0.0,
        length: 10.0,
        speed: 1.0,
        reverse: false,
        outputs: 1,
        join: Join::Continue,
    }
}

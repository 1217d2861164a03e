//! A rectangular field of parallel passes, for tests of missions.

use control::controller::Settings;
use control::dubins::Pose;
use control::fence::{Footprint, Point};
use control::mission::{Join, Leg, MissionSettings};
use control::scalar::Scalar;
use control::turn::TurnSettings;

/// Passes to the north and back, each to the east of the one before it, with section 0 on.
pub(crate) struct Field {
    /// Length of a pass, m.
    pub(crate) length: f64,
    /// Distance of two passes, m.
    pub(crate) spacing: f64,
    /// Number of passes.
    pub(crate) passes: usize,
    /// Depth of the headlands, m.
    pub(crate) headland: f64,
    /// Speed on a pass, m/s.
    pub(crate) speed: f64,
}

impl Field {
    /// The passes as legs, joined by turns.
    pub(crate) fn legs<T: Scalar>(&self) -> Vec<Leg<T>> {
        (0..self.passes)
            .map(|number| {
                let north = number % 2 == 0;
                Leg {
                    start: Pose {
                        north: T::lit(if north { 0.0 } else { self.length }),
                        east: T::lit(self.spacing * number as f64),
                        heading: if north { T::zero() } else { T::pi() },
                    },
                    curvature: T::zero(),
                    sharpness: T::zero(),
                    length: T::lit(self.length),
                    speed: T::lit(self.speed),
                    reverse: false,
                    outputs: 1,
                    join: Join::Turn,
                }
            })
            .collect()
    }

    /// The same, and two metres behind the last pass with all sections off.
    pub(crate) fn legs_and_way_out<T: Scalar>(&self) -> Vec<Leg<T>> {
        let mut legs = self.legs();
        if let Some(last) = legs.last_mut() {
            last.join = Join::Continue;
            let out = Leg {
                start: last.end(),
                length: T::lit(2.0),
                outputs: 0,
                ..*last
            };
            legs.push(out);
        }
        legs
    }

    /// A fence about passes and headlands, half a pass wider at the sides.
    pub(crate) fn fence<T: Scalar>(&self) -> [Point<T>; 4] {
        let (south, north) = (-self.headland, self.length + self.headland);
        let west = -self.spacing - 3.0;
        let east = self.spacing * self.passes as f64 + 3.0;
        [(south, west), (north, west), (north, east), (south, east)].map(|(north, east)| Point {
            north: T::lit(north),
            east: T::lit(east),
        })
    }
}

/// What a mission may ask of the vehicle of `settings` that turns at `turn_speed`. It has a pass's width
/// of three metres.
pub(crate) fn mission_settings<T: Scalar>(
    settings: &Settings<T>,
    turn_speed: f64,
) -> MissionSettings<T> {
    let footprint = Footprint {
        half_width: T::lit(1.5),
        ahead: T::zero(),
        behind: T::zero(),
    };
    let base =
        MissionSettings::for_controller(settings, footprint, T::lit(turn_speed), T::lit(0.2));
    MissionSettings {
        turn: TurnSettings {
            lead_in: T::lit(0.5),
            lead_out: T::lit(2.0),
            stop_cost: T::lit(3.0),
            ..base.turn
        },
        ..base
    }
}

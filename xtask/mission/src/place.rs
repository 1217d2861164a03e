//! Places on the earth (WGS 84) and in the local frame that the vehicle drives in.
//!
//! The firmware knows positions as `control::position::Position`: millimetres north and east of the base station, as
//! the receiver's message `MSG_BASELINE_NED` has them. Swift Navigation's binary protocol defines that frame as the plane
//! tangent to the ellipsoid at the base station (SBP specification, message 0x020C). [`Frame`] is this frame in metres. So the
//! origin of a plan is the base station's antenna, with its height.
//!
//! How far a place of the plan is from where the firmware drives to:
//!
//! - The projection is exact, to 0.1 µm within 10 km of the origin, for places at the height of the origin above the ellipsoid.
//! - Nothing here knows the heights of the field. A place that is `h` metres higher than the origin is farther from it by
//!   `h` / 6371 km: 0.16 mm for each metre of height, 1 km away.
//! - Distances in the plane are shorter than on the ground by d³ / 6R²: 4 µm over 1 km, 4 mm over 10 km.
//! - A height of 0 where the base station is 330 m up (Nebraska) makes all distances 52 mm shorter over 1 km. Give the height.

use std::fmt;

/// Semi-major axis of WGS 84, m (NIMA TR8350.2).
const MAJOR: f64 = 6_378_137.0;
/// First eccentricity squared of WGS 84, from the flattening 1/298.257223563.
const ECCENTRICITY: f64 = 6.694_379_990_141_316e-3;

/// Largest distance of a place from the origin in each direction, m. It is the range of waypoints in a vehicle's manifest.
pub const FARTHEST: f64 = 10_000.0;
/// Angle by which the way back from a plane leads aside of a place that is still near, rad: that is 11 m, 97 km away.
const ASIDE: f64 = 1.75e-6;

/// A place on the earth, WGS 84.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Geodetic {
    /// Degrees, north positive, -90 to 90.
    pub latitude: f64,
    /// Degrees, east positive, -180 to 180.
    pub longitude: f64,
}

impl Geodetic {
    /// The place, if there is one: finite angles within their ranges.
    #[must_use]
    pub fn checked(latitude: f64, longitude: f64) -> Option<Self> {
        ((-90.0..=90.0).contains(&latitude) && (-180.0..=180.0).contains(&longitude)).then_some(
            Self {
                latitude,
                longitude,
            },
        )
    }
}

/// A place in the local frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Local {
    /// Metres north of the origin.
    pub north: f64,
    /// Metres east of the origin.
    pub east: f64,
}

impl Local {
    /// A place from metres north and east.
    #[must_use]
    pub const fn new(north: f64, east: f64) -> Self {
        Self { north, east }
    }

    /// Distance to another place, m.
    #[must_use]
    pub fn distance(self, other: Self) -> f64 {
        (other.north - self.north).hypot(other.east - self.east)
    }

    /// Direction to another place, rad clockwise from north in (-pi, pi].
    #[must_use]
    pub fn bearing(self, other: Self) -> f64 {
        (other.east - self.east).atan2(other.north - self.north)
    }

    /// The place `distance` metres from here in a direction, rad clockwise from north.
    #[must_use]
    pub fn towards(self, bearing: f64, distance: f64) -> Self {
        let (sine, cosine) = bearing.sin_cos();
        Self::new(self.north + distance * cosine, self.east + distance * sine)
    }

    /// The place at a share of the way to another one.
    #[must_use]
    pub fn between(self, other: Self, share: f64) -> Self {
        Self::new(
            self.north + share * (other.north - self.north),
            self.east + share * (other.east - self.east),
        )
    }
}

impl fmt::Display for Local {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} m north, {:.2} m east", self.north, self.east)
    }
}

/// Where the local frame is on the earth: the base station's antenna.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Origin {
    /// Latitude and longitude; within 89 degrees of the equator.
    pub place: Geodetic,
    /// Height above the ellipsoid, m, -500 to 9000.
    pub height: f64,
}

/// The local frame: the plane tangent to the ellipsoid at the origin. See the module for its errors.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    origin: Origin,
    /// The origin, earth-centred.
    centre: [f64; 3],
    /// Unit vectors towards north and east, earth-centred.
    north: [f64; 3],
    east: [f64; 3],
    /// Metres for a radian of latitude and of longitude at the origin.
    radii: (f64, f64),
}

/// Earth-centred, earth-fixed coordinates, m.
fn ecef(place: Geodetic, height: f64) -> [f64; 3] {
    let (sine, cosine) = place.latitude.to_radians().sin_cos();
    let (sine_east, cosine_east) = place.longitude.to_radians().sin_cos();
    let normal = MAJOR / (1.0 - ECCENTRICITY * sine * sine).sqrt();
    let across = (normal + height) * cosine;
    [
        across * cosine_east,
        across * sine_east,
        (normal * (1.0 - ECCENTRICITY) + height) * sine,
    ]
}

fn dot(one: [f64; 3], other: [f64; 3]) -> f64 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

impl Frame {
    /// The frame at an origin.
    #[must_use]
    pub fn new(origin: Origin) -> Self {
        let (sine, cosine) = origin.place.latitude.to_radians().sin_cos();
        let (sine_east, cosine_east) = origin.place.longitude.to_radians().sin_cos();
        let normal = MAJOR / (1.0 - ECCENTRICITY * sine * sine).sqrt();
        let meridian = normal * (1.0 - ECCENTRICITY) / (1.0 - ECCENTRICITY * sine * sine);
        Self {
            origin,
            centre: ecef(origin.place, origin.height),
            north: [-sine * cosine_east, -sine * sine_east, cosine],
            east: [-sine_east, cosine_east, 0.0],
            radii: (meridian + origin.height, (normal + origin.height) * cosine),
        }
    }

    /// The origin of the frame.
    #[must_use]
    pub const fn origin(&self) -> Origin {
        self.origin
    }

    /// A place of the earth in the frame. It is taken to be at the height of the origin.
    #[must_use]
    pub fn local(&self, place: Geodetic) -> Local {
        let [x, y, z] = ecef(place, self.origin.height);
        let [cx, cy, cz] = self.centre;
        let from = [x - cx, y - cy, z - cz];
        Local::new(dot(from, self.north), dot(from, self.east))
    }

    /// False for a place so far away that the plane has it elsewhere, as one at the other end of the earth.
    #[must_use]
    pub fn is_near(&self, place: Geodetic) -> bool {
        let back = self.geodetic(self.local(place));
        let same = |one: f64, other: f64| (one - other).to_radians().sin().abs() < ASIDE;
        same(back.latitude, place.latitude) && same(back.longitude, place.longitude)
    }

    /// The place of the earth, at the height of the origin, that has these local coordinates. For coordinates up to
    /// [`FARTHEST`]; farther ones may find no place, then the result is wrong.
    #[must_use]
    pub fn geodetic(&self, local: Local) -> Geodetic {
        let mut place = self.origin.place;
        let mut missing = local;
        // Each step leaves about distance / earth radius of what was missing, and near a pole as much more as the
        // meridians converge: twelve reach the last bits from 10 km at 89 degrees, too.
        for _ in 0..12 {
            place.latitude += (missing.north / self.radii.0).to_degrees();
            place.longitude += (missing.east / self.radii.1).to_degrees();
            let reached = self.local(place);
            missing = Local::new(local.north - reached.north, local.east - reached.east);
        }
        place.longitude -= 360.0 * (place.longitude / 360.0).round();
        place
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_equator_and_a_pole() {
        let at = |latitude| {
            ecef(
                Geodetic {
                    latitude,
                    longitude: 0.0,
                },
                0.0,
            )
        };
        assert_eq!(at(0.0), [MAJOR, 0.0, 0.0]);
        let [x, _, z] = at(90.0);
        // The semi-minor axis of TR8350.2.
        assert!(x.abs() < 1e-8 && (z - 6_356_752.314_245).abs() < 1e-5);
    }

    #[test]
    fn only_places_of_the_earth_are_places() {
        assert!(Geodetic::checked(90.0, -180.0).is_some());
        for (latitude, longitude) in [
            (90.1, 0.0),
            (0.0, 180.1),
            (f64::NAN, 0.0),
            (0.0, f64::INFINITY),
        ] {
            assert_eq!(Geodetic::checked(latitude, longitude), None);
        }
    }

    #[test]
    fn a_longitude_goes_on_behind_the_date_line() {
        let frame = Frame::new(Origin {
            place: Geodetic {
                latitude: -17.0,
                longitude: 179.999,
            },
            height: 0.0,
        });
        let beyond = frame.geodetic(Local::new(0.0, 1000.0));
        assert!(beyond.longitude < -179.98, "{beyond:?}");
        assert!((frame.local(beyond).east - 1000.0).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn there_and_back(
            latitude in -89.0_f64..89.0, longitude in -180.0_f64..180.0, height in -100.0_f64..4000.0,
            north in -FARTHEST..FARTHEST, east in -FARTHEST..FARTHEST,
        ) {
            let frame = Frame::new(Origin { place: Geodetic { latitude, longitude }, height });
            let again = frame.local(frame.geodetic(Local::new(north, east)));
            prop_assert!((again.north - north).abs() < 1e-7, "{} {}", again.north, north);
            prop_assert!((again.east - east).abs() < 1e-7, "{} {}", again.east, east);
        }

        #[test]
        fn bearings_lead_there(north in -99.0_f64..99.0, east in -99.0_f64..99.0) {
            let (from, to) = (Local::new(3.0, -4.0), Local::new(north, east));
            let reached = from.towards(from.bearing(to), from.distance(to));
            prop_assert!(reached.distance(to) < 1e-9);
        }
    }
}

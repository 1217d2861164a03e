//! The shape of the earth (WGS 84, NIMA TR8350.2), as needed for a receiver's output.

use libm::{cos, sin, sqrt};

/// Semi-major axis, metres.
const MAJOR: f64 = 6_378_137.0;
/// First eccentricity squared, from the flattening 1/298.257223563.
const ECCENTRICITY: f64 = 6.694_379_990_141_316e-3;

/// A geodetic position: radians, radians, metres above the ellipsoid.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Geodetic {
    /// Latitude, positive north.
    pub latitude: f64,
    /// Longitude, positive east.
    pub longitude: f64,
    /// Height above the ellipsoid.
    pub height: f64,
}

/// Radius of curvature across the meridian.
fn normal(latitude: f64) -> f64 {
    MAJOR / sqrt(1.0 - ECCENTRICITY * sin(latitude) * sin(latitude))
}

/// Radius of curvature along the meridian.
fn meridian(latitude: f64) -> f64 {
    let n = normal(latitude) / MAJOR;
    MAJOR * (1.0 - ECCENTRICITY) * n * n * n
}

impl Geodetic {
    /// The position `north`, `east`, `down` metres from here, in the plane tangent to the
    /// ellipsoid. Within a kilometre the error is at most a decimetre in height and 0.1 mm
    /// horizontally.
    #[must_use]
    pub fn offset(self, [north, east, down]: [f64; 3]) -> Self {
        Self {
            latitude: self.latitude + north / (meridian(self.latitude) + self.height),
            longitude: self.longitude
                + east / ((normal(self.latitude) + self.height) * cos(self.latitude)),
            height: self.height - down,
        }
    }

    /// Earth-centred, earth-fixed coordinates, metres.
    #[must_use]
    pub fn ecef(self) -> [f64; 3] {
        let n = normal(self.latitude);
        let across = (n + self.height) * cos(self.latitude);
        [
            across * cos(self.longitude),
            across * sin(self.longitude),
            (n * (1.0 - ECCENTRICITY) + self.height) * sin(self.latitude),
        ]
    }

    /// Converts a north-east-down vector at this position to earth-centred axes.
    #[must_use]
    pub fn rotate(self, [north, east, down]: [f64; 3]) -> [f64; 3] {
        let (sl, cl) = (sin(self.latitude), cos(self.latitude));
        let (so, co) = (sin(self.longitude), cos(self.longitude));
        [
            -sl * co * north - so * east - cl * co * down,
            -sl * so * north + co * east - cl * so * down,
            cl * north - sl * down,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equator_and_pole() {
        let place = |latitude: f64| Geodetic {
            latitude,
            longitude: 0.0,
            height: 0.0,
        };
        assert_eq!(place(0.0).ecef(), [MAJOR, 0.0, 0.0]);
        // Semi-minor axis of the ellipsoid.
        let [x, _, z] = place(core::f64::consts::FRAC_PI_2).ecef();
        assert!(
            x.abs() < 1e-8 && (z - 6_356_752.314_245).abs() < 1e-5,
            "{x} {z}"
        );
    }

    #[test]
    fn a_short_offset_agrees_with_the_rotated_vector() {
        let base = Geodetic {
            latitude: 0.713,
            longitude: -1.687,
            height: 350.0,
        };
        let vector = [100.0, -40.0, 2.0];
        let moved = base.offset(vector).ecef();
        for ((to, from), step) in moved.iter().zip(base.ecef()).zip(base.rotate(vector)) {
            assert!((to - from - step).abs() < 2e-3, "{to} {from} {step}");
        }
    }
}

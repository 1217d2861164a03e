//! The shape of the earth (WGS 84, NIMA TR8350.2), as needed for a receiver's output.

use libm::{atan2, cos, hypot, sin, sqrt};

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

impl Geodetic {
    /// The position `north`, `east`, `down` metres from here, in the plane that touches the ellipsoid at this latitude
    /// and longitude.
    #[must_use]
    pub fn offset(self, vector: [f64; 3]) -> Self {
        let ([x, y, z], [dx, dy, dz]) = (self.ecef(), self.rotate(vector));
        Self::from_ecef([x + dx, y + dy, z + dz])
    }

    /// The position with these earth-centred, earth-fixed coordinates, metres (B. R. Bowring, "Transformation from spatial
    /// to geographical coordinates", Survey Review, 1976). Up to 10 km above the ellipsoid its error is below a micrometre.
    #[must_use]
    pub fn from_ecef([x, y, z]: [f64; 3]) -> Self {
        let minor = MAJOR * sqrt(1.0 - ECCENTRICITY);
        let across = hypot(x, y);
        let reduced = atan2(z * MAJOR, across * minor);
        let (s, c) = (sin(reduced), cos(reduced));
        let second = ECCENTRICITY / (1.0 - ECCENTRICITY);
        let latitude = atan2(
            z + second * minor * s * s * s,
            across - ECCENTRICITY * MAJOR * c * c * c,
        );
        let (s, c) = (sin(latitude), cos(latitude));
        Self {
            latitude,
            longitude: atan2(y, x),
            height: across * c + z * s - MAJOR * sqrt(1.0 - ECCENTRICITY * s * s),
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

    /// Before, 1 km north and east at this place was 68 and 135 mm off.
    #[test]
    fn an_offset_agrees_with_the_rotated_vector() {
        for (latitude, vector) in [
            (0.713, [100.0, -40.0, 2.0]),
            (0.712_618_5, [1000.0, 1000.0, -1.2]),
            (-1.2, [-3000.0, 500.0, 40.0]),
        ] {
            let base = Geodetic {
                latitude,
                longitude: -1.687,
                height: 350.0,
            };
            let moved = base.offset(vector).ecef();
            for ((to, from), step) in moved.iter().zip(base.ecef()).zip(base.rotate(vector)) {
                assert!((to - from - step).abs() < 1e-6, "{to} {from} {step}");
            }
        }
    }
}

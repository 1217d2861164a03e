//! Latitude and longitude as single numbers, each combined from its signals.
//!
//! The frames of the thesis carry whole degrees and ten decimal places separately (Figures 6.2
//! and 6.3). Here an angle is one number in units of 1E-10 degrees, which is 11 micrometres on
//! the ground.
//!
//! The byte order of the ten decimal places is inferred and unresolved: so read, the frames that
//! the thesis logged (Figure 6.33) lie some 76 km from its test track.

use crate::messages::{Degrees, DegreesE10, Latitude, Longitude};

/// 1E-10 degrees in a degree.
const DEGREE: u64 = 10_000_000_000;

/// Parts of an angle as the messages carry it: whole degrees, truncated; the magnitude of the
/// remainder; the sign.
struct Parts {
    whole: Degrees,
    fraction: DegreesE10,
    negative: bool,
}

impl Parts {
    /// `limit` is in degrees, at most 180; a greater angle is taken as the limit.
    fn new(angle: i64, limit: u8) -> Self {
        let magnitude = angle.unsigned_abs().min(u64::from(limit) * DEGREE);
        // At most 180, which fits.
        let whole = (magnitude / DEGREE) as i16;
        Self {
            whole: Degrees(if angle < 0 { -whole } else { whole }),
            fraction: DegreesE10(magnitude % DEGREE),
            negative: angle < 0,
        }
    }

    /// The sign is that of the whole degrees, the only sign in the thesis's frames; if they are
    /// zero, it is that of the sign flag.
    fn angle(&self) -> i64 {
        // Less than one degree, so no sum overflows.
        let fraction = self.fraction.0.min(DEGREE - 1) as i64;
        let whole = i64::from(self.whole.0) * DEGREE as i64;
        if self.whole.0 < 0 || (self.whole.0 == 0 && self.negative) {
            whole - fraction
        } else {
            whole + fraction
        }
    }
}

impl Latitude {
    /// The message for a latitude in 1E-10 degrees, north positive. A latitude beyond a pole is
    /// sent as the pole.
    pub fn from_angle(angle: i64) -> Self {
        let Parts {
            whole,
            fraction,
            negative,
        } = Parts::new(angle, 90);
        Self {
            fraction,
            whole,
            negative,
        }
    }

    /// The latitude in 1E-10 degrees, north positive.
    pub fn angle(&self) -> i64 {
        let Self {
            fraction,
            whole,
            negative,
        } = *self;
        Parts {
            whole,
            fraction,
            negative,
        }
        .angle()
    }
}

impl Longitude {
    /// The message for a longitude in 1E-10 degrees, east positive. A longitude beyond 180
    /// degrees is sent as 180 degrees.
    pub fn from_angle(angle: i64) -> Self {
        let Parts {
            whole,
            fraction,
            negative,
        } = Parts::new(angle, 180);
        Self {
            fraction,
            whole,
            negative,
        }
    }

    /// The longitude in 1E-10 degrees, east positive.
    pub fn angle(&self) -> i64 {
        let Self {
            fraction,
            whole,
            negative,
        } = *self;
        Parts {
            whole,
            fraction,
            negative,
        }
        .angle()
    }
}

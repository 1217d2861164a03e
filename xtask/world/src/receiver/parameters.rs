//! Parameters of the receiver.

use serde::{Deserialize, Serialize};

use crate::changes::changes;
use crate::units::{Angle, Length, Ppm, Ratio, Speed, Time};

/// The receiver.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Time between two measurements, 50 ms to 1 s.
    pub period: Time,
    /// Standard deviation of a fixed position, each coordinate, 0 to 1 m. Default 1 cm.
    pub noise: Length,
    /// Standard deviation of the velocity, each coordinate, 0 to 1 m/s. Default 1 cm/s.
    pub velocity_noise: Speed,
    /// Time constant of the noise, 0 to 600 s. Default 0 s: white.
    pub correlation: Time,
    /// Time from the measurement to the first byte, 0 to 250 ms.
    pub latency: Time,
    /// Random additional latency: its largest value, 0 to 10 ms. Default 100 us.
    pub latency_jitter: Time,
    /// Pause between two frames of a burst, 0 to 10 ms.
    pub frame_gap: Time,
    /// Rotation of the velocity vector that the receiver reports, -10 to 10 deg. Default 0 deg.
    pub heading_bias: Angle,
    /// Whether it sends velocities, in either frame. Default true.
    pub velocities: bool,
    /// Whether it has an inertial sensor and sends roll, pitch and yaw.
    pub inertial: bool,
    /// Standard deviation of a measured roll or pitch, 0 to 10 deg. Default 0.2 deg.
    pub tilt_noise: Angle,
    /// Constant error of the measured roll, -10 to 10 deg, positive if the right side seems lower than it is. Default 0.3
    /// deg.
    pub roll_error: Angle,
    /// Constant error of the measured pitch, -10 to 10 deg, positive if the front seems higher than it is. Default 0.3 deg.
    pub pitch_error: Angle,
    /// Error of the receiver's clock, -100 to 100 ppm; random within 20 ppm when `None`.
    pub clock: Option<Ppm>,
    /// Time from the start of the run to the first measurement, 0 to a period; random when `None`.
    pub phase: Option<Time>,
    /// Fix at the start of the run. Default fixed.
    pub fix: Fix,
    /// Position of the base station.
    pub base: Base,
}

impl Parameters {
    /// The receiver that a manifest describes, without an inertial sensor. Values that the manifest does not contain take
    /// the defaults stated at the fields.
    #[must_use]
    pub fn of(receiver: &vehicle_model::manifest::Receiver) -> Self {
        Self {
            period: receiver.period,
            noise: Length::new(0.01),
            velocity_noise: Speed::new(0.01),
            correlation: Time::new(0.0),
            latency: receiver.latency,
            latency_jitter: Time::new(100e-6),
            frame_gap: super::frame_gap(receiver.burst),
            heading_bias: Angle::degrees(0.0),
            velocities: true,
            inertial: false,
            tilt_noise: Angle::degrees(0.2),
            roll_error: Angle::degrees(0.3),
            pitch_error: Angle::degrees(0.3),
            clock: None,
            phase: None,
            fix: Fix::Fixed,
            base: Base::default(),
        }
    }
}

changes! {
    /// Changes of the manifest's receiver by a scenario.
    pub(crate) struct Changes of Parameters {
        noise: Length,
        velocity_noise: Speed,
        correlation: Time,
        latency: Time,
        latency_jitter: Time,
        frame_gap: Time,
        heading_bias: Angle,
        velocities: bool,
        tilt_noise: Angle,
        roll_error: Angle,
        pitch_error: Angle,
        fix: Fix,
        base: Base,
    } optional {
        clock: Ppm,
        phase: Time,
    }
}

/// Place of the base station: the origin of all northings and eastings.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Base {
    /// Latitude, -89 to 89 deg.
    pub latitude: Angle,
    /// Longitude, -180 to 180 deg.
    pub longitude: Angle,
    /// Height above the ellipsoid, -500 to 9000 m.
    pub height: Length,
}

impl Default for Base {
    /// The thesis's test track in Lincoln, Nebraska, to a hundredth of a degree.
    fn default() -> Self {
        Self {
            latitude: Angle::degrees(40.83),
            longitude: Angle::degrees(-96.66),
            height: Length::new(330.0),
        }
    }
}

/// Quality of the solution.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fix {
    /// No satellites.
    None,
    /// Satellites, no corrections from the base.
    Single,
    /// Corrections, ambiguities not resolved.
    Float,
    /// Carrier-phase ambiguities resolved.
    Fixed,
}

impl Fix {
    /// The name in scenario files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Single => "single",
            Self::Float => "float",
            Self::Fixed => "fixed",
        }
    }

    /// Flags of the position messages.
    #[must_use]
    pub const fn position_flags(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Single => 1,
            Self::Float => 3,
            Self::Fixed => 4,
        }
    }

    /// Flags of the baseline messages.
    #[must_use]
    pub const fn baseline_flags(self) -> u8 {
        match self {
            Self::None | Self::Single => 0,
            Self::Float => 3,
            Self::Fixed => 4,
        }
    }

    /// True if there is a baseline to the base station.
    #[must_use]
    pub const fn has_baseline(self) -> bool {
        matches!(self, Self::Float | Self::Fixed)
    }
}

/// The fix changes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FixChange {
    /// When.
    pub at: Time,
    /// To what.
    pub state: Fix,
}

/// What the receiver's inertial sensor tells of roll and pitch.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inertial {
    /// What it measures.
    Valid,
    /// That it does not know them: its message says so, and has zeros for the angles.
    Invalid,
    /// Nothing: its message does not come.
    Silent,
}

impl Inertial {
    /// The name in scenario files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::Invalid => "invalid",
            Self::Silent => "silent",
        }
    }
}

/// The inertial sensor loses roll and pitch, or finds them again. A receiver without one ignores it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InertialChange {
    /// When.
    pub at: Time,
    /// What it tells from then on.
    pub state: Inertial,
}

/// The byte stream is damaged for a while.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamFault {
    /// When the damage starts.
    pub from: Time,
    /// When the damage ends; the end of the run if left out.
    pub until: Option<Time>,
    /// Kind of damage.
    pub fault: StreamFaultKind,
    /// Share of damaged bytes or frames for the kinds that have a rate: 0 to 100 %, default 1 %.
    #[serde(default = "default_rate")]
    pub rate: Ratio,
}

fn default_rate() -> Ratio {
    Ratio::new(0.01)
}

/// Kinds of damage.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StreamFaultKind {
    /// `rate` of the bytes have one bit inverted.
    Flip,
    /// `rate` of the frames end early.
    Truncate,
    /// `rate` of the frames have a wrong length field and a valid checksum.
    Length,
    /// Random bytes without pause until the next burst.
    Flood,
    /// Bytes that each look like the begin of a frame, without pause until the next burst.
    Preambles,
    /// Nothing is sent.
    Silence,
}

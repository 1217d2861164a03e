//! Numbers that belong to one machine and to the ground it stands on.

use serde::Deserialize;

use crate::units::{Angle, Compliance, Count, CountSlope, Length, Rate, Ratio, Speed, Time};

/// The machine. Every field may be left out of a scenario; the defaults are the thesis's vehicle.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// `L1`: rear axle to antenna, above 0 to 10 m. Default 0.255 m (thesis 7.2.4).
    pub rear_to_antenna: Length,
    /// `L2`: antenna to front axle, above 0 to 10 m. Default 0.845 m (thesis 7.2.4).
    pub antenna_to_front: Length,
    /// Speed at full drive effort, above 0 to 10 m/s. Default 2 m/s (thesis 5.3).
    pub top_speed: Speed,
    /// Share of the drive effort that moves nothing, 0 to 50 %. Default 5 %.
    pub drive_dead_band: Ratio,
    /// Time constant of the drive, 0 to 10 s. Default 0.3 s.
    pub drive_lag: Time,
    /// Mechanical end stops, either side, above 0 to 60 deg. Default 25 deg (thesis 5.3).
    pub steering_limit: Angle,
    /// Steering rate at full effort, above 0 to 180 deg/s. Default 25 deg/s (thesis 5.3).
    pub steering_rate: Rate,
    /// Rate of this actuator as a share of `steering_rate`: below 100 % the actuator is slower
    /// than its calibration says. 10 to 200 %, default 100 %.
    pub actuator_gain: Ratio,
    /// Share of the steering effort to the right that moves nothing, 0 to 50 %. Default 10 %.
    pub dead_band_right: Ratio,
    /// Share of the steering effort to the left that moves nothing, 0 to 50 %. Default 12 %.
    pub dead_band_left: Ratio,
    /// Angle of the wheels less the angle that the potentiometer shows, -10 to 10 deg.
    /// Default 0 deg.
    pub steering_bias: Angle,
    /// Reading of the potentiometer straight ahead, 0 to 4095 counts. Default 2048 counts.
    pub pot_centre: Count,
    /// Reading for a degree to the right, -80 to 80 counts/deg, not 0. Default 40 counts/deg.
    pub pot_slope: CountSlope,
    /// Standard deviation of the noise on the potentiometer, 0 to 100 counts. Default 1 count.
    pub pot_noise: Count,
    /// The steering motor driver turns left on bytes above 127. Default false.
    pub steering_reversed: bool,
    /// The drive motor driver turns backwards on bytes above 127. Default false.
    pub drive_reversed: bool,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            rear_to_antenna: Length::new(0.255),
            antenna_to_front: Length::new(0.845),
            top_speed: Speed::new(2.0),
            drive_dead_band: Ratio::new(0.05),
            drive_lag: Time::new(0.3),
            steering_limit: Angle::degrees(25.0),
            steering_rate: Rate::degrees(25.0),
            actuator_gain: Ratio::new(1.0),
            dead_band_right: Ratio::new(0.10),
            dead_band_left: Ratio::new(0.12),
            steering_bias: Angle::degrees(0.0),
            pot_centre: Count::new(2048.0),
            pot_slope: CountSlope::new(40.0 / Angle::degrees(1.0).get()),
            pot_noise: Count::new(1.0),
            steering_reversed: false,
            drive_reversed: false,
        }
    }
}

impl Parameters {
    /// `L = L1 + L2`, metres.
    #[must_use]
    pub fn wheelbase(&self) -> f64 {
        self.rear_to_antenna.get() + self.antenna_to_front.get()
    }
}

/// The ground. The default is level and grips.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ground {
    /// Steepness, 0 to 30 deg.
    pub slope: Angle,
    /// Direction of steepest descent, clockwise from north, -360 to 360 deg. Default 90 deg: a
    /// vehicle that drives north is drawn to its right.
    pub downhill: Angle,
    /// Slip of the front tyres for a lateral force of the vehicle's weight, 0 to 60 deg/g.
    /// Default 14 deg/g, a cornering coefficient of 4 per radian.
    pub front_slip: Compliance,
    /// The same for the rear tyres.
    pub rear_slip: Compliance,
    /// Share of the wheels' speed lost to slip along the way, 0 to 90 %. Default 0 %.
    pub wheel_slip: Ratio,
}

impl Default for Ground {
    fn default() -> Self {
        let slip = Compliance::new(Angle::degrees(14.0).get());
        Self {
            slope: Angle::degrees(0.0),
            downhill: Angle::degrees(90.0),
            front_slip: slip,
            rear_slip: slip,
            wheel_slip: Ratio::new(0.0),
        }
    }
}

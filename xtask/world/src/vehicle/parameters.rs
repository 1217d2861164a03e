//! Parameters of a machine and of the ground.

use serde::Deserialize;
use vehicle_model::Machine;

use crate::changes::changes;
use crate::units::{Angle, Compliance, Count, CountSlope, Length, Rate, Ratio, Speed, Time};

/// The machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// `L1`: rear axle to antenna, positive ahead, -10 to 10 m.
    pub rear_to_antenna: Length,
    /// `L2`: antenna to front axle; the wheelbase `L1 + L2` is above 0 to 10 m.
    pub antenna_to_front: Length,
    /// Antenna beside the centre line, right positive, -5 to 5 m.
    pub antenna_right: Length,
    /// Antenna above the ground, 0 to 10 m.
    pub antenna_height: Length,
    /// Speed at full drive effort, above 0 to 10 m/s.
    pub top_speed: Speed,
    /// Largest share of the drive effort that does not move the vehicle, 0 to 50 %.
    pub drive_dead_band: Ratio,
    /// Time constant of the drive, 0 to 10 s.
    pub drive_lag: Time,
    /// Mechanical end stops, either side, above 0 to 60 deg.
    pub steering_limit: Angle,
    /// Steering rate to the right at full effort, above 0 to 180 deg/s.
    pub rate_right: Rate,
    /// Steering rate to the left at full effort, above 0 to 180 deg/s.
    pub rate_left: Rate,
    /// Rate of this actuator as a share of the two above: below 100 % the actuator is slower
    /// than its calibration says. 10 to 200 %, default 100 %.
    pub actuator_gain: Ratio,
    /// Largest share of the steering effort to the right that does not move the wheels, 0 to 50 %.
    pub dead_band_right: Ratio,
    /// Largest share of the steering effort to the left that does not move the wheels, 0 to 50 %.
    pub dead_band_left: Ratio,
    /// Angle of the wheels minus the angle that the potentiometer shows, -10 to 10 deg. Default 0
    /// deg.
    pub steering_bias: Angle,
    /// Reading of the potentiometer straight ahead, 0 to 4095 counts.
    pub pot_centre: Count,
    /// Increase of the reading per degree to the right, -80 to 80 counts/deg, not 0.
    pub pot_slope: CountSlope,
    /// Standard deviation of the noise on the potentiometer, 0 to 100 counts. Default 1 count.
    pub pot_noise: Count,
    /// The steering motor driver turns left on bytes above 127.
    pub steering_reversed: bool,
    /// The drive motor driver turns backwards on bytes above 127.
    pub drive_reversed: bool,
}

impl From<&Machine> for Parameters {
    /// The machine that a manifest describes. Values that the manifest does not contain take the
    /// defaults stated at the fields.
    fn from(machine: &Machine) -> Self {
        let reversed = !machine.motor_driver.full_byte_is_forward;
        Self {
            rear_to_antenna: machine.rear_to_antenna,
            antenna_to_front: machine.antenna_to_front,
            antenna_right: machine.antenna_right,
            antenna_height: machine.antenna_height,
            top_speed: machine.drive.full_speed,
            drive_dead_band: machine.drive.dead_band,
            drive_lag: machine.drive.lag,
            steering_limit: machine.limits.steering_angle,
            rate_right: machine.steering.right.full_rate,
            rate_left: machine.steering.left.full_rate,
            actuator_gain: Ratio::new(1.0),
            dead_band_right: machine.steering.right.dead_band,
            dead_band_left: machine.steering.left.dead_band,
            steering_bias: Angle::degrees(0.0),
            pot_centre: machine.potentiometer.centre,
            pot_slope: machine.potentiometer.slope,
            pot_noise: Count::new(1.0),
            steering_reversed: reversed,
            drive_reversed: reversed,
        }
    }
}

changes! {
    /// Changes of the manifest's machine by a scenario.
    pub(crate) struct Changes of Parameters {
        rear_to_antenna: Length,
        antenna_to_front: Length,
        antenna_right: Length,
        antenna_height: Length,
        top_speed: Speed,
        drive_dead_band: Ratio,
        drive_lag: Time,
        steering_limit: Angle,
        rate_right: Rate,
        rate_left: Rate,
        actuator_gain: Ratio,
        dead_band_right: Ratio,
        dead_band_left: Ratio,
        steering_bias: Angle,
        pot_centre: Count,
        pot_slope: CountSlope,
        pot_noise: Count,
        steering_reversed: bool,
        drive_reversed: bool,
    } optional {
    }
}

impl Parameters {
    /// `L = L1 + L2`, metres.
    #[must_use]
    pub fn wheelbase(&self) -> f64 {
        self.rear_to_antenna.get() + self.antenna_to_front.get()
    }
}

/// The ground. The default is level ground with normal grip.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ground {
    /// Steepness, 0 to 30 deg.
    pub slope: Angle,
    /// Direction of steepest descent, clockwise from north, -360 to 360 deg. Default 90 deg: the
    /// slope pulls a vehicle that drives north to its right.
    pub downhill: Angle,
    /// Whether the slope leans the vehicle, so that a high antenna is not above its place in the vehicle. Default false:
    /// the slope only pulls.
    pub leans: bool,
    /// Slip angle of the front tyres for a lateral force equal to the vehicle's weight, 0 to 60
    /// deg/g. Default 14 deg/g, a cornering coefficient of 4 per radian.
    pub front_slip: Compliance,
    /// The same for the rear tyres.
    pub rear_slip: Compliance,
    /// Share of the wheels' speed lost to longitudinal slip, 0 to 90 %. Default 0 %.
    pub wheel_slip: Ratio,
}

impl Default for Ground {
    fn default() -> Self {
        let slip = Compliance::new(Angle::degrees(14.0).get());
        Self {
            slope: Angle::degrees(0.0),
            downhill: Angle::degrees(90.0),
            leans: false,
            front_slip: slip,
            rear_slip: slip,
            wheel_slip: Ratio::new(0.0),
        }
    }
}

//! Constants of the robot and of the ground under it.

use serde::Deserialize;
use vehicle_model::manifest;

use super::State;
use crate::scenario::check::{between, within};
use crate::units::{Angle, Density, Length, Ratio};

/// The robot. The default is that of the thesis (2.2.1) and of its decisions where the thesis is
/// silent; those are inferred.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Length of the chassis, metres. Default 18 inches.
    pub length: f64,
    /// Width of the chassis, metres. Default 12 inches.
    pub width: f64,
    /// Distance of the left wheels' middle from that of the right ones, metres. Default 0.25 m
    /// (inferred: the width without half a tyre of 55 mm on either side).
    pub track: f64,
    /// Distance of two axles, metres. Default 0.15 m (inferred: tyres of 12 cm on a chassis with
    /// three axles).
    pub axle_spacing: f64,
    /// Mean speed of a wheel at full effort, metres per second. Default 2 m/s (inferred: a 34:1 gearbox
    /// on 12 V with tyres of 12 cm).
    pub top_speed: f64,
    /// Standard deviation of the single motors' speeds, as a share of the mean. Default 6 %:
    /// with it the thesis's law has the mean errors of its figures (2.2.4.3 says "highly variable").
    pub motor_spread: f64,
    /// Speed of each motor as a share of `top_speed`, left and right side, each from front to rear.
    /// Drawn from the seed if left out.
    pub motors: Option<[[f64; 3]; 2]>,
    /// Share of the effort that only overcomes the motors' friction. Default 5 % (inferred).
    pub friction: f64,
    /// Time constant of the wheels' speeds, seconds. Default 0.12 s (inferred).
    pub lag: f64,
    /// Share of its speed that a tyre loses for a force along it that equals its load. Default
    /// 0.25, the tyres of [`Ground`](crate::vehicle::Ground).
    pub slip_along: f64,
    /// Slip angle of a tyre for a lateral force that equals its load, radians. Default 14 deg, the tyres
    /// of [`Ground`](crate::vehicle::Ground).
    pub slip_across: f64,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            length: 0.4572,
            width: 0.3048,
            track: 0.25,
            axle_spacing: 0.15,
            top_speed: 2.0,
            motor_spread: 0.06,
            motors: None,
            friction: 0.05,
            lag: 0.12,
            slip_along: 0.25,
            slip_across: 14_f64.to_radians(),
        }
    }
}

impl Parameters {
    /// Those of a manifest's rover. What the manifest does not say has its default.
    #[must_use]
    pub fn of(rover: &manifest::Rover) -> Self {
        Self {
            length: rover.length.get(),
            width: rover.width.get(),
            track: rover.track.get(),
            axle_spacing: rover.axle_spacing.get(),
            top_speed: rover.motors.full_speed.get(),
            friction: rover.motors.dead_band.get(),
            lag: rover.motors.lag.get(),
            ..Self::default()
        }
    }
}

/// The ground under the robot: table `[terrain]`. The default is the level floor of a hall.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Terrain {
    /// Steepness, 0 to 30 deg.
    pub slope: Angle,
    /// Direction of steepest descent, to the right of the beginning of the row, -360 to 360 deg.
    /// Default 90 deg: the slope is across the row and pulls to the right.
    pub downhill: Angle,
    /// Mean share of the wheels' speed that is lost to slip, 0 to 90 %.
    pub slip: Ratio,
    /// Standard deviation of that share on either side by itself, 0 to 50 %.
    pub slip_spread: Ratio,
    /// Way for which the slip of a side stays the same, 1 cm to 100 m. Default 25 cm.
    pub slip_length: Length,
    /// How often the chassis tips from one pair of axles to the other, 0 to 100 /m. Default 2 /m (inferred
    /// from "frequently and randomly", thesis 2.2.2).
    pub tips: Density,
    /// Clods that a wheel meets, 0 to 20 /m.
    pub clods: Density,
    /// Standard deviation of the heading that a clod changes, 0 to 45 deg. Default 3 deg.
    pub clod_turn: Angle,
    /// Standard deviation of the way to the side that a clod moves the robot, 0 to 20 cm. Default
    /// 8 mm.
    pub clod_shift: Length,
}

impl Default for Terrain {
    fn default() -> Self {
        Self {
            slope: Angle::default(),
            downhill: Angle::degrees(90.0),
            slip: Ratio::default(),
            slip_spread: Ratio::default(),
            slip_length: Length::new(0.25),
            tips: Density::new(2.0),
            clods: Density::default(),
            clod_turn: Angle::degrees(3.0),
            clod_shift: Length::new(0.008),
        }
    }
}

impl Terrain {
    /// A field: clods, uneven grip, and a slope of 2 deg across the row (inferred from thesis 2.2.7,
    /// "uneven terrain").
    #[must_use]
    pub fn field() -> Self {
        Self {
            slope: Angle::degrees(2.0),
            slip: Ratio::new(0.1),
            slip_spread: Ratio::new(0.05),
            clods: Density::new(0.5),
            ..Self::default()
        }
    }

    /// Checks what a file says about the ground.
    ///
    /// # Errors
    /// The first value out of its range, as a phrase that begins with the field.
    pub fn check(&self) -> Result<(), String> {
        let degrees = |least, most| between(Angle::degrees(least), Angle::degrees(most));
        let shares = |most| between(Ratio::default(), Ratio::new(most));
        let lengths = |least, most| between(Length::new(least), Length::new(most));
        let densities = |most| between(Density::default(), Density::new(most));
        within("terrain.slope", self.slope, degrees(0.0, 30.0))?;
        within("terrain.downhill", self.downhill, degrees(-360.0, 360.0))?;
        within("terrain.slip", self.slip, shares(0.9))?;
        within("terrain.slip_spread", self.slip_spread, shares(0.5))?;
        within(
            "terrain.slip_length",
            self.slip_length,
            lengths(0.01, 100.0),
        )?;
        within("terrain.tips", self.tips, densities(100.0))?;
        within("terrain.clods", self.clods, densities(20.0))?;
        within("terrain.clod_turn", self.clod_turn, degrees(0.0, 45.0))?;
        within("terrain.clod_shift", self.clod_shift, lengths(0.0, 0.2))
    }
}

/// Where a distance sensor is mounted on the chassis and where it looks.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Mount {
    /// Aperture ahead of the chassis' middle, metres.
    pub ahead: f64,
    /// Aperture to the right of the chassis' middle, metres.
    pub right: f64,
    /// Direction of the beam, radians to the right of straight ahead.
    pub yaw: f64,
}

impl Mount {
    /// The sensor on the right of a manifest's rover.
    #[must_use]
    pub fn of(rover: &manifest::Rover) -> Self {
        Self {
            ahead: rover.sensors.ahead.get(),
            right: rover.sensors.beside.get(),
            yaw: -rover.sensors.angle.get(),
        }
    }

    /// The sensor on the other side, which looks to the other side.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self {
            right: -self.right,
            yaw: -self.yaw,
            ..*self
        }
    }

    /// The sensor on the right of the thesis's robot, which looks 45 degrees to the left and so measures
    /// the left row. The beams cross 7 inches ahead of the front edge (thesis 2.2.1), so the
    /// apertures are 0.026 m ahead of it (inferred).
    #[must_use]
    pub fn right() -> Self {
        Self {
            ahead: 0.2286 + 0.026,
            right: 0.152,
            yaw: -core::f64::consts::FRAC_PI_4,
        }
    }

    /// The sensor on the left, which measures the right row.
    #[must_use]
    pub fn left() -> Self {
        Self::right().mirrored()
    }

    /// The aperture, and the heading of the beam, of a robot in `state`: `x`, `y`, heading.
    #[must_use]
    pub fn beam(&self, state: &State) -> (f64, f64, f64) {
        let (s, c) = (libm::sin(state.heading), libm::cos(state.heading));
        (
            state.x + self.ahead * c - self.right * s,
            state.y + self.ahead * s + self.right * c,
            state.heading + self.yaw,
        )
    }
}

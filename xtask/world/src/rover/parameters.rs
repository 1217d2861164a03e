//! Constants of the robot and of the ground under it.

use super::State;

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
    /// Standard deviation of the single motors' speeds, as a share of the mean. Default 8 %
    /// (inferred from "highly variable", thesis 2.2.4.3).
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
            length: 18.0 * 0.0254,
            width: 12.0 * 0.0254,
            track: 0.25,
            axle_spacing: 0.15,
            top_speed: 2.0,
            motor_spread: 0.08,
            motors: None,
            friction: 0.05,
            lag: 0.12,
            slip_along: 0.25,
            slip_across: 14_f64.to_radians(),
        }
    }
}

/// The ground. The default is the level floor of a hall.
#[derive(Clone, Debug, PartialEq)]
pub struct Terrain {
    /// Steepness, radians.
    pub slope: f64,
    /// Direction of steepest descent, radians to the right of `x`. Default to the right, so that
    /// the slope is across the row.
    pub downhill: f64,
    /// Mean share of the wheels' speed that is lost to slip.
    pub slip: f64,
    /// Standard deviation of that share on either side by itself.
    pub slip_spread: f64,
    /// Way for which the slip of a side stays the same, metres. Default 0.25 m.
    pub slip_length: f64,
    /// Mean way after which the chassis tips from one pair of axles to the other, metres. Default
    /// 0.5 m (inferred from "frequently and randomly", thesis 2.2.2). Infinite for none.
    pub tip_length: f64,
    /// Clods that a wheel meets in a metre of way.
    pub clods: f64,
    /// Standard deviation of the heading that a clod changes, radians. Default 3 deg.
    pub clod_turn: f64,
    /// Standard deviation of the way to the side that a clod moves the robot, metres. Default 8 mm.
    pub clod_shift: f64,
}

impl Default for Terrain {
    fn default() -> Self {
        Self {
            slope: 0.0,
            downhill: core::f64::consts::FRAC_PI_2,
            slip: 0.0,
            slip_spread: 0.0,
            slip_length: 0.25,
            tip_length: 0.5,
            clods: 0.0,
            clod_turn: 3_f64.to_radians(),
            clod_shift: 0.008,
        }
    }
}

impl Terrain {
    /// A field: clods, uneven grip, and a slope of 2 deg across the row (inferred from thesis 2.2.7,
    /// "uneven terrain").
    #[must_use]
    pub fn field() -> Self {
        Self {
            slope: 2_f64.to_radians(),
            slip: 0.1,
            slip_spread: 0.05,
            clods: 0.5,
            ..Self::default()
        }
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
        let right = Self::right();
        Self {
            right: -right.right,
            yaw: -right.yaw,
            ..right
        }
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

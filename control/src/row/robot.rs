//! Settings derived from measurable facts of a robot and its rows.

use super::beams::{Beams, Mounting};
use super::controller::{RowSettings, RowSettingsError};
use super::law::RowLawSettings;
use super::settings::{Motion, Odds, Readings, RowEstimatorSettings, Rows};
use super::thesis::Sides;
use crate::calibration::{Actuator, Direction};
use crate::scalar::Scalar;

/// Measurable facts of a robot and the rows it follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowRobot {
    /// Where the sensors are mounted.
    pub mounting: Mounting<f64>,
    /// Smallest reading of an intact sensor, m.
    pub least: f64,
    /// Reading from which on no plant is within range, m.
    pub open: f64,
    /// Distance between left and right wheels as it acts in a turn, m. Wheels
    /// that slip sideways make it larger than it is by construction.
    pub track: f64,
    /// Time constant with which the wheels follow their command, s.
    pub lag: f64,
    /// Motors of both sides: speed of the wheels over ground (m/s) by effort.
    pub motors: Sides<Actuator<f64>>,
    /// Speed between the rows, m/s.
    pub cruise: f64,
    /// Distance between the stalks of both rows, m.
    pub width: f64,
    /// By how much that differs from row to row, as a standard deviation, m.
    pub tolerance: f64,
    /// Diameter of a stalk, m.
    pub stalk: f64,
    /// Length of the longest gap in both rows at once, m.
    pub gap: f64,
}

/// Standard deviation of the difference of both sides' speeds, as a share of the cruise
/// speed: 4.5 % are the motors', and the clocks of motor drivers that take pulses of 1.5 ms
/// for 1 % more or less change the effort of either side by up to 3 %.
fn uneven(robot: &RowRobot, fastest: f64) -> f64 {
    let pulses = 0.0245 * fastest / robot.cruise;
    libm::hypot(0.045, pulses)
}

impl<T: Scalar> RowSettings<T> {
    /// Settings for a robot. What is not among its facts was fitted to the field rows
    /// of the virtual robot (`xtask/world/examples/furrow_row.rs`) and is written here.
    ///
    /// # Errors
    /// [`RowSettingsError`] names the setting that is unusable.
    pub fn for_robot(robot: &RowRobot) -> Result<Self, RowSettingsError> {
        let lit = T::lit;
        let mounting = Mounting {
            ahead: lit(robot.mounting.ahead),
            beside: lit(robot.mounting.beside),
            angle: lit(robot.mounting.angle),
        };
        let beams = Beams::new(mounting).map_err(RowSettingsError::Mounting)?;
        let Sides { left, right } = robot.motors;
        let fastest = left.positive.full_rate.min(right.positive.full_rate);
        let settings = Self {
            estimator: RowEstimatorSettings {
                beams,
                rows: Rows {
                    half_width: lit(robot.width * 0.5),
                    tolerance: lit(robot.tolerance * 0.5),
                    // All rows of a field are about as far apart.
                    spacing: lit(robot.width),
                    width_way: lit(4.0),
                    // Stalks stand within about 2 cm of their line.
                    scatter: lit(0.02),
                    // And rows are as far apart within 3 cm.
                    far_scatter: lit(0.04),
                    // A bend is known after about 5 m.
                    bend_gain: lit(0.05),
                },
                readings: Readings {
                    least: lit(robot.least),
                    open: lit(robot.open),
                    agreement: lit(0.04),
                    // The beam is 6 mm wide; it crosses a stalk at 45 degrees, but seldom in its middle.
                    run: lit(robot.stalk + 0.006),
                    surface: lit(0.43),
                    leaf_way: lit(0.4),
                    // A stalk looks wider by what the robot drives while the sensor measures.
                    wide: lit(2.0 * (robot.stalk + 0.006)),
                    touching: lit(4.0),
                    // Rows with 0.5 leaves a metre, and with 6.
                    clear: Odds {
                        stalk: lit(0.9),
                        near: lit(0.33),
                        far: lit(0.02),
                    },
                    leafy: Odds {
                        stalk: lit(0.25),
                        near: lit(2.0),
                        far: lit(0.02),
                    },
                    doubt: lit(0.001),
                    fault_way: lit(0.6),
                    fresh_way: lit(1.0),
                },
                motion: Motion {
                    track: lit(robot.track),
                    wheel_speed: lit(fastest),
                    lag: lit(robot.lag),
                    // Uneven grip, and a clod every 2 m that turns the robot by 3 degrees.
                    heading_walk: lit(0.08),
                    offset_walk: lit(0.01),
                    turn_error: lit(0.07),
                    curvature: lit(uneven(robot, fastest) / robot.track),
                    curvature_way: lit(50.0),
                },
            },
            law: RowLawSettings {
                cruise: lit(robot.cruise),
                slow: lit(0.5),
                good: lit(0.03),
                poor: lit(0.15),
                settling: lit(0.09),
                lead: lit(0.6 * robot.lag),
                damping: lit(1.2),
                approach: lit(0.25),
                turn_rate: lit(2.0),
                wheel_speed: lit(fastest),
                track: lit(robot.track),
            },
            // Two plants beside a gap may be missing, and the last one be missed.
            end_way: lit(robot.gap + 0.6),
            lost_way: lit(robot.gap + 1.0),
            motors: Sides {
                left: converted(&left),
                right: converted(&right),
            },
        };
        settings.check()?;
        Ok(settings)
    }
}

fn converted<T: Scalar>(motor: &Actuator<f64>) -> Actuator<T> {
    let direction = |direction: &Direction<f64>| Direction {
        dead_band: T::lit(direction.dead_band),
        full_rate: T::lit(direction.full_rate),
    };
    Actuator {
        positive: direction(&motor.positive),
        negative: direction(&motor.negative),
    }
}

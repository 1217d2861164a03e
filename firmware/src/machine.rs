//! Facts about the machine that the shared modules need.
//!
//! The numbers are in the vehicle's manifest, from which the build script of the vehicle's
//! crate implements [`Machine`]. So the controller and the actuator nodes cannot disagree about
//! a limit.

use control::calibration::{Actuator, Potentiometer};
use control::controller::Settings;
use control::feedback::Limits;
use control::position::Position;

use crate::actuator::Command;
use crate::guide::Guidance;
use crate::steering::Law;

/// The numbers of a machine with a steered front axle and a driven rear axle.
pub trait Machine {
    /// Limits of the commands to the actuators: rad, rad/s, m/s.
    const LIMITS: Limits<f32>;
    /// Largest acceleration of the drive, m/s^2. Slowing down is not limited.
    const ACCELERATION: f32;
    /// The potentiometer of the steering. A reading beyond its ends is implausible.
    const POTENTIOMETER: Potentiometer<f32>;
    /// The steering actuator on its motor driver, rad/s.
    const STEERING: Actuator<f32>;
    /// The drive motor on its motor driver, m/s.
    const DRIVE: Actuator<f32>;
    /// Which way the motor driver's byte 255 turns: true means forward, or to the right.
    const FULL_BYTE_IS_FORWARD: bool;
    /// The ends of the line that an autonomous run follows.
    const ROUTE: [Position; 2];
    /// Time between two control steps, s: the basic cycle.
    const PERIOD: f32;
    /// Time from one position of the receiver to the next, s.
    const INTERVAL: f32;
    /// The settings of the control law.
    const SETTINGS: Settings<f32>;
    /// The law that steers.
    type Law: Law;
    /// Its own settings.
    const LAW: <Self::Law as Law>::Settings;
    /// What guides a run besides the path.
    type Guide: Guidance;
    /// Its settings.
    const GUIDE: <Self::Guide as Guidance>::Settings;
}

/// A command to steering and drive, as a network's message carries it.
pub trait MotionCommand: Command {
    /// Steering rate, rad/s, positive to the right.
    fn steering_rate(&self) -> f32;
    /// Speed, m/s.
    fn speed(&self) -> f32;
    /// Whether the vehicle moves in its current mode.
    fn is_driving_mode(&self) -> bool;
    /// Whether the steering may move.
    fn steering_enabled(&self) -> bool;
    /// Whether the drive may move.
    fn drive_enabled(&self) -> bool;
    /// Whether the vehicle is in an emergency stop.
    fn emergency_stop(&self) -> bool;
}

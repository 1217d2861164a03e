//! Computes the steering's calibration from a recorded drive.
//!
//! The potentiometer: while the steering is held and the vehicle moves, the antenna drives a
//! circle, and the radius of the circle gives the steering angle. The actuator: while a command is
//! constant, the potentiometer changes at a constant rate. The steering node's own arithmetic gives
//! the effort for that command.

use control::calibration::{
    Actuator, ActuatorFit, CircleFit, FitError, LineFit, Potentiometer, angle_on_circle,
};
use control::feedback::Limits;
use control::model::{Antenna, Geometry};
use firmware::{actuator::limited_effort, convert};
use serde::Serialize;
use vehicle_model::Vehicle;

use super::recording::{Command, Recording};

/// The constants of the machine that are compiled into the images of a drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Machine {
    geometry: Geometry<f64>,
    antenna: Antenna<f64>,
    limits: Limits<f32>,
    potentiometer: Potentiometer<f32>,
    actuator: Actuator<f32>,
    full_byte_is_forward: bool,
}

impl Machine {
    /// The constants of a vehicle; `None` if it has no machine.
    pub(super) fn of(vehicle: &Vehicle) -> Option<Self> {
        let description = vehicle_model::description(vehicle)?;
        let machine = vehicle.manifest().machine.as_ref()?;
        Some(Self {
            geometry: description.geometry,
            antenna: description.antenna,
            limits: vehicle_model::limits(machine),
            potentiometer: vehicle_model::potentiometer(machine),
            actuator: vehicle_model::steering(machine),
            full_byte_is_forward: machine.motor_driver.full_byte_is_forward,
        })
    }

    /// The motor driver's effort, -1 to 1, for a rate (rad/s) at a reading of the potentiometer.
    /// `None` if the node rejects the reading as implausible, or near an end stop, where the node
    /// slows its motor.
    fn effort(&self, rate: f64, count: u16) -> Option<f64> {
        let angle = self.potentiometer.angle(count).ok()?;
        let at = |angle| limited_effort(&self.limits, &self.actuator, rate as f32, angle);
        let effort = at(angle);
        if (effort - at(0.0)).abs() > 1e-3 {
            return None;
        }
        let byte = convert::motor_byte(effort, self.full_byte_is_forward);
        Some((f64::from(byte) - 127.0) / 127.0)
    }
}

/// Largest difference between two readings while the steering is held, counts: six standard
/// deviations of the noise to either side.
const STILL: u16 = 12;
/// Shortest time for which the steering must be held, s.
const HELD: f64 = 4.0;
/// Share of the readings, one in so many, that the next attempt to find a circle leaves out.
const ATTEMPTS: usize = 32;
/// Smallest arc of a circle that gives a radius, rad.
const ARC: f64 = 0.8;
/// Largest difference between the commands of one movement, degrees a second: noise of the
/// joystick.
const SAME_RATE: f64 = 0.3;
/// Smallest number of readings that give a rate.
const READINGS: usize = 5;
/// Largest residual of a movement's readings from a straight line, counts. It allows for noise and
/// for the unknown time of a sample within its period of 5 ms. Running into an end stop leaves a
/// larger residual.
const STRAIGHT: f64 = 6.0;
/// Rate below which the actuator counts as stationary, rad/s (0.3 degrees a second).
const STANDING: f64 = 0.005;
/// Smallest number of circles, and of movements in each direction.
const FEWEST: usize = 3;

/// A circle driven with the steering held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Circle {
    /// When it began, s from the beginning of the log.
    pub from: f64,
    /// Radius of the antenna's path, m, positive to the right.
    pub radius: f64,
    /// Steering angle for that radius, degrees, positive to the right.
    pub angle: f64,
    /// Mean of the potentiometer's readings.
    pub counts: f64,
}

/// A movement of the steering at one rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Movement {
    /// When it began, s from the beginning of the log.
    pub from: f64,
    /// Mean effort, -1 to 1.
    pub effort: f64,
    /// Rate, degrees a second.
    pub rate: f64,
}

/// The result of the fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Calibration {
    /// Reading of the potentiometer with the wheels straight, counts.
    pub centre: f64,
    /// Increase of the reading per degree to the right, counts.
    pub counts_per_degree: f64,
    /// Root mean square of the circles' residuals, degrees.
    pub angle_residual: f64,
    /// The actuator to the right.
    pub right: Side,
    /// The actuator to the left.
    pub left: Side,
    /// The circles.
    pub circles: Vec<Circle>,
    /// The movements.
    pub movements: Vec<Movement>,
    /// Lines of the log that are no frames of classical CAN: error frames and CAN FD frames.
    pub skipped: usize,
}

/// One direction of the actuator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Side {
    /// Largest share of the full effort that does not move the actuator.
    pub dead_band: f64,
    /// Rate at full effort, degrees a second.
    pub full_rate: f64,
    /// Root mean square of the residuals, degrees a second.
    pub residual: f64,
    /// Number of movements.
    pub movements: usize,
}

/// Fits the calibration.
///
/// # Errors
///
/// A sentence that says what is missing in the drive.
pub(super) fn fit(machine: &Machine, recording: &Recording) -> Result<Calibration, String> {
    let circles = circles(machine, recording);
    let [right, left] = [1.0, -1.0].map(|side| {
        let one = circles.iter().filter(|circle| circle.angle * side > 0.0);
        one.count()
    });
    if circles.len() < FEWEST || right == 0 || left == 0 {
        return Err(format!(
            "the steering was held on {right} circles to the right and {left} to the left: at \
             least {FEWEST} are needed, with both sides among them, each for {HELD} s and an \
             eighth of the circle"
        ));
    }
    let mut line = LineFit::new();
    for circle in &circles {
        line.add(circle.angle.to_radians(), circle.counts);
    }
    let potentiometer = Potentiometer::fit(&line, 0, u16::MAX)
        .map_err(|error| format!("the potentiometer: {error}"))?;
    let residual = |circle: &Circle| {
        let read = (circle.counts - potentiometer.centre) / potentiometer.counts_per_radian;
        read.to_degrees() - circle.angle
    };

    let movements = movements(machine, recording, potentiometer.counts_per_radian);
    let mut actuator = ActuatorFit::new(STANDING);
    for movement in &movements {
        actuator.add(movement.effort, movement.rate.to_radians());
    }
    for (side, name) in [(1.0, "right"), (-1.0, "left")] {
        let moving = of_side(&movements, side);
        if moving.is_empty() {
            return Err(format!("there is no motion of the steering to the {name}"));
        }
        if moving.len() < FEWEST {
            return Err(format!(
                "the steering moved to the {name} at {} rates: at least {FEWEST} are needed",
                moving.len()
            ));
        }
    }
    let actuator = actuator.solve().map_err(|error| match error {
        FitError::NoSpread => "the steering moved at one rate only".to_owned(),
        error => format!("the actuator: {error}"),
    })?;
    Ok(Calibration {
        centre: potentiometer.centre,
        counts_per_degree: potentiometer.counts_per_radian.to_radians(),
        angle_residual: root_mean_square(circles.iter().map(residual)),
        right: side(&actuator, &movements, 1.0),
        left: side(&actuator, &movements, -1.0),
        circles,
        movements,
        skipped: recording.skipped,
    })
}

/// The movements to one side that the fit uses.
fn of_side(movements: &[Movement], side: f64) -> Vec<Movement> {
    let used = movements.iter().filter(|movement| {
        let (effort, rate) = (movement.effort * side, movement.rate * side);
        effort > 0.0 && effort < 1.0 && rate > STANDING.to_degrees()
    });
    used.copied().collect()
}

fn side(actuator: &Actuator<f64>, movements: &[Movement], side: f64) -> Side {
    let direction = if side > 0.0 {
        actuator.positive
    } else {
        actuator.negative
    };
    let moving = of_side(movements, side);
    let residual =
        |movement: &Movement| actuator.rate(movement.effort).to_degrees() - movement.rate;
    Side {
        dead_band: direction.dead_band,
        full_rate: direction.full_rate.to_degrees(),
        residual: root_mean_square(moving.iter().map(residual)),
        movements: moving.len(),
    }
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// The times in which the steering was held and the vehicle drove an arc.
fn circles(machine: &Machine, recording: &Recording) -> Vec<Circle> {
    let mut circles = Vec::new();
    let mut rest = recording.pots.as_slice();
    while let Some(&(from, first)) = rest.first() {
        let (mut least, mut most) = (first, first);
        let held = rest.iter().take_while(|(_, count)| {
            least = least.min(*count);
            most = most.max(*count);
            most - least <= STILL
        });
        let length = held.count();
        let (held, after) = rest.split_at(length);
        let until = held.last().map_or(from, |(time, _)| *time);
        // The received data are older than their reception, so the first half second may show the
        // motion before the hold.
        if let Some(circle) = (until - from >= HELD)
            .then(|| circle(machine, recording, held, from + 0.5, until))
            .flatten()
        {
            circles.push(circle);
            rest = after;
        } else {
            // The steering may have settled only later. Each attempt leaves out a share of the
            // readings, so that the time grows in proportion to the log.
            let tried = until - from >= HELD;
            let skipped = if tried { length.div_ceil(ATTEMPTS) } else { 1 };
            rest = &rest[skipped..];
        }
    }
    circles
}

fn circle(
    machine: &Machine,
    recording: &Recording,
    held: &[(f64, u16)],
    from: f64,
    until: f64,
) -> Option<Circle> {
    let first = recording
        .positions
        .partition_point(|(time, ..)| *time < from);
    let ways = recording.positions[first..].iter();
    let places: Vec<(f64, f64)> = ways
        .take_while(|(time, ..)| *time <= until)
        .map(|(_, north, east)| (*north, *east))
        .collect();
    let mut fit = CircleFit::new();
    for (north, east) in &places {
        fit.add(*north, *east);
    }
    let found = fit.solve().ok()?;
    // Direction of a position as seen from the centre of the circle, clockwise positive.
    let around = |(north, east): (f64, f64)| (east - found.east).atan2(north - found.north);
    let turned: f64 = places
        .windows(2)
        .map(|pair| {
            let step = around(pair[1]) - around(pair[0]);
            step.sin().atan2(step.cos())
        })
        .sum();
    if turned.abs() < ARC {
        return None;
    }
    let radius = found.radius.copysign(turned);
    let angle = angle_on_circle(&machine.geometry, &machine.antenna, radius)?;
    let counts = held.iter().filter(|(time, _)| *time >= from);
    let counts: Vec<f64> = counts.map(|(_, count)| f64::from(*count)).collect();
    Some(Circle {
        from,
        radius,
        angle: angle.to_degrees(),
        counts: counts.iter().sum::<f64>() / counts.len().max(1) as f64,
    })
}

/// The movements with a constant commanded rate.
fn movements(machine: &Machine, recording: &Recording, counts_per_radian: f64) -> Vec<Movement> {
    let mut movements = Vec::new();
    let mut rest = recording.commands.as_slice();
    while let Some(&(from, first)) = rest.first() {
        let wanted = first.rate;
        let same = rest.iter().take_while(|(_, command)| {
            command.enabled && (command.rate - wanted).abs() <= SAME_RATE.to_radians()
        });
        let length = same.count().max(1);
        let (same, after) = rest.split_at(length);
        rest = after;
        if wanted == 0.0 || !first.enabled {
            continue;
        }
        movements.extend(movement(machine, recording, same, from, counts_per_radian));
    }
    movements
}

/// The movement during a sequence of equal commands.
fn movement(
    machine: &Machine,
    recording: &Recording,
    same: &[(f64, Command)],
    from: f64,
    counts_per_radian: f64,
) -> Option<Movement> {
    let mut efforts = 0.0;
    let mut line = LineFit::new();
    let mut readings = 0;
    for (number, (begun, command)) in same.iter().enumerate() {
        // A command applies until the next one, and the readings in between belong to its motion.
        // The last command counts for 0.15 s.
        let until = same.get(number + 1).map_or(begun + 0.15, |(next, _)| *next);
        let pots = recording.pots.iter();
        let during = pots.filter(|(time, _)| (*begun..until).contains(time));
        for (time, count) in during {
            let Some(effort) = machine.effort(command.rate, *count) else {
                continue;
            };
            efforts += effort;
            readings += 1;
            line.add(*time, f64::from(*count));
        }
    }
    if readings < READINGS {
        return None;
    }
    let line = line.solve().ok()?;
    if line.residual > STRAIGHT {
        return None;
    }
    Some(Movement {
        from,
        effort: efforts / readings as f64,
        rate: (line.slope / counts_per_radian).to_degrees(),
    })
}

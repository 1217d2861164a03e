//! From a recorded drive to the steering's calibration.
//!
//! The potentiometer: while the steering is held and the vehicle moves, the antenna runs on
//! a circle whose radius tells the steering angle. The actuator: while a command holds, the
//! potentiometer runs at a rate, and the steering node's own arithmetic says which effort
//! the command became.

use control::calibration::{
    Actuator, ActuatorFit, CircleFit, FitError, LineFit, Potentiometer, angle_on_circle,
};
use control::feedback::Limits;
use control::model::{Antenna, Geometry};
use firmware::{actuator::limited_effort, convert};
use serde::Serialize;
use vehicle_model::Vehicle;

use super::recording::{Command, Recording};

/// The numbers of the machine that the images of a drive were built with.
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
    /// Those of a vehicle; `None` when it has no machine.
    pub(super) fn of(vehicle: &Vehicle) -> Option<Self> {
        let description = vehicle_model::description(vehicle)?;
        let machine = vehicle.manifest().machine.as_ref()?;
        Some(Self {
            geometry: description.geometry,
            antenna: description.antenna,
            limits: vehicle_model::limits(machine),
            potentiometer: vehicle_model::potentiometer(&machine.potentiometer),
            actuator: vehicle_model::steering(machine),
            full_byte_is_forward: machine.motor_driver.full_byte_is_forward,
        })
    }

    /// The motor driver's effort, -1 to 1, that a rate (rad/s) becomes at a reading of the
    /// potentiometer. `None` where the reading is not believed, and near an end stop, where the
    /// node slows its motor.
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

/// Longest difference of two readings of a steering that is held, counts: six standard
/// deviations of the noise to either side.
const STILL: u16 = 12;
/// Shortest time that a steering is held, s.
const HELD: f64 = 4.0;
/// Least part of a circle from which its radius is taken, rad.
const ARC: f64 = 0.8;
/// Longest difference between commands of a movement at one rate, degrees a second: noise
/// of the joystick.
const SAME_RATE: f64 = 0.3;
/// Fewest readings that make a rate.
const READINGS: usize = 5;
/// What may remain of a movement's readings beside a line, counts: noise, and the moment of
/// the sample within its period of 5 ms. A steering that runs into its end stop leaves more.
const STRAIGHT: f64 = 6.0;
/// Rate below which the actuator counts as standing, rad/s (0.3 degrees a second).
const STANDING: f64 = 0.005;
/// Fewest circles, and fewest movements in each direction.
const FEWEST: usize = 3;

/// A circle driven with the steering held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Circle {
    /// When it began, s from the beginning of the log.
    pub from: f64,
    /// Radius of the antenna's way, m, positive to the right.
    pub radius: f64,
    /// The steering angle that drives it, degrees, positive right.
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

/// What the drive says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Calibration {
    /// Counts with the wheels straight.
    pub centre: f64,
    /// Counts for a degree to the right.
    pub counts_per_degree: f64,
    /// Root mean square of what remains at the circles, degrees.
    pub angle_residual: f64,
    /// The actuator to the right.
    pub right: Side,
    /// The actuator to the left.
    pub left: Side,
    /// The circles.
    pub circles: Vec<Circle>,
    /// The movements.
    pub movements: Vec<Movement>,
}

/// One direction of the actuator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Side {
    /// Share of the full effort that moves nothing.
    pub dead_band: f64,
    /// Rate at full effort, degrees a second.
    pub full_rate: f64,
    /// Root mean square of what remains, degrees a second.
    pub residual: f64,
    /// Number of movements.
    pub movements: usize,
}

/// Fits the calibration.
///
/// # Errors
///
/// A sentence that says what the drive lacks.
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

/// The stretches in which the steering was held and the vehicle drove an arc.
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
        // The data are of a moment before: what they say of the first half second is old.
        if let Some(circle) = (until - from >= HELD)
            .then(|| circle(machine, recording, held, from + 0.5, until))
            .flatten()
        {
            circles.push(circle);
            rest = after;
        } else {
            rest = &rest[1..];
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
    let ways = recording.positions.iter();
    let places: Vec<(f64, f64)> = ways
        .filter(|(time, ..)| (from..=until).contains(time))
        .map(|(_, north, east)| (*north, *east))
        .collect();
    let mut fit = CircleFit::new();
    for (north, east) in &places {
        fit.add(*north, *east);
    }
    let found = fit.solve().ok()?;
    // The angle that the way takes around the centre, clockwise positive.
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

/// The movements at one commanded rate.
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

/// The movement under commands that are all the same.
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
        // A command is in force until the next one; a reading in between is of its motion. The
        // first one's follows while the motion may only be beginning.
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

//! The steering commands, and whether the actuator's dead band swallows them.

use control::calibration::{Actuator, Potentiometer};
use control::feedback::Limits;
use firmware::{actuator::limited_effort, convert};
use vehicle_model::units::{CountKind, RateKind, factor};
use vehicle_model::{Device, Vehicle};

use super::{
    figures::{SteeringFigures, rounded},
    guidance::Place,
    series::Spread,
};
use crate::network::decode::{Decoder, Field};

/// The constants of the machine that are compiled into the steering node.
struct Machine {
    limits: Limits<f32>,
    potentiometer: Potentiometer<f32>,
    actuator: Actuator<f32>,
    full_byte_is_forward: bool,
}

impl Machine {
    fn of(vehicle: &Vehicle) -> Option<Self> {
        let machine = vehicle.manifest().machine.as_ref()?;
        Some(Self {
            limits: vehicle_model::limits(machine),
            potentiometer: vehicle_model::potentiometer(machine),
            actuator: vehicle_model::steering(machine),
            full_byte_is_forward: machine.motor_driver.full_byte_is_forward,
        })
    }

    /// Whether the actuator moves at a commanded rate (rad/s) and a steering angle (rad): the
    /// motor driver's byte is beyond the dead band.
    fn moves(&self, rate: f64, angle: f32) -> bool {
        let effort = limited_effort(&self.limits, &self.actuator, rate as f32, angle);
        let byte = convert::motor_byte(effort, self.full_byte_is_forward);
        let steps = (f32::from(byte) - 127.0) / 127.0;
        let effort = if self.full_byte_is_forward {
            steps
        } else {
            -steps
        };
        self.actuator.rate(effort) != 0.0
    }

    /// The smallest rate to one side that moves the actuator, in steps of the message's factor,
    /// degrees a second.
    fn moves_from(&self, side: f64) -> Option<f64> {
        let rates = (1..=1000).map(|step| f64::from(step) * 0.01);
        let mut moving = rates.filter(|rate| self.moves(side * rate.to_radians(), 0.0));
        moving.next()
    }
}

/// A command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Command {
    /// Time from the first frame, s.
    pub(super) at: f64,
    /// Commanded rate, degrees a second, positive to the right; 0 while the steering may not
    /// move.
    pub(super) rate: f64,
}

/// The commands and readings of the steering.
pub(super) struct Steering {
    machine: Machine,
    rate: Place,
    enabled: Field,
    pot: Place,
    /// Last reading, rad.
    angle: f32,
    pub(super) commands: Vec<Command>,
    /// Measured angles: seconds, degrees to the right.
    pub(super) angles: Vec<(f64, f64)>,
    enabled_rates: Spread,
    enabled_seconds: f64,
    last_enabled: Option<f64>,
    last_sign: Option<bool>,
    reversals: u64,
    zero: u64,
    within_dead_band: u64,
}

/// Longest time between two commands of one movement, s.
const TOGETHER: f64 = 1.0;

impl Steering {
    /// `None` if the manifest names no such signals.
    pub(super) fn new(vehicle: &Vehicle, decoder: &Decoder) -> Option<Self> {
        let manifest = vehicle.manifest();
        let named = manifest.calibration.as_ref()?;
        let enable = manifest
            .command
            .as_ref()?
            .enable
            .get(&Device::SteeringMotor)?;
        let rate = Place::find(decoder, &named.steering_rate, factor::<RateKind>)?;
        Some(Self {
            machine: Machine::of(vehicle)?,
            enabled: decoder.message(rate.id)?.field(enable)?.clone(),
            rate,
            pot: Place::find(decoder, &named.potentiometer, factor::<CountKind>)?,
            angle: 0.0,
            commands: Vec::new(),
            angles: Vec::new(),
            enabled_rates: Spread::default(),
            enabled_seconds: 0.0,
            last_enabled: None,
            last_sign: None,
            reversals: 0,
            zero: 0,
            within_dead_band: 0,
        })
    }

    /// Takes a data frame of the network.
    pub(super) fn take(&mut self, at: f64, id: u16, data: &[u8; 8]) {
        if id == self.pot.id {
            let counts = self.pot.value(data).clamp(0.0, 65535.0) as u16;
            if let Ok(angle) = self.machine.potentiometer.angle(counts) {
                self.angle = angle;
                self.angles.push((at, f64::from(angle).to_degrees()));
            }
        }
        if id == self.rate.id {
            let enabled = self.enabled.raw(data) != 0;
            let rate = if enabled { self.rate.value(data) } else { 0.0 };
            self.commands.push(Command {
                at,
                rate: rate.to_degrees(),
            });
            if enabled {
                self.command(at, rate);
            } else {
                (self.last_enabled, self.last_sign) = (None, None);
            }
        }
    }

    /// A command that lets the steering move.
    fn command(&mut self, at: f64, rate: f64) {
        self.enabled_rates.add(rate.to_degrees());
        let since = self.last_enabled.map(|last| at - last);
        self.enabled_seconds += since
            .filter(|since| (0.0..TOGETHER).contains(since))
            .unwrap_or(0.0);
        self.last_enabled = Some(at);
        if rate == 0.0 {
            self.zero += 1;
            return;
        }
        let right = rate > 0.0;
        self.reversals += u64::from(self.last_sign.is_some_and(|last| last != right));
        self.last_sign = Some(right);
        self.within_dead_band += u64::from(!self.machine.moves(rate, self.angle));
    }

    /// The figures; `None` without a command.
    pub(super) fn figures(&self) -> Option<SteeringFigures> {
        if self.commands.is_empty() {
            return None;
        }
        let rates = &self.enabled_rates;
        let three = |value: Option<f64>| value.map(|value| rounded(value, 3));
        let largest = rates.least().zip(rates.greatest());
        let reversals = self.reversals as f64 / self.enabled_seconds;
        Some(SteeringFigures {
            commands: self.commands.len() as u64,
            enabled: rates.count(),
            zero: self.zero,
            mean_rate_deg_s: three(rates.mean()),
            deviation_deg_s: three(rates.deviation()),
            largest_rate_deg_s: three(largest.map(|(least, most)| least.abs().max(most.abs()))),
            reversals_per_second: three((self.enabled_seconds > 0.0).then_some(reversals)),
            within_dead_band: self.within_dead_band,
            moves_right_from_deg_s: three(self.machine.moves_from(1.0)),
            moves_left_from_deg_s: three(self.machine.moves_from(-1.0)),
        })
    }
}

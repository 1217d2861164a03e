//! A run without bus, boards and images: receiver, estimator, law and actuators are connected
//! directly. This is about a hundred times as fast.
//!
//! Kept as on the vehicle: the receiver's bytes and their parser, the age of the data when the
//! control step is released, the command's resolution and its delay to the motors, the motor
//! drivers' bytes, and the end stops. No message is lost or late here. Use it to explore; the
//! figures of a report come from the images.

use control::{
    calibration::{Actuator, Potentiometer},
    controller::{Controller, Outcome, Sample, Settings},
    feedback::Limits,
    line::Line,
    plain::PlainController,
    position::{Position, Velocity},
    safety,
};
use firmware::{
    actuator::{effort, limited_effort, limited_speed},
    convert,
    navigation::{Station, Step, Update},
};
use network_model::worst_case_bits;
use vehicle_model::{
    Vehicle,
    manifest::{self, Waypoint},
};
use world::time::{PER_SECOND, Span as _};
use world::{
    Analog, Device, Effect, NodeIndex, Scenario, SimDuration, SimTime, World,
    report::{ModeChange, Run},
    scenario::Button,
    time::{after, at, from_seconds},
};

use super::measure::{Figures, SteeringRate};
use super::{Error, needed};

/// A steering law.
pub trait Law {
    /// The control step of a basic cycle.
    fn step(&mut self, sample: &Sample<f32>) -> Outcome<f32>;
}

impl Law for Controller<f32> {
    fn step(&mut self, sample: &Sample<f32>) -> Outcome<f32> {
        Controller::step(self, sample)
    }
}

impl Law for PlainController<f32> {
    fn step(&mut self, sample: &Sample<f32>) -> Outcome<f32> {
        PlainController::step(self, sample)
    }
}

const fn micros(count: u64) -> SimDuration {
    SimDuration::from_ticks(count * 1_000_000)
}

/// A byte to a motor driver at 38400 baud.
const MOTOR_BYTE: SimDuration = micros(260);
/// Time between two bytes to a motor driver.
const MOTOR_PERIOD: SimDuration = micros(10_000);
/// Age of the potentiometer's sample when its window begins: half a period of the
/// converter on average.
const POT_AGE: SimDuration = micros(2_500);
/// Time from the end of the command's frame until the actuator nodes act on it, us.
const REACTION_US: u64 = 10;

/// Instants of a basic cycle, from its start.
#[derive(Clone, Copy, Debug)]
struct Times {
    /// Length of the basic cycle.
    cycle: SimDuration,
    /// Window of the potentiometer's message.
    pot: SimDuration,
    /// Release of the control step.
    release: SimDuration,
    /// Until the actuator nodes have the command.
    command: SimDuration,
}

/// A vehicle's numbers, as the constants of its images.
#[derive(Clone, Debug)]
pub struct Numbers {
    settings: Settings<f32>,
    /// Gains of the thesis's law.
    gains: [f32; 3],
    line: Line<f32>,
    limits: Limits<f32>,
    /// Largest acceleration, m/s2.
    acceleration: f32,
    steering: Actuator<f32>,
    drive: Actuator<f32>,
    potentiometer: Potentiometer<f32>,
    full_byte_is_forward: bool,
    /// Length of the basic cycle, s.
    period: f32,
    times: Times,
    /// By then the first burst of the receiver is over, whatever its phase.
    listened: SimDuration,
    /// From the end of a burst to the next basic cycle.
    lead: SimDuration,
    /// Nodes of steering and drive.
    motors: [(NodeIndex, Device); 2],
}

impl Numbers {
    /// The numbers of a vehicle, from its manifest and its network.
    ///
    /// # Errors
    ///
    /// The manifest lacks something that the vehicle needs to drive by itself.
    pub fn of(vehicle: &Vehicle) -> Result<Self, Error> {
        let manifest = vehicle.manifest();
        let machine = needed(vehicle, "[machine]", manifest.machine.as_ref())?;
        let receiver = needed(vehicle, "[receiver]", manifest.receiver.as_ref())?;
        let description = vehicle_model::description(vehicle);
        let description = needed(vehicle, "[machine]", description)?;
        let [from, to] = manifest.waypoints.as_slice() else {
            return Err(Error::lacks(vehicle, "[[waypoint]]"));
        };
        let motor = |device: Device| {
            let node = vehicle.node_of(device).map(|node| (node, device));
            needed(vehicle, device.name(), node)
        };
        let half_period = receiver.period.get() / 2.0;
        let first_burst = receiver.period.get() + receiver.latency.get() + receiver.burst.get();
        Ok(Self {
            settings: Settings::for_vehicle(&description)?,
            gains: machine.thesis.array().map(|gain| gain as f32),
            line: Line::new(waypoint(from), waypoint(to))?,
            limits: vehicle_model::limits(machine),
            acceleration: machine.limits.acceleration.get() as f32,
            steering: vehicle_model::steering(machine),
            drive: vehicle_model::drive(machine),
            potentiometer: vehicle_model::potentiometer(machine),
            full_byte_is_forward: machine.motor_driver.full_byte_is_forward,
            period: vehicle.network().basic_cycle_us as f32 * 1e-6,
            times: times(vehicle)?,
            listened: from_seconds((first_burst / half_period).ceil() * half_period),
            lead: receiver.lead.span(),
            motors: [motor(Device::SteeringMotor)?, motor(Device::DriveMotor)?],
        })
    }

    /// The settings of the law.
    #[must_use]
    pub fn settings(&self) -> &Settings<f32> {
        &self.settings
    }

    /// Length of the basic cycle, s.
    #[must_use]
    pub fn period(&self) -> f32 {
        self.period
    }

    /// Cycle time at which the control step is released, s.
    #[must_use]
    pub fn release(&self) -> f32 {
        world::time::span_seconds(self.times.release) as f32
    }

    /// Furrow's law, or the thesis's with the same settings.
    ///
    /// # Errors
    ///
    /// A setting is unusable.
    pub fn law(&self, law: manifest::Law) -> Result<Box<dyn Law>, Error> {
        let (settings, line) = (self.settings, self.line);
        Ok(match law {
            manifest::Law::Thesis => Box::new(PlainController::new(self.gains, settings, line)?),
            manifest::Law::Furrow => Box::new(Controller::new(settings, line)?),
        })
    }
}

/// A waypoint, to the millimetre as in the images.
fn waypoint(point: &Waypoint) -> Position {
    let millimetres = |length: f64| (length * 1000.0).round() as i32;
    Position::new(
        millimetres(point.north.get()),
        millimetres(point.east.get()),
    )
}

/// When things happen in a basic cycle of a vehicle.
fn times(vehicle: &Vehicle) -> Result<Times, Error> {
    let network = vehicle.network();
    let command = SteeringRate::of(vehicle)?.message;
    let start = u64::from(command.window.start_us);
    let release = network.release_us(command).map_or(start, u64::from);
    let path = vehicle.manifest().calibration.as_ref();
    let path = path.map(|calibration| &calibration.potentiometer.message);
    let mut messages = network.messages.iter();
    let pot = messages.find(|message| Some(&message.name) == path);
    let pot = needed(vehicle, "calibration.potentiometer", pot)?;
    let frame = network.bits_to_us(worst_case_bits(command.length));
    Ok(Times {
        cycle: micros(u64::from(network.basic_cycle_us)),
        // A window behind the step's release serves the next step, which then reads it late.
        pot: micros(u64::from(pot.window.start_us).min(release)),
        release: micros(release),
        command: micros(start + u64::from(frame) + REACTION_US),
    })
}

/// A command to the actuators, as its frame carries it: rad/s and m/s, rounded to the
/// resolution of [`convert`].
#[derive(Clone, Copy, Debug)]
struct Command {
    rate: f32,
    speed: f32,
    /// Whether the motors may turn.
    enabled: bool,
}

impl Command {
    fn of(applied: safety::Command<f32>, enabled: bool) -> Self {
        let rate = convert::centidegrees_per_second(applied.steering_rate);
        let speed = convert::centimetres_per_second(applied.speed);
        Self {
            rate: convert::from_centidegrees_per_second(rate),
            speed: convert::from_centimetres_per_second(speed),
            enabled,
        }
    }
}

/// The state of a run.
struct Loop<'a> {
    numbers: &'a Numbers,
    world: World,
    station: Station,
    position: Option<Position>,
    velocity: Option<Velocity>,
    heard: SimTime,
    /// The drive's speed, as far as its acceleration is limited, m/s.
    speed: f32,
    command: Option<Command>,
}

impl Loop<'_> {
    /// Lets the world run up to `to` and reads the receiver's bytes.
    fn advance(&mut self, to: SimTime) {
        self.world.advance_to(to);
        let Self {
            world,
            station,
            position,
            velocity,
            heard,
            ..
        } = self;
        while let Some(output) = world.poll() {
            let Effect::Byte {
                device: Device::SatelliteReceiver,
                byte,
                ..
            } = output.what
            else {
                continue;
            };
            *heard = output.at;
            station.take([byte].into_iter());
            let mut more = Step::More;
            while more == Step::More {
                more = station.step(0, |update| match update {
                    Update::Position(news) => *position = news,
                    Update::Velocity(news) => *velocity = news,
                    Update::Heading(_) | Update::Latitude(_) | Update::Longitude(_) => {}
                });
            }
        }
    }

    /// The converter's latest count when a control step begins.
    fn potentiometer(&mut self) -> u16 {
        let sampled = SimTime::from_ticks(self.world.now().as_ticks() - POT_AGE.as_ticks());
        let moved = self
            .world
            .machine()
            .map_or(sampled, world::vehicle::Vehicle::now);
        self.world.adc(Analog::SteeringPot, sampled.max(moved))
    }

    /// Commands both motors.
    fn motors(&mut self, now: SimTime) {
        let numbers = self.numbers;
        let count = self.world.adc(Analog::SteeringPot, now);
        let byte = |effort| convert::motor_byte(effort, numbers.full_byte_is_forward);
        let angle = numbers.potentiometer.angle(count).ok();
        let command = self.command.filter(|command| command.enabled);
        let steering = match (command, angle) {
            (Some(Command { rate, .. }), Some(angle)) => {
                limited_effort(&numbers.limits, &numbers.steering, rate, angle)
            }
            _ => 0.0,
        };
        let limit = numbers.limits.speed;
        let wanted = command.map_or(0.0, |command| command.speed.clamp(-limit, limit));
        let period = MOTOR_PERIOD.as_ticks() as f32 * 1e-12;
        self.speed = limited_speed(self.speed, wanted, numbers.acceleration, period);
        let drive = effort(&numbers.drive, self.speed);
        for (node, _) in numbers.motors {
            self.world.relay(node, true, now);
        }
        let end = after(now, MOTOR_BYTE);
        for ((node, device), effort) in numbers.motors.into_iter().zip([steering, drive]) {
            self.world.serial(node, device, byte(effort), now, end);
        }
    }
}

/// A finished run.
pub struct Record {
    scenario: Scenario,
    seed: u64,
    cycle: SimDuration,
    bit_time: SimDuration,
    /// The world at the end of the run.
    pub world: World,
    /// When each command took effect, and its steering rate, rad/s.
    rates: Vec<(SimTime, f64)>,
    modes: Vec<ModeChange>,
}

impl Record {
    /// The figures, `None` when the vehicle never drove by itself.
    pub fn figures(&self) -> Option<Figures> {
        Figures::of(&self.run(), self.rates.iter().copied())
    }

    /// The recordings as the report wants them.
    pub fn run(&self) -> Run<'_> {
        Run {
            scenario: &self.scenario,
            nodes: &[],
            seed: self.seed,
            duration: self.scenario.duration.span(),
            states: self.world.states(),
            efforts: self.world.efforts(),
            frames: &[],
            windows: &[],
            cycle_count_byte: 0,
            basic_cycle: self.cycle,
            bit_time: self.bit_time,
            modes: &self.modes,
            tasks: &[],
            rover: None,
            crop: None,
            mission: None,
        }
    }
}

/// When the vehicle begins to drive by itself: at the second press of button C. The first one
/// makes it ready.
fn engaged(scenario: &Scenario) -> Option<SimTime> {
    let presses = scenario.press.iter();
    let mut starts = presses.filter(|press| press.button == Button::C);
    starts.nth(1).map(|press| at(press.at.span()))
}

/// Drives `scenario` with `law`; `watch` sees each step.
pub fn drive(
    vehicle: &Vehicle,
    numbers: &Numbers,
    scenario: &Scenario,
    seed: u64,
    law: &mut dyn Law,
    mut watch: impl FnMut(&World, &Sample<f32>, &Outcome<f32>),
) -> Record {
    let Times {
        cycle,
        pot,
        release,
        command: way,
    } = numbers.times;
    let mut all = Loop {
        numbers,
        world: World::new(vehicle, scenario, seed),
        station: Station::new(),
        position: None,
        velocity: None,
        heard: at(micros(0)),
        speed: 0.0,
        command: None,
    };
    let end = at(scenario.duration.span());
    // The receiver's node begins the schedule at a fixed time after the first burst.
    all.advance(at(numbers.listened));
    let mut begin = after(all.heard, numbers.lead);
    let engaged = engaged(scenario);
    let mut applied = safety::Command::still();
    let mut rates = Vec::new();
    while after(begin, cycle) < end {
        all.advance(after(begin, pot));
        let count = all.potentiometer();
        let now = after(begin, release);
        all.advance(now);
        let engaged = engaged.is_some_and(|engaged| now >= engaged);
        let sample = Sample {
            position: all.position.take(),
            velocity: all.velocity.take(),
            steering_angle: numbers.potentiometer.angle(count).ok(),
            applied,
            engaged,
            dt: numbers.period,
        };
        let outcome = law.step(&sample);
        watch(&all.world, &sample, &outcome);
        applied = if engaged {
            outcome.command
        } else {
            safety::Command::still()
        };
        let command = Command::of(applied, engaged);
        all.command = Some(command);
        let mut motors = after(begin, way);
        rates.push((motors, f64::from(command.rate)));
        begin = after(begin, cycle);
        let next = after(begin, way);
        while motors < next {
            all.advance(motors);
            all.motors(motors);
            motors = after(motors, MOTOR_PERIOD);
        }
    }
    all.advance(end);
    let modes = engaged.map(|at| ModeChange {
        at,
        mode: "AutonomousRun".into(),
        autonomous: true,
    });
    Record {
        scenario: scenario.clone(),
        seed,
        cycle,
        bit_time: SimDuration::from_ticks(PER_SECOND / u64::from(vehicle.network().bit_rate)),
        world: all.world,
        rates,
        modes: modes.into_iter().collect(),
    }
}

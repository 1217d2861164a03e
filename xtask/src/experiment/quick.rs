//! A run without bus, boards and images: receiver, estimator, law and actuators are connected
//! directly. This is about a hundred times as fast.
//!
//! Kept as on the vehicle: the receiver's bytes and their parser, the age of the data when the
//! control step is released, the command's resolution and its delay to the motors, the motor
//! drivers' bytes, and the end stops. No message is lost or late here. Use it to explore; the
//! figures of a report come from the images.

use control::{
    controller::{Controller, Outcome, Sample, Settings},
    line::Line,
    plain::PlainController,
    position::{Position, Velocity},
    safety,
};
use firmware::{
    actuator::{Drive, steering_effort},
    convert,
    navigation::{Station, Step, Update},
};
use network::Message as _;
use uagv::{
    Uagv, design, matrix,
    messages::{CentidegreesPerSecond, CentimetresPerSecond, Command, Mode},
};
use vehicle_model::Vehicle;
use world::time::Span as _;
use world::{
    Analog, Device, Effect, NodeIndex, Scenario, SimDuration, SimTime, World,
    report::{FrameRecord, ModeChange, Run},
    time::{after, at},
};

use super::Error;
use super::measure::Figures;

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

/// The firmware's settings of the control law.
#[must_use]
pub fn settings() -> Settings<f32> {
    design::SETTINGS
}

/// The line of the firmware's waypoints.
///
/// # Errors
///
/// The waypoints are no line.
pub fn line() -> Result<Line<f32>, Error> {
    let [from, to] = design::ROUTE;
    Ok(Line::new(from, to)?)
}

/// Furrow's law with `settings`, or the thesis's.
///
/// # Errors
///
/// A setting is unusable.
pub fn law(settings: &Settings<f32>, plain: bool) -> Result<Box<dyn Law>, Error> {
    Ok(if plain {
        Box::new(PlainController::new(*settings, line()?)?)
    } else {
        Box::new(Controller::new(*settings, line()?)?)
    })
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
/// Time from the start of the command's window until the actuator nodes have its frame.
const COMMAND_WAY: SimDuration = micros(550);
/// When the joystick's button takes effect: the second press of the scenarios.
const ENGAGED: SimDuration = micros(1_500_000);

/// The state of a run.
struct Loop {
    world: World,
    /// Steering and drive.
    motors: [(NodeIndex, Device); 2],
    station: Station,
    position: Option<Position>,
    velocity: Option<Velocity>,
    heard: SimTime,
    drive: Drive<Uagv>,
    command: Option<Command>,
}

impl Loop {
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
        let count = self.world.adc(Analog::SteeringPot, now);
        let byte = |effort| convert::motor_byte(effort, design::FULL_BYTE_IS_FORWARD);
        let angle = design::POTENTIOMETER.angle(count).ok();
        let command = self.command.as_ref();
        let steering = byte(steering_effort::<Uagv>(command, angle));
        let period = MOTOR_PERIOD.as_ticks() as f32 * 1e-12;
        let drive = byte(self.drive.effort(command, period));
        for (node, _) in self.motors {
            self.world.relay(node, true, now);
        }
        let end = after(now, MOTOR_BYTE);
        for ((node, device), byte) in self.motors.into_iter().zip([steering, drive]) {
            self.world.serial(node, device, byte, now, end);
        }
    }
}

/// A finished run: the world at its end and the frames that the report reads.
pub struct Record {
    scenario: Scenario,
    seed: u64,
    /// The world at the end of the run.
    pub world: World,
    /// The command frames.
    pub frames: Vec<FrameRecord>,
    modes: [ModeChange; 1],
}

impl Record {
    /// The figures, `None` when the vehicle never drove by itself.
    pub fn figures(&self) -> Option<Figures> {
        Figures::of(&self.run())
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
            frames: &self.frames,
            windows: &[],
            basic_cycle: cycle(),
            bit_time: micros(4),
            modes: &self.modes,
            tasks: &[],
        }
    }
}

fn cycle() -> SimDuration {
    micros(u64::from(matrix::BASIC_CYCLE.ticks()))
}

/// The frame that asks the actuators for `applied`.
fn command(applied: safety::Command<f32>, engaged: bool) -> Command {
    Command {
        steering_rate: CentidegreesPerSecond(convert::centidegrees_per_second(
            applied.steering_rate,
        )),
        speed: CentimetresPerSecond(convert::centimetres_per_second(applied.speed)),
        mode: if engaged {
            Mode::AutonomousRun
        } else {
            Mode::AutonomousReady
        },
        steering_enabled: engaged,
        drive_enabled: engaged,
        emergency_stop: false,
        counter: 0,
        check: 0,
    }
}

/// Drives `scenario` with `law`; `watch` sees each step.
///
/// # Errors
///
/// The vehicle lacks one of the two motors.
pub fn drive(
    vehicle: &Vehicle,
    scenario: &Scenario,
    seed: u64,
    law: &mut dyn Law,
    mut watch: impl FnMut(&World, &Sample<f32>, &Outcome<f32>),
) -> Result<Record, Error> {
    let motor = |device| {
        let node = vehicle.node_of(device);
        node.map(|node| (node, device)).ok_or(Error::NoMotor)
    };
    let mut all = Loop {
        world: World::new(vehicle, scenario, seed),
        motors: [motor(Device::SteeringMotor)?, motor(Device::DriveMotor)?],
        station: Station::new(),
        position: None,
        velocity: None,
        heard: at(micros(0)),
        drive: Drive::new(),
        command: None,
    };
    let end = at(scenario.duration.span());
    // The gps node begins the schedule at a fixed time after the first burst.
    all.advance(at(micros(150_000)));
    let lead = micros(u64::from(design::RECEIVER_LEAD.ticks()));
    let mut begin = after(all.heard, lead);
    let mut applied = safety::Command::still();
    let mut frames = Vec::new();
    let release = micros(u64::from(design::CONTROL_RELEASE.ticks()));
    while after(begin, cycle()) < end {
        all.advance(after(begin, micros(6_000)));
        let count = all.potentiometer();
        let now = after(begin, release);
        all.advance(now);
        let engaged = now >= at(ENGAGED);
        let sample = Sample {
            position: all.position.take(),
            velocity: all.velocity.take(),
            steering_angle: design::POTENTIOMETER.angle(count).ok(),
            applied,
            engaged,
            dt: 0.1,
        };
        let outcome = law.step(&sample);
        watch(&all.world, &sample, &outcome);
        applied = if engaged {
            outcome.command
        } else {
            safety::Command::still()
        };
        let command = command(applied, engaged);
        all.command = Some(command);
        let mark = after(begin, micros(7_000));
        let mut motors = after(mark, COMMAND_WAY);
        frames.push(FrameRecord {
            id: Command::ID,
            dlc: 8,
            data: command.encode(),
            start: mark,
            end: motors,
            complete: true,
        });
        begin = after(begin, cycle());
        while motors < after(begin, micros(7_000)) {
            all.advance(motors);
            all.motors(motors);
            motors = after(motors, MOTOR_PERIOD);
        }
    }
    all.advance(end);
    Ok(Record {
        scenario: scenario.clone(),
        seed,
        world: all.world,
        frames,
        modes: [ModeChange {
            at: at(ENGAGED),
            mode: "AutonomousRun".into(),
            autonomous: true,
        }],
    })
}

//! The constants that a vehicle's images are built with.

use std::fmt::Write as _;

use control::calibration::{self, Actuator};
use control::controller::Settings;
use control::demand::DemandSettings;
use control::design::SteeringWeights;
use control::feedback::Limits;
use control::model::{Antenna, Geometry};
use control::row::{self, Mounting, RowRobot, RowSettings, RowSettingsError, Sides};
use control::takeover::TakeoverSettings;
use control::vehicle::{self, Description, Refusal};

use crate::error::VehicleError;
use crate::manifest::{
    BackupMaster, BusGuardian, Device, Direction, DistanceSensors, Law, Machine, Manifest, Mission,
    Planner, Receiver, RegulatorWeights, Remote, Rover, RowGuidance, Safety, ThesisLaw, Waypoint,
};
use crate::units::{
    AccelerationKind, AngleKind, Kind, LengthKind, Quantity, RateKind, SpeedKind, TimeKind,
};
use crate::vehicle::Vehicle;

/// A rover and its rows as the control law knows them.
#[must_use]
pub fn robot(rover: &Rover) -> RowRobot {
    let direction = calibration::Direction {
        dead_band: rover.motors.dead_band.get(),
        full_rate: rover.motors.full_speed.get(),
    };
    let motor = Actuator {
        positive: direction,
        negative: direction,
    };
    RowRobot {
        mounting: mounting(&rover.sensors),
        least: rover.sensors.least.get(),
        open: rover.sensors.open.get(),
        track: rover.turning_track.get(),
        lag: rover.motors.lag.get(),
        motors: Sides {
            left: motor,
            right: motor,
        },
        cruise: rover.cruise.get(),
        width: rover.rows.width.get(),
        tolerance: rover.rows.tolerance.get(),
        stalk: rover.rows.stalk.get(),
        gap: rover.rows.gap.get(),
    }
}

/// A machine between its rows as the estimator knows it: it takes speed and turn rate as they are
/// measured.
fn between_rows(machine: &Machine, guidance: &RowGuidance) -> RowRobot {
    let direction = calibration::Direction {
        dead_band: 0.0,
        full_rate: machine.limits.speed.get(),
    };
    let motor = Actuator {
        positive: direction,
        negative: direction,
    };
    let rows = &guidance.rows;
    RowRobot {
        mounting: mounting(&guidance.sensors),
        least: guidance.sensors.least.get(),
        open: guidance.sensors.open.get(),
        track: 1.0,
        lag: 0.0,
        motors: Sides {
            left: motor,
            right: motor,
        },
        cruise: guidance.speed.get(),
        width: rows.width.get(),
        tolerance: rows.tolerance.get(),
        stalk: rows.stalk.get(),
        gap: rows.gap.get(),
    }
}

fn mounting(sensors: &DistanceSensors) -> Mounting<f64> {
    Mounting {
        ahead: sensors.ahead.get(),
        beside: sensors.beside.get(),
        angle: sensors.angle.get(),
    }
}

/// Settings of the takeover by rows.
fn takeover(guidance: &RowGuidance) -> TakeoverSettings<f32> {
    TakeoverSettings {
        speed: single(guidance.speed),
        longest_age: single(guidance.longest_age),
        longest_way: single(guidance.longest_way),
        settle: single(guidance.settle),
        take_back: single(guidance.take_back),
        half_width: single(guidance.rows.width) * 0.5,
        tolerance: single(guidance.rows.tolerance) * 0.5,
    }
}

/// Settings of the law that obeys a planner.
fn demands(planner: &Planner) -> DemandSettings<f32> {
    DemandSettings {
        longest_age: single(planner.longest_age),
        lateral: single(planner.lateral_acceleration),
    }
}

/// The vehicle data from which the control law is designed; `None` for a vehicle without a
/// machine.
#[must_use]
pub fn description(vehicle: &Vehicle) -> Option<Description> {
    let manifest = vehicle.manifest();
    let machine = manifest.machine.as_ref()?;
    let limits = &machine.limits;
    let receiver = manifest.receiver.as_ref();
    Some(Description {
        geometry: Geometry {
            l1: machine.rear_to_antenna.get(),
            l2: machine.antenna_to_front.get(),
        },
        antenna: Antenna {
            right: machine.antenna_right.get(),
            height: machine.antenna_height.get(),
        },
        limits: Limits {
            steering_angle: limits.steering_angle.get(),
            steering_rate: limits.steering_rate.get(),
            speed: limits.speed.get(),
        },
        cruise: machine.cruise.get(),
        period: f64::from(vehicle.network().basic_cycle_us) * 1e-6,
        sensors: vehicle::Sensors {
            position: machine.sensors.position.get(),
            velocity: machine.sensors.velocity.get(),
            steering: machine.sensors.steering.get(),
            age: receiver.map_or(0.0, |receiver| {
                let burst = receiver.latency.get() + receiver.burst.get();
                burst + receiver.lead.get() + control_release(vehicle)
            }),
            interval: receiver.map_or(0.1, |receiver| receiver.period.get()),
        },
        drive_lag: machine.drive.lag.get(),
        acceleration: limits.acceleration.get(),
        cornering: machine.cornering,
        misalignment: vehicle::Misalignment {
            heading: machine.misalignment.heading.get(),
            steering: machine.misalignment.steering.get(),
        },
        weights: machine.weights.map(|weights| vehicle::Weights {
            firm: regulator(&weights.firm),
            gentle: regulator(&weights.gentle),
        }),
    })
}

/// Checks that the control law can be designed for a vehicle's machine.
///
/// # Errors
/// Names the key of the manifest at fault, its value and what is accepted.
pub(crate) fn check(vehicle: &Vehicle) -> Result<(), String> {
    if let Some(rover) = &vehicle.manifest().rover {
        RowSettings::<f32>::for_robot(&robot(rover)).map_err(|error| format!("rover: {error}"))?;
    }
    let manifest = vehicle.manifest();
    if let (Some(machine), Some(guidance)) = (&manifest.machine, &manifest.row_guidance) {
        RowSettings::<f32>::for_robot(&between_rows(machine, guidance))
            .map_err(|error| format!("row_guidance: {error}"))?;
    }
    let Some(description) = description(vehicle) else {
        return Ok(());
    };
    match Settings::<f32>::for_vehicle(&description) {
        Ok(_) => Ok(()),
        Err(Refusal::Number {
            what,
            value,
            least,
            most,
        }) => {
            let (key, shown) = key(what);
            Err(format!(
                "{key} is {}: {} to {} is accepted",
                shown(value),
                shown(least),
                shown(most)
            ))
        }
        Err(Refusal::Design(error)) => Err(format!("machine.weights: {error}")),
    }
}

/// Shows a number in the base unit with its unit.
type Shown = fn(f64) -> String;

/// The key of the manifest that a number of the control law's description comes from, and how
/// the number is shown with its unit.
fn key(what: vehicle::Quantity) -> (&'static str, Shown) {
    use vehicle::Quantity as Of;

    fn shown<K: Kind>(value: f64) -> String {
        // A thousandth of any unit is finer than what these numbers are known to.
        let (_, factor, divisor) = K::UNITS[0];
        let rounded = (value / factor * divisor * 1e3).round() / 1e3;
        Quantity::<K>::new(rounded * factor / divisor).to_string()
    }
    let (length, speed): (Shown, Shown) = (shown::<LengthKind>, shown::<SpeedKind>);
    let (angle, time): (Shown, Shown) = (shown::<AngleKind>, shown::<TimeKind>);
    match what {
        Of::Wheelbase => (
            "the wheelbase, machine.rear_to_antenna plus machine.antenna_to_front,",
            length,
        ),
        Of::AntennaAhead => ("machine.rear_to_antenna", length),
        Of::AntennaRight => ("machine.antenna_right", length),
        Of::AntennaHeight => ("machine.antenna_height", length),
        Of::SteeringAngle => ("machine.limits.steering_angle", angle),
        Of::SteeringRate => ("machine.limits.steering_rate", shown::<RateKind>),
        Of::Cruise => ("machine.cruise", speed),
        Of::TopSpeed => (
            "machine.limits.speed, which machine.cruise must not exceed,",
            speed,
        ),
        Of::Period => (
            "the period of the control law, BasicCycle of network.dbc,",
            time,
        ),
        Of::PositionNoise => ("machine.sensors.position", length),
        Of::VelocityNoise => ("machine.sensors.velocity", speed),
        Of::SteeringNoise => ("machine.sensors.steering", angle),
        Of::Age => (
            "the age of a measurement in the control step, with receiver.latency, receiver.burst \
             and receiver.lead,",
            time,
        ),
        Of::Interval => ("receiver.period", time),
        Of::DriveLag => ("machine.drive.lag", time),
        Of::Acceleration => ("machine.limits.acceleration", shown::<AccelerationKind>),
        Of::Cornering => ("machine.cornering", |value| format!("{value} 1/rad")),
        Of::HeadingMisalignment => ("machine.misalignment.heading", angle),
        Of::SteeringMisalignment => ("machine.misalignment.steering", angle),
    }
}

/// Cycle time of the control step, s: the latest release of a step in the network.
fn control_release(vehicle: &Vehicle) -> f64 {
    let network = vehicle.network();
    let messages = network.messages.iter();
    let releases = messages.filter_map(|message| network.release_us(message));
    f64::from(releases.max().unwrap_or(0)) * 1e-6
}

const fn regulator(weights: &RegulatorWeights) -> SteeringWeights<f64> {
    SteeringWeights {
        integral: weights.integral,
        cross_track: weights.cross_track,
        heading: weights.heading,
        steering_angle: weights.steering_angle,
        steering_rate: weights.steering_rate,
    }
}

/// The Rust source of the constants; every type has its full path.
///
/// # Errors
/// The control law cannot be designed for the machine.
pub(crate) fn source(vehicle: &Vehicle) -> Result<String, VehicleError> {
    let manifest = vehicle.manifest();
    let mut out = String::new();
    let switches = vehicle.node_of(Device::OperatorSwitches);
    if switches.is_some() {
        let remote = match manifest.operator.remote {
            Remote::Momentary => "Momentary",
            Remote::Toggle => "Toggle",
            Remote::Latched => "Latched",
        };
        constant(
            &mut out,
            "How the remote control's receiver shows a press.",
            "REMOTE: ::firmware::buttons::Remote",
            &format!("::firmware::buttons::Remote::{remote}"),
        );
    }
    if let Some(receiver) = &manifest.receiver {
        self::receiver(&mut out, receiver);
    }
    if let Some(rover) = &manifest.rover {
        self::rover(&mut out, rover).map_err(|error| VehicleError::Manifest {
            file: vehicle.manifest_file(),
            what: format!("rover: {error}"),
        })?;
    }
    if let Some(machine) = &manifest.machine {
        let description = description(vehicle);
        let settings = description
            .map(|description| Settings::<f32>::for_vehicle(&description))
            .transpose()
            .map_err(|refusal| VehicleError::Manifest {
                file: vehicle.manifest_file(),
                what: refusal.to_string(),
            })?;
        self::machine(&mut out, machine, &manifest.waypoints);
        if let Some(settings) = settings {
            constant(
                &mut out,
                "Settings of the control law, derived from the manifest.",
                "SETTINGS: ::control::controller::Settings<f32>",
                &vehicle::source(&settings).to_string(),
            );
        }
        steering_law(&mut out, machine, manifest.missions());
        if let Some(tilt) = manifest.inertial() {
            constant(
                &mut out,
                "How long the last roll and pitch count, s.",
                "TILT_AGE: f32",
                &format!("{:?}", single(tilt.longest_age)),
            );
        }
        let guide = guide(&mut out, machine, manifest).map_err(|error| VehicleError::Manifest {
            file: vehicle.manifest_file(),
            what: format!("row_guidance: {error}"),
        })?;
        out.push_str(IMPLEMENTATION);
        let _ = writeln!(out, "    type Guide = ::firmware::guide::{guide};");
        let _ = writeln!(
            out,
            "    const GUIDE: <Self::Guide as ::firmware::guide::Guidance>::Settings = GUIDE;"
        );
        let period = vehicle.network().basic_cycle_us as f32 * 1e-6;
        // Writing to a string cannot fail.
        let _ = writeln!(out, "    const PERIOD: f32 = {period:?};");
        let receiver = manifest.receiver.as_ref();
        let interval = receiver.map_or(period, |receiver| single(receiver.period));
        let _ = writeln!(out, "    const INTERVAL: f32 = {interval:?};\n}}");
    }
    Ok(out)
}

/// The Rust source of what a vehicle brings to its missions.
fn missions(mission: &Mission, machine: &Machine) -> String {
    let half_width = single(mission.width) * 0.5;
    format!(
        "::firmware::mission::Design {{ turn_speed: {:?}, reserve: {:?}, half_width: {half_width:?}, ahead: {:?}, \
         behind: {:?}, clearance: {:?}, aside: {:?}, acceleration: {:?} }}",
        single(mission.turn_speed),
        single(mission.reserve),
        single(mission.ahead),
        single(mission.behind),
        single(mission.clearance),
        single(mission.aside),
        single(machine.limits.acceleration),
    )
}

/// The law that steers a machine.
fn steering_law(out: &mut String, machine: &Machine, mission: Option<&Mission>) {
    let (law, settings) = match machine.law {
        Law::Furrow if let Some(mission) = mission => ("Mission", missions(mission, machine)),
        Law::Furrow => ("Furrow", String::from("()")),
        Law::Thesis => {
            let gains = machine.thesis.array().map(|gain| gain as f32);
            ("Thesis", format!("{gains:?}"))
        }
    };
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "/// The law that steers.\npub type Law = ::firmware::steering::{law};\n"
    );
    constant(
        out,
        "Its own settings.",
        "LAW: <Law as ::firmware::steering::Law>::Settings",
        &settings,
    );
}

/// The settings of what guides a run besides the path. Returns its type.
///
/// # Errors
/// No estimator can be made of the numbers of the rows.
fn guide(
    out: &mut String,
    machine: &Machine,
    manifest: &Manifest,
) -> Result<&'static str, RowSettingsError> {
    if let Some(planner) = manifest.leading_planner() {
        constant(
            out,
            "When and how a planner leads a run.",
            "GUIDE: ::control::demand::DemandSettings<f32>",
            &format!("::control::demand::{:#?}", demands(planner)),
        );
        return Ok("ByPlanner");
    }
    let Some(guidance) = manifest.guidance_by_rows() else {
        constant(out, "The path alone guides a run.", "GUIDE: ()", "()");
        return Ok("Without");
    };
    constant(
        out,
        "When and how rows guide a run.",
        "GUIDE: ::control::takeover::TakeoverSettings<f32>",
        &format!("::control::takeover::{:#?}", takeover(guidance)),
    );
    let settings = RowSettings::<f32>::for_robot(&between_rows(machine, guidance))?;
    constant(
        out,
        "How the place between the rows is found.",
        "ROW_WATCH: ::control::row::RowSettings<f32>",
        &row::source(&settings).to_string(),
    );
    Ok("ByRows")
}

/// The Rust source of which nodes the bus guardian guards.
pub(crate) fn guarded(guardian: Option<&BusGuardian>) -> String {
    let guards = guardian.map_or(&[][..], |guardian| &guardian.guards);
    let nodes = guards
        .iter()
        .map(|name| format!("super::matrix::{}", name.to_uppercase()));
    let names = guards.iter().map(|name| format!("{name:?}"));
    let (nodes, names) = (nodes.collect::<Vec<_>>(), names.collect::<Vec<_>>());
    let mut out = String::new();
    constant(
        &mut out,
        "The guarded nodes, in the order of the taps of the guardian's board.",
        &format!("NODES: [::ttcan::NodeId; {}]", nodes.len()),
        &format!("[{}]", nodes.join(", ")),
    );
    constant(
        &mut out,
        "Their names.",
        &format!("NAMES: [&str; {}]", names.len()),
        &format!("[{}]", names.join(", ")),
    );
    out
}

/// The Rust source of what the manifest says about stops.
pub(crate) fn safety(safety: Safety) -> String {
    let mut out = String::new();
    let backup = match safety.backup_master {
        BackupMaster::Stop => "Stop",
        BackupMaster::Drive => "Drive",
    };
    constant(
        &mut out,
        "What the motors do while a backup master leads the bus.",
        "BACKUP_MASTER: ::firmware::leader::BackupMaster",
        &format!("::firmware::leader::BackupMaster::{backup}"),
    );
    out
}

/// The beginning of the implementation of `firmware::machine::Machine`.
const IMPLEMENTATION: &str = "\
/// The machine.
#[derive(Clone, Copy, Debug)]
pub struct Machine;

impl ::firmware::machine::Machine for Machine {
    const LIMITS: ::control::feedback::Limits<f32> = LIMITS;
    const ACCELERATION: f32 = ACCELERATION;
    const POTENTIOMETER: ::control::calibration::Potentiometer<f32> = POTENTIOMETER;
    const STEERING: ::control::calibration::Actuator<f32> = STEERING;
    const DRIVE: ::control::calibration::Actuator<f32> = DRIVE;
    const FULL_BYTE_IS_FORWARD: bool = FULL_BYTE_IS_FORWARD;
    const ROUTE: [::control::position::Position; 2] = ROUTE;
    const SETTINGS: ::control::controller::Settings<f32> = SETTINGS;
    type Law = Law;
    const LAW: <Law as ::firmware::steering::Law>::Settings = LAW;
";

/// Appends `/// doc`, `pub const NAME: TYPE = value;`.
fn constant(out: &mut String, doc: &str, name: &str, value: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(out, "/// {doc}\npub const {name} = {value};\n");
}

fn receiver(out: &mut String, receiver: &Receiver) {
    for (doc, name, time) in [
        (
            "Time between two measurements of the receiver.",
            "RECEIVER_PERIOD",
            receiver.period,
        ),
        (
            "How long before a reference the receiver's burst shall end.",
            "RECEIVER_LEAD",
            receiver.lead,
        ),
    ] {
        let value = format!("::ttcan::Micros::micros({})", time.micros());
        constant(out, doc, &format!("{name}: ::ttcan::Micros"), &value);
    }
}

/// # Errors
/// No law can be made of the rover's numbers.
fn rover(out: &mut String, rover: &Rover) -> Result<(), RowSettingsError> {
    let robot = robot(rover);
    // The type with its full path; the block imports the types of its fields.
    let value = format!(
        "{{\nuse ::control::{{calibration::{{Actuator, Direction}}, row::{{Mounting, RowRobot, Sides}}}};\n{robot:#?}\n}}",
    );
    constant(
        out,
        "The robot and its rows.",
        "ROBOT: ::control::row::RowRobot",
        &value,
    );
    let (law, settings, difference) = match rover.law {
        Law::Furrow => {
            let settings = RowSettings::<f32>::for_robot(&robot)?;
            let source = row::source(&settings).to_string();
            ("Furrow", source, largest_difference(&robot, &settings))
        }
        Law::Thesis => (
            "Thesis",
            thesis_source(&robot, &rover.thesis),
            2.0 * rover.thesis.effort.get(),
        ),
    };
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "/// The law that steers.\npub type Law = ::firmware::rows::{law};\n"
    );
    constant(
        out,
        "Settings of the law.",
        "LAW: <Law as ::firmware::rows::Law>::Settings",
        &settings,
    );
    constant(
        out,
        "Largest difference of both sides' efforts that the law asks for.",
        "LARGEST_DIFFERENCE: f64",
        &format!("{difference:?}"),
    );
    Ok(())
}

/// Largest difference of both sides' efforts under Furrow's law: that of its fastest turn, with the
/// dead bands of both sides in it, as when they turn in opposite directions.
fn largest_difference(robot: &RowRobot, settings: &RowSettings<f32>) -> f64 {
    let law = &settings.law;
    let half = (law.turn_rate * law.track / 2.0).min(law.wheel_speed);
    2.0 * robot.motors.left.effort(f64::from(half))
}

/// The settings of the thesis's law, for distances in centimetres.
fn thesis_source(robot: &RowRobot, law: &ThesisLaw) -> String {
    let centimetres = |length: Quantity<LengthKind>| (length.get() * 100.0) as f32;
    format!(
        "::firmware::rows::ThesisLaw {{ least: {:?}, most: {:?}, process: {:?}, proportional: {:?}, \
         integral: {:?}, difference: {:?}, effort: {:?}, forward: {:?}, sine: {:?} }}",
        centimetres(law.least),
        centimetres(law.most),
        law.process as f32,
        law.proportional as f32,
        law.integral as f32,
        centimetres(law.difference),
        single(law.effort),
        robot.motors.left.effort(robot.cruise) as f32,
        robot.mounting.angle.sin() as f32,
    )
}

/// A quantity in single precision, as the images use it.
fn single<K: Kind>(quantity: Quantity<K>) -> f32 {
    quantity.get() as f32
}

fn machine(out: &mut String, machine: &Machine, waypoints: &[Waypoint]) {
    let limits = limits(machine);
    constant(
        out,
        "Rear axle to antenna and antenna to front axle, m.",
        "GEOMETRY: ::control::model::Geometry<f64>",
        &format!(
            "::control::model::Geometry {{ l1: {:?}, l2: {:?} }}",
            machine.rear_to_antenna.get(),
            machine.antenna_to_front.get()
        ),
    );
    constant(
        out,
        "Place of the antenna beside the centre line and above the ground, m.",
        "ANTENNA: ::control::model::Antenna<f64>",
        &format!(
            "::control::model::Antenna {{ right: {:?}, height: {:?} }}",
            machine.antenna_right.get(),
            machine.antenna_height.get()
        ),
    );
    constant(
        out,
        "What the actuators may be asked for: rad, rad/s, m/s.",
        "LIMITS: ::control::feedback::Limits<f32>",
        &format!(
            "::control::feedback::Limits {{ steering_angle: {:?}, steering_rate: {:?}, speed: {:?} }}",
            limits.steering_angle, limits.steering_rate, limits.speed
        ),
    );
    constant(
        out,
        "Largest growth of the drive speed, m/s each second.",
        "ACCELERATION: f32",
        &format!("{:?}", single(machine.limits.acceleration)),
    );
    actuators(out, machine);
    let millimetres = |length: f64| (length * 1000.0).round() as i32;
    let points = waypoints.iter().map(|point| {
        format!(
            "::control::position::Position::new({}, {})",
            millimetres(point.north.get()),
            millimetres(point.east.get())
        )
    });
    constant(
        out,
        "The ends of the line that an autonomous run follows, mm north and east.",
        "ROUTE: [::control::position::Position; 2]",
        &format!("[{}]", points.collect::<Vec<_>>().join(", ")),
    );
}

/// The calibration of the steering and of the drive.
fn actuators(out: &mut String, machine: &Machine) {
    constant(
        out,
        "The steering's potentiometer. An intact one cannot leave its ends.",
        "POTENTIOMETER: ::control::calibration::Potentiometer<f32>",
        &potentiometer_source(&potentiometer(machine)),
    );
    constant(
        out,
        "The steering actuator on its motor driver, rad/s; positive to the right.",
        "STEERING: ::control::calibration::Actuator<f32>",
        &actuator_source(&steering(machine)),
    );
    constant(
        out,
        "The drive motor on its motor driver, m/s.",
        "DRIVE: ::control::calibration::Actuator<f32>",
        &actuator_source(&drive(machine)),
    );
    constant(
        out,
        "Which way the motor driver's byte 255 turns: true means forward, or to the right.",
        "FULL_BYTE_IS_FORWARD: bool",
        &format!("{:?}", machine.motor_driver.full_byte_is_forward),
    );
}

fn direction(direction: &Direction) -> calibration::Direction<f32> {
    calibration::Direction {
        dead_band: single(direction.dead_band),
        full_rate: single(direction.full_rate),
    }
}

/// The steering actuator of a machine, as its images use it.
#[must_use]
pub fn steering(machine: &Machine) -> Actuator<f32> {
    Actuator {
        positive: direction(&machine.steering.right),
        negative: direction(&machine.steering.left),
    }
}

/// The drive motor of a machine, as its images use it, m/s.
#[must_use]
pub fn drive(machine: &Machine) -> Actuator<f32> {
    let direction = calibration::Direction {
        dead_band: single(machine.drive.dead_band),
        full_rate: single(machine.drive.full_speed),
    };
    Actuator {
        positive: direction,
        negative: direction,
    }
}

/// The potentiometer of a machine, as its images use it. A reading beyond its ends, which are
/// those of the steering's travel, is implausible.
#[must_use]
pub fn potentiometer(machine: &Machine) -> calibration::Potentiometer<f32> {
    let pot = &machine.potentiometer;
    let range = (pot.slope.get() * machine.steering.travel.get()).abs();
    calibration::Potentiometer {
        centre: single(pot.centre),
        counts_per_radian: single(pot.slope),
        lowest: (pot.centre.get() - range).round() as u16,
        highest: (pot.centre.get() + range).round() as u16,
    }
}

/// Limits of the commands to a machine's actuators, as its images use them.
#[must_use]
pub fn limits(machine: &Machine) -> Limits<f32> {
    Limits {
        steering_angle: single(machine.limits.steering_angle),
        steering_rate: single(machine.limits.steering_rate),
        speed: single(machine.limits.speed),
    }
}

fn direction_source(direction: &calibration::Direction<f32>) -> String {
    format!(
        "::control::calibration::Direction {{ dead_band: {:?}, full_rate: {:?} }}",
        direction.dead_band, direction.full_rate
    )
}

fn actuator_source(actuator: &Actuator<f32>) -> String {
    format!(
        "::control::calibration::Actuator {{ positive: {}, negative: {} }}",
        direction_source(&actuator.positive),
        direction_source(&actuator.negative)
    )
}

fn potentiometer_source(pot: &calibration::Potentiometer<f32>) -> String {
    format!(
        "::control::calibration::Potentiometer {{ centre: {:?}, counts_per_radian: {:?}, lowest: {}, highest: {} }}",
        pot.centre, pot.counts_per_radian, pot.lowest, pot.highest
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::sample::select;
    use std::path::Path;

    /// The constants of the UAGV with each `(from, to)` replaced in its manifest.
    fn changed(changes: &[(&str, &str)]) -> Result<String, String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../vehicles/uagv");
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let mut manifest = read("vehicle.toml");
        for (from, to) in changes {
            assert!(manifest.contains(from), "{from}");
            manifest = manifest.replacen(from, to, 1);
        }
        let vehicle = Vehicle::parse("uagv", &folder, &manifest, &read("network.dbc"))
            .map_err(|error| error.to_string())?;
        source(&vehicle).map_err(|error| error.to_string())
    }

    /// The constants of the vehicle with these values in place of its manifest's.
    fn set(set: &str) -> Result<String, String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../vehicles/uagv");
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let (manifest, network) = (read("vehicle.toml"), read("network.dbc"));
        let set = crate::Overrides::parse(set)?;
        let vehicle = Vehicle::parse_with("uagv", &folder, &manifest, &network, &set)
            .map_err(|error| error.to_string())?;
        source(&vehicle).map_err(|error| error.to_string())
    }

    #[test]
    fn the_manifest_chooses_the_law_and_its_gains() {
        let own = set("").unwrap();
        assert!(own.contains("pub type Law = ::firmware::steering::Furrow;"));
        assert!(own.contains("Settings = ();"), "{own}");
        let thesis = set("machine.law=thesis;machine.thesis.heading=1.5").unwrap();
        assert!(thesis.contains("pub type Law = ::firmware::steering::Thesis;"));
        assert!(
            thesis.contains("Settings = [0.888975, 1.5, 2.198963];"),
            "{thesis}"
        );
        for wrong in [
            "cross_track=0",
            "heading=-1",
            "steering_angle=1e9",
            "heading=nan",
        ] {
            let told = set(&format!("machine.thesis.{wrong}")).unwrap_err();
            assert!(told.contains("is accepted"), "{told}");
        }
    }

    /// The constants of the row follower with these values in place of its manifest's.
    fn row_follower(set: &str) -> Result<String, String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../vehicles/row-follower");
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let (manifest, network) = (read("vehicle.toml"), read("network.dbc"));
        let set = crate::Overrides::parse(set)?;
        let name = "row-follower";
        let vehicle = Vehicle::parse_with(name, &folder, &manifest, &network, &set)
            .map_err(|error| error.to_string())?;
        source(&vehicle).map_err(|error| error.to_string())
    }

    /// Numbers of a rover's manifest, and their units.
    const NUMBERS: [(&str, &str); 24] = [
        ("length", " m"),
        ("width", " m"),
        ("track", " m"),
        ("turning_track", " m"),
        ("axle_spacing", " m"),
        ("cruise", " m/s"),
        ("motors.dead_band", " %"),
        ("motors.full_speed", " m/s"),
        ("motors.lag", " s"),
        ("sensors.ahead", " m"),
        ("sensors.beside", " m"),
        ("sensors.angle", " deg"),
        ("sensors.least", " m"),
        ("sensors.open", " m"),
        ("rows.width", " m"),
        ("rows.tolerance", " m"),
        ("rows.stalk", " m"),
        ("thesis.least", " m"),
        ("thesis.most", " m"),
        ("thesis.process", ""),
        ("thesis.proportional", ""),
        ("thesis.integral", ""),
        ("thesis.difference", " m"),
        ("thesis.effort", " %"),
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        /// Whatever number is accepted, the images get one that single precision has, and neither 0
        /// nor infinity in place of another one.
        #[test]
        fn an_accepted_number_is_one_of_the_firmware(
            (key, unit) in select(&NUMBERS[..]),
            law in select(&["furrow", "thesis"][..]),
            (digits, exponent) in (1.0..10.0_f64, prop_oneof![-330..308_i32, -8..4_i32]),
        ) {
            let value = format!("{digits}e{exponent}");
            let set = format!("rover.law={law};rover.{key}={value}{unit}");
            match row_follower(&set) {
                Ok(source) => {
                    let words = || source.split(|c: char| !c.is_alphanumeric());
                    prop_assert!(!words().any(|word| ["inf", "NaN"].contains(&word)), "{source}");
                    // A least distance as small as that is none.
                    let field = key.strip_prefix("thesis.").filter(|field| *field != "least");
                    let field = field.filter(|_| law == "thesis");
                    let zero = field.map(|field| format!(" {field}: 0.0,"));
                    let none = value.parse() == Ok(0.0);
                    prop_assert!(none || zero.is_none_or(|zero| !source.contains(&zero)), "{source}");
                }
                Err(told) => prop_assert!(!told.contains('\n'), "{told}"),
            }
        }
    }

    #[test]
    fn a_changed_limit_reaches_actuators_and_controller() {
        let source = changed(&[
            ("steering_angle = \"25 deg\"", "steering_angle = \"30 deg\""),
            (
                "steering_rate = \"25 deg/s\"",
                "steering_rate = \"20 deg/s\"",
            ),
            ("\nspeed = \"2 m/s\"", "\nspeed = \"2.5 m/s\""),
            ("full_speed = \"2 m/s\"", "full_speed = \"2.5 m/s\""),
            ("antenna_right = \"0 m\"", "antenna_right = \"-20 cm\""),
        ])
        .unwrap();
        let (before, settings) = source.split_once("pub const SETTINGS").unwrap();
        let (_, actuators) = before.split_once("pub const LIMITS").unwrap();
        let squeeze = |text: &str| text.split_whitespace().collect::<String>();
        let limits = "{steering_angle:0.5235988,steering_rate:0.34906584,speed:2.5";
        for constants in [squeeze(actuators), squeeze(settings)] {
            assert!(constants.contains(limits), "{constants}");
        }
        assert!(squeeze(settings).contains("right:-0.2"), "{settings}");
    }

    #[test]
    fn the_remote_control_is_a_constant() {
        for (word, constant) in [("toggle", "Toggle"), ("latched", "Latched")] {
            let remote = format!("remote = {word:?}");
            let source = changed(&[("remote = \"momentary\"", &remote)]).unwrap();
            assert!(source.contains(&format!(
                "REMOTE: ::firmware::buttons::Remote = ::firmware::buttons::Remote::{constant};"
            )));
        }
    }

    #[test]
    fn a_machine_without_a_control_law_is_refused_in_one_sentence() {
        let told = changed(&[("cornering = 4.0", "cornering = 0.1")]).unwrap_err();
        assert!(
            told.contains(
                "vehicle.toml: machine.cornering is 0.1 1/rad: 2 1/rad to 20 1/rad is accepted"
            ),
            "{told}"
        );
    }
}

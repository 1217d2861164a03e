//! The manifest of a vehicle, `vehicle.toml`: its nodes, what is wired to them, and the
//! numbers of its machine.
//!
//! Quantities are strings with a unit (`"0.255 m"`). An unknown field is refused.

use std::collections::BTreeMap;

use control::plain::GAINS;
use serde::{Deserialize, Serialize};

use crate::units::{Acceleration, Angle, Count, CountSlope, Length, Rate, Ratio, Speed, Time};

/// What `vehicle.toml` says.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// The vehicle in one line, for lists.
    pub summary: String,
    /// The boards on the bus, in the order in which reports list them.
    #[serde(rename = "node")]
    pub nodes: Vec<Node>,
    /// The signal that carries the vehicle's mode; `None` if it has no modes.
    pub mode: Option<ModeSignal>,
    /// The message that commands the motors; `None` if there is none.
    pub command: Option<Command>,
    /// Which signals `cargo xtask calibrate` reads; `None` when there is nothing to calibrate.
    pub calibration: Option<Calibration>,
    /// The signals with a rover's distances to both rows; `None` if no message carries them.
    pub distances: Option<DistanceSignals>,
    /// The messages of the nodes' self-test; `None` if there are none.
    pub self_test: Option<SelfTest>,
    /// How the nodes use the bus. Default: by the schedule of the network file.
    #[serde(default)]
    pub bus: Bus,
    /// When the motors stop. Default: as the thesis says.
    #[serde(default)]
    pub safety: Safety,
    /// The operator's controls. Default: a momentary remote control.
    #[serde(default)]
    pub operator: Operator,
    /// The machine that the nodes move; `None` for boards without one. Its motors and its
    /// potentiometer must be wired.
    pub machine: Option<Machine>,
    /// The robot that the nodes drive between the rows of a crop, instead of a machine; `None` for
    /// other vehicles. Its sensors, its motors and its remote control must be wired.
    pub rover: Option<Rover>,
    /// Guidance of a machine by the rows of a crop while the receiver has no fix; `None` if it is not
    /// meant for that.
    pub row_guidance: Option<RowGuidance>,
    /// A planner that may lead runs; `None` if the vehicle is not meant to have one.
    pub planner: Option<Planner>,
    /// Missions in place of the one line; `None` if the vehicle is not meant for them.
    pub mission: Option<Mission>,
    /// Roll and pitch from an inertial sensor; `None` if the vehicle is not meant to have one.
    pub tilt: Option<Inertial>,
    /// Sessions of nodes with a key; `None` if the vehicle is not meant for them.
    pub sessions: Option<Sessions>,
    /// The bus guardian; `None` if the vehicle is not meant to have one.
    pub guardian: Option<BusGuardian>,
    /// The satellite receiver; needed when one is wired.
    pub receiver: Option<Receiver>,
    /// The ends of the line that the run follows, two when there is a machine.
    #[serde(default, rename = "waypoint")]
    pub waypoints: Vec<Waypoint>,
}

/// A node: a board on the bus with its image.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Node {
    /// Its name. Its image, its source file and its node in the network file have the same
    /// name.
    pub name: String,
    /// The sled that it runs on, by its short name: `f446` or `f303`.
    pub board: String,
    /// The device at each connector of the sled; a connector that is not listed is open.
    #[serde(default)]
    pub wiring: BTreeMap<String, Device>,
}

impl Manifest {
    /// The guidance by rows, if it is on.
    #[must_use]
    pub fn guidance_by_rows(&self) -> Option<&RowGuidance> {
        self.row_guidance.as_ref().filter(|rows| rows.enabled)
    }

    /// The planner, if it is on.
    #[must_use]
    pub fn leading_planner(&self) -> Option<&Planner> {
        self.planner.as_ref().filter(|planner| planner.enabled)
    }

    /// The missions, if they are on.
    #[must_use]
    pub fn missions(&self) -> Option<&Mission> {
        self.mission.as_ref().filter(|mission| mission.enabled)
    }

    /// The inertial sensor, if it is on.
    #[must_use]
    pub fn inertial(&self) -> Option<&Inertial> {
        self.tilt.as_ref().filter(|tilt| tilt.enabled)
    }

    /// Whether nodes with a key have sessions.
    #[must_use]
    pub fn has_sessions(&self) -> bool {
        self.sessions
            .as_ref()
            .is_some_and(|sessions| sessions.enabled)
    }

    /// The names of the files, without the ending `dbc`, that have the messages of what is on.
    pub(crate) fn supplements(&self) -> impl Iterator<Item = &str> {
        let rows = self.guidance_by_rows().map(|rows| rows.node.name.as_str());
        let planner = self.leading_planner().map(|planner| planner.name.as_str());
        let mission = self.missions().map(|_| MISSION);
        let sessions = self.has_sessions().then_some(SESSION);
        let tilt = self.inertial().map(|_| TILT);
        let guides = rows.into_iter().chain(planner);
        guides.chain(mission).chain(sessions).chain(tilt)
    }

    /// The signal that says what guides the vehicle beside its path, if something else may.
    #[must_use]
    pub fn guide_signal(&self) -> Option<&SignalPath> {
        let rows = self.guidance_by_rows().map(|rows| &rows.guide);
        rows.or(self.leading_planner().map(|planner| &planner.lead))
    }

    /// The bus guardian, if it is on.
    #[must_use]
    pub fn bus_guardian(&self) -> Option<&BusGuardian> {
        self.guardian.as_ref().filter(|guardian| guardian.enabled)
    }

    /// Whether a node is the bus guardian. It sends no message, so the network file does not have it.
    #[must_use]
    pub fn is_guardian(&self, node: &Node) -> bool {
        let guardian = self.bus_guardian();
        guardian.is_some_and(|guardian| guardian.node.name == node.name)
    }

    /// Puts the node that measures the rows among the others if the guidance by rows is on, and behind
    /// them the bus guardian if that is on.
    pub(crate) fn complete(&mut self) {
        if let Some(rows) = self.row_guidance.as_ref().filter(|rows| rows.enabled) {
            self.nodes.push(rows.node.clone());
            if let Some(test) = &mut self.self_test {
                let (node, message) = (rows.node.name.clone(), rows.self_test.clone());
                test.report.insert(node, message);
            }
        }
        if let Some(guardian) = self.guardian.as_ref().filter(|guardian| guardian.enabled) {
            self.nodes.push(guardian.node.clone());
        }
    }
}

impl Node {
    /// The connector that `device` is wired to.
    #[must_use]
    pub fn connector(&self, device: Device) -> Option<&str> {
        let mut wires = self.wiring.iter();
        wires
            .find(|(_, wired)| **wired == device)
            .map(|(connector, _)| connector.as_str())
    }
}

/// A device that is wired to a connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// An RTK receiver that speaks SBP on a serial line.
    SatelliteReceiver,
    /// A serial display of 4 rows with three lamps: Matrix Orbital's LK204-7T-1U.
    #[serde(rename = "lk204-7t-1u")]
    Display,
    /// A joystick of two potentiometers.
    Joystick,
    /// Remote control (A to D), switch of the joystick, emergency-stop loop.
    OperatorSwitches,
    /// A motor driver on simplified serial, and the relay in its motor's lead; they turn the
    /// machine's steering actuator.
    SteeringMotor,
    /// The same for the machine's drive motor.
    DriveMotor,
    /// The same with a motor that moves no machine.
    BenchMotor,
    /// The potentiometer of the machine's steering.
    SteeringPotentiometer,
    /// A potentiometer that a person turns.
    Knob,
    /// The two distance sensors of a rover.
    DistanceSensors,
    /// The two motor drivers of a rover, on servo pulses.
    DriveMotors,
    /// A remote control's receiver with a line for run and one for stop.
    PinRemote,
}

impl Device {
    /// All devices.
    pub const ALL: [Self; 12] = [
        Self::SatelliteReceiver,
        Self::Display,
        Self::Joystick,
        Self::OperatorSwitches,
        Self::SteeringMotor,
        Self::DriveMotor,
        Self::BenchMotor,
        Self::SteeringPotentiometer,
        Self::Knob,
        Self::DistanceSensors,
        Self::DriveMotors,
        Self::PinRemote,
    ];

    /// Its name in a manifest.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SatelliteReceiver => "satellite-receiver",
            Self::Display => "lk204-7t-1u",
            Self::Joystick => "joystick",
            Self::OperatorSwitches => "operator-switches",
            Self::SteeringMotor => "steering-motor",
            Self::DriveMotor => "drive-motor",
            Self::BenchMotor => "bench-motor",
            Self::SteeringPotentiometer => "steering-potentiometer",
            Self::Knob => "knob",
            Self::DistanceSensors => "distance-sensors",
            Self::DriveMotors => "drive-motors",
            Self::PinRemote => "pin-remote",
        }
    }

    /// Whether its name is a plural.
    pub(crate) const fn is_plural(self) -> bool {
        matches!(
            self,
            Self::OperatorSwitches | Self::DistanceSensors | Self::DriveMotors
        )
    }

    /// Its name for a sentence, with an article unless it is a plural.
    pub(crate) fn with_article(self) -> String {
        let name = self.name();
        if self.is_plural() {
            name.to_owned()
        } else {
            format!("a {name}")
        }
    }

    /// The connector of a sled that it fits.
    #[must_use]
    pub const fn connector(self) -> &'static str {
        match self {
            Self::SatelliteReceiver => "receiver",
            Self::Display => "display",
            Self::Joystick => "joystick",
            Self::OperatorSwitches => "inputs",
            Self::SteeringMotor | Self::DriveMotor | Self::BenchMotor => "motor",
            Self::SteeringPotentiometer | Self::Knob => "pot",
            Self::DistanceSensors => "distances",
            Self::DriveMotors => "servos",
            Self::PinRemote => "remote",
        }
    }

    /// Whether it drives a motor.
    #[must_use]
    pub const fn is_motor(self) -> bool {
        matches!(
            self,
            Self::SteeringMotor | Self::DriveMotor | Self::BenchMotor | Self::DriveMotors
        )
    }

    /// Whether it is a motor driver on simplified serial, with a relay in its motor's lead.
    #[must_use]
    pub const fn has_relay(self) -> bool {
        matches!(
            self,
            Self::SteeringMotor | Self::DriveMotor | Self::BenchMotor
        )
    }

    /// Whether it is part of a machine and makes no sense without one.
    #[must_use]
    pub const fn needs_machine(self) -> bool {
        matches!(
            self,
            Self::SatelliteReceiver
                | Self::SteeringMotor
                | Self::DriveMotor
                | Self::SteeringPotentiometer
        )
    }

    /// Whether it is part of a rover and makes no sense without one.
    #[must_use]
    pub const fn needs_rover(self) -> bool {
        matches!(
            self,
            Self::DistanceSensors | Self::DriveMotors | Self::PinRemote
        )
    }
}

/// The signal that carries the vehicle's mode.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModeSignal {
    /// The message.
    pub message: String,
    /// Its signal, which has a value table.
    pub signal: String,
    /// The value of an autonomous run.
    pub autonomous: String,
}

/// The message that commands the motors.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Command {
    /// The message, of 8 bytes with the signals `Counter` and `Check` in the last two: sequence counter
    /// and check value.
    pub message: String,
    /// For each motor, the one-bit signal that lets it turn; each motor has its own.
    pub enable: BTreeMap<Device, String>,
}

/// The messages of the nodes' self-test.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelfTest {
    /// The event message by which a program on the bus asks for it. No node of the vehicle sends
    /// it.
    pub request: String,
    /// For each node, the event message by which it reports.
    pub report: BTreeMap<String, String>,
}

/// The signals of a recorded drive from which the steering is calibrated.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Reading of the steering's potentiometer, counts.
    pub potentiometer: SignalPath,
    /// Commanded steering rate, positive to the right; a signal of the command message.
    pub steering_rate: SignalPath,
    /// Northing of the antenna, sent with an RTK-fixed solution only.
    pub north: SignalPath,
    /// Easting of the antenna, in the same message.
    pub east: SignalPath,
}

/// The signals with a rover's distances to both rows, as they were measured; reports of a run read
/// them.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistanceSignals {
    /// To the left row.
    pub left: SignalPath,
    /// To the right row.
    pub right: SignalPath,
}

/// A signal and its message, written `Message.Signal`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct SignalPath {
    /// The message.
    pub message: String,
    /// The signal.
    pub signal: String,
}

impl TryFrom<String> for SignalPath {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        match text.split_once('.') {
            Some((message, signal)) if !message.is_empty() && !signal.is_empty() => Ok(Self {
                message: message.into(),
                signal: signal.into(),
            }),
            _ => Err(format!(
                "{text:?} is no signal: write the message's name, a dot and the signal's name"
            )),
        }
    }
}

/// How the nodes use the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// When a message is sent.
    pub protocol: Protocol,
}

/// When a message is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// In its window of the system matrix.
    #[default]
    TimeTriggered,
    /// As soon as its data are there: the identifiers decide. The times of the windows mean nothing
    /// then, and there is no time master. A command is protected without the time: a recorded one that is
    /// sent again passes if its counter fits.
    EventTriggered,
}

impl Protocol {
    /// All protocols.
    pub const ALL: [Self; 2] = [Self::TimeTriggered, Self::EventTriggered];

    /// Its name in a manifest.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TimeTriggered => "time-triggered",
            Self::EventTriggered => "event-triggered",
        }
    }

    /// The protocol of that name.
    ///
    /// # Errors
    /// A clause that says which names are accepted.
    pub fn named(name: &str) -> Result<Self, String> {
        let mut all = Self::ALL.into_iter();
        all.find(|protocol| protocol.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(" and ");
            format!("{names} are accepted")
        })
    }
}

/// When the motors stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Safety {
    /// What they do while a backup master leads the bus.
    pub backup_master: BackupMaster,
}

/// What the motors do while a backup master leads the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BackupMaster {
    /// They stop within two basic cycles (thesis 6.2.4.4).
    #[default]
    Stop,
    /// They obey commands as under the first time master. The network must have a backup.
    Drive,
}

/// The operator's controls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Operator {
    /// The remote control's receiver.
    pub remote: Remote,
}

/// How a remote control's receiver shows a press.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Remote {
    /// Its output is high while the button is pressed.
    #[default]
    Momentary,
    /// Each press changes its output.
    Toggle,
    /// Its output is high until another button is pressed.
    Latched,
}

/// A vehicle with a steered front axle and a driven rear axle.
///
/// Where no range is stated, [`control::vehicle::Description`] has it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// `L1`: rear axle to antenna, positive ahead.
    pub rear_to_antenna: Length,
    /// `L2`: antenna to front axle; `L1 + L2` is the wheelbase.
    pub antenna_to_front: Length,
    /// Antenna beside the centre line, right positive. Default 0 m.
    #[serde(default)]
    pub antenna_right: Length,
    /// Antenna above the ground. Default 0 m.
    #[serde(default)]
    pub antenna_height: Length,
    /// Speed of an autonomous run, at most the speed limit.
    pub cruise: Speed,
    /// Limits of the commands to the actuators.
    pub limits: Limits,
    /// The potentiometer of the steering.
    pub potentiometer: Potentiometer,
    /// The steering actuator.
    pub steering: Steering,
    /// The drive motor.
    pub drive: Drive,
    /// The motor drivers.
    pub motor_driver: MotorDriver,
    /// Standard deviations of the measurements.
    pub sensors: Sensors,
    /// Constant errors of angles to expect after mounting and calibration.
    pub misalignment: Misalignment,
    /// Cornering coefficient of the tyres, 1/rad: lateral force as a share of the load for
    /// each radian of slip.
    pub cornering: f64,
    /// Weights of the steering's regulators. Default: derived from the other numbers.
    pub weights: Option<Weights>,
    /// The law that steers. Default: Furrow's.
    #[serde(default)]
    pub law: Law,
    /// Gains of the thesis's law. Default: those that `dlqr` gives for its vehicle at 1 m/s with unit
    /// weights ([`control::plain::GAINS`]). Its text does not have those that drove.
    #[serde(default)]
    pub thesis: SteeringGains,
}

/// Gains of a state feedback from the steering's states to the steering rate, 0 to 1000.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SteeringGains {
    /// On the cross-track error, 1/(m s), above 0.
    pub cross_track: f64,
    /// On the heading error, 1/s.
    pub heading: f64,
    /// On the steering angle, 1/s.
    pub steering_angle: f64,
}

impl Default for SteeringGains {
    fn default() -> Self {
        let [cross_track, heading, steering_angle] = GAINS;
        Self {
            cross_track,
            heading,
            steering_angle,
        }
    }
}

impl SteeringGains {
    /// The gains in the order of the states.
    #[must_use]
    pub const fn array(self) -> [f64; 3] {
        [self.cross_track, self.heading, self.steering_angle]
    }
}

/// Standard deviations of measurements.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensors {
    /// Position, north and east each.
    pub position: Length,
    /// Velocity, north and east each.
    pub velocity: Speed,
    /// Steering angle.
    pub steering: Angle,
}

/// Constant errors of angles.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misalignment {
    /// Of the course against the direction of travel.
    pub heading: Angle,
    /// Of the measured steering angle.
    pub steering: Angle,
}

/// Limits of the commands to the actuators.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// To either side, at most the travel of the steering.
    pub steering_angle: Angle,
    /// To either side.
    pub steering_rate: Rate,
    /// Forwards and backwards, at most the drive's full speed.
    pub speed: Speed,
    /// Largest acceleration of the drive, above 0 to 20 m/s2.
    pub acceleration: Acceleration,
}

/// A potentiometer with a straight line between angle and reading.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Potentiometer {
    /// Reading straight ahead, 0 to 4095 counts.
    pub centre: Count,
    /// Change of the reading for an angle to the right, -80 to 80 counts/deg.
    pub slope: CountSlope,
}

/// The steering actuator on its motor driver.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Steering {
    /// Angle between straight ahead and the stop on either side, above 0 to 60 deg. A reading
    /// of the potentiometer beyond it is implausible.
    pub travel: Angle,
    /// To the right.
    pub right: Direction,
    /// To the left.
    pub left: Direction,
}

/// One direction of the steering actuator: a straight line beyond a dead band.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Direction {
    /// Share of the full effort that moves nothing, 0 to 50 %.
    pub dead_band: Ratio,
    /// Rate at full effort, 1 to 180 deg/s.
    pub full_rate: Rate,
}

/// The drive motor on its motor driver, alike in both directions.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Share of the full effort that moves nothing, 0 to 50 %.
    pub dead_band: Ratio,
    /// Speed at full effort, above 0 to 10 m/s.
    pub full_speed: Speed,
    /// Time constant from commanded to real speed.
    pub lag: Time,
}

/// The motor drivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorDriver {
    /// Whether the byte 255 turns a motor forwards, or to the right.
    pub full_byte_is_forward: bool,
}

/// Weights of the steering's two regulators.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Of the one that brings the vehicle onto its path.
    pub firm: RegulatorWeights,
    /// Of the one that keeps it there.
    pub gentle: RegulatorWeights,
}

/// Weights of a linear-quadratic regulator on the steering's states (m, m s, rad) and on
/// its input, the steering rate (rad/s).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegulatorWeights {
    /// Integral of the cross-track error, above 0.
    pub integral: f64,
    /// Cross-track error, above 0.
    pub cross_track: f64,
    /// Heading error, 0 or above.
    pub heading: f64,
    /// Steering angle, 0 or above.
    pub steering_angle: f64,
    /// Steering rate, above 0.
    pub steering_rate: f64,
}

/// A robot that is steered by the difference of its wheels' speeds, and follows the rows of a crop by
/// two distance sensors (thesis 2.2.1).
///
/// Where no range is stated, [`control::row`] has it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rover {
    /// Length of the chassis, 10 cm to 5 m.
    pub length: Length,
    /// Width of the chassis, 10 cm to 3 m.
    pub width: Length,
    /// Middle of the left wheels to that of the right ones, 5 cm to 3 m.
    pub track: Length,
    /// The same as it acts in a turn: wheels that slip sideways make it larger.
    pub turning_track: Length,
    /// Distance of two of the three axles, 2 cm to 2 m.
    pub axle_spacing: Length,
    /// Speed between the rows, at most half the motors' full speed, so that turns have the rest.
    pub cruise: Speed,
    /// The motors of a side.
    pub motors: Motors,
    /// The distance sensors.
    pub sensors: DistanceSensors,
    /// The rows.
    pub rows: CropRows,
    /// The law that steers. Default: Furrow's.
    #[serde(default)]
    pub law: Law,
    /// Numbers of the thesis's law. Default: those with which it has the thesis's errors on simulated
    /// rows.
    #[serde(default)]
    pub thesis: ThesisLaw,
}

/// Guidance of a machine's autonomous run by the rows of a crop, as a supplement to satellites (thesis
/// 2.1). While it is off, its node is not on the bus and the others know nothing of it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RowGuidance {
    /// Whether it is on. Default: off.
    #[serde(default)]
    pub enabled: bool,
    /// Speed while the rows guide, at most the machine's cruise speed.
    pub speed: Speed,
    /// Longest age of the last sound message of the node, two basic cycles to 1 s; then the vehicle
    /// stops.
    pub longest_age: Time,
    /// Longest way without a fix, 1 m to 1 km; then the vehicle stops.
    pub longest_way: Length,
    /// How long the fix must be back before satellites guide again, 0 to 60 s.
    pub settle: Time,
    /// Rate at which the distance between the row's middle and the line is taken back after a change
    /// of the guide, 1 cm/s to 20 cm/s.
    pub take_back: Speed,
    /// Width of the machine between the rows, for reports of a run, 10 cm to 3 m.
    pub vehicle_width: Length,
    /// The node that measures the rows. Its messages stand in the file of its name with the ending
    /// `dbc`, its tasks in the one with the ending `tasks.toml`.
    pub node: Node,
    /// The event message by which this node reports its self-test.
    pub self_test: String,
    /// The signal that says what guides the vehicle, for reports of a run.
    pub guide: SignalPath,
    /// The distance sensors; they are ahead of the rear axle.
    pub sensors: DistanceSensors,
    /// The rows.
    pub rows: CropRows,
}

/// The name of the files with what missions add to the others.
pub(crate) const MISSION: &str = "mission";
/// The name of the files with what roll and pitch add to the others.
pub(crate) const TILT: &str = "tilt";
/// The name of the file with the messages of sessions.
const SESSION: &str = "session";

/// Missions: plans of any length in the flash of the controller's board, which an autonomous run drives in place of the
/// line between the waypoints (`control::mission`). Without a mission in the flash it drives the line. While they are
/// off, the images have nothing of them. What they add to the bus and to the task table stands in `mission.dbc` and
/// `mission.tasks.toml`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mission {
    /// Whether they are on. Default: off.
    #[serde(default)]
    pub enabled: bool,
    /// Speed in headland turns, at most the machine's limit.
    pub turn_speed: Speed,
    /// Share of the steering's angle and rate that no path uses, 0 to 50 %: it is left for corrections.
    pub reserve: Ratio,
    /// Width over everything, for fences, above 0 to 20 m.
    pub width: Length,
    /// From the rear axle to the front, for fences: the wheelbase, if missions are on, to 20 m.
    pub ahead: Length,
    /// From the rear axle to the rear, for fences, 0 to 20 m.
    pub behind: Length,
    /// How far paths stay away from fence and obstacles, beside this ground, 0 to 5 m: the vehicle may be as far off its
    /// path. Where the ground itself touches one, the run ends.
    pub clearance: Length,
    /// How far beside its path the vehicle may work, 0 to 5 m: farther off it, all sections are off.
    pub aside: Length,
    /// The message that says when the sections of an implement are switched in the next basic cycle. For each section from 1
    /// to 8 it has the signals `State1`, whether it is on when that cycle begins, and `After1`, after how many milliseconds
    /// it changes; 127 if it does not.
    pub sections: String,
}

/// Roll and pitch from an inertial sensor in the satellite receiver: they say where the antenna is on a slope
/// (`control::tilt`). While they are off, the images have nothing of them. What they add to the bus and to the task table
/// stands in `tilt.dbc` and `tilt.tasks.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Inertial {
    /// Whether they are on. Default: off.
    #[serde(default)]
    pub enabled: bool,
    /// How long the last roll and pitch count when no others come, two basic cycles to 5 s; then the ground counts as
    /// level.
    pub longest_age: Time,
}

/// Sessions of nodes with a key: the nodes that obey commands count their starts in the flash, and commands of a run
/// are sealed by a key that follows from these starts, so that nobody can play recorded ones to a later run. What they add to
/// the bus stands in `session.dbc`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sessions {
    /// Whether they are on. Default: off.
    #[serde(default)]
    pub enabled: bool,
    /// The signals with the numbers of starts, each of a node that obeys commands.
    pub starts: Vec<SignalPath>,
}

/// A computer above the control layer that may lead autonomous runs: it sends a curvature and a speed in each basic
/// cycle (thesis 5.2.5). It has no image, but its messages and their windows stand in the file of its name with the
/// ending `dbc`. While it is off, its messages are not in the schedule and nobody obeys them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Planner {
    /// Whether it is on. Default: off.
    #[serde(default)]
    pub enabled: bool,
    /// Its name, that of its node in the network file.
    pub name: String,
    /// Its message, with the signals `Curvature` (1/m, positive to the right) and `Speed` (m/s or a part of that).
    pub command: String,
    /// The signal that says who leads a run.
    pub lead: SignalPath,
    /// Longest age of its last command, two basic cycles to 1 s; then the vehicle stops.
    pub longest_age: Time,
    /// Largest lateral acceleration, 0.1 to 10 m/s2: in turns the vehicle drives slower than commanded.
    pub lateral_acceleration: Acceleration,
}

/// A bus guardian on a board of its own, which keeps a node that babbles off the bus
/// (`ttcan::guardian`). It listens and sends no message. While it is off, its board is not on the bus.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BusGuardian {
    /// Whether it is on. Default: off.
    #[serde(default)]
    pub enabled: bool,
    /// The guarded nodes, in the order of the board's taps ([`parts::Sled::taps`]).
    pub guards: Vec<String>,
    /// Its board. Its tasks stand in the file of its name with the ending `tasks.toml`.
    pub node: Node,
}

/// The motors of a rover's side on their motor driver, alike in both directions.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motors {
    /// Share of the full effort that moves nothing, 0 to 50 %.
    pub dead_band: Ratio,
    /// Speed of a wheel at full effort, above 0 to 10 m/s.
    pub full_speed: Speed,
    /// Time constant from commanded to real speed, 0 to 1 s.
    pub lag: Time,
}

/// Two distance sensors at the front of a robot. Each looks across the centre line, so that the
/// one on the right measures the left row (thesis, Figure 2.3).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistanceSensors {
    /// Apertures ahead of the point about which the robot turns.
    pub ahead: Length,
    /// Apertures to the left and to the right of the centre line.
    pub beside: Length,
    /// Angle of the beams against straight ahead, 10 to 90 deg.
    pub angle: Angle,
    /// Smallest reading of an intact sensor.
    pub least: Length,
    /// Reading from which on no plant is within range, at most 2.5 m, which is the largest distance
    /// on the bus.
    pub open: Length,
}

/// The rows that a robot follows.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CropRows {
    /// Distance between the stalks of two rows, up to 5 m; at least the robot's width and a stalk's
    /// diameter, with 10 cm on either side.
    pub width: Length,
    /// Standard deviation of that distance from row to row.
    pub tolerance: Length,
    /// Diameter of a stalk, 4 mm to 20 cm.
    pub stalk: Length,
    /// Longest gap in both rows at once, above 0 to 5 m. After it, and 60 cm more, the row has ended.
    pub gap: Length,
}

/// The law that steers a machine or a rover.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// Furrow's: an estimator of the vehicle's place, and a law that brings it to the line or to the
    /// middle between the rows.
    #[default]
    Furrow,
    /// The thesis's, on what the sensors say. A machine has state feedback with the gains of
    /// [`SteeringGains`]. A rover has one on the difference of its distances: proportional, or with an
    /// integral if [`ThesisLaw::integral`] is above 0.
    Thesis,
}

impl Law {
    /// All laws.
    pub const ALL: [Self; 2] = [Self::Furrow, Self::Thesis];

    /// Its name in a manifest.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Furrow => "furrow",
            Self::Thesis => "thesis",
        }
    }
}

/// Numbers of the thesis's law (thesis 2.2.5.3 and 2.2.6.1). Its text does not have them.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThesisLaw {
    /// Smallest plausible distance, 0 to 149 cm. Default 50 cm.
    pub least: Length,
    /// Largest plausible distance, at least a centimetre more, up to 150 cm. Default 120 cm.
    pub most: Length,
    /// Variance that a distance gains from one sample to the next, as a share of the variance of a
    /// sample, 1e-6 to 100. Default 0.01.
    pub process: f64,
    /// Effort for a difference of one centimetre, 1e-6 to 1. Default 0.0018.
    pub proportional: f64,
    /// Effort for a difference of one centimetre that lasts a second, 0 or 1e-6 to 1. Default 0.
    pub integral: f64,
    /// Limit of the difference, 1 cm to 150 cm. Default 40 cm.
    pub difference: Length,
    /// Limit of the effort, 0.2 % to 100 %. Default 10 %.
    pub effort: Ratio,
}

impl Default for ThesisLaw {
    fn default() -> Self {
        Self {
            least: Length::new(0.5),
            most: Length::new(1.2),
            process: 0.01,
            proportional: 0.0018,
            integral: 0.0,
            difference: Length::new(0.4),
            effort: Ratio::new(0.1),
        }
    }
}

/// The satellite receiver.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receiver {
    /// From a measurement to the first byte of its burst, 0 to 250 ms.
    pub latency: Time,
    /// Length of the burst, above 0 to 90 ms.
    pub burst: Time,
    /// Time between two measurements, 50 ms to 1 s.
    pub period: Time,
    /// How long before a reference the bursts should end, 0 to 50 ms. This absorbs the jitter
    /// of their begin and length: a burst must be read before the windows that send its
    /// measurements.
    pub lead: Time,
}

/// A point in the base station's frame, -10 to 10 km.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// Northing.
    pub north: Length,
    /// Easting.
    pub east: Length,
}

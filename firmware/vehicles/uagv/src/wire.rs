//! Converts the physical quantities of the shared modules to the vehicle's messages, and back.

use control::mode::Mode;
use control::position;
use firmware::actuator::{self, Refusal, check_motion};
use firmware::buttons::{self, Button, Edge};
use firmware::convert::{self, Geodetic};
use firmware::e2e;
use firmware::housekeeping::{self, NodeFault, ResetCause, Status, StatusMessage};
use firmware::link::{Link, Port, WindowTimer, padded};
use firmware::machine::MotionCommand;
use firmware::navigation::Update;
use firmware::pilot::{Change, Decision, Inputs, Reason};
use network::Message;
use ttcan::ErrorLevel;

use crate::Uagv;
use crate::matrix::{DRIVE, GPS, STEERING, window};
use crate::messages::{
    self as named, AdcCount, ButtonEvent, CentidegreesPerSecond, CentimetresPerSecond, Command,
    ControllerSelfTest, ControllerStatus, Degrees, DegreesE10, DegreesPerSecondQ8, DegreesQ8,
    DriveSelfTest, DriveState, DriveStatus, GpsSelfTest, GpsStatus, Heading, Latitude, LogControl,
    LogGuidance, LogMotion, LogPosition, Longitude, Millidegrees, Millimetres,
    MillimetresPerSecond, Milliseconds, ModeChange, Position, SelfTestRequest, SteeringPot,
    SteeringSelfTest, SteeringStatus, Velocity,
};
use crate::peers::{Peers, health};

impl actuator::Command for Command {
    fn check(&self) -> Result<(), Refusal> {
        check_motion::<Uagv, Self>(self)
    }
}

impl MotionCommand for Command {
    fn steering_rate(&self) -> f32 {
        convert::from_centidegrees_per_second(self.steering_rate.0)
    }

    fn speed(&self) -> f32 {
        convert::from_centimetres_per_second(self.speed.0)
    }

    fn is_driving_mode(&self) -> bool {
        matches!(self.mode, named::Mode::Manual | named::Mode::AutonomousRun)
    }

    fn steering_enabled(&self) -> bool {
        self.steering_enabled
    }

    fn drive_enabled(&self) -> bool {
        self.drive_enabled
    }

    fn emergency_stop(&self) -> bool {
        self.emergency_stop
    }
}

/// Inputs of a control step, from the messages on the controller's link. Each message is used
/// in one step only.
pub fn inputs<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
) -> Inputs {
    Inputs {
        position: link
            .message(window::POSITION)
            .map(|Position { north, east }| position::Position::new(north.0, east.0)),
        velocity: link
            .message(window::VELOCITY)
            .map(|Velocity { north, east }| position::Velocity::new(north.0, east.0)),
        pot: link
            .message(window::STEERING_POT)
            .map(|SteeringPot { count }| count.0),
        fixed: link.reference_byte() & 1 != 0,
        in_schedule: link.is_heard(),
        may_move: link.may_move(),
        ..Inputs::default()
    }
}

/// Data of message 300 after a step in the basic cycle that began at system time `time` (ms);
/// `sender` protects it.
pub fn command(decision: &Decision, sender: &mut e2e::Sender, time: u32) -> [u8; 8] {
    let Decision {
        mode,
        moving,
        command,
        ..
    } = decision;
    let mut data = Command {
        steering_rate: steering_rate(command.steering_rate),
        speed: speed(command.speed),
        mode: mode_of(*mode),
        steering_enabled: *moving,
        drive_enabled: *moving,
        emergency_stop: *mode == Mode::EmergencyStop,
        counter: 0,
        check: 0,
    }
    .encode();
    sender.seal::<Command>(time, &mut data);
    data
}

/// Data of the messages that log a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// Message 450.
    pub position: [u8; 8],
    /// Message 451.
    pub motion: [u8; 8],
    /// Message 452.
    pub guidance: [u8; 8],
    /// Message 453.
    pub control: [u8; 8],
}

impl Record {
    /// The messages of the step that decided so, with what the controller sees of the other nodes.
    pub fn of(decision: &Decision, peers: &Peers) -> Self {
        let Decision {
            command, tracking, ..
        } = decision;
        Self {
            position: LogPosition {
                x: Millimetres(decision.position.north),
                y: Millimetres(decision.position.east),
            }
            .encode(),
            motion: LogMotion {
                heading: DegreesQ8(convert::heading_q8(tracking.heading)),
                psi: DegreesQ8(convert::degrees_q8(tracking.heading_error)),
                speed: speed(tracking.speed),
            }
            .encode(),
            guidance: LogGuidance {
                cross_track_error: Millimetres(convert::millimetres(tracking.cross_track)),
                steering_angle: Millidegrees(convert::millidegrees(tracking.steering_angle)),
                steering_rate_command: steering_rate(command.steering_rate),
                speed_command: speed(command.speed),
            }
            .encode(),
            control: LogControl {
                control_input: DegreesPerSecondQ8(convert::degrees_q8(decision.control_input)),
                gps_health: health(peers, GPS),
                steering_health: health(peers, STEERING),
                drive_health: health(peers, DRIVE),
                steering_pot: AdcCount(decision.pot),
            }
            .encode(),
        }
    }
}

/// Data of the drive node's message: the speed of the command in force, if there is one, the last byte
/// to the motor driver, and whether the self-test bars the motor.
pub fn drive_state(command: Option<CentimetresPerSecond>, output: u8, barred: bool) -> [u8; 8] {
    let state = DriveState {
        speed: command.unwrap_or(CentimetresPerSecond(0)),
        commanded: command.is_some(),
        barred,
        output,
    };
    padded(state.encode())
}

fn steering_rate(rate: f32) -> CentidegreesPerSecond {
    CentidegreesPerSecond(convert::centidegrees_per_second(rate))
}

fn speed(speed: f32) -> CentimetresPerSecond {
    CentimetresPerSecond(convert::centimetres_per_second(speed))
}

/// The gps node's window for an update, and the data for it; `None` removes what was enqueued.
pub fn update(update: Update) -> (usize, Option<[u8; 8]>) {
    match update {
        Update::Position(position) => (
            window::POSITION,
            position.map(|position| {
                Position {
                    north: Millimetres(position.north),
                    east: Millimetres(position.east),
                }
                .encode()
            }),
        ),
        Update::Velocity(velocity) => (
            window::VELOCITY,
            velocity.map(|velocity| {
                Velocity {
                    north: MillimetresPerSecond(velocity.north),
                    east: MillimetresPerSecond(velocity.east),
                }
                .encode()
            }),
        ),
        Update::Heading(heading) => (
            window::HEADING,
            heading.map(|heading| {
                let heading = Millidegrees(heading);
                padded(Heading { heading }.encode())
            }),
        ),
        Update::Latitude(angle) => (
            window::LATITUDE,
            angle.map(|angle| padded(latitude(angle).encode())),
        ),
        Update::Longitude(angle) => (
            window::LONGITUDE,
            angle.map(|angle| padded(longitude(angle).encode())),
        ),
    }
}

/// The message for a latitude.
pub const fn latitude(angle: Geodetic) -> Latitude {
    Latitude {
        fraction: DegreesE10(angle.fraction),
        whole: Degrees(angle.whole),
        negative: angle.negative,
    }
}

/// The message for a longitude.
pub const fn longitude(angle: Geodetic) -> Longitude {
    Longitude {
        fraction: DegreesE10(angle.fraction),
        whole: Degrees(angle.whole),
        negative: angle.negative,
    }
}

/// The event message of a change of mode, with its sequence number and the system time in ms.
pub const fn mode_change(change: &Change, counter: u8, time: u32) -> ModeChange {
    ModeChange {
        previous: mode_of(change.previous),
        mode: mode_of(change.mode),
        reason: match change.reason {
            Reason::StartUp => named::ModeReason::StartUp,
            Reason::ButtonA => named::ModeReason::ButtonA,
            Reason::ButtonB => named::ModeReason::ButtonB,
            Reason::ButtonC => named::ModeReason::ButtonC,
            Reason::ButtonD => named::ModeReason::ButtonD,
            Reason::StopLoop => named::ModeReason::StopLoop,
            Reason::FixLost => named::ModeReason::FixLost,
            Reason::BusFault => named::ModeReason::BusFault,
            Reason::NodeFault => named::ModeReason::NodeFault,
            Reason::MasterLost => named::ModeReason::MasterLost,
            Reason::PathEnd => named::ModeReason::PathEnd,
            Reason::Steering => named::ModeReason::Steering,
            Reason::Speed => named::ModeReason::Speed,
            Reason::Course => named::ModeReason::Course,
            Reason::OffPath => named::ModeReason::OffPath,
            Reason::NoHeading => named::ModeReason::NoHeading,
            Reason::Joystick => named::ModeReason::Joystick,
            Reason::NoCommands => named::ModeReason::NoCommands,
            Reason::Fence => named::ModeReason::Fence,
            Reason::FarOff => named::ModeReason::FarOff,
        },
        counter,
        system_time: Milliseconds(time),
    }
}

/// The event message of a button.
pub const fn button_event(change: buttons::Change) -> ButtonEvent {
    ButtonEvent {
        button: match change.button {
            Button::A => named::Button::A,
            Button::B => named::Button::B,
            Button::C => named::Button::C,
            Button::D => named::Button::D,
            Button::Joystick => named::Button::Joystick,
            Button::StopLoop => named::Button::StopLoop,
        },
        pressed: matches!(change.edge, Edge::Pressed),
        counter: change.count,
    }
}

/// The mode as the network names it.
pub const fn mode_of(mode: Mode) -> named::Mode {
    match mode {
        Mode::Idle => named::Mode::Idle,
        Mode::Manual => named::Mode::Manual,
        Mode::AutonomousReady => named::Mode::AutonomousReady,
        Mode::AutonomousRun => named::Mode::AutonomousRun,
        Mode::EmergencyStop => named::Mode::EmergencyStop,
        Mode::Fault => named::Mode::Fault,
    }
}

/// Implements [`StatusMessage`] for the nodes' status messages, which share one layout.
macro_rules! status_messages {
    ($($message:ident, $report:ident;)*) => {$(
        impl StatusMessage for $message {
            type Report = $report;
            type Request = SelfTestRequest;

            fn of(status: &Status) -> Self {
                Self {
                    reset_cause: reset_cause(status.reset_cause),
                    error_level: error_level(status.error_level),
                    bus_state: bus_state(status.bus),
                    fault: fault(status.fault),
                    transmit_errors: status.transmit_errors,
                    receive_errors: status.receive_errors,
                    missed_windows: status.missed_windows,
                    fault_detail: status.bus_offs,
                }
            }
        }
    )*};
}

#[cfg(not(row_guidance))]
firmware::self_test_messages!(
    GpsSelfTest,
    ControllerSelfTest,
    SteeringSelfTest,
    DriveSelfTest
);

#[cfg(row_guidance)]
firmware::self_test_messages!(
    GpsSelfTest,
    ControllerSelfTest,
    SteeringSelfTest,
    DriveSelfTest,
    RowsSelfTest
);

#[cfg(row_guidance)]
use crate::messages::{RowsSelfTest, RowsStatus};

#[cfg(row_guidance)]
status_messages! {
    RowsStatus, RowsSelfTest;
}

status_messages! {
    GpsStatus, GpsSelfTest;
    ControllerStatus, ControllerSelfTest;
    SteeringStatus, SteeringSelfTest;
    DriveStatus, DriveSelfTest;
}

const fn reset_cause(cause: ResetCause) -> named::ResetCause {
    match cause {
        ResetCause::Power => named::ResetCause::PowerOn,
        ResetCause::Pin => named::ResetCause::Pin,
        ResetCause::Software => named::ResetCause::Software,
        ResetCause::Watchdog => named::ResetCause::IndependentWatchdog,
        ResetCause::Other => named::ResetCause::Unknown,
    }
}

const fn error_level(level: ErrorLevel) -> named::ErrorLevel {
    match level {
        ErrorLevel::None => named::ErrorLevel::None,
        ErrorLevel::Warning => named::ErrorLevel::Warning,
        ErrorLevel::Error => named::ErrorLevel::Error,
        ErrorLevel::Severe(_) => named::ErrorLevel::Severe,
    }
}

const fn bus_state(state: housekeeping::BusState) -> named::BusState {
    match state {
        housekeeping::BusState::ErrorActive => named::BusState::ErrorActive,
        housekeeping::BusState::ErrorPassive => named::BusState::ErrorPassive,
        housekeeping::BusState::BusOff => named::BusState::BusOff,
    }
}

const fn fault(fault: Option<NodeFault>) -> named::Fault {
    match fault {
        None => named::Fault::None,
        Some(NodeFault::Panic) => named::Fault::Panic,
        Some(NodeFault::HardFault) => named::Fault::HardFault,
        Some(NodeFault::StartRefused) => named::Fault::ScheduleRefused,
        Some(NodeFault::ClockFailure) => named::Fault::ClockFailure,
        Some(NodeFault::WatchdogStarved) => named::Fault::WatchdogStarved,
        Some(NodeFault::SelfTest) => named::Fault::SelfTest,
        Some(NodeFault::SupplyLow) => named::Fault::SupplyLow,
    }
}

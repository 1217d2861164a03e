//! The controller's step: mode, states, control law, and the messages that come of them.

use control::controller::{Sample, SettingsError, Tracking};
use control::line::{Line, LineError};
use control::mode::{Conditions, Mode, ModeMachine, Request, Source};
use control::position;
use control::safety;
use network::Message;
use network::matrix::window;
use network::messages::{
    AdcCount, Command, LogControl, LogGuidance, LogMotion, LogPosition, Millidegrees, Millimetres,
    Milliseconds, ModeChange, ModeReason, Position, SteeringPot, Velocity,
};

use crate::buttons::{Button, Buttons, Edge};
use crate::console::PilotView;
use crate::display::View;
use crate::link::{Link, Port, WindowTimer};
use crate::{convert, design, e2e};

/// What turns samples into commands.
#[cfg(not(feature = "thesis-law"))]
type Law = control::controller::Controller<f32>;
/// The thesis's law in its place.
#[cfg(feature = "thesis-law")]
type Law = control::plain::PlainController<f32>;

/// Time between two steps, s: the basic cycle.
const PERIOD: f32 = network::matrix::BASIC_CYCLE.ticks() as f32 * 1e-6;

/// Steps that the potentiometer may be missing while actuators move.
const POT_PATIENCE: u8 = 3;

/// What the logs say before the first step.
const AT_REST: Tracking<f32> = Tracking {
    segment: 0,
    along: 0.0,
    cross_track: 0.0,
    heading: 0.0,
    heading_error: 0.0,
    steering_angle: 0.0,
    speed: 0.0,
};

/// The waypoints or the vehicle's settings make no controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DesignError {
    /// The waypoints.
    Line(LineError),
    /// The settings.
    Settings(SettingsError),
}

/// What the bus and the operator brought since the last step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Inputs {
    /// Message 200 of this cycle.
    pub position: Option<Position>,
    /// Message 201 of this cycle.
    pub velocity: Option<Velocity>,
    /// Message 206 of this cycle, counts.
    pub pot: Option<u16>,
    /// Fix flag of the last reference.
    pub fixed: bool,
    /// Whether the node keeps the schedule and is not silenced by its errors.
    pub in_schedule: bool,
    /// System time at which the basic cycle began, ms.
    pub cycle_began: u32,
    /// Latest samples of the joystick, x and y.
    pub joystick: (u16, u16),
}

impl Inputs {
    /// What has arrived on a link; each message counts for one step.
    pub fn take<P: Port, T: WindowTimer>(link: &mut Link<P, T>) -> Self {
        fn message<P: Port, T: WindowTimer, M: Message>(
            link: &mut Link<P, T>,
            window: usize,
        ) -> Option<M> {
            link.take(window)
                .and_then(|frame| M::decode(frame.data()).ok())
        }
        Self {
            position: message(link, window::POSITION),
            velocity: message(link, window::VELOCITY),
            pot: message(link, window::STEERING_POT).map(|SteeringPot { count }| count.0),
            fixed: link.reference_byte() & 1 != 0,
            in_schedule: link.is_heard(),
            cycle_began: link.cycle_began(),
            joystick: (design::JOYSTICK_CENTRE, design::JOYSTICK_CENTRE),
        }
    }
}

/// A change of mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// The mode left.
    pub previous: Mode,
    /// The mode entered.
    pub mode: Mode,
    /// What caused it.
    pub reason: ModeReason,
}

impl Change {
    /// Its event message, with its number and the system time in ms.
    pub const fn event(&self, counter: u8, time: u32) -> ModeChange {
        ModeChange {
            previous: network_mode(self.previous),
            mode: network_mode(self.mode),
            reason: self.reason,
            counter,
            system_time: Milliseconds(time),
        }
    }
}

/// Data for the node's windows after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frames {
    /// Message 300.
    pub command: [u8; 8],
    /// Message 450.
    pub position: [u8; 8],
    /// Message 451.
    pub motion: [u8; 8],
    /// Message 452.
    pub guidance: [u8; 8],
    /// Message 453.
    pub control: [u8; 8],
}

/// Everything that the controller node decides with.
#[derive(Clone, Debug)]
pub struct Pilot {
    modes: ModeMachine,
    controller: Law,
    sender: e2e::Sender,
    applied: safety::Command<f32>,
    tracking: Tracking<f32>,
    position: Position,
    pot: u16,
    pot_missing: u8,
    position_missing: u8,
    request: Request,
    request_reason: ModeReason,
    fixed: bool,
    finished: bool,
    steps: u32,
}

impl Pilot {
    /// A pilot in idle, for the line and the vehicle of [`design`].
    ///
    /// # Errors
    /// Which of the design's constants is unusable.
    pub fn new() -> Result<Self, DesignError> {
        let line = Line::new(design::WAYPOINT_A, design::WAYPOINT_B).map_err(DesignError::Line)?;
        let mut settings = design::SETTINGS;
        settings.estimator.gps_delay = design::RECEIVER_AGE.ticks() as f32 * 1e-6;
        let controller = Law::new(settings, line).map_err(DesignError::Settings)?;
        Ok(Self {
            modes: ModeMachine::new(),
            controller,
            sender: e2e::Sender::default(),
            applied: safety::Command::still(),
            tracking: AT_REST,
            position: Position {
                north: Millimetres(0),
                east: Millimetres(0),
            },
            pot: 0,
            pot_missing: POT_PATIENCE,
            position_missing: design::POSITION_PATIENCE,
            request: Request::None,
            request_reason: ModeReason::StartUp,
            fixed: false,
            finished: false,
            steps: 0,
        })
    }

    /// Notes a button; what it asks for is decided at the next step. An emergency stop is
    /// never replaced by what comes after it.
    pub fn button(&mut self, button: Button, edge: Edge) {
        if edge == Edge::Released || self.request == Request::EmergencyStop {
            return;
        }
        let (request, reason) = match button {
            Button::A => (Request::Release, ModeReason::ButtonA),
            Button::B => (Request::Manual, ModeReason::ButtonB),
            Button::C => (Request::Autonomous, ModeReason::ButtonC),
            Button::D | Button::Joystick => (Request::EmergencyStop, ModeReason::ButtonD),
            Button::StopLoop => (Request::EmergencyStop, ModeReason::StopLoop),
        };
        self.request = request;
        self.request_reason = reason;
    }

    /// One step, once in each basic cycle.
    pub fn step(&mut self, inputs: &Inputs, buttons: &Buttons) -> (Frames, Option<Change>) {
        self.steps = self.steps.wrapping_add(1);
        match inputs.pot {
            Some(count) => {
                self.pot = count;
                self.pot_missing = 0;
            }
            None => self.pot_missing = self.pot_missing.saturating_add(1),
        }
        match inputs.position {
            Some(position) => {
                self.position = position;
                self.position_missing = 0;
            }
            None => self.position_missing = self.position_missing.saturating_add(1),
        }
        self.fixed = inputs.fixed && self.position_missing < design::POSITION_PATIENCE;
        let change = self.change_mode(inputs, buttons);
        let mode = self.modes.mode();

        let outcome = self.controller.step(&Sample {
            position: inputs
                .position
                .map(|Position { north, east }| position::Position::new(north.0, east.0)),
            velocity: inputs
                .velocity
                .map(|Velocity { north, east }| position::Velocity::new(north.0, east.0)),
            steering_angle: inputs
                .pot
                .and_then(|count| design::POTENTIOMETER.angle(count).ok()),
            applied: self.applied,
            engaged: mode.source() == Source::Law,
            dt: PERIOD,
        });
        self.tracking = outcome.tracking;
        self.finished = outcome.finished;
        self.applied = match mode.source() {
            Source::Law => outcome.command,
            Source::Joystick => joystick_command(inputs.joystick),
            Source::Still => safety::Command::still(),
        };
        (self.frames(mode, inputs.cycle_began), change)
    }

    fn change_mode(&mut self, inputs: &Inputs, buttons: &Buttons) -> Option<Change> {
        let previous = self.modes.mode();
        let driving = previous.source() != Source::Still;
        let blind = self.pot_missing >= POT_PATIENCE;
        let conditions = Conditions {
            fixed_solution: self.fixed,
            stop_loop_open: buttons.is_pressed(Button::StopLoop),
            fault: driving && (blind || !inputs.in_schedule),
        };
        let mut request = core::mem::take(&mut self.request);
        if self.finished && previous == Mode::AutonomousRun && request == Request::None {
            // At the end of the path the run ends as if its button were pressed again.
            request = Request::Autonomous;
            self.request_reason = ModeReason::PathEnd;
        }
        let mode = self.modes.step(request, conditions);
        (mode != previous).then_some(Change {
            previous,
            mode,
            reason: if conditions.stop_loop_open {
                ModeReason::StopLoop
            } else if conditions.fault && !inputs.in_schedule {
                ModeReason::BusFault
            } else if conditions.fault {
                ModeReason::NodeFault
            } else if request != Request::None {
                self.request_reason
            } else {
                ModeReason::FixLost
            },
        })
    }

    fn frames(&mut self, mode: Mode, cycle_began: u32) -> Frames {
        let tracking = &self.tracking;
        let moving = mode.source() != Source::Still;
        let steering_rate = convert::steering_rate(self.applied.steering_rate);
        let speed = convert::speed(self.applied.speed);
        let mut command = Command {
            steering_rate,
            speed,
            mode: network_mode(mode),
            steering_enabled: moving,
            drive_enabled: moving,
            emergency_stop: mode == Mode::EmergencyStop,
            counter: 0,
            check: 0,
        }
        .encode();
        self.sender.seal(Command::ID, cycle_began, &mut command);
        Frames {
            command,
            position: LogPosition {
                x: self.position.north,
                y: self.position.east,
            }
            .encode(),
            motion: LogMotion {
                heading: convert::heading_q8(tracking.heading),
                psi: convert::degrees_q8(tracking.heading_error),
                speed: convert::speed(tracking.speed),
            }
            .encode(),
            guidance: LogGuidance {
                cross_track_error: convert::millimetres(tracking.cross_track),
                steering_angle: convert::millidegrees(tracking.steering_angle),
                steering_rate_command: steering_rate,
                speed_command: speed,
            }
            .encode(),
            control: LogControl {
                control_input: convert::degrees_per_second_q8(self.applied.steering_rate),
                steering_pot: AdcCount(self.pot),
            }
            .encode(),
        }
    }

    /// Steps so far; wraps.
    pub const fn steps(&self) -> u32 {
        self.steps
    }

    /// What the display shows at system time `time` (ms); `bus` says whether the schedule is
    /// kept.
    pub const fn view(&self, time: u32, bus: bool) -> View {
        View {
            from: design::WAYPOINT_A,
            to: design::WAYPOINT_B,
            north: self.position.north.0,
            east: self.position.east.0,
            tracking: self.tracking,
            time,
            mode: self.modes.mode(),
            bus,
            fixed: self.fixed,
        }
    }

    /// What the console says; `display` says whether the display answers.
    pub fn line(&self, display: bool) -> PilotView {
        let Millidegrees(heading_error) = convert::millidegrees(self.tracking.heading_error);
        PilotView {
            mode: self.modes.mode(),
            north: self.position.north,
            east: self.position.east,
            cross_track: convert::millimetres(self.tracking.cross_track),
            heading_error,
            fixed: self.fixed,
            display,
        }
    }

    /// The present mode.
    pub const fn mode(&self) -> Mode {
        self.modes.mode()
    }
}

/// Joystick to command: x steers, y drives, both in proportion.
fn joystick_command((x, y): (u16, u16)) -> safety::Command<f32> {
    safety::Command {
        steering_rate: convert::joystick(x) * design::STEERING_RATE_LIMIT,
        speed: convert::joystick(y) * design::SPEED_LIMIT,
    }
}

/// The mode as the network names it.
pub const fn network_mode(mode: Mode) -> network::messages::Mode {
    use network::messages::Mode as Named;
    match mode {
        Mode::Idle => Named::Idle,
        Mode::Manual => Named::Manual,
        Mode::AutonomousReady => Named::AutonomousReady,
        Mode::AutonomousRun => Named::AutonomousRun,
        Mode::EmergencyStop => Named::EmergencyStop,
        Mode::Fault => Named::Fault,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::actuator::CommandHold;
    use network::messages::{MillimetresPerSecond, Mode as Named};

    fn inputs(fixed: bool) -> Inputs {
        Inputs {
            position: fixed.then_some(Position {
                north: Millimetres(1000),
                east: Millimetres(1000),
            }),
            velocity: Some(Velocity {
                north: MillimetresPerSecond(1000),
                east: MillimetresPerSecond(0),
            }),
            pot: Some(2048),
            fixed,
            in_schedule: true,
            cycle_began: 7,
            joystick: (2048, 4095),
        }
    }

    fn press(pilot: &mut Pilot, button: Button) {
        pilot.button(button, Edge::Pressed);
        pilot.button(button, Edge::Released);
    }

    fn step(pilot: &mut Pilot, inputs: &Inputs) -> (Command, Option<Change>) {
        let (frames, change) = pilot.step(inputs, &Buttons::default());
        (Command::decode(&frames.command).unwrap(), change)
    }

    #[test]
    fn a_run_needs_two_presses_and_a_fix_and_ends_with_it() {
        let mut pilot = Pilot::new().unwrap();
        let (command, _) = step(&mut pilot, &inputs(false));
        assert_eq!(command.mode, Named::Idle);
        for _ in 0..2 {
            press(&mut pilot, Button::C);
            let (command, _) = step(&mut pilot, &inputs(false));
            assert_eq!(command.mode, Named::AutonomousReady);
            assert!(!command.drive_enabled && !command.steering_enabled);
        }
        press(&mut pilot, Button::C);
        let (command, change) = step(&mut pilot, &inputs(true));
        assert_eq!(command.mode, Named::AutonomousRun);
        assert_eq!(change.unwrap().reason, ModeReason::ButtonC);
        let (command, _) = step(&mut pilot, &inputs(true));
        // One metre right of the line: steer left.
        assert!(command.steering_rate.0 < 0 && command.speed.0 > 0);
        let (command, change) = step(&mut pilot, &inputs(false));
        assert_eq!(command.mode, Named::AutonomousReady);
        assert_eq!(command.speed.0, 0);
        assert_eq!(change.unwrap().reason, ModeReason::FixLost);
    }

    /// The gps node keeps its position window empty as soon as the fix is gone, and says so in
    /// the reference: a flag without a position is a lost frame.
    #[test]
    fn one_lost_position_frame_does_not_end_a_run_two_do() {
        let mut pilot = Pilot::new().unwrap();
        for _ in 0..2 {
            press(&mut pilot, Button::C);
            let _ = step(&mut pilot, &inputs(true));
        }
        let lost = Inputs {
            position: None,
            ..inputs(true)
        };
        for _ in 0..3 {
            let (command, _) = step(&mut pilot, &lost);
            assert_eq!(command.mode, Named::AutonomousRun);
            let (command, _) = step(&mut pilot, &inputs(true));
            assert_eq!(command.mode, Named::AutonomousRun);
        }
        let _ = step(&mut pilot, &lost);
        let (command, change) = step(&mut pilot, &lost);
        assert_eq!((command.mode, command.speed.0), (Named::AutonomousReady, 0));
        assert_eq!(change.unwrap().reason, ModeReason::FixLost);
    }

    #[test]
    fn a_run_ends_at_the_end_of_the_path() {
        let mut pilot = Pilot::new().unwrap();
        let at = |north| Inputs {
            position: Some(Position {
                north: Millimetres(north),
                east: Millimetres(0),
            }),
            ..inputs(true)
        };
        for _ in 0..2 {
            press(&mut pilot, Button::C);
            let _ = step(&mut pilot, &at(242_000));
        }
        let (command, _) = step(&mut pilot, &at(242_100));
        assert_eq!(command.mode, Named::AutonomousRun);
        let changes: std::vec::Vec<_> = (1..20)
            .filter_map(|tenth| step(&mut pilot, &at(242_100 + 100 * tenth)).1)
            .collect();
        assert_eq!(changes.len(), 1, "{changes:?}");
        assert_eq!(
            (changes[0].mode, changes[0].reason),
            (Mode::AutonomousReady, ModeReason::PathEnd)
        );
        let beyond = at(244_100);
        let (command, _) = step(&mut pilot, &beyond);
        assert!(!command.drive_enabled && command.speed.0 == 0);
    }

    #[test]
    fn the_joystick_drives_without_a_fix_and_the_stop_wins() {
        let mut pilot = Pilot::new().unwrap();
        let _ = step(&mut pilot, &inputs(false));
        press(&mut pilot, Button::B);
        let (command, _) = step(&mut pilot, &inputs(false));
        assert_eq!((command.mode, command.speed.0), (Named::Manual, 200));
        press(&mut pilot, Button::Joystick);
        press(&mut pilot, Button::A);
        let (command, change) = step(&mut pilot, &inputs(false));
        assert_eq!(command.mode, Named::EmergencyStop);
        assert!(command.emergency_stop && !command.drive_enabled);
        assert_eq!(change.unwrap().reason, ModeReason::ButtonD);
        press(&mut pilot, Button::B);
        let (command, _) = step(&mut pilot, &inputs(false));
        assert_eq!(command.mode, Named::EmergencyStop);
        press(&mut pilot, Button::A);
        let (command, _) = step(&mut pilot, &inputs(false));
        assert_eq!(command.mode, Named::Idle);
    }

    #[test]
    fn moving_without_steering_angle_is_a_fault() {
        let mut pilot = Pilot::new().unwrap();
        let _ = step(&mut pilot, &inputs(true));
        press(&mut pilot, Button::B);
        let blind = Inputs {
            pot: None,
            ..inputs(true)
        };
        let modes: std::vec::Vec<_> = (0..4).map(|_| step(&mut pilot, &blind).0.mode).collect();
        assert_eq!(
            modes,
            [Named::Manual, Named::Manual, Named::Fault, Named::Fault]
        );
    }

    #[test]
    fn every_command_passes_the_actuators_judgement() {
        let mut pilot = Pilot::new().unwrap();
        let mut hold = CommandHold::new();
        let (frames, _) = pilot.step(&inputs(true), &Buttons::default());
        let _ = hold.receive(&frames.command, 7);
        for (index, button) in [
            Button::B,
            Button::A,
            Button::C,
            Button::C,
            Button::D,
            Button::A,
        ]
        .into_iter()
        .cycle()
        .take(600)
        .enumerate()
        {
            if index % 5 == 0 {
                press(&mut pilot, button);
            }
            let (frames, _) = pilot.step(&inputs(index % 7 != 0), &Buttons::default());
            assert!(hold.receive(&frames.command, 7).is_ok());
        }
    }
}

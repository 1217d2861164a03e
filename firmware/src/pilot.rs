//! The controller's step: mode, states, control law. The vehicle's crate turns its decisions
//! into messages.

use core::marker::PhantomData;

use control::controller::{Sample, SettingsError, Tracking};
use control::line::{Line, LineError};
use control::mode::{self, Conditions, Mode, ModeMachine, Request, Source};
use control::position::{Position, Velocity};
use control::response::{Departure, Response, ResponseSettings, ResponseWatch};
use control::safety;

use crate::buttons::{Button, Buttons, Edge};
use crate::console::PilotView;
use crate::display::View;
use crate::guide::{Guidance, GuideError, Known, Lead, Motion};
use crate::machine::Machine;
use crate::peers::Named;
use crate::steering::Law as _;
use crate::{convert, design};

/// Steps without a potentiometer reading that are tolerated while actuators move.
const POT_PATIENCE: u8 = 3;

/// Steps within which C, A, C of a latching remote control start a run: 2 s. Its output shows no
/// second press of C.
const CONFIRM_STEPS: u8 = 20;

/// Share of the joystick's travel that ends an autonomous run, and the steps for which it must be there.
const JOYSTICK_MOVED: f32 = 0.25;
const JOYSTICK_STEPS: u8 = 2;

/// Tracking before the first step, for the logging messages.
const AT_REST: Tracking<f32> = Tracking {
    segment: 0,
    along: 0.0,
    cross_track: 0.0,
    heading: 0.0,
    heading_error: 0.0,
    steering_angle: 0.0,
    speed: 0.0,
};

/// Why no controller can be built from the waypoints and the vehicle's settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DesignError {
    /// The waypoints.
    Line(LineError),
    /// The settings.
    Settings(SettingsError),
    /// What guides a run besides the path.
    Guide(GuideError),
}

/// Inputs of a step: from the bus and from the operator.
#[derive(Clone, Copy, Debug)]
pub struct Inputs {
    /// Position of this cycle, mm.
    pub position: Option<Position>,
    /// Velocity of this cycle, mm/s.
    pub velocity: Option<Velocity>,
    /// Reading of the steering's potentiometer of this cycle, counts.
    pub pot: Option<u16>,
    /// Fix flag of the last reference.
    pub fixed: bool,
    /// Whether the node keeps the schedule and is not silenced by its errors.
    pub in_schedule: bool,
    /// Whether actuators may move under the time master that leads the bus.
    pub may_move: bool,
    /// Latest samples of the joystick, x and y, counts.
    pub joystick: (u16, u16),
}

impl Default for Inputs {
    /// No messages, and the joystick at rest.
    fn default() -> Self {
        Self {
            position: None,
            velocity: None,
            pot: None,
            fixed: false,
            in_schedule: false,
            may_move: false,
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
    pub reason: Reason,
}

/// Why a mode was entered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Reason {
    /// The node started.
    StartUp,
    /// Button A: release.
    ButtonA,
    /// Button B: manual.
    ButtonB,
    /// Button C: autonomous.
    ButtonC,
    /// Button D or the joystick's switch: emergency stop.
    ButtonD,
    /// The emergency stop loop was opened.
    StopLoop,
    /// The receiver's solution is no longer fixed.
    FixLost,
    /// The node lost the schedule of the bus.
    BusFault,
    /// The time master was lost, and the vehicle does not drive under its backup.
    MasterLost,
    /// The potentiometer's messages are missing.
    NodeFault,
    /// The vehicle reached the end of its path.
    PathEnd,
    /// The steering does not follow its commands.
    Steering,
    /// The speed over ground is not the commanded one.
    Speed,
    /// The course does not turn as the steering angle says.
    Course,
    /// The vehicle has left its path.
    OffPath,
    /// The heading is not known.
    NoHeading,
    /// The joystick was moved in an autonomous run.
    Joystick,
    /// The planner that led the run sends no commands any more.
    NoCommands,
    /// The vehicle is out of the fence of its mission, or touches an obstacle.
    Fence,
    /// The vehicle is too far from the origin of its mission.
    FarOff,
}

impl Reason {
    const fn of(departure: Departure) -> Self {
        match departure {
            Departure::Steering => Self::Steering,
            Departure::Speed => Self::Speed,
            Departure::Course => Self::Course,
            Departure::Path => Self::OffPath,
            Departure::Heading => Self::NoHeading,
        }
    }

    /// In words for an operator, up to 13 characters.
    pub const fn text(self) -> &'static str {
        match self {
            Self::StartUp => "start-up",
            Self::ButtonA => "button A",
            Self::ButtonB => "button B",
            Self::ButtonC => "button C",
            Self::ButtonD => "button D",
            Self::StopLoop => "stop loop",
            Self::FixLost => "fix lost",
            Self::BusFault => "bus",
            Self::MasterLost => "time master",
            Self::NodeFault => "potentiometer",
            Self::PathEnd => "end of path",
            Self::Steering => "steering",
            Self::Speed => "speed",
            Self::Course => "course",
            Self::OffPath => "off the path",
            Self::NoHeading => "no heading",
            Self::Joystick => "joystick",
            Self::NoCommands => "no commands",
            Self::Fence => "fence",
            Self::FarOff => "far off",
        }
    }
}

/// Result of a step.
#[derive(Clone, Copy, Debug)]
pub struct Decision {
    /// Mode.
    pub mode: Mode,
    /// Whether the actuators may move.
    pub moving: bool,
    /// Command to the actuators.
    pub command: safety::Command<f32>,
    /// Steering rate that the control law itself asks for, before limits, rad/s; 0 while it does
    /// not command the actuators.
    pub control_input: f32,
    /// Where the vehicle is relative to its path.
    pub tracking: Tracking<f32>,
    /// Last position, mm.
    pub position: Position,
    /// Last reading of the potentiometer, counts.
    pub pot: u16,
}

/// Everything that the controller node's decisions depend on.
#[derive(Clone, Debug)]
pub struct Pilot<M: Machine> {
    modes: ModeMachine,
    controller: M::Law,
    guide: M::Guide,
    applied: safety::Command<f32>,
    control_input: f32,
    tracking: Tracking<f32>,
    position: Position,
    pot: u16,
    pot_missing: u8,
    position_missing: u8,
    velocity_missing: u8,
    /// Steps since the solution was fixed.
    unfixed: u8,
    request: Request,
    request_reason: Reason,
    /// The request stands for two presses of the button.
    twice: bool,
    /// The request is of a latching remote control.
    selected: bool,
    /// Steps in which C counts as pressed again.
    confirm: u8,
    /// Why the current mode was entered.
    mode_reason: Reason,
    fixed: bool,
    finished: bool,
    /// Compares commands with what the vehicle does, what it compares next, and what it found.
    watch: ResponseWatch<f32>,
    response: Option<Response<f32>>,
    departure: Option<Departure>,
    /// Why the vehicle must not drive by itself where it is.
    strays: Option<Reason>,
    /// Steps for which the joystick has been moved in an autonomous run.
    joystick_moved: u8,
    steps: u32,
    machine: PhantomData<M>,
}

impl<M: Machine> Pilot<M> {
    /// Steps from one position to the next, and half a step.
    const STEPS: f32 = M::INTERVAL / M::PERIOD + 0.5;
    /// Steps without a position, or without a velocity, from which on they are missing.
    const PATIENCE: u8 = design::POSITION_PATIENCE
        * if Self::STEPS < 1.5 {
            1
        } else {
            Self::STEPS as u8
        };
    /// Steps without a fixed solution that a run goes on.
    const BRIDGED: u8 = (design::BRIDGED / M::PERIOD + 0.5) as u8;

    /// A pilot in idle, for the machine and its route.
    ///
    /// # Errors
    /// Which of the machine's numbers is unusable.
    pub fn new() -> Result<Self, DesignError> {
        let [from, to] = M::ROUTE;
        let line = Line::new(from, to).map_err(DesignError::Line)?;
        let controller = M::Law::new(&M::LAW, M::SETTINGS, line).map_err(DesignError::Settings)?;
        Ok(Self {
            modes: ModeMachine::new(),
            controller,
            guide: M::Guide::new(&M::GUIDE, &M::SETTINGS).map_err(DesignError::Guide)?,
            applied: safety::Command::still(),
            control_input: 0.0,
            tracking: AT_REST,
            position: Position::new(0, 0),
            pot: 0,
            pot_missing: POT_PATIENCE,
            position_missing: Self::PATIENCE,
            velocity_missing: Self::PATIENCE,
            unfixed: u8::MAX,
            request: Request::None,
            request_reason: Reason::StartUp,
            twice: false,
            selected: false,
            confirm: 0,
            mode_reason: Reason::StartUp,
            fixed: false,
            finished: false,
            watch: ResponseWatch::new(ResponseSettings::of(&M::SETTINGS)),
            response: None,
            departure: None,
            strays: None,
            joystick_moved: 0,
            steps: 0,
            machine: PhantomData,
        })
    }

    /// Notes a button; the next step acts on it. A later button never replaces an emergency
    /// stop.
    ///
    /// Every edge of button D and of the joystick's switch is an emergency stop, so that no
    /// remote control of another kind and no broken wire can defeat it. [`Edge::Fallen`] only
    /// ends driving.
    pub fn button(&mut self, button: Button, edge: Edge) {
        if self.request == Request::EmergencyStop {
            return;
        }
        // One match over all buttons: a second one, over those that are left, would leave a trap
        // in the image for the others.
        let (request, reason) = match button {
            Button::A => (Request::Release, Reason::ButtonA),
            Button::B => (Request::Manual, Reason::ButtonB),
            Button::C => (Request::Autonomous, Reason::ButtonC),
            Button::D | Button::Joystick => (Request::EmergencyStop, Reason::ButtonD),
            Button::StopLoop => (Request::EmergencyStop, Reason::StopLoop),
        };
        let always = reason == Reason::ButtonD;
        if edge == Edge::Released && !always {
            return;
        }
        let stops = request == Request::EmergencyStop;
        self.request = match edge {
            Edge::Fallen if !stops && self.modes.mode().source() == Source::Still => Request::None,
            Edge::Fallen if !stops => Request::Release,
            _ => request,
        };
        self.request_reason = reason;
        self.selected = edge == Edge::Selected;
        self.twice = self.selected && button == Button::C && self.confirm > 0;
    }

    /// One step, once in each basic cycle. Each step needs a [`Self::predict`] behind the one before: without
    /// it, the positions of this step are not used, and the vehicle stops when there are none for too long.
    pub fn step(&mut self, inputs: &Inputs, buttons: &Buttons) -> (Decision, Option<Change>) {
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
        self.velocity_missing = match inputs.velocity {
            Some(_) => 0,
            None => self.velocity_missing.saturating_add(1),
        };
        self.fixed = inputs.fixed && self.position_missing < Self::PATIENCE;
        self.unfixed = match self.fixed {
            true => 0,
            false => self.unfixed.saturating_add(1),
        };
        let lead = self.guide.step(&Known {
            mode: self.modes.mode(),
            fixed: self.fixed,
            tracking: self.tracking,
            dt: M::PERIOD,
        });
        let change = self.change_mode(inputs, buttons, lead);
        let mode = self.modes.mode();
        let applied = self.applied;
        let steering_angle = inputs
            .pot
            .and_then(|count| M::POTENTIOMETER.angle(count).ok());

        let sample = Sample {
            position: inputs.position,
            velocity: inputs.velocity,
            steering_angle,
            applied: self.applied,
            // While another one leads, the law has nothing to integrate.
            engaged: mode.source() == Source::Law && !by_other(lead),
            dt: M::PERIOD,
        };
        let outcome = self.controller.update(&sample);
        self.tracking = outcome.tracking;
        // A planner goes where it wants.
        self.finished = outcome.finished && lead != Lead::Planner;
        self.applied = match mode.source() {
            Source::Law => {
                let motion = Motion {
                    tracking: outcome.tracking,
                    applied: self.applied,
                    steering_angle,
                    effectiveness: self.controller.effectiveness(),
                    dt: M::PERIOD,
                };
                match self.guide.drive(&motion) {
                    Some(command) => {
                        // So the controller goes on from there when it takes over again.
                        self.controller.resume(command);
                        command
                    }
                    None => outcome.command,
                }
            }
            Source::Joystick => joystick_command::<M>(inputs.joystick),
            Source::Still => safety::Command::still(),
        };
        self.control_input = outcome.proposed.map_or(0.0, |own| own.steering_rate);
        self.response = (mode == Mode::AutonomousRun).then_some(Response {
            // A drive that is known to be slow moves the vehicle at this share of its command.
            applied: safety::Command {
                speed: applied.speed * self.controller.drive(),
                ..applied
            },
            cross_track: (!by_other(lead) && self.controller.has_path())
                .then_some(outcome.tracking.cross_track),
            ..Response::of(&sample, &outcome)
        });
        (self.decision(), change)
    }

    /// Predicts the vehicle's motion until the next step, and compares what was commanded with what the
    /// vehicle did. The next step need not do this between the measurements and its own command.
    pub fn predict(&mut self) {
        self.controller.predict(self.applied, M::PERIOD);
        self.departure = match &self.response {
            Some(response) => self.watch.step(response),
            None => {
                self.watch.reset();
                None
            }
        };
    }

    /// What the last step decided.
    pub fn decision(&self) -> Decision {
        let mode = self.modes.mode();
        Decision {
            mode,
            moving: mode.source() != Source::Still,
            command: self.applied,
            control_input: self.control_input,
            tracking: self.tracking,
            position: self.position,
            pot: self.pot,
        }
    }

    fn change_mode(&mut self, inputs: &Inputs, buttons: &Buttons, lead: Lead) -> Option<Change> {
        let previous = self.modes.mode();
        let blind = self.pot_missing >= POT_PATIENCE;
        let mut request = core::mem::take(&mut self.request);
        if self.finished && previous == Mode::AutonomousRun && request == Request::None {
            // At the end of the path the run ends as if button C were pressed again.
            request = Request::Autonomous;
            self.request_reason = Reason::PathEnd;
        }
        if self.takes_joystick(inputs) && request == Request::None {
            request = Request::Autonomous;
            self.request_reason = Reason::Joystick;
        }
        let departure = self.departure.filter(|_| previous == Mode::AutonomousRun);
        let sound = Conditions {
            // Rows only go on with a run: they do not lead before it.
            fixed_solution: (self.fixed && lead != Lead::Nobody)
                || by_other(lead)
                || (lead == Lead::Satellites && self.is_bridged(inputs)),
            stop_loop_open: buttons.is_pressed(Button::StopLoop),
            fault: false,
        };
        // A fault counts while the vehicle drives, and when it is about to. It stays until the
        // operator releases it.
        let twice = core::mem::take(&mut self.twice);
        let next = mode::next(previous, request, sound);
        let driving = |mode: Mode| mode.source() != Source::Still;
        // An operator may drive it back by the joystick.
        let by_itself = |mode: Mode| mode.source() == Source::Law;
        let begins = by_itself(next) || (twice && sound.fixed_solution);
        let strays = self.strays.filter(|_| begins || by_itself(previous));
        let conditions = Conditions {
            fault: strays.is_some()
                || (twice || driving(previous) || driving(next))
                    && (blind || !inputs.in_schedule || !inputs.may_move || departure.is_some()),
            ..sound
        };
        let mut mode = self.modes.step(request, conditions);
        if twice && mode == Mode::AutonomousReady {
            mode = self.modes.step(request, conditions);
        }
        self.confirm = match (previous, mode) {
            (Mode::AutonomousReady, Mode::Idle) if self.selected => CONFIRM_STEPS,
            (Mode::Idle, Mode::Idle) => self.confirm.saturating_sub(1),
            _ => 0,
        };
        if mode == previous {
            return None;
        }
        self.mode_reason = if conditions.stop_loop_open {
            Reason::StopLoop
        } else if conditions.fault && !inputs.in_schedule {
            Reason::BusFault
        } else if conditions.fault && !inputs.may_move {
            Reason::MasterLost
        } else if conditions.fault && blind {
            Reason::NodeFault
        } else if let Some(reason) = strays {
            reason
        } else if let (true, Some(departure)) = (conditions.fault, departure) {
            Reason::of(departure)
        } else if conditions.fault {
            Reason::NodeFault
        } else if request != Request::None {
            self.request_reason
        } else if lead == Lead::Nobody {
            M::Guide::LOST
        } else {
            Reason::FixLost
        };
        Some(Change {
            previous,
            mode,
            reason: self.mode_reason,
        })
    }

    /// Whether a run goes on by dead reckoning for a moment in which the receiver has no fixed solution. Its velocities
    /// must still come, and the place be known well. Positions that are lost on the bus are not bridged.
    fn is_bridged(&self, inputs: &Inputs) -> bool {
        self.modes.mode() == Mode::AutonomousRun
            && !inputs.fixed
            && self.unfixed <= Self::BRIDGED
            && self.velocity_missing < Self::PATIENCE
            && self.controller.is_placed()
    }

    /// Whether the operator has moved the joystick in an autonomous run, to end it.
    fn takes_joystick(&mut self, inputs: &Inputs) -> bool {
        let (x, y) = inputs.joystick;
        let moved = |axis: u16| convert::joystick(axis).abs() > JOYSTICK_MOVED;
        let counts = self.modes.mode() == Mode::AutonomousRun && (moved(x) || moved(y));
        self.joystick_moved = match counts {
            true => self.joystick_moved.saturating_add(1),
            false => 0,
        };
        self.joystick_moved >= JOYSTICK_STEPS
    }

    /// What guides a run besides the path.
    pub const fn guide(&self) -> &M::Guide {
        &self.guide
    }

    /// The same, for its messages.
    pub const fn guide_mut(&mut self) -> &mut M::Guide {
        &mut self.guide
    }

    /// Says why the vehicle must not drive by itself where it is, if so. From the next step on no run begins or goes on there.
    pub const fn set_strays(&mut self, strays: Option<Reason>) {
        self.strays = strays;
    }

    /// Whether the positions of the receiver are good.
    pub const fn is_fixed(&self) -> bool {
        self.fixed
    }

    /// The law that steers.
    pub const fn law(&self) -> &M::Law {
        &self.controller
    }

    /// The same, to change what it follows.
    pub const fn law_mut(&mut self) -> &mut M::Law {
        &mut self.controller
    }

    /// Steps so far; wraps.
    pub const fn steps(&self) -> u32 {
        self.steps
    }

    /// What the display shows at system time `time` (ms); `bus` says whether the node keeps the
    /// schedule, and `trouble` which other node does not.
    pub const fn view(&self, time: u32, bus: bool, trouble: Option<Named>) -> View {
        View {
            from: M::ROUTE[0],
            to: M::ROUTE[1],
            north: self.position.north,
            east: self.position.east,
            tracking: self.tracking,
            time,
            mode: self.modes.mode(),
            bus,
            fixed: self.fixed,
            trouble,
            reason: self.mode_reason,
        }
    }

    /// What the console says; `display` says whether the display answers, `trouble` which other node
    /// does not do its part on the bus.
    pub fn line(&self, display: bool, trouble: Option<Named>) -> PilotView {
        PilotView {
            mode: self.modes.mode(),
            reason: self.mode_reason,
            north: self.position.north,
            east: self.position.east,
            cross_track: convert::millimetres(self.tracking.cross_track),
            heading_error: convert::millidegrees(self.tracking.heading_error),
            fixed: self.fixed,
            display,
            trouble,
        }
    }

    /// Whether the node may start again: nobody commands the actuators, and no emergency stop or
    /// fault is latched that the start would forget.
    pub fn may_restart(&self) -> bool {
        matches!(self.modes.mode(), Mode::Idle | Mode::AutonomousReady)
    }

    /// The current mode.
    pub const fn mode(&self) -> Mode {
        self.modes.mode()
    }
}

/// Whether another one than the law leads.
fn by_other(lead: Lead) -> bool {
    matches!(lead, Lead::Rows | Lead::Planner)
}

/// Joystick to command: x steers and y drives, both proportionally.
fn joystick_command<M: Machine>((x, y): (u16, u16)) -> safety::Command<f32> {
    safety::Command {
        steering_rate: convert::joystick(x) * M::LIMITS.steering_rate,
        speed: convert::joystick(y) * M::LIMITS.speed,
    }
}

//! Operation modes (thesis 5.2.5, Figure 5.17): who commands the actuators.
//!
//! The function [`next`] is the table of all transitions. It checks the
//! vehicle's conditions (no fixed solution, an open stop loop, a fault) before
//! any button, so the vehicle leaves autonomous operation within one step.

/// The operation mode, which decides who commands the actuators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// Actuators are still. The mode after start-up.
    #[default]
    Idle,
    /// The joystick commands the actuators; no GPS fix is needed.
    Manual,
    /// An autonomous run is prepared; actuators are still.
    AutonomousReady,
    /// The control law commands the actuators.
    AutonomousRun,
    /// Actuators are still until the operator releases the stop.
    EmergencyStop,
    /// Actuators are still because a node reported a fault. A release leaves
    /// this mode once the fault is gone.
    Fault,
}

/// The operator's request in this step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Request {
    /// No request.
    #[default]
    None,
    /// Go to idle. This also releases an emergency stop or a fault.
    Release,
    /// Drive by joystick.
    Manual,
    /// From idle or manual, prepare an autonomous run. From ready, start the
    /// run. From a run, go back to ready.
    Autonomous,
    /// Stop now.
    EmergencyStop,
}

/// Conditions of the vehicle on which transitions depend.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Conditions {
    /// The receiver has an RTK-fixed solution and its position is recent, or dead reckoning
    /// bridges a moment without one.
    pub fixed_solution: bool,
    /// The hard-wired emergency stop loop is open, or a stop button is held.
    pub stop_loop_open: bool,
    /// A node reports a fault: old or implausible sensor data, missed messages,
    /// or an actuator that does not answer.
    pub fault: bool,
}

/// The mode that follows `mode` under `request` and `conditions`.
///
/// * An emergency stop takes effect from every mode in one step.
/// * Only [`Request::Release`] with the stop loop closed leaves it.
/// * [`Mode::AutonomousRun`] is neither entered nor kept without a fixed
///   solution.
#[must_use]
pub const fn next(mode: Mode, request: Request, conditions: Conditions) -> Mode {
    use Mode::{AutonomousReady, AutonomousRun, EmergencyStop, Fault, Idle, Manual};

    if conditions.stop_loop_open || matches!(request, Request::EmergencyStop) {
        return EmergencyStop;
    }
    if conditions.fault {
        return match mode {
            EmergencyStop => EmergencyStop,
            _ => Fault,
        };
    }
    let fixed = conditions.fixed_solution;
    match (mode, request) {
        // An emergency stop or a fault persists until it is released.
        (EmergencyStop | Fault, Request::Release) => Idle,
        (EmergencyStop, _) => EmergencyStop,
        (Fault, _) => Fault,

        (_, Request::Release) => Idle,
        (Idle | Manual | AutonomousReady | AutonomousRun, Request::Manual) => Manual,

        (Idle | Manual, Request::Autonomous) => AutonomousReady,
        (AutonomousReady, Request::Autonomous) if fixed => AutonomousRun,
        (AutonomousRun, Request::Autonomous) => AutonomousReady,

        // Without a fixed solution the run ends at once.
        (AutonomousRun, _) if !fixed => AutonomousReady,

        (unchanged, _) => unchanged,
    }
}

/// Who commands the actuators.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Source {
    /// Nobody: all commands are zero.
    Still,
    /// The joystick.
    Joystick,
    /// The control law.
    Law,
}

impl Mode {
    /// All modes, in the order of their codes.
    pub const ALL: [Self; 6] = [
        Self::Idle,
        Self::Manual,
        Self::AutonomousReady,
        Self::AutonomousRun,
        Self::EmergencyStop,
        Self::Fault,
    ];

    /// Who commands the actuators in this mode (the multiplexer of thesis
    /// Figure 5.16).
    #[must_use]
    pub const fn source(self) -> Source {
        match self {
            Self::Manual => Source::Joystick,
            Self::AutonomousRun => Source::Law,
            Self::Idle | Self::AutonomousReady | Self::EmergencyStop | Self::Fault => Source::Still,
        }
    }

    /// The code of this mode on the bus (message 300, D4).
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Idle => 0,
            Self::Manual => 1,
            Self::AutonomousReady => 2,
            Self::AutonomousRun => 3,
            Self::EmergencyStop => 4,
            Self::Fault => 5,
        }
    }

    /// The mode with this code, if there is one.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        Some(match code {
            0 => Self::Idle,
            1 => Self::Manual,
            2 => Self::AutonomousReady,
            3 => Self::AutonomousRun,
            4 => Self::EmergencyStop,
            5 => Self::Fault,
            _ => return None,
        })
    }

    /// A short name for displays and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Manual => "manual",
            Self::AutonomousReady => "ready",
            Self::AutonomousRun => "run",
            Self::EmergencyStop => "stop",
            Self::Fault => "fault",
        }
    }
}

/// The mode state machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ModeMachine {
    mode: Mode,
}

impl ModeMachine {
    /// A machine in [`Mode::Idle`].
    #[must_use]
    pub const fn new() -> Self {
        Self { mode: Mode::Idle }
    }

    /// The current mode.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Makes one transition by [`next`] and returns the new mode.
    pub const fn step(&mut self, request: Request, conditions: Conditions) -> Mode {
        self.mode = next(self.mode, request, conditions);
        self.mode
    }
}

//! Two boards on a bench: a knob drives a motor over the bus.
//!
//! The node `motor` sends the knob's position, and `master` turns it into a command. `motor`
//! obeys the command while its end-to-end protection holds and it has not expired.

#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

firmware::vehicle!();

use firmware::actuator::{self, Refusal, Supervised};
use firmware::housekeeping::{self, NodeFault, ResetCause, Status, StatusMessage};
use firmware::{convert, e2e};
use network::Message as _;
use ttcan::{ErrorLevel, Micros};

use crate::messages::{self as named, Command, MasterStatus, MotorStatus};

/// Time from the end of a command frame until the second frame after it is overdue.
pub const COMMAND_TIMEOUT: Micros = matrix::overdue::COMMAND;

/// The command for a position of the knob, in the basic cycle that began at system time `time`
/// (ms). The speed is proportional to the knob's distance from a dead zone in its middle, and
/// the LED shows that the motor turns.
pub fn command(knob: u16, sender: &mut e2e::Sender, time: u32) -> [u8; 8] {
    let motor = convert::motor_byte(convert::joystick(knob), true);
    let mut data = Command {
        motor,
        led: motor != STOP,
        counter: 0,
        check: 0,
    }
    .encode();
    sender.seal(Command::ID, time, &mut data);
    data
}

/// The motor driver's byte that stops the motor.
pub const STOP: u8 = 127;

impl actuator::Command for Command {
    /// The motor driver accepts every byte in the signal's range.
    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}

/// The command that the motor node obeys.
pub type Obeyed = Supervised<Command>;

/// Implements [`StatusMessage`] for the nodes' status messages, which share one layout.
macro_rules! status_messages {
    ($($message:ident),*) => {$(
        impl StatusMessage for $message {
            fn of(status: &Status) -> Self {
                Self {
                    reset_cause: reset_cause(status.reset_cause),
                    error_level: error_level(status.error_level),
                    bus_state: bus_state(status.bus),
                    fault: fault(status.fault),
                    transmit_errors: status.transmit_errors,
                    receive_errors: status.receive_errors,
                    missed_windows: status.missed_windows,
                    bus_offs: status.bus_offs,
                }
            }
        }
    )*};
}

status_messages!(MasterStatus, MotorStatus);

const fn reset_cause(cause: ResetCause) -> named::ResetCause {
    match cause {
        ResetCause::Power => named::ResetCause::Power,
        ResetCause::Pin => named::ResetCause::Pin,
        ResetCause::Software => named::ResetCause::Software,
        ResetCause::Watchdog => named::ResetCause::Watchdog,
        ResetCause::Other => named::ResetCause::Other,
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
        Some(NodeFault::StartRefused) => named::Fault::StartRefused,
        Some(NodeFault::ClockFailure) => named::Fault::ClockFailure,
        Some(NodeFault::WatchdogStarved) => named::Fault::WatchdogStarved,
    }
}

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

use crate::messages::{
    self as named, Command, MasterSelfTest, MasterStatus, MotorSelfTest, MotorStatus,
    SelfTestRequest,
};

/// Time from the end of a command frame until the second frame after it is overdue.
pub const COMMAND_TIMEOUT: Micros = matrix::overdue::COMMAND;

/// The command for a position of the knob, in the basic cycle that began at system time `time`
/// (ms). The speed is proportional to the knob's distance from a dead zone in its middle, and
/// the LED shows that the motor turns.
pub fn command(knob: u16, sender: &mut e2e::Sender, time: u32) -> [u8; 8] {
    let motor = motor(knob);
    let mut data = Command {
        motor,
        led: motor != STOP,
        counter: 0,
        check: 0,
    }
    .encode();
    sender.seal::<Command>(time, &mut data);
    data
}

/// The motor driver's byte for a position of the knob.
fn motor(knob: u16) -> u8 {
    convert::motor_byte(convert::joystick(knob), true)
}

/// Whether the motor stands still at this position of the knob.
pub fn is_stop(knob: u16) -> bool {
    motor(knob) == STOP
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

/// Time for which the motor's circuit stays closed after the last command that turned the motor.
///
/// The driver slows the motor down meanwhile. A relay that opened at once would have to break the
/// current of the turning motor, and would rattle when the knob trembles at the edge of its dead
/// zone.
pub const RELAY_HOLD: Micros = Micros::millis(500);

/// The motor's circuit, which the relay closes.
#[derive(Clone, Copy, Debug)]
pub struct Circuit {
    /// Time of the last command that turned the motor, in ticks; `None` while the circuit is open.
    turned_at: Option<u32>,
    /// [`RELAY_HOLD`] in ticks.
    hold: u32,
}

impl Circuit {
    /// An open circuit. `ticks_per_us` is the rate of the time base.
    pub const fn open(ticks_per_us: u32) -> Self {
        Self {
            turned_at: None,
            hold: RELAY_HOLD.ticks().saturating_mul(ticks_per_us),
        }
    }

    /// The motor driver's byte for the command in force at `now`. `None` opens the circuit, and
    /// from then on not even noise on the driver's line moves the motor: at once without a command, and
    /// [`RELAY_HOLD`] after the last command that turned the motor. Call it for every command, so
    /// that the time base does not wrap in between.
    pub fn byte(&mut self, command: Option<&Command>, now: u32) -> Option<u8> {
        let byte = command.map(|command| command.motor);
        self.turned_at = match byte {
            None => None,
            Some(STOP) => {
                let recent = |at: &u32| now.wrapping_sub(*at) < self.hold;
                self.turned_at.filter(recent)
            }
            Some(_) => Some(now),
        };
        self.turned_at.and(byte)
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
                    bus_offs: status.bus_offs,
                }
            }
        }
    )*};
}

firmware::self_test_messages!(MasterSelfTest, MotorSelfTest);

status_messages! {
    MasterStatus, MasterSelfTest;
    MotorStatus, MotorSelfTest;
}

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
        Some(NodeFault::SelfTest) => named::Fault::SelfTest,
        Some(NodeFault::SupplyLow) => named::Fault::SupplyLow,
    }
}

#[cfg(test)]
mod tests {
    use super::{Circuit, Command, RELAY_HOLD, STOP};

    const TICKS_PER_US: u32 = 4;
    /// From one command to the next.
    const CYCLE: u32 = 20_000 * TICKS_PER_US;
    const HOLD: u32 = RELAY_HOLD.ticks() * TICKS_PER_US;

    fn command(motor: u8) -> Command {
        Command {
            motor,
            led: motor != STOP,
            counter: 0,
            check: 0,
        }
    }

    /// `boards/GETTING_STARTED.md` says how long guesses take with so many.
    #[test]
    fn a_command_has_room_for_a_code_of_55_bits() {
        assert_eq!(firmware::e2e::mask::<Command>().count_ones(), 55);
    }

    #[test]
    fn the_circuit_is_closed_by_turning_and_opens_after_the_hold() {
        let (turn, stop) = (command(200), command(STOP));
        // The time base wraps meanwhile.
        for start in [0, u32::MAX - HOLD / 2] {
            let at = |cycle: u32| start.wrapping_add(cycle * CYCLE);
            let mut circuit = Circuit::open(TICKS_PER_US);
            assert_eq!(circuit.byte(Some(&stop), at(0)), None);
            assert_eq!(circuit.byte(Some(&turn), at(1)), Some(200));
            for cycle in 2..26 {
                assert_eq!(circuit.byte(Some(&stop), at(cycle)), Some(STOP));
            }
            assert_eq!(circuit.byte(Some(&stop), at(26)), None);
            assert_eq!(circuit.byte(Some(&stop), at(27)), None);
        }
    }

    #[test]
    fn a_command_that_turns_begins_the_hold_again() {
        let (turn, stop) = (command(128), command(STOP));
        let mut circuit = Circuit::open(TICKS_PER_US);
        for cycle in 0..500 {
            let command = if cycle % 20 == 0 { &turn } else { &stop };
            let byte = circuit.byte(Some(command), cycle * CYCLE);
            assert_eq!(byte, Some(command.motor));
        }
    }

    #[test]
    fn without_a_command_the_circuit_opens_at_once_and_a_stop_does_not_close_it() {
        let mut circuit = Circuit::open(TICKS_PER_US);
        assert_eq!(circuit.byte(Some(&command(0)), 0), Some(0));
        assert_eq!(circuit.byte(None, 1), None);
        assert_eq!(circuit.byte(Some(&command(STOP)), 2), None);
    }
}

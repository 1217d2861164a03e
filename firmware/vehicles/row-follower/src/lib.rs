//! A robot that follows the rows of a crop by two distance sensors (thesis chapter 2).
//!
//! The node `sensors` measures the distances to both rows 200 times a second, `feedback` makes
//! efforts of them, and `motors` turns these into servo pulses. `motors` obeys a command while its
//! end-to-end protection holds, its efforts are plausible and it has not expired.

#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

firmware::vehicle!();

/// The robot's numbers, from `vehicle.toml`.
#[allow(clippy::approx_constant, reason = "written by a program")]
pub mod design {
    include!(concat!(env!("OUT_DIR"), "/design.rs"));
}

use control::row::{RowRobot, Sides};
use firmware::actuator::{self, Refusal, Supervised};
use firmware::e2e;
use firmware::housekeeping::{self, NodeFault, ResetCause, Status, StatusMessage};
use firmware::rows::{FULL_EFFORT, State, Step};
use network::Message as _;
use ttcan::{ErrorLevel, Micros};

use crate::messages::{
    self as named, Command, FeedbackSelfTest, FeedbackStatus, MotorsSelfTest, MotorsStatus, RowLog,
    RowState, SelfTestRequest, SensorsSelfTest, SensorsStatus,
};

/// Cycle time at which a burst of samples begins: the reference is over, and the burst of 231 us at
/// most and its interrupt end before the first window.
pub const SAMPLE: Micros = Micros::micros(400);

/// Time between two control steps, s: the basic cycle.
pub const PERIOD: f32 = matrix::BASIC_CYCLE.ticks() as f32 * 1e-6;

/// Time from the end of a command frame until the second frame after it is overdue.
pub const COMMAND_TIMEOUT: Micros = matrix::overdue::COMMAND;

/// Time between two servo pulses while no command comes. It is longer than a command lasts, so that each
/// command begins pulses of its own, and so do the neutral ones when none is in force any more.
pub const PULSE_PERIOD_US: u16 = COMMAND_TIMEOUT.ticks() as u16 + 1_000;

/// The command of a control step, in the basic cycle that began at system time `time` (ms).
pub fn command(step: &Step, sender: &mut e2e::Sender, time: u32) -> [u8; 8] {
    let mut data = Command {
        left: step.efforts.left,
        enabled: step.state == State::Following,
        state: state(step.state),
        right: step.efforts.right,
        offset: step.offset,
        heading: step.heading,
        counter: 0,
        check: 0,
    }
    .encode();
    sender.seal::<Command>(time, &mut data);
    data
}

/// The copy of a control step for loggers.
pub fn row_log(distances: &Sides<Option<u8>>, step: &Step) -> [u8; 8] {
    const NONE: u8 = 255;
    RowLog {
        distance_left: distances.left.unwrap_or(NONE),
        distance_right: distances.right.unwrap_or(NONE),
        left: step.efforts.left,
        enabled: step.state == State::Following,
        state: state(step.state),
        right: step.efforts.right,
        offset: step.offset,
        heading: step.heading,
    }
    .encode()
}

const fn state(state: State) -> RowState {
    match state {
        State::Idle => RowState::Idle,
        State::Following => RowState::Following,
        State::End => RowState::End,
        State::Lost => RowState::Lost,
    }
}

/// The effort for this speed, in 1/500.
const fn effort(robot: &RowRobot, speed: f64) -> i16 {
    let motor = &robot.motors.left.positive;
    let effort = motor.dead_band + (1.0 - motor.dead_band) * speed / motor.full_rate;
    (effort * FULL_EFFORT as f64) as i16
}

/// Largest mean effort of both sides. The law never asks for more than the cruise speed; a tenth more
/// is allowed for rounding.
const LARGEST_MEAN: i16 = effort(&design::ROBOT, design::ROBOT.cruise * 1.1);

/// Largest difference of the sides' efforts, in 1/500. Either side may be rounded by half of one.
const LARGEST_DIFFERENCE: i16 = (design::LARGEST_DIFFERENCE * FULL_EFFORT as f64) as i16 + 2;

impl actuator::Command for Command {
    const NONSENSE_ENDS: bool = true;

    /// Refuses a pair of efforts that no law makes: with the motors not enabled or the robot not
    /// following its rows, only standing still makes sense. Together the sides never drive backwards, nor
    /// faster than the cruise speed, and they turn the robot no faster than the law does.
    fn check(&self) -> Result<(), Refusal> {
        let mean = (self.left + self.right) / 2;
        let still = self.left == 0 && self.right == 0;
        if self.enabled != (self.state == RowState::Following) || !self.enabled && !still {
            return Err(Refusal::Mode);
        }
        let difference = (self.left - self.right).abs();
        if !(-LARGEST_MEAN / 10..=LARGEST_MEAN).contains(&mean) || difference > LARGEST_DIFFERENCE {
            return Err(Refusal::Limits);
        }
        Ok(())
    }
}

/// The command that the motors' node obeys.
pub type Obeyed = Supervised<Command>;

/// The efforts of a command in force; standing still without one.
pub fn efforts(command: Option<&Command>) -> Sides<i16> {
    command
        .filter(|command| command.enabled)
        .map_or(Sides { left: 0, right: 0 }, |command| Sides {
            left: command.left,
            right: command.right,
        })
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

firmware::self_test_messages!(SensorsSelfTest, FeedbackSelfTest, MotorsSelfTest);

status_messages! {
    SensorsStatus, SensorsSelfTest;
    FeedbackStatus, FeedbackSelfTest;
    MotorsStatus, MotorsSelfTest;
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
    use super::*;
    use firmware::actuator::{Command as _, Times};
    use firmware::e2e::Secret;
    use firmware::rows::{Follower, LARGEST_DISTANCE};
    use proptest::prelude::*;

    fn following(left: i16, right: i16) -> Command {
        Command {
            left,
            enabled: true,
            state: RowState::Following,
            right,
            offset: 0,
            heading: 0,
            counter: 0,
            check: 0,
        }
    }

    /// `boards/GETTING_STARTED.md` says how long guesses take with so many.
    #[test]
    fn a_command_has_room_for_a_code_of_25_bits() {
        assert_eq!(e2e::mask::<Command>().count_ones(), 25);
    }

    #[test]
    fn pairs_that_no_law_makes_are_refused() {
        assert_eq!(following(120, 110).check(), Ok(()));
        assert_eq!(following(-50, 170).check(), Ok(()));
        assert_eq!(following(-120, -110).check(), Err(Refusal::Limits));
        assert_eq!(following(400, 300).check(), Err(Refusal::Limits));
        let standing = |left, enabled, state| Command {
            enabled,
            state,
            ..following(left, 0)
        };
        assert_eq!(standing(0, false, RowState::Lost).check(), Ok(()));
        assert_eq!(standing(0, true, RowState::End).check(), Err(Refusal::Mode));
        assert_eq!(
            standing(1, false, RowState::Idle).check(),
            Err(Refusal::Mode)
        );
        let idle = standing(0, false, RowState::Following);
        assert_eq!(idle.check(), Err(Refusal::Mode));
        // As fast as the motors can in opposite directions: the mean is that of standing still.
        assert_eq!(following(500, -500).check(), Err(Refusal::Limits));
        assert_eq!(following(-500, 500).check(), Err(Refusal::Limits));
    }

    /// The next command of `sender`, 5 ms after the last one.
    fn sealed(command: &Command, sender: &mut e2e::Sender) -> [u8; 8] {
        let mut data = command.encode();
        sender.seal::<Command>(0, &mut data);
        data
    }

    #[test]
    fn an_implausible_pair_ends_the_command_before_it() {
        for nonsense in [
            following(500, -500),
            following(400, 300),
            Command {
                enabled: false,
                ..following(100, 90)
            },
        ] {
            let mut obeyed = Obeyed::new(Times::new(COMMAND_TIMEOUT, 18), Secret::None);
            let sender = &mut e2e::Sender::default();
            let receive = |obeyed: &mut Obeyed, command: &Command, sender: &mut e2e::Sender| {
                obeyed.receive(&sealed(command, sender), 0, 0).is_ok()
            };
            let sane = following(100, 90);
            assert!(!receive(&mut obeyed, &sane, sender));
            assert!(receive(&mut obeyed, &sane, sender));
            assert!(obeyed.command().is_some());
            // Also if every second command makes sense.
            for _ in 0..5 {
                assert!(!receive(&mut obeyed, &nonsense, sender));
                assert_eq!(obeyed.command(), None);
                assert!(!receive(&mut obeyed, &sane, sender));
                assert_eq!(obeyed.command(), None);
            }
            assert!(receive(&mut obeyed, &sane, sender));
            // A frame that is altered on its way says nothing of its sender.
            let mut altered = sealed(&sane, sender);
            altered[0] ^= 1;
            assert!(obeyed.receive(&altered, 0, 0).is_err());
            assert!(obeyed.command().is_some());
        }
    }

    #[test]
    fn without_a_command_the_efforts_are_zero() {
        assert_eq!(efforts(None), Sides { left: 0, right: 0 });
        let command = following(100, 90);
        let expected = Sides {
            left: 100,
            right: 90,
        };
        assert_eq!(efforts(Some(&command)), expected);
        let disabled = Command {
            enabled: false,
            ..command
        };
        assert_eq!(efforts(Some(&disabled)), Sides { left: 0, right: 0 });
    }

    proptest! {
        /// Whatever distances come, the motors obey what the law makes of them.
        #[test]
        fn the_law_makes_plausible_pairs(
            steps in proptest::collection::vec((any::<u8>(), any::<u8>(), 1..40_u8), 1..60),
        ) {
            let mut follower = Follower::<design::Law>::new(&design::LAW);
            let _ = follower.command(&Sides { left: None, right: None }, false, PERIOD);
            for (left, right, times) in steps {
                let within = |cm: u8| (20..=LARGEST_DISTANCE).contains(&cm).then_some(cm);
                let distances = Sides { left: within(left), right: within(right) };
                for _ in 0..times {
                    let step = follower.command(&distances, true, PERIOD);
                    follower.correct();
                    let data = command(&step, &mut e2e::Sender::default(), 0);
                    let command = Command::decode(&data).unwrap();
                    prop_assert_eq!(command.check(), Ok(()), "{:?}", command);
                }
            }
        }

        #[test]
        fn a_step_comes_back_from_its_messages(
            left in -500_i16..=500, right in -500_i16..=500, offset in -127_i8..=127,
            heading in -127_i8..=127, code in 0..4_u8, time: u32,
            distances in (proptest::option::of(20..=150_u8), proptest::option::of(20..=150_u8)),
        ) {
            let states = [State::Idle, State::Following, State::End, State::Lost];
            let step = Step {
                efforts: Sides { left, right },
                state: states[usize::from(code)],
                offset,
                heading,
            };
            let data = command(&step, &mut e2e::Sender::default(), time);
            let decoded = Command::decode(&data).unwrap();
            prop_assert_eq!((decoded.left, decoded.right), (left, right));
            prop_assert_eq!((decoded.offset, decoded.heading), (offset, heading));
            prop_assert_eq!(decoded.enabled, step.state == State::Following);
            prop_assert_eq!(decoded.state as u8, code);
            let pair = Sides { left: distances.0, right: distances.1 };
            let log = RowLog::decode(&row_log(&pair, &step)).unwrap();
            prop_assert_eq!((log.left, log.right), (left, right));
            prop_assert_eq!(log.distance_left, distances.0.unwrap_or(255));
            prop_assert_eq!(log.distance_right, distances.1.unwrap_or(255));
        }
    }
}

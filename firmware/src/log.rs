//! Lines of the log that a debug probe shows.
//!
//! In each pass the console's task hands the state of its node to [`Changes`]. A pass writes at
//! most one line: about the first fact that differs from what was last logged. So the time of a
//! pass is bounded, and tasks of higher priority do nothing for the log. The price: a state
//! that comes and goes between two passes is not logged, although a counter may show it.

use control::mode::Mode;
use sled_common::clock::{Oscillator, ResetCause};
use ttcan::{ErrorLevel, MasterState, SyncState};

use crate::actuator::Refusal;
use crate::console::{ActuatorView, BusView, PilotView};
use crate::e2e::{Proof, Secret};
use crate::housekeeping::{BusState, NodeFault, Start};
use crate::navigation::Navigation;
use crate::peers::Trouble;
use crate::pilot::Reason;
use crate::sbp::Fix;
use crate::selftest::{Check, Report};

/// A line of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Entry {
    /// The node started.
    Start(ResetCause),
    /// The clocks that it runs on.
    Clocks {
        /// Where the clock comes from.
        oscillator: Oscillator,
        /// Core clock, kHz.
        core_khz: u32,
    },
    /// The key of the network.
    Key(KeyState),
    /// What went wrong before the start or at it.
    Fault(NodeFault),
    /// The operation mode.
    Mode(Mode, Reason),
    /// Quality of the satellite receiver's position.
    Fix(Fix),
    /// Whether a command is in force.
    Command(bool),
    /// The CAN controller.
    Bus(Bus),
    /// The node's part in the schedule of the bus.
    Schedule(Schedule),
    /// The time of the bus.
    Time(Time),
    /// A command was refused.
    Refused(Refused),
    /// Another node that does not do its part on the bus, or none.
    Trouble(Option<Trouble>),
    /// The self-test: the first check that fails, or `None`.
    SelfTest(Option<Check>),
    /// A check of the self-test that was not done, once for each.
    NotDone(Check),
}

/// The [number](crate::e2e::Key::number) of a key. It is logged in the eight hexadecimal digits that `cargo xtask
/// keys show` prints, so that the two can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyNumber(pub u32);

#[cfg(feature = "target")]
impl defmt::Format for KeyNumber {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{=u32:08X}", self.0);
    }
}

/// What a node knows of the key of its network. A key itself is never logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum KeyState {
    /// It has none: whoever reaches the bus can command the vehicle.
    None,
    /// It has the key of this number.
    Known(KeyNumber),
    /// Its key is damaged, and it obeys no command.
    Damaged,
}

impl From<&Secret> for KeyState {
    fn from(secret: &Secret) -> Self {
        match secret {
            Secret::None => Self::None,
            Secret::Key(key) => Self::Known(KeyNumber(key.number())),
            Secret::Damaged => Self::Damaged,
        }
    }
}

/// State of the CAN controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub struct Bus {
    /// Error state.
    pub state: BusState,
    /// Bus-off states so far; wraps.
    pub bus_offs: u16,
}

/// The node's part in the schedule of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub struct Schedule {
    /// Synchronisation state.
    pub sync: SyncState,
    /// Master state of the node itself.
    pub master: MasterState,
    /// Rank of the time master.
    pub leader: Option<u8>,
    /// Error level.
    pub level: ErrorLevel,
}

/// How far the time of the bus can be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub struct Time {
    /// Whether it is proven.
    pub proof: Proof,
    /// References with a wrong tag so far; wraps.
    pub forged: u16,
}

/// Commands that were refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub struct Refused {
    /// How many so far; wraps.
    pub count: u16,
    /// Why the last one was refused.
    pub why: Refusal,
}

/// The facts of a node beyond its bus that the log reports. A fact that a node does not have is
/// `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Own {
    /// Operation mode, and why it was entered.
    pub mode: Option<(Mode, Reason)>,
    /// Quality of the satellite receiver's position.
    pub fix: Option<Fix>,
    /// Whether a command is in force.
    pub command: Option<bool>,
    /// Commands that were refused.
    pub refused: Option<Refused>,
    /// Another node that does not do its part on the bus.
    pub trouble: Option<Option<Trouble>>,
}

impl From<&PilotView> for Own {
    fn from(view: &PilotView) -> Self {
        Self {
            mode: Some((view.mode, view.reason)),
            trouble: Some(view.trouble.map(|named| named.trouble)),
            ..Self::default()
        }
    }
}

impl From<&Navigation> for Own {
    fn from(navigation: &Navigation) -> Self {
        Self {
            fix: Some(navigation.fix()),
            ..Self::default()
        }
    }
}

impl From<&ActuatorView> for Own {
    fn from(view: &ActuatorView) -> Self {
        let count = view.refused;
        Self {
            command: Some(view.command.is_some()),
            refused: view.refusal.map(|why| Refused { count, why }),
            ..Self::default()
        }
    }
}

/// What was last logged.
#[derive(Clone, Copy, Debug)]
pub struct Changes {
    start: Option<ResetCause>,
    clocks: Option<(Oscillator, u32)>,
    key: Option<KeyState>,
    fault: Option<NodeFault>,
    own: Own,
    bus: Option<Bus>,
    schedule: Option<Schedule>,
    time: Option<Time>,
    test: Option<Option<Check>>,
    /// The checks that have been logged as not done, one bit for each number.
    not_done: u16,
}

impl Changes {
    /// A log in which nothing has been written yet.
    pub fn new(start: &Start) -> Self {
        Self {
            start: Some(start.cause),
            key: Some(KeyState::from(&start.secret)),
            clocks: Some((start.clocks.oscillator, start.clocks.core / 1000)),
            fault: start.fault(),
            own: Own {
                mode: None,
                fix: None,
                command: None,
                refused: None,
                trouble: None,
            },
            bus: None,
            schedule: None,
            time: None,
            test: None,
            not_done: 0,
        }
    }

    /// The line for this pass. Start, clocks and fault come first, once each. The facts that
    /// change most often come last, so that they cannot keep the others out for ever.
    pub fn next(&mut self, bus: &BusView, own: &Own, test: Option<&Report>) -> Option<Entry> {
        let said = &mut self.own;
        let controller = Bus {
            state: BusState::of(&bus.errors),
            bus_offs: bus.link.bus_off,
        };
        let schedule = Schedule {
            sync: bus.status.sync,
            master: bus.status.master,
            leader: bus.status.master_rank,
            level: bus.status.error_level,
        };
        // Where nothing asks for a proof, there is nothing to say.
        let time = (bus.time != Proof::Unasked).then_some(Time {
            proof: bus.time,
            forged: bus.forged,
        });
        None.or_else(|| self.start.take().map(Entry::Start))
            .or_else(|| {
                let (oscillator, core_khz) = self.clocks.take()?;
                Some(Entry::Clocks {
                    oscillator,
                    core_khz,
                })
            })
            .or_else(|| self.key.take().map(Entry::Key))
            .or_else(|| self.fault.take().map(Entry::Fault))
            .or_else(|| {
                let failed = test.map(|report| report.failed().next());
                news(&mut self.test, failed).map(Entry::SelfTest)
            })
            .or_else(|| {
                let told = self.not_done;
                let is_new = |check: &Check| told >> *check as u16 & 1 == 0;
                let check = test?.not_done().find(is_new)?;
                self.not_done |= 1 << check as u16;
                Some(Entry::NotDone(check))
            })
            .or_else(|| news(&mut said.mode, own.mode).map(|(mode, why)| Entry::Mode(mode, why)))
            .or_else(|| news(&mut said.fix, own.fix).map(Entry::Fix))
            .or_else(|| news(&mut said.command, own.command).map(Entry::Command))
            .or_else(|| news(&mut self.bus, Some(controller)).map(Entry::Bus))
            .or_else(|| news(&mut self.schedule, Some(schedule)).map(Entry::Schedule))
            .or_else(|| news(&mut self.time, time).map(Entry::Time))
            .or_else(|| news(&mut said.trouble, own.trouble).map(Entry::Trouble))
            .or_else(|| news(&mut said.refused, own.refused).map(Entry::Refused))
    }
}

/// Returns a fact if it differs from the one last logged, `said`, and notes it there.
fn news<T: Copy + PartialEq>(said: &mut Option<T>, now: Option<T>) -> Option<T> {
    // First of all: for a node that never has the fact, the compiler then leaves out the line.
    let now = now?;
    let is_new = *said != Some(now);
    *said = Some(now);
    is_new.then_some(now)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::e2e;
    use sled_common::clock::Clocks;
    use sled_common::fault::Fault;
    use std::vec::Vec;

    const CLOCKS: Clocks = Clocks::of(parts::Sled::F446, Oscillator::External);

    const fn start(cause: ResetCause, record: Option<Fault>) -> Start {
        Start {
            cause,
            record,
            clocks: CLOCKS,
            secret: Secret::None,
        }
    }

    fn running() -> BusView {
        BusView::quiet(SyncState::InSchedule, Some(0))
    }

    /// The lines that a log writes when each of these states lasts for some passes.
    fn lines(changes: &mut Changes, states: &[(BusView, Own)]) -> Vec<Entry> {
        let passes = states.iter().flat_map(|state| [state; 12]);
        passes
            .filter_map(|(bus, own)| changes.next(bus, own, None))
            .collect()
    }

    /// A log that has already written the lines of start-up and of normal operation.
    fn after_the_start(own: Own) -> Changes {
        let mut changes = Changes::new(&start(ResetCause::Power, None));
        lines(&mut changes, &[(running(), own)]);
        changes
    }

    const fn schedule(sync: SyncState, leader: Option<u8>) -> Entry {
        Entry::Schedule(Schedule {
            sync,
            master: MasterState::Follower,
            leader,
            level: ErrorLevel::None,
        })
    }

    #[test]
    fn a_start_is_told_line_by_line_and_once() {
        let mut changes = Changes::new(&start(ResetCause::Software, Some(Fault::Panic)));
        let waiting = BusView::quiet(SyncState::Synchronising, None);
        let told = lines(
            &mut changes,
            &[(waiting, Own::default()), (running(), Own::default())],
        );
        let quiet = Entry::Bus(Bus {
            state: BusState::ErrorActive,
            bus_offs: 0,
        });
        assert_eq!(
            told,
            [
                Entry::Start(ResetCause::Software),
                Entry::Clocks {
                    oscillator: Oscillator::External,
                    core_khz: CLOCKS.core / 1000,
                },
                Entry::Key(KeyState::None),
                Entry::Fault(NodeFault::Panic),
                quiet,
                schedule(SyncState::Synchronising, None),
                schedule(SyncState::InSchedule, Some(0)),
            ]
        );
        assert_eq!(lines(&mut changes, &[(running(), Own::default())]), []);
    }

    #[test]
    fn modes_fixes_and_time_masters_are_told_when_they_change() {
        let own = |mode, why, fix| Own {
            mode: Some((mode, why)),
            fix: Some(fix),
            ..Own::default()
        };
        let ready = own(Mode::AutonomousReady, Reason::ButtonC, Fix::Fixed);
        let run = own(Mode::AutonomousRun, Reason::ButtonC, Fix::Fixed);
        let lost = own(Mode::AutonomousReady, Reason::FixLost, Fix::Float);
        let mut changes = after_the_start(ready);
        let backup = BusView::quiet(SyncState::InSchedule, Some(1));
        assert_eq!(
            lines(
                &mut changes,
                &[(running(), run), (running(), lost), (backup, lost)]
            ),
            [
                Entry::Mode(Mode::AutonomousRun, Reason::ButtonC),
                Entry::Mode(Mode::AutonomousReady, Reason::FixLost),
                Entry::Fix(Fix::Float),
                schedule(SyncState::InSchedule, Some(1)),
            ]
        );
    }

    #[test]
    fn a_bus_off_between_two_passes_leaves_a_line() {
        let mut changes = after_the_start(Own::default());
        let mut passive = running();
        passive.errors.passive = true;
        let mut back = running();
        back.link.bus_off = 1;
        let told = lines(
            &mut changes,
            &[(passive, Own::default()), (back, Own::default())],
        );
        let line = |state, bus_offs| Entry::Bus(Bus { state, bus_offs });
        assert_eq!(
            told,
            [
                line(BusState::ErrorPassive, 0),
                line(BusState::ErrorActive, 1)
            ]
        );
    }

    #[test]
    fn commands_that_are_refused_all_the_time_hold_back_nothing() {
        let own = |count| Own {
            command: Some(false),
            refused: Some(Refused {
                count,
                why: Refusal::Protection(e2e::Refusal::Altered),
            }),
            ..Own::default()
        };
        let mut changes = after_the_start(own(0));
        let told = [1, 2, 3].map(|count| changes.next(&running(), &own(count), None));
        let refused = told.iter().flatten();
        assert!(
            refused
                .clone()
                .all(|entry| matches!(entry, Entry::Refused(_)))
        );
        assert_eq!(refused.count(), 3);
        let backup = BusView::quiet(SyncState::InSchedule, Some(1));
        assert_eq!(
            changes.next(&backup, &own(4), None),
            Some(schedule(SyncState::InSchedule, Some(1)))
        );
    }

    #[test]
    fn what_a_node_shows_on_its_console_is_what_its_log_tells() {
        let view = ActuatorView {
            command: Some(5),
            refused: 2,
            refusal: Some(Refusal::Limits),
            ..ActuatorView::default()
        };
        let told = Own {
            command: Some(true),
            refused: Some(Refused {
                count: 2,
                why: Refusal::Limits,
            }),
            ..Own::default()
        };
        assert_eq!(Own::from(&view), told);
        let silent = Own {
            fix: Some(Fix::None),
            ..Own::default()
        };
        assert_eq!(Own::from(&Navigation::new()), silent);
    }
}

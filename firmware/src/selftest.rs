//! The self-test of a node: judges what its board found out at the start, and how it fares on the
//! bus.
//!
//! The node reports once after a start, and whenever a program on the bus asks for it. The result
//! is also a line on the console, a line of the log and a code of the LED. A node that fails a
//! check on which safety rests ([`Report::is_fit`]) turns no motor.

use network::Message;
use sled_common::clock::Oscillator;
use sled_common::fault::Fault;
use sled_common::selftest::{Findings, is_plausible};
use ttcan::{ErrorLevel, SyncState};

use crate::console::{BusView, Line};
use crate::housekeeping::{NodeFault, Start};

/// Factory readings of the internal reference, mV. Its voltage is about 1.2 V (data sheets, table of
/// the embedded reference); a page that was never written is far from it.
const REFERENCE: core::ops::RangeInclusive<u32> = 1150..=1280;

/// Supply of the part, mV: 3.3 V of the Nucleo's regulator, 3.0 V as the transceiver needs.
const SUPPLY: core::ops::RangeInclusive<u16> = 3000..=3600;

/// A check of the self-test. The number is that of the LED's code, in flashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Check {
    /// The node started regularly.
    Reset = 1,
    /// The memory holds what is written to it.
    Memory = 2,
    /// The flash holds the image that was built; not done if the build did not seal the image.
    Program = 3,
    /// There is an external clock, and it agrees with the RC oscillator; not done if the node runs on
    /// it but could not measure it.
    Oscillators = 4,
    /// The CAN controller receives its own frame; not done if its receive pin was dominant.
    LoopBack = 5,
    /// The node takes part in the traffic without errors; not done outside the schedule.
    Bus = 6,
    /// The converter reads its reference.
    Reference = 7,
    /// The supply is right.
    Supply = 8,
    /// The relay in the motor's lead opens; not done without a motor, or while it may turn.
    Relay = 9,
    /// At least an eighth of the stack was never used.
    Stack = 10,
}

impl Check {
    /// All checks, in the order of their numbers.
    pub const ALL: [Self; 10] = [
        Self::Reset,
        Self::Memory,
        Self::Program,
        Self::Oscillators,
        Self::LoopBack,
        Self::Bus,
        Self::Reference,
        Self::Supply,
        Self::Relay,
        Self::Stack,
    ];

    /// Its name on the console.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reset => "reset",
            Self::Memory => "memory",
            Self::Program => "program",
            Self::Oscillators => "clocks",
            Self::LoopBack => "loop",
            Self::Bus => "bus",
            Self::Reference => "ref",
            Self::Supply => "supply",
            Self::Relay => "relay",
            Self::Stack => "stack",
        }
    }
}

/// Outcome of a check.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    /// The node has nothing to check, or could not.
    #[default]
    NotDone,
    /// As it should be.
    Passed,
    /// Not as it should be.
    Failed,
}

impl Outcome {
    const fn of(passed: Option<bool>) -> Self {
        match passed {
            None => Self::NotDone,
            Some(true) => Self::Passed,
            Some(false) => Self::Failed,
        }
    }
}

/// The key of a request: the text TEST, so that no frame asks by chance.
pub const KEY: u32 = u32::from_le_bytes(*b"TEST");

/// A request of a program on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Its number, which the report repeats.
    pub round: u8,
    /// Whether the node is to start again, so that all checks are done once more.
    pub start_again: bool,
}

/// What a node knows of its motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motor {
    /// No motor turns by this node's hand, and none is about to.
    pub still: bool,
    /// Whether the relay in the motor's lead is open as it should be; `None` without a motor, or
    /// while the relay is closed.
    pub opens: Option<bool>,
}

impl Motor {
    /// A node without a motor; `still` tells whether it may start again without harm.
    pub const fn none(still: bool) -> Self {
        Self { still, opens: None }
    }
}

/// The report of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Round of the request; 0 after a start.
    pub round: u8,
    /// Outcome of each check, in the order of [`Check::ALL`].
    pub outcomes: [Outcome; Check::ALL.len()],
    /// Error of the external clock, in tenths of a per cent.
    pub clock_error: i8,
    /// Supply, mV.
    pub supply: u16,
    /// Bytes of the stack that were never used.
    pub stack_free: u16,
}

/// The report message of a node, as its network defines it.
pub trait ReportMessage: Message {
    /// The message for a report.
    fn of(report: &Report) -> Self;
}

/// The message of a network by which a program on the bus asks for a self-test.
pub trait RequestMessage: Message {
    /// What it asks for; `None` if its key is wrong.
    fn request(&self) -> Option<Request>;
}

impl Report {
    /// Judges the board's findings, the start, the bus and the motor. `stack_free` are the bytes of
    /// the stack that were never used, `stack_reserve` those that must not be.
    pub fn new(
        start: &Start,
        findings: &Findings,
        bus: &BusView,
        motor: Motor,
        stack_free: u16,
        stack_reserve: u16,
    ) -> Self {
        let clock = findings.clock_error;
        let external = start.clocks.oscillator == Oscillator::External;
        let oscillators = match clock {
            Some(error) => Some(is_plausible(error)),
            None => (!external).then_some(false),
        };
        let passed = |check: Check| match check {
            // An external clock that fails its own check fails no second one; a PLL that did not
            // lock does.
            Check::Reset => Some(match start.fault() {
                None => true,
                Some(NodeFault::ClockFailure) => {
                    oscillators == Some(false) && start.record != Some(Fault::ClockStart)
                }
                Some(_) => false,
            }),
            Check::Memory => Some(findings.memory_defect.is_none()),
            Check::Program => findings.program,
            Check::Oscillators => oscillators,
            Check::LoopBack => findings.loop_back,
            Check::Bus => (bus.status.sync == SyncState::InSchedule).then(|| is_well(bus)),
            Check::Reference => Some(findings.reference.is_some_and(|read| {
                // The factory's reading was taken at 3.3 V.
                REFERENCE.contains(&(u32::from(read.factory) * 3300 / 4095)) && read.count > 0
            })),
            Check::Supply => Some(
                findings
                    .reference
                    .is_some_and(|read| SUPPLY.contains(&read.supply())),
            ),
            Check::Relay => motor.opens,
            Check::Stack => Some(stack_free >= stack_reserve),
        };
        let range = |error: i16| error.clamp(i16::from(i8::MIN), i16::from(i8::MAX)) as i8;
        Self {
            round: 0,
            outcomes: Check::ALL.map(|check| Outcome::of(passed(check))),
            clock_error: clock.map_or(0, range),
            supply: findings.reference.map_or(0, |read| read.supply()),
            stack_free,
        }
    }

    /// Outcome of a check.
    pub fn outcome(&self, check: Check) -> Outcome {
        let mut pairs = Check::ALL.into_iter().zip(self.outcomes);
        pairs
            .find(|(other, _)| *other == check)
            .map_or(Outcome::NotDone, |(_, outcome)| outcome)
    }

    /// The failed checks.
    pub fn failed(&self) -> impl Iterator<Item = Check> + use<> {
        self.with(Outcome::Failed)
    }

    /// The checks that were not done.
    pub fn not_done(&self) -> impl Iterator<Item = Check> + use<> {
        self.with(Outcome::NotDone)
    }

    fn with(&self, wanted: Outcome) -> impl Iterator<Item = Check> + use<> {
        let pairs = Check::ALL.into_iter().zip(self.outcomes);
        pairs
            .filter(move |(_, outcome)| *outcome == wanted)
            .map(|(check, _)| check)
    }

    /// Whether the node may turn a motor: memory, program, CAN controller, converter, supply, relay
    /// and stack are sound. The other checks have remedies of their own: a node without its external clock trims
    /// the RC oscillator, a node that is not well on the bus obeys no commands.
    pub fn is_fit(&self) -> bool {
        self.unfit().is_none()
    }

    /// The first failed check of those on which [`Report::is_fit`] rests.
    pub fn unfit(&self) -> Option<Check> {
        self.failed().find(|check| {
            matches!(
                check,
                Check::Memory
                    | Check::Program
                    | Check::LoopBack
                    | Check::Reference
                    | Check::Supply
                    | Check::Relay
                    | Check::Stack
            )
        })
    }
}

/// Whether the node may send in the schedule and is below the error warning limit of its controller.
fn is_well(bus: &BusView) -> bool {
    matches!(
        bus.status.error_level,
        ErrorLevel::None | ErrorLevel::Warning
    ) && !(bus.errors.warning || bus.errors.passive || bus.errors.bus_off)
}

/// When the line about the self-test goes to the console: when the failed checks change, when a
/// check is done for the first time, after a request, and again and again while a check fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct Repeat {
    /// The round, and whether each check had failed.
    said: Option<(u8, [bool; Check::ALL.len()])>,
    /// Whether each check has ever been done.
    done: [bool; Check::ALL.len()],
    passes: u8,
}

/// Passes of the console between two lines about the same failure: 5 s.
const REPEAT: u8 = 50;

impl Repeat {
    /// Nothing has been said yet.
    pub const fn new() -> Self {
        Self {
            said: None,
            done: [false; Check::ALL.len()],
            passes: 0,
        }
    }

    /// Whether the line is due in this pass of the console.
    pub fn is_due(&mut self, report: &Report) -> bool {
        self.passes = self.passes.saturating_add(1);
        let failed = report.outcomes.map(|outcome| outcome == Outcome::Failed);
        let now = Some((report.round, failed));
        let again = self.passes >= REPEAT && report.failed().next().is_some();
        let before = self.done;
        // loop-bound: 10 checks
        for (done, outcome) in self.done.iter_mut().zip(report.outcomes) {
            *done |= outcome != Outcome::NotDone;
        }
        let due = self.said != now || self.done != before || again;
        if due {
            self.said = now;
            self.passes = 0;
        }
        due
    }
}

/// The line on the console.
pub fn show(line: &mut Line, report: &Report) {
    line.str("test");
    if !list(line, " FAILED ", report, Outcome::Failed) {
        line.str(" passed");
    }
    list(line, ", not done ", report, Outcome::NotDone);
    line.str(" | clock ")
        .fixed(i32::from(report.clock_error), 1);
    line.str(" % supply ").fixed(i32::from(report.supply), 3);
    line.str(" V stack ").unsigned(u32::from(report.stack_free));
    line.str("\r\n");
}

/// Names the checks with an outcome, behind `title`. False if there are none.
fn list(line: &mut Line, title: &'static str, report: &Report, wanted: Outcome) -> bool {
    let mut before = title;
    // loop-bound: 10 checks
    for (check, outcome) in Check::ALL.into_iter().zip(report.outcomes) {
        if outcome == wanted {
            line.str(before).str(check.name());
            before = " ";
        }
    }
    before == " "
}

/// Steps of the LED's code: a flash and the dark time after it, and the pause between two codes.
const FLASH: u32 = 15;
const DARK: u32 = 15;
const PAUSE: u32 = 150;

/// Level of the LED at a step of 10 ms that tells the first failed check: as many flashes as its
/// number, then a pause.
pub fn code(check: Check, step: u32) -> bool {
    let flashes = check as u32;
    let phase = step % (flashes * (FLASH + DARK) + PAUSE);
    phase < flashes * (FLASH + DARK) && phase % (FLASH + DARK) < FLASH
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::e2e::Secret;
    use sled_common::clock::{Clocks, ResetCause};
    use sled_common::selftest::Reference;
    use std::vec::Vec;

    const SOUND: Findings = Findings {
        memory_defect: None,
        program: Some(true),
        clock_error: Some(-7),
        loop_back: Some(true),
        reference: Some(Reference {
            count: 1501,
            factory: 1501,
        }),
    };

    fn start(cause: ResetCause, record: Option<Fault>) -> Start {
        Start {
            cause,
            record,
            clocks: Clocks::of(parts::Sled::F303, Oscillator::External),
            secret: Secret::None,
        }
    }

    fn judge(start: &Start, findings: &Findings, bus: &BusView, motor: Motor) -> Vec<Check> {
        Report::new(start, findings, bus, motor, 1000, 500)
            .failed()
            .collect()
    }

    fn failed(findings: Findings) -> Vec<Check> {
        let start = start(ResetCause::Power, None);
        let bus = BusView::quiet(SyncState::InSchedule, Some(0));
        judge(&start, &findings, &bus, Motor::none(true))
    }

    #[test]
    fn a_sound_node_passes() {
        assert_eq!(failed(SOUND), []);
    }

    #[test]
    fn what_was_not_done_is_told_and_bars_nothing() {
        let start = start(ResetCause::Power, None);
        let away = BusView::quiet(SyncState::Synchronising, None);
        let findings = Findings {
            program: None,
            clock_error: None,
            loop_back: None,
            ..SOUND
        };
        let report = Report::new(&start, &findings, &away, Motor::none(true), 500, 500);
        assert_eq!(report.failed().count(), 0);
        assert!(report.is_fit());
        let mut line = Line::new();
        show(&mut line, &report);
        assert_eq!(
            std::str::from_utf8(line.as_bytes()).unwrap(),
            "test passed, not done program clocks loop bus relay | clock 0.0 % supply 3.300 V \
             stack 500\r\n"
        );
    }

    #[test]
    fn a_missing_clock_fails_one_check() {
        let still = Motor::none(true);
        let bus = BusView::quiet(SyncState::InSchedule, Some(0));
        let on = |oscillator, record| Start {
            clocks: Clocks::of(parts::Sled::F303, oscillator),
            ..start(ResetCause::Software, record)
        };
        let lost = Some(Fault::Clock);
        let missing = Findings {
            clock_error: None,
            ..SOUND
        };
        for record in [None, lost] {
            let start = on(Oscillator::Internal, record);
            assert_eq!(judge(&start, &missing, &bus, still), [Check::Oscillators]);
        }
        let wrong = Findings {
            clock_error: Some(-112),
            ..SOUND
        };
        let start = on(Oscillator::Internal, None);
        assert_eq!(judge(&start, &wrong, &bus, still), [Check::Oscillators]);
        // The PLL did not lock at the start before.
        let unlocked = on(Oscillator::Internal, Some(Fault::ClockStart));
        assert_eq!(
            judge(&unlocked, &missing, &bus, still),
            [Check::Reset, Check::Oscillators]
        );
        // The clock stopped in the run before, and is there again.
        let back = on(Oscillator::External, lost);
        assert_eq!(judge(&back, &SOUND, &bus, still), [Check::Reset]);
    }

    #[test]
    fn every_finding_fails_its_own_check() {
        let reference = |count, factory| Some(Reference { count, factory });
        for (findings, check) in [
            (
                Findings {
                    memory_defect: Some(0x2000_0004),
                    ..SOUND
                },
                Check::Memory,
            ),
            (
                Findings {
                    program: Some(false),
                    ..SOUND
                },
                Check::Program,
            ),
            (
                Findings {
                    clock_error: Some(101),
                    ..SOUND
                },
                Check::Oscillators,
            ),
            (
                Findings {
                    loop_back: Some(false),
                    ..SOUND
                },
                Check::LoopBack,
            ),
            (
                Findings {
                    reference: reference(1400, 1400),
                    ..SOUND
                },
                Check::Reference,
            ),
            (
                Findings {
                    reference: reference(1700, 1501),
                    ..SOUND
                },
                Check::Supply,
            ),
            (
                Findings {
                    reference: reference(1350, 1501),
                    ..SOUND
                },
                Check::Supply,
            ),
        ] {
            assert_eq!(failed(findings), [check]);
        }
        let dead = Findings {
            reference: None,
            ..SOUND
        };
        assert_eq!(failed(dead), [Check::Reference, Check::Supply]);
    }

    #[test]
    fn start_bus_relay_and_stack_are_judged() {
        let regular = start(ResetCause::Power, None);
        let well = BusView::quiet(SyncState::InSchedule, Some(0));
        let starved = start(ResetCause::Watchdog, None);
        let still = Motor::none(true);
        assert_eq!(judge(&starved, &SOUND, &well, still), [Check::Reset]);
        let alone = BusView::quiet(SyncState::Synchronising, None);
        let lonely = Report::new(&regular, &SOUND, &alone, still, 500, 500);
        assert_eq!(lonely.outcome(Check::Bus), Outcome::NotDone);
        let mut warned = well;
        warned.errors.warning = true;
        assert_eq!(judge(&regular, &SOUND, &warned, still), [Check::Bus]);
        let stuck = Motor {
            still: true,
            opens: Some(false),
        };
        assert_eq!(judge(&regular, &SOUND, &well, stuck), [Check::Relay]);
        let deep = Report::new(&regular, &SOUND, &well, still, 499, 500);
        assert_eq!(deep.failed().collect::<Vec<_>>(), [Check::Stack]);
        assert!(!deep.is_fit());
        let restarted = Report::new(&starved, &SOUND, &well, still, 500, 500);
        assert!(restarted.is_fit());
        assert_eq!(restarted.outcome(Check::Relay), Outcome::NotDone);
        assert_eq!(restarted.outcome(Check::Reset), Outcome::Failed);
        assert_eq!(restarted.outcome(Check::Stack), Outcome::Passed);
    }

    #[test]
    fn the_line_comes_with_every_change_and_a_failure_again() {
        let start = start(ResetCause::Power, None);
        let bus = BusView::quiet(SyncState::InSchedule, Some(0));
        let sound = Report::new(&start, &SOUND, &bus, Motor::none(true), 500, 500);
        let deep = Report::new(&start, &SOUND, &bus, Motor::none(true), 400, 500);
        let mut repeat = Repeat::new();
        let mut count = |report: &Report| (0..100).filter(|_| repeat.is_due(report)).count();
        assert_eq!(count(&sound), 1);
        assert_eq!(count(&Report { round: 3, ..sound }), 1);
        let driving = Report { round: 3, ..sound };
        let mut standing = driving;
        standing.outcomes[Check::Relay as usize - 1] = Outcome::Passed;
        assert_eq!(count(&standing), 1, "the relay has been checked");
        assert_eq!(count(&driving), 0, "it cannot be checked now");
        assert_eq!(
            count(&standing),
            0,
            "a check that can be done again is no news"
        );
        assert_eq!(count(&deep), 2);
    }

    #[test]
    fn the_longest_line_fits() {
        let report = Report {
            round: 255,
            outcomes: [Outcome::Failed; Check::ALL.len()],
            clock_error: -128,
            supply: u16::MAX,
            stack_free: u16::MAX,
        };
        let mut line = Line::new();
        show(&mut line, &report);
        assert!(!line.is_cut());
        assert_eq!(
            std::str::from_utf8(line.as_bytes()).unwrap(),
            "test FAILED reset memory program clocks loop bus ref supply relay stack | clock -12.8 % \
             supply 65.535 V stack 65535\r\n"
        );
        let mut hindered = report;
        hindered.outcomes[Check::Relay as usize - 1] = Outcome::NotDone;
        line.clear();
        show(&mut line, &hindered);
        assert!(!line.is_cut());
        assert_eq!(
            std::str::from_utf8(line.as_bytes()).unwrap(),
            "test FAILED reset memory program clocks loop bus ref supply stack, not done relay | \
             clock -12.8 % supply 65.535 V stack 65535\r\n"
        );
    }

    #[test]
    fn the_led_flashes_the_number_of_the_check() {
        for check in Check::ALL {
            let number = check as u32;
            let period = number * (FLASH + DARK) + PAUSE;
            let levels: Vec<bool> = (0..period).map(|step| code(check, step)).collect();
            let flashes = levels.windows(2).filter(|pair| !pair[0] && pair[1]).count();
            // The first flash begins with the period.
            assert_eq!(flashes + 1, number as usize);
            assert!(code(check, period) && !code(check, period - 1));
        }
    }
}

//! Duties of every node, a hundred times a second: feed the watchdog while schedule and tasks
//! make progress, report the node's state on the bus, set the LED.

use network::Message;
pub use sled_common::clock::ResetCause;

use sled_common::can::ErrorState;
use sled_common::clock::{Clocks, Oscillator};
use sled_common::fault::Fault;
use sled_common::selftest::Findings;
use ttcan::{ErrorLevel, Micros, SyncState};

use crate::console::BusView;
use crate::design;
use crate::e2e::Secret;
use crate::link::Silence;
use crate::selftest::{self, Check, Motor, Report, ReportMessage, Request, RequestMessage};

/// Steps of 10 ms after which a schedule or a task without progress counts as stuck: 150 ms,
/// one and a half basic cycles of 100 ms.
const PATIENCE: u8 = 15;

/// Least time between two event messages of the housekeeping on the bus, a status or a self-test: their
/// inhibit time, as CiA 301 calls it. The network file says that the one is sent in place of the
/// other, and the analysis counts the two as one message with this interval.
pub const REPORT_INTERVAL: Micros = Micros::millis(100);

/// The same in steps, from the first step that finds the last message gone to the one that may enqueue
/// the next. It does not count from the step that enqueued the last one, because a message may wait for
/// its window: on a flooded bus the next one would follow it at once. The first step counts although
/// no time has passed, and a step may come half a step late, so there are two more.
const REPORT_PAUSE: u8 =
    (REPORT_INTERVAL.ticks() / (1000 * design::HOUSEKEEPING_PERIOD.ticks())) as u8 + 2;

/// Steps in the schedule after which a node that has started reports its self-test: 200 ms, two
/// basic cycles.
const SETTLE_STEPS: u8 = 20;

/// Steps of 10 ms in which the external clock must be there before the node starts again with it.
const CLOCK_STEPS: u8 = 10;

/// Steps after a restart for the external clock before the next one: 10 s.
const CLOCK_PAUSE: u32 = 1000;

/// Silence on the bus after which the best of the masters leads on its RC oscillator, and how much
/// longer each of the others waits.
const LAST_RESORT: Micros = Micros::secs(3);
const LAST_RESORT_RANK: Micros = Micros::secs(2);

/// Duties of the node after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duties {
    /// Feed the watchdog.
    pub feed: bool,
    /// A status message to enqueue, in place of the one that has not left the node yet if there is
    /// one.
    pub report: Option<Status>,
    /// Level of the LED.
    pub led: bool,
}

/// State of a node, for its status message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Why the node started.
    pub reset_cause: ResetCause,
    /// Error level of the protocol stack, S0 to S3.
    pub error_level: ErrorLevel,
    /// State of the controller on the bus.
    pub bus: BusState,
    /// What went wrong before the start or since.
    pub fault: Option<NodeFault>,
    /// Transmit error counter.
    pub transmit_errors: u8,
    /// Receive error counter.
    pub receive_errors: u8,
    /// Own windows missed; saturates.
    pub missed_windows: u16,
    /// Bus-off states; wraps.
    pub bus_offs: u16,
}

impl Status {
    /// Whether two reports differ in their counters only.
    fn is_same_state(&self, other: &Self) -> bool {
        let level = |status: &Self| core::mem::discriminant(&status.error_level);
        level(self) == level(other) && (self.bus, self.fault) == (other.bus, other.fault)
    }
}

/// How the node started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// Why the microcontroller started.
    pub cause: ResetCause,
    /// The fault record that outlived the reset.
    pub record: Option<Fault>,
    /// The clocks that it runs on.
    pub clocks: Clocks,
    /// What it found in the place of its key.
    pub secret: Secret,
}

impl Start {
    /// What went wrong before the start or at it.
    pub const fn fault(&self) -> Option<NodeFault> {
        match (self.record, self.cause, self.clocks.oscillator) {
            (Some(Fault::Panic), ..) => Some(NodeFault::Panic),
            (Some(Fault::Hard | Fault::Unhandled), ..) => Some(NodeFault::HardFault),
            (Some(Fault::Start), ..) => Some(NodeFault::StartRefused),
            (Some(Fault::Clock | Fault::ClockStart), ..) => Some(NodeFault::ClockFailure),
            // A supply that is switched off falls first, and one that is switched on rises.
            (
                Some(Fault::Supply),
                ResetCause::Pin | ResetCause::Software | ResetCause::Watchdog | ResetCause::Other,
                _,
            ) => Some(NodeFault::SupplyLow),
            (None, ResetCause::Watchdog, _) => Some(NodeFault::WatchdogStarved),
            (_, _, Oscillator::Internal) => Some(NodeFault::ClockFailure),
            (
                None
                | Some(Fault::ClockFound | Fault::LastResort | Fault::SelfTest | Fault::Supply),
                _,
                Oscillator::External,
            ) => None,
        }
    }

    /// Whether the node started again to lead on its RC oscillator.
    pub fn is_last_resort(&self) -> bool {
        self.record == Some(Fault::LastResort)
    }
}

/// Error state of a CAN controller (ISO 11898-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum BusState {
    /// Full participation.
    ErrorActive,
    /// Takes part, but its error flags cannot destroy the frames of others.
    ErrorPassive,
    /// Takes no part in the traffic.
    BusOff,
}

impl BusState {
    /// The state that the controller's registers say.
    pub const fn of(errors: &ErrorState) -> Self {
        if errors.bus_off {
            Self::BusOff
        } else if errors.passive {
            Self::ErrorPassive
        } else {
            Self::ErrorActive
        }
    }
}

/// What went wrong in a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum NodeFault {
    /// The program panicked.
    Panic,
    /// A hard fault, or an interrupt without a task.
    HardFault,
    /// The node could not start: its schedule or a peripheral was refused.
    StartRefused,
    /// The external oscillator failed.
    ClockFailure,
    /// The watchdog was not fed.
    WatchdogStarved,
    /// The self-test failed: no motor turns by this node's hand.
    SelfTest,
    /// The supply was too low for the clock.
    SupplyLow,
}

/// The status message of a node, as its network defines it.
pub trait StatusMessage: Message {
    /// The message by which the node reports its self-test.
    type Report: ReportMessage;
    /// The message by which a program on the bus asks for it.
    type Request: RequestMessage;
    /// The message for a status.
    fn of(status: &Status) -> Self;
}

/// An event message of the housekeeping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The node's status.
    Status,
    /// Its self-test.
    SelfTest,
}

/// Housekeeping of a node.
#[derive(Clone, Copy, Debug)]
pub struct Housekeeping {
    start: Start,
    /// Steps in a row in which the external clock was there.
    clocked: u8,
    cause: ResetCause,
    fault: Option<NodeFault>,
    steps: u32,
    services: u32,
    work: u32,
    quiet: u8,
    idle: u8,
    reported: Option<Status>,
    pause: u8,
    /// The message that has not left the node yet.
    unsent: Option<Event>,
    findings: Findings,
    /// The self-test after the last step.
    test: Option<Report>,
    /// Steps in the schedule in a row, until the node has reported its start.
    settled: u8,
    /// The round for which a report is due.
    round: Option<u8>,
    /// The first check on which safety rests that has ever failed.
    unfit: Option<Check>,
}

impl Housekeeping {
    /// Housekeeping that has done no step yet, on a board with these findings.
    pub const fn new(start: &Start, findings: &Findings) -> Self {
        Self {
            start: *start,
            clocked: 0,
            cause: start.cause,
            fault: start.fault(),
            steps: 0,
            services: 0,
            work: 0,
            quiet: 0,
            idle: 0,
            reported: None,
            pause: 0,
            unsent: None,
            findings: *findings,
            test: None,
            settled: 0,
            round: Some(0),
            unfit: None,
        }
    }

    /// Notes which of its messages has not left the node yet: it waits, or is being sent. Call this
    /// before each step.
    pub const fn note_unsent(&mut self, event: Option<Event>) {
        self.unsent = event;
    }

    /// One step. `work` counts activations of the node's own tasks. While the schedule runs,
    /// the watchdog is fed only as long as `work` and the window timer's count of services keep
    /// growing.
    pub fn step(&mut self, bus: &BusView, work: u32) -> Duties {
        self.steps = self.steps.wrapping_add(1);
        let running = bus.status.sync == SyncState::InSchedule;
        if bus.link.services != self.services || !running {
            self.quiet = 0;
        } else {
            self.quiet = self.quiet.saturating_add(1);
        }
        if work != self.work || !running {
            self.idle = 0;
        } else {
            self.idle = self.idle.saturating_add(1);
        }
        self.services = bus.link.services;
        self.work = work;
        Duties {
            feed: self.quiet < PATIENCE && self.idle < PATIENCE,
            report: self.report(bus, running),
            led: self.led(bus, running),
        }
    }

    /// Judges the node. Of the stack, `unused` bytes were never used, and `reserve` bytes must not
    /// be. Returns the report that is due on the bus. Call this before each step.
    pub fn test(
        &mut self,
        bus: &BusView,
        motor: Motor,
        reserve: u16,
        unused: u16,
    ) -> Option<Report> {
        let running = bus.status.sync == SyncState::InSchedule;
        self.settled = if running {
            self.settled.saturating_add(1)
        } else {
            0
        };
        let due = self
            .round
            .filter(|_| self.settled > SETTLE_STEPS && self.pause == 0);
        let mut report = Report::new(&self.start, &self.findings, bus, motor, unused, reserve);
        if self.unfit.is_none() {
            self.unfit = report.unfit();
            self.fault = self.fault.or(self.unfit.map(|_| NodeFault::SelfTest));
        }
        report.round = due.or(self.test.map(|last| last.round)).unwrap_or(0);
        self.test = Some(report);
        if due.is_some() {
            self.round = None;
            // The step that follows takes one off.
            self.pause = REPORT_PAUSE + 1;
        }
        due.map(|_| report)
    }

    /// Notes a request of a program on the bus; `still` tells that no motor turns by this node's
    /// hand. True if the node is to start again.
    ///
    /// A node with a key never starts again by a request: requests have no tag, so whoever reaches the bus
    /// could restart the whole vehicle. It only reports what the running program has found.
    pub fn ask(&mut self, request: &Request, still: bool) -> bool {
        self.round = Some(request.round);
        request.start_again && still && self.start.secret == Secret::None
    }

    /// Notes that the queue had no room for the report of a round: it is tried again after the pause.
    pub fn test_refused(&mut self, round: u8) {
        self.round = Some(round);
    }

    /// The self-test after the last step; `None` before the first one.
    pub const fn last_test(&self) -> Option<&Report> {
        self.test.as_ref()
    }

    /// Whether the node may turn a motor. Once it may not, it never may again until it starts
    /// anew.
    pub const fn is_fit(&self) -> bool {
        self.unfit.is_none()
    }

    /// Whether the node runs on its RC oscillator and looks for its external clock.
    pub fn wants_clock(&self) -> bool {
        self.start.clocks.oscillator == Oscillator::Internal
    }

    /// Why the node is to start again: with its external clock, which is `ready`, or to lead as
    /// the last resort. `idle` tells that no motor turns by its hand. Call this before each step.
    pub fn restart(&mut self, bus: &BusView, ready: bool, idle: bool) -> Option<Fault> {
        if !self.wants_clock() {
            return None;
        }
        self.clocked = if ready {
            self.clocked.saturating_add(1)
        } else {
            0
        };
        let running = bus.status.sync == SyncState::InSchedule;
        // A clock that came and was gone again at the start is not trusted so soon.
        let again = self.start.record == Some(Fault::ClockFound);
        let pause = if again { CLOCK_PAUSE } else { 0 };
        if self.clocked >= CLOCK_STEPS && self.steps >= pause && (idle || !running) {
            return Some(Fault::ClockFound);
        }
        let rank = bus.rank?;
        let patience = LAST_RESORT + LAST_RESORT_RANK * u32::from(rank);
        let quiet = bus.quiet? >= patience && !self.start.is_last_resort();
        quiet.then_some(Fault::LastResort)
    }

    /// A status message after the start and whenever anything except the counters changed. It replaces
    /// one that waits, so that what is sent is new.
    fn report(&mut self, bus: &BusView, running: bool) -> Option<Status> {
        self.pause = match self.unsent {
            Some(_) => REPORT_PAUSE,
            None => self.pause.saturating_sub(1),
        };
        let replaces = self.unsent == Some(Event::Status);
        if !running || (self.pause > 0 && !replaces) {
            return None;
        }
        let status = Status {
            reset_cause: self.cause,
            error_level: bus.status.error_level,
            bus: BusState::of(&bus.errors),
            fault: self.fault,
            transmit_errors: bus.errors.transmit,
            receive_errors: bus.errors.receive,
            missed_windows: bus.missed_windows.min(u32::from(u16::MAX)) as u16,
            bus_offs: bus.link.bus_off,
        };
        if self
            .reported
            .is_some_and(|last| last.is_same_state(&status))
        {
            return None;
        }
        self.pause = REPORT_PAUSE;
        self.reported = Some(status);
        Some(status)
    }

    /// Notes that the queue was full, or that the status to be replaced has been sent: the report is tried
    /// again as soon as the pause allows it.
    pub fn report_refused(&mut self) {
        self.reported = None;
    }

    /// The LED's pattern. In the schedule: on, with one short dark spot a second, or two on the
    /// RC oscillator. Unfit to turn a motor: the code of the failed check. Looking for the schedule:
    /// slow blinking. Off the bus, or at error level S2 or S3: fast blinking. Silent until the RC oscillator is trimmed: one short flash a second.
    fn led(&self, bus: &BusView, running: bool) -> bool {
        let phase = self.steps % 100;
        let trouble = bus.errors.bus_off
            || matches!(
                bus.status.error_level,
                ErrorLevel::Error | ErrorLevel::Severe(_)
            );
        let listens = matches!(bus.silence, Some(Silence::NoReference | Silence::Trimming));
        if let Some(check) = self.unfit {
            selftest::code(check, self.steps)
        } else if listens {
            phase < 5
        } else if trouble {
            phase % 20 < 10
        } else if running {
            phase < 95 && !(self.wants_clock() && (80..85).contains(&phase))
        } else {
            phase < 50
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use sled_common::selftest::Reference;

    fn start(cause: ResetCause, record: Option<Fault>) -> Start {
        let clocks = Clocks::of(parts::Sled::F303, Oscillator::External);
        Start {
            cause,
            record,
            clocks,
            secret: Secret::None,
        }
    }

    const SOUND: Findings = Findings {
        memory_defect: None,
        program: None,
        clock_error: Some(0),
        loop_back: Some(true),
        reference: Some(Reference {
            count: 1501,
            factory: 1501,
        }),
    };

    fn view(sync: SyncState, services: u32) -> BusView {
        let mut view = BusView::quiet(sync, Some(0));
        view.missed_windows = 70_000;
        view.link.services = services;
        view
    }

    #[test]
    fn the_watchdog_starves_when_the_schedule_or_the_work_stands_still() {
        let new = || Housekeeping::new(&start(ResetCause::Pin, None), &SOUND);
        let mut keeping = new();
        for step in 0..100 {
            assert!(keeping.step(&view(SyncState::InSchedule, step), step).feed);
        }
        let mut fed = 0;
        for step in 0..100 {
            fed += u32::from(keeping.step(&view(SyncState::InSchedule, 99), step).feed);
        }
        assert!(fed < 16);
        let mut keeping = new();
        let mut fed = 0;
        for step in 0..100 {
            fed += u32::from(keeping.step(&view(SyncState::InSchedule, step), 7).feed);
        }
        assert!(fed < 17);
        // Waiting for a master is no fault.
        let mut keeping = new();
        for _ in 0..100 {
            assert!(keeping.step(&view(SyncState::Synchronising, 5), 5).feed);
        }
    }

    #[test]
    fn the_cause_is_reported_once() {
        let mut keeping =
            Housekeeping::new(&start(ResetCause::Software, Some(Fault::Panic)), &SOUND);
        assert_eq!(
            keeping.step(&view(SyncState::Synchronising, 0), 0).report,
            None
        );
        let report = keeping.step(&view(SyncState::InSchedule, 1), 1).report;
        let status = report.expect("a report after the start");
        assert_eq!(
            (status.reset_cause, status.fault, status.missed_windows),
            (ResetCause::Software, Some(NodeFault::Panic), u16::MAX)
        );
        for step in 2..50 {
            assert_eq!(
                keeping
                    .step(&view(SyncState::InSchedule, step), step)
                    .report,
                None
            );
        }
    }

    /// Steps from the one before which the last message left the node to the one that enqueues the
    /// next, which the analysis counts on.
    const APART: usize = 11;

    /// A queue that lets a message go `wait` steps after it was enqueued, at the earliest. Each step the
    /// node's state may change, and a self-test may be asked for. Returns at which steps messages left,
    /// and with which fault they did.
    fn through_queue(
        acts: &[(bool, bool)],
        wait: usize,
    ) -> std::vec::Vec<(usize, Event, BusState)> {
        let mut keeping = Housekeeping::new(&start(ResetCause::Pin, None), &SOUND);
        let mut queue: Option<(usize, Event, BusState)> = None;
        let mut sent = std::vec::Vec::new();
        let mut bus = view(SyncState::InSchedule, 0);
        for (step, (changes, asks)) in acts.iter().enumerate() {
            sent.extend(
                queue
                    .take_if(|(since, ..)| step > *since + wait)
                    .map(|(_, event, state)| (step, event, state)),
            );
            bus.errors.passive ^= changes;
            bus.link.services += 1;
            if *asks {
                let request = Request {
                    round: 1,
                    start_again: false,
                };
                assert!(!keeping.ask(&request, true));
            }
            keeping.note_unsent(queue.map(|(_, event, _)| event));
            let test = keeping.test(&bus, Motor::none(true), 0, 800);
            let status = keeping.step(&bus, 0).report;
            if test.is_some() {
                assert!(queue.is_none() && status.is_none());
                queue = Some((step, Event::SelfTest, BusState::ErrorActive));
            } else if let Some(status) = status {
                let since = queue.map_or(step, |(since, event, _)| {
                    assert_eq!(event, Event::Status);
                    since
                });
                queue = Some((since, Event::Status, status.bus));
            }
            if let Some((_, Event::Status, state)) = queue {
                assert_eq!(state, BusState::of(&bus.errors), "the newest waits");
            }
        }
        sent
    }

    proptest! {
        #[test]
        fn messages_keep_their_distance_however_long_they_wait(
            acts in prop::collection::vec(any::<(bool, bool)>(), 0..400),
            wait in 0usize..60,
        ) {
            let sent = through_queue(&acts, wait);
            // The next one is sent a step after it is enqueued, if not later.
            for two in sent.windows(2) {
                prop_assert!(two[1].0 - two[0].0 > APART, "{two:?}");
            }
        }
    }

    #[test]
    fn a_status_that_waited_is_sent_as_it_is_now() {
        let changes = [5, 30].map(|at| at..at + 1);
        let acts: std::vec::Vec<_> = (0..120)
            .map(|step| (changes.iter().any(|at| at.contains(&step)), false))
            .collect();
        let sent = through_queue(&acts, 20);
        let of: std::vec::Vec<_> = sent.iter().map(|sent| (sent.1, sent.2)).collect();
        assert_eq!(
            of,
            [
                (Event::Status, BusState::ErrorPassive),
                (Event::Status, BusState::ErrorActive),
                (Event::SelfTest, BusState::ErrorActive),
            ]
        );
    }

    #[test]
    fn the_self_test_is_reported_after_the_start_and_for_each_request() {
        let mut keeping = Housekeeping::new(&start(ResetCause::Pin, None), &SOUND);
        let mut rounds = std::vec::Vec::new();
        let mut run = |keeping: &mut Housekeeping, sync| {
            for _ in 0..100 {
                let bus = view(sync, 0);
                let report = keeping.test(&bus, Motor::none(true), 0, 800);
                let status = keeping.step(&bus, 0).report;
                assert!(report.is_none() || status.is_none(), "one event a step");
                rounds.extend(report.map(|report| (report.round, report.stack_free)));
            }
        };
        run(&mut keeping, SyncState::Synchronising);
        run(&mut keeping, SyncState::InSchedule);
        let request = |round, start_again| Request { round, start_again };
        assert!(!keeping.ask(&request(7, false), true));
        run(&mut keeping, SyncState::InSchedule);
        keeping.test_refused(7);
        run(&mut keeping, SyncState::InSchedule);
        assert_eq!(rounds, [(0, 800), (7, 800), (7, 800)]);
        assert!(keeping.ask(&request(8, true), true));
        assert!(!keeping.ask(&request(9, true), false));
    }

    #[test]
    fn a_node_with_a_key_answers_a_request_but_does_not_start_again() {
        for secret in [Secret::Key(crate::e2e::Key::new([7; 16])), Secret::Damaged] {
            let start = Start {
                secret,
                ..start(ResetCause::Pin, None)
            };
            let mut keeping = Housekeeping::new(&start, &SOUND);
            let request = Request {
                round: 8,
                start_again: true,
            };
            assert!(!keeping.ask(&request, true));
            let bus = view(SyncState::InSchedule, 0);
            let reports = (0..100).filter_map(|_| {
                let report = keeping.test(&bus, Motor::none(true), 0, 800);
                keeping.step(&bus, 0);
                report.map(|report| report.round)
            });
            assert_eq!(reports.collect::<std::vec::Vec<_>>(), [8]);
        }
    }

    #[test]
    fn a_node_that_was_unfit_once_stays_so() {
        let mut keeping = Housekeeping::new(&start(ResetCause::Pin, None), &SOUND);
        let bus = view(SyncState::InSchedule, 0);
        let motor = |opens| Motor { still: true, opens };
        for (opens, fit) in [
            (None, true),
            (Some(true), true),
            (Some(false), false),
            (None, false),
        ] {
            let _ = keeping.test(&bus, motor(opens), 0, 0);
            assert_eq!(keeping.is_fit(), fit);
        }
        let status = keeping
            .step(&bus, 0)
            .report
            .expect("a report after the start");
        assert_eq!(status.fault, Some(NodeFault::SelfTest));
    }
}

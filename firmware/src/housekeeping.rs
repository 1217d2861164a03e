//! What every node does a hundred times a second besides its job: judges whether it may feed
//! its watchdog, reports its state on the bus, blinks.

use network::Message as _;
use network::messages::{
    BusState, ErrorLevel as NamedLevel, Fault as NamedFault, GpsStatus, ResetCause as NamedCause,
};
use sled_common::clock::{Oscillator, ResetCause};
use sled_common::fault::Fault;
use ttcan::{ErrorLevel, SyncState};

use crate::console::BusView;

/// Steps, of 10 ms each, in which the schedule must show a sign of life: one and a half basic
/// cycles.
const PATIENCE: u8 = 15;

/// Steps between two reports of a state that has changed: a basic cycle.
const REPORT_PAUSE: u8 = 10;

/// What a step asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duties {
    /// Feed the watchdog.
    pub feed: bool,
    /// Data of a status message to be queued.
    pub report: Option<[u8; 8]>,
    /// Level of the LED.
    pub led: bool,
}

/// Housekeeping of a node.
#[derive(Clone, Copy, Debug)]
pub struct Housekeeping {
    cause: NamedCause,
    fault: NamedFault,
    steps: u32,
    services: u32,
    work: u32,
    quiet: u8,
    idle: u8,
    reported: Option<[u8; 8]>,
    pause: u8,
}

impl Housekeeping {
    /// `fault` is the record that outlived the reset.
    pub const fn new(cause: ResetCause, fault: Option<Fault>, oscillator: Oscillator) -> Self {
        let cause_named = match cause {
            ResetCause::Power => NamedCause::PowerOn,
            ResetCause::Pin => NamedCause::Pin,
            ResetCause::Software => NamedCause::Software,
            ResetCause::Watchdog => NamedCause::IndependentWatchdog,
            ResetCause::Other => NamedCause::Unknown,
        };
        Self {
            cause: cause_named,
            fault: match (fault, cause, oscillator) {
                (Some(Fault::Panic), ..) => NamedFault::Panic,
                (Some(Fault::Hard | Fault::Unhandled), ..) => NamedFault::HardFault,
                (Some(Fault::Start), ..) => NamedFault::ScheduleRefused,
                (Some(Fault::Clock), ..) => NamedFault::ClockFailure,
                (None, ResetCause::Watchdog, _) => NamedFault::WatchdogStarved,
                (None, _, Oscillator::Internal) => NamedFault::ClockFailure,
                (None, _, Oscillator::External) => NamedFault::None,
            },
            steps: 0,
            services: 0,
            work: 0,
            quiet: 0,
            idle: 0,
            reported: None,
            pause: 0,
        }
    }

    /// Notes a fault of the running node for its status message; the first one stands until
    /// it was reported.
    pub fn note(&mut self, fault: NamedFault) {
        if self.fault == NamedFault::None {
            self.fault = fault;
        }
    }

    /// One step. `work` counts what the node's own tasks have done; while the schedule runs it
    /// must go on, as must the services of the window timer.
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

    /// A status message after the start and whenever something but the counters changed.
    fn report(&mut self, bus: &BusView, running: bool) -> Option<[u8; 8]> {
        self.pause = self.pause.saturating_sub(1);
        if !running || self.pause > 0 {
            return None;
        }
        let status = GpsStatus {
            reset_cause: self.cause,
            error_level: match bus.status.error_level {
                ErrorLevel::None => NamedLevel::None,
                ErrorLevel::Warning => NamedLevel::Warning,
                ErrorLevel::Error => NamedLevel::Error,
                ErrorLevel::Severe(_) => NamedLevel::Severe,
            },
            bus_state: if bus.errors.bus_off {
                BusState::BusOff
            } else if bus.errors.passive {
                BusState::ErrorPassive
            } else {
                BusState::ErrorActive
            },
            fault: self.fault,
            transmit_errors: bus.errors.transmit,
            receive_errors: bus.errors.receive,
            missed_windows: bus.missed_windows.min(u32::from(u16::MAX)) as u16,
            fault_detail: bus.link.bus_off,
        }
        .encode();
        if self.reported.is_some_and(|last| same_state(&last, &status)) {
            return None;
        }
        self.pause = REPORT_PAUSE;
        self.reported = Some(status);
        Some(status)
    }

    /// The report found no room: it is tried again.
    pub fn report_refused(&mut self) {
        self.reported = None;
    }

    /// Steady: in schedule, one short dark spot a second. Slow blinking: looking for the
    /// schedule. Fast: off the bus, or S2 and S3.
    fn led(&self, bus: &BusView, running: bool) -> bool {
        let phase = self.steps % 100;
        let trouble = bus.errors.bus_off
            || matches!(
                bus.status.error_level,
                ErrorLevel::Error | ErrorLevel::Severe(_)
            );
        if trouble {
            phase % 20 < 10
        } else if running {
            phase < 95
        } else {
            phase < 50
        }
    }
}

/// Whether two status messages differ in their counters only: bytes 0 and 1 are the state.
fn same_state(one: &[u8; 8], other: &[u8; 8]) -> bool {
    let ([a0, a1, ..], [b0, b1, ..]) = (one, other);
    a0 == b0 && a1 == b1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link;
    use network::messages::{ControllerStatus, DriveStatus, SteeringStatus};
    use sled_common::can::ErrorState;
    use ttcan::{ClockState, MasterState, Status};

    fn view(sync: SyncState, services: u32) -> BusView {
        BusView {
            status: Status {
                sync,
                master: MasterState::Follower,
                error_level: ErrorLevel::None,
                missed_references: 0,
                cycle: 0,
                master_rank: Some(0),
                initial_watch: false,
                clock: ClockState::Locked,
                reference_offset: 0,
            },
            missed_references: 0,
            missed_messages: 0,
            missed_windows: 70_000,
            misplaced: 0,
            errors: ErrorState::default(),
            link: link::Counters {
                services,
                ..link::Counters::default()
            },
        }
    }

    #[test]
    fn the_watchdog_starves_when_the_schedule_or_the_work_stands_still() {
        let new = || Housekeeping::new(ResetCause::Pin, None, Oscillator::External);
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
    fn the_cause_is_reported_once_and_in_every_node_s_layout() {
        let mut keeping = Housekeeping::new(
            ResetCause::Software,
            Some(Fault::Panic),
            Oscillator::External,
        );
        assert_eq!(
            keeping.step(&view(SyncState::Synchronising, 0), 0).report,
            None
        );
        let report = keeping.step(&view(SyncState::InSchedule, 1), 1).report;
        let data = report.expect("a report after the start");
        let status = GpsStatus::decode(&data).expect("that decodes");
        assert_eq!(
            (status.reset_cause, status.fault, status.missed_windows),
            (NamedCause::Software, NamedFault::Panic, u16::MAX)
        );
        // One layout for all four nodes.
        assert_eq!(ControllerStatus::decode(&data).unwrap().fault, status.fault);
        assert_eq!(
            SteeringStatus::decode(&data).unwrap().missed_windows,
            u16::MAX
        );
        assert_eq!(
            DriveStatus::decode(&data).unwrap().reset_cause,
            status.reset_cause
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
}

//! Code of the tasks of every node that uses the board: time base, watchdog, LED, console.

use crate::board;
use crate::console::{self, BusView, Line};
use crate::design;
use crate::housekeeping::{Housekeeping, Start, StatusMessage};
use crate::link::{Identity, Link, Stack, WindowTimer};
use crate::log::{Changes, Own};
use board::clock::{Clocks, Oscillator};
use board::led::Led;
use board::watchdog::{self, Watchdog};
use core::future::{Future, pending};
use cortex_m::peripheral::{SCB, SYST};
use fugit::MillisDurationU32;
use rtic::Mutex;
use rtic_monotonics::TimerQueueBackend;
use rtic_monotonics::systick::SystickBackend;
use rtic_monotonics::systick::prelude::*;
use ttcan::{ConfigError, Micros, NodeConfig, StampLatency};

/// The time base and its compare channels, as the link uses them.
pub struct Timer {
    clock: board::time::Clock,
    alarms: board::time::Alarms,
}

/// The link of a node on this board, in a network with this many windows and nodes.
pub type BoardLink<const WINDOWS: usize, const NODES: usize> =
    Link<board::CanPort, Timer, WINDOWS, NODES>;

impl WindowTimer for Timer {
    #[inline]
    fn now(&self) -> u32 {
        self.clock.now()
    }
    #[inline]
    fn set_window(&mut self, instant: u32) {
        self.alarms.set_window(instant);
    }
    #[inline]
    fn clear_window(&mut self) {
        self.alarms.clear_window();
    }
}

impl<const WINDOWS: usize, const NODES: usize> BoardLink<WINDOWS, NODES> {
    /// Interrupt of the time base: loads the mailbox when the window timer fired. True when
    /// the node's second alarm went off.
    pub fn on_timer(&mut self) -> bool {
        let released = self.timer_mut().take_release();
        if self.timer_mut().take_window() {
            self.service();
        }
        released
    }

    /// Sets the node's second alarm to go off in `time`.
    pub fn release_in(&mut self, time: Micros) {
        let ticks = self.ticks(time);
        self.timer_mut().release_in(ticks.cast_signed());
    }

    /// Sets the node's second alarm to the cycle time `time` of the current basic cycle; at
    /// once when that is past.
    pub fn release_at(&mut self, time: Micros) {
        if let Some(ticks) = self.until(time) {
            self.timer_mut().release_in(ticks);
        }
    }
}

impl Timer {
    /// Acknowledges the window timer; true when it had fired.
    #[inline]
    pub fn take_window(&mut self) -> bool {
        self.alarms.take_window()
    }

    /// Sets the second alarm of the node `ticks` from now; at once when negative.
    #[inline]
    pub fn release_in(&mut self, ticks: i32) {
        let instant = self.clock.now().wrapping_add_signed(ticks);
        self.alarms.set_release(instant);
    }

    /// Acknowledges the second alarm; true when it had fired.
    #[inline]
    pub fn take_release(&mut self) -> bool {
        self.alarms.take_release()
    }
}

/// Makes the link of a node, whose protocol stack lives in `place`; it is silent until [`Link::start`].
///
/// # Errors
/// The protocol stack refuses the configuration.
pub fn link<const WINDOWS: usize, const NODES: usize>(
    place: &'static mut Option<Stack<WINDOWS, NODES>>,
    identity: Identity,
    clocks: Clocks,
    can: board::CanPort,
    clock: board::time::Clock,
    alarms: board::time::Alarms,
) -> Result<BoardLink<WINDOWS, NODES>, ConfigError> {
    let bit = 1_000_000 * clocks.ticks_per_us / board::BIT_RATE;
    let config = NodeConfig {
        latency: StampLatency::bxcan(bit, board::FACTS.stamp_ticks),
        transmit_lead: board::FACTS.transmit_lead_ticks,
        drift_limit_ppm: match clocks.oscillator {
            Oscillator::External => design::DRIFT_LIMIT_PPM,
            Oscillator::Internal => design::DRIFT_LIMIT_PPM_INTERNAL,
        },
        // A master on its RC oscillator is beyond what the others follow: the next in rank
        // leads, and this node keeps its windows.
        may_lead: clocks.oscillator == Oscillator::External,
        ..NodeConfig::new(identity.node, clocks.ticks_per_us)
    };
    let timer = Timer { clock, alarms };
    Link::new(place, identity.schedule, config, can, timer)
}

/// Writes what changes to the log of a debug probe. For the task of the lowest priority only.
/// Without a probe, or with a slow one, the line is dropped and no task waits.
pub struct Log {
    changes: Changes,
}

impl Log {
    /// A log that begins with the node's start.
    pub const fn new(start: &Start) -> Self {
        Self {
            changes: Changes::new(start),
        }
    }

    /// Writes one line at most.
    fn pass(&mut self, bus: &BusView, own: &Own) {
        if let Some(entry) = self.changes.next(bus, own) {
            defmt::info!("{}", entry);
        }
    }
}

/// Steps of the housekeeping between two reports on the console.
const REPORT_STEPS: u32 = design::CONSOLE_PERIOD.ticks() / design::HOUSEKEEPING_PERIOD.ticks();

const _: () = assert!(
    design::CONSOLE_PERIOD
        .ticks()
        .is_multiple_of(design::HOUSEKEEPING_PERIOD.ticks()),
    "the console follows the housekeeping's steps"
);

#[cfg(feature = "f446")]
const WATCHDOG: MillisDurationU32 = design::WATCHDOG_F446;
#[cfg(feature = "f303")]
const WATCHDOG: MillisDurationU32 = design::WATCHDOG_F303;

/// Ticks in a second: one for each step of the housekeeping.
const TICKS: u32 = 1000 / design::HOUSEKEEPING_PERIOD.ticks();

const _: () = assert!(
    1000u32.is_multiple_of(design::HOUSEKEEPING_PERIOD.ticks()),
    "a step is a tick"
);

systick_monotonic!(Mono, TICKS);

type Instant = <Mono as Monotonic>::Instant;
type Duration = <Mono as Monotonic>::Duration;

/// The instants at which a software task goes on, one at each tick.
pub struct Pace {
    due: Instant,
}

impl Pace {
    /// A pace that begins now.
    pub fn begin() -> Self {
        Self { due: Mono::now() }
    }

    /// Waits for the next instant: a tick after the last one however long the work took.
    /// Instants that were missed are left out.
    pub fn wait(&mut self) -> impl Future + use<> {
        const TICK: Duration = Duration::from_ticks(1);
        let now = Mono::now();
        self.due += TICK;
        if self.due <= now {
            self.due = now + TICK;
        }
        // Of the ways to wait the one without a panic: `Mono::delay_until` is an `async fn`,
        // which may not be polled once more, and asks whether the timer was started.
        let queue = SystickBackend::timer_queue();
        queue.timeout_at(self.due.ticks(), pending::<()>())
    }
}

/// The housekeeping task's own things: watchdog and LED.
pub struct Keeper {
    housekeeping: Housekeeping,
    watchdog: Watchdog,
    led: Led,
    shown: Option<bool>,
    steps: u32,
}

impl Keeper {
    /// Starts watchdog and tick: SysTick, from the core clock; `system` sets its priority.
    pub fn start(
        tick: SYST,
        system: &mut SCB,
        led: Led,
        watchdog: watchdog::Idle,
        start: &Start,
    ) -> Self {
        board::tick::set_priority(system, board::pac::NVIC_PRIO_BITS);
        Mono::start(tick, start.clocks.core);
        Self {
            housekeeping: Housekeeping::new(start),
            watchdog: watchdog.start(WATCHDOG.ticks() as u16),
            led,
            shown: None,
            steps: 0,
        }
    }

    /// Sets what the LED shows from the next step on; `None`: the state of the node.
    pub const fn show(&mut self, level: Option<bool>) {
        self.shown = level;
    }

    /// Time since the start, as the steps count it; stands at its largest value.
    pub const fn uptime(&self) -> MillisDurationU32 {
        let period = design::HOUSEKEEPING_PERIOD.ticks();
        MillisDurationU32::millis(self.steps.saturating_mul(period))
    }

    /// Whether a report on the console is due at this step.
    pub const fn is_report_due(&self) -> bool {
        self.steps.is_multiple_of(REPORT_STEPS)
    }

    /// One step. `work` counts what the node's own tasks have done.
    pub fn step<S: StatusMessage, const WINDOWS: usize, const NODES: usize>(
        &mut self,
        link: &mut impl Mutex<T = BoardLink<WINDOWS, NODES>>,
        bus: &BusView,
        work: u32,
    ) {
        self.steps = self.steps.saturating_add(1);
        let duties = self.housekeeping.step(bus, work);
        if duties.feed {
            self.watchdog.feed();
        }
        self.led.set(self.shown.unwrap_or(duties.led));
        if let Some(status) = duties.report {
            let data = S::of(&status).encode();
            let data = data.as_ref();
            let queued = link.lock(|link| link.queue_event(S::ID, data, design::EVENT_LIFETIME));
            if queued.is_err() {
                self.housekeeping.report_refused();
            }
        }
    }
}

/// The console task: the line about the bus, the node's line, which `show` writes, and the
/// log, in which `own` is told.
pub fn report<const WINDOWS: usize, const NODES: usize>(
    link: &mut impl Mutex<T = BoardLink<WINDOWS, NODES>>,
    console: &mut impl Mutex<T = board::console::Console>,
    log: &mut Log,
    own: &Own,
    show: impl FnOnce(&mut Line),
) {
    let bus = link.lock(|link| BusView::of(link));
    log.pass(&bus, own);
    let mut line = Line::new();
    console::bus(&mut line, &bus);
    console.lock(|console| console.push(line.as_bytes()));
    line.clear();
    show(&mut line);
    console.lock(|console| console.push(line.as_bytes()));
}

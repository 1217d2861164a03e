//! Code that the tasks of every node share and that uses the board: time base, watchdog, LED,
//! console.

use crate::board;
use crate::console::{self, BusView, Line};
use crate::design;
use crate::e2e::Secret;
use crate::event;
use crate::fault;
use crate::housekeeping::{Event, Housekeeping, Start, StatusMessage};
use crate::link::{AnyLink, Identity, Link, Stack, WindowTimer};
use crate::log::{Changes, Own};
use crate::selftest::{self, Motor, Report, ReportMessage, RequestMessage};
use board::clock::Oscillator;
use board::fault::Fault;
use board::led::Led;
use board::selftest::Findings;
use board::watchdog::Watchdog;
use core::future::{Future, pending};
use cortex_m::peripheral::{SCB, SYST};
use fugit::MillisDurationU32;
use network::Message;
use rtic::Mutex;
use rtic_monotonics::TimerQueueBackend;
use rtic_monotonics::systick::SystickBackend;
use ttcan::{ConfigError, Micros, NodeConfig, StampLatency};

/// The time base and its compare channels, as the link uses them.
pub struct Timer {
    clock: board::time::Clock,
    alarms: board::time::Alarms,
}

/// The link of a node on this board, in a network with this many windows and nodes.
pub type BoardLink<const WINDOWS: usize, const NODES: usize> =
    Link<board::CanPort, Timer, WINDOWS, NODES>;

/// The link of a node that sends at once, on this board. See [`event::Link`].
pub type BoardEventLink<const WINDOWS: usize, const PLACES: usize> =
    event::Link<board::CanPort, Timer, WINDOWS, PLACES>;

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
    /// Keeps the node on the bus, and trims its oscillator where it has to. Call this every few
    /// milliseconds.
    pub fn keep(&mut self) {
        if let Some(steps) = self.keep_present() {
            board::clocks::trim(steps);
        }
    }

    /// Interrupt of the time base: loads the mailbox if the window timer fired. True if the
    /// node's second alarm fired.
    pub fn on_timer(&mut self) -> bool {
        let released = self.timer_mut().take_release();
        if self.timer_mut().take_window() {
            self.service();
        }
        released
    }

    /// Sets the node's second alarm to fire in `time`.
    pub fn release_in(&mut self, time: Micros) {
        let ticks = self.ticks(time);
        self.timer_mut().release_in(ticks.cast_signed());
    }

    /// Sets the node's second alarm to the cycle time `time` of the current basic cycle. It
    /// fires at once if that is in the past.
    pub fn release_at(&mut self, time: Micros) {
        if let Some(ticks) = self.until(time) {
            self.timer_mut().release_in(ticks);
        }
    }
}

impl<const WINDOWS: usize, const PLACES: usize> BoardEventLink<WINDOWS, PLACES> {
    /// Keeps the node on the bus. Call this every few milliseconds.
    pub fn keep(&mut self) {
        self.keep_present();
        self.tidy();
    }

    /// Interrupt of the time base: supervises the bus if the window timer fired. True if the
    /// node's second alarm fired.
    pub fn on_timer(&mut self) -> bool {
        let released = self.timer_mut().take_release();
        if self.timer_mut().take_window() {
            self.service();
        }
        released
    }

    /// Sets the node's second alarm to fire in `time`.
    pub fn release_in(&mut self, time: Micros) {
        let ticks = self.ticks(time);
        self.timer_mut().release_in(ticks.cast_signed());
    }

    /// Does nothing: there is no cycle time. A call for the schedule compiles, and never comes,
    /// as no reference begins a basic cycle.
    pub const fn release_at(&mut self, _: Micros) {}
}

impl Timer {
    /// Acknowledges the window timer; true if it had fired.
    #[inline]
    pub fn take_window(&mut self) -> bool {
        self.alarms.take_window()
    }

    /// Sets the node's second alarm to `ticks` from now; it fires at once if that is negative.
    #[inline]
    pub fn release_in(&mut self, ticks: i32) {
        let instant = self.clock.now().wrapping_add_signed(ticks);
        self.alarms.set_release(instant);
    }

    /// Acknowledges the second alarm; true if it had fired.
    #[inline]
    pub fn take_release(&mut self) -> bool {
        self.alarms.take_release()
    }
}

/// A vehicle's way to use the bus, named by what its link keeps in static memory: the protocol
/// stack of the schedule ([`Stack`]), or the queue of a node that sends at once
/// ([`event::Stack`]).
pub trait Protocol: Sized {
    /// Which node of which network an image is.
    type Identity;
    /// The link of a node on this board.
    type Link;
    /// See [`link`].
    ///
    /// # Errors
    /// The protocol stack refuses the configuration.
    fn link(
        place: &'static mut Option<Self>,
        identity: Self::Identity,
        start: &Start,
        can: board::CanPort,
        timer: Timer,
    ) -> Result<Self::Link, ConfigError>;
}

impl<const WINDOWS: usize, const NODES: usize> Protocol for Stack<WINDOWS, NODES> {
    type Identity = Identity;
    type Link = BoardLink<WINDOWS, NODES>;

    fn link(
        place: &'static mut Option<Self>,
        identity: Identity,
        start: &Start,
        can: board::CanPort,
        timer: Timer,
    ) -> Result<Self::Link, ConfigError> {
        let clocks = start.clocks;
        let bit = 1_000_000 * clocks.ticks_per_us / identity.bit_rate;
        let config = NodeConfig {
            latency: StampLatency::bxcan(bit, board::FACTS.stamp_ticks),
            transmit_lead: board::FACTS.transmit_lead_ticks,
            drift_limit_ppm: match clocks.oscillator {
                Oscillator::External => design::DRIFT_LIMIT_PPM,
                Oscillator::Internal => design::DRIFT_LIMIT_PPM_INTERNAL,
            },
            // A master on its RC oscillator would lead the others at a pace that none of them has
            // measured. So the next master in rank leads, and this node keeps its windows.
            may_lead: clocks.oscillator == Oscillator::External || start.is_last_resort(),
            ..NodeConfig::new(identity.node, clocks.ticks_per_us)
        };
        let Identity {
            schedule,
            rule,
            free,
            awaited,
            ..
        } = identity;
        let mut link = Link::new(place, schedule, config, clocks.oscillator, rule, can, timer)?;
        link.wait_for(awaited);
        link.prove_time(start.secret, free);
        if let (Secret::Key(_), Some(time)) = (start.secret, board::kept::take()) {
            link.resume(time);
        }
        Ok(link)
    }
}

impl<const WINDOWS: usize, const PLACES: usize> Protocol for event::Stack<WINDOWS, PLACES> {
    type Identity = event::Identity<WINDOWS>;
    type Link = BoardEventLink<WINDOWS, PLACES>;

    fn link(
        place: &'static mut Option<Self>,
        identity: Self::Identity,
        start: &Start,
        can: board::CanPort,
        timer: Timer,
    ) -> Result<Self::Link, ConfigError> {
        let Start { clocks, .. } = *start;
        let per_us = clocks.ticks_per_us;
        let link = event::Link::new(place, identity, clocks.oscillator, per_us, can, timer);
        Ok(link)
    }
}

/// Makes the link of a node, with its protocol stack in `place`. It is silent until
/// [`Link::start`].
///
/// # Errors
/// The protocol stack refuses the configuration.
pub fn link<S: Protocol>(
    place: &'static mut Option<S>,
    identity: S::Identity,
    start: &Start,
    can: board::CanPort,
    clock: board::time::Clock,
    alarms: board::time::Alarms,
) -> Result<S::Link, ConfigError> {
    S::link(place, identity, start, can, Timer { clock, alarms })
}

/// Starts the board for a bus of this bit rate, bit/s. Does not return if that fails: the node records why, and starts again.
pub fn start<const BIT_RATE: u32>(device: board::pac::Peripherals) -> board::Sled {
    const {
        assert!(
            crate::link::TOLERANCE_PPM <= board::Timings::<BIT_RATE>::TOLERANCE_PPM,
            "the bit timing allows what the link does"
        );
    }
    match board::Sled::start::<BIT_RATE>(device, WATCHDOG.ticks() as u16) {
        Ok(sled) => sled,
        Err(reason) => fault::stop(reason),
    }
}

/// Writes changes of the node's state to the log of a debug probe. Only the task of the lowest
/// priority may use it. Without a probe, or with a slow one, the line is dropped and no task
/// waits.
pub struct Log {
    changes: Changes,
    test: selftest::Repeat,
}

impl Log {
    /// A log that begins with the node's start.
    pub fn new(start: &Start) -> Self {
        Self {
            changes: Changes::new(start),
            test: selftest::Repeat::new(),
        }
    }

    /// Writes one line at most.
    fn pass(&mut self, bus: &BusView, own: &Own, test: Option<&Report>) {
        if let Some(entry) = self.changes.next(bus, own, test) {
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

/// Bytes of the stack that must stay unused: an eighth of it.
const STACK_RESERVE: u16 = (board::FACTS.stack.size / 8) as u16;

/// Ticks in a second: one for each step of the housekeeping.
pub const TICKS: u32 = 1000 / design::HOUSEKEEPING_PERIOD.ticks();

const _: () = assert!(
    1000u32.is_multiple_of(design::HOUSEKEEPING_PERIOD.ticks()),
    "a step is a tick"
);

/// The tick of an image's software tasks: see [`tick!`](crate::tick).
pub trait Tick {
    /// Starts SysTick, which counts at `core_hz`.
    fn start(tick: SYST, core_hz: u32);
}

/// Starts the tick of the software tasks: SysTick, from the core clock. `system` sets its priority.
fn start_tick<T: Tick>(tick: SYST, system: &mut SCB, oscillator: Oscillator) {
    board::tick::set_priority(system, board::pac::NVIC_PRIO_BITS);
    // Constants, so that the timer's check of its rate is done at build time.
    T::start(
        tick,
        match oscillator {
            Oscillator::External => board::FACTS.external.core,
            Oscillator::Internal => board::FACTS.internal.core,
        },
    );
}

/// The wake-up times of a software task, one at each tick.
pub struct Pace {
    /// In ticks, which wrap.
    due: u32,
}

impl Pace {
    /// A pace that begins now.
    pub fn begin() -> Self {
        Self {
            due: SystickBackend::now(),
        }
    }

    /// Waits until a tick after the last wake-up time, however long the work took. Wake-up
    /// times that have passed already are skipped.
    pub fn wait(&mut self) -> impl Future + use<> {
        let now = SystickBackend::now();
        self.due = self.due.wrapping_add(1);
        if self.due.wrapping_sub(now).cast_signed() <= 0 {
            self.due = now.wrapping_add(1);
        }
        // This is the way to wait that cannot panic. `delay_until` of a monotonic is an `async fn`:
        // polling it after its end panics, and it asserts that the timer was started.
        let queue = SystickBackend::timer_queue();
        queue.timeout_at(self.due, pending::<()>())
    }
}

/// What the housekeeping task owns: watchdog and LED.
pub struct Keeper {
    housekeeping: Housekeeping,
    stack: board::stack::Gauge,
    watchdog: Watchdog,
    led: Led,
    shown: Option<bool>,
    steps: u32,
}

impl Keeper {
    /// Starts watchdog and tick. The board has these `findings`.
    pub fn start<T: Tick>(
        tick: SYST,
        system: &mut SCB,
        led: Led,
        mut watchdog: Watchdog,
        start: &Start,
        findings: &Findings,
    ) -> Self {
        // Start-up is over, and with it all that it waited for.
        board::fault::passed();
        watchdog.feed();
        start_tick::<T>(tick, system, start.clocks.oscillator);
        Self {
            housekeeping: Housekeeping::new(start, findings),
            stack: board::stack::Gauge::begin(),
            watchdog,
            led,
            shown: None,
            steps: 0,
        }
    }

    /// Sets the LED's level from the next step on; with `None` it shows the state of the node.
    pub const fn show(&mut self, level: Option<bool>) {
        self.shown = level;
    }

    /// Time since the start, counted in steps; saturates.
    pub const fn uptime(&self) -> MillisDurationU32 {
        let period = design::HOUSEKEEPING_PERIOD.ticks();
        MillisDurationU32::millis(self.steps.saturating_mul(period))
    }

    /// Whether a report on the console is due at this step.
    pub const fn is_report_due(&self) -> bool {
        self.steps.is_multiple_of(REPORT_STEPS)
    }

    /// Whether the node may turn a motor: see [`Report::is_fit`].
    pub const fn is_fit(&self) -> bool {
        self.housekeeping.is_fit()
    }

    /// The self-test after the last step.
    pub fn last_test(&self) -> Option<Report> {
        self.housekeeping.last_test().copied()
    }

    /// One step. `work` counts what the node's own tasks have done. While `motor` stands still, the
    /// node may start again without harm.
    ///
    /// A node on its RC oscillator starts again when its external clock has come, or to lead as
    /// the last resort; one without a key does when a program on the bus asks for the whole self-test.
    pub fn step<S: StatusMessage>(
        &mut self,
        link: &mut impl Mutex<T: AnyLink>,
        bus: &BusView,
        work: u32,
        motor: Motor,
    ) {
        self.steps = self.steps.saturating_add(1);
        // Between two sections, because the interrupts of the bus must not wait for a tag.
        if let Some(open) = link.lock(|link| link.open()) {
            let answer = open.answer();
            link.lock(|link| link.close(answer));
            if let Some(time) = open.latest() {
                board::kept::put(time);
            }
        }
        let ready = self.housekeeping.wants_clock() && board::clocks::external_is_ready();
        if let Some(reason) = self.housekeeping.restart(bus, ready, motor.still) {
            fault::stop(reason);
        }
        let (received, unsent) = link.lock(|link| {
            let unsent = if link.has_event(S::ID) {
                Some(Event::Status)
            } else {
                link.has_event(<S::Report as Message>::ID)
                    .then_some(Event::SelfTest)
            };
            (link.take_event(), unsent)
        });
        self.housekeeping.note_unsent(unsent);
        let request = received.and_then(|frame| S::Request::decode(frame.data()).ok()?.request());
        if let Some(request) = request
            && self.housekeeping.ask(&request, motor.still)
        {
            fault::stop(Fault::SelfTest);
        }
        let test = self
            .housekeeping
            .test(bus, motor, STACK_RESERVE, self.stack.step());
        let duties = self.housekeeping.step(bus, work);
        if duties.feed {
            self.watchdog.feed();
        }
        // The code of a failed check comes first.
        let shown = self.shown.filter(|_| self.is_fit());
        self.led.set(shown.unwrap_or(duties.led));
        // At most one of the two is due.
        let event = match (test, duties.report) {
            (Some(report), _) => Some(encoded(&S::Report::of(&report))),
            (None, Some(status)) => Some(encoded(&S::of(&status))),
            (None, None) => None,
        };
        let Some((id, data)) = event else {
            return;
        };
        let queued = link.lock(|link| match unsent {
            None => link.queue_event(id, &data, design::EVENT_LIFETIME),
            // Once that has been sent, the next one must keep its distance.
            Some(_) => link.replace_event(id, &data, design::EVENT_LIFETIME),
        });
        if queued.is_err() {
            match test {
                Some(report) => self.housekeeping.test_refused(report.round),
                None => self.housekeeping.report_refused(),
            }
        }
    }
}

/// Identifier and data of an event message.
fn encoded<M: Message>(message: &M) -> (u16, heapless::Vec<u8, 8>) {
    let bytes = message.encode();
    // No message has more bytes.
    (
        M::ID,
        heapless::Vec::from_slice(bytes.as_ref()).unwrap_or_default(),
    )
}

/// What a node with a motor tells its self-test. A node that is not fit lets go of its motor.
#[cfg(feature = "f303")]
pub fn motor(output: &mut impl Mutex<T = board::motor::MotorOutput>, keeper: &Keeper) -> Motor {
    output.lock(|output| {
        if !keeper.is_fit() {
            output.bar();
        }
        Motor {
            still: output.is_open(),
            opens: output.watch(),
        }
    })
}

/// The console task: writes the line about the bus and the node's own line, which `show`
/// composes, and logs changes of the bus, of `own` and of the self-test. A line about the self-test
/// takes the place of the node's own.
pub fn report(
    link: &mut impl Mutex<T: AnyLink>,
    console: &mut impl Mutex<T = board::console::Console>,
    log: &mut Log,
    own: &Own,
    test: Option<Report>,
    show: impl FnOnce(&mut Line),
) {
    let bus = link.lock(|link| BusView::of(link));
    log.pass(&bus, own, test.as_ref());
    let mut line = Line::new();
    console::bus(&mut line, &bus);
    console.lock(|console| console.push(line.as_bytes()));
    line.clear();
    match test.filter(|report| log.test.is_due(report)) {
        Some(report) => selftest::show(&mut line, &report),
        None => show(&mut line),
    }
    console.lock(|console| console.push(line.as_bytes()));
}

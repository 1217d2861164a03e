//! The gps node: time master of the bus, and sender of the satellite receiver's measurements.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 begins the schedule |
//! | `ring` | DMA2 stream 2 | 5 | takes the receiver's bytes, some at a time |
//! | `look` | TIM4 | 5 | 5 kHz: notices the end of a burst |
//! | `console_dma` | DMA1 stream 6 | 4 | next console line |
//! | `SysTick` | SysTick | 4 | 100 Hz: the tick of `rtic-monotonics`, wakes `housekeeping` |
//! | `housekeeping` | software, by EXTI2 | 3 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `parse` | EXTI4, pended by software | 2 | reads the bytes that were taken, some at a time |
//! | `console` | EXTI3, pended by software | 1 | 10 Hz lines |

#![no_std]
#![no_main]

use defmt_rtt as _;

firmware::tick!();

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2])]
mod app {
    use super::Mono;
    use firmware::board::fault::Fault;
    use firmware::board::{self, pac::Interrupt, receiver::Receiver, time::Clock};
    use firmware::console::{self as lines, BusView};
    use firmware::e2e::Secret;
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::navigation::{Pause, Station, Step, trim};
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::selftest::{Motor, Report};
    use firmware::{design, fault};
    use rtic::Mutex as _;
    use ttcan::{Micros, Stamp};
    use uagv::design::{RECEIVER_LEAD, RECEIVER_PERIOD};
    use uagv::matrix::{BASIC_CYCLE, GPS, window};
    use uagv::messages::{Command, GpsStatus};
    #[cfg(tilt)]
    use uagv::tilt;
    use uagv::{Link, Stack, identity, wire};

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        receiver: Receiver,
        station: Station,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
    }

    #[local]
    struct Local {
        keeper: Keeper,
        log: Log,
    }

    #[init(local = [stack: Option<Stack> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let sled = uagv::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let Ok(link) = node::link(
            cx.local.stack,
            identity(GPS),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        let Some(receiver) = sled.rest.receiver() else {
            fault::stop(Fault::Start)
        };
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                receiver,
                station: Station::new(),
                console: sled.console,
                test: None,
            },
            Local {
                keeper: Keeper::start::<Mono>(
                    cx.core.SYST,
                    &mut cx.core.SCB,
                    sled.led,
                    sled.watchdog,
                    &start,
                    &sled.findings,
                ),
                log: Log::new(&start),
            },
        )
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            rtic::export::wfi();
        }
    }

    #[task(binds = CAN1_RX0, priority = 6, shared = [&clock, link])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| link.on_receive(stamp));
    }

    #[task(binds = CAN1_TX, priority = 6, shared = [&clock, link])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| link.on_transmit(stamp));
    }

    #[task(binds = CAN1_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
    }

    #[task(binds = TIM2, priority = 6, shared = [link])]
    fn window_timer(mut cx: window_timer::Context) {
        cx.shared.link.lock(|link| {
            if link.on_timer() && !link.is_started() {
                link.start();
            }
        });
    }

    #[task(binds = DMA2_STREAM2, priority = 5, shared = [receiver, station])]
    fn ring(cx: ring::Context) {
        (cx.shared.receiver, cx.shared.station).lock(|receiver, station| {
            receiver.acknowledge_dma();
            // If there may be more bytes, this task runs again; otherwise `parse` reads what was
            // taken.
            if station.take(receiver.arrived()) {
                rtic::pend(Interrupt::DMA2_STREAM2);
            } else {
                rtic::pend(Interrupt::EXTI4);
            }
        });
    }

    #[task(binds = TIM4, priority = 5, shared = [&clock, receiver, station])]
    fn look(cx: look::Context) {
        let now = cx.shared.clock.now();
        (cx.shared.receiver, cx.shared.station).lock(|receiver, station| {
            if let Some(since) = receiver.look(now) {
                station.pause(since);
                rtic::pend(Interrupt::DMA2_STREAM2);
            }
        });
    }

    #[task(binds = EXTI4, priority = 2, shared = [&clock, link, station])]
    fn parse(mut cx: parse::Context) {
        let now = cx.shared.clock.now();
        let mut link = cx.shared.link;
        #[cfg(not(tilt))]
        let step = cx.shared.station.lock(|station| {
            station.step(now, |update| {
                let (window, data) = wire::update(update);
                link.lock(|link| link.replace(window, data));
            })
        });
        #[cfg(tilt)]
        let step = {
            let mut news = tilt::News::default();
            let step = cx.shared.station.lock(|station| {
                let put = |update| {
                    let (window, data) = wire::update(update);
                    link.lock(|link| link.replace(window, data));
                };
                station.step_showing(now, put, |frame| news.see(frame))
            });
            if let Some(data) = news.data() {
                link.lock(|link| link.replace(window::TILT, data));
            }
            step
        };
        match step {
            Step::More => rtic::pend(Interrupt::EXTI4),
            Step::Drained => {}
            Step::Paused(pause) => link.lock(|link| settle(link, &pause)),
        }
    }

    /// Applies the results of a burst at its end: fix flag, cycle length, start of the schedule.
    fn settle(link: &mut Link, pause: &Pause) {
        link.set_reference_byte(u8::from(pause.fixed));
        // The schedule begins such that the windows follow the receiver's bursts closely.
        // Trimming the cycle length keeps it so, although the two clocks drift apart.
        if pause.is_new_epoch
            && let Some(age) = link.node().cycle_time(Stamp(pause.since))
        {
            // The stack refuses this while another node is the master.
            let _ = link
                .node_mut()
                .trim_cycle(trim(age, BASIC_CYCLE, RECEIVER_LEAD));
        }
        if let Some(tow) = pause.tow
            && !link.is_started()
        {
            link.set_time(Stamp(pause.since), tow);
            link.release_in(RECEIVER_LEAD);
        }
    }

    #[task(binds = DMA1_STREAM6, priority = 4, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(
        priority = 3,
        shared = [&clock, link, station, test],
        local = [keeper, moving: bool = false]
    )]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            keep(&mut cx.shared, cx.local.keeper, cx.local.moving);
            pace.wait().await;
        }
    }

    /// A step of the housekeeping.
    fn keep(
        shared: &mut housekeeping::SharedResources<'_>,
        keeper: &mut Keeper,
        moving: &mut bool,
    ) {
        let clock = shared.clock;
        let timeout = shared
            .link
            .lock(|link| link.ticks(design::receiver_timeout(RECEIVER_PERIOD)));
        let silent = shared
            .station
            .lock(|station| station.navigation_mut().lapse(clock.now(), timeout));
        // Several sections, because each blocks the interrupts of the bus.
        shared.link.lock(|link| {
            link.keep();
            if silent {
                link.set_reference_byte(0);
            }
            // Manual driving needs no receiver (thesis 5.3), so the schedule begins without
            // one.
            if !link.is_started() && keeper.uptime() >= design::receiver_patience(RECEIVER_PERIOD) {
                link.start();
            }
        });
        let command = shared
            .link
            .lock(|link| link.message::<Command>(window::COMMAND));
        let bus = shared.link.lock(|link| BusView::of(link));
        // No motor turns by this node's hand, but without it every motor stops.
        if let Some(command) = command {
            *moving = command.steering_enabled || command.drive_enabled;
        }
        let still = !*moving;
        keeper.step::<GpsStatus>(
            &mut shared.link,
            &bus,
            bus.link.services,
            Motor::none(still),
        );
        shared.test.lock(|test| *test = keeper.last_test());
        if keeper.is_report_due() {
            rtic::pend(Interrupt::EXTI3);
        }
    }

    #[task(binds = EXTI3, priority = 1, shared = [&clock, link, station, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let now = cx.shared.clock.now();
        let millisecond = Micros::millis(1);
        let ticks_per_ms = cx.shared.link.lock(|link| link.ticks(millisecond));
        let (navigation, counters) = cx
            .shared
            .station
            .lock(|station| (*station.navigation(), station.counters()));
        let age = navigation
            .age(now)
            .and_then(|ticks| ticks.checked_div(ticks_per_ms));
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::from(&navigation),
            test,
            |line| lines::receiver(line, &navigation, age, counters),
        );
    }
}

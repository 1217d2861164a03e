//! The rows node: finds the place between the rows of a crop by two distance sensors and sends it in
//! message 207. It is on the bus only while `row_guidance.enabled` of the manifest is true.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 releases `offset` |
//! | `offset` | EXTI1, pended by software | 5 | once in each basic cycle: message 207 |
//! | `burst` | DMA1 channel 1 | 5 | 200 Hz, the end of a burst of samples: moves the estimate |
//! | `correct` | EXTI4, pended by software | 5 | the rest of that: corrects the estimate |
//! | `console_dma` | DMA1 channel 7 | 3 | next console line |
//! | `SysTick` | SysTick | 3 | 100 Hz: the tick of `rtic-monotonics`, wakes `housekeeping` |
//! | `housekeeping` | software, by EXTI2 | 2 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `console` | EXTI3, pended by software | 1 | 10 Hz lines |

#![no_std]
#![no_main]

use defmt_rtt as _;

firmware::tick!();

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2_TSC])]
mod app {
    use super::Mono;
    use control::takeover::Presence;
    use firmware::board::distances::{BURST_HZ, Distances, Trigger};
    use firmware::board::fault::Fault;
    use firmware::board::{self, pac::Interrupt, time::Clock};
    use firmware::console::BusView;
    use firmware::convert::rounded;
    use firmware::e2e::{self, Secret};
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::rows::{self, Watcher};
    use firmware::selftest::{Motor, Report};
    use rtic::Mutex as _;
    use uagv::design::{ROW_RELEASE, ROW_WATCH, WHEELBASE};
    use uagv::matrix::{ROWS, window};
    use uagv::messages::RowsStatus;
    use uagv::rows::{motion, offset as message};
    use uagv::session::{self, Session};
    use uagv::{Link, Stack, identity};

    /// Time between two bursts, s.
    const PERIOD: f32 = 1.0 / BURST_HZ as f32;

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
        distances: Distances,
        watcher: &'static mut Watcher,
        /// Bursts that gave no distances; wraps.
        failed: u16,
        /// A session in which `offset` does not seal yet.
        news: session::News,
    }

    #[local]
    struct Local {
        sender: e2e::Sender,
        keeper: Keeper,
        log: Log,
        session: Session,
    }

    #[init(local = [stack: Option<Stack> = None, place: Option<Watcher> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let sled = uagv::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(ROWS),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        let Some(distances) = sled.rest.distances(Trigger::Timer) else {
            fault::stop(Fault::Start)
        };
        let watcher = cx.local.place.insert(Watcher::new(ROW_WATCH, WHEELBASE));
        let session = Session::of_sender(start.secret);
        link.start();
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                console: sled.console,
                test: None,
                distances,
                watcher,
                failed: 0,
                news: Some(session.secret()),
            },
            Local {
                sender: e2e::Sender::new(start.secret),
                keeper: Keeper::start::<Mono>(
                    cx.core.SYST,
                    &mut cx.core.SCB,
                    sled.led,
                    sled.watchdog,
                    &start,
                    &sled.findings,
                ),
                log: Log::new(&start),
                session,
            },
        )
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            rtic::export::wfi();
        }
    }

    #[task(binds = USB_LP_CAN_RX0, priority = 6, shared = [&clock, link])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| {
            if link.on_receive(stamp).reference {
                link.release_at(ROW_RELEASE);
            }
        });
    }

    #[task(binds = USB_HP_CAN_TX, priority = 6, shared = [&clock, link])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| link.on_transmit(stamp));
    }

    #[task(binds = CAN_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
    }

    #[task(binds = TIM2, priority = 6, shared = [link])]
    fn window_timer(mut cx: window_timer::Context) {
        if cx.shared.link.lock(|link| link.on_timer()) {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    /// Deadline: the beginning of the message's window.
    #[task(binds = EXTI1, priority = 5, shared = [link, watcher, news], local = [sender])]
    fn offset(cx: offset::Context) {
        let (mut link, mut watcher) = (cx.shared.link, cx.shared.watcher);
        let sighting = watcher.lock(|watcher| watcher.report());
        let (time, believed) = link.lock(|link| (link.cycle_began(), link.is_time_believed()));
        let sender = cx.local.sender;
        let mut news = cx.shared.news;
        news.lock(|news| session::change(sender, news));
        let data = message(&sighting, sender, time);
        let data = (believed && session::can_seal(sender)).then_some(data);
        link.lock(|link| link.replace(window::ROW_OFFSET, data));
    }

    #[task(binds = DMA1_CH1, priority = 5, shared = [link, distances, watcher, failed])]
    fn burst(cx: burst::Context) {
        let (mut distances, mut failed) = (cx.shared.distances, cx.shared.failed);
        let (mut link, mut watcher) = (cx.shared.link, cx.shared.watcher);
        let Ok(means) = distances.lock(Distances::take) else {
            failed.lock(|failed| *failed = failed.wrapping_add(1));
            return;
        };
        let motion = link.lock(motion);
        let measured = rows::distances(&means);
        watcher.lock(|watcher| watcher.observe(&measured, motion, PERIOD));
        rtic::pend(Interrupt::EXTI4);
    }

    /// Runs behind `burst`, and is over long before the next one.
    #[task(binds = EXTI4, priority = 5, shared = [watcher])]
    fn correct(mut cx: correct::Context) {
        cx.shared.watcher.lock(|watcher| watcher.correct());
    }

    #[task(binds = DMA1_CH7, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(priority = 2, shared = [link, test, distances, failed, news], local = [keeper, session])]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            keep(&mut cx.shared, cx.local.keeper, cx.local.session);
            pace.wait().await;
        }
    }

    /// A step of the housekeeping.
    fn keep(
        shared: &mut housekeeping::SharedResources<'_>,
        keeper: &mut Keeper,
        session: &mut Session,
    ) {
        // Two sections, because each blocks the interrupts of the bus.
        shared.link.lock(|link| link.keep());
        if shared.link.lock(|link| session.step(link)) {
            let secret = session.secret();
            shared.news.lock(|news| *news = Some(secret));
        }
        let bus = shared.link.lock(|link| BusView::of(link));
        // A burst that does not end is given up.
        if shared.distances.lock(Distances::watch).is_err() {
            let failed = &mut shared.failed;
            failed.lock(|failed| *failed = failed.wrapping_add(1));
        }
        // No motor turns by this node's hand.
        keeper.step::<RowsStatus>(&mut shared.link, &bus, bus.link.services, Motor::none(true));
        shared.test.lock(|test| *test = keeper.last_test());
        if keeper.is_report_due() {
            rtic::pend(Interrupt::EXTI3);
        }
    }

    #[task(binds = EXTI3, priority = 1, shared = [link, watcher, failed, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let sighting = cx.shared.watcher.lock(|watcher| watcher.sighting());
        let failed = cx.shared.failed.lock(|failed| *failed);
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::default(),
            test,
            |line| {
                line.str("rows ").str(match sighting.presence {
                    Presence::Searching => "searching",
                    Presence::Following => "following",
                    Presence::End => "end",
                    Presence::Faulty => "faulty",
                });
                // In millimetres.
                line.str(" offset ")
                    .fixed(rounded(sighting.pose.offset * 1000.0), 0)
                    .str(" failed ")
                    .unsigned(u32::from(failed))
                    .str("\r\n");
            },
        );
    }
}

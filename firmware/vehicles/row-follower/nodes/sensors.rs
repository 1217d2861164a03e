//! The sensors' node, time master: measures the distances to both rows in each basic cycle and sends
//! them in messages 200 and 201.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 releases `sample` |
//! | `sample` | EXTI1, pended by software | 5 | begins a burst of samples |
//! | `burst` | DMA1 channel 1 | 5 | the end of the burst: messages 200 and 201 |
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
    use control::row::Sides;
    use firmware::board::distances::{Distances, Trigger};
    use firmware::board::fault::Fault;
    use firmware::board::{self, pac::Interrupt, time::Clock};
    use firmware::console::BusView;
    use firmware::e2e::Secret;
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::link::padded;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::rows::{self, LARGEST_DISTANCE};
    use firmware::selftest::{Motor, Report};
    use network::Message as _;
    use row_follower::matrix::{SENSORS, window};
    use row_follower::messages::{DistanceLeft, DistanceRight, SensorsStatus};
    use row_follower::{EVENT_TRIGGERED, Link, SAMPLE, Stack, identity};
    use rtic::Mutex as _;

    /// Without a schedule there is no mark for the bursts: the timer of the converter begins them.
    const TRIGGER: Trigger = if EVENT_TRIGGERED {
        Trigger::Timer
    } else {
        Trigger::Software
    };

    /// What the console shows of the sensors.
    #[derive(Clone, Copy)]
    pub struct Seen {
        distances: Sides<u8>,
        failed: u16,
    }

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
        distances: Distances,
        /// Last distances, and bursts that gave none; wraps.
        seen: Seen,
    }

    #[local]
    struct Local {
        keeper: Keeper,
        log: Log,
    }

    #[init(local = [stack: Option<Stack> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let sled = row_follower::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(SENSORS),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        let Some(distances) = sled.rest.distances(TRIGGER) else {
            fault::stop(Fault::Start)
        };
        link.start();
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                console: sled.console,
                test: None,
                distances,
                seen: Seen {
                    distances: Sides {
                        left: LARGEST_DISTANCE,
                        right: LARGEST_DISTANCE,
                    },
                    failed: 0,
                },
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

    #[task(binds = USB_LP_CAN_RX0, priority = 6, shared = [&clock, link])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| link.on_receive(stamp));
    }

    #[task(binds = USB_HP_CAN_TX, priority = 6, shared = [&clock, link])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| {
            if link.on_transmit(stamp) {
                link.release_at(SAMPLE);
            }
        });
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

    /// A burst that has not ended by now is given up; its distances are missing on the bus.
    #[task(binds = EXTI1, priority = 5, shared = [distances, seen])]
    fn sample(cx: sample::Context) {
        // Without a schedule there is no mark.
        if EVENT_TRIGGERED {
            return;
        }
        let (mut distances, mut seen) = (cx.shared.distances, cx.shared.seen);
        if distances.lock(|distances| distances.begin()).is_err() {
            seen.lock(|seen| seen.failed = seen.failed.wrapping_add(1));
        }
    }

    /// Deadline: the beginning of the first window.
    #[task(binds = DMA1_CH1, priority = 5, shared = [link, distances, seen])]
    fn burst(cx: burst::Context) {
        let (mut distances, mut seen) = (cx.shared.distances, cx.shared.seen);
        let mut link = cx.shared.link;
        let Ok(means) = distances.lock(Distances::take) else {
            seen.lock(|seen| seen.failed = seen.failed.wrapping_add(1));
            return;
        };
        let measured = rows::distances(&means);
        let left = DistanceLeft {
            distance: measured.left,
        };
        let right = DistanceRight {
            distance: measured.right,
        };
        let (left, right) = (padded(left.encode()), padded(right.encode()));
        // Each in a lock of its own, so that the bus waits for one of them at most.
        link.lock(|link| link.put(window::DISTANCE_LEFT, left));
        link.lock(|link| link.put(window::DISTANCE_RIGHT, right));
        seen.lock(|seen| seen.distances = measured);
    }

    #[task(binds = DMA1_CH7, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(priority = 2, shared = [link, test, distances, seen], local = [keeper])]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            keep(&mut cx.shared, cx.local.keeper);
            pace.wait().await;
        }
    }

    /// A step of the housekeeping.
    fn keep(shared: &mut housekeeping::SharedResources<'_>, keeper: &mut Keeper) {
        // Two sections, because each blocks the interrupts of the bus.
        shared.link.lock(|link| link.keep());
        let bus = shared.link.lock(|link| BusView::of(link));
        // A burst that the timer began, and that does not end, is given up.
        if EVENT_TRIGGERED && shared.distances.lock(Distances::watch).is_err() {
            let seen = &mut shared.seen;
            seen.lock(|seen| seen.failed = seen.failed.wrapping_add(1));
        }
        // No motor turns by this node's hand. Without it they stop.
        keeper.step::<SensorsStatus>(&mut shared.link, &bus, bus.link.services, Motor::none(true));
        shared.test.lock(|test| *test = keeper.last_test());
        if keeper.is_report_due() {
            rtic::pend(Interrupt::EXTI3);
        }
    }

    #[task(binds = EXTI3, priority = 1, shared = [link, seen, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let seen = cx.shared.seen.lock(|seen| *seen);
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::default(),
            test,
            |line| {
                line.str("sensors left ")
                    .unsigned(u32::from(seen.distances.left))
                    .str(" right ")
                    .unsigned(u32::from(seen.distances.right))
                    .str(" failed ")
                    .unsigned(u32::from(seen.failed))
                    .str("\r\n");
            },
        );
    }
}

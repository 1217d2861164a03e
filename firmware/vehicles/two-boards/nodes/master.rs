//! The master: begins the basic cycles and makes a command of the knob's position.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 releases `control` |
//! | `control` | EXTI1, pended by software | 5 | one step for each basic cycle: message 300 |
//! | `console_dma` | DMA1 stream 6 | 3 | next console line |
//! | `SysTick` | SysTick | 3 | 100 Hz: the tick of `rtic-monotonics`, wakes `housekeeping` |
//! | `housekeeping` | software, by EXTI2 | 2 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `console` | EXTI3, pended by software | 1 | 10 Hz lines |

#![no_std]
#![no_main]

use defmt_rtt as _;

firmware::tick!();

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2])]
mod app {
    use super::Mono;
    use firmware::board::fault::Fault;
    use firmware::board::{self, pac::Interrupt, time::Clock};
    use firmware::console::BusView;
    use firmware::e2e::{self, Secret};
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::selftest::{Motor, Report};
    use rtic::Mutex as _;
    use two_boards::matrix::{MASTER, release, window};
    use two_boards::messages::{Knob, MasterStatus};
    use two_boards::{Link, Stack, identity};

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
        /// Last position of the knob, and the number of commands sent, which wraps.
        knob: (u16, u32),
    }

    #[local]
    struct Local {
        sender: e2e::Sender,
        keeper: Keeper,
        log: Log,
    }

    #[init(local = [stack: Option<Stack> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let sled = two_boards::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(MASTER),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
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
                knob: (0, 0),
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
        let news = cx.shared.link.lock(|link| link.on_receive(stamp));
        // Without a schedule the message itself releases the step.
        if two_boards::EVENT_TRIGGERED && news.has(window::KNOB) {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = CAN1_TX, priority = 6, shared = [&clock, link])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| {
            if link.on_transmit(stamp) {
                link.release_at(release::COMMAND);
            }
        });
    }

    #[task(binds = CAN1_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
    }

    #[task(binds = TIM2, priority = 6, shared = [link])]
    fn window_timer(mut cx: window_timer::Context) {
        if cx.shared.link.lock(|link| link.on_timer()) {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    /// Deadline: the beginning of the command's window. Without a position of the knob no
    /// command is sent, and the motor stops after two missing commands.
    #[task(binds = EXTI1, priority = 5, shared = [link, knob], local = [sender])]
    fn control(cx: control::Context) {
        let mut link = cx.shared.link;
        let mut knob = cx.shared.knob;
        let (message, time, believed) = link.lock(|link| {
            let message = link.message::<Knob>(window::KNOB);
            (message, link.cycle_began(), link.is_time_believed())
        });
        let Some(Knob { count }) = message else {
            return;
        };
        let data = two_boards::command(count.0, cx.local.sender, time);
        if believed {
            link.lock(|link| link.put(window::COMMAND, data));
        }
        knob.lock(|knob| *knob = (count.0, knob.1.wrapping_add(1)));
    }

    #[task(binds = DMA1_STREAM6, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(priority = 2, shared = [link, knob, test], local = [keeper])]
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
        // No motor turns by this node's hand, but without it the motor stops.
        let (knob, _) = shared.knob.lock(|knob| *knob);
        let still = two_boards::is_stop(knob);
        keeper.step::<MasterStatus>(
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

    #[task(binds = EXTI3, priority = 1, shared = [link, knob, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let (knob, commands) = cx.shared.knob.lock(|knob| *knob);
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::default(),
            test,
            |line| {
                line.str("master knob ").unsigned(u32::from(knob));
                line.str(" commands ").unsigned(commands).str("\r\n");
            },
        );
    }
}

//! The feedback node: makes a command of the distances and of the remote control's lines.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome, releases `correct` |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 releases `control` |
//! | `control` | EXTI1, pended by software | 5 | one step for each basic cycle: messages 300 and 400 |
//! | `correct` | EXTI4, pended by software | 5 | the rest of the step: corrects the estimate |
//! | `console_dma` | DMA1 channel 7 | 3 | next console line |
//! | `SysTick` | SysTick | 3 | 100 Hz: the tick of `rtic-monotonics`, wakes `housekeeping` |
//! | `housekeeping` | software, by EXTI2 | 2 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `console` | EXTI3, pended by software | 1 | 10 Hz lines |
//!
//! The thesis computes the command in the receive interrupt itself (2.2.5.1). Here that interrupt
//! only takes the frame, so that neither the time stamps nor the windows of the bus wait for the
//! estimator. The command leaves in its window anyway, so nothing is lost by it.

#![no_std]
#![no_main]

use defmt_rtt as _;

firmware::tick!();

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2_TSC])]
mod app {
    use super::Mono;
    use ::control::row::Sides;
    use firmware::board::fault::Fault;
    use firmware::board::{self, pac::Interrupt, remote::Remote, time::Clock};
    use firmware::console::BusView;
    use firmware::e2e::{self, Secret};
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::rows::{RunSwitch, Spacing, State, Step};
    use firmware::selftest::{Motor, Report};
    use row_follower::design::{LAW, Law};
    use row_follower::matrix::{BASIC_CYCLE, FEEDBACK, release, window};
    use row_follower::messages::{DistanceLeft, DistanceRight, FeedbackStatus};
    use row_follower::{EVENT_TRIGGERED, Link, PERIOD, Stack, identity};
    use rtic::Mutex as _;

    type Follower = firmware::rows::Follower<Law>;

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
        follower: &'static mut Follower,
        /// Whether `correct` is to follow the next frame.
        due: bool,
        /// Whether the schedule has been lost since the last control step.
        halted: bool,
        /// The last control step.
        last: Option<Step>,
    }

    #[local]
    struct Local {
        /// Of the right distance, which releases the step without a schedule.
        spacing: Spacing,
        remote: Remote,
        switch: RunSwitch,
        sender: e2e::Sender,
        keeper: Keeper,
        log: Log,
    }

    #[init(local = [stack: Option<Stack> = None, place: Option<Follower> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let mut sled = row_follower::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(FEEDBACK),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        let Some(remote) = sled.rest.remote() else {
            fault::stop(Fault::Start)
        };
        let follower = cx.local.place.insert(Follower::new(&LAW));
        link.start();
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                console: sled.console,
                test: None,
                follower,
                due: false,
                halted: false,
                last: None,
            },
            Local {
                spacing: Spacing::of(BASIC_CYCLE.ticks() * start.clocks.ticks_per_us),
                remote,
                switch: RunSwitch::new(),
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

    #[task(binds = USB_LP_CAN_RX0, priority = 6, shared = [&clock, link, halted], local = [spacing])]
    fn can_rx(cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        let spacing = cx.local.spacing;
        (cx.shared.link, cx.shared.halted).lock(|link, halted| {
            let news = link.on_receive(stamp);
            if news.reference {
                link.release_at(release::COMMAND);
            }
            *halted |= news.stop;
            // Without a schedule the second distance releases the step.
            if EVENT_TRIGGERED && news.has(window::DISTANCE_RIGHT) {
                *halted |= spacing.has_gap(stamp, link.counters().services);
                rtic::pend(Interrupt::EXTI1);
            }
        });
    }

    #[task(binds = USB_HP_CAN_TX, priority = 6, shared = [&clock, link, due])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| link.on_transmit(stamp));
        if cx.shared.due.lock(core::mem::take) {
            rtic::pend(Interrupt::EXTI4);
        }
    }

    #[task(binds = CAN_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
    }

    #[task(binds = TIM2, priority = 6, shared = [link, halted])]
    fn window_timer(cx: window_timer::Context) {
        let due = (cx.shared.link, cx.shared.halted).lock(|link, halted| {
            let due = link.on_timer();
            *halted |= link.take_stop();
            due
        });
        if due {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    /// Deadline: the beginning of the command's window.
    #[task(binds = EXTI1, priority = 5, shared = [link, follower, due, halted, last], local = [remote, switch, sender])]
    fn control(cx: control::Context) {
        let (mut link, mut last) = (cx.shared.link, cx.shared.last);
        let (mut follower, mut due) = (cx.shared.follower, cx.shared.due);
        let mut halted = cx.shared.halted;
        let (left, right, time, believed) = link.lock(|link| {
            let left = link.message::<DistanceLeft>(window::DISTANCE_LEFT);
            let right = link.message::<DistanceRight>(window::DISTANCE_RIGHT);
            let (time, believed) = (link.cycle_began(), link.is_time_believed());
            (left, right, time, believed)
        });
        let distances = Sides {
            left: left.map(|left| left.distance),
            right: right.map(|right| right.distance),
        };
        let (run, stop) = (cx.local.remote.run(), cx.local.remote.stop());
        // After a time without a schedule the robot waits to be engaged anew, as without distances.
        let halted = halted.lock(core::mem::take);
        let engaged = cx.local.switch.read(run, stop || halted);
        let step = follower.lock(|follower| follower.command(&distances, engaged, PERIOD));
        let command = row_follower::command(&step, cx.local.sender, time);
        let log = row_follower::row_log(&distances, &step);
        // Each in a lock of its own, so that the bus waits for one of them at most.
        if believed {
            link.lock(|link| link.put(window::COMMAND, command));
        }
        link.lock(|link| link.put(window::ROW_LOG, log));
        due.lock(|due| *due = true);
        last.lock(|last| *last = Some(step));
    }

    /// Runs when the command has left. With the priority of `control` it locks nothing that `control`
    /// would wait for, and it is over long before that runs again.
    #[task(binds = EXTI4, priority = 5, shared = [follower])]
    fn correct(mut cx: correct::Context) {
        cx.shared.follower.lock(|follower| follower.correct());
    }

    #[task(binds = DMA1_CH7, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(priority = 2, shared = [link, last, test], local = [keeper])]
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
        // No motor turns by this node's hand, but without it the motors stop.
        let state = shared.last.lock(|last| last.map(|step| step.state));
        let still = state != Some(State::Following);
        keeper.step::<FeedbackStatus>(
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

    #[task(binds = EXTI3, priority = 1, shared = [link, last, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let last = cx.shared.last.lock(|last| *last);
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::default(),
            test,
            |line| {
                line.str("feedback ");
                let Some(step) = last else {
                    line.str("no step\r\n");
                    return;
                };
                line.str(match step.state {
                    State::Idle => "idle",
                    State::Following => "following",
                    State::End => "end",
                    State::Lost => "lost",
                });
                // In centimetres and degrees.
                line.str(" offset ")
                    .fixed(i32::from(step.offset) * 5, 1)
                    .str(" heading ")
                    .fixed(i32::from(step.heading) * 5, 1)
                    .str(" out ")
                    .fixed(i32::from(step.efforts.left), 0)
                    .str(" ")
                    .fixed(i32::from(step.efforts.right), 0)
                    .str("\r\n");
            },
        );
    }
}

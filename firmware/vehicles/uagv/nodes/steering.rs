//! The steering node: runs the steering rate of message 300 on its actuator and sends the
//! potentiometer's count in message 206.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 is the command's expiry |
//! | `pot` | DMA1 channel 1 | 5 | 200 Hz: sample, end stops, message 206 |
//! | `actuate` | EXTI1, pended by software | 5 | commands and stops |
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
    use firmware::actuator::Times;
    use firmware::board::fault::Fault;
    use firmware::board::{self, motor::MotorOutput, pac::Interrupt, pot::Pot, time::Clock};
    use firmware::console::{self as lines, ActuatorView, BusView};
    use firmware::e2e::Secret;
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::link::padded;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::selftest::Report;
    use network::Message as _;
    use rtic::Mutex as _;
    use uagv::design::COMMAND_TIMEOUT;
    use uagv::matrix::{STEERING, window};
    use uagv::messages::{AdcCount, SteeringPot, SteeringStatus};
    use uagv::session::{Actuator, Session};
    use uagv::{Link, Stack, Steering, identity};

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        steering: Steering,
        output: MotorOutput,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
    }

    #[local]
    struct Local {
        pot: Pot,
        keeper: Keeper,
        log: Log,
        session: Session,
    }

    #[init(local = [stack: Option<Stack> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let mut sled = uagv::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let session = Session::of(Actuator::Steering, start.secret, &mut sled.starts);
        // Behind whatever stores through addresses that only the running program knows: the analysis of execution
        // times would forget where the node's schedule is.
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(STEERING),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        let Some(pot) = sled.rest.pot() else {
            fault::stop(Fault::Start)
        };
        let mut steering = Steering::new(
            Times::new(COMMAND_TIMEOUT, start.clocks.ticks_per_us),
            start.secret,
        );
        steering.supervised.set_secret(session.secret());
        link.start();
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                steering,
                output: sled.motor,
                console: sled.console,
                test: None,
            },
            Local {
                pot,
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
        let news = cx.shared.link.lock(|link| link.on_receive(stamp));
        if news.has(window::COMMAND) || news.stop {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = USB_HP_CAN_TX, priority = 6, shared = [&clock, link])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| link.on_transmit(stamp));
    }

    /// After bus-off the window timer fires at once, and tells the end of the command.
    #[task(binds = CAN_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
    }

    #[task(binds = TIM2, priority = 6, shared = [link])]
    fn window_timer(mut cx: window_timer::Context) {
        let act = cx.shared.link.lock(|link| {
            let expired = link.on_timer();
            link.take_end(expired)
        });
        if act {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = DMA1_CH1, priority = 5, shared = [&clock, link, steering, output], local = [pot])]
    fn pot(cx: pot::Context) {
        cx.local.pot.acknowledge();
        let count = cx.local.pot.count();
        let now = cx.shared.clock.now();
        let barred = (cx.shared.steering, cx.shared.output).lock(|steering, output| {
            steering.sample(count, now);
            // At each sample: a byte that noise put on the line stays for 5 ms at most.
            output.set(steering.byte(now));
            output.is_barred()
        });
        let data = SteeringPot {
            count: AdcCount(count),
        };
        // The controller takes a silent potentiometer for a node that cannot steer, and does not
        // drive.
        let data = (!barred).then(|| padded(data.encode()));
        let mut link = cx.shared.link;
        link.lock(|link| link.replace(window::STEERING_POT, data));
    }

    #[task(binds = EXTI1, priority = 5, shared = [&clock, link, steering, output])]
    fn actuate(cx: actuate::Context) {
        let now = cx.shared.clock.now();
        let mut link = cx.shared.link;
        let arrival = link.lock(|link| link.arrival(window::COMMAND));
        let accepted = (cx.shared.steering, cx.shared.output).lock(|steering, output| {
            let accepted = steering.supervised.attend(&arrival, now);
            output.set(steering.byte(now));
            accepted
        });
        if accepted {
            link.lock(|link| link.release_in(COMMAND_TIMEOUT));
        }
    }

    #[task(binds = DMA1_CH7, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(priority = 2, shared = [&clock, link, steering, output, test], local = [keeper, session])]
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
        let clock = shared.clock;
        // Two sections, because each blocks the interrupts of the bus.
        shared.link.lock(|link| link.keep());
        if shared.link.lock(|link| session.step(link)) {
            let secret = session.secret();
            shared
                .steering
                .lock(|steering| steering.supervised.set_secret(secret));
        }
        let bus = shared.link.lock(|link| BusView::of(link));
        // The potentiometer's task counts as making progress while its samples are fresh.
        let fresh = shared
            .steering
            .lock(|steering| steering.has_sample(clock.now()));
        let work = if fresh { bus.link.services } else { 0 };
        let motor = node::motor(&mut shared.output, keeper);
        keeper.step::<SteeringStatus>(&mut shared.link, &bus, work, motor);
        shared.test.lock(|test| *test = keeper.last_test());
        if keeper.is_report_due() {
            rtic::pend(Interrupt::EXTI3);
        }
    }

    #[task(binds = EXTI3, priority = 1, shared = [link, steering, output, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let byte = cx.shared.output.lock(|output| output.last());
        let view = cx.shared.steering.lock(|steering| ActuatorView {
            command: steering
                .supervised
                .command()
                .map(|command| command.steering_rate.0),
            count: steering.count(),
            byte,
            refused: steering.supervised.refused(),
            refusal: steering.supervised.refusal(),
        });
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::from(&view),
            test,
            |line| lines::actuator(line, "steering", &view),
        );
    }
}

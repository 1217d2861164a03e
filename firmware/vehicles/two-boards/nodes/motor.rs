//! The motor's node: sends the knob's position in message 200, and turns motor and LED as
//! message 300 says.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 is the command's expiry |
//! | `knob` | DMA1 channel 1 | 5 | 200 Hz: sample, message 200 |
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
    use two_boards::matrix::{MOTOR, window};
    use two_boards::messages::{AdcCount, Knob, MotorStatus};
    use two_boards::{COMMAND_TIMEOUT, Circuit, Link, Obeyed, Stack, identity};

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        obeyed: Obeyed,
        output: MotorOutput,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
    }

    #[local]
    struct Local {
        pot: Pot,
        circuit: Circuit,
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
            identity(MOTOR),
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
        link.start();
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                obeyed: Obeyed::new(
                    Times::new(COMMAND_TIMEOUT, start.clocks.ticks_per_us),
                    start.secret,
                ),
                output: sled.motor,
                console: sled.console,
                test: None,
            },
            Local {
                pot,
                circuit: Circuit::open(start.clocks.ticks_per_us),
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

    #[task(binds = CAN_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
        rtic::pend(Interrupt::EXTI1);
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

    #[task(binds = DMA1_CH1, priority = 5, shared = [link], local = [pot])]
    fn knob(mut cx: knob::Context) {
        cx.local.pot.acknowledge();
        let count = AdcCount(cx.local.pot.count());
        let data = padded(Knob { count }.encode());
        cx.shared.link.lock(|link| link.put(window::KNOB, data));
    }

    #[task(binds = EXTI1, priority = 5, shared = [&clock, link, obeyed, output], local = [circuit])]
    fn actuate(cx: actuate::Context) {
        let now = cx.shared.clock.now();
        let (mut link, circuit) = (cx.shared.link, cx.local.circuit);
        let arrival = link.lock(|link| link.arrival(window::COMMAND));
        let accepted = (cx.shared.obeyed, cx.shared.output).lock(|obeyed, output| {
            let accepted = obeyed.attend(&arrival, now);
            output.set(circuit.byte(obeyed.command(), now));
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

    #[task(priority = 2, shared = [link, obeyed, output, test], local = [keeper])]
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
        // A command sets the LED. Without one the LED shows the state of the node.
        let led = shared
            .obeyed
            .lock(|obeyed| obeyed.command().map(|command| command.led));
        keeper.show(led);
        let motor = node::motor(&mut shared.output, keeper);
        keeper.step::<MotorStatus>(&mut shared.link, &bus, bus.link.services, motor);
        shared.test.lock(|test| *test = keeper.last_test());
        if keeper.is_report_due() {
            rtic::pend(Interrupt::EXTI3);
        }
    }

    #[task(binds = EXTI3, priority = 1, shared = [link, obeyed, output, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let byte = cx.shared.output.lock(|output| output.last());
        let view = cx.shared.obeyed.lock(|obeyed| ActuatorView {
            command: obeyed.command().map(|command| i16::from(command.motor)),
            count: None,
            byte,
            refused: obeyed.refused(),
            refusal: obeyed.refusal(),
        });
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::from(&view),
            test,
            |line| lines::actuator(line, "motor", &view),
        );
    }
}

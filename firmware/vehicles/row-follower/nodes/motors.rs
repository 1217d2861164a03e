//! The motors' node: servo pulses for the motor drivers of both sides, as message 300 says.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack; a command begins pulses |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 is the command's expiry |
//! | `actuate` | EXTI1, pended by software | 5 | the end of a command: neutral |
//! | `console_dma` | DMA1 channel 7 | 3 | next console line |
//! | `SysTick` | SysTick | 3 | 100 Hz: the tick of `rtic-monotonics`, wakes `housekeeping` |
//! | `housekeeping` | software, by EXTI2 | 2 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `console` | EXTI3, pended by software | 1 | 10 Hz lines |
//!
//! The pulses are neutral from the start of the node until its first command, and whenever no
//! command is in force. Without its external clock the node makes pulses only while commands come, and
//! some neutral ones behind the last of them: the references trim its RC oscillator, which makes no
//! neutral pulse without them.

#![no_std]
#![no_main]

use defmt_rtt as _;

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2_TSC])]
mod app {
    use firmware::actuator::Times;
    use firmware::board::clock::Oscillator;
    use firmware::board::fault::Fault;
    use firmware::board::pulse::PulsePeriod;
    use firmware::board::servos::Servos;
    use firmware::board::{self, pac::Interrupt, time::Clock};
    use firmware::console::{ActuatorView, BusView};
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::rows::pulse;
    use firmware::selftest::{Motor, Report};
    use row_follower::matrix::{MOTORS, window};
    use row_follower::messages::MotorsStatus;
    use row_follower::{COMMAND_TIMEOUT, Link, Obeyed, PULSE_PERIOD_US, Stack, efforts, identity};
    use rtic::Mutex as _;

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        obeyed: Obeyed,
        servos: Servos,
        /// Whether the node may turn the motors: its self-test found nothing.
        fit: bool,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
    }

    /// Steps of the housekeeping without a command after which an RC oscillator makes no pulses any
    /// more. By then the neutral ones have stopped the motors.
    const PAUSE: u8 = 3;

    #[local]
    struct Local {
        keeper: Keeper,
        /// Steps without a command on the RC oscillator; `None` on the external clock.
        idle: Option<u8>,
        log: Log,
    }

    #[init(local = [stack: Option<Stack> = None])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let mut sled = row_follower::start(cx.device);
        let Some(mut servos) =
            PulsePeriod::new(PULSE_PERIOD_US).and_then(|period| sled.rest.servos(period))
        else {
            fault::stop(Fault::Start)
        };
        if sled.clocks.oscillator == Oscillator::External {
            // The counter stands before its first wrap, where no pulse is.
            let _ = servos.begin();
        }
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
        };
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(MOTORS),
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
                obeyed: Obeyed::new(Times::new(COMMAND_TIMEOUT, start.clocks.ticks_per_us)),
                servos,
                fit: true,
                console: sled.console,
                test: None,
            },
            Local {
                keeper: Keeper::start(
                    cx.core.SYST,
                    &mut cx.core.SCB,
                    sled.led,
                    sled.watchdog,
                    &start,
                    &sled.findings,
                ),
                idle: (start.clocks.oscillator == Oscillator::Internal).then_some(0),
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

    /// A command acts here and not in a task of its own, so that no other interrupt comes between its
    /// frame and its pulses.
    #[task(binds = USB_LP_CAN_RX0, priority = 6, shared = [&clock, link, obeyed, servos, fit])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        let news = cx.shared.link.lock(|link| link.on_receive(stamp));
        if news.has(window::COMMAND) {
            let shared = (
                cx.shared.link,
                cx.shared.obeyed,
                cx.shared.servos,
                cx.shared.fit,
            );
            act(shared, stamp);
        } else if news.stop {
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
        let act = cx
            .shared
            .link
            .lock(|link| link.on_timer() || link.take_stop() || !link.is_alive());
        if act {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    /// Without a command the next pulses are neutral.
    #[task(binds = EXTI1, priority = 5, shared = [&clock, link, obeyed, servos, fit])]
    fn actuate(cx: actuate::Context) {
        let now = cx.shared.clock.now();
        let shared = (
            cx.shared.link,
            cx.shared.obeyed,
            cx.shared.servos,
            cx.shared.fit,
        );
        act(shared, now);
    }

    /// Begins pulses: those of the command that has come, or neutral ones if none is in force.
    #[inline(never)]
    fn act(
        (mut link, mut obeyed, mut servos, mut fit): (
            impl rtic::Mutex<T = Link>,
            impl rtic::Mutex<T = Obeyed>,
            impl rtic::Mutex<T = Servos>,
            impl rtic::Mutex<T = bool>,
        ),
        now: u32,
    ) {
        let arrival = link.lock(|link| link.arrival(window::COMMAND));
        let fit = fit.lock(|fit| *fit);
        let (accepted, efforts) = obeyed.lock(|obeyed| {
            let accepted = obeyed.attend(&arrival, now);
            (accepted, efforts(obeyed.command().filter(|_| fit)))
        });
        servos.lock(|servos| {
            servos.fire(pulse(efforts.left), pulse(efforts.right));
            if accepted {
                // A later command tries again.
                let _ = servos.begin();
            }
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

    #[task(priority = 2, shared = [link, obeyed, servos, fit, test], local = [keeper, idle])]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            if let Some(steps) = cx.local.idle {
                rest(&mut cx.shared, steps);
            }
            keep(&mut cx.shared, cx.local.keeper);
            pace.wait().await;
        }
    }

    /// Ends the pulses of an RC oscillator some steps after the last command.
    fn rest(shared: &mut housekeeping::SharedResources<'_>, steps: &mut u8) {
        let commanded = shared.obeyed.lock(|obeyed| obeyed.command().is_some());
        *steps = if commanded {
            0
        } else {
            steps.saturating_add(1)
        };
        if *steps >= PAUSE {
            // A pulse that runs is left to end, and the next step tries again.
            shared.servos.lock(Servos::pause);
        }
    }

    /// A step of the housekeeping.
    fn keep(shared: &mut housekeeping::SharedResources<'_>, keeper: &mut Keeper) {
        let bus = shared.link.lock(|link| {
            link.keep();
            BusView::of(link)
        });
        let fit = keeper.is_fit();
        shared.fit.lock(|allowed| *allowed = fit);
        let still = shared.servos.lock(|servos| {
            if !fit {
                servos.stop();
            }
            servos.is_neutral()
        });
        keeper.step::<MotorsStatus>(
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

    #[task(binds = EXTI3, priority = 1, shared = [link, obeyed, servos, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let (left, right) = cx.shared.servos.lock(|servos| servos.widths());
        let view = cx.shared.obeyed.lock(|obeyed| ActuatorView {
            command: obeyed.command().map(|command| command.left),
            count: None,
            byte: 0,
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
            |line| {
                line.str("motors ").str(match view.command {
                    Some(_) => "cmd",
                    None => "no cmd",
                });
                line.str(" left ")
                    .unsigned(u32::from(left.us()))
                    .str(" right ")
                    .unsigned(u32::from(right.us()))
                    .str(" refused ")
                    .unsigned(u32::from(view.refused))
                    .str("\r\n");
            },
        );
    }
}

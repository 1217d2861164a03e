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
//! some neutral ones behind the last of them: see `firmware::pulses`. It makes none under a time
//! master that has no external clock either.

#![no_std]
#![no_main]

use defmt_rtt as _;

firmware::tick!();

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2_TSC])]
mod app {
    use super::Mono;
    use firmware::actuator::Times;
    use firmware::board::clock::Oscillator;
    use firmware::board::fault::Fault;
    use firmware::board::pulse::PulsePeriod;
    use firmware::board::servos::Servos;
    use firmware::board::{self, pac::Interrupt, time::Clock};
    use firmware::console::{ActuatorView, BusView};
    use firmware::e2e::Secret;
    use firmware::fault;
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::pulses::{PulseClock, PulseScale};
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
        leave: Leave,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
    }

    /// What the housekeeping lets the other tasks do.
    #[derive(Clone, Copy)]
    pub struct Leave {
        /// The node may turn the motors: its self-test found nothing, and its clock is known.
        drive: bool,
        /// By how much the widths of the pulses are changed.
        scale: PulseScale,
    }

    #[local]
    struct Local {
        keeper: Keeper,
        pulse_clock: PulseClock,
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
            secret: Secret::read(&sled.secret),
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
        let pulse_clock = PulseClock::new(start.clocks.oscillator);
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                obeyed: Obeyed::new(
                    Times::new(COMMAND_TIMEOUT, start.clocks.ticks_per_us),
                    start.secret,
                ),
                servos,
                leave: Leave {
                    drive: pulse_clock.is_known(),
                    scale: pulse_clock.scale(),
                },
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
                pulse_clock,
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
    #[task(binds = USB_LP_CAN_RX0, priority = 6, shared = [&clock, link, obeyed, servos, leave])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        let news = cx.shared.link.lock(|link| link.on_receive(stamp));
        if news.has(window::COMMAND) {
            let shared = (
                cx.shared.link,
                cx.shared.obeyed,
                cx.shared.servos,
                cx.shared.leave,
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
        let act = cx.shared.link.lock(|link| {
            let expired = link.on_timer();
            link.take_end(expired)
        });
        if act {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    /// Without a command the next pulses are neutral.
    #[task(binds = EXTI1, priority = 5, shared = [&clock, link, obeyed, servos, leave])]
    fn actuate(cx: actuate::Context) {
        let now = cx.shared.clock.now();
        let shared = (
            cx.shared.link,
            cx.shared.obeyed,
            cx.shared.servos,
            cx.shared.leave,
        );
        act(shared, now);
    }

    /// Begins pulses: those of the command that has come, or neutral ones if none is in force. A frame that
    /// is refused begins none: pulses of the old command would delay the neutral ones behind them.
    #[inline(never)]
    fn act(
        (mut link, mut obeyed, mut servos, mut leave): (
            impl rtic::Mutex<T = Link>,
            impl rtic::Mutex<T = Obeyed>,
            impl rtic::Mutex<T = Servos>,
            impl rtic::Mutex<T = Leave>,
        ),
        now: u32,
    ) {
        let arrival = link.lock(|link| link.arrival(window::COMMAND));
        let Leave { drive, scale } = leave.lock(|leave| *leave);
        let (accepted, stands, efforts) = obeyed.lock(|obeyed| {
            let accepted = obeyed.attend(&arrival, now);
            let command = obeyed.command().filter(|_| drive);
            (accepted, command.is_none(), efforts(command))
        });
        servos.lock(|servos| {
            if accepted || stands {
                servos.fire(scale.pulse(efforts.left), scale.pulse(efforts.right));
            }
            if accepted && drive {
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

    #[task(priority = 2, shared = [link, obeyed, servos, leave, test], local = [keeper, pulse_clock])]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            keep(&mut cx.shared, cx.local.keeper, cx.local.pulse_clock);
            pace.wait().await;
        }
    }

    /// A step of the housekeeping.
    fn keep(
        shared: &mut housekeeping::SharedResources<'_>,
        keeper: &mut Keeper,
        pulse_clock: &mut PulseClock,
    ) {
        // Two sections, because each blocks the interrupts of the bus.
        shared.link.lock(|link| link.keep());
        let (bus, rate) = shared
            .link
            .lock(|link| (BusView::of(link), link.true_rate()));
        let (commanded, efforts) = shared
            .obeyed
            .lock(|obeyed| (obeyed.command().is_some(), efforts(obeyed.command())));
        pulse_clock.step(rate, commanded);
        let leave = Leave {
            drive: keeper.is_fit() && pulse_clock.is_known(),
            scale: pulse_clock.scale(),
        };
        shared.leave.lock(|shared| *shared = leave);
        let still = !leave.drive || efforts.left == 0 && efforts.right == 0;
        shared.servos.lock(|servos| {
            if !leave.drive {
                let neutral = leave.scale.pulse(0);
                servos.set(neutral, neutral);
            }
            if pulse_clock.is_paused() {
                // A pulse that runs is left to end, and the next step tries again.
                servos.pause();
            }
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
        let ((left, right), on) = cx
            .shared
            .servos
            .lock(|servos| (servos.widths(), servos.is_on()));
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
                line.str(if on { " left " } else { " no pulses left " })
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

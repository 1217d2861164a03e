//! The bus guardian of one node, on a small board beside it: it closes the gate of the node if that drives the bus where it may
//! not. It is on the bus only in the variant `sentry` of the vehicle, or where `guardian` of the manifest says so. It sends
//! nothing: its CAN controller only acknowledges, and no task has a way to request a frame. `tap` of its board has its
//! wiring, and `ttcan::guardian` what it lets through.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `look` | TIM7 | 7 | every 18 us: looks at the TX line, sets the gate |
//! | `can_rx` | receive FIFO 0 | 6 | stamps; takes a frame, and what the line is at that moment |
//! | `handle` | EXTI4 | 5 | tells the lower half of the frame; behind a reference, finds when the node may begin a frame next |
//! | `step` | TIM2 | 4 | every 299 us: what the spells are that have begun; in turns, when the node may begin a frame next, and one step of what can wait |
//! | `report` | EXTI1 | 2 | each 38th `step`, every 11.4 ms: watchdog, LED; each tenth time, asks for `tell` |
//! | `tell` | EXTI0 | 1 | every 114 ms: a line for each cut, and one each second |
//! | `console_dma` | DMA1 channel 7 | 1 | end of a console line |
//!
//! No task waits for an instant, because the timer queue of `rtic-monotonics` masks all interrupts for longer than a
//! look may be late. `report` feeds the watchdog only if `look` and `step` ran since its step before: if one of them
//! ends, the watchdog bites, and the gate opens.

#![no_std]
#![no_main]

use defmt_rtt as _;

#[rtic::app(device = firmware::board::pac, peripherals = true)]
mod app {
    use firmware::board::can::Received;
    use firmware::board::console::Console;
    use firmware::board::fault::Fault;
    use firmware::board::led::Led;
    use firmware::board::pac::Interrupt;
    use firmware::board::tap::Tap;
    use firmware::board::time::{Alarms, Clock};
    use firmware::board::watchdog::Watchdog;
    use firmware::board::{self, CanPort};
    use firmware::fault;
    use firmware::guard::{Lower, Taken, Teller, guards};
    use firmware::sentry::Sentry;
    use ttcan::guardian::{Guardian, GuardianConfig, GuardianState};
    use ttcan::{Micros, Stamp, StampLatency};
    use uagv::guarded;
    use uagv::matrix::{BIT_RATE, SCHEDULE};

    /// The stamps of the line's edges are a timer's. What is told with its begin is the release of a spell shorter than a look,
    /// and the guardian's margins allow for as much.
    const INTERVAL: Micros = Micros::micros(11);
    /// From one `step` to the next.
    const STEP: Micros = Micros::micros(299);
    /// Longest time from a reference's reception to the end of its `handle`.
    const HANDLING: Micros = Micros::micros(220);
    /// Longest time from one `step` to the next, with its deadline.
    const RULING: Micros = Micros::micros(600);
    /// Bits of a short spell: 80 us, and no less than two flags take. A frame may have five recessive bits there, the look that
    /// finds the next one comes 22 us later at most, and takes 14 us: it is stopped ahead of its bit 34.
    const SPELL_BITS: u8 = 20;
    /// Runs of `step` from one `report` to the next, and of `report` from one `tell` to the next: 113.6 ms.
    const STEPS: u8 = 38;
    const REPORTS: u8 = 10;
    const TELL_US: u32 = STEP.ticks() * STEPS as u32 * REPORTS as u32;

    const _: () = assert!(
        guarded::NODES.len() == 1 && board::FACTS.taps.len() == 1,
        "the tap of the board has its node"
    );

    #[shared]
    struct Shared {
        clock: Clock,
        sentry: Sentry<Tap>,
        /// The last frame, until `handle` has it.
        taken: Option<Taken<1>>,
        lower: Lower<1>,
        console: Console,
    }

    #[local]
    struct Local {
        can: CanPort,
        alarms: Alarms,
        /// Ticks from one `step` to the next, and when it is due.
        every: u32,
        due: u32,
        led: Led,
        watchdog: Watchdog,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let mut sled = uagv::start(cx.device);
        let ticks = sled.clocks.ticks_per_us;
        let bit = 1_000_000 * ticks / BIT_RATE;
        let config = GuardianConfig {
            receive_latency: StampLatency::bxcan(bit, board::FACTS.stamp_ticks).receive,
            handling: HANDLING,
            ruling: RULING,
            spell_bits: SPELL_BITS,
            ..GuardianConfig::new(ticks, INTERVAL)
        };
        let now = sled.clock.now();
        let Ok(guardian) = Guardian::new(SCHEDULE.view(), config, guarded::NODES, Stamp(now))
        else {
            fault::stop(Fault::Start)
        };
        let (watch, judge) = guardian.halves();
        let Some(tap) = sled.rest.tap() else {
            fault::stop(Fault::Start)
        };
        let guards = guards(sled.clocks.oscillator);
        let every = STEP.ticks() * ticks;
        let due = now.wrapping_add(every);
        sled.alarms.set_window(due);
        // Start-up is over, and with it all that it waited for.
        board::fault::passed();
        sled.watchdog.feed();
        (
            Shared {
                clock: sled.clock,
                sentry: Sentry::new(watch, tap, bit, guards),
                taken: None,
                lower: Lower::new(judge, guards),
                console: sled.console,
            },
            Local {
                can: sled.can,
                alarms: sled.alarms,
                every,
                due,
                led: sled.led,
                watchdog: sled.watchdog,
            },
        )
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            rtic::export::wfi();
        }
    }

    #[task(binds = TIM7, priority = 7, shared = [&clock, sentry])]
    fn look(mut cx: look::Context) {
        let now = Stamp(cx.shared.clock.now());
        cx.shared.sentry.lock(|sentry| sentry.look(now));
    }

    /// One frame in a job: while the FIFO holds another one, the interrupt stays pending.
    #[task(binds = USB_LP_CAN_RX0, priority = 6, shared = [&clock, sentry, taken], local = [can])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = Stamp(cx.shared.clock.now());
        if let Some(Received::Data(frame)) = cx.local.can.receive() {
            let evidence = cx.shared.sentry.lock(|sentry| sentry.evidence());
            let taken = Taken {
                frame,
                stamp,
                evidence,
            };
            cx.shared.taken.lock(|last| *last = Some(taken));
            rtic::pend(Interrupt::EXTI4);
        }
    }

    #[task(binds = EXTI4, priority = 5, shared = [&clock, sentry, taken, lower])]
    fn handle(mut cx: handle::Context) {
        let Some(taken) = cx.shared.taken.lock(Option::take) else {
            return;
        };
        let now = Stamp(cx.shared.clock.now());
        let outlook = cx.shared.lower.lock(|lower| {
            let followed = lower.receive(&taken);
            followed.then(|| lower.judge.look_ahead(now))
        });
        if let Some(outlook) = outlook {
            cx.shared.sentry.lock(|sentry| sentry.publish(&outlook));
        }
    }

    #[task(binds = TIM2, priority = 4, shared = [&clock, sentry, lower], local = [alarms, every, due, steps: u8 = 0])]
    fn step(cx: step::Context) {
        let (mut sentry, mut lower) = (cx.shared.sentry, cx.shared.lower);
        if !cx.local.alarms.take_window() {
            return;
        }
        *cx.local.due = cx.local.due.wrapping_add(*cx.local.every);
        cx.local.alarms.set_window(*cx.local.due);
        let news = sentry.lock(|sentry| sentry.news());
        let now = Stamp(cx.shared.clock.now());
        lower.lock(|lower| lower.rule(&news, now));
        *cx.local.steps = cx.local.steps.wrapping_add(1);
        if cx.local.steps.is_multiple_of(2) {
            let outlook = lower.lock(|lower| lower.judge.look_ahead(now));
            sentry.lock(|sentry| sentry.publish(&outlook));
        } else {
            let driving = sentry.lock(|sentry| sentry.driving());
            let orders = lower.lock(|lower| lower.judge.account(driving, now));
            sentry.lock(|sentry| sentry.obey(orders));
        }
        if *cx.local.steps == STEPS {
            *cx.local.steps = 0;
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = DMA1_CH7, priority = 1, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared.console.lock(Console::on_transfer_complete);
    }

    #[task(binds = EXTI1, priority = 2, shared = [sentry, lower], local = [led, watchdog, reports: u8 = 0])]
    fn report(mut cx: report::Context) {
        let (ruled, state) = cx.shared.lower.lock(Lower::report);
        let looks = cx.shared.sentry.lock(|sentry| sentry.take_looks());
        if ruled && looks {
            cx.local.watchdog.feed();
        }
        cx.local.led.set(state == GuardianState::InSchedule);
        *cx.local.reports = cx.local.reports.wrapping_add(1);
        if *cx.local.reports == REPORTS {
            *cx.local.reports = 0;
            rtic::pend(Interrupt::EXTI0);
        }
    }

    #[task(binds = EXTI0, priority = 1, shared = [lower, console], local = [teller: Teller<1> = Teller::new()])]
    fn tell(mut cx: tell::Context) {
        let line = cx
            .local
            .teller
            .step(cx.shared.lower, &guarded::NAMES, TELL_US);
        if !line.as_bytes().is_empty() {
            let push = |console: &mut Console| console.push(line.as_bytes());
            cx.shared.console.lock(push);
        }
    }
}

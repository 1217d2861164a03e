//! The bus guardian of the four nodes: it closes the gate of one that drives the bus where it may not. It is on
//! the bus only while `guardian.enabled` of the manifest is true. It sends nothing: its CAN controller only
//! acknowledges, and no task has a way to request a frame. `taps` of its board has its wiring, and
//! `ttcan::guardian` what it lets through.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `look` | TIM3 | 7 | every 8.9 us: looks at the TX lines, sets the gates; each 28th time, asks for `rule`, and each 56th time for `ahead` |
//! | `can_rx` | receive FIFO 0 | 6 | stamps; takes a frame, and what the lines are at that moment |
//! | `handle` | RTC_WKUP | 5 | tells the lower half of the frame; behind a reference, asks for `ahead` |
//! | `rule` | EXTI15_10 | 4 | every 249 us: what the spells are that have begun; asks for `account` |
//! | `ahead` | EXTI9_5 | 3 | behind each reference, and every 498 us: finds when each node may begin a frame next |
//! | `account` | EXTI4 | 2 | every 249 us: one step of what can wait |
//! | `report` | RTC_ALARM | 2 | each 45th `account`, every 11.2 ms: watchdog, LED; each tenth time, asks for `tell` |
//! | `tell` | TAMP_STAMP | 1 | every 112 ms: a line for each cut, and one each second |
//! | `console_dma` | DMA1 stream 6 | 1 | end of a console line |
//!
//! No task waits for an instant, because the timer queue of `rtic-monotonics` masks all interrupts for longer than a
//! look may be late. `report` feeds the watchdog only if `rule` ran since its step before: if looks end, the watchdog
//! bites, and the gates open.

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
    use firmware::board::taps::Taps;
    use firmware::board::watchdog::Watchdog;
    use firmware::board::{self, CanPort, time::Clock};
    use firmware::fault;
    use firmware::guard::{Lower, Taken, Teller, guards};
    use ttcan::guardian::{Guardian, GuardianConfig, GuardianState, Lines, Watch};
    use ttcan::{Micros, Stamp, StampLatency};
    use uagv::guarded;
    use uagv::matrix::{BIT_RATE, SCHEDULE};

    /// Guarded nodes, each at the tap of its place.
    const NODES: usize = guarded::NODES.len();
    /// Looks come every 8.9 us, and each up to 2.1 us late: the interrupt's entry, and a lock of another task. The
    /// deadline of `look` in `guardian.tasks.toml` holds it to that.
    const INTERVAL: Micros = Micros::micros(11);
    /// Looks from one `rule` to the next.
    const ROUND: u8 = 28;
    /// Looks from one `ahead` to the next.
    const ROUNDS: u8 = 2 * ROUND;
    /// Longest time from a reference's reception to the end of the `ahead` behind it.
    const HANDLING: Micros = Micros::micros(520);
    /// Longest time from one `rule` to the next: 28 looks, and its deadline.
    const RULING: Micros = Micros::micros(480);
    /// Bits of a short spell: 112 us.
    const SPELL_BITS: u8 = 28;
    /// Steps of `account` from one `report` to the next, and of `report` from one `tell` to the next: 112 ms.
    const STEPS: u8 = 45;
    const REPORTS: u8 = 10;
    /// Looks come 112 500 times a second.
    const TELL_US: u32 = ROUND as u32 * STEPS as u32 * REPORTS as u32 * 80 / 9;

    const _: () = assert!(
        NODES == board::FACTS.taps.len(),
        "each tap of the board has its node"
    );

    #[shared]
    struct Shared {
        clock: Clock,
        watch: Watch<NODES>,
        /// The last frame, until `handle` has it.
        taken: Option<Taken<NODES>>,
        lower: Lower<NODES>,
        console: Console,
    }

    #[local]
    struct Local {
        can: CanPort,
        taps: Taps,
        /// Gates that stay open: all without a crystal.
        passes: u32,
        looks: u8,
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
        let now = Stamp(sled.clock.now());
        let Ok(guardian) = Guardian::new(SCHEDULE.view(), config, guarded::NODES, now) else {
            fault::stop(Fault::Start)
        };
        let (watch, judge) = guardian.halves();
        let taps = sled.rest.taps();
        let guards = guards(sled.clocks.oscillator);
        // Start-up is over, and with it all that it waited for.
        board::fault::passed();
        sled.watchdog.feed();
        (
            Shared {
                clock: sled.clock,
                watch,
                taken: None,
                lower: Lower::new(judge, guards),
                console: sled.console,
            },
            Local {
                can: sled.can,
                taps,
                passes: if guards { 0 } else { u32::MAX },
                looks: 0,
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

    #[task(binds = TIM3, priority = 7, shared = [&clock, watch], local = [taps, passes, looks])]
    fn look(mut cx: look::Context) {
        let levels = cx.local.taps.look();
        let now = Stamp(cx.shared.clock.now());
        let lines = Lines {
            dominant: levels.dominant,
            fell: levels.fell,
        };
        let open = cx.shared.watch.lock(|watch| watch.look(lines, now));
        cx.local.taps.open(open.bits() | *cx.local.passes);
        *cx.local.looks = cx.local.looks.wrapping_add(1);
        if *cx.local.looks == ROUND {
            rtic::pend(Interrupt::EXTI15_10);
        } else if *cx.local.looks == ROUNDS {
            *cx.local.looks = 0;
            rtic::pend(Interrupt::EXTI15_10);
            rtic::pend(Interrupt::EXTI9_5);
        }
    }

    /// One frame in a job: while the FIFO holds another one, the interrupt stays pending.
    #[task(binds = CAN1_RX0, priority = 6, shared = [&clock, watch, taken], local = [can])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = Stamp(cx.shared.clock.now());
        if let Some(Received::Data(frame)) = cx.local.can.receive() {
            let evidence = cx.shared.watch.lock(|watch| watch.evidence());
            let taken = Taken {
                frame,
                stamp,
                evidence,
            };
            cx.shared.taken.lock(|last| *last = Some(taken));
            rtic::pend(Interrupt::RTC_WKUP);
        }
    }

    #[task(binds = RTC_WKUP, priority = 5, shared = [taken, lower])]
    fn handle(mut cx: handle::Context) {
        let Some(taken) = cx.shared.taken.lock(Option::take) else {
            return;
        };
        let followed = cx.shared.lower.lock(|lower| lower.receive(&taken));
        if followed {
            rtic::pend(Interrupt::EXTI9_5);
        }
    }

    #[task(binds = EXTI9_5, priority = 3, shared = [&clock, watch, lower])]
    fn ahead(cx: ahead::Context) {
        let (mut watch, mut lower) = (cx.shared.watch, cx.shared.lower);
        let now = Stamp(cx.shared.clock.now());
        let outlook = lower.lock(|lower| lower.judge.look_ahead(now));
        // One node in each lock, because it delays a look.
        // loop-bound: 4. The guarded nodes.
        for node in 0..NODES {
            watch.lock(|watch| watch.publish(&outlook, node));
        }
    }

    #[task(binds = EXTI15_10, priority = 4, shared = [&clock, watch, lower])]
    fn rule(cx: rule::Context) {
        let (mut watch, mut lower) = (cx.shared.watch, cx.shared.lower);
        let news = watch.lock(Watch::news);
        let now = Stamp(cx.shared.clock.now());
        lower.lock(|lower| lower.rule(&news, now));
        rtic::pend(Interrupt::EXTI4);
    }

    #[task(binds = EXTI4, priority = 2, shared = [&clock, watch, lower], local = [steps: u8 = 0])]
    fn account(cx: account::Context) {
        let (mut watch, mut lower) = (cx.shared.watch, cx.shared.lower);
        let driving = watch.lock(|watch| watch.driving());
        let now = Stamp(cx.shared.clock.now());
        let orders = lower.lock(|lower| lower.judge.account(driving, now));
        watch.lock(|watch| watch.obey(orders));
        *cx.local.steps = cx.local.steps.wrapping_add(1);
        if *cx.local.steps == STEPS {
            *cx.local.steps = 0;
            rtic::pend(Interrupt::RTC_ALARM);
        }
    }

    #[task(binds = DMA1_STREAM6, priority = 1, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared.console.lock(Console::on_transfer_complete);
    }

    #[task(binds = RTC_ALARM, priority = 2, shared = [lower], local = [led, watchdog, reports: u8 = 0])]
    fn report(mut cx: report::Context) {
        let (ruled, state) = cx.shared.lower.lock(Lower::report);
        if ruled {
            cx.local.watchdog.feed();
        }
        cx.local.led.set(state == GuardianState::InSchedule);
        *cx.local.reports = cx.local.reports.wrapping_add(1);
        if *cx.local.reports == REPORTS {
            *cx.local.reports = 0;
            rtic::pend(Interrupt::TAMP_STAMP);
        }
    }

    #[task(binds = TAMP_STAMP, priority = 1, shared = [lower, console], local = [teller: Teller<NODES> = Teller::new()])]
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

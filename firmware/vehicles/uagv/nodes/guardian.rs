//! The bus guardian of the four nodes: it closes the gate of one that drives the bus where it may not. It is on
//! the bus only while `guardian.enabled` of the manifest is true. It sends nothing: its CAN controller only
//! acknowledges, and no task has a way to request a frame. `taps` of its board has its wiring, and
//! `ttcan::guardian` what it lets through.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `look` | TIM3 | 5 | every 8.9 us: looks at the TX lines, sets the gates; each 12th time, asks for `rule` |
//! | `can_rx` | receive FIFO 0 | 4 | stamps, tells the lower half of a frame; behind a reference, asks for `ahead` |
//! | `ahead` | EXTI9_5 | 4 | behind each reference, and every 427 us: finds when each node may begin a frame next |
//! | `rule` | EXTI15_10 | 3 | every 107 us: what the spells are that have begun; each second time, asks for `account`, and each fourth time for `ahead` |
//! | `account` | EXTI0 | 2 | every 213 us: one step of what can wait |
//! | `console_dma` | DMA1 stream 6 | 2 | end of a console line |
//! | `report` | EXTI2 | 1 | each 45th `account`, every 9.6 ms: watchdog, LED; a line for each cut, and one each second |
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
    use firmware::console::Line;
    use firmware::fault;
    use firmware::guard::{self, Told, Trips};
    use ttcan::guardian::{Guardian, GuardianConfig, GuardianState, Judge, Lines, Watch};
    use ttcan::{Micros, Stamp, StampLatency};
    use uagv::guarded;
    use uagv::matrix::{BIT_RATE, SCHEDULE};

    /// Guarded nodes, each at the tap of its place.
    const NODES: usize = guarded::NODES.len();
    /// Looks come every 8.9 us, and each up to 2.1 us late: the interrupt's entry, and a lock of another task.
    const INTERVAL: Micros = Micros::micros(11);
    /// Looks from one `rule` to the next, and steps of `rule` from one `ahead` to the next.
    const ROUND: u8 = 12;
    const ROUNDS: u8 = 4;
    /// Longest time from a frame's reception to the end of the `ahead` behind it.
    const HANDLING: Micros = Micros::micros(110);
    /// Bits of a short spell: 112 us.
    const SPELL_BITS: u8 = 28;
    /// Steps of `account` from one `report` to the next, and five times the time that takes, 9.6 ms.
    const STEPS: u8 = 45;
    const STEP_5_MS: u32 = 48;
    /// Steps of `report` between two lines about the state, about a second.
    const REPORTS: u32 = 104;

    const _: () = assert!(
        NODES == board::FACTS.taps.len(),
        "each tap of the board has its node"
    );

    #[shared]
    struct Shared {
        clock: Clock,
        watch: Watch<NODES>,
        lower: Lower,
        console: Console,
    }

    /// The lower half, and whether it has ruled since the last step of `report`.
    pub struct Lower {
        judge: Judge<'static, NODES>,
        ruled: bool,
    }

    #[local]
    struct Local {
        can: CanPort,
        taps: Taps,
        looks: u8,
        reporter: Reporter,
    }

    /// What `report` owns.
    pub struct Reporter {
        led: Led,
        watchdog: Watchdog,
        told: Told<NODES>,
        steps: u32,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let mut sled = uagv::start(cx.device);
        let ticks = sled.clocks.ticks_per_us;
        let bit = 1_000_000 * ticks / BIT_RATE;
        let config = GuardianConfig {
            receive_latency: StampLatency::bxcan(bit, board::FACTS.stamp_ticks).receive,
            handling: HANDLING,
            spell_bits: SPELL_BITS,
            ..GuardianConfig::new(ticks, INTERVAL)
        };
        let now = Stamp(sled.clock.now());
        let Ok(guardian) = Guardian::new(SCHEDULE.view(), config, guarded::NODES, now) else {
            fault::stop(Fault::Start)
        };
        let (watch, judge) = guardian.halves();
        let taps = sled.rest.taps();
        // Start-up is over, and with it all that it waited for.
        board::fault::passed();
        sled.watchdog.feed();
        (
            Shared {
                clock: sled.clock,
                watch,
                lower: Lower {
                    judge,
                    ruled: false,
                },
                console: sled.console,
            },
            Local {
                can: sled.can,
                taps,
                looks: 0,
                reporter: Reporter {
                    led: sled.led,
                    watchdog: sled.watchdog,
                    told: Told::new(),
                    steps: 0,
                },
            },
        )
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            rtic::export::wfi();
        }
    }

    #[task(binds = TIM3, priority = 5, shared = [&clock, watch], local = [taps, looks])]
    fn look(mut cx: look::Context) {
        let levels = cx.local.taps.look();
        let now = Stamp(cx.shared.clock.now());
        let lines = Lines {
            dominant: levels.dominant,
            fell: levels.fell,
        };
        let open = cx.shared.watch.lock(|watch| watch.look(lines, now));
        cx.local.taps.open(open.bits());
        *cx.local.looks = cx.local.looks.wrapping_add(1);
        if *cx.local.looks == ROUND {
            *cx.local.looks = 0;
            rtic::pend(Interrupt::EXTI15_10);
        }
    }

    /// One frame in a job: while the FIFO holds another one, the interrupt stays pending.
    #[task(binds = CAN1_RX0, priority = 4, shared = [&clock, watch, lower], local = [can])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = Stamp(cx.shared.clock.now());
        if let Some(Received::Data(frame)) = cx.local.can.receive() {
            let evidence = cx.shared.watch.lock(|watch| watch.evidence());
            let lower = &mut cx.shared.lower;
            if lower.lock(|lower| lower.judge.receive(&frame, stamp, &evidence)) {
                rtic::pend(Interrupt::EXTI9_5);
            }
        }
    }

    #[task(binds = EXTI9_5, priority = 4, shared = [&clock, watch, lower])]
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

    #[task(binds = EXTI15_10, priority = 3, shared = [&clock, watch, lower], local = [rounds: u8 = 0])]
    fn rule(cx: rule::Context) {
        let (mut watch, mut lower) = (cx.shared.watch, cx.shared.lower);
        let news = watch.lock(Watch::news);
        let now = Stamp(cx.shared.clock.now());
        lower.lock(|lower| {
            lower.ruled = true;
            lower.judge.rule(&news, now);
        });
        *cx.local.rounds = cx.local.rounds.wrapping_add(1);
        if *cx.local.rounds == ROUNDS {
            *cx.local.rounds = 0;
            rtic::pend(Interrupt::EXTI9_5);
        }
        if cx.local.rounds.is_multiple_of(2) {
            rtic::pend(Interrupt::EXTI0);
        }
    }

    #[task(binds = EXTI0, priority = 2, shared = [&clock, watch, lower], local = [steps: u8 = 0])]
    fn account(cx: account::Context) {
        let (mut watch, mut lower) = (cx.shared.watch, cx.shared.lower);
        let driving = watch.lock(|watch| watch.driving());
        let now = Stamp(cx.shared.clock.now());
        let orders = lower.lock(|lower| lower.judge.account(driving, now));
        watch.lock(|watch| watch.obey(orders));
        *cx.local.steps = cx.local.steps.wrapping_add(1);
        if *cx.local.steps == STEPS {
            *cx.local.steps = 0;
            rtic::pend(Interrupt::EXTI2);
        }
    }

    #[task(binds = DMA1_STREAM6, priority = 2, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared.console.lock(Console::on_transfer_complete);
    }

    /// Locks the lower half for moments, because each delays a verdict.
    #[task(binds = EXTI2, priority = 1, shared = [lower, console], local = [reporter])]
    fn report(cx: report::Context) {
        let (mut lower, mut console) = (cx.shared.lower, cx.shared.console);
        let reporter = cx.local.reporter;
        let (ruled, state) = lower.lock(|lower| {
            let ruled = core::mem::take(&mut lower.ruled);
            (ruled, lower.judge.state())
        });
        if ruled {
            reporter.watchdog.feed();
        }
        reporter.led.set(state == GuardianState::InSchedule);
        reporter.steps = reporter.steps.wrapping_add(1);
        let mut line = Line::new();
        if reporter.steps.is_multiple_of(REPORTS) {
            guard::state(&mut line, state, &guarded::NAMES, reporter.told.counts());
        } else {
            // One node in each step, so that a step is short.
            let node = reporter.steps as usize % NODES;
            let trips: Trips = lower.lock(|lower| lower.judge.trips(node));
            let at_ms = reporter.steps.wrapping_mul(STEP_5_MS) / 5;
            if let Some(cut) = reporter.told.news(node, trips, at_ms)
                && let Some(name) = guarded::NAMES.get(node)
            {
                cut.log();
                guard::cut(&mut line, name, cut);
            }
        }
        if !line.as_bytes().is_empty() {
            console.lock(|console| console.push(line.as_bytes()));
        }
    }
}

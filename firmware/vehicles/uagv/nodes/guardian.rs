//! The bus guardian of the four nodes: it closes the gate of one that drives the bus where it may not. It is on
//! the bus only while `guardian.enabled` of the manifest is true. It sends nothing: its CAN controller only
//! acknowledges, and no task has a way to request a frame. `taps` of its board has its wiring, and
//! `ttcan::guardian` what it lets through.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `look` | TIM3 | 3 | every 8 us: looks at the TX lines, sets the gates |
//! | `can_rx` | receive FIFO 0 | 3 | stamps, tells the guardian of a frame |
//! | `console_dma` | DMA1 stream 6 | 2 | end of a console line |
//! | `SysTick` | SysTick | 2 | 100 Hz: the tick of `rtic-monotonics`, wakes `report` |
//! | `report` | software, by EXTI2 | 1 | 100 Hz: watchdog, LED; a line for each cut, and one each second |
//!
//! `report` feeds the watchdog only if there were looks since its step before: if they end, the watchdog
//! bites, and the gates open.

#![no_std]
#![no_main]

use defmt_rtt as _;

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2])]
mod app {
    use firmware::board::can::Received;
    use firmware::board::console::Console;
    use firmware::board::fault::Fault;
    use firmware::board::led::Led;
    use firmware::board::taps::Taps;
    use firmware::board::watchdog::Watchdog;
    use firmware::board::{self, CanPort, time::Clock};
    use firmware::console::Line;
    use firmware::guard::{self, Told, Trips};
    use firmware::node::{self, Pace};
    use firmware::{design, fault};
    use rtic::Mutex as _;
    use ttcan::guardian::{Guardian, GuardianConfig, GuardianState, Lines};
    use ttcan::{Micros, Stamp, StampLatency};
    use uagv::guarded;
    use uagv::matrix::{BIT_RATE, SCHEDULE};

    /// Guarded nodes, each at the tap of its place.
    const NODES: usize = guarded::NODES.len();
    /// Looks come every 8 us. This leaves 3 us for what delays one: the interrupt's entry, and a lock of
    /// `report`. A frame may delay it for longer, because the bus is at rest then.
    const INTERVAL: Micros = Micros::micros(11);
    /// Steps of `report` between two lines about the state: a second.
    const STEPS: u32 = 1000 / STEP_MS;
    /// Time between two steps of `report`, ms.
    const STEP_MS: u32 = design::HOUSEKEEPING_PERIOD.ticks();

    const _: () = assert!(
        NODES == board::FACTS.taps.len(),
        "each tap of the board has its node"
    );

    #[shared]
    struct Shared {
        guard: Guard,
        console: Console,
    }

    /// The guardian, and whether it has looked since the last step of `report`.
    pub struct Guard {
        guardian: Guardian<'static, NODES>,
        looked: bool,
    }

    #[local]
    struct Local {
        clock: Clock,
        received_at: Clock,
        can: CanPort,
        taps: Taps,
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
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let mut sled = uagv::start(cx.device);
        let ticks = sled.clocks.ticks_per_us;
        let bit = 1_000_000 * ticks / BIT_RATE;
        let config = GuardianConfig {
            receive_latency: StampLatency::bxcan(bit, board::FACTS.stamp_ticks).receive,
            ..GuardianConfig::new(ticks, INTERVAL)
        };
        let now = Stamp(sled.clock.now());
        let Ok(guardian) = Guardian::new(SCHEDULE.view(), config, guarded::NODES, now) else {
            fault::stop(Fault::Start)
        };
        let taps = sled.rest.taps();
        // Start-up is over, and with it all that it waited for.
        board::fault::passed();
        sled.watchdog.feed();
        node::start_tick(cx.core.SYST, &mut cx.core.SCB, sled.clocks.oscillator);
        let _ = report::spawn();
        (
            Shared {
                guard: Guard {
                    guardian,
                    looked: false,
                },
                console: sled.console,
            },
            Local {
                clock: sled.clock,
                received_at: sled.clock,
                can: sled.can,
                taps,
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

    #[task(binds = TIM3, priority = 3, shared = [guard], local = [clock, taps])]
    fn look(mut cx: look::Context) {
        let levels = cx.local.taps.look();
        let now = Stamp(cx.local.clock.now());
        let lines = Lines {
            dominant: levels.dominant,
            fell: levels.fell,
        };
        let open = cx.shared.guard.lock(|guard| {
            guard.looked = true;
            guard.guardian.look(lines, now)
        });
        cx.local.taps.open(open.bits());
    }

    /// One frame in a job: while the FIFO holds another one, the interrupt stays pending.
    #[task(binds = CAN1_RX0, priority = 3, shared = [guard], local = [received_at, can])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = Stamp(cx.local.received_at.now());
        if let Some(Received::Data(frame)) = cx.local.can.receive() {
            let guard = &mut cx.shared.guard;
            guard.lock(|guard| guard.guardian.handle_frame(&frame, stamp));
        }
    }

    #[task(binds = DMA1_STREAM6, priority = 2, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared.console.lock(Console::on_transfer_complete);
    }

    #[task(priority = 1, shared = [guard, console], local = [reporter])]
    async fn report(mut cx: report::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            tell(&mut cx.shared, cx.local.reporter);
            pace.wait().await;
        }
    }

    /// A step of `report`. It locks the guardian for moments, because each delays a look.
    fn tell(shared: &mut report::SharedResources<'_>, reporter: &mut Reporter) {
        let (looked, state) = shared.guard.lock(|guard| {
            let looked = core::mem::take(&mut guard.looked);
            (looked, guard.guardian.state())
        });
        if looked {
            reporter.watchdog.feed();
        }
        reporter.led.set(state == GuardianState::InSchedule);
        reporter.steps = reporter.steps.wrapping_add(1);
        let at_ms = reporter.steps.wrapping_mul(STEP_MS);
        // loop-bound: 4. One turn for each guarded node.
        for (node, name) in guarded::NAMES.iter().enumerate() {
            let trips: Trips = shared.guard.lock(|guard| guard.guardian.trips(node));
            if let Some(cut) = reporter.told.news(node, trips, at_ms) {
                cut.log();
                let mut line = Line::new();
                guard::cut(&mut line, name, cut);
                shared.console.lock(|console| console.push(line.as_bytes()));
            }
        }
        if reporter.steps.is_multiple_of(STEPS) {
            let mut line = Line::new();
            guard::state(&mut line, state, &guarded::NAMES, reporter.told.counts());
            shared.console.lock(|console| console.push(line.as_bytes()));
        }
    }
}

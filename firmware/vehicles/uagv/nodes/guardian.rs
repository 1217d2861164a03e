//! The bus guardian of the four nodes: it closes the gate of one that drives the bus where it may not. It is on
//! the bus only while `guardian.enabled` of the manifest is true. It sends nothing: its CAN controller only
//! acknowledges, and no task has a way to request a frame. `taps` of its board has its wiring, and
//! `ttcan::guardian` what it lets through.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `look` | TIM3 | 2 | every 8 us: looks at the TX lines, sets the gates |
//! | `can_rx` | receive FIFO 0 | 2 | stamps, tells the guardian of a frame |
//! | `console_dma` | DMA1 stream 6 | 1 | end of a console line |
//! | `idle` | | 0 | watchdog, LED; a line for each cut, and one each second |
//!
//! The looks wake `idle`, which feeds the watchdog: if they end, the watchdog bites, and the gates open.

#![no_std]
#![no_main]

use defmt_rtt as _;

#[rtic::app(device = firmware::board::pac, peripherals = true)]
mod app {
    use firmware::board::can::Received;
    use firmware::board::console::Console;
    use firmware::board::fault::Fault;
    use firmware::board::led::Led;
    use firmware::board::taps::Taps;
    use firmware::board::watchdog::Watchdog;
    use firmware::board::{self, CanPort, time::Clock};
    use firmware::console::Line;
    use firmware::fault;
    use firmware::guard::{self, Told};
    use ttcan::guardian::{Guardian, GuardianConfig, GuardianState, Lines};
    use ttcan::{Micros, Stamp, StampLatency};
    use uagv::guarded;
    use uagv::matrix::{BIT_RATE, SCHEDULE};

    /// Guarded nodes, each at the tap of its place.
    const NODES: usize = guarded::NODES.len();
    /// Looks come every 8 us. This leaves 3 us for what delays one: the interrupt's entry, and a lock of
    /// `idle`. A frame may delay it for longer, because the bus is at rest then.
    const INTERVAL: Micros = Micros::micros(11);
    /// Time between two steps of `idle`, ms.
    const STEP_MS: u32 = 10;
    /// Steps between two lines about the state: a second.
    const STEPS: u32 = 100;

    const _: () = assert!(
        NODES == board::FACTS.taps.len(),
        "each tap of the board has its node"
    );

    #[shared]
    struct Shared {
        guardian: Guardian<'static, NODES>,
        console: Console,
    }

    #[local]
    struct Local {
        clock: Clock,
        received_at: Clock,
        can: CanPort,
        taps: Taps,
        led: Led,
        watchdog: Watchdog,
        told: Told<NODES>,
        /// Ticks of the time base in a step of `idle`, and the stamp of the last one.
        step: u32,
        stepped: u32,
        time: Clock,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let sled = uagv::start(cx.device);
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
        (
            Shared {
                guardian,
                console: sled.console,
            },
            Local {
                clock: sled.clock,
                received_at: sled.clock,
                can: sled.can,
                taps,
                led: sled.led,
                watchdog: sled.watchdog,
                told: Told::new(),
                step: STEP_MS * 1000 * ticks,
                stepped: now.0,
                time: sled.clock,
            },
        )
    }

    #[task(binds = TIM3, priority = 2, shared = [guardian], local = [clock, taps])]
    fn look(mut cx: look::Context) {
        let levels = cx.local.taps.look();
        let now = Stamp(cx.local.clock.now());
        let lines = Lines {
            dominant: levels.dominant,
            fell: levels.fell,
        };
        let open = cx
            .shared
            .guardian
            .lock(|guardian| guardian.look(lines, now));
        cx.local.taps.open(open.bits());
    }

    /// One frame in a job: while the FIFO holds another one, the interrupt stays pending.
    #[task(binds = CAN1_RX0, priority = 2, shared = [guardian], local = [received_at, can])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = Stamp(cx.local.received_at.now());
        if let Some(Received::Data(frame)) = cx.local.can.receive() {
            let guardian = &mut cx.shared.guardian;
            guardian.lock(|guardian| guardian.handle_frame(&frame, stamp));
        }
    }

    #[task(binds = DMA1_STREAM6, priority = 1, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared.console.lock(Console::on_transfer_complete);
    }

    #[idle(shared = [guardian, console], local = [led, watchdog, told, step, stepped, time])]
    fn idle(mut cx: idle::Context) -> ! {
        let mut steps: u32 = 0;
        loop {
            cx.local.watchdog.feed();
            // The next look ends the wait.
            rtic::export::wfi();
            if cx.local.time.now().wrapping_sub(*cx.local.stepped) < *cx.local.step {
                continue;
            }
            *cx.local.stepped = cx.local.stepped.wrapping_add(*cx.local.step);
            steps = steps.wrapping_add(1);
            let guardian = &mut cx.shared.guardian;
            let state = guardian.lock(|guardian| guardian.state());
            cx.local.led.set(state == GuardianState::InSchedule);
            for (node, name) in guarded::NAMES.iter().enumerate() {
                let trips = guardian.lock(|guardian| guardian.trips(node));
                let at_ms = steps.wrapping_mul(STEP_MS);
                if let Some(cut) = cx.local.told.news(node, trips, at_ms) {
                    cut.log(name);
                    let mut line = Line::new();
                    guard::cut(&mut line, name, cut);
                    let console = &mut cx.shared.console;
                    console.lock(|console| console.push(line.as_bytes()));
                }
            }
            if steps.is_multiple_of(STEPS) {
                let mut line = Line::new();
                guard::state(&mut line, state, &guarded::NAMES, cx.local.told.counts());
                let console = &mut cx.shared.console;
                console.lock(|console| console.push(line.as_bytes()));
            }
        }
    }
}

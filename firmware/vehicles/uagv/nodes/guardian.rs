//! The bus guardian of the four nodes: it closes the gate of one that drives the bus where it may not.
//! It sends nothing; its CAN controller only acknowledges. [`board::taps`] has its wiring, and
//! `ttcan::guardian` what it lets through.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `look` | TIM3 | 2 | every 8 us: looks at the TX lines, sets the gates |
//! | `can_rx` | receive FIFO 0 | 2 | stamps, tells the guardian of each frame |
//! | `idle` | | 0 | watchdog, LED, a line to the log for each trip |

#![no_std]
#![no_main]

use defmt_rtt as _;

#[rtic::app(device = firmware::board::pac, peripherals = true)]
mod app {
    use firmware::board::can::Received;
    use firmware::board::fault::Fault;
    use firmware::board::led::Led;
    use firmware::board::taps::Taps;
    use firmware::board::watchdog::Watchdog;
    use firmware::board::{self, CanPort, time::Clock};
    use firmware::fault;
    use firmware::guard::Trips;
    use ttcan::guardian::{Guardian, GuardianConfig, GuardianState, Lines};
    use ttcan::{Micros, Stamp, StampLatency};
    use uagv::matrix::{BIT_RATE, CONTROLLER, DRIVE, GPS, SCHEDULE, STEERING};

    /// Guarded nodes. The line of the `k`-th is PC`k`, its gate PC`k + 6`.
    const NODES: usize = 4;
    /// Looks come every 8 us. This leaves 3 us for what delays one: the interrupt's entry, and a lock of
    /// `idle`. A frame may delay it for longer, because the bus is at rest then.
    const INTERVAL: Micros = Micros::micros(11);
    /// Frames that the receive FIFO holds.
    const FIFO: usize = 3;

    #[shared]
    struct Shared {
        guardian: Guardian<'static, NODES>,
    }

    #[local]
    struct Local {
        clock: Clock,
        received_at: Clock,
        can: CanPort,
        taps: Taps,
        led: Led,
        watchdog: Watchdog,
        trips: Trips<NODES>,
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
        let nodes = [GPS, CONTROLLER, STEERING, DRIVE];
        let now = Stamp(sled.clock.now());
        let Ok(guardian) = Guardian::new(SCHEDULE.view(), config, nodes, now) else {
            fault::stop(Fault::Start)
        };
        let taps = sled.rest.taps();
        // Start-up is over, and with it all that it waited for.
        board::fault::passed();
        (
            Shared { guardian },
            Local {
                clock: sled.clock,
                received_at: sled.clock,
                can: sled.can,
                taps,
                led: sled.led,
                watchdog: sled.watchdog,
                trips: Trips::new(),
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

    #[task(binds = CAN1_RX0, priority = 2, shared = [guardian], local = [received_at, can])]
    fn can_rx(mut cx: can_rx::Context) {
        let stamp = Stamp(cx.local.received_at.now());
        for _ in 0..FIFO {
            match cx.local.can.receive() {
                Some(Received::Data(frame)) => {
                    let guardian = &mut cx.shared.guardian;
                    guardian.lock(|guardian| guardian.handle_frame(&frame, stamp));
                }
                Some(Received::Remote(_)) => {}
                None => break,
            }
        }
    }

    #[idle(shared = [guardian], local = [led, watchdog, trips])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            cx.local.watchdog.feed();
            let state = cx.shared.guardian.lock(|guardian| guardian.state());
            cx.local.led.set(state == GuardianState::InSchedule);
            for node in 0..NODES {
                let trips = cx.shared.guardian.lock(|guardian| guardian.trips(node));
                cx.local.trips.tell(node, trips);
            }
        }
    }
}

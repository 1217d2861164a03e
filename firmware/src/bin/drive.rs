//! The drive node: runs the speed of message 300 on the drive motor.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 is the command's expiry |
//! | `actuate` | EXTI1, pended by software | 5 | commands, slew at 100 Hz, stops |
//! | `console_dma` | DMA1 channel 7 | 3 | next console line |
//! | `housekeeping` | software | 2 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `console` | software | 1 | 10 Hz lines |

#![no_std]
#![no_main]

use defmt_rtt as _;
use rtic_monotonics::systick::prelude::*;

systick_monotonic!(Mono, 100);

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2_TSC, EXTI3])]
mod app {
    use super::Mono;
    use firmware::actuator::{Driving, Times};
    use firmware::board::fault::Fault;
    use firmware::board::{
        self, Sled, led::Led, motor::MotorOutput, pac::Interrupt, time::Clock, watchdog::Watchdog,
    };
    use firmware::console::{self as lines, ActuatorView, BusView, Line};
    use firmware::housekeeping::Housekeeping;
    use firmware::link::Stack;
    use firmware::node::{self, BoardLink, Log};
    use firmware::{design, fault};
    use network::Message as _;
    use network::matrix::{DRIVE, window};
    use network::messages::DriveStatus;
    use rtic_monotonics::systick::prelude::*;

    #[shared]
    struct Shared {
        clock: Clock,
        link: BoardLink,
        driving: Driving,
        output: MotorOutput,
        console: board::console::Console,
    }

    #[local]
    struct Local {
        led: Led,
        watchdog: Watchdog,
        keeping: Housekeeping,
    }

    #[init(local = [stack: Option<Stack> = None])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let last_fault = board::fault::take();
        let Some(sled) = Sled::start(cx.device) else {
            fault::stop(Fault::Start)
        };
        let clocks = sled.clocks;
        let Ok(mut link) = node::link(
            cx.local.stack,
            DRIVE,
            clocks,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        defmt::info!(
            "drive: core {=u32} Hz, reset cause {=u8}",
            clocks.core,
            sled.reset_cause.code()
        );
        Mono::start(cx.core.SYST, clocks.core);
        link.start();
        let _ = (housekeeping::spawn(), console::spawn());
        (
            Shared {
                clock: sled.clock,
                link,
                driving: Driving::new(Times::new(clocks.ticks_per_us)),
                output: MotorOutput::new(sled.motor),
                console: sled.console,
            },
            Local {
                led: sled.led,
                watchdog: sled.watchdog.start(design::WATCHDOG.ticks() as u16),
                keeping: Housekeeping::new(sled.reset_cause, last_fault, clocks.oscillator),
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
        if news.has(window::COMMAND) {
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
            let expired = link.timer_mut().take_release();
            if link.timer_mut().take_window() {
                link.service();
            }
            expired || !link.node().is_alive()
        });
        if act {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = EXTI1, priority = 5, shared = [&clock, link, driving, output])]
    fn actuate(cx: actuate::Context) {
        let now = cx.shared.clock.now();
        let mut link = cx.shared.link;
        let (frame, time, alive) = link.lock(|link| {
            let frame = link.take(window::COMMAND);
            (frame, link.cycle_began(), link.commands_arrive())
        });
        let accepted = (cx.shared.driving, cx.shared.output).lock(|driving, output| {
            let accepted = frame
                .is_some_and(|frame| driving.supervised.receive(frame.data(), time, now).is_ok());
            driving.supervised.supervise(alive, now);
            output.repeat(driving.byte(now));
            accepted
        });
        if accepted {
            link.lock(|link| link.release_in(design::COMMAND_TIMEOUT));
        }
    }

    #[task(binds = DMA1_CH7, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    #[task(priority = 2, shared = [link], local = [led, watchdog, keeping])]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut due = Mono::now();
        loop {
            let bus = cx.shared.link.lock(|link| {
                link.keep_present();
                BusView::of(link)
            });
            // Also advances the slew.
            rtic::pend(Interrupt::EXTI1);
            let duties = cx.local.keeping.step(&bus, bus.link.services);
            if duties.feed {
                cx.local.watchdog.feed();
            }
            cx.local.led.set(duties.led);
            if let Some(data) = duties.report {
                let queued = cx
                    .shared
                    .link
                    .lock(|link| link.queue_event(DriveStatus::ID, &data, design::EVENT_LIFETIME));
                if queued.is_err() {
                    cx.local.keeping.report_refused();
                }
            }
            due += design::HOUSEKEEPING_PERIOD.convert();
            Mono::delay_until(due).await;
        }
    }

    #[task(priority = 1, shared = [link, driving, output, console])]
    async fn console(mut cx: console::Context) {
        let mut due = Mono::now();
        let mut log = Log::new();
        loop {
            let bus = cx.shared.link.lock(|link| BusView::of(link));
            log.bus(&bus);
            let byte = cx.shared.output.lock(|output| output.last());
            let view = cx.shared.driving.lock(|driving| ActuatorView {
                command: driving.supervised.command().map(|command| command.speed.0),
                count: None,
                byte,
                refused: driving.supervised.refused(),
            });
            let mut line = Line::new();
            lines::bus(&mut line, &bus);
            cx.shared
                .console
                .lock(|console| console.push(line.as_bytes()));
            line.clear();
            lines::actuator(&mut line, "drive", &view);
            cx.shared
                .console
                .lock(|console| console.push(line.as_bytes()));
            due += design::CONSOLE_PERIOD.convert();
            Mono::delay_until(due).await;
        }
    }
}

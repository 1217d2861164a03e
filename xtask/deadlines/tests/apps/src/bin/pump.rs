//! Hardware tasks, and a software task that waits by the SysTick of rtic-monotonics.

#![no_std]
#![no_main]

use portable_atomic as _;

#[rtic::app(device = apps, peripherals = false, dispatchers = [SOFT_A])]
mod app {
    use apps::{Interrupt, input, output, smoothed};
    use rtic_monotonics::systick::prelude::*;

    systick_monotonic!(Mono, 1000);

    #[shared]
    struct Shared {
        level: u32,
    }

    #[local]
    struct Local {
        history: [u32; 8],
        next: usize,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        Mono::start(cx.core.SYST, apps::CORE_HZ);
        rtic::pend(Interrupt::TIM_A);
        let _ = display::spawn();
        let local = Local {
            history: [0; 8],
            next: 0,
        };
        (Shared { level: 0 }, local)
    }

    /// Filters the level, and has it sent after each round of the history.
    #[task(binds = TIM_A, priority = 3, shared = [level], local = [history, next])]
    fn filter(mut cx: filter::Context) {
        let next = (*cx.local.next + 1) % 8;
        *cx.local.next = next;
        cx.local.history[next] = input();
        let level = smoothed(cx.local.history, 1);
        cx.shared.level.lock(|of_all| *of_all = level);
        if next == 0 {
            rtic::pend(Interrupt::UART);
        }
    }

    /// Sends the level.
    #[task(binds = UART, priority = 2, shared = [level])]
    fn send(mut cx: send::Context) {
        output(cx.shared.level.lock(|level| *level));
    }

    /// Shows the level.
    #[task(priority = 1, shared = [level])]
    async fn display(mut cx: display::Context) {
        // loop-bound: 1. Each turn ends in a delay, and a job ends before it does.
        loop {
            output(cx.shared.level.lock(|level| *level));
            Mono::delay(100.millis()).await;
        }
    }
}

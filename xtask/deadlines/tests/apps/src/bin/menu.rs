//! A software task that waits, in a program that also has a table of functions which no waker calls.

#![no_std]
#![no_main]

use portable_atomic as _;

#[rtic::app(device = apps, peripherals = false, dispatchers = [SOFT_A])]
mod app {
    use apps::{input, output};
    use rtic_monotonics::systick::prelude::*;

    #[cfg(not(feature = "v6"))]
    systick_monotonic!(Mono, 1000);
    #[cfg(feature = "v6")]
    systick_monotonic!(Mono, 500);

    /// What the operator may choose.
    static MENU: [fn(u32, u32); 4] = [show, scale, wait, wait_long];

    fn show(row: u32, column: u32) {
        output(row << 16 | column);
    }

    fn scale(row: u32, by: u32) {
        output(row * by);
    }

    /// It ends when the input says so.
    fn wait(mask: u32, wanted: u32) {
        while input() & mask != wanted {}
    }

    fn wait_long(mask: u32, wanted: u32) {
        wait(mask, wanted);
        wait(mask, !wanted);
    }

    #[shared]
    struct Shared {}

    #[local]
    struct Local {}

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        Mono::start(cx.core.SYST, apps::CORE_HZ);
        let _ = step::spawn();
        (Shared {}, Local {})
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            MENU[input() as usize % MENU.len()](input(), input());
        }
    }

    #[task(priority = 1)]
    async fn step(_: step::Context) {
        // loop-bound: 1. Each turn ends in a delay, and a job ends before it does.
        loop {
            output(input() >> 3);
            Mono::delay(10.millis()).await;
        }
    }
}

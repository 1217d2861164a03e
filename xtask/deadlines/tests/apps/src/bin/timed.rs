//! Software tasks that wait, by the SysTick of rtic-monotonics.

#![no_std]
#![no_main]

use portable_atomic as _;

#[rtic::app(device = apps, peripherals = false, dispatchers = [SOFT_A, SOFT_B])]
mod app {
    use apps::{input, output, smoothed};
    use rtic_monotonics::systick::prelude::*;

    #[cfg(not(feature = "v6"))]
    systick_monotonic!(Mono, 1000);
    #[cfg(feature = "v6")]
    systick_monotonic!(Mono, 500);

    #[shared]
    struct Shared {
        level: u32,
    }

    #[local]
    struct Local {}

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        Mono::start(cx.core.SYST, apps::CORE_HZ);
        let _ = fast::spawn();
        let _ = slow::spawn();
        (Shared { level: 0 }, Local {})
    }

    #[task(priority = 2, shared = [level])]
    async fn fast(mut cx: fast::Context) {
        // loop-bound: 1. Each turn ends in a delay, and a job ends before it does.
        loop {
            cx.shared.level.lock(|level| *level = input());
            Mono::delay(10.millis()).await;
        }
    }

    #[task(priority = 1, shared = [level])]
    async fn slow(mut cx: slow::Context) {
        // loop-bound: 1. Each turn ends in a delay, and a job ends before it does.
        loop {
            let level = cx.shared.level.lock(|level| *level);
            output(smoothed(&[level; 8], 3));
            Mono::delay(100.millis()).await;
        }
    }
}

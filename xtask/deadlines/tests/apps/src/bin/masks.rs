//! Locks within locks, for a core that masks single interrupts.

#![no_std]
#![no_main]

#[rtic::app(device = apps, peripherals = false)]
mod app {
    use apps::{input, output, smoothed};

    /// Rounds of what runs with the resource locked.
    const ROUNDS: u32 = 3;

    #[shared]
    struct Shared {
        fast: u32,
        slow: u32,
    }

    #[local]
    struct Local {}

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        (Shared { fast: 0, slow: 0 }, Local {})
    }

    #[task(binds = TIM_A, priority = 3, shared = [fast])]
    fn high(mut cx: high::Context) {
        cx.shared.fast.lock(|fast| *fast = input());
    }

    #[task(binds = TIM_B, priority = 2, shared = [slow])]
    fn middle(mut cx: middle::Context) {
        cx.shared.slow.lock(|slow| *slow = input());
    }

    #[task(binds = UART, priority = 1, shared = [fast, slow])]
    fn low(cx: low::Context) {
        let (mut fast, mut slow) = (cx.shared.fast, cx.shared.slow);
        fast.lock(|fast| {
            slow.lock(|slow| *slow = *fast);
            output(smoothed(&[*fast; 8], ROUNDS));
        });
    }
}

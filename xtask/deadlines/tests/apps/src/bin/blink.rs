//! One file, three hardware tasks that share samples, and one that a feature adds.

#![no_std]
#![no_main]

#[rtic::app(device = apps, peripherals = false)]
mod app {
    use apps::{Interrupt, input, output, smoothed};

    /// Rounds of the report's filter.
    const ROUNDS: u32 = 4;

    #[shared]
    struct Shared {
        samples: [u32; 8],
    }

    #[local]
    struct Local {
        next: usize,
    }

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        rtic::pend(Interrupt::TIM_A);
        (Shared { samples: [0; 8] }, Local { next: 0 })
    }

    #[task(binds = TIM_A, priority = 3, shared = [samples], local = [next])]
    fn sample(mut cx: sample::Context) {
        let next = (*cx.local.next + 1) % 8;
        *cx.local.next = next;
        cx.shared.samples.lock(|samples| samples[next] = input());
        if next == 0 {
            rtic::pend(Interrupt::UART);
        }
    }

    #[task(binds = TIM_B, priority = 2)]
    fn watch(_: watch::Context) {
        output(input() >> 3);
    }

    /// Sends what was sampled.
    /// deadline: every 8 ms, within 8 ms, after sample
    #[task(binds = UART, shared = [samples])]
    fn report(mut cx: report::Context) {
        let level = cx.shared.samples.lock(|samples| smoothed(samples, 1));
        output(level);
        let samples = cx.shared.samples.lock(|samples| *samples);
        output(smoothed(&samples, ROUNDS));
    }

    #[cfg(feature = "extra")]
    #[task(binds = ADC, priority = 3)]
    fn convert(_: convert::Context) {
        output(input());
    }
}

//! A node with three tasks that share their samples.

#![no_std]
#![no_main]

#[rtic::app(device = part, peripherals = false)]
mod app {
    use part::{Interrupt, checksum, input, output};

    /// Rounds of the report's checksum.
    const ROUNDS: u32 = 20;

    #[shared]
    struct Shared {
        samples: [u32; 16],
    }

    #[local]
    struct Local {
        next: usize,
        level: u32,
    }

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        for interrupt in [Interrupt::EXTI0, Interrupt::EXTI1, Interrupt::EXTI2] {
            rtic::pend(interrupt);
        }
        let shared = Shared { samples: [0; 16] };
        let local = Local {
            next: 0,
            level: 0xFFFF,
        };
        (shared, local)
    }

    #[task(binds = EXTI0, priority = 3, shared = [samples], local = [next])]
    fn sample(mut cx: sample::Context) {
        let next = (*cx.local.next + 1) % 16;
        *cx.local.next = next;
        cx.shared.samples.lock(|samples| samples[next] = input());
    }

    #[task(binds = EXTI1, priority = 2, shared = [samples], local = [level])]
    fn filter(mut cx: filter::Context) {
        let samples = cx.shared.samples.lock(|samples| *samples);
        let mut level = *cx.local.level;
        for sample in samples {
            level = level - level / 8 + sample / 8;
        }
        *cx.local.level = level;
        output(level);
    }

    #[task(binds = EXTI2, priority = 1, shared = [samples])]
    fn report(mut cx: report::Context) {
        // One sample more, which preempts it.
        rtic::pend(Interrupt::EXTI0);
        let samples = cx.shared.samples.lock(|samples| *samples);
        output(checksum(&samples, ROUNDS));
    }
}

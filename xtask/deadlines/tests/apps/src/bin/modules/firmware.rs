//! The application.

use rtic::app as firmware;

#[firmware(device = apps, peripherals = false, dispatchers = [SOFT_A, SOFT_B])]
mod app {
    use crate::tasks::{convert, handle, idle};
    use apps::Interrupt;

    #[shared]
    struct Shared {
        level: u32,
    }

    #[local]
    struct Local {}

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        rtic::pend(Interrupt::ADC);
        (Shared { level: 0 }, Local {})
    }

    extern "Rust" {
        #[idle(shared = [level])]
        fn idle(_: idle::Context) -> !;

        #[task(binds = ADC, priority = 3, shared = [level])]
        fn convert(_: convert::Context);

        #[task(priority = 2, shared = [level])]
        async fn handle(_: handle::Context, reading: u32);
    }
}

pub(crate) use app::{convert, handle, idle};

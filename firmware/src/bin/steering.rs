//! The steering node.

#![no_std]
#![no_main]

use defmt_rtt as _;
use rtic_monotonics::systick::prelude::*;

systick_monotonic!(Mono, 100);

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI0])]
mod app {
    use super::Mono;
    use firmware::board::{Sled, led::Led};
    use rtic_monotonics::systick::prelude::*;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        led: Led,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let sled = Sled::start(cx.device);
        Mono::start(cx.core.SYST, sled.clocks.core);
        let _ = blink::spawn();
        (Shared {}, Local { led: sled.led })
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        defmt::info!("steering");
        loop {
            rtic::export::wfi();
        }
    }

    #[task(priority = 1, local = [led])]
    async fn blink(cx: blink::Context) {
        let mut on = false;
        loop {
            on = !on;
            cx.local.led.set(on);
            Mono::delay(500.millis()).await;
        }
    }
}

//! A node that uses `ttcan` alone, on a Nucleo-F446RE with a CAN transceiver: CAN RX at PB8, CAN TX at
//! PB9. With PC0 at ground it is the echo, otherwise the master; so two boards with this image
//! are a network. `ttcan/HOWTO.md` leads through it.

#![no_std]
#![no_main]

mod bx_can;
mod mailbox;
mod network;

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use crate::bx_can::{BxCan, WindowTimer};
    use crate::network::{BIT_RATE, Driver, ECHO, MASTER, SCHEDULE};
    use stm32f4xx_hal::rcc::{Config, Enable};
    use stm32f4xx_hal::{can::CanExt, pac, prelude::*};
    use ttcan::{BitTiming, Frame, Node, NodeConfig, Reception, StampLatency, SyncState};

    /// Clock of the core and of the timer on APB1, and of APB1, MHz.
    const CORE_MHZ: u32 = 80;
    const APB1_MHZ: u32 = 40;
    const TICKS_PER_US: u32 = 20;
    const TIMING: BitTiming = BitTiming::constant::<{ APB1_MHZ * 1_000_000 }, BIT_RATE>();
    const BIT: u32 = TICKS_PER_US * 1_000_000 / BIT_RATE;
    /// From the end of a frame to the stamp in its interrupt, ticks: 32 cycles.
    const INTERRUPT: u32 = 8;
    /// From the window timer's compare to the frame on the bus, ticks: 8 us. The request comes behind
    /// less than 640 cycles, and the frame begins with the controller's next bit.
    const LEAD: u32 = 160;
    /// How long the node stays off the bus after S3, ticks: 1 s.
    const PAUSE: u32 = 1_000_000 * TICKS_PER_US;

    #[shared]
    struct Shared {
        // All tasks have one priority, so nothing needs a lock.
        #[lock_free]
        driver: Driver<BxCan>,
        #[lock_free]
        timer: WindowTimer,
        /// The message of this node's window.
        #[lock_free]
        message: Option<u32>,
    }

    #[local]
    struct Local {}

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let device = cx.device;
        let clocks = Config::hse(8.MHz()).bypass_hse_oscillator();
        let clocks = clocks.sysclk(CORE_MHZ.MHz()).pclk1(APB1_MHZ.MHz());
        let mut rcc = device.RCC.freeze(clocks);
        // The HAL sets the wait states, and leaves the flash without prefetch and caches.
        device.FLASH.acr().modify(|_, w| {
            w.prften().set_bit();
            w.icen().set_bit();
            w.dcen().set_bit()
        });
        enable::<pac::GPIOB>(&mut rcc);
        enable::<pac::GPIOC>(&mut rcc);
        enable::<pac::CAN1>(&mut rcc);
        enable::<pac::TIM2>(&mut rcc);
        let port_b = device.GPIOB.split(&mut rcc);
        let strap = device.GPIOC.split(&mut rcc).pc0.into_pull_up_input();
        let cell = device.CAN1.can((port_b.pb9, port_b.pb8), &mut rcc);
        let (id, message) = if strap.is_low() {
            (ECHO, None)
        } else {
            (MASTER, Some(0))
        };
        let config = NodeConfig {
            latency: StampLatency::bxcan(BIT, INTERRUPT),
            transmit_lead: LEAD,
            ..NodeConfig::new(id, TICKS_PER_US)
        };
        let Ok(mut node) = Node::new(SCHEDULE.view(), config) else {
            // The same configuration on every start: there is nothing to try again.
            loop {
                cortex_m::asm::wfi();
            }
        };
        let mut timer = WindowTimer::new(device.TIM2, (CORE_MHZ / TICKS_PER_US) as u16);
        node.start(timer.now());
        timer.set(timer.now());
        let driver = Driver::new(node, BxCan::new(cell, TIMING));
        (
            Shared {
                driver,
                timer,
                message,
            },
            Local {},
        )
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }

    /// Opens a clock gate. The part loses accesses that follow too soon (ES0298 2.2.7).
    fn enable<P: Enable>(rcc: &mut pac::RCC) {
        P::enable(rcc);
        cortex_m::asm::delay(16);
    }

    #[task(binds = CAN1_RX0, shared = [driver, timer, message])]
    fn received(cx: received::Context) {
        let stamp = cx.shared.timer.now();
        let driver = cx.shared.driver;
        if let Some(frame) = driver.controller.receive()
            && let Some(Reception::Scheduled { .. }) = driver.handle_receive(&frame, stamp)
            && driver.node.id() == ECHO
            && let Some(frame) = Frame::from_can(&frame)
        {
            // The node has taken it, so it has the four bytes of its window. The driver's own way to
            // the data could panic.
            let [a, b, c, d, ..] = frame.buffer();
            *cx.shared.message = Some(u32::from_le_bytes([a, b, c, d]));
        }
        if let Some(deadline) = driver.next_deadline(stamp) {
            cx.shared.timer.set(deadline);
        }
    }

    #[task(binds = CAN1_TX, shared = [driver, timer])]
    fn transmitted(cx: transmitted::Context) {
        let stamp = cx.shared.timer.now();
        let driver = cx.shared.driver;
        if let Some(outcome) = driver.controller.outcome() {
            driver.handle_transmit(outcome, stamp);
        }
        if let Some(deadline) = driver.next_deadline(stamp) {
            cx.shared.timer.set(deadline);
        }
    }

    #[task(binds = TIM2, shared = [driver, timer, message])]
    fn window_timer(cx: window_timer::Context) {
        let timer = cx.shared.timer;
        let driver = cx.shared.driver;
        timer.acknowledge();
        let now = timer.now();
        if driver.controller.is_bus_off() {
            driver.node.handle_bus_off();
        }
        if driver.node.status().sync == SyncState::Off && !driver.node.is_due(now) {
            // The pause is over.
            driver.controller.join();
            driver.node.start(now);
        }
        let leads = driver.node.id() == MASTER;
        let message = cx.shared.message;
        driver.handle_timer(now, |_| {
            let number = message.as_mut()?;
            if leads {
                *number = number.wrapping_add(1);
            }
            let [a, b, c, d] = number.to_le_bytes();
            Some([a, b, c, d, 0, 0, 0, 0])
        });
        timer.set(driver.next_deadline(now).unwrap_or(now.after(PAUSE)));
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

//! Software tasks that wait, by a monotonic of a timer with a compare register, as those of rtic-monotonics
//! for the STM32, the nRF52 and the RP2040.

#![no_std]
#![no_main]

use core::ptr::{read_volatile, write_volatile};

use fugit::{TimerDurationU32, TimerInstantU32};
use rtic_time::monotonic::TimerQueueBasedMonotonic;
use rtic_time::timer_queue::{TimerQueue, TimerQueueBackend};

use apps::Interrupt;

use portable_atomic as _;

/// Registers of the timer: count, compare value, flags.
const COUNT: *mut u32 = 0x4000_0024 as *mut u32;
const COMPARE: *mut u32 = 0x4000_0034 as *mut u32;
const FLAGS: *mut u32 = 0x4000_0010 as *mut u32;

static QUEUE: TimerQueue<Timer> = TimerQueue::new();

/// The timer.
pub struct Timer;

impl TimerQueueBackend for Timer {
    type Ticks = u32;

    fn now() -> u32 {
        // SAFETY: a register that may be read at any time.
        unsafe { read_volatile(COUNT) }
    }

    fn set_compare(instant: u32) {
        // SAFETY: a register of this timer.
        unsafe { write_volatile(COMPARE, instant) }
    }

    fn clear_compare_flag() {
        // SAFETY: a register of this timer.
        unsafe { write_volatile(FLAGS, !2) }
    }

    fn pend_interrupt() {
        cortex_m::peripheral::NVIC::pend(Interrupt::TIM_A);
    }

    fn timer_queue() -> &'static TimerQueue<Self> {
        &QUEUE
    }
}

/// Time in microseconds.
pub struct Mono;

impl TimerQueueBasedMonotonic for Mono {
    type Backend = Timer;
    type Instant = TimerInstantU32<1_000_000>;
    type Duration = TimerDurationU32<1_000_000>;
}

impl Mono {
    /// Starts it, at the priority that RTIC gives to monotonics.
    pub fn start(nvic: &mut cortex_m::peripheral::NVIC) {
        unsafe extern "C" {
            static RTIC_ASYNC_MAX_LOGICAL_PRIO: u8;
        }
        QUEUE.initialize(Timer);
        // SAFETY: RTIC defines it, and nothing else is bound to the interrupt.
        unsafe {
            let priority = RTIC_ASYNC_MAX_LOGICAL_PRIO.max(1).min(1 << apps::NVIC_PRIO_BITS);
            let value = ((1 << apps::NVIC_PRIO_BITS) - priority) << (8 - apps::NVIC_PRIO_BITS);
            nvic.set_priority(Interrupt::TIM_A, value);
            cortex_m::peripheral::NVIC::unmask(Interrupt::TIM_A);
        }
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn TIM_A() {
    // SAFETY: it is the handler of the timer's interrupt.
    unsafe { QUEUE.on_monotonic_interrupt() }
}

#[rtic::app(device = apps, peripherals = false, dispatchers = [SOFT_A])]
mod app {
    use super::Mono;
    use apps::{input, output};
    use fugit::ExtU32 as _;
    use rtic_time::Monotonic as _;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {}

    #[init]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        Mono::start(&mut cx.core.NVIC);
        let _ = step::spawn();
        (Shared {}, Local {})
    }

    #[task(binds = UART, priority = 3)]
    fn receive(_: receive::Context) {
        output(input());
    }

    #[task(priority = 1)]
    async fn step(_: step::Context) {
        // loop-bound: 1. Each turn ends in a delay, and a job ends before it does.
        loop {
            output(input() / 3);
            Mono::delay(5.millis()).await;
        }
    }
}

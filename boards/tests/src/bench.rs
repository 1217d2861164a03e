//! What every test begins with: a started board, and a way to measure time on it.

use crate::board::{self, Sled};
use cortex_m::peripheral::{DCB, DWT, NVIC};
use defmt::info;

/// The watchdog's time, ms: longer than any test.
const WATCHDOG_MS: u16 = 20_000;

/// Bit rate of the CAN controller, bit/s.
pub(crate) const BIT_RATE: u32 = 250_000;

/// A started board.
pub(crate) struct Bench {
    pub(crate) sled: Sled,
}

impl Bench {
    /// Starts the board as each node does.
    pub(crate) fn start() -> Self {
        start_cycle_counter();
        let device = board::pac::Peripherals::take().expect("the first call");
        match Sled::start::<BIT_RATE>(device, WATCHDOG_MS) {
            Ok(sled) => {
                info!("{} {}", sled.reset_cause, sled.clocks.oscillator);
                Self { sled }
            }
            Err(fault) => panic!("the board does not start: {fault:?}"),
        }
    }

    /// The time now, in ticks of the time base.
    pub(crate) fn now(&self) -> u32 {
        self.sled.clock.now()
    }

    /// Ticks of the time base in so many microseconds.
    pub(crate) fn ticks(&self, us: u32) -> u32 {
        us * self.sled.clocks.ticks_per_us
    }

    /// Core cycles in so many microseconds.
    pub(crate) fn cycles(&self, us: u32) -> u32 {
        us * (self.sled.clocks.core / 1_000_000)
    }

    /// Ticks of the time base in a bit on the CAN bus.
    pub(crate) fn bit(&self) -> u32 {
        self.ticks(1_000_000) / BIT_RATE
    }

    /// Waits.
    pub(crate) fn pause(&self, us: u32) {
        let since = self.now();
        while self.now().wrapping_sub(since) < self.ticks(us) {}
    }

    /// Waits until `done` returns true. False if that takes longer than `us`.
    pub(crate) fn wait(&self, us: u32, mut done: impl FnMut() -> bool) -> bool {
        let since = self.now();
        loop {
            if done() {
                return true;
            }
            if self.now().wrapping_sub(since) > self.ticks(us) {
                return false;
            }
        }
    }
}

/// Lets an interrupt through to its handler in this crate.
pub(crate) fn enable(interrupt: board::pac::Interrupt) {
    // SAFETY: no test relies on the interrupt being masked.
    unsafe { NVIC::unmask(interrupt) };
}

/// Starts the counter of core cycles.
pub(crate) fn start_cycle_counter() {
    // SAFETY: only the tests use the trace unit of this part.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    DCB::enable_trace(&mut core.DCB);
    DWT::enable_cycle_counter(&mut core.DWT);
}

/// The counter of core cycles.
#[inline(always)]
pub(crate) fn cycle() -> u32 {
    DWT::cycle_count()
}

/// Logs a figure, and fails unless it is within `tolerance` of what is expected.
#[track_caller]
pub(crate) fn near(what: &str, measured: u32, expected: u32, tolerance: u32) {
    info!(
        "{=str}: {=u32}, expected {=u32} +- {=u32}",
        what, measured, expected, tolerance
    );
    assert!(
        measured.abs_diff(expected) <= tolerance,
        "{what}: {measured} instead of {expected} +- {tolerance}"
    );
}

//! The clock tree: where the clock comes from, its rate, and how it is divided.

use crate::bench::{Bench, cycle, near, start_cycle_counter};
use crate::board::{FACTS, clock::Oscillator};
use crate::registers::{flash, iwdg, rcc};

const CR: u32 = 0x00;
/// CR: the external clock is ready; the clock security system is on; the PLL is ready.
const CR_HSERDY: u32 = 1 << 17;
const CR_CSSON: u32 = 1 << 19;
const CR_PLLRDY: u32 = 1 << 25;

#[cfg(feature = "f446")]
mod fields {
    /// RCC_CFGR, RCC_CSR; position of the prescalers of APB1 and APB2 (RM0390 6.3).
    pub(super) const CFGR: u32 = 0x08;
    pub(super) const CSR: u32 = 0x74;
    pub(super) const APB: [u32; 2] = [10, 13];
}
#[cfg(feature = "f303")]
mod fields {
    /// The same (RM0316 9.4).
    pub(super) const CFGR: u32 = 0x04;
    pub(super) const CSR: u32 = 0x24;
    pub(super) const APB: [u32; 2] = [8, 11];
}

/// Divider that a prescaler field of a peripheral bus stands for.
fn divider(field: u32) -> u32 {
    match field & 0b111 {
        code @ 0b100.. => 2 << (code & 0b11),
        _ => 1,
    }
}

/// Core cycles in which the watchdog takes over a new reload value, on average over a few: some
/// cycles of the low-speed oscillator, the same number each time.
fn update_cycles() -> u32 {
    const KEY: u32 = 0x00;
    const PRESCALER: u32 = 0x04;
    const RELOAD: u32 = 0x08;
    const STATUS: u32 = 0x0C;
    const UPDATES: u32 = 8;
    /// Longer than five cycles of the slowest oscillator at the fastest core.
    const PATIENCE: u32 = 100_000;
    rcc().set(fields::CSR, 1);
    let settle = || {
        let since = cycle();
        while iwdg().read(STATUS) != 0 {
            let waited = cycle().wrapping_sub(since);
            assert!(waited < PATIENCE, "the watchdog has no clock");
        }
    };
    iwdg().write(KEY, 0xCCCC);
    settle();
    iwdg().write(KEY, 0x5555);
    iwdg().write(PRESCALER, 0);
    iwdg().write(RELOAD, 0xFFF);
    settle();
    let since = cycle();
    for _ in 0..UPDATES {
        iwdg().write(RELOAD, 0xFFF);
        settle();
    }
    let took = cycle().wrapping_sub(since) / UPDATES;
    iwdg().write(KEY, 0xAAAA);
    took
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn the_external_clock_drives_the_core() {
        let bench = Bench::start();
        assert!(
            bench.sled.clocks.oscillator == Oscillator::External,
            "no external clock: the node runs on its internal oscillator"
        );
        let on = CR_HSERDY | CR_CSSON | CR_PLLRDY;
        assert!(rcc().read(CR) & on == on, "clock, security system, PLL");
        assert!(rcc().read(fields::CFGR) >> 2 & 0b11 == 0b10, "not the PLL");
    }

    /// The low-speed oscillator is the same before and after the start; so the ratio of the two
    /// figures is that of the core's clocks. The internal oscillator is good to 5 % over all
    /// temperatures (data sheets).
    #[test]
    fn the_core_is_as_fast_as_the_internal_oscillator_says() {
        start_cycle_counter();
        let before = update_cycles();
        let bench = Bench::start();
        let after = update_cycles();
        let internal = FACTS.part.hsi.hz / 1000;
        let core = bench.sled.clocks.core / 1000;
        defmt::info!(
            "an update of the watchdog takes {} us",
            before / (internal / 1000)
        );
        let measured = u64::from(internal) * u64::from(after) / u64::from(before.max(1));
        near("core clock, kHz", measured as u32, core, core / 18);
    }

    #[test]
    fn the_time_base_divides_the_clock_of_the_core() {
        let bench = Bench::start();
        const US: u32 = 10_000;
        let since = bench.now();
        let begin = cycle();
        while bench.now().wrapping_sub(since) < bench.ticks(US) {}
        let took = cycle().wrapping_sub(begin);
        near("core cycles in 10 ms", took, bench.cycles(US), 100);
    }

    #[test]
    fn buses_and_flash_suit_the_clock_of_the_core() {
        let bench = Bench::start();
        let clocks = bench.sled.clocks;
        let cfgr = rcc().read(fields::CFGR);
        assert!(cfgr >> 7 & 1 == 0, "AHB is divided");
        let [apb1, apb2] = fields::APB.map(|at| clocks.core / divider(cfgr >> at));
        near("APB1, Hz", apb1, clocks.apb1, 0);
        near("APB2, Hz", apb2, clocks.apb2, 0);
        let states = FACTS.part.flash_access.wait_states(clocks.core);
        let states = states.map_or(u32::MAX, u32::from);
        near("wait states", flash().read(0) & 0b111, states, 0);
    }
}

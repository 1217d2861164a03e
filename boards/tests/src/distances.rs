//! Bursts of the distance sensors' converter. The means are those of the voltages at PA1 and PA3,
//! whatever these are.

use crate::bench::{Bench, near};
use crate::board::burst::Means;
use crate::board::distances::{Distances, Trigger};
use crate::registers::converter_dma;

/// Core cycles of a burst: 100 conversions of 61.5 + 12.5 cycles of the converter's clock, which is
/// half the core's.
const BURST_CYCLES: u32 = 100 * 74 * 2;

/// The flag of a complete transfer of DMA channel 1.
const COMPLETE: u32 = 1 << 1;

/// Starts the converter. The rest of the board goes with it.
fn start(bench: Bench, trigger: Trigger) -> Distances {
    let distances = bench.sled.rest.distances(trigger);
    distances.expect("the converter")
}

/// Waits for the end of a burst, for at most `patience` ticks, and returns when it was.
fn end(clock: crate::board::time::Clock, patience: u32) -> u32 {
    let since = clock.now();
    while converter_dma().read(0) & COMPLETE == 0 {
        let waited = clock.now().wrapping_sub(since);
        assert!(waited < patience, "the burst does not end");
    }
    clock.now()
}

/// Logs the means, in sixteenths of a count.
fn log(means: Means) {
    defmt::info!(
        "left {=u16}, right {=u16}",
        means.left.sixteenths(),
        means.right.sixteenths()
    );
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;
    use crate::board::burst::{BurstError, Mean};

    #[test]
    fn a_burst_by_software_takes_its_time_and_gives_both_means() {
        let bench = Bench::start();
        let clock = bench.sled.clock;
        let expected = (u64::from(BURST_CYCLES) * u64::from(bench.ticks(1_000_000))
            / u64::from(bench.sled.clocks.core)) as u32;
        let tolerance = bench.ticks(4);
        let mut distances = start(bench, Trigger::Software);
        assert!(distances.take() == Err(BurstError::Unfinished), "no burst");
        for _ in 0..3 {
            let since = clock.now();
            assert!(distances.begin() == Ok(()), "the burst does not begin");
            let took = end(clock, expected + expected / 2).wrapping_sub(since);
            near("ticks of a burst", took, expected, tolerance);
            let means = distances.take().expect("the means");
            log(means);
            assert!(means.left <= Mean::FULL_SCALE && means.right <= Mean::FULL_SCALE);
            assert!(converter_dma().read(0) & COMPLETE == 0, "not acknowledged");
        }
    }

    /// A burst whose end nobody takes, and one that is given up in its middle.
    #[test]
    fn a_burst_that_is_begun_again_tells_and_ends() {
        let bench = Bench::start();
        let clock = bench.sled.clock;
        let (burst, patience) = (bench.ticks(100), bench.ticks(500));
        let mut distances = start(bench, Trigger::Software);
        for wait in [patience, burst] {
            assert!(distances.begin() == Ok(()), "the burst does not begin");
            let since = clock.now();
            while clock.now().wrapping_sub(since) < wait {}
            let before = distances.begin();
            assert!(before == Err(BurstError::Unfinished), "{before:?}");
            end(clock, patience);
            log(distances.take().expect("the means"));
        }
    }

    #[test]
    fn the_timer_begins_bursts_at_its_rate() {
        use crate::board::distances::BURST_HZ;
        let bench = Bench::start();
        let clock = bench.sled.clock;
        let period = bench.ticks(1_000_000) / BURST_HZ;
        let mut distances = start(bench, Trigger::Timer);
        let mut last = None;
        for _ in 0..5 {
            let ended = end(clock, 2 * period);
            log(distances.take().expect("the means"));
            assert!(distances.watch() == Ok(()), "a burst has ended");
            if let Some(last) = last.replace(ended) {
                let between = ended.wrapping_sub(last);
                near("ticks between bursts", between, period, period / 500);
            }
        }
        let watched = distances.watch();
        assert!(watched == Err(BurstError::Unfinished), "{watched:?}");
        end(clock, 2 * period);
        log(distances.take().expect("the means"));
    }
}

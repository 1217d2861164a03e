//! The time base: the alarms of TIM2 fire at their instant.

use crate::bench::{Bench, enable, near};
use crate::board::FACTS;
use crate::board::pac::Interrupt;
use crate::registers::tim2;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

const SR: u32 = 0x10;
const CNT: u32 = 0x24;
/// SR: compare flags of the two channels.
const WINDOW: u32 = 1 << 1;
const RELEASE: u32 = 1 << 2;
const FLAGS: u32 = 0x1E5F;

/// When the last alarm fired, which ones fired, and how often.
static STAMP: AtomicU32 = AtomicU32::new(0);
static FIRED: AtomicU32 = AtomicU32::new(0);
static COUNT: AtomicU32 = AtomicU32::new(0);

// SAFETY: the name is the one that the part's vector table asks for.
#[unsafe(export_name = "TIM2")]
extern "C" fn alarm() {
    let stamp = tim2().read(CNT);
    let flags = tim2().read(SR) & (WINDOW | RELEASE);
    tim2().write(SR, FLAGS & !flags);
    STAMP.store(stamp, Relaxed);
    FIRED.store(flags, Relaxed);
    COUNT.store(COUNT.load(Relaxed) + 1, Relaxed);
}

/// A board whose alarms interrupt. The compare registers are zero after a reset, so both flags may
/// stand since the counter has started there; the protocol stack takes such an alarm for one that
/// came too early, and does nothing.
fn with_alarms() -> Bench {
    let bench = Bench::start();
    tim2().write(SR, FLAGS & !(WINDOW | RELEASE));
    enable(Interrupt::TIM2);
    bench
}

/// Ticks from the compare to its stamp at most: the entry of the interrupt, as for a frame, and
/// half as much again.
fn latency() -> u32 {
    FACTS.stamp_ticks * 3 / 2
}

/// Checks the stamp of an alarm at `instant`.
#[track_caller]
fn on_time(stamp: u32, instant: u32) {
    let half = latency() / 2;
    near(
        "ticks after the instant",
        stamp.wrapping_sub(instant),
        half,
        half,
    );
}

/// Waits for the next alarm, and returns which channels fired and when.
fn next(bench: &Bench, before: u32, us: u32) -> (u32, u32) {
    let fired = bench.wait(us, || COUNT.load(Relaxed) != before);
    assert!(fired, "no alarm in {us} us");
    (FIRED.load(Relaxed), STAMP.load(Relaxed))
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn an_alarm_fires_at_its_instant() {
        let mut bench = with_alarms();
        for us in [5, 20, 333, 4_000] {
            let before = COUNT.load(Relaxed);
            let instant = bench.now().wrapping_add(bench.ticks(us));
            bench.sled.alarms.set_window(instant);
            let (channels, stamp) = next(&bench, before, 10_000);
            near("channel", channels & WINDOW, WINDOW, 0);
            on_time(stamp, instant);
        }
    }

    #[test]
    fn an_alarm_in_the_past_fires_at_once() {
        let mut bench = with_alarms();
        for us in [0, 1, 50, 1_000_000] {
            let before = COUNT.load(Relaxed);
            let asked = bench.now();
            let instant = asked.wrapping_sub(bench.ticks(us));
            bench.sled.alarms.set_window(instant);
            let (_, stamp) = next(&bench, before, 1000);
            let late = stamp.wrapping_sub(asked);
            // The call itself takes about as long as the entry of the interrupt.
            near("ticks after the call", late, latency(), latency() + 4);
        }
    }

    #[test]
    fn an_alarm_fires_across_the_wrap_of_the_counter() {
        let mut bench = with_alarms();
        tim2().write(CNT, bench.ticks(100).wrapping_neg());
        let instant = bench.ticks(100);
        bench.sled.alarms.set_window(instant);
        let (_, stamp) = next(&bench, 0, 1000);
        on_time(stamp, instant);
    }

    #[test]
    fn a_cleared_alarm_stays_silent_and_the_other_one_fires() {
        let mut bench = with_alarms();
        let since = bench.now();
        let window = since.wrapping_add(bench.ticks(200));
        let release = since.wrapping_add(bench.ticks(400));
        bench.sled.alarms.set_window(window);
        bench.sled.alarms.set_release(release);
        bench.sled.alarms.clear_window();
        let (channels, stamp) = next(&bench, 0, 1000);
        assert!(channels & RELEASE != 0, "the second channel did not fire");
        on_time(stamp, release);
        bench.pause(500);
        near("alarms", COUNT.load(Relaxed), 1, 0);
    }
}

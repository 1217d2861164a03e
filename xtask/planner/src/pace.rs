//! How fast the time of a bus goes.

use std::collections::VecDeque;
use std::time::Duration;

use super::Slot;

/// References by which the pace is measured: about a second of the bus.
const REFERENCES: usize = 10;

/// A gap between two references after which the measurement begins anew: the bus stood still meanwhile.
const GAP: Duration = Duration::from_secs(1);

/// Slowest and fastest bus, in time of the computer for that of the bus.
const RANGE: (f64, f64) = (0.1, 100.0);

/// The pace of a bus beside the clock of a computer, by the references that are heard. On a real bus both are the same; a
/// simulation that does not keep up, or runs with `--real-time=0.5`, takes more time for each cycle, and a command that counted
/// the computer's time would come before its window.
#[derive(Clone, Debug, Default)]
pub struct Pace {
    /// Time of the computer and of the bus at each reference.
    heard: VecDeque<(Duration, Duration)>,
}

impl Pace {
    /// How long to wait from now, when a reference has been heard, until its command may be sent. `now` is a clock of the computer
    /// that only goes on. `None` until the pace is known, a second of the bus after the first reference.
    pub fn wait(&mut self, now: Duration, slot: &Slot) -> Option<Duration> {
        let last = self.heard.back();
        let goes_on = last.is_none_or(|(clock, time)| {
            now >= *clock && slot.time > *time && slot.time - *time < GAP
        });
        if !goes_on {
            self.heard.clear();
        }
        self.heard.push_back((now, slot.time));
        if self.heard.len() <= REFERENCES {
            return None;
        }
        let (clock, time) = self.heard.pop_front()?;
        let factor = (now - clock).as_secs_f64() / (slot.time - time).as_secs_f64();
        let (least, most) = RANGE;
        Some(slot.earliest.mul_f64(factor.clamp(least, most)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slot(time: u64) -> Slot {
        Slot {
            time: Duration::from_millis(time),
            earliest: Duration::from_millis(40),
            latest: Duration::from_millis(55),
        }
    }

    /// The wait after the last of so many cycles of 100 ms, each of which takes `cycle` ms of the computer.
    fn waited(pace: &mut Pace, from: u64, cycles: u64, cycle: u64) -> Option<Duration> {
        let waits = (from..from + cycles)
            .map(|count| pace.wait(Duration::from_millis(count * cycle), &slot(count * 100)));
        waits.last().flatten()
    }

    #[test]
    fn a_command_comes_in_the_time_of_its_bus() {
        for (cycle, wait) in [(100, 40), (200, 80), (50, 20), (1000, 400)] {
            let waited = waited(&mut Pace::default(), 1, 30, cycle);
            assert_eq!(waited, Some(Duration::from_millis(wait)), "{cycle} ms");
        }
    }

    #[test]
    fn nothing_is_sent_before_the_pace_is_known() {
        let mut pace = Pace::default();
        assert_eq!(waited(&mut pace, 1, 10, 100), None);
        assert!(waited(&mut pace, 11, 1, 100).is_some());
        // A time master that starts anew.
        assert_eq!(pace.wait(Duration::from_secs(5), &slot(0)), None);
    }
}

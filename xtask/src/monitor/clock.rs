//! The clock of the time stamps beside that of the computer.

use std::time::Duration;

/// Below such a time nothing is said of how fast the bus runs.
const SOON: Duration = Duration::from_secs(2);
/// A shorter one tells nothing of it.
const SHORT: Duration = Duration::from_millis(300);

/// A frame: its time stamp, and when it was read.
#[derive(Clone, Copy, Debug)]
struct Heard {
    stamp: Duration,
    read: Duration,
}

/// Follows the clock of the time stamps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clock {
    /// The first and the last frame.
    span: Option<(Heard, Heard)>,
}

impl Clock {
    /// A frame with that stamp was read at `read`.
    pub(super) fn heard(&mut self, stamp: Duration, read: Duration) {
        let last = Heard { stamp, read };
        let first = self.span.map_or(last, |(first, _)| first);
        self.span = Some((first, last));
    }

    /// What the clock of the stamps shows when that of the computer shows `now`. Since the last frame it has
    /// gone on as fast as before, and no faster than time.
    pub(super) fn now(&self, now: Duration) -> Duration {
        self.span.map_or(now, |(_, last)| {
            let since = now.saturating_sub(last.read);
            last.stamp + since.mul_f64(self.measured(SHORT).unwrap_or(1.0).min(1.0))
        })
    }

    /// How fast it runs against the computer's; `None` at first.
    pub(super) fn pace(&self) -> Option<f64> {
        self.measured(SOON)
    }

    /// The same, if it was measured over so long a time.
    fn measured(&self, least: Duration) -> Option<f64> {
        let (first, last) = self.span?;
        let read = last.read.saturating_sub(first.read);
        let stamped = last.stamp.saturating_sub(first.stamp);
        (read >= least).then(|| stamped.as_secs_f64() / read.as_secs_f64())
    }
}

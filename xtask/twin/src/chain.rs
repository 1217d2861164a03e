//! From a rover's distance sensors to its motors: when distances were sampled, and when the pulses of
//! the motor drivers began.

use can_bus::{SimDuration, SimTime};
use world::rover::Side;

/// The ends of the chain from sensor to motor, in order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chain {
    /// When bursts of samples of the distance sensors began.
    pub samples: Vec<SimTime>,
    /// When pulses of a motor driver began, and on which side.
    pub pulses: Vec<(SimTime, Side)>,
}

/// A pulse and the samples before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Latency {
    /// When the pulse began.
    pub pulse: SimTime,
    /// Its side.
    pub side: Side,
    /// Time since the last burst before it began.
    pub since_sample: SimDuration,
}

impl Chain {
    /// For each pulse, the time since the last burst of samples that began before it. That is the
    /// latency from sample to pulse if each burst leads to a pulse before the next one begins.
    pub fn latencies(&self) -> impl Iterator<Item = Latency> {
        self.pulses.iter().filter_map(|&(pulse, side)| {
            let after = self.samples.partition_point(|sample| *sample <= pulse);
            let sample = self.samples.get(after.checked_sub(1)?)?;
            let since_sample = pulse.as_ticks() - sample.as_ticks();
            Some(Latency {
                pulse,
                side,
                since_sample: SimDuration::from_ticks(since_sample),
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_belongs_to_the_burst_before_it() {
        let at = SimTime::from_ticks;
        let chain = Chain {
            samples: vec![at(100), at(200), at(300)],
            pulses: vec![
                (at(99), Side::Left),
                (at(150), Side::Left),
                (at(200), Side::Right),
                (at(460), Side::Left),
            ],
        };
        let found: Vec<_> = chain
            .latencies()
            .map(|one| (one.pulse.as_ticks(), one.side, one.since_sample.as_ticks()))
            .collect();
        assert_eq!(
            found,
            [
                (150, Side::Left, 50),
                (200, Side::Right, 0),
                (460, Side::Left, 160)
            ]
        );
    }
}

//! From a rover's distance sensors to its motors: when distances were sampled, which frames carried
//! them and the command, and when the pulses of the motor drivers began.

use can_bus::{SimDuration, SimTime};
use world::rover::Side;

/// The ends of the chain from sensor to motor and the frames between them, in order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chain {
    /// When bursts of samples of the distance sensors began.
    pub samples: Vec<SimTime>,
    /// The complete frames of the messages that the command needs first.
    pub distances: Vec<OnWire>,
    /// The complete frames of the command.
    pub commands: Vec<OnWire>,
    /// When pulses of a motor driver began, and on which side.
    pub pulses: Vec<(SimTime, Side)>,
}

/// A frame on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OnWire {
    /// Its start of frame.
    pub start: SimTime,
    /// Its last bit.
    pub end: SimTime,
}

/// A pulse and the samples before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Latency {
    /// When the pulse began.
    pub pulse: SimTime,
    /// Its side.
    pub side: Side,
    /// Time since the burst began that it follows from.
    pub since_sample: SimDuration,
}

impl Chain {
    /// For the first pulse of each side behind each command, the time since the burst of samples that
    /// it follows from: the last one before the newest distance that was on the bus before the command.
    /// So a latency may be longer than the time between two bursts. It is right as long as no single
    /// frame waits for the bus until the data of the next cycle are there.
    ///
    /// Without commands on the bus, each pulse follows from the last burst before it.
    pub fn latencies(&self) -> impl Iterator<Item = Latency> {
        let sides = [Side::Left, Side::Right];
        let mut served = sides.map(|_| None);
        self.pulses.iter().filter_map(move |&(pulse, side)| {
            let cause = if self.commands.is_empty() {
                pulse
            } else {
                let command = last(&self.commands, |command| command.end, pulse)?;
                if served[side as usize].replace(command) == Some(command) {
                    return None;
                }
                last(&self.distances, |distance| distance.end, command.start)?.start
            };
            let sample = last(&self.samples, |sample| *sample, cause)?;
            let since_sample = pulse.as_ticks() - sample.as_ticks();
            Some(Latency {
                pulse,
                side,
                since_sample: SimDuration::from_ticks(since_sample),
            })
        })
    }
}

/// The last one up to this time, of a list in order of time.
fn last<T: Copy>(all: &[T], time: impl Fn(&T) -> SimTime, until: SimTime) -> Option<T> {
    let after = all.partition_point(|one| time(one) <= until);
    all.get(after.checked_sub(1)?).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(ticks: u64) -> SimTime {
        SimTime::from_ticks(ticks)
    }

    fn frame(start: u64, end: u64) -> OnWire {
        OnWire {
            start: at(start),
            end: at(end),
        }
    }

    fn found(chain: &Chain) -> Vec<(u64, Side, u64)> {
        let latencies = chain.latencies();
        latencies
            .map(|one| (one.pulse.as_ticks(), one.side, one.since_sample.as_ticks()))
            .collect()
    }

    #[test]
    fn without_commands_a_pulse_belongs_to_the_burst_before_it() {
        let chain = Chain {
            samples: vec![at(100), at(200), at(300)],
            pulses: vec![
                (at(99), Side::Left),
                (at(150), Side::Left),
                (at(200), Side::Right),
                (at(460), Side::Left),
            ],
            ..Chain::default()
        };
        assert_eq!(
            found(&chain),
            [
                (150, Side::Left, 50),
                (200, Side::Right, 0),
                (460, Side::Left, 160)
            ]
        );
    }

    #[test]
    fn a_pulse_belongs_to_the_burst_whose_command_began_it() {
        let chain = Chain {
            samples: vec![at(100), at(200), at(300)],
            distances: vec![frame(110, 115), frame(190, 195), frame(290, 295)],
            // The second command had to wait for the bus beyond the next burst.
            commands: vec![frame(120, 130), frame(215, 230)],
            pulses: vec![
                (at(105), Side::Left),
                (at(131), Side::Left),
                (at(132), Side::Right),
                (at(232), Side::Right),
                (at(233), Side::Left),
                // A neutral pulse when the command has expired.
                (at(280), Side::Left),
            ],
        };
        assert_eq!(
            found(&chain),
            [
                (131, Side::Left, 31),
                (132, Side::Right, 32),
                (232, Side::Right, 132),
                (233, Side::Left, 133)
            ]
        );
    }

    #[test]
    fn a_command_without_new_distances_is_as_old_as_the_last_ones() {
        let chain = Chain {
            samples: vec![at(100), at(200), at(300)],
            distances: vec![frame(110, 115)],
            commands: vec![frame(120, 130), frame(220, 230), frame(320, 330)],
            pulses: [131, 231, 331].map(|when| (at(when), Side::Left)).to_vec(),
        };
        assert_eq!(
            found(&chain).iter().map(|one| one.2).collect::<Vec<_>>(),
            [31, 131, 231]
        );
    }
}

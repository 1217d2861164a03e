//! Reproducible random numbers: one independent ChaCha8 stream for each purpose.
//!
//! ChaCha is defined on integers, and the logarithm and cosine of the normal distribution come
//! from `libm`, so that a seed gives the same noise on every platform.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Purpose of a random stream. Each purpose has a stream of its own, so drawing one more number for
/// one purpose leaves the others unchanged.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Errors of the nodes' crystals and oscillators.
    Clocks = 1,
    /// Phase, latency and clock of the receiver.
    ReceiverTiming = 2,
    /// Noise of position and velocity.
    ReceiverNoise = 3,
    /// Damage done to the receiver's byte stream.
    StreamFaults = 4,
    /// Noise of the potentiometer and joystick voltages.
    Analog = 5,
    /// Random choices for a run's faults.
    Faults = 6,
    /// Noise of the knobs' voltages.
    Knobs = 7,
    /// Errors of the devices' own clocks.
    DeviceClocks = 8,
    /// Places and diameters of plants.
    Plants = 9,
    /// Leaves that overhang a row.
    Leaves = 10,
    /// Weeds in a row.
    Weeds = 11,
    /// Speeds of single motors.
    Motors = 12,
    /// Where a chassis tips from one pair of axles to the other.
    Tips = 13,
    /// Clods on the way.
    Clods = 14,
    /// Grip of the ground along the way.
    Slip = 15,
    /// Phase and noise of distance sensors.
    Distances = 16,
    /// Noise on the lines of distance sensors.
    DistanceLines = 17,
    /// Errors of the clocks of motor drivers with servo pulses.
    ServoClocks = 18,
    /// Frames of foreign nodes on the bus.
    ForeignFrames = 19,
    /// Which attacks a run suffers.
    Attacks = 20,
    /// The frames of an attacker.
    Attacker = 21,
    /// Noise of roll and pitch.
    TiltNoise = 22,
}

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Stream {
    generator: ChaCha8Rng,
}

impl Stream {
    /// The stream for `purpose` in the run with `seed`.
    #[must_use]
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(purpose as u64);
        Self { generator }
    }

    /// Moves to the numbers that belong to `index`, independent of earlier draws. Up to 16 words
    /// (eight calls of [`Stream::uniform`]) belong to one index.
    pub fn seek(&mut self, index: u64) {
        self.generator.set_word_pos(u128::from(index) * 16);
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.generator.next_u64()
    }

    /// A byte.
    pub fn byte(&mut self) -> u8 {
        (self.bits() >> 56) as u8
    }

    /// Uniform in 0 (included) to 1 (excluded).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform in `-bound` to `bound`.
    pub fn symmetric(&mut self, bound: f64) -> f64 {
        bound * (2.0 * self.uniform() - 1.0)
    }

    /// Uniform in 0 to `count` (excluded); 0 when `count` is 0.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Normally distributed with mean 0 and standard deviation 1 (Box and Muller, Ann. Math.
    /// Statist. 29, 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
        radius * libm::cos(core::f64::consts::TAU * self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_repeats_and_purposes_differ() {
        let draw = |seed, purpose| {
            let mut stream = Stream::new(seed, purpose);
            [stream.bits(), stream.bits()]
        };
        assert_eq!(draw(7, Purpose::Clocks), draw(7, Purpose::Clocks));
        assert_ne!(draw(7, Purpose::Clocks), draw(8, Purpose::Clocks));
        assert_ne!(draw(7, Purpose::Clocks), draw(7, Purpose::Analog));
    }

    #[test]
    fn the_numbers_of_an_index_do_not_depend_on_the_past() {
        let mut early = Stream::new(1, Purpose::Analog);
        let mut late = Stream::new(1, Purpose::Analog);
        for _ in 0..100 {
            late.bits();
        }
        early.seek(3);
        late.seek(3);
        assert_eq!(early.bits(), late.bits());
        late.seek(4);
        assert_ne!(early.bits(), late.bits());
    }

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal_distribution() {
        let mut stream = Stream::new(11, Purpose::ReceiverNoise);
        let draws: Vec<f64> = (0..20_000).map(|_| stream.normal()).collect();
        let mean = draws.iter().sum::<f64>() / 20_000.0;
        let moment = |power| draws.iter().map(|x| x.powi(power)).sum::<f64>() / 20_000.0;
        // Four standard errors of each estimate.
        assert!(mean.abs() < 0.03, "mean {mean}");
        assert!((moment(2) - 1.0).abs() < 0.04, "variance {}", moment(2));
        assert!((moment(4) - 3.0).abs() < 0.3, "fourth moment {}", moment(4));
    }
}

//! Servo pulses, which tell a motor driver how far and in which direction to turn.

/// Width of a servo pulse: 1000 to 2000 us, 1500 us is neutral (Victor SP).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PulseWidth(u16);

impl PulseWidth {
    /// 1000 us: full effort in one direction.
    pub const SHORTEST: Self = Self(1000);
    /// 1500 us: no effort.
    pub const NEUTRAL: Self = Self(1500);
    /// 2000 us: full effort in the other direction.
    pub const LONGEST: Self = Self(2000);

    /// The width that is nearest to `us` microseconds.
    pub const fn clamped(us: u16) -> Self {
        if us < Self::SHORTEST.0 {
            Self::SHORTEST
        } else if us > Self::LONGEST.0 {
            Self::LONGEST
        } else {
            Self(us)
        }
    }

    /// The width in microseconds, 1000 to 2000.
    pub const fn us(self) -> u16 {
        self.0
    }
}

/// Time from the beginning of a pulse to that of the next one, while no command restarts it:
/// 3000 to 60 000 us. The Victor SP takes 2.9 to 100 ms; the shortest one has 3 % of reserve, because
/// the RC oscillator of the node may be fast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulsePeriod(u16);

impl PulsePeriod {
    /// The shortest: no two pulses begin within less.
    pub const SHORTEST: Self = Self(3000);
    /// The longest that a 16-bit timer of microseconds makes, with some reserve.
    pub const LONGEST: Self = Self(60_000);

    /// The period of `us` microseconds; `None` out of range.
    pub const fn new(us: u16) -> Option<Self> {
        if us < Self::SHORTEST.0 || us > Self::LONGEST.0 {
            None
        } else {
            Some(Self(us))
        }
    }

    /// The period in microseconds, 3000 to 60 000.
    pub const fn us(self) -> u16 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::{PulsePeriod, PulseWidth};

    #[test]
    fn no_number_makes_a_pulse_out_of_range() {
        for us in 0..=u16::MAX {
            let width = PulseWidth::clamped(us);
            assert!((1000..=2000).contains(&width.us()));
            assert_eq!(width.us() == us, (1000..=2000).contains(&us));
            let period = PulsePeriod::new(us).map(PulsePeriod::us);
            assert_eq!(period, (3000..=60_000).contains(&us).then_some(us));
        }
        assert_eq!(PulseWidth::clamped(1500), PulseWidth::NEUTRAL);
        assert_eq!(PulseWidth::clamped(0), PulseWidth::SHORTEST);
        assert_eq!(PulseWidth::clamped(u16::MAX), PulseWidth::LONGEST);
    }
}

//! The two times of a node: local time (stamps of its own counter) and global
//! time.

/// Microseconds, the network time unit of every schedule.
pub type Micros = fugit::MicrosDurationU32;

/// A reading of the node's own free-running 32-bit counter.
///
/// The counter wraps. Two stamps compare correctly if they are less than half its
/// range apart (119 s at 18 MHz).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Stamp(
    /// The counter's value in ticks.
    pub u32,
);

impl Stamp {
    /// The stamp `ticks` after this one (before it, if negative).
    pub const fn offset(self, ticks: i32) -> Self {
        Self(self.0.wrapping_add_signed(ticks))
    }

    /// The stamp `ticks` after this one.
    pub const fn after(self, ticks: u32) -> Self {
        Self(self.0.wrapping_add(ticks))
    }

    /// The stamp `ticks` before this one.
    pub const fn before(self, ticks: u32) -> Self {
        Self(self.0.wrapping_sub(ticks))
    }

    /// Ticks from `earlier` to this stamp; negative if this stamp is before
    /// `earlier`.
    pub const fn ticks_since(self, earlier: Self) -> i32 {
        self.0.wrapping_sub(earlier.0).cast_signed()
    }

    /// Whether this stamp is `other` or later.
    pub const fn reached(self, other: Self) -> bool {
        self.ticks_since(other) >= 0
    }
}

/// Time that all nodes agree on, in 2^-16 us since an epoch that the time master
/// chooses. It wraps after almost nine years.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct GlobalTime(u64);

impl GlobalTime {
    /// Bits behind the binary point of a microsecond.
    pub const FRACTION_BITS: u32 = 16;

    /// From microseconds since the epoch.
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros << Self::FRACTION_BITS)
    }

    /// From 2^-16 us since the epoch.
    pub const fn from_raw(raw: u64) -> Self {
        Self(raw)
    }

    /// In 2^-16 us since the epoch.
    pub const fn raw(self) -> u64 {
        self.0
    }

    /// Whole microseconds since the epoch.
    pub const fn as_micros(self) -> u64 {
        self.0 >> Self::FRACTION_BITS
    }

    /// Whole milliseconds since the epoch, as the reference message carries
    /// them (wraps after 49 days).
    // The optimiser would give each branch of a caller a copy.
    #[inline(never)]
    pub const fn as_millis(self) -> u32 {
        // Long division by hand, because a 64-bit division is a library call on
        // the targets. The first of the quotient's digits is lost as it wraps.
        let mut time = self.0;
        let (mut millis, mut rest, mut places) = (0, 0, 0);
        while places < 3 {
            let digits = rest << 16 | (time >> 48) as u32;
            millis = (millis << 16) | (digits / 1000);
            rest = digits % 1000;
            time <<= 16;
            places += 1;
        }
        millis
    }

    /// This time plus `raw` 2^-16 us.
    pub const fn offset(self, raw: i64) -> Self {
        Self(self.0.wrapping_add_signed(raw))
    }

    /// Time from `earlier` to this one in 2^-16 us; negative if this one is before
    /// `earlier`.
    pub const fn since(self, earlier: Self) -> i64 {
        self.0.wrapping_sub(earlier.0).cast_signed()
    }
}

#[cfg(test)]
mod tests {
    use super::GlobalTime;

    #[test]
    fn milliseconds_are_a_thousandth_of_microseconds() {
        for micros in [
            0,
            999,
            1000,
            4_294_967_295,
            4_294_967_296,
            281_474_976_710_655,
        ] {
            let time = GlobalTime::from_micros(micros);
            assert_eq!(time.as_millis(), (micros / 1000) as u32);
        }
    }
}

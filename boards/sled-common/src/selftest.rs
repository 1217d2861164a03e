//! What a board finds out about itself while it starts.

/// The converter's reading of the internal reference voltage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reference {
    /// The reading now, a 12-bit count.
    pub count: u16,
    /// The factory's reading at a supply of 3.3 V, from the part's system page.
    pub factory: u16,
}

impl Reference {
    /// The supply of the part, mV: the converter measures against it. Zero if the reading is zero.
    pub const fn supply(&self) -> u16 {
        let scaled = 3300 * self.factory as u32;
        match scaled.checked_div(self.count as u32) {
            Some(supply) if supply <= u16::MAX as u32 => supply as u16,
            Some(_) => u16::MAX,
            None => 0,
        }
    }
}

/// Largest error of an external clock by the RC oscillator, in tenths of a per cent. The RC
/// oscillator itself is off by up to 8 % from -40 to 105 degrees Celsius (data sheets, HSI
/// oscillator accuracy). A clock of another frequency is off by more.
pub const CLOCK_ERROR: i16 = 100;

/// Whether a clock with this error, in tenths of a per cent by the RC oscillator, can be the
/// board's.
pub const fn is_plausible(error: i16) -> bool {
    error.unsigned_abs() <= CLOCK_ERROR.unsigned_abs()
}

/// The findings of a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Findings {
    /// First word of memory that did not hold what was written to it.
    pub memory_defect: Option<u32>,
    /// Whether the flash holds the image that was sealed; `None` if the image carries no seal.
    pub program: Option<bool>,
    /// Error of the external clock, measured by the RC oscillator, in tenths of a per cent; `None`
    /// without an external clock, or if no edge of it came to the timer that measures it.
    pub clock_error: Option<i16>,
    /// Whether the CAN controller received its own frame in internal loop-back; `None` if that
    /// could not be tested, because its receive pin was dominant.
    pub loop_back: Option<bool>,
    /// `None` if the converter did not get ready.
    pub reference: Option<Reference>,
}

#[cfg(test)]
mod tests {
    use super::Reference;

    #[test]
    fn the_supply_follows_from_the_reference() {
        let supply = |count| {
            Reference {
                count,
                factory: 1501,
            }
            .supply()
        };
        assert_eq!(supply(1501), 3300);
        assert_eq!(supply(1651), 3000);
        assert_eq!(supply(0), 0);
        assert_eq!(supply(1), u16::MAX);
    }
}

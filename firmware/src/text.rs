//! Text for displays and consoles, without `core::fmt`: that would cost a microsecond for each
//! number, several kilobytes of code, and paths that could panic.

/// The powers of ten: each is the smallest number with one more digit.
const POWERS: [u32; 10] = [
    1,
    10,
    100,
    1_000,
    10_000,
    100_000,
    1_000_000,
    10_000_000,
    100_000_000,
    1_000_000_000,
];

/// A text of at most `N` bytes. What does not fit is cut, and [`Text::is_cut`] says so.
#[derive(Clone, Copy, Debug)]
pub struct Text<const N: usize> {
    bytes: [u8; N],
    length: usize,
    cut: bool,
}

impl<const N: usize> Default for Text<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Text<N> {
    /// An empty text.
    pub const fn new() -> Self {
        Self {
            bytes: [0; N],
            length: 0,
            cut: false,
        }
    }

    /// The bytes so far.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or(&[])
    }

    /// Whether something did not fit.
    pub const fn is_cut(&self) -> bool {
        self.cut
    }

    /// Empties it.
    pub fn clear(&mut self) {
        self.length = 0;
        self.cut = false;
    }

    /// Appends one byte.
    #[inline]
    pub fn byte(&mut self, byte: u8) -> &mut Self {
        match self.bytes.get_mut(self.length) {
            Some(slot) => {
                *slot = byte;
                self.length += 1;
            }
            None => self.cut = true,
        }
        self
    }

    /// Appends a string.
    // Not inlined: each call would be a loop of its own, together 5 KiB in an image.
    #[inline(never)]
    pub fn str(&mut self, text: &str) -> &mut Self {
        // loop-bound: 24 no label is longer
        for &byte in text.as_bytes() {
            self.byte(byte);
        }
        self
    }

    /// Appends an unsigned number.
    pub fn unsigned(&mut self, number: u32) -> &mut Self {
        self.digits(number, 1)
    }

    /// Appends a number with its sign, if negative.
    pub fn signed(&mut self, number: i32) -> &mut Self {
        if number < 0 {
            self.byte(b'-');
        }
        self.unsigned(number.unsigned_abs())
    }

    /// Appends `number` as a decimal fraction: `number` counts units of 10 to the minus
    /// `decimals`, at most 9.
    ///
    /// `fixed(-1234, 3)` is `-1.234`.
    pub fn fixed(&mut self, number: i32, decimals: u8) -> &mut Self {
        let decimals = decimals.min(9);
        let unit = POWERS.get(usize::from(decimals)).copied().unwrap_or(1);
        if number < 0 {
            self.byte(b'-');
        }
        let magnitude = number.unsigned_abs();
        // `unit` is never zero; `checked_div` spares the compiler a panic path.
        self.unsigned(magnitude.checked_div(unit).unwrap_or(0));
        if decimals > 0 {
            self.byte(b'.');
            self.digits(magnitude.checked_rem(unit).unwrap_or(0), decimals);
        }
        self
    }

    /// Appends spaces up to column `column`, counted from `start`.
    pub fn pad(&mut self, start: usize, column: usize) -> &mut Self {
        while self.length < start.saturating_add(column) && self.length < N {
            self.byte(b' ');
        }
        self
    }

    /// Bytes so far.
    pub const fn len(&self) -> usize {
        self.length
    }

    /// Whether it holds nothing.
    pub const fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Appends a number with at least `least` digits, at most ten.
    // Not inlined, like `str`.
    #[inline(never)]
    fn digits(&mut self, number: u32, least: u8) -> &mut Self {
        let needed = POWERS.iter().filter(|&&power| number >= power).count();
        let begin = self.length;
        let end = begin + needed.max(usize::from(least)).min(POWERS.len());
        let mut rest = number;
        // loop-bound: 10 digits of a 32-bit number
        for place in (begin..end).rev() {
            if let Some(slot) = self.bytes.get_mut(place) {
                *slot = b'0' + (rest % 10) as u8;
            }
            rest /= 10;
        }
        self.length = end.min(N);
        self.cut |= end > N;
        self
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::Text;
    use proptest::prelude::*;
    use std::format;

    proptest! {
        #[test]
        fn numbers_are_written_as_the_standard_library_does(number: i32, unsigned: u32) {
            let mut text = Text::<32>::new();
            text.signed(number).byte(b' ').unsigned(unsigned);
            let expected = format!("{number} {unsigned}");
            prop_assert_eq!(text.as_bytes(), expected.as_bytes());
        }

        #[test]
        fn fractions_read_back(number: i32, decimals in 0u8..=9) {
            let mut text = Text::<16>::new();
            text.fixed(number, decimals);
            let written = std::str::from_utf8(text.as_bytes()).unwrap();
            prop_assert_eq!(written.split('.').nth(1).map_or(0, str::len), usize::from(decimals));
            let back: i64 = written.replace('.', "").parse().unwrap();
            prop_assert_eq!(back, i64::from(number));
        }

        #[test]
        fn what_does_not_fit_is_cut(word in "[a-z]{0,20}") {
            let mut text = Text::<8>::new();
            text.str(&word);
            prop_assert_eq!(text.as_bytes(), &word.as_bytes()[..word.len().min(8)]);
            prop_assert_eq!(text.is_cut(), word.len() > 8);
        }
    }

    #[test]
    fn columns_are_padded() {
        let mut text = Text::<8>::new();
        text.str("ab").pad(0, 4).str("c");
        assert_eq!(text.as_bytes(), b"ab  c");
    }
}

//! What a look of a guardian at a TX line finds, if a timer follows the line between looks.

/// A line that is not at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// How long ago its rest ended, in ticks.
    pub age: u32,
    /// It is dominant.
    pub dominant: bool,
    /// It has become dominant since the look before.
    pub fell: bool,
    /// It was released since the look before: so many ticks ago, the last time.
    pub released: Option<u32>,
}

//! Options of a campaign.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Which part of the sequences is run here: every `of`-th, from the `index`-th on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Shard {
    pub(crate) index: u64,
    pub(crate) of: u64,
}

impl Shard {
    /// Whether the sequence of this seed is one of it, of a campaign of so many that begin with the seed
    /// `first`.
    pub(crate) const fn has(self, first: u64, all: u64, seed: u64) -> bool {
        let number = seed.wrapping_sub(first);
        number < all && number % self.of == self.index - 1
    }

    /// How many of `all` sequences it has.
    pub(crate) const fn sequences(self, all: u64) -> u64 {
        all / self.of + (self.index <= all % self.of) as u64
    }
}

impl Default for Shard {
    /// All of them.
    fn default() -> Self {
        Self { index: 1, of: 1 }
    }
}

/// A text that names no shard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShardError(String);

impl std::fmt::Display for ShardError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:?} is no shard: write its number and how many there are, such as \"2/8\"",
            self.0
        )
    }
}

impl std::error::Error for ShardError {}

impl FromStr for Shard {
    type Err = ShardError;

    /// Reads `i/n` with 1 <= i <= n.
    ///
    /// # Errors
    /// When it is anything else.
    fn from_str(text: &str) -> Result<Self, ShardError> {
        let parsed = text
            .split_once('/')
            .and_then(|(index, of)| Some((index.parse().ok()?, of.parse().ok()?)))
            .filter(|&(index, of): &(u64, u64)| 1 <= index && index <= of);
        let (index, of) = parsed.ok_or_else(|| ShardError(text.to_owned()))?;
        Ok(Self { index, of })
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
    }
}

impl TryFrom<String> for Shard {
    type Error = ShardError;

    fn try_from(text: String) -> Result<Self, ShardError> {
        text.parse()
    }
}

/// What happens in the sequences of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Trouble {
    /// Random faults.
    Faults,
    /// Attacks on the bus, sometimes with a fault beside them.
    Attacks {
        /// Whether the nodes have a key. Without one, forged commands with the right check value move
        /// the motors; tests see by that whether the rules find it.
        key: bool,
    },
}

/// The sequences of a campaign, and the part of them that is run here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// What happens in them.
    pub trouble: Trouble,
    /// Number of sequences in all shards together.
    pub sequences: u64,
    /// Seed of the first sequence; each further one has the next seed, so that one sequence with
    /// the seed of a failure repeats it.
    pub seed: u64,
    /// The part of them that is run here.
    pub shard: Shard,
    /// Threads; as many as there are cores when `None`.
    pub threads: Option<usize>,
}

//! The sum of a campaign.

use std::collections::BTreeMap;
use std::fmt;

use vehicle_model::Vehicle;

use crate::options::Options;
use crate::rules::Violation;

/// The outcome of one sequence.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Verdict {
    /// Its seed, which replays it.
    pub seed: u64,
    /// The events of the sequence, one sentence each.
    pub story: Vec<String>,
    /// The rules that were broken; empty when all is well.
    pub violations: Vec<Violation>,
}

/// The outcome of all sequences.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// Name of the vehicle.
    pub vehicle: String,
    /// Seed of the first sequence of all shards.
    pub seed: u64,
    /// The shard, as `i/n`.
    pub shard: String,
    /// Sequences that were run.
    pub sequences: u64,
    /// Simulated time of all of them, s.
    pub simulated_seconds: f64,
    /// How often each rule was broken.
    pub broken_rules: BTreeMap<&'static str, u64>,
    /// The sequences that broke a rule, by seed.
    pub failures: Vec<Verdict>,
}

impl Report {
    pub(crate) fn new(vehicle: &Vehicle, options: &Options) -> Self {
        Self {
            vehicle: vehicle.name().to_owned(),
            seed: options.seed,
            shard: options.shard.to_string(),
            sequences: 0,
            simulated_seconds: 0.0,
            broken_rules: BTreeMap::new(),
            failures: Vec::new(),
        }
    }

    pub(crate) fn take(&mut self, verdict: Verdict) {
        self.sequences += 1;
        if verdict.violations.is_empty() {
            return;
        }
        for violation in &verdict.violations {
            *self.broken_rules.entry(violation.rule).or_default() += 1;
        }
        self.failures.push(verdict);
    }

    /// Puts the failures in order, whatever thread was first.
    pub(crate) fn finish(&mut self) {
        self.simulated_seconds = self.sequences as f64 * crate::sequence::END;
        self.failures.sort_by_key(|verdict| verdict.seed);
    }

    /// The report as JSON, one object; the fields are those of this type.
    ///
    /// # Panics
    /// Never: it holds nothing that JSON cannot say.
    #[must_use]
    pub fn json(&self) -> String {
        serde_json::to_string_pretty(self).expect("numbers and texts") + "\n"
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for verdict in &self.failures {
            writeln!(f, "seed {} broke a rule; what happened:", verdict.seed)?;
            for sentence in &verdict.story {
                writeln!(f, "    {sentence}")?;
            }
            for violation in &verdict.violations {
                writeln!(
                    f,
                    "  {} at {:.6} s: {}",
                    violation.rule, violation.at, violation.what
                )?;
            }
            writeln!(
                f,
                "  replay it with: cargo xtask sim --faults 1 --seed {} --vehicle {}",
                verdict.seed, self.vehicle
            )?;
        }
        writeln!(
            f,
            "{} fault sequences, {:.0} s simulated, {} broke a rule",
            self.sequences,
            self.simulated_seconds,
            self.failures.len()
        )
    }
}

//! The sum of a campaign.

use std::collections::BTreeMap;
use std::fmt;

use vehicle_model::Vehicle;

use crate::attack::Tally;
use crate::options::{Options, Trouble};
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
    /// What its attacks did.
    #[serde(skip)]
    pub tally: Tally,
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
    /// What the attacks did; `None` in a campaign without an attacker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attacks: Option<Tally>,
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
            attacks: (options.trouble != Trouble::Faults).then(Tally::default),
            failures: Vec::new(),
        }
    }

    pub(crate) fn take(&mut self, verdict: Verdict) {
        self.sequences += 1;
        if let Some(attacks) = &mut self.attacks {
            attacks.add(&verdict.tally);
        }
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
            let attacker = self.attacks.as_ref().map_or("", |_| " --attacker");
            writeln!(
                f,
                "  replay it with: cargo xtask sim --faults 1{attacker} --seed {} --vehicle {}",
                verdict.seed, self.vehicle
            )?;
        }
        if let Some(attacks) = &self.attacks {
            write!(f, "{attacks}")?;
        }
        let kind = self.attacks.as_ref().map_or("fault", |_| "attack");
        writeln!(
            f,
            "{} {kind} sequences, {:.0} s simulated, {} broke a rule",
            self.sequences,
            self.simulated_seconds,
            self.failures.len()
        )
    }
}

/// Why a rule is known to be broken.
fn reason(rule: &str) -> &'static str {
    match rule {
        "notice" => "because consoles do not count foreign references",
        _ => "because a reference is proven only by the next one",
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "attack                  attacks   frames sent")?;
        for (kind, count) in &self.attacks {
            let frames = self.attempts.get(kind).map(u64::to_string);
            let frames = frames.unwrap_or_default();
            writeln!(f, "  {kind:<22} {count:>6} {frames:>13}")?;
        }
        writeln!(
            f,
            "{} attempts: forged and replayed frames that were sent to their end, {} of them in the command's window",
            self.attempts(),
            self.attempts_in_command_window
        )?;
        writeln!(
            f,
            "{} attempts moved a motor; {} frames of floods; {} frames of the nodes destroyed",
            self.moved_a_motor, self.flood_frames, self.suppressed_frames
        )?;
        if let Some(seed) = self.worst_recovery_seed {
            writeln!(
                f,
                "longest recovery: {:.3} s after the end of the attacks (seed {seed})",
                self.worst_recovery_seconds
            )?;
        }
        for (rule, count) in &self.known {
            writeln!(
                f,
                "known, {}: rule {rule} in {count} sequences",
                reason(rule)
            )?;
            if let Some(example) = self.known_examples.get(rule) {
                let crate::attack::Example { seed, at, what } = example;
                writeln!(f, "  such as seed {seed} at {at:.6} s: {what}")?;
            }
        }
        Ok(())
    }
}

//! The sum of a campaign.

use std::collections::BTreeMap;
use std::fmt;

use object::{Object, ObjectSegment};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use twin::Images;
use vehicle_model::{NodeIndex, Vehicle};

use crate::Word;
use crate::attack::Tally;
use crate::options::{Options, Shard, Trouble};
use crate::rules::Violation;

/// The outcome of one sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

/// What all parts of a campaign have in common.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Campaign {
    /// Name of the vehicle.
    pub vehicle: String,
    /// Values in place of those of its manifest, each as `KEY=VALUE`. Not every one changes an image.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub set: Vec<String>,
    /// What happens in its sequences.
    pub trouble: Trouble,
    /// Sequences of all parts.
    pub sequences: u64,
    /// Seed of the first of them.
    pub seed: u64,
    /// Of each node, the digest of what is in its flash (the first half of SHA-256): other images are
    /// another campaign.
    pub images: BTreeMap<String, String>,
}

impl Campaign {
    /// The campaign of these options.
    #[must_use]
    pub fn new(vehicle: &Vehicle, images: &Images, options: &Options) -> Self {
        Self {
            vehicle: vehicle.name().to_owned(),
            set: vehicle.overrides().texts(),
            trouble: options.trouble,
            sequences: options.sequences,
            seed: options.seed,
            images: digests(vehicle, images),
        }
    }

    /// The command that runs the sequence of a seed again. A shell reads it back, whatever the file said
    /// that the campaign comes from.
    #[must_use]
    pub fn replay(&self, seed: u64) -> String {
        let attacker = match self.trouble {
            Trouble::Faults => "",
            Trouble::Attacks { .. } => " --attacker",
        };
        let vehicle = quoted(&self.vehicle);
        let mut command =
            format!("cargo xtask sim --faults 1{attacker} --seed {seed} --vehicle {vehicle}");
        for set in &self.set {
            command += &format!(" --set {}", quoted(set));
        }
        command
    }
}

/// A word as a shell reads it back.
#[must_use]
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Of each node, the digest of what is in its flash.
#[must_use]
pub fn digests(vehicle: &Vehicle, images: &Images) -> BTreeMap<String, String> {
    let digest = |(node, file): (NodeIndex, &[u8])| {
        let name = vehicle.node(node).name.clone();
        (name, digest(file))
    };
    images.iter().map(digest).collect()
}

/// The digest of a program: of its loadable segments, so that paths in the debug information do not
/// count.
fn digest(elf: &[u8]) -> String {
    let mut hash = Sha256::new();
    let file = object::File::parse(elf).ok();
    for segment in file.iter().flat_map(|file| file.segments()) {
        hash.update(segment.address().to_le_bytes());
        hash.update(segment.data().unwrap_or_default());
    }
    let bytes = hash.finalize();
    let first = bytes.iter().take(16);
    first.map(|byte| format!("{byte:02x}")).collect()
}

/// Failures that have the same first cause.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// The rule that was broken first.
    pub rule: Word,
    /// What happened then, with `#` for each number.
    pub what: String,
    /// Sequences.
    pub count: u64,
    /// Seeds of the first of them.
    pub seeds: Vec<u64>,
}

/// Most seeds that a [`Cause`] names.
const SEEDS: usize = 5;

/// The outcome of all sequences, or of those of one part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// The campaign.
    pub campaign: Campaign,
    /// The part that was run, as `i/n`.
    pub shard: Shard,
    /// Sequences that were run.
    pub sequences: u64,
    /// Simulated time of all of them, s.
    pub simulated_seconds: f64,
    /// How often each rule was broken.
    pub broken_rules: BTreeMap<Word, u64>,
    /// What the attacks did; `None` in a campaign without an attacker.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attacks: Option<Tally>,
    /// The failures by first cause, the most frequent first.
    pub causes: Vec<Cause>,
    /// The sequences that broke a rule, by seed.
    pub failures: Vec<Verdict>,
}

impl Report {
    pub(crate) fn new(campaign: Campaign, shard: Shard) -> Self {
        Self {
            shard,
            sequences: 0,
            simulated_seconds: 0.0,
            broken_rules: BTreeMap::new(),
            attacks: (campaign.trouble != Trouble::Faults).then(Tally::default),
            causes: Vec::new(),
            failures: Vec::new(),
            campaign,
        }
    }

    pub(crate) fn take(&mut self, verdict: Verdict) {
        self.sequences += 1;
        if let Some(attacks) = &mut self.attacks {
            attacks.add(&verdict.tally);
        }
        self.fail(verdict);
    }

    fn fail(&mut self, verdict: Verdict) {
        if verdict.violations.is_empty() {
            return;
        }
        for violation in &verdict.violations {
            *self.broken_rules.entry(violation.rule.clone()).or_default() += 1;
        }
        self.failures.push(verdict);
    }

    /// Adds the sequences of another part.
    pub(crate) fn add(&mut self, part: Self) {
        self.sequences += part.sequences;
        if let (Some(attacks), Some(more)) = (&mut self.attacks, &part.attacks) {
            attacks.add(more);
        }
        for verdict in part.failures {
            self.fail(verdict);
        }
    }

    /// Puts the failures in order, whatever thread was first.
    pub(crate) fn finish(&mut self) {
        self.simulated_seconds = self.sequences as f64 * crate::sequence::END;
        self.failures.sort_by_key(|verdict| verdict.seed);
        self.causes = causes(&self.failures);
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

/// The failures by what broke first.
pub(crate) fn causes(failures: &[Verdict]) -> Vec<Cause> {
    let mut causes: BTreeMap<(Word, String), (u64, Vec<u64>)> = BTreeMap::new();
    for verdict in failures {
        let by_time = |one: &&Violation, other: &&Violation| one.at.total_cmp(&other.at);
        let Some(first) = verdict.violations.iter().min_by(by_time) else {
            continue;
        };
        let key = (first.rule.clone(), without_numbers(&first.what));
        let (count, seeds) = causes.entry(key).or_default();
        *count += 1;
        if seeds.len() < SEEDS {
            seeds.push(verdict.seed);
        }
    }
    let mut causes: Vec<Cause> = causes
        .into_iter()
        .map(|((rule, what), (count, seeds))| Cause {
            rule,
            what,
            count,
            seeds,
        })
        .collect();
    causes.sort_by_key(|cause| core::cmp::Reverse(cause.count));
    causes
}

/// A sentence with `#` in place of each number.
fn without_numbers(text: &str) -> String {
    let mut out = String::new();
    let mut in_number = false;
    for one in text.chars() {
        let digit = one.is_ascii_digit() || (in_number && one == '.');
        if digit && !in_number {
            out.push('#');
        }
        if !digit {
            out.push(one);
        }
        in_number = digit;
    }
    out
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
            let replay = self.campaign.replay(verdict.seed);
            writeln!(f, "  replay it with: {replay}")?;
        }
        if self.failures.len() > 1 {
            writeln!(f, "first causes:")?;
            for cause in &self.causes {
                let seeds: Vec<String> = cause.seeds.iter().map(u64::to_string).collect();
                writeln!(
                    f,
                    "  {:>6}  {}: {} (seeds {}{})",
                    cause.count,
                    cause.rule,
                    cause.what,
                    seeds.join(", "),
                    if cause.count > seeds.len() as u64 {
                        ", ..."
                    } else {
                        ""
                    }
                )?;
            }
        }
        if let Some(attacks) = &self.attacks {
            write!(f, "{attacks}")?;
        }
        let kind = self.attacks.as_ref().map_or("fault", |_| "attack");
        writeln!(
            f,
            "{} {kind} {}, {:.0} s simulated, {} broke a rule",
            self.sequences,
            sequences(self.sequences),
            self.simulated_seconds,
            self.failures.len()
        )
    }
}

/// The word behind a number of sequences.
const fn sequences(count: u64) -> &'static str {
    match count {
        1 => "sequence",
        _ => "sequences",
    }
}

/// What happened where a rule is known to be broken, and why it could.
fn limit(rule: &str) -> &'static str {
    match rule {
        "notice" => {
            "no console counted the foreign references: none counts those that its node refuses"
        }
        "recovery" => {
            "some windows of the satellite receiver stayed empty for more than a second: the schedule \
             follows the receiver's epochs by only 8 us in each cycle"
        }
        "master" => {
            "a motor was driven under a foreign reference: a reference is proven only by the next one"
        }
        _ => {
            "a node sent in a window that began with a foreign reference: a reference is proven only by \
             the next one"
        }
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "attack                  attacks   frames sent   frames destroyed"
        )?;
        for (kind, count) in &self.attacks {
            let number = |known: Option<&u64>| known.map_or("-".into(), u64::to_string);
            let sent = self.attempts.get(kind).or(self.floods.get(kind));
            let (sent, destroyed) = (number(sent), number(self.suppressed.get(kind)));
            writeln!(f, "  {kind:<22} {count:>6} {sent:>13} {destroyed:>18}")?;
        }
        let in_vain = self.suppressed.iter().filter(|(_, count)| **count == 0);
        for (kind, _) in in_vain {
            writeln!(
                f,
                "{kind}: no node sent a frame that it aimed at while it lasted"
            )?;
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
            let sequences = sequences(*count);
            writeln!(
                f,
                "known limit, not counted as a broken rule ({rule}): in {count} {sequences} {}",
                limit(rule)
            )?;
            if let Some(example) = self.known_examples.get(rule) {
                let crate::attack::Example { seed, at, what } = example;
                writeln!(f, "  such as seed {seed} at {at:.6} s: {what}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_replay_has_all_that_the_images_depend_on() {
        let mut campaign = Campaign {
            vehicle: "two-boards".into(),
            set: Vec::new(),
            trouble: Trouble::Faults,
            sequences: 4,
            seed: 1,
            images: BTreeMap::new(),
        };
        let command = campaign.replay(3);
        let plain = "cargo xtask sim --faults 1 --seed 3 --vehicle two-boards";
        assert_eq!(command, plain);
        // As in the files of before.
        let text = serde_json::to_string(&campaign).unwrap();
        assert!(!text.contains("\"set\""), "{text}");
        assert_eq!(serde_json::from_str::<Campaign>(&text).unwrap(), campaign);
        campaign.trouble = Trouble::Attacks { key: true };
        campaign.set = vec![
            "bus.protocol=event-triggered".into(),
            "rover.cruise=0.8 m/s".into(),
        ];
        let command = campaign.replay(3);
        let attacked = "cargo xtask sim --faults 1 --attacker --seed 3 --vehicle two-boards \
                        --set bus.protocol=event-triggered --set 'rover.cruise=0.8 m/s'";
        assert_eq!(command, attacked);
        assert_eq!(quoted("it's; $(rm x)"), r"'it'\''s; $(rm x)'");
    }

    #[test]
    fn what_attacks_did_is_told_for_each_kind() {
        let count = |pairs: &[(&'static str, u64)]| -> BTreeMap<Word, u64> {
            let pairs = pairs.iter();
            pairs
                .map(|(name, count)| ((*name).into(), *count))
                .collect()
        };
        let tally = Tally {
            attacks: count(&[("bus-off", 1), ("flood", 2), ("suppression", 2)]),
            floods: count(&[("flood", 70)]),
            suppressed: count(&[("bus-off", 12), ("suppression", 0)]),
            known: count(&[("place", 1), ("notice", 2)]),
            ..Tally::default()
        };
        let text = tally.to_string();
        let has = |line: &str| assert!(text.lines().any(|one| one == line), "{line}\n{text}");
        has("attack                  attacks   frames sent   frames destroyed");
        has("  bus-off                     1             -                 12");
        has("  flood                       2            70                  -");
        has("  suppression                 2             -                  0");
        has("suppression: no node sent a frame that it aimed at while it lasted");
        assert!(
            text.contains("(place): in 1 sequence a node sent in a window"),
            "{text}"
        );
        assert!(
            text.contains("(notice): in 2 sequences no console"),
            "{text}"
        );
    }

    fn failure(seed: u64, broken: &[(&str, f64, &str)]) -> Verdict {
        let violation = |&(rule, at, what): &(&str, f64, &str)| Violation {
            rule: Word::Owned(rule.to_owned()),
            at,
            what: what.to_owned(),
        };
        Verdict {
            seed,
            story: Vec::new(),
            violations: broken.iter().map(violation).collect(),
            tally: Tally::default(),
        }
    }

    #[test]
    fn failures_are_grouped_by_what_broke_first() {
        let late = |at| format!("drive turns {at} ms after the last command");
        let failures = [
            failure(
                3,
                &[("stop", 5.0, &late("201.5")), ("place", 4.0, "message 300")],
            ),
            failure(7, &[("stop", 2.0, &late("305"))]),
            failure(9, &[("stop", 2.0, &late("7"))]),
        ];
        let seen: Vec<_> = causes(&failures)
            .into_iter()
            .map(|cause| (cause.rule, cause.what, cause.count, cause.seeds))
            .collect();
        let stop = "drive turns # ms after the last command".to_owned();
        assert_eq!(seen[0], ("stop".into(), stop, 2, vec![7, 9]));
        assert_eq!(seen[1], ("place".into(), "message #".into(), 1, vec![3]));
        assert_eq!(without_numbers("at 1.5 s. 2"), "at # s. #");
    }
}

//! Whether a report of a part, as it was read from a file, can be what was simulated.

use std::collections::{BTreeMap, BTreeSet};

use vehicle_model::Override;

use crate::Word;
use crate::attack::Tally;
use crate::options::Trouble;
use crate::report::{Report, Verdict, causes};
use crate::rules::{RULES, SIMULATION};
use crate::sequence::END;

/// Most sequences of a campaign, and most of anything that happens in them. More are not simulated in years, and
/// sums of them stay in range.
const MOST: u64 = 1 << 40;

/// How far behind the end of a sequence a rule may be found broken, s.
const BEHIND: f64 = 1.0;

impl Report {
    /// Says in a clause what contradicts itself in a report, or cannot be.
    pub(crate) fn contradiction(&self) -> Option<String> {
        let all = self.campaign.sequences;
        if all > MOST {
            return Some(format!(
                "it has {all} sequences, and up to {MOST} are accepted"
            ));
        }
        let should = self.shard.sequences(all);
        if self.sequences != should {
            return Some(format!(
                "it has {} sequences, but part {} of {all} has {should}",
                self.sequences, self.shard
            ));
        }
        let seconds = self.sequences as f64 * END;
        let apart = (self.simulated_seconds - seconds).abs();
        if !(0.0..=1e-6 * seconds).contains(&apart) {
            return Some(format!(
                "simulated_seconds is {:?}, but its sequences last {seconds} s",
                self.simulated_seconds
            ));
        }
        let is_value =
            |text: &&String| Override::parse(text).is_ok_and(|read| read.to_string() == **text);
        let mut set = self.campaign.set.iter();
        if let Some(odd) = set.find(|text| !is_value(text)) {
            return Some(format!(
                "{odd:?} is no value of --set: KEY=VALUE is accepted"
            ));
        }
        self.texts().or_else(|| self.counts())
    }

    /// A text that would change what a terminal shows.
    fn texts(&self) -> Option<String> {
        let campaign = &self.campaign;
        let images = campaign
            .images
            .iter()
            .flat_map(|(node, digest)| [node, digest]);
        let told = self.failures.iter().flat_map(|verdict| {
            let broken = verdict.violations.iter();
            verdict.story.iter().chain(broken.map(|one| &one.what))
        });
        let examples = self
            .attacks
            .iter()
            .flat_map(|tally| tally.known_examples.values());
        let kinds = self
            .attacks
            .iter()
            .flat_map(|tally| {
                [
                    &tally.attacks,
                    &tally.attempts,
                    &tally.floods,
                    &tally.suppressed,
                ]
            })
            .flat_map(BTreeMap::keys);
        let mut texts = images
            .chain([&campaign.vehicle])
            .chain(told)
            .chain(examples.map(|example| &example.what))
            .map(String::as_str)
            .chain(kinds.map(AsRef::as_ref));
        let odd = |one: char| one.is_control() && one != '\n' && one != '\t';
        let odd = texts.find(|text| text.chars().any(odd))?;
        Some(format!("the text {odd:?} has control characters"))
    }

    fn counts(&self) -> Option<String> {
        let mut seeds = BTreeSet::new();
        let mut broken: BTreeMap<Word, u64> = BTreeMap::new();
        for verdict in &self.failures {
            let seed = verdict.seed;
            if !self.has(seed) {
                return Some(format!("seed {seed} is none of part {}", self.shard));
            }
            if !seeds.insert(seed) {
                return Some(format!("seed {seed} is there twice"));
            }
            if let Some(what) = contradiction(verdict) {
                return Some(what);
            }
            for violation in &verdict.violations {
                *broken.entry(violation.rule.clone()).or_default() += 1;
            }
        }
        let named = self.broken_rules.keys().find(|rule| !is_rule(rule));
        if let Some(rule) = named {
            return Some(format!("there is no rule {rule:?}"));
        }
        if broken != self.broken_rules {
            return Some("broken_rules does not count what its failures broke".to_owned());
        }
        if causes(&self.failures) != self.causes {
            return Some("causes does not group its failures".to_owned());
        }
        match (&self.attacks, self.campaign.trouble) {
            (None, Trouble::Faults) => None,
            (Some(tally), Trouble::Attacks { .. }) => self.attacked(tally),
            _ => Some("attacks belongs to a campaign with an attacker, and to no other".to_owned()),
        }
    }

    fn attacked(&self, tally: &Tally) -> Option<String> {
        let counts = [
            tally.attempts_in_command_window,
            tally.flood_frames,
            tally.suppressed_frames,
            tally.moved_a_motor,
        ];
        let maps = [
            &tally.attacks,
            &tally.attempts,
            &tally.floods,
            &tally.suppressed,
            &tally.known,
        ];
        let mut counts = maps.into_iter().flat_map(BTreeMap::values).chain(&counts);
        if counts.any(|count| *count > MOST) {
            return Some(format!("attacks counts more than {MOST} of something"));
        }
        if !(0.0..=END).contains(&tally.worst_recovery_seconds) {
            return Some(format!(
                "worst_recovery_seconds is {}",
                tally.worst_recovery_seconds
            ));
        }
        let mut rules = tally.known.keys().chain(tally.known_examples.keys());
        if let Some(rule) = rules.find(|rule| !is_rule(rule)) {
            return Some(format!("there is no rule {rule:?}"));
        }
        let examples = tally.known_examples.values();
        if let Some(example) = examples.clone().find(|example| !is_time(example.at)) {
            return Some(format!("something happened at {} s", example.at));
        }
        let mut seeds = examples
            .map(|example| example.seed)
            .chain(tally.worst_recovery_seed);
        let stray = seeds.find(|seed| !self.has(*seed))?;
        Some(format!("seed {stray} is none of part {}", self.shard))
    }

    fn has(&self, seed: u64) -> bool {
        let campaign = &self.campaign;
        self.shard.has(campaign.seed, campaign.sequences, seed)
    }
}

/// What is wrong with a failure.
fn contradiction(verdict: &Verdict) -> Option<String> {
    let seed = verdict.seed;
    if verdict.violations.is_empty() {
        return Some(format!("seed {seed} is a failure, and broke no rule"));
    }
    let mut all = verdict.violations.iter();
    let wrong = all.find(|one| !is_rule(&one.rule) || !is_time(one.at))?;
    Some(if is_rule(&wrong.rule) {
        format!("seed {seed} broke a rule at {} s", wrong.at)
    } else {
        format!("there is no rule {:?}", wrong.rule)
    })
}

fn is_rule(rule: &str) -> bool {
    RULES.contains(&rule) || rule == SIMULATION
}

/// Whether something can happen at that time of a sequence, s.
fn is_time(at: f64) -> bool {
    (0.0..=END + BEHIND).contains(&at)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every rule that the judge names is one that a part may name.
    #[test]
    fn all_rules_are_known() {
        let sources = [
            include_str!("rules.rs"),
            include_str!("rules/attacks.rs"),
            include_str!("run.rs"),
        ];
        let mut named = BTreeSet::new();
        for source in sources {
            let rules = source.split("rule: \"").skip(1);
            named.extend(rules.filter_map(|rest| rest.split('"').next()));
        }
        assert_eq!(named, RULES.into());
    }
}

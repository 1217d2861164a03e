//! The parts of a campaign, run on different machines, put together.

use std::collections::BTreeMap;

use crate::options::Shard;
use crate::report::{Campaign, Report};

/// Why parts make no whole. Displays as one sentence; the names are those that the caller gave to the
/// parts.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum MergeError {
    /// There is no part.
    #[error("there is no part to merge")]
    Nothing,
    /// Parts of different campaigns.
    #[error("{one} and {other} are parts of different campaigns: {what} differ")]
    Different {
        /// A part.
        one: String,
        /// Another one.
        other: String,
        /// In what.
        what: &'static str,
    },
    /// A part is there twice.
    #[error("{one} and {other} are the same part, {shard}")]
    Twice {
        /// A part.
        one: String,
        /// Another one.
        other: String,
        /// The part.
        shard: Shard,
    },
    /// A part that cannot be what was simulated.
    #[error("{part} contradicts itself: {what}")]
    Contradiction {
        /// The part.
        part: String,
        /// In what.
        what: String,
    },
    /// Parts are missing.
    #[error("parts are missing: {}", list(first, *all))]
    Missing {
        /// The first of them.
        first: Vec<Shard>,
        /// How many.
        all: u64,
    },
}

/// Most missing parts that a sentence names.
const NAMED: usize = 8;

fn list(first: &[Shard], all: u64) -> String {
    let mut names: Vec<String> = first.iter().map(Shard::to_string).collect();
    let more = all.saturating_sub(names.len() as u64);
    if more > 0 {
        names.push(format!("and {more} more"));
    }
    names.join(", ")
}

/// The report of the whole campaign, equal to that of one run, from the reports of all its parts with
/// their names.
///
/// # Errors
/// Parts are missing or doubled, contradict themselves, or belong to different campaigns.
pub fn merge(parts: Vec<(String, Report)>) -> Result<Report, MergeError> {
    let Some((first, campaign, of)) = parts
        .first()
        .map(|(name, part)| (name.clone(), part.campaign.clone(), part.shard.of))
    else {
        return Err(MergeError::Nothing);
    };
    let mut found: BTreeMap<u64, (String, Report)> = BTreeMap::new();
    for (name, part) in parts {
        if let Some(what) = difference(&campaign, of, &part) {
            return Err(MergeError::Different {
                one: first,
                other: name,
                what,
            });
        }
        if let Some(what) = part.contradiction() {
            return Err(MergeError::Contradiction { part: name, what });
        }
        let shard = part.shard;
        if let Some((one, _)) = found.get(&shard.index) {
            return Err(MergeError::Twice {
                one: one.clone(),
                other: name,
                shard,
            });
        }
        found.insert(shard.index, (name, part));
    }
    let all = of - found.len() as u64;
    if all > 0 {
        // There may be more than could ever be counted.
        let missing = (1..=of).filter(|index| !found.contains_key(index));
        let first = missing.take(NAMED).map(|index| Shard { index, of });
        return Err(MergeError::Missing {
            first: first.collect(),
            all,
        });
    }
    let mut whole = Report::new(campaign, Shard::default());
    for (_, part) in found.into_values() {
        whole.add(part);
    }
    whole.finish();
    Ok(whole)
}

/// In what a part differs from a campaign of so many parts.
fn difference(campaign: &Campaign, of: u64, part: &Report) -> Option<&'static str> {
    let other = &part.campaign;
    let differences = [
        (campaign.vehicle != other.vehicle, "their vehicles"),
        (campaign.set != other.set, "the values of --set and --bus"),
        (
            campaign.trouble != other.trouble,
            "what happens in their sequences",
        ),
        (
            campaign.sequences != other.sequences,
            "the numbers of their sequences",
        ),
        (campaign.seed != other.seed, "their seeds"),
        (campaign.images != other.images, "their images"),
        (of != part.shard.of, "the numbers of their parts"),
    ];
    let mut differences = differences.into_iter();
    differences
        .find(|(differ, _)| *differ)
        .map(|(_, what)| what)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Word;
    use crate::attack::{Example, Tally};
    use crate::options::Trouble;
    use crate::report::Verdict;
    use crate::rules::Violation;

    fn campaign() -> Campaign {
        Campaign {
            vehicle: "uagv".into(),
            set: vec!["safety.backup_master=drive".into()],
            trouble: Trouble::Attacks { key: true },
            sequences: 19,
            seed: 100,
            images: [("gps".to_owned(), "0123".to_owned())].into(),
        }
    }

    /// The verdict of a seed: each third breaks rules.
    fn verdict(seed: u64) -> Verdict {
        let violation = |rule: &'static str, at| Violation {
            rule: rule.into(),
            at,
            what: format!("{rule} after {at} s"),
        };
        let mut tally = Tally {
            flood_frames: seed,
            worst_recovery_seconds: (seed % 4) as f64 * 0.1,
            worst_recovery_seed: Some(seed),
            ..Tally::default()
        };
        tally.attempts.insert("forged command".into(), seed * 3);
        let example = Example {
            seed,
            at: 0.5,
            what: "it happens".into(),
        };
        tally.note(Word::from("place"), example);
        Verdict {
            seed,
            story: vec![format!("seed {seed}")],
            violations: match seed % 3 {
                0 => vec![violation("stop", 2.5), violation("place", 1.25)],
                _ => Vec::new(),
            },
            tally,
        }
    }

    /// The report of a part, as [`crate::run`] makes it, with its verdicts in another order.
    fn part(shard: Shard) -> Report {
        let campaign = campaign();
        let mut report = Report::new(campaign.clone(), shard);
        let numbers: Vec<u64> = (0..campaign.sequences)
            .filter(|number| number % shard.of == shard.index - 1)
            .collect();
        for number in numbers.into_iter().rev() {
            report.take(verdict(campaign.seed + number));
        }
        report.finish();
        report
    }

    fn parts(of: u64) -> Vec<(String, Report)> {
        let part = |index| {
            let report = part(Shard { index, of });
            // As it comes out of its file.
            let read = serde_json::from_str(&report.json()).unwrap();
            (format!("part {index}"), read)
        };
        (1..=of).rev().map(part).collect()
    }

    #[test]
    fn parts_make_the_whole_byte_by_byte() {
        let whole = part(Shard::default());
        assert_eq!(whole.failures.len(), 6);
        for of in [1, 2, 5, 8, 19] {
            let merged = merge(parts(of)).unwrap();
            assert_eq!(merged.json(), whole.json(), "{of} parts");
            assert_eq!(merged.to_string(), whole.to_string());
        }
    }

    #[test]
    fn what_makes_no_whole_is_refused() {
        assert_eq!(merge(Vec::new()), Err(MergeError::Nothing));
        let mut all = parts(8);
        all.retain(|(name, _)| name != "part 3" && name != "part 5");
        let error = merge(all).unwrap_err().to_string();
        assert_eq!(error, "parts are missing: 3/8, 5/8");

        let mut all = parts(8);
        all.push(("again".into(), all[2].1.clone()));
        let error = merge(all).unwrap_err().to_string();
        assert_eq!(error, "part 6 and again are the same part, 6/8");

        let mut all = parts(3);
        all[1].1.campaign.images.clear();
        let error = merge(all).unwrap_err().to_string();
        let different = "part 3 and part 2 are parts of different campaigns: their images differ";
        assert_eq!(error, different);

        let mut all = parts(3);
        all[1].1.campaign.set.clear();
        let error = merge(all).unwrap_err().to_string();
        let values = "different campaigns: the values of --set and --bus differ";
        assert!(error.ends_with(values), "{error}");

        let mut all = parts(3);
        all[1].1.sequences = 5;
        let error = merge(all).unwrap_err().to_string();
        let few = "part 2 contradicts itself: it has 5 sequences, but part 2/3 of 19 has 6";
        assert_eq!(error, few);

        let many: Vec<_> = parts(19).into_iter().take(2).collect();
        let error = merge(many).unwrap_err().to_string();
        assert!(error.ends_with("8/19, and 9 more"), "{error}");

        let mut one = part(Shard::default());
        let of = 9_000_000_000_000_000_000;
        one.shard = Shard { index: 1, of };
        one.campaign.sequences = 1;
        one.sequences = 1;
        one.simulated_seconds = crate::sequence::END;
        one.failures.clear();
        one.causes.clear();
        one.broken_rules.clear();
        one.attacks = Some(Tally::default());
        let error = merge(vec![("one".into(), one)]).unwrap_err().to_string();
        assert!(error.ends_with("and 8999999999999999991 more"), "{error}");
    }

    /// A part is believed only if all that it says fits together.
    #[test]
    fn a_part_that_contradicts_itself_is_refused() {
        type Change = fn(&mut Report);
        let changes: [(Change, &str); 18] = [
            (
                |it| it.campaign.set[0] = "safety".into(),
                "\"safety\" is no value",
            ),
            (|it| it.campaign.set[0] += "\n", "is no value"),
            (|it| it.simulated_seconds = -5.0, "simulated_seconds"),
            (|it| it.simulated_seconds = 1e308, "simulated_seconds"),
            (|it| it.simulated_seconds = f64::NAN, "simulated_seconds"),
            (|it| it.campaign.sequences = u64::MAX, "sequences"),
            (
                |it| {
                    it.broken_rules.insert("stop".into(), 99);
                },
                "broken_rules",
            ),
            (
                |it| {
                    it.broken_rules.insert("bus".into(), 2);
                },
                "no rule \"bus\"",
            ),
            (
                |it| it.failures[0].violations[0].rule = "bus".into(),
                "no rule \"bus\"",
            ),
            (
                |it| it.failures[0].violations[0].at = -1.0,
                "broke a rule at",
            ),
            (|it| it.failures[0].violations.clear(), "broke no rule"),
            (
                |it| it.failures.push(it.failures[0].clone()),
                "is there twice",
            ),
            (|it| it.failures[0].seed = 77_777, "seed 77777 is none"),
            (|it| it.causes.clear(), "causes"),
            (|it| it.attacks = None, "attacks"),
            (
                |it| it.failures[0].story[0] = "\u{1b}[31m".into(),
                "control characters",
            ),
            (
                |it| it.attacks.as_mut().unwrap().flood_frames = u64::MAX,
                "counts more than",
            ),
            (
                |it| it.attacks.as_mut().unwrap().worst_recovery_seed = Some(1),
                "seed 1 is none",
            ),
        ];
        for (change, what) in changes {
            let mut one = part(Shard::default());
            change(&mut one);
            let error = merge(vec![("one".into(), one)]).unwrap_err().to_string();
            assert!(error.starts_with("one contradicts itself: "), "{error}");
            assert!(error.contains(what), "{what}: {error}");
            assert!(!error.contains('\u{1b}'), "{error}");
        }
    }
}

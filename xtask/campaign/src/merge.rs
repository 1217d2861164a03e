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
    /// A part has not the sequences that it should have.
    #[error("{part} has {has} sequences, but part {shard} of {of} has {should}")]
    Incomplete {
        /// The part.
        part: String,
        /// Its place.
        shard: Shard,
        /// Sequences of all parts.
        of: u64,
        /// What it has.
        has: u64,
        /// What it should have.
        should: u64,
    },
    /// Parts are missing.
    #[error("parts are missing: {}", list(missing))]
    Missing {
        /// They.
        missing: Vec<Shard>,
    },
}

/// Most missing parts that a sentence names.
const NAMED: usize = 8;

fn list(shards: &[Shard]) -> String {
    let mut names: Vec<String> = shards.iter().take(NAMED).map(Shard::to_string).collect();
    if let Some(more) = shards.len().checked_sub(NAMED).filter(|&more| more > 0) {
        names.push(format!("and {more} more"));
    }
    names.join(", ")
}

/// The report of the whole campaign, equal to that of one run, from the reports of all its parts with
/// their names.
///
/// # Errors
/// Parts are missing or doubled, or belong to different campaigns.
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
        let should = part.shard.sequences(campaign.sequences);
        if part.sequences != should {
            return Err(MergeError::Incomplete {
                part: name,
                shard: part.shard,
                of: campaign.sequences,
                has: part.sequences,
                should,
            });
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
    let missing = (1..=of).filter(|index| !found.contains_key(index));
    let missing: Vec<Shard> = missing.map(|index| Shard { index, of }).collect();
    if !missing.is_empty() {
        return Err(MergeError::Missing { missing });
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
        all[1].1.sequences = 5;
        let error = merge(all).unwrap_err().to_string();
        assert_eq!(error, "part 2 has 5 sequences, but part 2/3 of 19 has 6");

        let many: Vec<_> = parts(19).into_iter().take(2).collect();
        let error = merge(many).unwrap_err().to_string();
        assert!(error.ends_with("8/19, and 9 more"), "{error}");
    }
}

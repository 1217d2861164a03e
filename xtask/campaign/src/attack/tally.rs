//! What the attacks of a run, or of a campaign, did.

use std::collections::BTreeMap;

use can_bus::{Frame, NodeId, Record, RecordKind};
use embedded_can::Id;
use world::SimTime;

use super::{Attack, Kind, attacker::Planned};
use crate::Word;
use crate::traffic::Sent;

/// Numbers of a run with attacks, or of many. Frames count when they were sent to their end: those that
/// lost arbitration or were destroyed do not.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tally {
    /// Attacks, by kind.
    pub attacks: BTreeMap<Word, u64>,
    /// Forged and replayed frames, and references of a drift, by kind of attack.
    pub attempts: BTreeMap<Word, u64>,
    /// Those of them that carry the command's identifier and began in its window.
    pub attempts_in_command_window: u64,
    /// Frames of floods.
    pub flood_frames: u64,
    /// The same by kind of flood. Reports of earlier versions do not have it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub floods: BTreeMap<Word, u64>,
    /// Frames of the vehicle's nodes that suppressions destroyed.
    pub suppressed_frames: u64,
    /// The same by kind of attack, with 0 for one that found none of the frames that it aims at. Reports of earlier
    /// versions do not have it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub suppressed: BTreeMap<Word, u64>,
    /// Forged or replayed commands that moved a motor.
    pub moved_a_motor: u64,
    /// Longest time from the end of the last attack until every node's frames came again, s; of runs
    /// without faults beside the attacks.
    pub worst_recovery_seconds: f64,
    /// Seed of that run; `None` without such a run.
    pub worst_recovery_seed: Option<u64>,
    /// Broken rules that are known to be open, by rule: those that no node can keep because a
    /// reference is proven only by the next one, windows of a receiver whose epochs the schedule has not
    /// reached again, and foreign references that no console counts.
    pub known: BTreeMap<Word, u64>,
    /// The first of them: seed, time in s and what happened.
    pub known_examples: BTreeMap<Word, Example>,
}

/// An occurrence.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Example {
    /// Seed of its run.
    pub seed: u64,
    /// When, s since power-on.
    pub at: f64,
    /// What happened.
    pub what: String,
}

impl Tally {
    /// Number of forged and replayed frames.
    #[must_use]
    pub fn attempts(&self) -> u64 {
        self.attempts.values().sum()
    }

    /// Adds the numbers of a run.
    pub(crate) fn add(&mut self, other: &Self) {
        let sum = |to: &mut BTreeMap<Word, u64>, from: &BTreeMap<Word, u64>| {
            for (name, count) in from {
                *to.entry(name.clone()).or_default() += count;
            }
        };
        sum(&mut self.attacks, &other.attacks);
        sum(&mut self.attempts, &other.attempts);
        sum(&mut self.floods, &other.floods);
        sum(&mut self.suppressed, &other.suppressed);
        sum(&mut self.known, &other.known);
        self.attempts_in_command_window += other.attempts_in_command_window;
        self.flood_frames += other.flood_frames;
        self.suppressed_frames += other.suppressed_frames;
        self.moved_a_motor += other.moved_a_motor;
        // Of equal ones the lowest seed, whatever thread was first.
        let worse = (other.worst_recovery_seconds, other.worst_recovery_seed);
        let worst = (self.worst_recovery_seconds, self.worst_recovery_seed);
        if let Some(seed) = worse.1
            && worst
                .1
                .is_none_or(|known| worse.0 > worst.0 || (worse.0 == worst.0 && seed < known))
        {
            (self.worst_recovery_seconds, self.worst_recovery_seed) = worse;
        }
        for (rule, example) in &other.known_examples {
            let first = self.known_examples.get(rule);
            if first.is_none_or(|first| example.seed < first.seed) {
                self.known_examples.insert(rule.clone(), example.clone());
            }
        }
    }

    /// Notes a broken rule that is known to be open.
    pub(crate) fn note(&mut self, rule: Word, example: Example) {
        *self.known.entry(rule.clone()).or_default() += 1;
        self.known_examples.entry(rule).or_insert(example);
    }
}

/// A frame of the attacker that was sent to its end.
#[derive(Clone, Debug)]
pub(crate) struct Foreign {
    /// The frame, as of no node of the vehicle.
    pub(crate) sent: Sent,
    /// Place of its attack.
    pub(crate) attack: usize,
}

/// The attacker's frames in the records of a run. `nodes` and `planned` are those of
/// [`Attacker::finish`](super::Attacker::finish).
pub(crate) fn foreign(
    records: &[Record],
    attacks: &[Attack],
    (nodes, planned): &([NodeId; 2], Vec<Planned>),
) -> Vec<Foreign> {
    let mut waiting = planned.iter();
    let ends = records.iter().filter_map(|record| match record.kind {
        RecordKind::FrameEnd { frame, start, .. } => Some((record, frame, start)),
        _ => None,
    });
    let frames = ends.filter_map(|(record, frame, start)| {
        let attack = if record.node == nodes[0] {
            // It sends in the order of its plan; those that failed are left out.
            let sent = waiting.find(|planned| planned.frame == frame && planned.at <= start)?;
            sent.attack
        } else if record.node == nodes[1] {
            attacks.iter().position(|attack| is_flood(attack, start))?
        } else {
            return None;
        };
        Some(Foreign {
            sent: sent(&frame, start, record.at)?,
            attack,
        })
    });
    frames.collect()
}

/// Whether a flood back to back runs at an instant.
fn is_flood(attack: &Attack, at: SimTime) -> bool {
    let at = at.as_ticks() as f64 * 1e-12;
    matches!(attack.kind, Kind::Flood { .. }) && (attack.from..attack.until).contains(&at)
}

fn sent(frame: &Frame, start: SimTime, end: SimTime) -> Option<Sent> {
    let Id::Standard(id) = frame.id() else {
        return None;
    };
    Some(Sent {
        node: None,
        id: id.as_raw(),
        data: frame.data().to_vec(),
        start,
        end,
        complete: true,
    })
}

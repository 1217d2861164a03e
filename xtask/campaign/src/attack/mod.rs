//! Attacks on a vehicle's bus, drawn from a seed.
//!
//! The attacker is a node on the bus that knows these sources, the network file and all that was sent
//! before, but not the key of the network. It may send any frame at any time, and drive single bits.
//!
//! | attack | what it does |
//! | --- | --- |
//! | flood | one identifier, 0 or 0x7FF, back to back |
//! | random flood | both of them at random intervals |
//! | forged frames | made-up or altered data, with the right check value where there is one, just before the window of the true frame, at its beginning, behind the true frame, and at any other time |
//! | replayed frames | data that was sent before, at the same places |
//! | suppression | each frame with one identifier, or each frame, is destroyed by dominant bits; also while frames with that identifier are forged |
//! | bus-off | the same with all frames of one node, whose error counter drives it off the bus |
//! | drift | references whose period is a little too short or too long |
//!
//! Forged and replayed are commands, references and measurements (other messages with an exclusive
//! window that a node of the vehicle receives).

mod attacker;
mod tally;

use network_model::{Message, WindowKind};
use vehicle_model::{NodeIndex, Vehicle};
use world::random::{Purpose, Stream};

pub(crate) use attacker::{Attacker, Planned};
pub use tally::{Example, Tally};
pub(crate) use tally::{Foreign, foreign};

/// What a forged or replayed message is to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// It commands the motors.
    Command,
    /// A reference message.
    Reference,
    /// Any other one.
    Measurement,
}

/// What an attacker does.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// It sends frames with one identifier back to back.
    Flood {
        /// The identifier.
        id: u16,
    },
    /// It sends frames of highest and lowest priority at random intervals.
    RandomFlood {
        /// How many a second.
        rate: f64,
    },
    /// It sends frames with data of its own.
    Forge {
        /// What they are to the vehicle.
        role: Role,
        /// Their identifier.
        id: u16,
        /// How many a second, besides those that it aims at a window.
        rate: f64,
    },
    /// It sends frames again that it received before.
    Replay {
        /// What they are to the vehicle.
        role: Role,
        /// Their identifier.
        id: u16,
        /// How many a second, besides those that it aims at a window.
        rate: f64,
    },
    /// It destroys frames.
    Suppress {
        /// Their identifier; all frames if `None`.
        id: Option<u16>,
        /// The first bit that it drives, counted from start of frame as 0.
        bit: u16,
    },
    /// It destroys all frames of a node.
    BusOff {
        /// Their sender.
        node: NodeIndex,
        /// Their identifiers.
        ids: Vec<u16>,
        /// The first bit that it drives, counted from start of frame as 0.
        bit: u16,
    },
    /// It sends references of a time of its own.
    Drift {
        /// Their identifier.
        id: u16,
        /// How much longer than the basic cycle their period is, us; negative when shorter.
        step_us: f64,
    },
}

impl Kind {
    /// Its name in reports.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Flood { .. } => "flood",
            Self::RandomFlood { .. } => "random flood",
            Self::Forge { role, .. } => match role {
                Role::Command => "forged command",
                Role::Reference => "forged reference",
                Role::Measurement => "forged measurement",
            },
            Self::Replay { role, .. } => match role {
                Role::Command => "replayed command",
                Role::Reference => "replayed reference",
                Role::Measurement => "replayed measurement",
            },
            Self::Suppress { .. } => "suppression",
            Self::BusOff { .. } => "bus-off",
            Self::Drift { .. } => "drift",
        }
    }

    /// Whether its frames pass themselves off as those of a node.
    pub(crate) fn is_attempt(&self) -> bool {
        matches!(
            self,
            Self::Forge { .. } | Self::Replay { .. } | Self::Drift { .. }
        )
    }

    /// Whether it destroys frames.
    pub(crate) fn destroys(&self) -> bool {
        matches!(self, Self::Suppress { .. } | Self::BusOff { .. })
    }

    /// Whether it destroys frames with this identifier.
    pub(crate) fn aims_at(&self, frame: u16) -> bool {
        match self {
            Self::Suppress { id, .. } => id.is_none_or(|id| id == frame),
            Self::BusOff { ids, .. } => ids.contains(&frame),
            _ => false,
        }
    }
}

/// An attack.
#[derive(Clone, Debug, PartialEq)]
pub struct Attack {
    /// What it is.
    pub kind: Kind,
    /// Begin, s.
    pub from: f64,
    /// End, s.
    pub until: f64,
}

/// The message that commands the motors of a vehicle; `None` if its manifest names none.
#[must_use]
pub fn command(vehicle: &Vehicle) -> Option<&Message> {
    let command = vehicle.manifest().command.as_ref()?;
    let mut messages = vehicle.network().messages.iter();
    messages.find(|message| message.name == command.message)
}

/// Shortest attack, s.
const SHORTEST: f64 = 0.2;
/// Forged and replayed frames a second, least and most. The longest frame takes 0.54 ms.
const RATES: (f64, f64) = (100.0, 900.0);
/// Bits at which a suppression begins, least and most: behind the identifier, and before the end of the
/// shortest message of the vehicles.
const BITS: (u16, u16) = (13, 45);
/// Largest drift, us in a basic cycle of 100 ms: 1000 ppm.
const DRIFT_US: f64 = 100.0;

/// Draws the attacks of a seed: one to three, each perhaps with another one beside it, that begin from `first` to `last` and have ended at `over`,
/// s. A sentence for each is added to `story`.
pub(crate) fn draw(
    vehicle: &Vehicle,
    seed: u64,
    (first, last, over): (f64, f64, f64),
    story: &mut Vec<String>,
) -> Vec<Attack> {
    let mut drawing = Drawing {
        vehicle,
        stream: Stream::new(seed, Purpose::Attacks),
    };
    let count = 1 + drawing.stream.below(3);
    let mut attacks = Vec::new();
    for _ in 0..count {
        let from = drawing.within(first, last);
        let until = drawing.within(from + SHORTEST, over);
        let (kind, what) = drawing.kind();
        story.push(format!("from {from:.6} s to {until:.6} s {what}"));
        let aside = drawing.aside(&kind);
        attacks.push(Attack { kind, from, until });
        if let Some((kind, what)) = aside {
            story.push(format!("meanwhile {what}"));
            attacks.push(Attack { kind, from, until });
        }
    }
    attacks
}

struct Drawing<'a> {
    vehicle: &'a Vehicle,
    stream: Stream,
}

impl Drawing<'_> {
    fn within(&mut self, from: f64, to: f64) -> f64 {
        ((from + (to - from) * self.stream.uniform()) * 1e6).round() * 1e-6
    }

    fn one(&mut self, of: &[u16]) -> u16 {
        of[self.stream.below(of.len())]
    }

    fn bit(&mut self) -> u16 {
        BITS.0 + self.stream.below(usize::from(BITS.1 - BITS.0) + 1) as u16
    }

    /// Identifiers of messages with such windows, in order.
    fn ids(&self, kinds: &[WindowKind]) -> Vec<u16> {
        let messages = self.vehicle.network().messages.iter();
        let chosen = messages.filter(|message| kinds.contains(&message.window.kind));
        let mut ids: Vec<u16> = chosen.map(|message| message.id).collect();
        ids.sort_unstable();
        ids
    }

    fn kind(&mut self) -> (Kind, String) {
        match self.stream.below(14) {
            0 => {
                let id = self.one(&[0, 0x7FF]);
                let what = format!("the attacker fills the bus with {id}");
                (Kind::Flood { id }, what)
            }
            1 => {
                let rate = self.within(100.0, 1500.0).round();
                let what = format!("the attacker sends {rate} frames a second with 0 and 2047");
                (Kind::RandomFlood { rate }, what)
            }
            2 | 3 => self.suppress(),
            4 => self.bus_off(),
            5 => self.drift(),
            6..=10 => self.pose(Role::Command),
            11 | 12 => self.pose(Role::Reference),
            _ => self.pose(Role::Measurement),
        }
    }

    /// In one case of two, forged and replayed frames take the place of the true ones, which are destroyed.
    fn aside(&mut self, kind: &Kind) -> Option<(Kind, String)> {
        let (Kind::Forge { id, .. } | Kind::Replay { id, .. }) = *kind else {
            return None;
        };
        (self.stream.below(2) == 0).then(|| self.destroy(Some(id)))
    }

    fn suppress(&mut self) -> (Kind, String) {
        let ids = self.ids(&[WindowKind::Reference, WindowKind::Exclusive]);
        let id = (self.stream.below(4) > 0).then(|| self.one(&ids));
        self.destroy(id)
    }

    fn destroy(&mut self, id: Option<u16>) -> (Kind, String) {
        let bit = self.bit();
        let which = id.map_or("each frame".to_owned(), |id| format!("each frame {id}"));
        let what = format!("the attacker destroys {which} of the others from bit {bit} on");
        (Kind::Suppress { id, bit }, what)
    }

    fn bus_off(&mut self) -> (Kind, String) {
        // A bus guardian is the last of the nodes, and sends nothing.
        let senders = self.vehicle.participants().count();
        let node = NodeIndex(self.stream.below(senders));
        let name = &self.vehicle.node(node).name;
        let messages = self.vehicle.network().messages.iter();
        let own = messages.filter(|message| message.sender == *name);
        let ids = own.map(|message| message.id).collect();
        let name = name.clone();
        let bit = self.bit();
        let what = format!("the attacker destroys each frame of {name} from bit {bit} on");
        (Kind::BusOff { node, ids, bit }, what)
    }

    fn drift(&mut self) -> (Kind, String) {
        let references = self.ids(&[WindowKind::Reference]);
        let id = self.one(&references);
        let cycle = f64::from(self.vehicle.network().basic_cycle_us);
        let step_us = self.stream.symmetric(DRIFT_US * cycle / 100_000.0);
        let what = format!("the attacker sends references {id} {step_us:.3} us too late each time");
        (Kind::Drift { id, step_us }, what)
    }

    fn pose(&mut self, role: Role) -> (Kind, String) {
        let command = command(self.vehicle).map(|message| message.id);
        let ids = match role {
            Role::Command => command.into_iter().collect(),
            Role::Reference => self.ids(&[WindowKind::Reference]),
            Role::Measurement => {
                let mut ids = self.ids(&[WindowKind::Exclusive]);
                ids.retain(|id| Some(*id) != command && self.is_heard(*id));
                ids
            }
        };
        let id = self.one(&ids);
        let rate = self.within(RATES.0, RATES.1).round();
        if self.stream.below(2) == 0 {
            let what = format!("the attacker replays {id}, {rate} a second and at its window");
            return (Kind::Replay { role, id, rate }, what);
        }
        let what = format!("the attacker forges {id}, {rate} a second and at its window");
        (Kind::Forge { role, id, rate }, what)
    }

    /// Whether a node of the vehicle receives a message.
    fn is_heard(&self, id: u16) -> bool {
        let message = self.vehicle.network().message(id);
        let mut nodes = self.vehicle.nodes();
        message
            .is_some_and(|message| nodes.any(|node| message.is_for(&self.vehicle.node(node).name)))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use crate::{Sequence, uagv};

    #[test]
    fn every_kind_of_attack_is_drawn_and_ends_in_time() {
        let vehicle = uagv();
        let mut names = BTreeSet::new();
        for seed in 0..200 {
            let sequence = Sequence::attacked(&vehicle, seed, true);
            assert_eq!(sequence, Sequence::attacked(&vehicle, seed, true));
            assert!(sequence.scenario.key);
            for attack in &sequence.attacks {
                assert!(attack.until - attack.from >= super::SHORTEST);
                assert!(attack.until <= crate::sequence::OVER);
                names.insert(attack.kind.name());
            }
        }
        let every = [
            "flood",
            "random flood",
            "forged command",
            "forged reference",
            "forged measurement",
            "replayed command",
            "replayed reference",
            "replayed measurement",
            "suppression",
            "bus-off",
            "drift",
        ];
        assert_eq!(names, BTreeSet::from(every));
    }

    /// The faults of a seed are the same whether there are attacks in other campaigns or not.
    #[test]
    fn a_campaign_without_an_attacker_has_no_attacks_and_no_key() {
        let sequence = Sequence::draw(&uagv(), 3);
        assert!(sequence.attacks.is_empty() && !sequence.scenario.key);
    }
}

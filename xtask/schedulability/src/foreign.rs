//! Frames of nodes that are not the vehicle's: a load of its bus that the analysis takes into account.

use std::str::FromStr;

use network_model::{Condition, Message, Network, SendType, Window, WindowKind};

/// The sender of foreign messages; no node of a network file has a blank in its name.
pub(crate) const SENDER: &str = "a foreign node";

/// A message of a foreign node.
///
/// Without a schedule each foreign message competes with its identifier as soon as its frame is put. By
/// the schedule the foreign nodes have [`windows`] of their own, and send what finds room there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreign {
    /// Its identifier, 11 bits.
    pub id: u16,
    /// Its data bytes, 0 to 8.
    pub length: u8,
    /// Least time between the nominal instants of two frames, microseconds, above 0.
    pub period_us: u32,
    /// How long after its nominal instant a frame may be put, microseconds.
    pub jitter_us: u32,
}

impl FromStr for Foreign {
    type Err = String;

    /// Reads `ID:BYTES:PERIOD` or `ID:BYTES:PERIOD:JITTER`, times in microseconds.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            "ID:BYTES:PERIOD or ID:BYTES:PERIOD:JITTER is accepted: an identifier up to 2047, 0 to 8 data \
             bytes, microseconds from 1 to 3600000000"
                .to_owned()
        };
        let numbers: Result<Vec<u32>, _> = text.split(':').map(str::parse).collect();
        let (id, length, period_us, jitter_us) = match numbers.map_err(|_| wrong())?.as_slice() {
            [id, length, period] => (*id, *length, *period, 0),
            [id, length, period, jitter] => (*id, *length, *period, *jitter),
            _ => return Err(wrong()),
        };
        const HOUR: u32 = 3_600_000_000;
        if id > 2047 || length > 8 || !(1..=HOUR).contains(&period_us) || jitter_us > HOUR {
            return Err(wrong());
        }
        Ok(Self {
            id: id as u16,
            length: length as u8,
            period_us,
            jitter_us,
        })
    }
}

impl Foreign {
    /// Its name in reports.
    pub(crate) fn name(&self) -> String {
        format!("foreign {}", self.id)
    }
}

/// A message of the foreign nodes in a network.
fn message(id: u16, name: String, lengths: (u8, u8), window: Window, cycle_us: u32) -> Message {
    Message {
        id,
        name,
        comment: String::new(),
        length: lengths.1,
        shortest: lengths.0,
        sender: SENDER.into(),
        send_type: SendType::Cyclic {
            period_ms: cycle_us.div_ceil(1000),
        },
        condition: Condition::Always,
        deadline_us: None,
        window,
        further: Vec::new(),
        after: Vec::new(),
        retry_late: false,
        instead_of: None,
        preparation_us: 0,
        signals: Vec::new(),
        line: None,
    }
}

/// The longest stretch of the basic cycle that belongs to no message, in any of the basic cycles: its
/// begin and its length, microseconds.
fn free_stretch(network: &Network) -> (u32, u32) {
    let mut windows = network.windows();
    windows.sort_by_key(|window| window.start_us);
    let (mut best, mut end) = ((0, 0), 0);
    let ends = windows
        .iter()
        .map(|window| (window.start_us, window.end_us()));
    for (start, until) in ends.chain([(network.basic_cycle_us, network.basic_cycle_us)]) {
        if start.saturating_sub(end) > best.1 {
            best = (end, start - end);
        }
        end = end.max(until);
    }
    best
}

/// The windows of foreign nodes that keep a network's schedule: as many as find room at the end of the
/// longest stretch of the basic cycle that belongs to no message of the vehicle. Each is for one frame
/// with `bytes` data bytes, and as long as the longest of the vehicle's windows for such a frame, because
/// its nodes need the time behind a frame to handle it.
#[must_use]
pub fn windows(network: &Network, bytes: u8) -> Vec<Window> {
    let (start_us, free_us) = free_stretch(network);
    let window = Window {
        start_us,
        length_us: 0,
        repeat: 1,
        offset: 0,
        kind: WindowKind::Exclusive,
    };
    let frame = message(
        0,
        String::new(),
        (bytes, bytes),
        window,
        network.basic_cycle_us,
    );
    let own = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Exclusive && message.length >= bytes);
    let own = own.map(|message| message.window.length_us).max();
    let length_us = network.needed_us(&frame).max(own.unwrap_or(1)).max(1);
    let count = free_us / length_us;
    let first = start_us + free_us - count * length_us;
    (0..count)
        .map(|place| Window {
            start_us: first + place * length_us,
            length_us,
            ..window
        })
        .collect()
}

/// Checks that no message of the network has the identifier of a foreign one.
///
/// # Errors
/// One has; the sentence names it.
pub(crate) fn check(network: &Network, foreign: &[Foreign]) -> Result<(), String> {
    for (at, one) in foreign.iter().enumerate() {
        let mut own = network.messages.iter();
        if let Some(own) = own.find(|message| message.id == one.id) {
            let Foreign { id, .. } = one;
            return Err(format!(
                "a foreign message has the identifier {id} of {}",
                own.name
            ));
        }
        if foreign[..at].iter().any(|other| other.id == one.id) {
            return Err(format!(
                "two foreign messages have the identifier {}",
                one.id
            ));
        }
    }
    Ok(())
}

/// Adds the windows of foreign nodes to the schedule of a network.
pub(crate) fn schedule(network: &mut Network, foreign: &[Foreign]) {
    let lengths = || foreign.iter().map(|one| one.length);
    let (Some(shortest), Some(longest)) = (lengths().min(), lengths().max()) else {
        return;
    };
    let cycle = network.basic_cycle_us;
    let windows = windows(network, longest).into_iter().enumerate();
    let messages = windows
        .zip(foreign.iter().cycle())
        .map(|((place, window), one)| {
            let name = format!("foreign window {place}");
            message(one.id, name, (shortest, longest), window, cycle)
        });
    network.messages.extend(messages);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row_follower() -> Network {
        let text = include_str!("../../../firmware/vehicles/row-follower/network.dbc");
        Network::parse(text).unwrap()
    }

    #[test]
    fn by_the_schedule_foreign_frames_have_windows_of_their_own() {
        let mut network = row_follower();
        assert_eq!(free_stretch(&network), (4200, 800));
        let own = network.messages.clone();
        let foreign: Vec<Foreign> = ["150:8:1350", "600:2:9000"]
            .map(|text| text.parse().unwrap())
            .to_vec();
        schedule(&mut network, &foreign);
        // Nobody else's window has changed.
        assert_eq!(network.messages[..own.len()], own);
        let added = &network.messages[own.len()..];
        // As long as that of the command.
        let windows: Vec<_> = added
            .iter()
            .map(|message| (message.window.start_us, message.window.length_us))
            .collect();
        assert_eq!(windows, [(4480, 520)]);
        for message in added {
            assert_eq!(message.sender, SENDER);
            assert_eq!((message.shortest, message.length), (2, 8));
        }
        // Without foreign messages there are no such windows.
        network.messages.truncate(own.len());
        schedule(&mut network, &[]);
        assert_eq!(network.messages, own);
    }

    #[test]
    fn an_identifier_belongs_to_one_message() {
        let network = row_follower();
        let refused = |all: &[&str]| {
            let all: Vec<Foreign> = all.iter().map(|text| text.parse().unwrap()).collect();
            check(&network, &all).err()
        };
        assert_eq!(refused(&["150:8:1000", "151:8:1000"]), None);
        assert_eq!(
            refused(&["300:8:1000"]).unwrap(),
            "a foreign message has the identifier 300 of Command"
        );
        assert_eq!(
            refused(&["150:8:1000", "150:1:500"]).unwrap(),
            "two foreign messages have the identifier 150"
        );
    }
}

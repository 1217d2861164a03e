//! Nodes and messages that are only sometimes on the bus, in a file of their own.

/// Statements of a network file in the order in which they must stand.
const ORDER: [&str; 7] = ["BU_", "VAL_TABLE_", "BO_", "CM_", "BA_DEF_", "BA_", "VAL_"];

/// The text of a network file with what a supplement adds to it: nodes (`BU_`), value tables
/// (`VAL_TABLE_`), messages with their signals (`BO_`, `SG_`), comments (`CM_`), values of attributes
/// (`BA_`) and of signals (`VAL_`). A value of an attribute takes the place of the
/// file's. Each statement of the supplement stands on one line, a message and
/// its signals on adjacent ones. The attributes themselves are those of the network file.
///
/// # Errors
/// The number of the line (from 1) that is no such statement, and what it is.
pub fn supplemented(network: &str, supplement: &str) -> Result<String, String> {
    let mut lines: Vec<String> = network.lines().map(str::to_owned).collect();
    // A message ends with a blank line.
    let mut added: [Vec<String>; ORDER.len()] = Default::default();
    let mut nodes = String::new();
    for (index, line) in supplement.lines().enumerate() {
        let trimmed = line.trim();
        let is_signal = trimmed.starts_with("SG_ ");
        let keyword = trimmed.split([' ', ':']).next().unwrap_or_default();
        match ORDER.iter().position(|known| *known == keyword) {
            _ if trimmed.is_empty() => {}
            _ if is_signal => added[2].push(line.to_owned()),
            Some(0) => {
                let names = trimmed.split_once(':').map_or("", |(_, names)| names);
                nodes = format!("{nodes} {}", names.trim());
            }
            Some(4) | None => {
                return Err(format!("line {}: {trimmed:?} cannot be added", index + 1));
            }
            Some(5) => {
                let replaced = format!("{} ", attribute_of(trimmed));
                lines.retain(|own| !own.starts_with(&replaced));
                added[5].push(line.to_owned());
            }
            Some(place) => {
                if place == 2 {
                    added[2].push(String::new());
                }
                added[place].push(line.to_owned());
            }
        }
    }
    // From the end, so that the places in front of it stay.
    for (place, new) in added.into_iter().enumerate().rev() {
        if !new.is_empty() {
            let at = place_of(&lines, place);
            lines.splice(at..at, new);
        }
    }
    if let Some(line) = lines.iter_mut().find(|line| line.starts_with("BU_:")) {
        line.push_str(nodes.trim_end());
    }
    lines.push(String::new());
    Ok(lines.join("\n"))
}

/// What a `BA_` statement gives a value to: the attribute and the node, message or signal, if it is one of these. The
/// value itself may have spaces.
fn attribute_of(statement: &str) -> &str {
    let words = match statement.split(' ').nth(2) {
        Some("BU_" | "BO_") => 4,
        Some("SG_") => 5,
        _ => 2,
    };
    let mut spaces = statement.match_indices(' ');
    let end = spaces.nth(words - 1);
    end.map_or(statement, |(end, _)| &statement[..end])
}

/// The line before which a statement stands that comes behind all of its kind and of those before it.
fn place_of(lines: &[String], place: usize) -> usize {
    let keyword = |line: &str| {
        let word = line.trim().split([' ', ':']).next().unwrap_or_default();
        if word == "SG_" {
            Some(2)
        } else {
            ORDER.iter().position(|known| *known == word)
        }
    };
    // Keywords also stand alone in the list of `NS_`, before the nodes.
    let nodes = lines.iter().position(|line| line.starts_with("BU_:"));
    let from = nodes.unwrap_or(0);
    let last = lines[from..]
        .iter()
        .rposition(|line| keyword(line).is_some_and(|found| found <= place));
    last.map_or(lines.len(), |last| from + last + 1)
}

#[cfg(test)]
mod tests {
    use super::supplemented;
    use crate::{Message, Network};

    const UAGV: &str = include_str!("../../../vehicles/uagv/network.dbc");
    const ROWS: &str = include_str!("../../../vehicles/uagv/rows.dbc");

    fn without_lines(message: &Message) -> Message {
        let mut message = message.clone();
        message.line = None;
        message
            .signals
            .iter_mut()
            .for_each(|signal| signal.line = None);
        message
    }

    #[test]
    fn a_value_with_spaces_takes_the_place_of_another() {
        let line = "BA_ \"After\" BO_ 300 \"Velocity SteeringPot\";";
        let network = Network::parse(&supplemented(UAGV, line).unwrap()).unwrap();
        assert_eq!(
            network.message(300).unwrap().after,
            ["Velocity", "SteeringPot"]
        );
        let line = "BA_ \"TransmitEnable\" 8;";
        let network = Network::parse(&supplemented(UAGV, line).unwrap()).unwrap();
        assert_eq!(network.transmit_enable_bits, 8);
    }

    #[test]
    fn a_supplement_adds_its_node_and_messages_and_changes_no_other() {
        let before = Network::parse(UAGV).unwrap();
        let text = supplemented(UAGV, ROWS).unwrap();
        let after = Network::parse(&text).unwrap();
        let names = |network: &Network| {
            let nodes = network.nodes.iter().map(|node| node.name.clone());
            nodes.collect::<Vec<_>>()
        };
        let mut nodes = names(&before);
        nodes.push("rows".into());
        assert_eq!(names(&after), nodes);
        let ids = [207, 454, 515, 525];
        for message in &after.messages {
            let own = before.message(message.id);
            assert_eq!(own.is_none(), ids.contains(&message.id), "{}", message.name);
            if let Some(own) = own {
                let mut own = without_lines(own);
                if own.id == 300 {
                    // What it needs may come later in a wider transmit enable window.
                    own.preparation_us = 500;
                }
                if own.window.kind == crate::WindowKind::Arbitrating {
                    // It has room for one more node, and for a disturbed frame.
                    own.window.length_us = 11_500;
                }
                assert_eq!(without_lines(message), own);
            }
        }
        // The node's window timer needs a wider transmit enable window.
        assert_eq!(
            (before.transmit_enable_bits, after.transmit_enable_bits),
            (16, 32)
        );
        assert_eq!(after.messages.len(), before.messages.len() + ids.len());
        let offset = after.message(207).unwrap();
        assert_eq!(
            (offset.sender.as_str(), offset.window.start_us),
            ("rows", 90_000)
        );
        let presence = offset
            .signals
            .iter()
            .find(|signal| signal.name == "Presence");
        assert_eq!(presence.unwrap().values.as_deref(), Some("RowPresence"));
    }

    #[test]
    fn an_empty_supplement_changes_nothing() {
        let own = Network::parse(UAGV).unwrap();
        let same = Network::parse(&supplemented(UAGV, "\n").unwrap()).unwrap();
        assert_eq!(own, same);
    }

    #[test]
    fn what_is_no_addition_is_refused() {
        for (line, what) in [
            ("BA_DEF_ \"More\" INT 0 1;", "line 2: \"BA_DEF_"),
            ("VERSION \"\"", "line 2: \"VERSION"),
        ] {
            let error = supplemented(UAGV, &format!("BU_: rows\n{line}\n")).unwrap_err();
            assert!(
                error.starts_with(what) && error.ends_with("cannot be added"),
                "{error}"
            );
        }
    }
}

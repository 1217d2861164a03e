//! Facts in the vehicle's own network file.

use network_model::{Condition, Network, SendType, WindowKind};

fn network() -> Network {
    Network::parse(include_str!("../../../vehicles/uagv/network.dbc")).expect("the file is right")
}

/// Position and heading stay off the bus while the solution is not fixed.
#[test]
fn two_messages_wait_for_a_fix() {
    let network = network();
    let waiting: Vec<u16> = network
        .messages
        .iter()
        .filter(|message| message.condition == Condition::WhileFixed)
        .map(|message| message.id)
        .collect();
    assert_eq!(waiting, [200, 202]);
}

#[test]
fn every_signal_and_message_is_described() {
    for message in network().messages {
        assert!(!message.comment.is_empty(), "{}", message.name);
        for signal in &message.signals {
            assert!(
                !signal.comment.is_empty(),
                "{}.{}",
                message.name,
                signal.name
            );
        }
    }
}

#[test]
fn the_arbitrating_window_holds_all_events_of_one_cycle() {
    let network = network();
    let events: Vec<_> = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Arbitrating)
        .collect();
    assert!(
        events
            .iter()
            .all(|m| matches!(m.send_type, SendType::Event { .. }))
    );
    let bits: u32 = events
        .iter()
        .map(|m| network_model::worst_case_bits(m.length))
        .sum();
    let length = events[0].window.length_us;
    assert!(
        bits * network.bit_time_ns() / 1000 < length,
        "{bits} bits in {length} us"
    );
}

#[test]
fn a_node_receives_what_names_it() {
    let network = network();
    let of = |node: &str| {
        let messages = network.messages.iter();
        let received = messages.filter(|message| message.is_for(node));
        received.map(|message| message.id).collect::<Vec<_>>()
    };
    // Of the cyclic ones, the drive needs the command only; a node never receives its own.
    assert!(of("drive").contains(&300) && !of("drive").contains(&200));
    assert!(!of("controller").contains(&300) && of("controller").contains(&200));
    assert!(of("logger").contains(&200));
    // A message that names nobody is for all but its sender.
    let mut message = network.message(300).expect("the command").clone();
    for signal in &mut message.signals {
        signal.receivers = vec!["Vector__XXX".into()];
    }
    assert!(message.is_for("gps") && !message.is_for("controller"));
}

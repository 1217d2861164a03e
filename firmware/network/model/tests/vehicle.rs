//! Facts in the vehicle's own network file.

use network_model::{Condition, Network, SendType, WindowKind, generate};

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
fn a_message_may_be_sent_late() {
    let file = include_str!("../../../vehicles/uagv/network.dbc");
    assert_eq!(network().late_messages(), []);
    assert!(!generate::matrix(&network()).contains("retry_late"));
    let file = file.replace("\nVAL_ 300 ", "\nBA_ \"RetryLate\" BO_ 300 1;\nVAL_ 300 ");
    let network = Network::parse(&file).expect("the file is right");
    let late = network.late_messages();
    let [late] = late.as_slice() else {
        panic!("{late:?}");
    };
    assert!(late.is_named("Command") && !late.is_named("Comm"));
    assert_eq!(
        (late.id, late.length, late.window.start_us),
        (300, 8, 12_000)
    );
    assert_eq!(late.send_type, SendType::Event { interval_ms: 100 });
    let rust = generate::matrix(&network);
    let rust: Vec<&str> = rust
        .lines()
        .filter(|line| line.contains("retry_late"))
        .collect();
    assert!(
        matches!(rust[..], [line] if line.contains("\"command\"")),
        "{rust:?}"
    );
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

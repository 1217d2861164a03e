//! Windows are written into a network file without touching the rest of it.

use std::sync::LazyLock;

use network_model::{Assignment, Network, Window, WindowKind, generate};
use proptest::prelude::*;

/// The vehicle's file without `After` attributes, so that any order of windows is accepted.
static VEHICLE: LazyLock<String> = LazyLock::new(|| {
    let file = include_str!("../../../vehicles/uagv/network.dbc");
    let (before, after) = file.split_once("BA_ \"After\" BO_ 300").unwrap();
    let (_, rest) = after.split_once('\n').unwrap();
    format!("{before}{rest}")
});

fn vehicle() -> Network {
    Network::parse(&VEHICLE).unwrap()
}

fn sorted(mut assignment: Assignment) -> Assignment {
    assignment.messages.sort_by_key(|message| message.id);
    assignment
}

/// The vehicle's schedule with its exclusive windows in another order.
fn dealt(order: &[usize]) -> Assignment {
    let mut assignment = sorted(Assignment::of(&vehicle()));
    let exclusive = |window: &Window| window.kind == WindowKind::Exclusive;
    let mut windows: Vec<Window> = vehicle().windows();
    windows.retain(exclusive);
    let mut order = order.iter();
    for message in &mut assignment.messages {
        for window in message
            .windows
            .iter_mut()
            .filter(|window| exclusive(window))
        {
            *window = windows[*order.next().unwrap()];
        }
    }
    assignment
}

fn exclusive_windows() -> usize {
    let windows = vehicle().windows();
    let exclusive = windows
        .iter()
        .filter(|window| window.kind == WindowKind::Exclusive);
    exclusive.count()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_written_file_reads_back(order in Just((0..exclusive_windows()).collect::<Vec<_>>()).prop_shuffle()) {
        let assignment = dealt(&order);
        let text = assignment.write(&VEHICLE);
        let network = Network::parse(&text).unwrap();
        prop_assert_eq!(sorted(Assignment::of(&network)), assignment);
        // Only starts change, each in its own line.
        prop_assert_eq!(text.lines().count(), VEHICLE.lines().count());
        for (new, old) in text.lines().zip(VEHICLE.lines()) {
            prop_assert!(new == old || new.starts_with("BA_ \"WindowStart\" BO_ "), "{}", new);
        }
        // Writing the old schedule gives the old text.
        prop_assert_eq!(&sorted(Assignment::of(&vehicle())).write(&text), &*VEHICLE);
    }
}

#[test]
fn the_schedule_that_a_file_has_changes_nothing() {
    assert_eq!(Assignment::of(&vehicle()).write(&VEHICLE), *VEHICLE);
}

#[test]
fn a_message_may_have_several_windows() {
    let mut assignment = Assignment::of(&vehicle());
    assignment.basic_cycles = 4;
    for message in &mut assignment.messages {
        if message.id == 206 {
            let first = message.windows[0];
            let window = |start_us, offset| Window {
                start_us,
                repeat: 4,
                offset,
                ..first
            };
            message.windows = vec![window(6_000, 0), window(20_000, 1), window(30_000, 3)];
        }
    }
    let text = assignment.write(&VEHICLE);
    assert!(text.contains("BA_ \"FurtherWindows\" BO_ 206 \"20000 4 1, 30000 4 3\";\n"));
    // Three times in 400 ms is no period in whole milliseconds.
    let refused = Network::parse(&text).unwrap_err().to_string();
    assert!(
        refused.contains("its window comes every 133.3"),
        "{refused}"
    );

    let four = text.replace("30000 4 3\"", "30000 4 3, 40000 4 2\"");
    let network = Network::parse(&four).unwrap();
    let pot = network.message(206).unwrap();
    assert_eq!(pot.windows().count(), 4);
    assert_eq!(network.windows().len(), vehicle().windows().len() + 3);
    let rust = generate::matrix(&network);
    for name in ["STEERING_POT:", "STEERING_POT_2:", "STEERING_POT_4:"] {
        assert!(rust.contains(name), "{name} is not in {rust}");
    }

    let overlap = four.replace("20000 4 1", "7500 4 1");
    let refused = Network::parse(&overlap).unwrap_err().to_string();
    assert!(
        refused.contains("SteeringPot (206), 7500 to 8500 us"),
        "{refused}"
    );
    for wrong in ["20000 4", "20000 4 1 1", "20000 4 x", "-1 4 1"] {
        let text = four.replace("20000 4 1", wrong);
        let refused = Network::parse(&text).unwrap_err().to_string();
        assert!(
            refused.contains("\"start repeat offset\" is accepted"),
            "{refused}"
        );
    }
    let shared = assignment.write(&VEHICLE).replace(
        "BA_ \"FurtherWindows\" BO_ 206",
        "BA_ \"FurtherWindows\" BO_ 501",
    );
    let refused = Network::parse(&shared).unwrap_err().to_string();
    assert!(refused.contains("only an exclusive window"), "{refused}");
}

#[test]
fn comments_and_lists_of_keywords_are_no_attributes() {
    let trap = "CM_ BO_ 206 \"BA_ \\\"WindowStart\\\" BO_ 206 1;\nBA_ \\\"WindowStart\\\" BO_ 206 2; \";\n";
    let at = VEHICLE.find("\nBA_DEF_ ").unwrap() + 1;
    let text = format!("{}{trap}{}", &VEHICLE[..at], &VEHICLE[at..]);
    let mut order: Vec<usize> = (0..exclusive_windows()).collect();
    order.reverse();
    let written = dealt(&order).write(&text);
    assert!(written.contains(trap));
    assert_eq!(written.replace(trap, ""), dealt(&order).write(&VEHICLE));
}

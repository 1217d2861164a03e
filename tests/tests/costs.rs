//! Cost of the protocol stack on the target.

use xtask::{
    Workspace,
    bench::{self, Builder, Profile},
};

fn workspace() -> Workspace {
    Workspace::find().unwrap_or_else(|failure| panic!("{failure}"))
}

/// Whether a table of the crate's README has this row, or one that goes on behind it.
fn is_told(row: &str) {
    let readme = workspace().root().join("ttcan/README.md");
    let text = std::fs::read_to_string(readme).unwrap_or_else(|error| panic!("{error}"));
    assert!(
        text.lines().any(|line| line.starts_with(row)),
        "ttcan/README.md has no row: {row}"
    );
}

#[test]
fn an_event_costs_as_much_with_512_windows_as_with_8() {
    let workspace = workspace();
    let builder = Builder::new(&workspace).unwrap_or_else(|failure| panic!("{failure}"));
    let costs = bench::cycles::measure(&builder, bench::EVERYTHING)
        .unwrap_or_else(|failure| panic!("{failure}"));
    assert_eq!(costs.len(), 3);
    // As a program with another stack it costs the same.
    let program = builder.events(bench::EVERYTHING);
    let again = program.and_then(|path| bench::cycles::foreign(&path));
    let again = again.unwrap_or_else(|failure| panic!("{failure}"));
    assert_eq!(costs, again);
    for cost in costs {
        println!(
            "{}: {} cycles with 8 windows, {} with 512",
            cost.event, cost.few, cost.many
        );
        assert!(cost.few > 50, "an event that costs nothing did not happen");
        let most = if cost.event == "reference received" {
            1800
        } else {
            400
        };
        assert!(cost.few < most, "{cost:?}");
        // Only the length of address computations may differ.
        assert!(cost.many.abs_diff(cost.few) <= cost.few / 50, "{cost:?}");
        is_told(&format!(
            "| {} | {} | {} |",
            cost.event, cost.few, cost.many
        ));
    }
}

/// Looks come every 2.2 bits, which is 1600 cycles at 180 MHz and 250 kbit/s. What else the image's task does has to fit too.
#[test]
fn a_look_at_four_lines_takes_little_more_than_a_third_of_its_time() {
    let workspace = workspace();
    let builder = Builder::new(&workspace).unwrap_or_else(|failure| panic!("{failure}"));
    let costs = bench::cycles::guardian(&builder).unwrap_or_else(|failure| panic!("{failure}"));
    println!("{costs:?}");
    for (event, cycles) in &costs {
        is_told(&format!("| {event} | {cycles} |"));
    }
    let [
        (_, rest),
        looks @ ..,
        (_, ahead),
        (_, message),
        (_, reference),
    ] = &costs[..]
    else {
        panic!("six events and more");
    };
    assert!((10..100).contains(rest), "{costs:?}");
    let longest = looks.iter().map(|(_, cycles)| *cycles).max();
    assert!(longest.is_some_and(|cycles| cycles < 550), "{costs:?}");
    // The handling of a reference has to be over within a short spell of 28 bits.
    let handling = message.max(reference) + ahead;
    assert!(handling < 28 * 720 / 3, "{costs:?}");
}

/// The control step is released 600 us before its window, which is 108 000 cycles at 180 MHz.
/// Limiting it to a fourteenth of that, as flashed, leaves room for other tasks, and its bound is
/// close to what it takes.
#[test]
fn a_control_step_takes_a_fourteenth_of_its_time() {
    let workspace = workspace();
    let builder = Builder::new(&workspace).unwrap_or_else(|failure| panic!("{failure}"));
    let costs = bench::control::measure(&builder).unwrap_or_else(|failure| panic!("{failure}"));
    println!("{}", bench::control::report(&costs));
    let [step, estimator, ..] = costs[..] else {
        panic!("no costs");
    };
    assert!(estimator.coming.flashed < step.coming.flashed && step.coming.flashed < 7700);
    let bound = step.bound.unwrap_or_else(|| panic!("no bound"));
    assert!(bound.zero_wait * 4 < step.coming.zero_wait * 5, "{bound:?}");
    let again = bench::control::measure(&builder).unwrap_or_else(|failure| panic!("{failure}"));
    assert_eq!(costs, again);
}

#[test]
fn a_node_of_level_1_takes_less_than_3_7_kb_of_code() {
    let workspace = workspace();
    let builder = Builder::new(&workspace).unwrap_or_else(|failure| panic!("{failure}"));
    let size = bench::size::measure(&builder, bench::LEAST, Profile::Small)
        .unwrap_or_else(|failure| panic!("{failure}"));
    println!(
        "{} bytes of code and constants, {} of RAM",
        size.code, size.ram
    );
    assert!((2000..3700).contains(&size.code), "{size:?}");
    is_told(&format!("| none: level 1, never master | {} |", size.code));
    assert!(size.ram < 512, "{size:?}");
}

#[test]
fn a_node_with_everything_takes_10_kib_of_code_at_most() {
    let workspace = workspace();
    let builder = Builder::new(&workspace).unwrap_or_else(|failure| panic!("{failure}"));
    let size = bench::size::measure(&builder, bench::EVERYTHING, Profile::Small)
        .unwrap_or_else(|failure| panic!("{failure}"));
    println!(
        "{} bytes of code and constants, {} of RAM",
        size.code, size.ram
    );
    assert!((8000..=10_240).contains(&size.code), "{size:?}");
    is_told(&format!("| all (default) | {} |", size.code));
}

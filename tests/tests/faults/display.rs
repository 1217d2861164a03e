//! A display that answers, and one that does not.

use furrow_tests::Journey;
use furrow_tests::nodes;

use crate::{assert_never_reset, assert_steady, running};

#[test]
fn a_display_that_never_answers_hinders_nothing() {
    let mut journey = running("lcd.acknowledges = false");
    journey.to(6.0);
    assert_eq!(journey.mode(), Some(crate::mode::RUN));
    assert_steady(&journey, &[100, 200, 206, 300, 450, 453], 1.0, 6.0);
    assert_never_reset(&journey);
    journey.assert_in_place();
    // The console reports it, and the node still sends the rows to the display.
    let console = journey.console(nodes::CONTROLLER);
    assert!(
        console
            .lines()
            .rev()
            .take(3)
            .any(|line| line.contains("lcd?")),
        "{console}"
    );
    assert!(journey.vehicle.world().counters().lcd_commands > 20);
}

#[test]
fn a_display_that_answers_counts_as_present() {
    let mut journey = Journey::of("start.east = \"0.3 m\"");
    journey.to(2.5);
    let console = journey.console(nodes::CONTROLLER);
    assert!(console.lines().count() > 5, "{console}");
    assert!(!console.contains("lcd?"), "{console}");
    assert!(journey.vehicle.world().counters().lcd_commands > 20);
    assert_shown(&journey, "idle");
}

/// Asserts that the display shows rows that begin like this, and understood every byte.
fn assert_shown(journey: &Journey, rows: &str) {
    let world = journey.vehicle.world();
    let text = world.lcd_text();
    println!("{text}");
    assert_eq!(world.counters().lcd_refused, 0);
    assert_eq!(world.counters().lcd_wrong_baud, 0);
    assert!(text.starts_with(rows), "{text}");
    assert!(text.ends_with("green green green\n"), "{text}");
}

//! Boards without a clock at their clock input.

use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::at;
use twin::Twin;

use crate::{RUNNING, assert_never_reset, assert_steady, mode};

#[test]
fn the_f303_nodes_keep_the_schedule_on_their_internal_oscillators() {
    let text = format!(
        r#"
        nodes.steering = {{ external = false, internal = "3000 ppm" }}
        nodes.drive = {{ external = false, internal = "-3000 ppm" }}
        {RUNNING}
        "#
    );
    let mut journey = Journey::of(&text);
    journey.to(4.0);
    let rate = |vehicle: &Twin, node| vehicle.node(node).core_hz();
    assert_eq!(rate(&journey.vehicle, nodes::STEERING) / 1_000_000, 64);
    assert_eq!(rate(&journey.vehicle, nodes::DRIVE) / 1_000_000, 64);
    assert_eq!(journey.mode(), Some(mode::RUN));
    assert!(journey.effort(nodes::DRIVE, at(4.0)) > 0.2);
    assert!(journey.last_moved(nodes::STEERING).is_some());
    assert_steady(&journey, &[100, 206, 300], 1.0, 4.0);
    journey.assert_in_place();
    assert_never_reset(&journey);
    let counters = journey.vehicle.world().counters();
    assert_eq!(counters.motor_garbled, 0);
    assert!(counters.motor_bytes > 50);
}

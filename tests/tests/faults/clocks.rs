//! Boards whose clock input is not there.

use furrow_tests::Journey;
use furrow_tests::time::at;
use twin::Vehicle;
use world::Node;

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
    let rate = |vehicle: &Vehicle, node| vehicle.node(node).core_hz();
    assert_eq!(rate(&journey.vehicle, Node::Steering) / 1_000_000, 64);
    assert_eq!(rate(&journey.vehicle, Node::Drive) / 1_000_000, 64);
    assert_eq!(journey.mode(), Some(mode::RUN));
    assert!(journey.effort(Node::Drive, at(4.0)) > 0.2);
    assert!(journey.last_moved(Node::Steering).is_some());
    assert_steady(&journey, &[100, 206, 300], 1.0, 4.0);
    journey.assert_in_place();
    assert_never_reset(&journey);
    let counters = journey.vehicle.world().counters();
    assert_eq!(counters.motor_wrong_baud, 0);
    assert!(counters.motor_bytes > 50);
}

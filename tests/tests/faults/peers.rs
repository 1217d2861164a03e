//! Nodes that do not do their part are named to the operator.

use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{seconds, span};
use network::Message as _;
use uagv::messages::{LogControl, NodeHealth};
use vehicle_model::NodeIndex;
use world::SimTime;

use crate::{last_before, next_cycle, running};

/// What the controller sees of a node, in the last message 453.
fn class(journey: &Journey, node: NodeIndex) -> NodeHealth {
    let last = last_before(journey, LogControl::ID, journey.vehicle.now());
    let log = LogControl::decode(&last.bytes()).expect("the limits");
    match node {
        nodes::GPS => log.gps_health,
        nodes::STEERING => log.steering_health,
        _ => log.drive_health,
    }
}

/// When the bus, the display and the console first say that a node is dead, which stops at some time
/// of the basic cycle; in seconds from the begin of its first empty window.
fn named_after(node: NodeIndex, id: u16, phase: f64) -> [f64; 3] {
    let mut journey = running("");
    let begin = next_cycle(&mut journey);
    journey.run_until(begin + span(phase));
    assert_eq!(class(&journey, node), NodeHealth::Healthy);
    journey.vehicle.node_mut(node).hold_reset();
    let last = last_before(&journey, id, journey.vehicle.now()).start;
    let text = format!("{} dead", nodes::name(node));
    let said = journey.console(nodes::CONTROLLER).len();
    let mut found: [Option<SimTime>; 3] = [None; 3];
    while found.contains(&None) {
        let now = journey.vehicle.now() + span(0.002);
        assert!(now < last + span(1.0), "{text}: {found:?}");
        journey.run_until(now);
        let seen = [
            class(&journey, node) == NodeHealth::Dead,
            journey.vehicle.world().lcd_text().contains(&text),
            journey.console(nodes::CONTROLLER)[said..].contains(&text),
        ];
        for (found, seen) in found.iter_mut().zip(seen) {
            if seen && found.is_none() {
                *found = Some(now);
            }
        }
    }
    found.map(|when| seconds(when.unwrap()) - seconds(last) - 0.1)
}

#[test]
fn a_dead_node_is_named_within_three_basic_cycles() {
    let mut worst = [0.0_f64; 3];
    for (node, id) in [
        (nodes::DRIVE, 208),
        (nodes::STEERING, 206),
        (nodes::GPS, 201),
    ] {
        for phase in [0.004, 0.06] {
            let times = named_after(node, id, phase);
            println!("{} {phase} {times:.3?}", nodes::name(node));
            for (worst, time) in worst.iter_mut().zip(times) {
                *worst = worst.max(time);
            }
        }
    }
    println!("bus, display, console: {worst:.3?} s");
    assert!(worst.iter().all(|time| *time <= 0.3), "{worst:?}");
}

#[test]
fn a_node_that_returns_is_healthy_again() {
    let mut journey = running("");
    journey.vehicle.node_mut(nodes::DRIVE).hold_reset();
    journey.to(3.5);
    assert_eq!(class(&journey, nodes::DRIVE), NodeHealth::Dead);
    let screen = journey.vehicle.world().lcd_text();
    assert!(screen.ends_with("green red green\n"), "{screen}");
    journey.vehicle.node_mut(nodes::DRIVE).release_reset();
    journey.to(4.5);
    assert_eq!(class(&journey, nodes::DRIVE), NodeHealth::Healthy);
    let screen = journey.vehicle.world().lcd_text();
    assert!(!screen.contains("dead"), "{screen}");
    assert!(screen.ends_with("green green green\n"), "{screen}");
}

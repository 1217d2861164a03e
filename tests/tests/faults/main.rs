//! How the release images react to faults and to the operator: the real programs run on emulated
//! microcontrollers, with the bus and the vehicle simulated around them.

mod attacker;
mod bus;
mod clocks;
mod commands;
mod display;
mod master;
mod modes;
mod oscillators;
mod peers;
mod receiver;
mod resets;
mod selftest;
mod stack;
mod synchronisation;
mod tick;
mod time;
mod track;
mod windows;

use campaign::traffic::Sent;
use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span};
use world::SimTime;

/// The codes of the modes in message 300, as the network file defines them.
mod mode {
    pub(crate) const IDLE: u8 = 0;
    pub(crate) const MANUAL: u8 = 1;
    pub(crate) const READY: u8 = 2;
    pub(crate) const RUN: u8 = 3;
    pub(crate) const STOP: u8 = 4;
    pub(crate) const FAULT: u8 = 5;
}

/// Beginning of a scenario in which the vehicle drives along the line from two seconds after
/// power-on.
const RUNNING: &str = r#"
    [[press]]
    at = "1 s"
    button = "C"

    [[press]]
    at = "1.5 s"
    button = "C"
"#;

/// The vehicle of [`RUNNING`], with `more` added to the scenario, driving at 3 seconds.
fn running(more: &str) -> Journey {
    let mut journey = Journey::of(&format!("start.east = \"0.3 m\"\n{more}\n{RUNNING}"));
    journey.to(3.0);
    assert_eq!(journey.mode(), Some(mode::RUN));
    assert!(journey.effort(nodes::DRIVE, at(3.0)) > 0.2);
    journey
}

/// Asserts that frames with these identifiers came in every basic cycle between `from` and `until`,
/// in seconds.
fn assert_steady(journey: &Journey, ids: &[u16], from: f64, until: f64) {
    let traffic = journey.traffic();
    for &id in ids {
        let count = traffic.between(id, at(from), at(until)).count() as f64;
        let cycles = (until - from) * 10.0;
        assert!(
            (count - cycles).abs() < 1.5,
            "{id} came {count} times in {cycles} cycles from {from} s on"
        );
    }
}

/// Asserts that every node was reset only at power-on.
fn assert_never_reset(journey: &Journey) {
    for node in nodes::ALL {
        let resets = journey.vehicle.node(node).resets();
        assert_eq!(resets.len(), 1, "{node:?}: {resets:?}");
        assert!(!journey.vehicle.node(node).is_locked_up(), "{node:?}");
    }
}

/// The first complete frame with this identifier that starts after `from`.
fn first_after(journey: &Journey, id: u16, from: SimTime) -> Sent {
    let traffic = journey.traffic();
    let found = traffic.genuine(id).find(|frame| frame.start > from);
    found
        .unwrap_or_else(|| panic!("{id} never came after {} s", seconds(from)))
        .clone()
}

/// The last complete frame with this identifier that starts before `until`.
fn last_before(journey: &Journey, id: u16, until: SimTime) -> Sent {
    let traffic = journey.traffic();
    let found = traffic
        .genuine(id)
        .filter(|frame| frame.start < until)
        .last();
    found
        .unwrap_or_else(|| panic!("{id} never came before {} s", seconds(until)))
        .clone()
}

/// Runs the vehicle until just after the next reference message and returns the start of that basic
/// cycle.
fn next_cycle(journey: &mut Journey) -> SimTime {
    let now = journey.vehicle.now();
    let last = last_before(journey, 100, now).start;
    let mut next = last;
    while next <= now {
        next += span(0.1);
    }
    journey.run_until(next + span(0.000_9));
    last_before(journey, 100, journey.vehicle.now()).start
}

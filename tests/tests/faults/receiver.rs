//! The receiver's bytes are damaged, truncated, flooded or missing.

use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span};
use network::Message as _;
use uagv::messages::Position;

use crate::{assert_never_reset, assert_steady, mode, running};

/// Asserts that every position on the bus was true. The tolerance is the distance driven within the
/// age of the data, plus six standard deviations of the noise.
fn assert_true_positions(journey: &Journey) {
    let states = journey.vehicle.world().states();
    let traffic = journey.traffic();
    let mut checked = 0;
    for frame in traffic.genuine(Position::ID) {
        let seen = Position::decode(&frame.data).expect("the node's own frame decodes");
        let (north, east) = (
            f64::from(seen.north.0) * 1e-3,
            f64::from(seen.east.0) * 1e-3,
        );
        let near = states.iter().any(|state| {
            let age = seconds(frame.start) - seconds(state.at);
            (0.0..0.3).contains(&age)
                && (state.north - north).abs() < 0.07
                && (state.east - east).abs() < 0.07
        });
        assert!(
            near,
            "position {north}, {east} at {} s",
            seconds(frame.start)
        );
        checked += 1;
    }
    assert!(checked > 20);
}

#[test]
fn damaged_streams_cost_measurements_and_nothing_else() {
    let mut journey = running(
        r#"
        stream = [
            { from = "3.0 s", until = "4.2 s", fault = "flip", rate = "1 %" },
            { from = "4.2 s", until = "5.4 s", fault = "truncate", rate = "30 %" },
            { from = "5.4 s", until = "6.6 s", fault = "length", rate = "30 %" },
            { from = "6.6 s", until = "7.8 s", fault = "flood" },
        ]
        "#,
    );
    journey.to(9.0);
    // The reference comes every 100 ms, whatever the receiver sends.
    assert_steady(&journey, &[100, 206, 300, 450, 453], 1.0, 9.0);
    assert_true_positions(&journey);
    assert_never_reset(&journey);
    journey.assert_in_place();
    // The data of the last second are intact, and the node did not invent the data that were lost
    // before.
    assert_steady(&journey, &[200, 201, 401, 402], 8.1, 9.0);
    let traffic = journey.traffic();
    assert!(traffic.between(200, at(3.0), at(7.8)).count() < 47);
    assert!(journey.console(nodes::GPS).contains("crc "));
}

#[test]
fn a_silent_receiver_ends_the_run_in_two_periods_and_keeps_the_schedule() {
    let mut journey =
        running("stream = [{ from = \"3.2 s\", until = \"4.6 s\", fault = \"silence\" }]");
    journey.to(5.5);
    let traffic = journey.traffic();
    let last = traffic
        .between(200, at(1.0), at(4.5))
        .last()
        .expect("there were positions");
    let left = traffic
        .genuine(300)
        .find(|frame| frame.start > last.start + span(0.05) && frame.data[4] != mode::RUN)
        .expect("the run is left");
    // In the second cycle without a position; a single lost frame ends nothing.
    assert!(left.start - last.start < span(0.21));
    assert_eq!(left.data[..4], [0; 4]);
    let stopped = journey.stopped(left.start).expect("the motors stop");
    assert!(stopped < left.end + span(0.003));
    assert_steady(&journey, &[100, 206, 300], 1.0, 5.5);
    // It does not start to drive again without a request.
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert_eq!(journey.mode(), Some(mode::READY));
}

#[test]
fn a_worse_solution_ends_the_run_after_a_second() {
    let mut journey = running("fix = [{ at = \"3.2 s\", state = \"float\" }]");
    journey.to(5.5);
    let traffic = journey.traffic();
    let last = traffic.genuine(200).last().expect("there were positions");
    let left = traffic
        .genuine(300)
        .find(|frame| frame.start > at(3.2) && frame.data[4] == mode::READY)
        .expect("the run is left");
    let bridged = left.start - last.start;
    assert!(bridged > span(0.95) && bridged < span(1.15), "{bridged:?}");
    assert_eq!(traffic.between(202, left.start, at(5.5)).count(), 0);
    // Velocity and the flag are still sent.
    assert_steady(&journey, &[100, 201], 1.0, 5.5);
    let flag = traffic.genuine(100).last().map(|frame| frame.data[0] & 1);
    assert_eq!(flag, Some(0));
}

/// In each burst a byte ends 20 ns after an instant at which the world takes its record.
#[test]
fn a_byte_that_ends_just_after_a_record_is_heard() {
    let mut journey = Journey::of(
        r#"
        [receiver]
        phase = "10 ms"
        latency = "39.90002 ms"
        latency_jitter = "0 s"
        frame_gap = "0 s"
        clock = "0 ppm"
        "#,
    );
    journey.to(2.0);
    let console = journey.console(nodes::GPS);
    let counters = console.lines().rev().find(|line| line.contains(" crc "));
    let counters = counters.expect("a line about the receiver");
    assert!(counters.ends_with(" crc 0 skip 0"), "{counters}");
}

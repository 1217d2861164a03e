//! The loss of the time master: the motors stop, and stay stopped until the operator acts
//! (thesis 6.2.4.4).

use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds};

use crate::mode::{FAULT, IDLE, MANUAL, RUN};
use crate::{RUNNING, first_after, last_before};

const BASIC_PERIOD: f64 = 0.1;

/// When the reset button of the gps node is pressed, s.
const LOST: f64 = 4.03;

/// Reason of a change of mode in message 501: the time master was lost.
const MASTER_LOST: u8 = 10;

/// A vehicle that the joystick drives from 1.2 s on, without a fix, with `more` in its scenario.
fn by_hand(more: &str) -> Journey {
    Journey::of(&format!(
        r#"
        receiver.fix = "none"
        {more}
        [[press]]
        at = "1 s"
        button = "B"
        [[joystick]]
        at = "1.2 s"
        forward = "50 %"
        right = "10 %"
        "#
    ))
}

/// Northing, easting and speed of the vehicle now.
fn motion(journey: &Journey) -> (f64, f64, f64) {
    let state = journey.vehicle.world().states().last().expect("a state");
    (state.north, state.east, state.speed)
}

/// Runs a driving vehicle whose gps node is held in reset at [`LOST`] until `until`, and asserts
/// that both motors stop two basic periods after the last reference and that it runs out.
fn assert_stops(journey: &mut Journey, until: f64) {
    journey.to(LOST);
    let (north, east, before) = motion(journey);
    assert!(before > 0.8, "{before} m/s");
    journey.to(until);
    let (to_north, to_east, speed) = motion(journey);
    let distance = (to_north - north).hypot(to_east - east);
    let stopped = journey.stopped(at(LOST)).map(seconds);
    println!(
        "{before:.2} m/s, then {speed:.2} m/s after {distance:.2} m, stopped at {stopped:?} s"
    );
    let last = seconds(last_before(journey, 100, at(LOST)).start);
    let stopped = stopped.expect("the motors stop");
    assert!(stopped < last + 2.0 * BASIC_PERIOD + 0.0015, "{stopped} s");
    assert!(journey.last_moved(nodes::DRIVE) < Some(at(stopped)));
    assert!(journey.last_moved(nodes::STEERING) < Some(at(stopped)));
    // It rolls out with the drive's lag of 0.3 s.
    assert!(speed.abs() < 0.01, "{speed:.2} m/s, {distance:.2} m");
    assert!(distance < 0.6, "{distance:.2} m");
}

#[test]
fn the_motors_stop_when_the_gps_node_is_held_in_reset_in_manual_mode() {
    let mut journey = by_hand("reset = [{ node = \"gps\", at = \"4.03 s\" }]");
    assert_stops(&mut journey, 8.0);
    assert_eq!(journey.mode(), Some(FAULT));
    // The schedule goes on under the backup, and the event says why.
    let backup = first_after(&journey, 101, at(LOST));
    let event = first_after(&journey, 501, backup.start);
    assert_eq!(event.data[..3], [MANUAL, FAULT, MASTER_LOST]);
    crate::assert_steady(&journey, &[101, 206, 300], seconds(backup.start), 8.0);
    journey.assert_in_place();
}

#[test]
fn the_motors_stop_when_the_gps_node_is_held_in_reset_in_an_autonomous_run() {
    let mut journey = Journey::of(&format!(
        "reset = [{{ node = \"gps\", at = \"4.03 s\" }}]\n{RUNNING}"
    ));
    assert_stops(&mut journey, 6.5);
    // The pose is bridged without positions, so the loss of the master ends the run.
    assert_eq!(journey.mode(), Some(FAULT));
    let backup = first_after(&journey, 101, at(LOST));
    let event = first_after(&journey, 501, backup.start);
    assert_eq!(event.data[..3], [RUN, FAULT, MASTER_LOST]);
    journey.assert_in_place();
}

#[test]
fn the_motors_stop_without_any_backup() {
    let mut journey = by_hand(
        "reset = [{ node = \"gps\", at = \"4.03 s\" }]\n\
         nodes.controller = { external = false, internal = \"1500 ppm\" }",
    );
    assert_stops(&mut journey, 6.0);
}

#[test]
fn the_master_that_comes_back_does_not_start_the_vehicle() {
    let mut journey = by_hand(
        r#"
        reset = [{ node = "gps", at = "4.03 s", until = "5 s" }]
        [[press]]
        at = "6 s"
        button = "B"
        [[press]]
        at = "6.5 s"
        button = "A"
        [[press]]
        at = "7 s"
        button = "B"
        "#,
    );
    assert_stops(&mut journey, 6.4);
    let _ = first_after(&journey, 100, at(5.0));
    // Only a release leads out of the fault.
    assert_eq!(journey.mode(), Some(FAULT));
    journey.to(6.9);
    assert_eq!(journey.mode(), Some(IDLE));
    journey.to(9.0);
    assert_eq!(journey.mode(), Some(MANUAL));
    assert!(motion(&journey).2 > 0.8);
    journey.assert_in_place();
}

#[test]
fn a_vehicle_that_begins_under_the_backup_does_not_drive() {
    let mut journey = by_hand("reset = [{ node = \"gps\", at = \"0 s\" }]");
    journey.to(4.0);
    crate::assert_steady(&journey, &[101, 206, 300], 2.0, 4.0);
    assert_eq!(journey.mode(), Some(FAULT));
    assert_eq!(journey.last_moved(nodes::DRIVE), None);
    assert_eq!(journey.last_moved(nodes::STEERING), None);
    // No command enabled a motor.
    let traffic = journey.traffic();
    assert!(traffic.genuine(300).all(|frame| frame.data[5] == 0));
    journey.assert_in_place();
}

#[test]
fn a_destroyed_reference_stops_nothing() {
    let mut journey = by_hand(
        r#"
        [[bus]]
        what = "corrupt"
        at = "4.03 s"
        id = 100
        "#,
    );
    journey.to(6.0);
    assert_eq!(journey.mode(), Some(MANUAL));
    assert!(journey.last_moved(nodes::DRIVE).is_some());
    assert_eq!(journey.stopped(at(2.0)), None);
}

//! Oscillators that stop during the run, and time masters whose clock input is missing from the
//! start.

use campaign::traffic::Matrix;
use can_bus::RecordKind;
use furrow_tests::Journey;
use furrow_tests::time::{at, seconds, span};
use furrow_tests::{nodes, vehicle};
use network::Message as _;
use twin::ResetCause;
use uagv::messages::{Fault, GpsStatus};
use vehicle_model::NodeIndex;

use crate::{RUNNING, assert_never_reset, assert_steady, first_after, last_before, mode, running};

const BASIC_PERIOD: f64 = 0.1;

/// Identifier of a node's status message.
const fn status(node: NodeIndex) -> u16 {
    511 + node.0 as u16
}

/// Asserts that a node's next status message after `from` reports a failed clock.
fn assert_told(journey: &Journey, node: NodeIndex, from: f64) {
    let report = first_after(journey, status(node), at(from));
    let report = GpsStatus::decode(&report.data).expect("one layout for all nodes");
    assert_eq!(report.fault, Fault::ClockFailure);
}

#[test]
fn a_gps_node_without_its_clock_leaves_the_lead_to_the_controller() {
    let mut journey = Journey::of(&format!(
        "nodes.gps = {{ external = false, internal = \"1500 ppm\" }}\n{RUNNING}"
    ));
    journey.to(4.0);
    assert_steady(&journey, &[101, 201, 206, 300, 450, 453], 2.0, 4.0);
    let traffic = journey.traffic();
    assert_eq!(traffic.between(100, at(0.0), at(4.0)).count(), 0);
    // Only the gps node, when it is the master, could report the quality of the fix.
    assert_eq!(journey.mode(), Some(mode::READY));
    assert_told(&journey, nodes::GPS, 0.0);
    journey.assert_in_place();
    assert_never_reset(&journey);
}

#[test]
fn a_controller_without_its_clock_drives_and_takes_no_lead() {
    let mut journey = running(
        "nodes.controller = { external = false, internal = \"-1500 ppm\" }\n\
        reset = [{ node = \"gps\", at = \"3.23 s\" }]",
    );
    assert_steady(&journey, &[100, 206, 300, 453], 1.5, 3.0);
    journey.to(5.0);
    let stopped = journey.stopped(at(3.23)).expect("the motors stop");
    assert!(stopped <= at(3.43), "{} s", seconds(stopped));
    let traffic = journey.traffic();
    assert_eq!(traffic.between(101, at(0.0), at(5.0)).count(), 0);
    assert_told(&journey, nodes::CONTROLLER, 0.0);
    journey.assert_in_place();
    assert_never_reset(&journey);
}

/// A driving vehicle whose `node` loses its clock at 3.23 s, run until 5 s.
fn failing(node: NodeIndex) -> Journey {
    let mut journey = running(&format!(
        "nodes.{} = {{ internal = \"900 ppm\" }}",
        nodes::name(node)
    ));
    journey.to(3.23);
    let safe = journey.vehicle.node_mut(node).lose_external_clock();
    assert!(safe, "the clock security system is off");
    journey.to(5.0);
    let resets = journey.vehicle.node(node).resets();
    assert_eq!(resets.len(), 2, "{node:?}: {resets:?}");
    assert_eq!(resets[1].1, ResetCause::Software);
    assert!(resets[1].0 < at(3.24), "{resets:?}");
    assert_told(&journey, node, 3.23);
    journey.assert_in_place();
    journey
}

#[test]
fn an_actuator_node_whose_clock_stops_opens_its_relay_and_comes_back_without() {
    for node in [nodes::DRIVE, nodes::STEERING] {
        let journey = failing(node);
        assert_eq!(journey.effort(node, at(3.24)), 0.0, "{node:?}");
        assert_eq!(journey.vehicle.node(node).core_hz() / 1_000_000, 64);
        assert_steady(&journey, &[100, 206, 300], 3.23 + 5.0 * BASIC_PERIOD, 5.0);
        if node == nodes::DRIVE {
            assert_eq!(journey.mode(), Some(mode::RUN));
            assert!(journey.effort(nodes::DRIVE, at(5.0)) > 0.2);
        } else {
            // While it listens to trim its oscillator the angle is unknown, so the run is over.
            assert_eq!(journey.mode(), Some(mode::FAULT));
            assert_eq!(journey.effort(nodes::DRIVE, at(5.0)), 0.0);
        }
    }
}

/// Lets the vehicle go on until the motor's port of an actuator node has begun to send a byte.
fn until_a_byte_begins(journey: &mut Journey, node: NodeIndex) {
    /// USART1_ISR of the F303, and its bit that is set while nothing is being sent.
    const ISR: u32 = 0x4001_381C;
    const TC: u32 = 1 << 6;
    let mut was_idle = false;
    for _ in 0..20_000 {
        let mcu = journey.vehicle.node_mut(node);
        let idle = mcu.read_register(ISR).is_some_and(|flags| flags & TC != 0);
        if was_idle && !idle {
            return;
        }
        was_idle = idle;
        let next = journey.vehicle.now() + span(10e-6);
        journey.run_until(next);
    }
    panic!("{node:?} sends nothing to its motor");
}

/// What the clock's failure makes of a byte that is on the line cannot be helped. The relay is open
/// before the driver reads it, and no other byte is spoiled.
#[test]
fn a_motor_driver_reads_no_wrong_byte_but_the_one_on_the_line_when_its_nodes_clock_stops() {
    for (node, bit) in [
        (nodes::DRIVE, 1.5),
        (nodes::STEERING, 4.5),
        (nodes::DRIVE, 40.0),
    ] {
        let mut journey = running("");
        until_a_byte_begins(&mut journey, node);
        let now = journey.vehicle.now() + span(bit / 38_400.0);
        journey.run_until(now);
        assert!(journey.vehicle.node_mut(node).lose_external_clock());
        journey.to(4.0);
        let garbles = journey.vehicle.world().garbles();
        let on_the_line = usize::from(bit < 10.0);
        assert!(
            garbles.len() <= on_the_line && garbles.iter().all(|garble| !garble.closed),
            "{node:?}, {bit} bits after the start of a byte: {garbles:?}"
        );
        let stopped = now + span(0.002);
        assert_eq!(journey.effort(node, stopped), 0.0);
    }
}

/// A reset cuts off the byte on the line, at any of its bits. Its pin lets go of the relay at the
/// same time.
#[test]
fn a_motor_driver_whose_node_is_reset_reads_no_wrong_byte_with_its_relay_closed() {
    let mut journey = running("");
    let mut cut = 0;
    for bit in 0..10 {
        let node = [nodes::DRIVE, nodes::STEERING][bit % 2];
        until_a_byte_begins(&mut journey, node);
        let now = journey.vehicle.now() + span((bit as f64 + 0.3) / 38_400.0);
        journey.run_until(now);
        assert!(journey.effort(nodes::DRIVE, now) > 0.2, "{bit}");
        journey.vehicle.node_mut(node).hold_reset();
        journey.run_until(now + span(0.005));
        journey.vehicle.node_mut(node).release_reset();
        journey.run_until(now + span(1.2));
        let garbles = journey.vehicle.world().garbles();
        assert!(garbles.iter().all(|garble| !garble.closed), "{garbles:?}");
        cut = garbles.len();
    }
    assert!(cut > 3, "the resets did cut off bytes: {cut}");
}

#[test]
fn a_master_whose_clock_stops_hands_the_lead_over_for_good() {
    let journey = failing(nodes::GPS);
    let stopped = journey.stopped(at(3.23)).expect("the motors stop");
    assert!(stopped <= at(3.43), "{} s", seconds(stopped));
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert_steady(&journey, &[101, 206, 300, 453], 3.4, 5.0);
    // It still sends in its windows.
    assert_steady(&journey, &[201], 3.23 + 8.0 * BASIC_PERIOD, 5.0);
    let traffic = journey.traffic();
    assert_eq!(traffic.between(100, at(3.24), at(5.0)).count(), 0);
}

#[test]
fn a_controller_whose_clock_stops_begins_again_in_idle() {
    let journey = failing(nodes::CONTROLLER);
    let stopped = journey.stopped(at(3.23)).expect("the motors stop");
    assert!(stopped <= at(3.45), "{} s", seconds(stopped));
    assert_steady(
        &journey,
        &[100, 206, 300, 453],
        3.23 + 5.0 * BASIC_PERIOD,
        5.0,
    );
    assert_eq!(journey.mode(), Some(mode::IDLE));
}

/// The debugger's clock reaches a board with a supply of its own seconds after its power, or never.
#[test]
fn two_masters_whose_clocks_come_late_start_the_network_when_they_come() {
    let mut journey = Journey::of(&format!(
        "nodes.gps = {{ external = false }}\nnodes.controller = {{ external = false }}\n\
        clock = [{{ node = \"gps\", at = \"2 s\", present = true }}, \
        {{ node = \"controller\", at = \"2.5 s\", present = true }}]\n{}",
        RUNNING
            .replace("at = \"1 s\"", "at = \"5 s\"")
            .replace("at = \"1.5 s\"", "at = \"5.5 s\"")
    ));
    journey.to(8.0);
    assert_steady(&journey, &[100, 201, 206, 300, 450, 453], 5.0, 8.0);
    assert_eq!(journey.mode(), Some(mode::RUN));
    for node in [nodes::GPS, nodes::CONTROLLER] {
        let resets = journey.vehicle.node(node).resets();
        assert_eq!(resets.len(), 2, "{node:?}: {resets:?}");
        assert_eq!(journey.vehicle.node(node).core_hz(), 180_000_000);
    }
    journey.assert_in_place();
}

/// With no clock anywhere the gps node leads on its own oscillator, and says so.
#[test]
fn without_any_clock_the_best_master_leads_on_its_own_oscillator_as_the_last_resort() {
    let mut journey = Journey::of(
        "nodes.gps = { external = false, internal = \"4000 ppm\" }\n\
        nodes.controller = { external = false, internal = \"-3000 ppm\" }",
    );
    journey.to(3.0);
    assert!(journey.traffic().frames.is_empty(), "it waits for a clock");
    let console = journey.console(nodes::STEERING);
    assert!(console.contains("bus sync"), "{console}");
    let console = journey.console(nodes::GPS);
    assert!(console.contains("no ref"), "{console}");
    journey.to(8.0);
    assert_steady(&journey, &[100, 206, 300, 453], 5.5, 8.0);
    let reference = last_before(&journey, 100, at(8.0));
    assert_eq!(reference.bytes()[0] & 2, 2, "the reference says so");
    assert_eq!(journey.traffic().between(101, at(0.0), at(8.0)).count(), 0);
    let mut errors = journey.vehicle.records().iter();
    assert!(!errors.any(|record| matches!(record.kind, RecordKind::Error { .. })));
}

/// The best master leads as the last resort, and later finds its clock. The other nodes have crystals:
/// they followed a master that was 4000 ppm off, and now follow one that is exact.
#[test]
fn a_last_resort_that_finds_its_clock_is_followed_again() {
    let mut journey = Journey::of(
        "nodes.gps = { external = false, internal = \"4000 ppm\" }\n\
        nodes.controller = { external = false, internal = \"-3000 ppm\" }\n\
        clock = [{ node = \"gps\", at = \"6 s\", present = true }]",
    );
    journey.to(10.0);
    let resets = journey.vehicle.node(nodes::GPS).resets();
    assert_eq!(resets.len(), 3, "{resets:?}");
    let reference = last_before(&journey, 100, at(10.0));
    assert_eq!(reference.bytes()[0] & 2, 0, "it has its clock");
    assert_steady(&journey, &[100, 206, 300, 453], 8.0, 10.0);
    // Until then the windows are as far off as the master.
    let traffic = journey.traffic();
    let misplaced = Matrix::new(vehicle()).misplaced(&traffic);
    let mut late = misplaced.iter().filter(|one| one.frame.start > at(7.0));
    assert_eq!(late.next().map(ToString::to_string), None);
}

/// The same, but the backup master has its clock first, and leads while the best one starts again. It
/// has followed a rate of 4000 ppm, and must not lead by it: then the best one, which is behind, could
/// never take the lead again.
#[test]
fn a_backup_that_followed_the_last_resort_leads_by_its_own_clock() {
    for error in ["4000 ppm", "-4000 ppm"] {
        let mut journey = Journey::of(&format!(
            "nodes.gps = {{ external = false, internal = \"{error}\" }}\n\
            nodes.controller = {{ external = false, internal = \"-3000 ppm\" }}\n\
            clock = [{{ node = \"controller\", at = \"6 s\", present = true }}, \
            {{ node = \"gps\", at = \"8 s\", present = true }}]",
        ));
        journey.to(11.0);
        assert_steady(&journey, &[100, 206, 300, 453], 10.0, 11.0);
        let cycle = seconds(last_before(&journey, 100, at(10.95)).start)
            - seconds(last_before(&journey, 100, at(9.95)).start);
        assert!(
            (cycle - 1.0).abs() < 300e-6,
            "{error}: {cycle} s for ten cycles"
        );
        let traffic = journey.traffic();
        let misplaced = Matrix::new(vehicle()).misplaced(&traffic);
        let mut late = misplaced.iter().filter(|one| one.frame.start > at(9.0));
        assert_eq!(late.next().map(ToString::to_string), None, "{error}");
    }
}

/// Frames that an error destroyed.
fn destroyed(journey: &Journey) -> usize {
    let records = journey.vehicle.records().iter();
    let errors = records.filter(|record| {
        matches!(
            record.kind,
            RecordKind::Error {
                transmitter: true,
                ..
            }
        )
    });
    errors.count()
}

/// Trims, before it sends anything, what 1.2 % and more made of the bus before: missed references,
/// bus-off, and error flags over the frames of the others.
#[test]
fn a_node_far_off_its_frequency_trims_itself_before_it_sends() {
    for error in ["12000 ppm", "-20000 ppm", "30000 ppm", "-48000 ppm"] {
        let mut journey = Journey::of(&format!(
            "nodes.steering = {{ external = false, internal = \"{error}\" }}\n\
            nodes.drive = {{ external = false, internal = \"{error}\" }}\n{}",
            RUNNING
                .replace("at = \"1 s\"", "at = \"4 s\"")
                .replace("at = \"1.5 s\"", "at = \"4.5 s\"")
        ));
        journey.to(7.0);
        assert_eq!(destroyed(&journey), 0, "{error}");
        assert_steady(&journey, &[100, 206, 300, 450, 453], 4.5, 7.0);
        assert_eq!(journey.mode(), Some(mode::RUN), "{error}");
        assert!(journey.effort(nodes::DRIVE, at(7.0)) > 0.2, "{error}");
        journey.assert_in_place();
        assert_never_reset(&journey);
    }
}

/// The clocks of the nodes follow oscillators that warm up or cool down, so that they stay on the bus.
#[test]
fn nodes_whose_oscillators_drift_keep_the_schedule() {
    let mut journey = Journey::of(&format!(
        "nodes.steering = {{ external = false, internal = \"-1500 ppm\", drift = \"500 ppm/s\" }}\n\
        nodes.drive = {{ external = false, internal = \"1500 ppm\", drift = \"-500 ppm/s\" }}\n{RUNNING}"
    ));
    journey.to(8.0);
    assert_eq!(destroyed(&journey), 0);
    assert_steady(&journey, &[100, 206, 300, 450, 453], 1.0, 8.0);
    for node in [nodes::STEERING, nodes::DRIVE] {
        let console = journey.console(node);
        assert!(!console.contains(" away"), "{console}");
    }
    assert_eq!(journey.mode(), Some(mode::RUN));
    journey.assert_in_place();
    assert_never_reset(&journey);
}

/// A node whose oscillator drifts away leaves the bus before it disturbs it, and comes back: when it is
/// off by more than its bit timing allows.
#[test]
fn a_node_that_drifts_away_falls_silent_and_trims_itself_again() {
    for (drift, leaves, back) in [("1200 ppm/s", 7.0, 9.0), ("2000 ppm/s", 4.5, 5.7)] {
        let mut journey = Journey::of(&format!(
            "nodes.steering = {{ external = false, internal = \"1000 ppm\", drift = \"{drift}\" }}\n{RUNNING}"
        ));
        journey.to(10.0);
        assert_eq!(destroyed(&journey), 0);
        assert_steady(&journey, &[100, 300, 450, 453], 1.0, 10.0);
        assert_steady(&journey, &[206], 1.0, leaves);
        let console = journey.console(nodes::STEERING);
        assert!(console.contains(" away"), "{console}");
        assert_steady(&journey, &[206], back, back + 1.0);
        journey.assert_in_place();
        assert_never_reset(&journey);
    }
}

//! Faults that the self-test of a node names: each one on the twin, and what the node reports.

use can_bus::{Frame, RecordKind, Retry, Tester};
use firmware::selftest::KEY;
use furrow_tests::nodes;
use furrow_tests::time::{at, span};
use furrow_tests::{Journey, images, scenario, vehicle};
use network::Message as _;
use twin::part::Pin;
use twin::{ResetCause, Twin};
use uagv::messages::{
    CheckResult, ControllerSelfTest, DriveSelfTest, DriveStatus, Fault, GpsSelfTest,
    SelfTestRequest, SteeringSelfTest,
};

use crate::RUNNING;

/// The reports of a node after `from` seconds, oldest first.
fn reports(journey: &Journey, id: u16, from: f64) -> Vec<DriveSelfTest> {
    let traffic = journey.traffic();
    let sent = traffic.genuine(id).filter(|frame| frame.start >= at(from));
    // The reports of all nodes are laid out alike.
    sent.map(|frame| DriveSelfTest::decode(&frame.bytes()).unwrap())
        .collect()
}

/// The results of a report that are not `Passed`, by their places in it.
fn others(report: &DriveSelfTest) -> Vec<(&'static str, CheckResult)> {
    [
        ("reset", report.reset),
        ("memory", report.memory),
        ("program", report.program),
        ("oscillators", report.oscillators),
        ("loop back", report.loop_back),
        ("bus", report.bus),
        ("reference", report.reference),
        ("supply", report.supply),
        ("relay", report.relay),
        ("stack", report.stack),
    ]
    .into_iter()
    .filter(|(_, result)| *result != CheckResult::Passed)
    .collect()
}

const FAILED: CheckResult = CheckResult::Failed;

/// The first report of the drive node on a vehicle that `prepare` has changed before power-on,
/// which is asked to run.
fn drive(prepare: impl FnOnce(&mut Journey)) -> (Journey, DriveSelfTest) {
    let mut journey = Journey::of(RUNNING);
    prepare(&mut journey);
    journey.to(3.0);
    let first = reports(&journey, DriveSelfTest::ID, 0.0);
    (journey, *first.first().expect("a report after the start"))
}

/// A program on the bus asks all nodes, in the next arbitrating window.
pub(crate) fn ask(journey: &mut Journey, request: SelfTestRequest) {
    let traffic = journey.traffic();
    let reference = traffic.genuine(100).last().expect("a reference").start;
    let mut bus = journey.vehicle.network().bus();
    let tester = bus.add_tester(Tester::new());
    let frame = Frame::standard(SelfTestRequest::ID, &request.encode()).unwrap();
    bus.send_at(tester, reference + span(0.113), frame, Retry::UntilSent);
}

/// Whether the drive motor has ever turned.
fn moved(journey: &Journey) -> bool {
    journey.last_moved(nodes::DRIVE).is_some()
}

/// The drive node's console.
fn console(journey: &Journey) -> String {
    String::from_utf8_lossy(journey.vehicle.console(nodes::DRIVE)).into_owned()
}

#[test]
fn a_sound_vehicle_reports_once_and_drives() {
    let mut journey = Journey::of(RUNNING);
    journey.to(3.0);
    for id in [GpsSelfTest::ID, ControllerSelfTest::ID] {
        let reports = reports(&journey, id, 0.0);
        assert_eq!(reports.len(), 1);
        // These nodes have no motor.
        assert_eq!(others(&reports[0]), [("relay", CheckResult::NotDone)]);
    }
    for id in [SteeringSelfTest::ID, DriveSelfTest::ID] {
        let reports = reports(&journey, id, 0.0);
        assert_eq!(reports.len(), 1);
        assert_eq!(others(&reports[0]), []);
        assert_eq!((reports[0].round, reports[0].supply_voltage), (0, 165));
        assert!(reports[0].clock_error.abs() <= 11, "{:?}", reports[0]);
        assert!(reports[0].stack_free > 1000);
    }
    assert!(console(&journey).contains("test passed | clock "));
    assert!(moved(&journey));
}

#[test]
fn a_stuck_bit_of_memory_bars_the_motor() {
    // Where the stack does not reach (a node whose stack is damaged has no report), in a
    // variable, and in the last word of the variables' first KiB.
    for (address, high) in [
        (0x1000_0200, true),
        (0x2000_0100, false),
        (0x2000_03FC, true),
    ] {
        let (journey, report) = drive(|journey| {
            let mcu = journey.vehicle.node_mut(nodes::DRIVE);
            mcu.stick_memory(address, 31, high);
        });
        assert_eq!(others(&report), [("memory", FAILED)], "{address:#x}");
        assert!(!moved(&journey));
        assert!(console(&journey).contains("test FAILED memory"));
    }
}

/// The first report of the drive node if something writes to its memory during the test of the
/// memory.
fn drive_with_a_changed_word(debugged: bool) -> (Journey, DriveSelfTest) {
    drive(|journey| {
        // The test of the memory takes more than 10 ms from the power-on of the node.
        let power_on = journey.vehicle.node(nodes::DRIVE).resets()[0].0;
        journey.run_until(power_on + span(0.003));
        let mcu = journey.vehicle.node_mut(nodes::DRIVE);
        if debugged {
            mcu.enable_debug();
        }
        assert!(mcu.set_memory(0x1000_0F00, &[0x52, 0x54, 0x54, 0x00]));
    })
}

#[test]
fn a_debugger_that_writes_to_the_memory_during_its_test_bars_nothing() {
    let (journey, report) = drive_with_a_changed_word(true);
    assert_eq!(others(&report), []);
    assert!(moved(&journey));
}

#[test]
fn a_word_of_memory_that_is_wrong_only_once_bars_the_motor() {
    let (journey, report) = drive_with_a_changed_word(false);
    assert_eq!(others(&report), [("memory", FAILED)]);
    assert!(!moved(&journey));
}

#[test]
fn a_changed_bit_of_the_flash_bars_the_motor() {
    let mut image = images().of(nodes::DRIVE).to_vec();
    // In a text of the console, so that the program still runs.
    let text = b" no cmd";
    let mut places = image.windows(text.len());
    let place = places.position(|bytes| bytes == text).expect("a text");
    image[place + 1] ^= 0x20;
    let images = images().clone().with(nodes::DRIVE, image);
    let mut journey = Journey::new(&scenario(RUNNING), 1);
    journey.vehicle = Twin::new(vehicle(), &scenario(RUNNING), 1, &images).unwrap();
    journey.to(3.0);
    let report = reports(&journey, DriveSelfTest::ID, 0.0)[0];
    assert_eq!(others(&report), [("program", FAILED)]);
    assert!(!moved(&journey));
}

#[test]
fn a_clock_of_another_frequency_is_found() {
    // 7.1 MHz in place of 8 MHz. On it the node would destroy every frame.
    let (journey, report) = drive(|journey| {
        let mcu = journey.vehicle.node_mut(nodes::DRIVE);
        mcu.find_external_clock(7_100_000);
    });
    let failed = [("oscillators", FAILED)];
    assert_eq!(others(&report), failed, "{}", console(&journey));
    let records = journey.vehicle.records();
    let errors = records
        .iter()
        .filter(|record| matches!(record.kind, RecordKind::Error { .. }));
    assert_eq!(errors.count(), 0);
}

#[test]
fn a_missing_clock_is_found() {
    let text = format!("{RUNNING}\n[nodes.drive]\nexternal = false\n");
    let mut journey = Journey::of(&text);
    journey.to(4.0);
    let report = reports(&journey, DriveSelfTest::ID, 0.0)[0];
    assert_eq!(others(&report), [("oscillators", FAILED)]);
}

#[test]
fn a_clock_that_cannot_be_measured_is_told() {
    let text = format!("{RUNNING}\n[nodes.drive]\nexternal = true\n");
    let mut journey = Journey::of(&text);
    for node in [nodes::CONTROLLER, nodes::DRIVE] {
        journey.vehicle.node_mut(node).set_clock_measured(false);
    }
    journey.to(4.0);
    for (node, id) in [
        (nodes::CONTROLLER, ControllerSelfTest::ID),
        (nodes::DRIVE, DriveSelfTest::ID),
    ] {
        let report = reports(&journey, id, 0.0)[0];
        assert_eq!(report.oscillators, CheckResult::NotDone);
        let console = String::from_utf8_lossy(journey.vehicle.console(node)).into_owned();
        assert!(
            console.contains("test passed, not done clocks"),
            "{console}"
        );
    }
    assert!(moved(&journey));
}

#[test]
fn a_board_without_a_transceiver_passes_the_loop_back_test() {
    for node in nodes::ALL {
        let mut journey = Journey::of(RUNNING);
        journey.vehicle.node_mut(node).set_transceiver(false);
        journey.to(1.0);
        let console = String::from_utf8_lossy(journey.vehicle.console(node)).into_owned();
        let line = console.lines().find(|line| line.starts_with("test "));
        let line = line.expect("a line about the self-test");
        assert!(!line.contains(" loop"), "{}: {line}", nodes::name(node));
    }
}

/// Bit timing of the controller; in it loop-back and silence (RM0316 31.9.2).
const CAN_BTR: u32 = 0x4000_641C;
const TEST_MODES: u32 = 3 << 30;

#[test]
fn a_controller_that_does_not_initialise_again_is_not_left_in_loop_back() {
    for unlocked in [false, true] {
        let mut journey = Journey::of(RUNNING);
        let mcu = journey.vehicle.node_mut(nodes::DRIVE);
        mcu.jam_controller(unlocked);
        journey.to(3.0);
        let mcu = journey.vehicle.node_mut(nodes::DRIVE);
        let timing = mcu.read_register(CAN_BTR).expect("a register");
        assert_eq!(timing & TEST_MODES, 0, "{timing:#x}");
        let console = console(&journey);
        assert!(
            console.contains("test FAILED loop"),
            "{unlocked}: {console}"
        );
        assert!(!moved(&journey));
    }
}

/// The receive pin of the drive node's controller.
const DRIVE_RECEIVES: Pin = Pin::new('A', 11);

#[test]
fn a_line_that_is_held_dominant_hinders_the_loop_back_test_and_bars_nothing() {
    let text = "
        [[press]]
        at = \"3 s\"
        button = \"C\"

        [[press]]
        at = \"3.5 s\"
        button = \"C\"
    ";
    let mut journey = Journey::of(text);
    let mcu = journey.vehicle.node_mut(nodes::DRIVE);
    mcu.drive_pin(DRIVE_RECEIVES, Some(false));
    journey.to(1.0);
    let line = console(&journey);
    let line = line.lines().find(|line| line.starts_with("test "));
    let line = line.expect("a line about the self-test");
    let mcu = journey.vehicle.node_mut(nodes::DRIVE);
    let timing = mcu.read_register(CAN_BTR).expect("a register");
    mcu.drive_pin(DRIVE_RECEIVES, None);
    journey.to(5.0);
    assert!(line.contains("test passed, not done loop bus"), "{line}");
    assert_eq!(timing & TEST_MODES, 0, "{timing:#x}");
    let report = reports(&journey, DriveSelfTest::ID, 0.0)[0];
    assert_eq!(others(&report), [("loop back", CheckResult::NotDone)]);
    assert!(moved(&journey));
}

#[test]
fn the_watchdog_is_frozen_for_a_debugger_before_it_starts() {
    for node in [nodes::CONTROLLER, nodes::DRIVE] {
        let mut journey = Journey::of("");
        let mcu = loop {
            let now = journey.vehicle.now();
            journey.run_until(now + span(1e-6));
            let mcu = journey.vehicle.node_mut(node);
            if mcu.watchdog_runs() {
                break mcu;
            }
        };
        // DBGMCU_APB1_FZ: DBG_IWDG_STOP.
        let freeze = mcu.read_register(0xE004_2008).expect("a register");
        assert_eq!(freeze >> 12 & 1, 1, "{}", nodes::name(node));
    }
}

#[test]
fn a_deaf_controller_is_found_before_it_joins_the_bus() {
    let mut journey = Journey::of(RUNNING);
    journey
        .vehicle
        .node_mut(nodes::DRIVE)
        .corrupt_reception(1 << 9);
    journey.to(3.0);
    let console = console(&journey);
    assert!(console.contains("test FAILED loop"), "{console}");
    assert!(!moved(&journey));
}

#[test]
fn a_supply_out_of_range_bars_the_motor() {
    for (millivolts, steps) in [(2900, 145), (3700, 185)] {
        let (journey, report) = drive(|journey| {
            let mcu = journey.vehicle.node_mut(nodes::DRIVE);
            mcu.set_supply(millivolts);
        });
        assert_eq!(others(&report), [("supply", FAILED)]);
        assert!(report.supply_voltage.abs_diff(steps) <= 1, "{report:?}");
        assert!(!moved(&journey));
    }
}

#[test]
fn a_relay_that_sticks_before_the_run_bars_the_motor() {
    let text = format!("{RUNNING}\n[[relay]]\nnode = \"drive\"\nat = \"0.01 s\"\n");
    let mut journey = Journey::of(&text);
    journey.to(3.0);
    let report = reports(&journey, DriveSelfTest::ID, 0.0)[0];
    assert_eq!(others(&report), [("relay", FAILED)]);
    assert!(!moved(&journey));
    let traffic = journey.traffic();
    let last = traffic.genuine(DriveStatus::ID).last().expect("a status");
    let status = DriveStatus::decode(&last.bytes()).unwrap();
    assert_eq!(status.fault, Fault::SelfTest);
}

#[test]
fn a_vehicle_that_cannot_steer_does_not_drive() {
    let text = format!("{RUNNING}\n[[relay]]\nnode = \"steering\"\nat = \"0.01 s\"\n");
    let mut journey = Journey::of(&text);
    journey.to(4.0);
    let report = reports(&journey, SteeringSelfTest::ID, 0.0)[0];
    assert_eq!(others(&report), [("relay", FAILED)]);
    assert!(!moved(&journey), "the drive motor turned");
}

#[test]
fn a_request_does_not_clear_an_emergency_stop() {
    let text = format!("{RUNNING}\n[[press]]\nat = \"2 s\"\nbutton = \"D\"\n");
    let mut journey = Journey::of(&text);
    journey.to(2.5);
    assert_eq!(journey.mode(), Some(crate::mode::STOP));
    ask(
        &mut journey,
        SelfTestRequest {
            round: 4,
            key: KEY,
            start_again: true,
        },
    );
    journey.to(4.5);
    assert_eq!(journey.mode(), Some(crate::mode::STOP));
}

#[test]
fn a_relay_that_sticks_in_a_run_bars_the_motor_from_its_next_stop_on() {
    let text = format!(
        "{RUNNING}\n[[relay]]\nnode = \"drive\"\nat = \"2.5 s\"\n\n\
         [[press]]\nat = \"3 s\"\nbutton = \"D\"\n\n[[press]]\nat = \"3.6 s\"\nbutton = \"C\"\n\n\
         [[press]]\nat = \"4.2 s\"\nbutton = \"C\"\n\n[[press]]\nat = \"4.8 s\"\nbutton = \"C\"\n"
    );
    let mut journey = Journey::of(&text);
    journey.to(6.0);
    assert!(journey.effort(nodes::DRIVE, at(2.9)) > 0.2, "it drove");
    assert!(
        journey.last_moved(nodes::DRIVE) < Some(at(3.2)),
        "the motor turned again"
    );
    assert_eq!(journey.effort(nodes::DRIVE, at(6.0)), 0.0);
    assert!(console(&journey).contains("test FAILED relay"));
}

#[test]
fn a_deep_stack_is_found_in_the_run_and_told_when_the_bus_asks() {
    let mut journey = Journey::of(RUNNING);
    journey.to(2.0);
    assert!(journey.effort(nodes::DRIVE, at(2.0)) > 0.2, "it drove");
    // As if the stack had been used down to its last 400 bytes.
    let mcu = journey.vehicle.node_mut(nodes::DRIVE);
    assert!(mcu.set_memory(0x1000_0000 + 400, &[0; 4]));
    // Two passes over the stack, of 80 ms each.
    journey.to(2.2);
    assert_eq!(journey.effort(nodes::DRIVE, at(2.2)), 0.0);
    ask(
        &mut journey,
        SelfTestRequest {
            round: 9,
            key: KEY,
            start_again: false,
        },
    );
    journey.to(3.0);
    let report = reports(&journey, DriveSelfTest::ID, 2.0)[0];
    assert_eq!((report.round, report.stack_free), (9, 400));
    assert_eq!(report.stack, FAILED);
    // The other nodes answer as well.
    for id in [
        GpsSelfTest::ID,
        ControllerSelfTest::ID,
        SteeringSelfTest::ID,
    ] {
        assert_eq!(reports(&journey, id, 2.0).len(), 1);
    }
}

#[test]
fn a_reset_by_the_watchdog_is_told() {
    let mut journey = Journey::of(RUNNING);
    journey.to(2.0);
    campaign::stall(&mut journey.vehicle, nodes::STEERING).unwrap();
    journey.to(4.0);
    let report = reports(&journey, SteeringSelfTest::ID, 2.0)[0];
    assert_eq!(report.reset, FAILED);
    let resets = journey.vehicle.node(nodes::STEERING).resets();
    assert_eq!(
        resets.last().map(|(_, cause)| *cause),
        Some(ResetCause::Watchdog)
    );
}

#[test]
fn nodes_start_again_for_the_whole_test_only_while_the_vehicle_stands_still() {
    let request = SelfTestRequest {
        round: 5,
        key: KEY,
        start_again: true,
    };
    let mut journey = Journey::of("");
    journey.to(1.0);
    ask(&mut journey, request);
    journey.to(3.0);
    for (node, id) in nodes::ALL.into_iter().zip([
        GpsSelfTest::ID,
        ControllerSelfTest::ID,
        SteeringSelfTest::ID,
        DriveSelfTest::ID,
    ]) {
        assert_eq!(
            journey.vehicle.node(node).resets().len(),
            2,
            "{}",
            nodes::name(node)
        );
        let rounds: Vec<u8> = reports(&journey, id, 1.0).iter().map(|r| r.round).collect();
        assert_eq!(rounds, [0]);
    }
    let mut journey = Journey::of(RUNNING);
    journey.to(2.5);
    assert!(moved(&journey));
    ask(&mut journey, request);
    journey.to(4.0);
    for node in nodes::ALL {
        assert_eq!(
            journey.vehicle.node(node).resets().len(),
            1,
            "{}",
            nodes::name(node)
        );
    }
    let report = reports(&journey, DriveSelfTest::ID, 2.5)[0];
    assert_eq!((report.round, report.relay), (5, CheckResult::NotDone));
    let effort = journey.effort(nodes::DRIVE, at(4.0));
    assert!(effort > 0.2, "it drives on");
}

//! The operator's buttons (thesis 5.2.5).

use furrow_tests::nodes;
use std::fmt::Write;

use furrow_tests::Journey;
use furrow_tests::time::{at, seconds};
use network::Message as _;
use uagv::messages::ModeChange;

use campaign::traffic::Sent;

use crate::mode::{IDLE, MANUAL, READY, RUN, STOP};
use crate::{RUNNING, assert_never_reset, assert_steady, first_after};

/// Each press and the mode that follows it: every transition that a button causes, and presses that
/// must not cause any.
const PRESSES: [(char, u8); 41] = [
    ('A', IDLE),
    ('C', READY),
    ('A', IDLE),
    ('B', MANUAL),
    ('B', MANUAL),
    ('C', READY),
    ('B', MANUAL),
    ('A', IDLE),
    ('C', READY),
    ('C', RUN),
    ('C', READY),
    ('C', RUN),
    ('B', MANUAL),
    ('D', STOP),
    ('B', STOP),
    ('C', STOP),
    ('D', STOP),
    ('A', IDLE),
    ('D', STOP),
    ('A', IDLE),
    ('C', READY),
    ('D', STOP),
    ('A', IDLE),
    ('C', READY),
    ('C', RUN),
    ('A', IDLE),
    ('C', READY),
    ('C', RUN),
    ('D', STOP),
    ('A', IDLE),
    ('J', STOP),
    ('A', IDLE),
    ('B', MANUAL),
    ('J', STOP),
    ('A', IDLE),
    ('C', READY),
    ('J', STOP),
    ('A', IDLE),
    ('C', READY),
    ('C', RUN),
    ('J', STOP),
];

const FIRST: f64 = 1.0;
const PAUSE: f64 = 0.3;

#[test]
fn every_transition_by_the_buttons() {
    // By a quarter of its travel or more it would end the runs.
    let mut text = String::from("[[joystick]]\nat = \"0 s\"\nforward = \"20 %\"\n");
    for (index, (button, _)) in PRESSES.iter().enumerate() {
        let at = FIRST + PAUSE * index as f64;
        writeln!(
            text,
            "[[press]]\nat = \"{at} s\"\nbutton = \"{button}\"\nhold = \"120 ms\"\nbounce = \"8 ms\""
        )
        .expect("a string takes everything");
    }
    let mut journey = Journey::of(&text);
    let end = FIRST + PAUSE * PRESSES.len() as f64;
    journey.to(end);
    let (mut before, mut changes) = (IDLE, Vec::new());
    for (index, (button, mode)) in PRESSES.into_iter().enumerate() {
        // Debouncing ends 20 ms after the last bounce; the next control step follows within 100 ms.
        let then = at(FIRST + PAUSE * (index + 1) as f64 - 0.01);
        let command = journey.command(then).expect("commands are sent");
        assert_eq!(command[4], mode, "press {index}, {button} in mode {before}");
        let moving = matches!(mode, MANUAL | RUN);
        assert_eq!(
            journey.effort(nodes::DRIVE, then) != 0.0,
            moving,
            "press {index}, {button}"
        );
        if !moving {
            assert_eq!(journey.effort(nodes::STEERING, then), 0.0, "press {index}");
        }
        if mode != before {
            changes.push((before, mode));
        }
        before = mode;
    }
    let traffic = journey.traffic();
    let reported: Vec<(u8, u8)> = traffic
        .genuine(ModeChange::ID)
        .map(|frame| (frame.data[0], frame.data[1]))
        .collect();
    assert_eq!(reported, changes, "the event messages tell another story");
    journey.assert_in_place();
    assert_never_reset(&journey);
}

/// Every edge of D stops. Here the receiver toggles its outputs, which the images do not expect:
/// the second press of D lets its output fall.
#[test]
fn a_receiver_that_toggles_does_not_defeat_the_stop_button() {
    let mut journey = Journey::of(
        r#"
        receiver.fix = "none"
        remote = { type = "toggle", bounce = "8 ms" }
        press = [
            { at = "1 s", button = "B" },
            { at = "2 s", button = "D" },
            { at = "2.5 s", button = "A" },
            { at = "3 s", button = "B" },
            { at = "3.5 s", button = "B" },
            { at = "5.5 s", button = "D" },
        ]
        [[joystick]]
        at = "1.2 s"
        forward = "50 %"
        "#,
    );
    journey.to(5.5);
    assert_eq!(journey.mode(), Some(MANUAL));
    journey.to(8.0);
    let state = *journey.vehicle.world().states().last().expect("a state");
    println!("{:.2} m/s 2.5 s after the stop button", state.speed);
    let stopped = journey.stopped(at(5.5)).expect("the motors stop");
    assert!(stopped < at(5.65), "{} s", seconds(stopped));
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert_eq!(journey.mode(), Some(STOP));
}

/// The receiver's outputs fall with its supply: that is the end of a press and nothing else.
#[test]
fn a_receiver_without_supply_starts_nothing() {
    let mut journey = Journey::of(
        r#"
        press = [
            { at = "1 s", button = "C", hold = "2 s" },
            { at = "3 s", button = "C" },
            { at = "4 s", button = "D", hold = "1 s" },
            { at = "4.7 s", button = "A" },
        ]
        supply = [
            { at = "2 s", on = false },
            { at = "3.5 s", on = true },
            { at = "4.5 s", on = false },
        ]
        "#,
    );
    journey.to(3.9);
    assert_eq!(journey.mode(), Some(READY));
    journey.to(5.5);
    assert_eq!(journey.mode(), Some(STOP));
    assert_eq!(journey.last_moved(nodes::DRIVE), None);
}

#[test]
fn an_open_stop_loop_stops_and_holds() {
    let mut journey = crate::running(
        r#"
        stop_loop = [{ at = "3.05 s", open = true }, { at = "4 s", open = false }]
        [[press]]
        at = "3.5 s"
        button = "A"
        [[press]]
        at = "4.4 s"
        button = "A"
        "#,
    );
    journey.to(4.3);
    let stopped = journey.stopped(at(3.05)).expect("the motors stop");
    // Debouncing, then the next control step, then its frame.
    assert!(stopped < at(3.20), "{} s", seconds(stopped));
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert_eq!(journey.mode(), Some(STOP));
    assert_eq!(journey.command(at(3.9)).map(|data| data[4]), Some(STOP));
    journey.to(4.8);
    assert_eq!(journey.mode(), Some(IDLE));
}

#[test]
fn the_joystick_drives_without_any_fix_and_a_run_is_locked_out() {
    let mut journey = Journey::of(
        r#"
        receiver.fix = "none"
        [[press]]
        at = "1 s"
        button = "B"
        [[joystick]]
        at = "1.5 s"
        right = "40 %"
        forward = "60 %"
        [[press]]
        at = "4 s"
        button = "C"
        [[press]]
        at = "4.4 s"
        button = "C"
        "#,
    );
    journey.to(3.9);
    assert_eq!(journey.mode(), Some(MANUAL));
    let state = *journey.vehicle.world().states().last().expect("a state");
    assert!((1.0..1.4).contains(&state.speed), "{} m/s", state.speed);
    assert!(state.steering.to_degrees() > 15.0);
    journey.to(5.0);
    assert_eq!(journey.mode(), Some(READY));
    assert_eq!(journey.effort(nodes::DRIVE, at(5.0)), 0.0);
    assert_eq!(journey.effort(nodes::STEERING, at(5.0)), 0.0);
    let traffic = journey.traffic();
    assert_eq!(traffic.genuine(200).count(), 0);
    // The gps node is the time master nevertheless.
    assert_steady(&journey, &[100, 206, 300], 1.0, 5.0);
    journey.assert_in_place();
}

#[test]
fn the_run_ends_at_the_end_of_the_path_with_the_vehicle_at_rest() {
    let mut journey = Journey::of(&format!("start.north = \"239.5 m\"\n{RUNNING}"));
    journey.to(9.0);
    let traffic = journey.traffic();
    let ran = |frame: &&Sent| frame.data[4] == RUN;
    let last = traffic.genuine(300).filter(ran).last().expect("it ran");
    assert!((at(4.0)..at(8.0)).contains(&last.end));
    assert_eq!(journey.mode(), Some(READY));
    let state = journey.vehicle.world().states().last().expect("a state");
    assert!(state.speed.abs() < 0.01, "{} m/s", state.speed);
    assert!((242.9..244.5).contains(&state.north), "{} m", state.north);
    // The event holds the mode left, the mode entered and the reason: the end of the path.
    let event = first_after(&journey, 501, last.start);
    assert_eq!(event.data[..3], [RUN, READY, 9]);
    // Pressed again in this state, the button does not start a run.
    assert_eq!(journey.effort(nodes::DRIVE, journey.vehicle.now()), 0.0);
}

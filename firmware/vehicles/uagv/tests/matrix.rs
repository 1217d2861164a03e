//! The generated system matrix is the one of the thesis (Figure 6.13).

use network::Message;
use ttcan::{Micros, WindowKind};
use uagv::matrix::{CONTROLLER, DRIVE, GPS, MATRIX, SCHEDULE, STEERING, window};
use uagv::messages::{Command, LogControl, SteeringPot, TimeReference};

#[test]
fn windows_follow_each_other_every_millisecond() {
    let windows = MATRIX.config().windows;
    // Behind those of the thesis, the drive node has its own.
    let (drive, thesis) = windows.split_last().unwrap();
    assert_eq!(
        (drive.name, drive.start),
        ("drive_state", Micros::millis(88))
    );
    assert_eq!(thesis.len(), 12);
    for (index, window) in thesis.iter().enumerate() {
        assert_eq!(
            window.start,
            Micros::millis(index as u32 + 1),
            "{}",
            window.name
        );
    }
    assert_eq!(MATRIX.config().basic_cycle, Micros::millis(100));
    assert_eq!(SCHEDULE.view().window_count(), 13);
}

#[test]
fn exclusive_windows_have_the_senders_and_the_identifiers_of_the_thesis() {
    let table = [
        (401, 7, GPS),
        (402, 7, GPS),
        (200, 8, GPS),
        (201, 8, GPS),
        (202, 4, GPS),
        (206, 2, STEERING),
        (300, 8, CONTROLLER),
        (450, 8, CONTROLLER),
        (451, 8, CONTROLLER),
        (452, 8, CONTROLLER),
        (453, 8, CONTROLLER),
    ];
    for (window, expected) in MATRIX.config().windows.iter().zip(table) {
        let WindowKind::Exclusive {
            id, len, sender, ..
        } = window.kind
        else {
            panic!("{} is not exclusive", window.name);
        };
        assert_eq!((id.raw(), len, sender), expected, "{}", window.name);
    }
}

#[test]
fn positions_name_their_windows() {
    let name = |position: usize| MATRIX.config().windows[position].name;
    assert_eq!(name(window::STEERING_POT), "steering_pot");
    assert_eq!(name(window::COMMAND), "command");
    assert_eq!(name(window::LOG_CONTROL), "log_control");
    assert_eq!(name(window::EVENTS), "events");
    assert_eq!(SteeringPot::ID, 206);
    assert_eq!(Command::ID, 300);
    assert_eq!(LogControl::ID, 453);
}

#[test]
fn events_share_the_window_after_the_last_message() {
    let config = MATRIX.config();
    let events = config.windows[window::EVENTS];
    assert_eq!(events.length, Micros::millis(6));
    assert!(matches!(events.kind, WindowKind::Arbitrating { .. }));
    assert!(config.events.iter().all(|event| event.id.raw() > 500));
    assert!(config.events.iter().any(|event| event.sender == DRIVE));
}

#[test]
fn the_gps_node_is_the_first_master_and_the_controller_the_second() {
    let config = MATRIX.config();
    assert_eq!(config.masters, [GPS, CONTROLLER]);
    assert_eq!(config.reference.raw(), u32::from(TimeReference::ID));
    assert_eq!(config.reference_format.application(), 1);
    assert_eq!(config.reference_format.longest(), TimeReference::LENGTH);
}

//! The vehicle's messages, made from the quantities of the shared modules.

use control::position::Position as Place;
use firmware::buttons::{Button, Change, Edge};
use firmware::convert::geodetic;
use firmware::housekeeping::{BusState, NodeFault, ResetCause, Status, StatusMessage};
use firmware::navigation::Update;
use network::Message;
use proptest::prelude::*;
use ttcan::ErrorLevel;
use uagv::matrix::window;
use uagv::messages::{
    ControllerStatus, DriveStatus, Fault, GpsStatus, Latitude, ResetCause as NamedCause,
    SteeringStatus,
};
use uagv::wire;

#[test]
fn status_messages_have_one_layout() {
    let status = Status {
        reset_cause: ResetCause::Software,
        error_level: ErrorLevel::Warning,
        bus: BusState::ErrorPassive,
        fault: Some(NodeFault::Panic),
        transmit_errors: 1,
        receive_errors: 2,
        missed_windows: u16::MAX,
        bus_offs: 3,
    };
    let data = GpsStatus::of(&status).encode();
    let gps = GpsStatus::decode(&data).unwrap();
    assert_eq!(
        (gps.reset_cause, gps.fault, gps.missed_windows),
        (NamedCause::Software, Fault::Panic, u16::MAX)
    );
    assert_eq!(ControllerStatus::of(&status).encode(), data);
    assert_eq!(SteeringStatus::of(&status).encode(), data);
    assert_eq!(DriveStatus::of(&status).encode(), data);
}

#[test]
fn buttons_have_their_number_on_the_bus() {
    let event = wire::button_event(Change {
        button: Button::StopLoop,
        edge: Edge::Pressed,
        count: 3,
    });
    assert_eq!(event.encode(), [6, 1, 3, 0]);
}

#[test]
fn what_the_receiver_says_goes_to_its_window() {
    assert_eq!(
        wire::update(Update::Position(Some(Place::new(-5, 7)))),
        (window::POSITION, Some([0xFB, 0xFF, 0xFF, 0xFF, 7, 0, 0, 0]))
    );
    // 180 degrees = 180 000 = 0x02BF20.
    assert_eq!(
        wire::update(Update::Heading(Some(180_000))),
        (window::HEADING, Some([0x20, 0xBF, 2, 0, 0, 0, 0, 0]))
    );
    assert_eq!(
        wire::update(Update::Velocity(None)),
        (window::VELOCITY, None)
    );
}

/// The thesis's logged longitude byte 84 is -96 degrees, truncated towards zero.
#[test]
fn negative_angles_truncate_towards_zero() {
    let angle = geodetic(-96.617_089_234_7).unwrap();
    assert_eq!(wire::longitude(angle).encode()[5], 84);
}

proptest! {
    #[test]
    fn angles_survive_the_bus(degrees in -90.0f64..=90.0) {
        let message = wire::latitude(geodetic(degrees).unwrap());
        let back = Latitude::decode(message.encode().as_ref()).unwrap();
        let magnitude = f64::from(back.whole.0.abs()) + back.fraction.0 as f64 * 1e-10;
        let value = if back.negative { -magnitude } else { magnitude };
        prop_assert!((value - degrees).abs() < 1e-10);
    }
}

//! The thesis's logged basic period (Figure 6.33, no fixed solution) reads back
//! as the vehicle it was taken from.

use network::Message;
use uagv::messages::{
    AdcCount, AnyMessage, CentimetresPerSecond, Command, Degrees, DegreesE10, DegreesQ8, Latitude,
    LogControl, LogGuidance, LogMotion, LogPosition, Longitude, Millidegrees, Millimetres,
    MillimetresPerSecond, Milliseconds, Mode, SteeringPot, TimeReference, Velocity,
};

/// The data of the one frame with this identifier.
fn data(id: u16) -> Vec<u8> {
    let log = include_str!("data/thesis_fig6_33.candump.log");
    let prefix = format!("can0 {id:03X}#");
    let (_, frame) = log
        .lines()
        .filter_map(|line| line.split_once(&prefix))
        .next()
        .expect("the frame is in the log");
    (0..frame.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&frame[at..at + 2], 16).expect("hexadecimal"))
        .collect()
}

fn read<M: Message>() -> M {
    M::decode(&data(M::ID)).expect("the frame decodes")
}

#[test]
fn the_time_reference_has_five_bytes_and_no_fix() {
    let reference: TimeReference = read();
    assert_eq!(data(100).len(), 5);
    assert!(!reference.fixed);
    assert_eq!(reference.system_time, Milliseconds(4_897_666));
    assert_eq!(reference.cycle_count, 0);
    assert!(!reference.next_is_gap);
}

/// Whole degrees are right. The reading of the decimal places is unresolved: with the byte order
/// that the network file infers, the receiver is some 76 km from the test track.
#[test]
fn the_receiver_is_in_nebraska_and_nearly_stands() {
    let latitude: Latitude = read();
    assert_eq!(latitude.whole, Degrees(40));
    assert_eq!(latitude.fraction, DegreesE10(3_267_961_710));
    let longitude: Longitude = read();
    assert_eq!(longitude.whole, Degrees(-96));
    assert_eq!(longitude.fraction, DegreesE10(668_627_475));
    let velocity: Velocity = read();
    assert_eq!(velocity.north, MillimetresPerSecond(-22));
    assert_eq!(velocity.east, MillimetresPerSecond(54));
}

#[test]
fn both_pot_messages_agree() {
    assert_eq!(read::<SteeringPot>().count, AdcCount(828));
    assert_eq!(read::<LogControl>().steering_pot, AdcCount(828));
}

#[test]
fn both_speeds_are_the_magnitude_of_the_velocity() {
    let motion: LogMotion = read();
    assert_eq!(motion.speed, CentimetresPerSecond(6));
    let velocity: Velocity = read();
    let magnitude = f64::from(velocity.north.0).hypot(f64::from(velocity.east.0)) / 10.0;
    assert!((f64::from(motion.speed.0) - magnitude).abs() <= 0.5);
    assert_eq!(read::<Command>().speed, CentimetresPerSecond(6));
}

#[test]
fn the_controller_is_at_rest() {
    let command: Command = read();
    assert_eq!(command.mode, Mode::Idle);
    assert_eq!(command.steering_rate.0, 0);
    let position: LogPosition = read();
    assert_eq!((position.x, position.y), (Millimetres(0), Millimetres(0)));
    assert_eq!(read::<LogMotion>().psi, DegreesQ8(0));
    assert_eq!(read::<LogControl>().control_input.0, 0);
    let guidance: LogGuidance = read();
    assert_eq!(guidance.cross_track_error, Millimetres(0));
    assert_eq!(guidance.steering_angle, Millidegrees(-11_008));
    assert_eq!(guidance.steering_rate_command.0, 0);
}

#[test]
fn every_frame_of_the_log_encodes_to_its_bytes_again() {
    for id in [401, 402, 201, 206, 300, 450, 451, 452, 453] {
        let bytes = data(id);
        let again = match AnyMessage::decode(id, &bytes).expect("the frame decodes") {
            AnyMessage::Latitude(m) => m.encode().to_vec(),
            AnyMessage::Longitude(m) => m.encode().to_vec(),
            AnyMessage::Velocity(m) => m.encode().to_vec(),
            AnyMessage::SteeringPot(m) => m.encode().to_vec(),
            AnyMessage::Command(m) => m.encode().to_vec(),
            AnyMessage::LogPosition(m) => m.encode().to_vec(),
            AnyMessage::LogMotion(m) => m.encode().to_vec(),
            AnyMessage::LogGuidance(m) => m.encode().to_vec(),
            AnyMessage::LogControl(m) => m.encode().to_vec(),
            other => panic!("{} is not in the log", other.name()),
        };
        assert_eq!(again, bytes, "identifier {id}");
    }
}

//! The generated shifts and masks against a bit-by-bit reader and writer.

use std::sync::LazyLock;

use network::{DecodeError, Message};
use network_model::Network;
use proptest::{collection::vec, prelude::*};
use uagv::messages::{
    AdcCount, AnyMessage, BackupReference, Button, ButtonEvent, CentidegreesPerSecond,
    CentimetresPerSecond, Command, ControllerSelfTest, ControllerStatus, DriveSelfTest, DriveState,
    DriveStatus, GpsSelfTest, GpsStatus, Heading, Latitude, LogControl, LogGuidance, LogMotion,
    LogPosition, Longitude, Millimetres, Mode, ModeChange, Position, SelfTestRequest, SteeringPot,
    SteeringSelfTest, SteeringStatus, TimeReference, Velocity,
};

static NETWORK: LazyLock<Network> = LazyLock::new(|| {
    Network::parse(include_str!("../network.dbc")).expect("the network file is right")
});

/// One message from numbers as random as `seeds`: each signal somewhere in its
/// range or at one of its ends; the counts, and the frame written bit by bit.
fn frame(model: &network_model::Message, tables: &Network, seeds: &[u64]) -> (Vec<i64>, Vec<u8>) {
    let mut data = vec![0; usize::from(model.length)];
    let mut counts = Vec::new();
    for (signal, seed) in model.signals.iter().zip(seeds) {
        let (least, greatest) = signal.count_range().expect("checked");
        let count = match (&signal.values, seed % 8) {
            (Some(name), _) => {
                let table = tables.value_tables.iter().find(|t| t.name == *name);
                let values = &table.expect("checked").values;
                i128::from(values[*seed as usize % values.len()].raw)
            }
            (None, 0) => least,
            (None, 1) => greatest,
            (None, _) => least + i128::from(*seed) % (greatest - least + 1),
        };
        signal.insert(&mut data, count - signal.offset_counts().expect("checked"));
        counts.push(count as i64);
    }
    (counts, data)
}

fn counts_of(message: &impl Message) -> Vec<i64> {
    let mut counts = Vec::new();
    message.visit(&mut |_, count| counts.push(count));
    counts
}

/// One property for one message type.
fn agrees<M: Message + PartialEq + core::fmt::Debug>(seeds: &[u64], noise: &[u8]) {
    let network = &*NETWORK;
    let model = network.message(M::ID).expect("in the file");
    assert_eq!((M::NAME, M::LENGTH), (model.name.as_str(), model.length));

    let (counts, data) = frame(model, network, seeds);
    let message = M::decode(&data).expect("every signal is in range");
    assert_eq!(counts_of(&message), counts);
    assert_eq!(message.encode().as_ref(), data);
    assert_eq!(message.frame().id().raw(), u32::from(M::ID));
    assert_eq!(message.frame().data(), data);

    // Any bytes at all: the same signals, or a refusal because one is out of range.
    let noise = &noise[..usize::from(M::LENGTH)];
    let raw: Vec<i128> = model.signals.iter().map(|s| s.extract(noise)).collect();
    let valid = model.signals.iter().zip(&raw).all(|(signal, raw)| {
        let count = raw + signal.offset_counts().expect("checked");
        let (least, greatest) = signal.count_range().expect("checked");
        let named = signal.values.as_ref().is_none_or(|name| {
            let table = network.value_tables.iter().find(|t| t.name == *name);
            let mut values = table.expect("checked").values.iter();
            values.any(|value| i128::from(value.raw) == count)
        });
        (least..=greatest).contains(&count) && named
    });
    match M::decode(noise) {
        Ok(message) => {
            assert!(valid);
            let expected: Vec<i64> = model
                .signals
                .iter()
                .zip(&raw)
                .map(|(signal, raw)| (raw + signal.offset_counts().expect("checked")) as i64)
                .collect();
            assert_eq!(counts_of(&message), expected);
            assert_eq!(M::decode(message.encode().as_ref()), Ok(message));
        }
        Err(DecodeError::Range(_)) => assert!(!valid),
        Err(other) => panic!("{other}"),
    }

    // Every other length is refused, except between the shortest and the full one.
    let long = [0; 9];
    for length in 0..=9 {
        let accepted = (M::SHORTEST..=M::LENGTH).contains(&(length as u8));
        let refused = M::decode(&long[..length]) == Err(DecodeError::Length);
        assert_eq!(refused, !accepted, "{} with {length} bytes", M::NAME);
    }
}

macro_rules! messages {
    ($($test:ident: $message:ident,)*) => {
        proptest! {
            #![proptest_config(ProptestConfig::with_cases(128))]
            $(#[test]
            fn $test(seeds in vec(any::<u64>(), 16), noise in vec(any::<u8>(), 8)) {
                agrees::<$message>(&seeds, &noise);
            })*
        }

        /// A message added to the network file must be added to this list.
        #[test]
        fn every_message_is_tested() {
            let mut tested = vec![$($message::ID),*];
            tested.sort_unstable();
            let mut all: Vec<u16> = NETWORK.messages.iter().map(|m| m.id).collect();
            all.sort_unstable();
            assert_eq!(tested, all);
        }
    };
}

messages! {
    time_reference: TimeReference,
    backup_reference: BackupReference,
    latitude: Latitude,
    longitude: Longitude,
    position: Position,
    velocity: Velocity,
    heading: Heading,
    steering_pot: SteeringPot,
    drive_state: DriveState,
    command: Command,
    log_position: LogPosition,
    log_motion: LogMotion,
    log_guidance: LogGuidance,
    log_control: LogControl,
    mode_change: ModeChange,
    button_event: ButtonEvent,
    gps_status: GpsStatus,
    controller_status: ControllerStatus,
    steering_status: SteeringStatus,
    drive_status: DriveStatus,
    gps_self_test: GpsSelfTest,
    controller_self_test: ControllerSelfTest,
    steering_self_test: SteeringSelfTest,
    drive_self_test: DriveSelfTest,
    self_test_request: SelfTestRequest,
}

proptest! {
    #[test]
    fn a_value_out_of_range_is_sent_as_the_nearest_limit(
        cross_track in any::<i32>(), angle in any::<i32>(), pot in any::<u16>(),
    ) {
        let mut guidance = LogGuidance::decode(&[0x80, 0, 0x80, 0, 0x80, 0, 0x80, 0]).unwrap();
        guidance.cross_track_error = Millimetres(cross_track);
        guidance.steering_angle.0 = angle;
        let sent = LogGuidance::decode(&guidance.encode()).unwrap();
        prop_assert_eq!(sent.cross_track_error.0, cross_track.clamp(-32_768, 32_767));
        prop_assert_eq!(sent.steering_angle.0, angle.clamp(-32_768, 32_767));

        let sent = SteeringPot::decode(&SteeringPot { count: AdcCount(pot) }.encode()).unwrap();
        prop_assert_eq!(sent.count.0, pot.min(4095));
    }
}

/// The layout that the actuator nodes rely on, byte by byte.
#[test]
fn the_command_has_its_layout() {
    let command = Command {
        steering_rate: CentidegreesPerSecond(-1234),
        speed: CentimetresPerSecond(100),
        mode: Mode::AutonomousRun,
        steering_enabled: true,
        drive_enabled: true,
        emergency_stop: false,
        counter: 0xA5,
        check: 0x3C,
    };
    let bytes = [0x2E, 0xFB, 0x64, 0x00, 0x03, 0x03, 0xA5, 0x3C];
    assert_eq!(command.encode(), bytes);
    assert_eq!(Command::decode(&bytes), Ok(command));
}

#[test]
fn a_value_without_a_name_is_refused() {
    assert_eq!(
        Command::decode(&[0, 0, 0, 0, 6, 0, 0, 0]),
        Err(DecodeError::Range(&Command::MODE))
    );
    assert_eq!(
        ButtonEvent::decode(&[0, 1, 0, 0]),
        Err(DecodeError::Range(&ButtonEvent::BUTTON))
    );
    assert_eq!(
        ButtonEvent::decode(&[1, 1, 0, 0]).map(|e| e.button),
        Ok(Button::A)
    );
}

#[test]
fn a_foreign_identifier_is_no_message() {
    assert_eq!(
        AnyMessage::decode(299, &[0; 8]),
        Err(DecodeError::Identifier)
    );
}

//! The generated code and the model against cantools, another reader of DBC files.
//!
//! `cantools/vectors.py` wrote the frames.

use network::Message;
use network_model::Network;
use uagv::messages::{
    AnyMessage, BackupReference, ButtonEvent, Command, ControllerSelfTest, ControllerStatus,
    DriveSelfTest, DriveState, DriveStatus, GpsSelfTest, GpsStatus, Heading, Latitude, LogControl,
    LogGuidance, LogMotion, LogPosition, Longitude, ModeChange, Position, SelfTestRequest,
    SteeringPot, SteeringSelfTest, SteeringStatus, TimeReference, Velocity,
};

struct Vector {
    id: u16,
    data: Vec<u8>,
    raw: Vec<i128>,
    physical: Vec<f64>,
}

fn vectors() -> impl Iterator<Item = Vector> {
    include_str!("data/cantools.txt").lines().map(|line| {
        let mut words = line.split_whitespace();
        let id = words
            .next()
            .expect("an identifier")
            .parse()
            .expect("a number");
        let hex = words.next().expect("data bytes");
        let data = (0..hex.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal"))
            .collect();
        let (raw, physical) = words
            .map(|word| {
                let (raw, physical) = word.split_once('=').expect("raw=physical");
                let raw: i128 = raw.parse().expect("a whole number");
                let physical: f64 = physical.parse().expect("a number");
                (raw, physical)
            })
            .unzip();
        Vector {
            id,
            data,
            raw,
            physical,
        }
    })
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs()).max(1e-6)
}

#[test]
fn the_model_reads_and_writes_what_cantools_does() {
    let network = Network::parse(include_str!("../network.dbc")).expect("the file is right");
    let mut seen = 0;
    for vector in vectors() {
        let message = network.message(vector.id).expect("in the file");
        assert_eq!(message.signals.len(), vector.raw.len());
        let mut data = vec![0; usize::from(message.length)];
        for ((signal, raw), physical) in message
            .signals
            .iter()
            .zip(&vector.raw)
            .zip(&vector.physical)
        {
            let name = format!("{}.{}", message.name, signal.name);
            assert_eq!(signal.extract(&vector.data), *raw, "{name}");
            assert!(close(signal.physical(*raw), *physical), "{name}");
            signal.insert(&mut data, *raw);
        }
        assert_eq!(data, vector.data, "{}", message.name);
        seen += 1;
    }
    assert_eq!(seen, 12 * network.messages.len());
}

fn check<M: Message + PartialEq + core::fmt::Debug>(vector: &Vector, any: AnyMessage) {
    let message = M::decode(&vector.data).expect("within the limits");
    let mut physical = Vec::new();
    message.visit(&mut |signal, count| physical.push(count as f64 * signal.factor));
    for ((ours, theirs), signal) in physical.iter().zip(&vector.physical).zip(M::SIGNALS) {
        assert!(
            close(*ours, *theirs),
            "{}.{}: {ours} {theirs}",
            M::NAME,
            signal.name
        );
    }
    assert_eq!(message.encode().as_ref(), vector.data, "{}", M::NAME);
    assert_eq!((any.id(), any.name()), (M::ID, M::NAME));
}

#[test]
fn the_generated_code_reads_and_writes_what_cantools_does() {
    for vector in vectors() {
        let any = AnyMessage::decode(vector.id, &vector.data).expect("within the limits");
        match any {
            AnyMessage::TimeReference(_) => check::<TimeReference>(&vector, any),
            AnyMessage::BackupReference(_) => check::<BackupReference>(&vector, any),
            AnyMessage::Latitude(_) => check::<Latitude>(&vector, any),
            AnyMessage::Longitude(_) => check::<Longitude>(&vector, any),
            AnyMessage::Position(_) => check::<Position>(&vector, any),
            AnyMessage::Velocity(_) => check::<Velocity>(&vector, any),
            AnyMessage::Heading(_) => check::<Heading>(&vector, any),
            AnyMessage::SteeringPot(_) => check::<SteeringPot>(&vector, any),
            AnyMessage::DriveState(_) => check::<DriveState>(&vector, any),
            AnyMessage::Command(_) => check::<Command>(&vector, any),
            AnyMessage::LogPosition(_) => check::<LogPosition>(&vector, any),
            AnyMessage::LogMotion(_) => check::<LogMotion>(&vector, any),
            AnyMessage::LogGuidance(_) => check::<LogGuidance>(&vector, any),
            AnyMessage::LogControl(_) => check::<LogControl>(&vector, any),
            AnyMessage::ModeChange(_) => check::<ModeChange>(&vector, any),
            AnyMessage::ButtonEvent(_) => check::<ButtonEvent>(&vector, any),
            AnyMessage::GpsStatus(_) => check::<GpsStatus>(&vector, any),
            AnyMessage::ControllerStatus(_) => check::<ControllerStatus>(&vector, any),
            AnyMessage::SteeringStatus(_) => check::<SteeringStatus>(&vector, any),
            AnyMessage::DriveStatus(_) => check::<DriveStatus>(&vector, any),
            AnyMessage::GpsSelfTest(_) => check::<GpsSelfTest>(&vector, any),
            AnyMessage::ControllerSelfTest(_) => check::<ControllerSelfTest>(&vector, any),
            AnyMessage::SteeringSelfTest(_) => check::<SteeringSelfTest>(&vector, any),
            AnyMessage::DriveSelfTest(_) => check::<DriveSelfTest>(&vector, any),
            AnyMessage::SelfTestRequest(_) => check::<SelfTestRequest>(&vector, any),
        }
    }
}

//! The planner's frames, as the vehicle's receiver judges them.

use can_bus::Frame;
use firmware::e2e::{Receiver, Refusal, Secret, TimeProof};
use network::{DecodeError, Message, Signal};
use planner::{Demand, Error, Heard, Key, Lead, Planner, Vehicle, vehicle};
use proptest::prelude::*;
use std::sync::LazyLock;
use std::time::Duration;
use ttcan::{Id, Micros};
use vehicle_model::Overrides;

/// Message 310 of planner.dbc, as far as its protection goes.
#[derive(Clone, Copy, Debug)]
struct Command;

impl Message for Command {
    const ID: u16 = 310;
    const NAME: &'static str = "PlannerCommand";
    const LENGTH: u8 = 8;
    const SHORTEST: u8 = 8;
    const FREE: u64 = 0x0000_FFFF_0000_0000;
    type Node = ();
    const SENDER: () = ();
    const SIGNALS: &'static [Signal] = &[];
    type Bytes = [u8; 8];

    fn encode(&self) -> [u8; 8] {
        [0; 8]
    }

    fn frame(&self) -> ttcan::Frame {
        ttcan::Frame::from_parts(ttcan::Id::constant::<310>(), 8, self.encode())
    }

    fn decode(_: &[u8]) -> Result<Self, DecodeError> {
        Ok(Self)
    }

    fn visit(&self, _: &mut dyn FnMut(&'static Signal, i64)) {}
}

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/vehicles/uagv");

fn planner(key: Option<Key>) -> Planner {
    static UAGV: LazyLock<Vehicle> = LazyLock::new(|| vehicle(FOLDER).unwrap());
    Planner::of(&UAGV, key).unwrap()
}

/// A reference message of the gps node at this system time, ms, with these bits of the proof of the time.
fn proving(time: u32, bits: u8) -> Frame {
    let [a, b, c, d] = time.to_be_bytes();
    Frame::standard(100, &[bits | 1, a, b, c, d, 0, 0, 0]).unwrap()
}

fn reference(time: u32) -> Frame {
    proving(time, 0)
}

const fn ms(time: u32) -> Duration {
    Duration::from_millis(time as u64)
}

fn command(planner: &mut Planner, time: u32, curvature: f64, speed: f64) -> Frame {
    let heard = planner.heard(&reference(time), ms(time));
    assert!(matches!(heard, Heard::Begin(_)));
    planner.command(Demand { curvature, speed }).unwrap()
}

/// A gps node with a key.
struct Gps(TimeProof);

impl Gps {
    fn with(key: Key) -> Self {
        Self(TimeProof::new(Secret::Key(key), 0xFC, Micros::millis(100)))
    }

    /// Its reference of a basic cycle.
    fn reference(&mut self, time: u32) -> Frame {
        let sent = proving(time, self.0.bits());
        let frame = ttcan::Frame::new(Id::constant::<100>(), sent.data()).unwrap();
        self.0.begin(&frame, 100);
        self.0.close(self.0.open().unwrap().answer());
        sent
    }
}

const AHEAD: Demand<f64> = Demand {
    curvature: -0.2,
    speed: 0.5,
};

fn judged(receiver: &mut Receiver, time: u32, frame: &Frame) -> Result<(), Refusal> {
    assert_eq!(
        frame.id(),
        embedded_can::StandardId::new(310).unwrap().into()
    );
    receiver.judge::<Command>(time, frame.data().try_into().unwrap())
}

#[test]
fn the_vehicle_believes_the_planner() {
    let (mut planner, mut receiver) = (planner(None), Receiver::new(Secret::None));
    let first = command(&mut planner, 1000, 0.0, 1.0);
    assert_eq!(judged(&mut receiver, 1000, &first), Err(Refusal::First));
    for cycle in 1..600 {
        let time = 1000 + 100 * cycle;
        let frame = command(&mut planner, time, 0.1, 1.0);
        assert_eq!(judged(&mut receiver, time, &frame), Ok(()));
    }
}

#[test]
fn with_a_key_only_the_same_key_is_believed() {
    let key = Key::new(*b"a secret of 16 b");
    let (mut own, mut receiver) = (planner(Some(key)), Receiver::new(Secret::Key(key)));
    let mut other = planner(Some(Key::new(*b"another secret  ")));
    let (mut gps, mut false_gps) = (Gps::with(key), Gps::with(Key::new(*b"another secret  ")));
    let mut forged = None;
    for cycle in 1..20 {
        let time = 100 * cycle;
        own.heard(&gps.reference(time), ms(time));
        let command = own.command::<Frame>(AHEAD);
        // Five right tags prove the time, and the first reference has none before it.
        assert_eq!(command.is_some(), cycle > 5, "{cycle}");
        if let Some(frame) = command {
            assert_eq!(judged(&mut receiver, time, &frame), Ok(()));
        }
        other.heard(&false_gps.reference(time), ms(time));
        forged = other.command(AHEAD);
    }
    let forged = forged.unwrap();
    assert_eq!(judged(&mut receiver, 1900, &forged), Err(Refusal::Forged));
    let open = command(&mut planner(None), 2100, -0.2, 0.5);
    assert_eq!(judged(&mut receiver, 2100, &open), Err(Refusal::Forged));
}

/// Who records a command of a later time can play it then.
#[test]
fn nothing_is_sealed_for_a_forged_time() {
    let key = Key::new(*b"a secret of 16 b");
    let (mut planner, mut gps) = (planner(Some(key)), Gps::with(key));
    for cycle in 1..20 {
        let time = 100 * cycle;
        planner.heard(&gps.reference(time), ms(time));
        assert_eq!(planner.command::<Frame>(AHEAD).is_some(), cycle > 5);
        // The tag is what it would be, as an attacker may guess.
        let forged = proving(time + 1_000_000, gps.0.bits());
        if cycle > 10 {
            assert!(matches!(
                planner.heard(&forged, ms(time + 50)),
                Heard::Begin(_)
            ));
            assert_eq!(planner.command::<Frame>(AHEAD), None);
            break;
        }
    }
    // The true ones prove theirs again.
    for cycle in 12..20 {
        let time = 100 * cycle;
        planner.heard(&gps.reference(time), ms(time));
        assert_eq!(
            planner.command::<Frame>(AHEAD).is_some(),
            cycle > 16,
            "{cycle}"
        );
    }
    // And a time before is none of this run.
    assert_eq!(planner.heard(&reference(1500), ms(2000)), Heard::Nothing);
}

/// References of another run, all of them right, played within a basic cycle.
#[test]
fn nothing_is_sealed_for_recorded_references_between_true_ones() {
    let key = Key::new(*b"a secret of 16 b");
    let (mut planner, mut gps, mut recorded) = (planner(Some(key)), Gps::with(key), Gps::with(key));
    for cycle in 1..40 {
        let time = 100 * cycle;
        planner.heard(&gps.reference(time), ms(time));
        planner.command::<Frame>(AHEAD);
        for step in 1..10 {
            let later = 1_000_000 + 1000 * cycle + 100 * step;
            planner.heard(&recorded.reference(later), ms(time + 10 * step));
            assert_eq!(planner.command::<Frame>(AHEAD), None, "{cycle} {step}");
        }
    }
}

#[test]
fn a_cycle_has_one_command() {
    let mut planner = planner(None);
    let demand = Demand {
        curvature: 0.0,
        speed: 1.0,
    };
    assert_eq!(planner.command::<Frame>(demand), None);
    command(&mut planner, 100, 0.0, 1.0);
    assert_eq!(planner.command::<Frame>(demand), None);
    planner.heard(&reference(200), ms(200));
    for bad in [f64::NAN, f64::INFINITY] {
        let bad = Demand {
            speed: bad,
            ..demand
        };
        assert_eq!(planner.command::<Frame>(bad), None);
    }
    assert!(planner.command::<Frame>(demand).is_some());
}

#[test]
fn a_command_fits_its_window() {
    let Heard::Begin(slot) = planner(None).heard(&reference(100), ms(100)) else {
        panic!("no slot");
    };
    assert!(slot.earliest >= Duration::from_millis(40));
    assert!(slot.latest > slot.earliest && slot.latest < Duration::from_millis(59));
}

#[test]
fn the_vehicle_tells_who_leads() {
    let mut planner = planner(None);
    // Path, 3 refused, 250 ms old, 0.05 1/m, 0.8 m/s.
    let data = [0x01, 3, 25, 0xF4, 0x01, 0x20, 0x03, 0];
    let Heard::Report(report) = planner.heard(&Frame::standard(455, &data).unwrap(), ms(0)) else {
        panic!("no report");
    };
    assert_eq!((report.lead, report.refused), (Lead::Planner, 3));
    assert_eq!(report.age, Duration::from_millis(250));
    assert!((report.demand.curvature - 0.05).abs() < 1e-9);
    assert!((report.demand.speed - 0.8).abs() < 1e-9);
}

#[test]
fn a_vehicle_without_a_planner_is_refused() {
    let off = Vehicle::read(FOLDER.as_ref()).unwrap();
    let refused = Planner::of(&off, None).err().unwrap();
    assert!(matches!(refused, Error::NoPlanner { .. }), "{refused}");
}

/// Values of the manifest that leave no planner to obey.
#[test]
fn a_planner_that_makes_no_sense_is_refused() {
    let refused = |values: &str| {
        let values = Overrides::parse(values).unwrap();
        let refused = Vehicle::read_with(FOLDER.as_ref(), &values).unwrap_err();
        refused.to_string()
    };
    for (values, part) in [
        (
            "planner.enabled=true;row_guidance.enabled=true",
            "one of the two is accepted",
        ),
        (
            "planner.enabled=true;planner.command=Command",
            "is a message of \"controller\"",
        ),
        (
            "planner.enabled=true;planner.command=Nothing",
            "there is no message \"Nothing\"",
        ),
        (
            "planner.enabled=true;planner.lead=PlannerLead.Age",
            "with a value table",
        ),
        ("planner.name=drive", "which a node with a board has"),
        (
            "planner.enabled=true;planner.longest_age=100 ms",
            "planner.longest_age",
        ),
        (
            "planner.lateral_acceleration=0 m/s2",
            "planner.lateral_acceleration",
        ),
    ] {
        let refused = refused(values);
        assert!(refused.contains(part), "{values}: {refused}");
    }
}

proptest! {
    /// Whatever is asked for and heard: the data say it, or the nearest that they can say.
    #[test]
    fn any_demand_is_sent(curvature in -1e9..1e9_f64, speed in -1e9..1e9_f64) {
        let frame = command(&mut planner(None), 100, curvature, speed);
        let data = frame.data();
        let number = |at: usize| f64::from(i16::from_le_bytes([data[at], data[at + 1]]));
        prop_assert!((number(0) * 1e-4 - curvature.clamp(-2.0, 2.0)).abs() <= 0.5001e-4);
        prop_assert!((number(2) * 1e-3 - speed.clamp(0.0, 10.0)).abs() <= 0.5001e-3);
    }

    #[test]
    fn any_frame_is_heard(id in 0..2048_u16, data in prop::collection::vec(any::<u8>(), 0..9)) {
        let mut planner = planner(None);
        planner.heard(&Frame::standard(id, &data).unwrap(), ms(0));
    }
}

/// The numbers of the example in README.md, which a planner in another language can be tried with.
#[test]
fn the_readme_has_a_true_example() {
    let data = [0xD0, 0x07, 0xF4, 0x01, 0, 0, 5, 0];
    let check = firmware::e2e::check_value(310, 12_300, &data);
    let mut frame = data;
    frame[7] = check;
    let told: Vec<String> = frame.iter().map(|byte| format!("{byte:02X}")).collect();
    let readme = include_str!("../README.md");
    assert!(
        readme.contains(&format!("`{}`", told.join(" "))),
        "{told:?}"
    );
}

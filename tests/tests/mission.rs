//! The release images of the UAGV drive a mission from their flash: two swaths with a headland turn between them.

use std::fs;
use std::sync::OnceLock;

use twin::{Images, Options, Outcome};
use vehicle_model::{Device, Overrides, Vehicle};
use world::Scenario;
use world::time::{from_seconds, seconds};

/// The vehicle with its images.
fn uagv() -> &'static (Vehicle, Images) {
    static VEHICLE: OnceLock<(Vehicle, Images)> = OnceLock::new();
    VEHICLE.get_or_init(|| {
        let build = || {
            let workspace = xtask::Workspace::find()?;
            let on = Overrides::parse("mission.enabled=true").expect("a value of the manifest");
            let vehicle = xtask::vehicle::with(&workspace, "uagv", &on)?;
            let nodes: Vec<_> = vehicle.nodes().collect();
            let images = xtask::build::images(&workspace, &vehicle, &nodes)?;
            Ok((vehicle, xtask::build::read(&images)?))
        };
        build().unwrap_or_else(|failure: xtask::Failure| panic!("{failure}"))
    })
}

const MISSION: &str = "name = \"two swaths\"\norigin = { latitude = \"40 deg\", longitude = \"10 deg\" }\n[[leg]]\nfrom = [3, 0]\nto = [15, 0]\nspeed = \"1 m/s\"\noutputs = [1]\n\
                       [[leg]]\nfrom = [15, 3]\nto = [3, 3]\nspeed = \"1 m/s\"\noutputs = [1]\n";

/// A run with these words in the place of a mission.
fn run(record: Option<Vec<u8>>, length: f64) -> Outcome {
    let (vehicle, images) = uagv();
    let text = "[[press]]\nat = \"4 s\"\nbutton = \"C\"\n[[press]]\nat = \"5 s\"\nbutton = \"C\"\n";
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", text).unwrap();
    let node = vehicle.node_of(Device::OperatorSwitches).unwrap();
    let place = xtask::vehicle::board(vehicle, node).mission.unwrap().base;
    let images = match record {
        Some(record) => images.clone().with_data(node, place, record),
        None => images.clone(),
    };
    let options = Options {
        duration: Some(from_seconds(length)),
        ..Options::default()
    };
    twin::run(vehicle, &scenario, &images, &options, |_| {}).unwrap()
}

/// The record of the mission.
fn record() -> Vec<u8> {
    static RECORD: OnceLock<Vec<u8>> = OnceLock::new();
    let make = || {
        let file = format!("furrow-mission-{}.toml", std::process::id());
        let file = std::env::temp_dir().join(file);
        fs::write(&file, MISSION).unwrap();
        let loaded = xtask::mission::load(&uagv().0, &file).unwrap_or_else(|why| panic!("{why}"));
        fs::remove_file(&file).unwrap();
        loaded.record
    };
    RECORD.get_or_init(make).clone()
}

/// Rear axle, m north and east, heading, rad, and speed, m/s, at each sample.
fn rear(outcome: &Outcome) -> Vec<(f64, [f64; 4])> {
    let states = outcome.world.states().iter();
    let of = states.map(|at| {
        let (north, east) = (at.heading.cos() * 0.255, at.heading.sin() * 0.255);
        let place = [at.north - north, at.east - east, at.heading, at.speed];
        (seconds(at.at), place)
    });
    of.collect()
}

#[test]
fn two_swaths_and_their_turn_are_driven() {
    let outcome = run(Some(record()), 75.0);
    let way = rear(&outcome);
    let on = |east: f64, heading: f64| {
        let inside = way.iter().filter(move |(_, [north, at, head, speed])| {
            let turn = (head - heading).sin().abs() < 0.2 && (head - heading).cos() > 0.0;
            (3.0..15.0).contains(north) && (at - east).abs() < 0.5 && turn && *speed > 0.2
        });
        let errors: Vec<f64> = inside.map(|(_, [_, at, ..])| (at - east).abs()).collect();
        assert!(errors.len() > 500, "{} samples", errors.len());
        errors.iter().sum::<f64>() / errors.len() as f64
    };
    let (first, second) = (on(0.0, 0.0), on(3.0, std::f64::consts::PI));
    assert!(first < 0.01 && second < 0.01, "{first} m, {second} m");
    // At rest at its end.
    let &(_, [north, east, _, speed]) = way.last().unwrap();
    assert!((north - 3.0).abs() < 0.1 && (east - 3.0).abs() < 0.1 && speed.abs() < 0.01);
}

/// What is no whole record is not driven, and neither is a line in its place.
#[test]
fn a_damaged_record_is_not_driven() {
    let mut record = record();
    record[40] ^= 1;
    let outcome = run(Some(record), 12.0);
    assert!(
        rear(&outcome)
            .iter()
            .all(|(_, [.., speed])| speed.abs() < 0.01)
    );
}

#[test]
fn without_a_record_the_line_is_driven() {
    let outcome = run(None, 20.0);
    let &(_, [north, east, _, speed]) = rear(&outcome).last().unwrap();
    assert!(north > 8.0 && east.abs() < 0.03 && (speed - 1.0).abs() < 0.05);
}

//! Commands of another run, played to the release images of the UAGV: with sessions nobody obeys them.

use std::collections::BTreeMap;
use std::time::Duration;

use can_bus::Frame;
use embedded_can::{Id, StandardId};
use furrow_tests::with;
use twin::Images;
use vehicle_model::Vehicle;
use world::Scenario;
use xtask::selftest::{OnTwin, Transport};

const REFERENCE: u16 = 100;
const COMMAND: u16 = 300;
/// From a reference's end to a bit before the window of the command, which wins against the true frame.
const BEFORE: Duration = Duration::from_micros(6520);

fn is(frame: &Frame, id: u16) -> bool {
    StandardId::new(id).map(Id::from) == Some(frame.id())
}

/// What a run was.
struct Run {
    /// The commands by the time in their basic cycle's reference.
    commands: BTreeMap<Vec<u8>, Frame>,
    /// The largest speed, m/s.
    fastest: f64,
}

/// Lets a vehicle run for 8 s, with a program on its bus that sends these commands ahead of the true ones, in the basic
/// cycles of the same time.
fn run(
    (vehicle, images): &(Vehicle, Images),
    text: &str,
    played: &BTreeMap<Vec<u8>, Frame>,
) -> Run {
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", text).unwrap();
    let mut bus = OnTwin::within(vehicle, &scenario, images).unwrap();
    let mut commands = BTreeMap::new();
    let mut time = Vec::new();
    let end = Duration::from_secs(8);
    while let Some(received) = bus.receive(end).unwrap() {
        if is(&received.frame, REFERENCE) {
            // The system time is in the first five bytes; the tag behind it is another one in each run.
            time = received.frame.data()[1..5].to_vec();
            if let Some(frame) = played.get(&time) {
                while bus.receive(received.at + BEFORE).unwrap().is_some() {}
                bus.send(frame).unwrap();
            }
        } else if is(&received.frame, COMMAND) {
            commands.insert(time.clone(), received.frame);
        }
    }
    let states = bus.twin().world().states();
    let fastest = states
        .iter()
        .map(|state| state.speed.abs())
        .fold(0.0, f64::max);
    Run { commands, fastest }
}

/// A run that drives.
const DRIVEN: &str = "key = true\n[[press]]\nat = \"3 s\"\nbutton = \"C\"\n[[press]]\nat = \"4 s\"\nbutton = \"C\"\n";
/// One that stands.
const STANDING: &str = "key = true\n";
/// One that stands, and in which the actuators have started for a second time: the twin's flash is new in each run.
const LATER: &str = "key = true\n[[reset]]\nnode = \"steering\"\nat = \"0.3 s\"\nuntil = \"0.4 s\"\n[[reset]]\nnode = \"drive\"\nat = \"0.3 s\"\nuntil = \"0.4 s\"\n";

/// The time of a run begins where that of the others does, so its commands fit to another one that has the same key.
#[test]
fn without_sessions_commands_of_another_run_are_obeyed() {
    let uagv = with("");
    let driven = run(&uagv, DRIVEN, &BTreeMap::new());
    assert!(driven.fastest > 0.5, "{}", driven.fastest);
    assert!(run(&uagv, STANDING, &BTreeMap::new()).fastest < 0.01);
    let played = run(&uagv, STANDING, &driven.commands);
    assert!(played.fastest > 0.5, "{}", played.fastest);
}

#[test]
fn with_sessions_commands_of_another_run_move_nothing() {
    let uagv = with("sessions.enabled=true");
    let driven = run(&uagv, DRIVEN, &BTreeMap::new());
    assert!(driven.fastest > 0.5, "{}", driven.fastest);
    // The recorded commands are good: in the session that they were sealed for they would be obeyed.
    let same = run(&uagv, STANDING, &driven.commands);
    assert!(same.fastest > 0.5, "{}", same.fastest);
    let later = run(&uagv, LATER, &driven.commands);
    assert!(later.fastest < 0.01, "{}", later.fastest);
}

/// An actuator that starts again comes back with a new number, and the others go on in the session of that.
#[test]
fn a_start_of_an_actuator_makes_another_session() {
    let again = "[[reset]]\nnode = \"drive\"\nat = \"1 s\"\nuntil = \"1.1 s\"\n";
    let text = format!("{DRIVEN}{again}");
    let run = run(&with("sessions.enabled=true"), &text, &BTreeMap::new());
    assert!(run.fastest > 0.5, "{}", run.fastest);
}

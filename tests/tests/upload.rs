//! The release images of the UAGV take a mission from their bus, check it, and write it into the emulated flash.

use std::sync::OnceLock;
use std::time::Duration;

use control::mission::{End, Leg, Legs};
use control::position::Position;
use firmware::mission::upload::{Outcome, Reason, Request};
use twin::Images;
use vehicle_model::Vehicle;
use world::Scenario;
use xtask::mission::{Client, Error, Told};
use xtask::selftest::{OnTwin, Transport};

#[path = "../../firmware/tests/support/missions.rs"]
#[expect(unreachable_pub, dead_code, reason = "a fuzz target has it, too")]
mod missions;
use missions::northwards;

/// The vehicle with its images.
fn uagv() -> &'static (Vehicle, Images) {
    static VEHICLE: OnceLock<(Vehicle, Images)> = OnceLock::new();
    VEHICLE.get_or_init(|| furrow_tests::with("mission.enabled=true"))
}

/// The bus of the vehicle at rest, with what else happens.
fn bus(events: &str) -> OnTwin {
    let (vehicle, images) = uagv();
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", events).unwrap();
    OnTwin::within(vehicle, &scenario, images).unwrap()
}

/// The record of legs of 10 m due north, one behind the other.
fn record(legs: u16, curvature: f32) -> Vec<u8> {
    let leg = |number| {
        let mut leg = northwards(number, curvature);
        leg.start.north += 3.0;
        leg
    };
    let legs: Vec<Leg<f32>> = (0..legs).map(leg).collect();
    let mission = Legs {
        origin: Position::new(0, 0),
        legs: &legs,
        fence: &[],
        obstacles: &[],
        end: End::Stop,
    };
    let words = firmware::mission::words(&mission).unwrap();
    words.flat_map(u32::to_le_bytes).collect()
}

/// Lets a program on the bus ask the vehicle, and says when it told what.
fn ask<R>(
    bus: &mut OnTwin,
    act: impl FnOnce(&mut Client<'_>) -> Result<R, Error>,
) -> (Result<R, Error>, Vec<Told>) {
    let mut told = Vec::new();
    let mut tell = |one| told.push(one);
    let mut client = Client::new(&uagv().0, bus, &mut tell).unwrap();
    let done = act(&mut client);
    (done, told)
}

/// The number of the mission that counts, and how many legs it has.
fn kept(bus: &mut OnTwin) -> (u8, u16) {
    let asked = ask(bus, |client| {
        let answer = client.request(Request::State)?;
        Ok((
            answer.number,
            client.state().map_or(0, |state| state.legs.1),
        ))
    });
    asked.0.unwrap()
}

fn wait(bus: &mut OnTwin, seconds: f64) {
    let until = bus.now() + Duration::from_secs_f64(seconds);
    wait_until(bus, until);
}

fn wait_until(bus: &mut OnTwin, until: Duration) {
    while bus.receive(until).unwrap().is_some() {}
}

/// Speed of the vehicle, m/s, and its place, m north.
fn motion(bus: &OnTwin) -> (f64, f64) {
    let last = bus.twin().world().states().last().unwrap();
    (last.speed, last.north)
}

/// Why a request was refused.
fn refusal<R: std::fmt::Debug>(done: Result<R, Error>) -> Option<Reason> {
    match done {
        Err(Error::Refused(refusal)) => refusal.reason,
        other => panic!("{other:?}"),
    }
}

/// Uploaded at rest, it survives a reset, is driven by the next run, and can be paused there.
#[test]
fn a_mission_is_uploaded_kept_driven_and_paused() {
    let mut bus = bus(
        "[[reset]]\nat = \"16 s\"\nnode = \"controller\"\nuntil = \"16.1 s\"\n\
         [[press]]\nat = \"30 s\"\nbutton = \"C\"\n[[press]]\nat = \"31 s\"\nbutton = \"C\"\n",
    );
    let (number, told) = ask(&mut bus, |client| client.upload(&record(4, 0.0)));
    assert_eq!(number.unwrap(), 1);
    assert!(
        told.contains(&Told::Writes) && !told.contains(&Told::Again),
        "{told:?}"
    );
    assert!(bus.now() < Duration::from_secs(16), "{:?}", bus.now());
    wait_until(&mut bus, Duration::from_secs(20));
    assert_eq!(kept(&mut bus), (1, 4));
    // No run goes: nothing on the bus moves the vehicle.
    for request in [Request::Resume, Request::Pause] {
        assert_eq!(
            refusal(ask(&mut bus, |client| client.request(request)).0),
            Some(Reason::NoRun)
        );
    }
    assert!(
        ask(&mut bus, |client| client.request(Request::Start))
            .0
            .is_ok()
    );
    wait_until(&mut bus, Duration::from_secs(40));
    let (speed, north) = motion(&bus);
    assert!(speed > 0.9 && north > 5.0, "{speed} m/s, {north} m");
    for request in [Request::Start, Request::Drop] {
        assert_eq!(
            refusal(ask(&mut bus, |client| client.request(request)).0),
            Some(Reason::Running)
        );
    }
    let refused = ask(&mut bus, |client| client.upload(&record(2, 0.0))).0;
    assert_eq!(refusal(refused), Some(Reason::Running));
    assert!(
        ask(&mut bus, |client| client.request(Request::Pause))
            .0
            .is_ok()
    );
    wait(&mut bus, 6.0);
    let (speed, stopped) = motion(&bus);
    assert!(
        speed.abs() < 0.01 && stopped < 25.0,
        "{speed} m/s, {stopped} m"
    );
    wait(&mut bus, 6.0);
    assert!((motion(&bus).1 - stopped).abs() < 0.01);
    assert!(
        ask(&mut bus, |client| client.request(Request::Resume))
            .0
            .is_ok()
    );
    wait(&mut bus, 45.0);
    let (speed, north) = motion(&bus);
    assert!(
        speed.abs() < 0.01 && (north - 43.0).abs() < 0.5,
        "{speed} m/s, {north} m"
    );
    assert_eq!(kept(&mut bus), (1, 4));
}

/// One that the vehicle cannot drive leaves the one before.
#[test]
fn a_mission_that_cannot_be_driven_is_refused_and_a_dropped_one_is_gone() {
    let mut bus = bus("");
    assert_eq!(
        ask(&mut bus, |client| client.upload(&record(3, 0.0)))
            .0
            .unwrap(),
        1
    );
    let (refused, told) = ask(&mut bus, |client| client.upload(&record(5, 0.9)));
    assert_eq!(refusal(refused), Some(Reason::Curvature));
    assert!(!told.contains(&Told::Writes));
    let checked = ask(&mut bus, |client| client.check(&record(5, 0.0)));
    assert!(checked.0.is_ok() && !checked.1.contains(&Told::Writes));
    let mut damaged = record(5, 0.0);
    damaged[30] ^= 1;
    let refused = ask(&mut bus, |client| client.upload(&damaged)).0;
    assert_eq!(refusal(refused), Some(Reason::Format));
    let long = ask(&mut bus, |client| client.upload(&record(800, 0.0))).0;
    assert_eq!(refusal(long), Some(Reason::TooLong));
    assert_eq!(kept(&mut bus), (1, 3));
    assert_eq!(
        ask(&mut bus, |client| client.upload(&record(6, 0.0)))
            .0
            .unwrap(),
        2
    );
    assert_eq!(kept(&mut bus), (2, 6));
    ask(&mut bus, |client| client.forget()).0.unwrap();
    // The line has no number.
    assert_eq!(kept(&mut bus), (0, 1));
    let refused = ask(&mut bus, |client| client.request(Request::Drop)).0;
    assert!(matches!(refusal(refused), Some(Reason::NoMission)));
}

/// A reset in the middle of an upload, and one while the flash is erased, change nothing.
#[test]
fn a_reset_in_the_middle_changes_nothing() {
    let upload = |events: &str| {
        let mut bus = bus(events);
        assert_eq!(
            ask(&mut bus, |client| client.upload(&record(3, 0.0)))
                .0
                .unwrap(),
            1
        );
        let begin = bus.now();
        let done = ask(&mut bus, |client| client.upload(&record(60, 0.0)));
        (bus, begin, done)
    };
    let (mut whole, begin, (number, _)) = upload("");
    assert_eq!(number.unwrap(), 2);
    assert_eq!(kept(&mut whole), (2, 60));
    let reset = |at: Duration, lasts: u64| {
        let until = at + Duration::from_millis(lasts);
        format!(
            "[[reset]]\nnode = \"controller\"\nat = \"{} ms\"\nuntil = \"{} ms\"\n",
            at.as_millis(),
            until.as_millis()
        )
    };
    // While frames come: the node is away for so long that the program gives up.
    let (mut bus, _, (done, told)) = upload(&reset(begin + Duration::from_secs(2), 60_000));
    assert!(
        matches!(done, Err(Error::Silent(_) | Error::NoAnswer)),
        "{done:?}"
    );
    assert!(
        told.iter()
            .any(|told| matches!(told, Told::Sends(sent, all) if sent < all))
    );
    wait_until(&mut bus, begin + Duration::from_secs(65));
    assert_eq!(kept(&mut bus), (1, 3));
    // While the flash is erased: 2 s before the node was back.
    let writes = whole_writes(&whole) - Duration::from_millis(1500);
    let (mut bus, _, (done, _)) = upload(&reset(writes, 50));
    assert!(matches!(done, Err(Error::NotKept)), "{done:?}");
    assert_eq!(kept(&mut bus), (1, 3));
}

/// When the controller started last.
fn whole_writes(bus: &OnTwin) -> Duration {
    let twin = bus.twin();
    let controller = twin
        .nodes()
        .find(|node| twin.name(*node) == "controller")
        .unwrap();
    let (at, _) = twin.node(controller).resets().last().unwrap();
    Duration::from_nanos(at.as_ticks() / 1000)
}

/// Loggers name what the firmware means.
#[test]
fn the_network_file_names_requests_and_reasons_as_the_firmware_does() {
    let tables = &uagv().0.network().value_tables;
    let named = |table: &str, raw: u8| -> Option<&str> {
        let values = &tables.iter().find(|one| one.name == table)?.values;
        let value = values
            .iter()
            .find(|value| i128::from(value.raw) == i128::from(raw))?;
        Some(&value.name)
    };
    for reason in Reason::ALL {
        let name = format!("{reason:?}");
        assert_eq!(named("MissionReason", reason.code()), Some(name.as_str()));
    }
    for request in Request::ALL {
        let name = format!("{request:?}");
        assert_eq!(named("MissionSubject", request.code()), Some(name.as_str()));
    }
    for outcome in [Outcome::Done, Outcome::Checking, Outcome::Refused] {
        let name = format!("{outcome:?}");
        assert_eq!(named("MissionOutcome", outcome.code()), Some(name.as_str()));
    }
}

//! The release images of the row follower drive the virtual robot between rows.

use std::sync::OnceLock;

use campaign::{Sequence, Trouble, agreement::Agreement, traffic::Traffic};
use furrow_tests::time::system_time;
use twin::{Images, Options, Outcome, Twin};
use vehicle_model::{Overrides, Protocol, Vehicle};
use world::report::{RoverFigures, RoverRun};
use world::rover::Side;
use world::time::{at, from_seconds, seconds, span_seconds};
use world::{Scenario, SimTime};

/// The vehicle with its images.
type Robot = (Vehicle, Images);

/// The robot of the manifest.
fn vehicle() -> &'static Robot {
    static VEHICLE: OnceLock<Robot> = OnceLock::new();
    build(&VEHICLE, &Overrides::default())
}

/// The same on an event-triggered bus.
fn event_triggered() -> &'static Robot {
    static VEHICLE: OnceLock<Robot> = OnceLock::new();
    build(&VEHICLE, &Overrides::default().on(Protocol::EventTriggered))
}

fn build(place: &'static OnceLock<Robot>, overrides: &Overrides) -> &'static Robot {
    place.get_or_init(|| {
        let build = || {
            let workspace = xtask::Workspace::find()?;
            let vehicle = xtask::vehicle::with(&workspace, "row-follower", overrides)?;
            let nodes: Vec<_> = vehicle.nodes().collect();
            let images = xtask::build::images(&workspace, &vehicle, &nodes)?;
            Ok((vehicle, xtask::build::read(&images)?))
        };
        build().unwrap_or_else(|failure: xtask::Failure| panic!("{failure}"))
    })
}

/// The robot is let go after half a second between two rows of poles.
fn drive(more: &str, length: f64) -> Outcome {
    drive_on("", more, length)
}

/// The same with these `nodes`.
fn drive_on(nodes: &str, more: &str, length: f64) -> Outcome {
    run(vehicle(), nodes, more, length)
}

fn run((vehicle, images): &Robot, nodes: &str, more: &str, length: f64) -> Outcome {
    let text = format!(
        "{nodes}row.start.station = \"30 cm\"\n\
         [[row.section]]\nkind = \"poles\"\nlength = \"20 m\"\n\
         [[press]]\nat = \"500 ms\"\nbutton = \"run\"\n{more}"
    );
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", &text).unwrap();
    let options = Options {
        duration: Some(from_seconds(length)),
        ..Options::default()
    };
    twin::run(vehicle, &scenario, images, &options, |_| {}).unwrap()
}

/// What a fault of the distance sensors from 3 s on does: the way driven until 14 s, m, whether the
/// robot stands then, and whether it has touched something.
fn after_fault(side: &str, fault: &str) -> (f64, bool, bool) {
    let table =
        format!("[[distance_fault]]\nside = \"{side}\"\nfault = \"{fault}\"\nat = \"3 s\"\n");
    let outcome = drive(&table, 14.0);
    let drive = outcome.world.drive().unwrap();
    let samples = drive.samples();
    let first = samples.iter().find(|sample| seconds(sample.at) >= 3.0);
    let way = samples.last().unwrap().station - first.unwrap().station;
    let stands = drive.rests().last().is_some_and(|(_, rest)| *rest);
    println!(
        "{side} {fault}: {way} m, stands: {stands}, contact: {:?}",
        drive.contact()
    );
    (way, stands, drive.contact().is_some())
}

/// The settings of the manifest: 0.6 m of readings that cannot be make a fault, and 2 m without a
/// stalk, 1 m more than the longest gap, make a lost row. A reading that does not change may count as
/// a wall before, after 0.43 m. The robot coasts for 0.1 m.
const FAULT_WAY: f64 = 0.6 + 0.2;
const LOST_WAY: f64 = 0.43 + 2.0 + 0.2;

#[test]
fn without_both_sensors_it_stands_after_a_bounded_way() {
    // As with a lost supply of both.
    let (way, stands, touched) = after_fault("both", "open");
    assert!(way < FAULT_WAY && stands && !touched, "{way} m");
    // Possible readings look like a gap.
    let (way, stands, _) = after_fault("both", "frozen");
    assert!(way < LOST_WAY && stands, "{way} m");
}

#[test]
fn without_one_sensor_it_drives_on_by_the_other_one() {
    let (way, stands, touched) = after_fault("left", "open");
    assert!(way > 2.5 && !stands && !touched, "{way} m");
}

#[test]
#[ignore = "slow: the rest of the faults"]
fn every_fault_of_its_sensors_ends_as_the_bounds_say() {
    for fault in ["shorted-to-ground", "shorted-to-supply", "frozen", "blind"] {
        for side in ["left", "right"] {
            let (way, stands, touched) = after_fault(side, fault);
            assert!(way > 2.5 && !stands && !touched, "{side} {fault}: {way} m");
        }
        let (way, stands, _) = after_fault("both", fault);
        assert!(way < LOST_WAY && stands, "both {fault}: {way} m");
    }
}

/// An RC oscillator makes a neutral pulse 5 % too long or too short, an effort of 15 %, until the node
/// has trimmed it by the references.
#[test]
fn on_their_rc_oscillators_the_motors_rest_until_a_command() {
    for internal in ["40000 ppm", "-40000 ppm"] {
        let clock = format!("nodes.motors = {{ external = false, internal = \"{internal}\" }}\n");
        let outcome = drive_on(&clock, "", 4.0);
        let first = driven_at(&outcome, 0.0);
        assert!(
            first.is_some_and(|first| first > 0.5),
            "{internal}: {first:?}"
        );
    }
}

/// The largest error of the neutral pulses of a robot that stands still on these `nodes` until `end` s, us;
/// `None` if there are no pulses.
fn neutral_error(nodes: &str, more: &str, end: f64) -> Option<f64> {
    let (vehicle, images) = vehicle();
    let text = format!("{nodes}[[row.section]]\nkind = \"poles\"\nlength = \"2 m\"\n{more}");
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", &text).unwrap();
    let mut twin = Twin::new(vehicle, &scenario, 1, images).unwrap();
    let mut largest = None;
    // No two pulses begin within 3 ms.
    while seconds(twin.now()) < end {
        twin.run_until(twin.now() + from_seconds(3e-3)).unwrap();
        let drive = twin.world().drive().unwrap();
        for driver in [Side::Left, Side::Right].map(|side| drive.driver(side)) {
            if let Some(width) = driver.width() {
                let error = (width / (1.0 + driver.clock_error()) * 1e6 - 1500.0).abs();
                largest = Some(error.max(largest.unwrap_or(0.0)));
            }
        }
    }
    largest
}

/// A motor driver whose own clock is off by 1 % takes a neutral pulse that is 6 us too long for an
/// effort. An RC oscillator is trimmed to 0.35 %, which makes 5 us, and drifts from there.
#[test]
fn on_their_rc_oscillator_the_motors_have_right_neutral_pulses() {
    for (internal, drift) in [(2_000, 300), (-2_000, -300)] {
        let clock = format!("internal = \"{internal} ppm\", drift = \"{drift} ppm/s\"");
        let nodes = format!("nodes.motors = {{ external = false, {clock} }}\n");
        let error = neutral_error(&nodes, "", 2.0).expect("there are pulses");
        assert!(error < 2.0, "{internal} ppm: {error} us");
    }
}

/// The references of such a master trim another oscillator to its own error.
#[test]
fn under_a_master_without_its_crystal_an_rc_oscillator_makes_no_pulses() {
    let off = "{ external = false, internal = \"-9000 ppm\" }";
    let both = format!("nodes.sensors = {off}\nnodes.motors = {off}\n");
    assert_eq!(neutral_error(&both, "", 4.0), None);
    // The clock comes, and the master starts again with it.
    let back = "[[clock]]\nnode = \"sensors\"\nat = \"3.5 s\"\npresent = true\n";
    let error = neutral_error(&both, back, 4.5).expect("there are pulses");
    assert!(error < 2.0, "{error} us");
    // The pulses of a crystal are right under any master.
    let error = neutral_error(&format!("nodes.sensors = {off}\n"), "", 3.5);
    assert!(error.expect("there are pulses") < 0.5);
}

/// Without references the node looks for another trim, and its oscillator makes no neutral pulse. In
/// this sequence of faults the sensors' node is in reset from 1.964 s to 2.570 s.
#[test]
fn on_its_rc_oscillator_the_motors_rest_while_there_are_no_references() {
    let (vehicle, images) = vehicle();
    let sequence = Sequence::draw(vehicle, 1001);
    let options = Options {
        seed: sequence.seed,
        duration: Some(from_seconds(2.8)),
        ..Options::default()
    };
    let outcome = twin::run(vehicle, &sequence.scenario, images, &options, |_| {}).unwrap();
    let driven = driven_at(&outcome, 1.964_165 + TWO_PERIODS);
    assert_eq!(driven, None);
}

/// Forged commands come in the windows of true ones, one of them just before the last true command
/// expires. Pulses that such a frame began delayed the neutral ones by 10 ms.
#[test]
fn a_forged_command_does_not_delay_the_end_of_the_last_true_one() {
    let (vehicle, images) = vehicle();
    let attacks = Trouble::Attacks { key: true };
    let verdict = campaign::replay(vehicle, 5, images, attacks).unwrap();
    assert_eq!(verdict.violations, []);
    assert!(verdict.tally.attempts_in_command_window > 100);
}

/// References come each 5 ms, and only one in eight has a tag.
#[test]
fn with_a_key_it_follows_a_row() {
    let stop = "[[press]]\nat = \"4 s\"\nbutton = \"stop\"\n";
    let outcome = drive_on("key = true\n", stop, 5.0);
    let way = figures(&outcome).way_m;
    assert!((1.2..1.7).contains(&way), "{way} m");
}

/// Nobody else knows the time: the sensors node is the only time master.
#[test]
fn with_a_key_its_master_goes_on_with_the_time_when_it_starts_again() {
    let more = "[[reset]]\nnode = \"sensors\"\nat = \"2 s\"\nuntil = \"2.3 s\"\n";
    let outcome = drive_on("key = true\n", more, 4.0);
    let traffic = Traffic::of(&outcome);
    let references = traffic.genuine(100);
    let told: Vec<u32> = references
        .map(|frame| system_time(&frame.bytes()))
        .collect();
    assert!(told.is_sorted(), "time goes back");
    let motors = vehicle().0.find_node("motors").unwrap();
    let node = outcome.nodes.iter().find(|node| node.node == motors);
    let console = String::from_utf8_lossy(&node.unwrap().console).into_owned();
    let last: Vec<&str> = console.lines().rev().take(2).collect();
    let has = |text: &str| last.iter().any(|line| line.contains(text));
    assert!(
        has("motors cmd") && has("tag-") && !has("time?"),
        "{last:?}"
    );
}

/// When a motor is first driven after `time`, s.
fn driven_at(outcome: &Outcome, time: f64) -> Option<f64> {
    let mut samples = outcome.world.drive().unwrap().samples().iter();
    let driven = samples.find(|sample| {
        let is_driven = sample.efforts.iter().any(|effort| *effort != 0.0);
        is_driven && seconds(sample.at) > time
    })?;
    Some(seconds(driven.at))
}

/// When the motors first came to rest after `time`, seconds later, and whether they rested from then
/// on.
fn rest_after(outcome: &Outcome, time: f64) -> (f64, bool) {
    let rests = outcome.world.drive().unwrap().rests();
    let first = rests
        .iter()
        .position(|(when, rest)| *rest && seconds(*when) >= time)
        .expect("the motors rest");
    (seconds(rests[first].0) - time, first + 1 == rests.len())
}

/// The figures of a run between rows.
fn figures(outcome: &Outcome) -> RoverFigures {
    let run = RoverRun {
        drive: outcome.world.drive().unwrap(),
        distances: &[],
        latencies: &[],
    };
    RoverFigures::of(&run)
}

/// Two basic cycles, and the neutral pulse by whose end the motor drivers know.
const TWO_PERIODS: f64 = 0.010 + 0.002;

#[test]
fn it_follows_a_row_until_a_press_of_stop() {
    let outcome = drive("[[press]]\nat = \"4 s\"\nbutton = \"stop\"\n", 5.0);
    let figures = figures(&outcome);
    assert!((1.2..1.7).contains(&figures.way_m), "{figures:?}");
    assert!(figures.mean_offset_cm.unwrap() < 8.0, "{figures:?}");
    assert_eq!(figures.contacts, []);
    let (after, stays) = rest_after(&outcome, 4.0);
    assert!(after < TWO_PERIODS && stays, "{after}");

    // From the first control step on, each burst of samples leads to pulses within 2 ms.
    let begun = at(from_seconds(0.6));
    let until: SimTime = at(from_seconds(4.0));
    let driven = outcome.chain.latencies();
    let driven: Vec<_> = driven
        .filter(|one| (begun..until).contains(&one.pulse))
        .map(|one| span_seconds(one.since_sample))
        .collect();
    // Both motors, 200 times a second.
    assert!((1358..=1362).contains(&driven.len()), "{}", driven.len());
    assert!(driven.iter().all(|latency| *latency < 0.002), "{driven:?}");
}

#[test]
fn without_its_distances_it_stops_and_stays() {
    let reset = "[[reset]]\nnode = \"sensors\"\nat = \"2 s\"\nuntil = \"2.5 s\"\n";
    let outcome = drive(reset, 4.0);
    let (after, stays) = rest_after(&outcome, 2.0);
    assert!(after < TWO_PERIODS && stays, "{after}");
    // The sensors are back and sample; a press of run is still missing.
    let last = outcome.chain.samples.last().unwrap();
    assert!(seconds(*last) > 3.9);
}

#[test]
fn without_commands_it_stops() {
    let reset = "[[reset]]\nnode = \"feedback\"\nat = \"2 s\"\nuntil = \"2.5 s\"\n";
    let outcome = drive(reset, 4.0);
    let (after, stays) = rest_after(&outcome, 2.0);
    assert!(after < TWO_PERIODS && stays, "{after}");
}

/// The comparison of the nodes' times must not read a clock while a task changes it.
#[test]
fn the_nodes_agree_on_the_time_at_every_instant_of_a_cycle() {
    let (vehicle, images) = vehicle();
    let text = "[[row.section]]\nkind = \"poles\"\nlength = \"2 m\"\n";
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", text).unwrap();
    let mut twin = Twin::new(vehicle, &scenario, 1, images).unwrap();
    let mut agreement = Agreement::new(images).expect("images with debug information");
    // All nodes are known to know the time from here on, and are compared one second later.
    twin.run_until(at(from_seconds(0.5))).unwrap();
    agreement.compare(&mut twin);
    twin.run_until(at(from_seconds(1.6))).unwrap();
    let cycle = from_seconds(0.005);
    let end = twin.now() + cycle;
    while twin.now() < end {
        twin.run_until(twin.now() + from_seconds(1e-6)).unwrap();
        agreement.compare(&mut twin);
    }
    let figures = agreement.figures().expect("the nodes know the time");
    assert!(figures.instants > 4500, "{figures:?}");
    assert!(figures.largest_us <= 2.0, "{figures:?}");
}

/// As many failed attempts as keep the right distance from the bus for two periods, and the left one
/// comes as before.
#[test]
fn without_one_of_the_distances_it_stops_and_stays() {
    for (robot, failures) in [(vehicle(), 2), (event_triggered(), 12)] {
        let corrupt =
            format!("[[bus]]\nwhat = \"corrupt\"\nat = \"2 s\"\nid = 201\ncount = {failures}\n");
        let outcome = run(robot, "", &corrupt, 3.0);
        let (after, stays) = rest_after(&outcome, 2.0);
        assert!(after < 0.005 + TWO_PERIODS && stays, "{after}");
    }
}

/// Frames that win against every event message hold a status back, while the state of its node changes
/// again. The analysis counts a status, or a self-test in its place, once in the interval of the network
/// file, so they may not make up for lost time afterwards.
#[test]
fn a_status_that_waited_for_the_bus_and_the_next_one_keep_their_interval() {
    let flood = "[[bus]]\nwhat = \"frame\"\nat = \"2 s\"\nid = 0\nevery = \"240 us\"\n\
                 until = \"2.15 s\"\n";
    let traffic = Traffic::of(&drive(flood, 3.0));
    // Besides the first status and the first self-test.
    let mut changes = 0;
    for ids in [[511, 521], [512, 522], [513, 523]] {
        let events = traffic.frames.iter();
        let events = events.filter(|f| f.complete && f.node.is_some() && ids.contains(&f.id));
        let ends: Vec<f64> = events.map(|frame| seconds(frame.end)).collect();
        println!("{ids:?}: {ends:?}");
        changes += ends.len().saturating_sub(2);
        for two in ends.windows(2) {
            assert!(two[1] - two[0] >= 0.1, "{ids:?}: {two:?}");
        }
    }
    assert!(changes > 0, "the flood changes no node's state");
}

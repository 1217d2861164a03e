//! The world in a closed loop: receiver bytes in, motor bytes out, judged by the report.

mod pilot;
mod uagv;

use pilot::Pilot;
use world::SimDuration;
use world::report::{ModeChange, Run, Summary, track_svg};
use world::time::{at, from_seconds};

const START: SimDuration = SimDuration::from_ticks(2_000_000_000_000);

fn drive(name: &str, seed: u64, length: f64) -> (Summary, String, String) {
    let scenario = uagv::find(name);
    let mut pilot = Pilot::new(&scenario, seed);
    let duration = from_seconds(length);
    pilot.run(START, duration);
    let mode = |at, mode: &str, autonomous| ModeChange {
        at,
        mode: mode.to_owned(),
        autonomous,
    };
    let modes = [
        mode(at(SimDuration::from_ticks(0)), "Idle", false),
        mode(at(START), "AutonomousRun", true),
    ];
    let run = Run {
        scenario: &scenario,
        nodes: &uagv::ALL.map(|_| String::new()),
        seed,
        duration,
        states: pilot.world.states(),
        efforts: pilot.world.efforts(),
        frames: &[],
        windows: &[],
        cycle_count_byte: 0,
        basic_cycle: from_seconds(0.1),
        bit_time: from_seconds(4e-6),
        modes: &modes,
        tasks: &[],
        rover: None,
        crop: None,
        mission: None,
    };
    let summary = Summary::of(&run);
    let files = (
        world::report::states(&run).unwrap().csv(),
        track_svg(&run, &summary).unwrap(),
    );
    (summary, files.0, files.1)
}

#[test]
fn state_feedback_brings_the_vehicle_to_the_line() {
    let (summary, ..) = drive("straight-line", 1, 60.0);
    let run = &summary.autonomous_runs[0];
    assert!((run.initial_cross_track_error_cm - 100.0).abs() < 1.0);
    assert!(run.settling_seconds.unwrap() < 15.0, "{run:?}");
    assert!(run.largest_cross_track_error_cm.unwrap() < 10.0, "{run:?}");
    assert!(
        (summary.distance_m.unwrap() - 58.0).abs() < 2.0,
        "{:?}",
        summary.distance_m
    );
}

#[test]
fn it_turns_round_when_it_faces_away() {
    let (summary, ..) = drive("five-metres-off", 1, 60.0);
    let run = &summary.autonomous_runs[0];
    assert!((run.initial_cross_track_error_cm - 500.0).abs() < 1.0);
    assert!(run.settling_seconds.unwrap() < 40.0, "{run:?}");
    assert!(summary.largest_steering_angle_deg > Some(24.9));
}

#[test]
fn a_lost_fix_stops_the_motors() {
    let (summary, ..) = drive("gps-lost", 1, 45.0);
    let stop = &summary.stops[0];
    assert_eq!(
        (stop.event.as_str(), stop.at_seconds),
        ("fix lost (single)", 20.0)
    );
    // Receiver phase, latency and burst take at most 100 + 41 + 4 ms; one byte more.
    assert!(stop.motors_stopped_after_ms.unwrap() < 146.0, "{stop:?}");
}

#[test]
fn a_seed_repeats_and_another_gives_other_noise() {
    let first = drive("straight-line", 3, 8.0);
    let again = drive("straight-line", 3, 8.0);
    assert_eq!((&first.1, &first.2), (&again.1, &again.2));
    assert_eq!(first.0.json(), again.0.json());
    let other = drive("straight-line", 4, 8.0);
    assert_ne!(first.1, other.1);
}

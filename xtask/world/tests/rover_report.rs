//! The report of a rover's drive along its row.

mod boards_in_row;

use boards_in_row::{MOTORS, scenario, vehicle};
use proptest::prelude::*;
use roxmltree::Document;
use world::report::{
    DistancePair, OutputFolder, RoverFigures, RoverRun, Run, Summary, rover_svg, terminal, write,
};
use world::rover::Side;
use world::time::{at, from_seconds};
use world::{Scenario, SimDuration, SimTime, World};

fn time(seconds: f64) -> SimTime {
    at(from_seconds(seconds))
}

/// A robot with equal motors drives straight from `from` to `to` seconds, and stands before and
/// after.
fn driven(scenario: &Scenario, from: f64, to: f64, end: f64) -> World {
    let mut scenario = scenario.clone();
    if let Some(setting) = &mut scenario.row {
        setting.rover.motors = Some([[1.0; 3]; 2]);
    }
    let mut world = World::new(&vehicle(), &scenario, 1);
    for i in 0..((to - from) / 0.005).round() as u32 {
        let begin = from + 0.005 * f64::from(i);
        world.advance_to(time(begin));
        for side in [Side::Left, Side::Right] {
            let clock = world.drive().unwrap().driver(side).clock_error();
            // The driver reads 1.6 ms: an effort of 0.2.
            let width = 1.6e-3 / (1.0 + clock);
            world.servo_edge(side, time(begin), true);
            world.servo_edge(side, time(begin + width), false);
        }
    }
    world.advance_to(time(end));
    world
}

const BARRIERS: &str = "[[row.section]]\nkind = \"barriers\"\nlength = \"4 m\"\nwidth = \"1 m\"\n";

fn barriers(more: &str) -> Scenario {
    let text = format!("{BARRIERS}{more}");
    Scenario::parse(&vehicle(), "barriers", "barriers", &text).unwrap()
}

/// Pulses before the drive of [`the_figures_are_those_of_the_drive`], in it, and after it.
const LATENCIES: [(SimTime, SimDuration); 4] = [
    (
        SimTime::from_ticks(500_000_000_000),
        SimDuration::from_ticks(1),
    ),
    (
        SimTime::from_ticks(2_000_000_000_000),
        SimDuration::from_ticks(1_500_000_000),
    ),
    (
        SimTime::from_ticks(2_500_000_000_000),
        SimDuration::from_ticks(1_620_000_000),
    ),
    (
        SimTime::from_ticks(5_900_000_000_000),
        SimDuration::from_ticks(9_000_000_000),
    ),
];

fn run<'a>(scenario: &'a Scenario, world: &'a World, distances: &'a [DistancePair]) -> Run<'a> {
    Run {
        scenario,
        nodes: &[],
        seed: 1,
        duration: SimDuration::from_ticks(world.now().as_ticks()),
        states: world.states(),
        efforts: world.efforts(),
        frames: &[],
        windows: &[],
        cycle_count_byte: 0,
        basic_cycle: from_seconds(0.005),
        bit_time: from_seconds(2e-6),
        modes: &[],
        tasks: &[],
        crop: None,
        mission: None,
        rover: Some(RoverRun {
            drive: world.drive().unwrap(),
            distances,
            latencies: &LATENCIES,
        }),
    }
}

#[test]
fn the_figures_are_those_of_the_drive() {
    let scenario = barriers("[row.start]\nstation = \"-10 cm\"\nright = \"6 cm\"\n");
    let world = driven(&scenario, 1.0, 5.0, 6.0);
    let pair = |seconds, left, right| DistancePair {
        at: time(seconds),
        left,
        right,
    };
    // Before the drive, in it, and after it.
    let distances = [
        pair(0.5, 9.0, 1.0),
        pair(2.0, 0.7, 0.8),
        pair(3.0, 0.8, 0.74),
        pair(5.9, 1.0, 9.0),
    ];
    let summary = Summary::of(&run(&scenario, &world, &distances));
    let rover = summary.rover.as_ref().unwrap();
    // 6 % of the effort is lost to friction.
    let speed = 1.8 * (0.2 - 0.06) / 0.94;
    assert!(
        (rover.mean_speed_m_s.unwrap() - speed).abs() < 0.02,
        "{rover:?}"
    );
    assert!(
        (rover.largest_speed_m_s.unwrap() - speed).abs() < 1e-3,
        "{rover:?}"
    );
    // It drives straight ahead, 10 cm before its row, too, and does not steer by an angle.
    let way = summary.distance_m.unwrap();
    assert!(
        (way - rover.end_station_m - 0.1).abs() < 1e-3,
        "{way} {rover:?}"
    );
    assert_eq!(summary.largest_speed_m_s, rover.largest_speed_m_s);
    assert_eq!(summary.largest_steering_angle_deg, None);
    // The row begins 10 cm ahead of the start.
    assert!(
        (rover.end_station_m - (4.0 * speed - 0.1)).abs() < 0.04,
        "{rover:?}"
    );
    assert!(rover.from_seconds.unwrap() > 1.3 && rover.until_seconds.unwrap() > 5.0);
    assert!(rover.until_seconds.unwrap() < 5.6, "{rover:?}");
    assert!(
        (rover.way_m - rover.end_station_m).abs() < 0.01,
        "{rover:?}"
    );
    for offset in [rover.mean_offset_cm, rover.largest_offset_cm] {
        assert!((offset.unwrap() - 6.0).abs() < 0.01, "{rover:?}");
    }
    assert_eq!(rover.mean_difference_cm, Some(2.0));
    assert_eq!(rover.mean_absolute_difference_cm, Some(8.0));
    assert_eq!(
        (
            rover.least_latency_us,
            rover.mean_latency_us,
            rover.largest_latency_us
        ),
        (Some(1500.0), Some(1560.0), Some(1620.0))
    );
    assert_eq!((rover.row_length_m, rover.contacts.len()), (4.0, 0));

    let text = terminal(&summary, None);
    assert!(
        text.contains("no contact") && !text.contains("autonomous"),
        "{text}"
    );
    assert!(
        text.contains("mean offset from the middle        6.00 cm"),
        "{text}"
    );
    let half = RoverFigures::between(
        &RoverRun {
            drive: world.drive().unwrap(),
            distances: &[],
            latencies: &[],
        },
        0.5,
        0.7,
    );
    assert!((half.way_m - 0.2).abs() < 0.01, "{half:?}");
    assert_eq!(half.mean_difference_cm, None);
}

#[test]
fn after_a_contact_only_contacts_count() {
    let weed = "[[row.weed]]\nat = \"1 m\"\nright = \"8 cm\"\ndiameter = \"6 cm\"\n\
                [[row.weed]]\nat = \"2 m\"\nright = \"-8 cm\"\ndiameter = \"6 cm\"\n";
    let scenario = barriers(weed);
    let world = driven(&scenario, 0.5, 10.0, 11.0);
    let summary = Summary::of(&run(&scenario, &world, &[]));
    let rover = summary.rover.as_ref().unwrap();
    assert_eq!(rover.contacts.len(), 2, "{rover:?}");
    let sides: Vec<f64> = rover
        .contacts
        .iter()
        .map(|contact| contact.right_cm)
        .collect();
    assert_eq!(sides, [8.0, -8.0]);
    assert_eq!(rover.until_seconds, Some(rover.contacts[0].at_seconds));
    // The front edge is 22.5 cm ahead, and the weed begins 3 cm before its middle.
    assert!((rover.way_m - 0.745).abs() < 0.01, "{rover:?}");
    let text = terminal(&summary, None);
    assert!(
        text.contains("touched a weed at 0.75 m, 8 cm to the right of the middle"),
        "{text}"
    );
    assert!(text.contains("8 cm to the left of the middle") && !text.contains("no contact"));
}

#[test]
fn a_rover_that_stands_has_no_figures() {
    let scenario = barriers("");
    let world = driven(&scenario, 1.0, 1.0, 2.0);
    let summary = Summary::of(&run(&scenario, &world, &[]));
    let rover = summary.rover.as_ref().unwrap();
    assert_eq!(
        (rover.mean_offset_cm, rover.from_seconds, rover.way_m),
        (None, None, 0.0)
    );
    assert!(terminal(&summary, None).contains("the rover did not move in its row"));
    assert!(summary.json().contains("\"mean_offset_cm\": null"));
}

#[test]
fn motors_without_pulses_are_stopped() {
    let text = "[[reset]]\nnode = \"drive\"\nat = \"2 s\"\n";
    let scenario = barriers(text);
    assert_eq!(scenario.reset[0].node, MOTORS);
    let world = driven(&scenario, 1.0, 2.0, 3.0);
    let nodes = ["gps", "controller", "steering", "drive"].map(String::from);
    let run = Run {
        nodes: &nodes,
        ..run(&scenario, &world, &[])
    };
    let stops = Summary::of(&run).stops;
    // The last pulse ends 3.4 ms before the reset; the drivers wait for 100 ms.
    let after = stops[0].motors_stopped_after_ms.unwrap();
    assert!((96.0..97.5).contains(&after), "{stops:?}");
    // Without an end of the pulses they do not stop.
    let world = driven(&scenario, 1.0, 3.0, 3.0);
    let run = Run {
        nodes: &nodes,
        crop: None,
        mission: None,
        rover: Some(RoverRun {
            drive: world.drive().unwrap(),
            distances: &[],
            latencies: &[],
        }),
        ..run
    };
    assert_eq!(Summary::of(&run).stops[0].motors_stopped_after_ms, None);
}

#[test]
fn the_folder_has_states_and_the_picture() {
    let scenario = scenario("[row.start]\nright = \"-3 cm\"\n");
    let world = driven(&scenario, 0.5, 3.0, 3.0);
    let run = run(&scenario, &world, &[]);
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("run");
    let mut files = OutputFolder::create(&target).unwrap();
    let names = write(
        &run,
        &Summary::of(&run),
        world::report::table(&run).as_ref(),
        &mut files,
    )
    .unwrap();
    files.finish().unwrap();
    assert_eq!(names, ["summary.json", "states.csv", "row.svg"]);
    let read = |name: &str| std::fs::read_to_string(target.join(name)).unwrap();
    let picture = read("row.svg");
    assert!(Document::parse(&picture).is_ok() && picture.contains("no contact"));
    let table = read("states.csv");
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines.len(), 302);
    let columns = lines[0].split(',').count();
    assert!(lines.iter().all(|line| line.split(',').count() == columns));
    let last: Vec<&str> = lines[301].split(',').collect();
    assert_eq!((last[0], last[4], last[7]), ("3.00", "-0.0300", "0.2000"));
    let json: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!(json["rover"]["mean_offset_cm"], 3.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn parts_of_a_row_make_the_whole(cut in 0.2..1.0_f64, right in -0.1..0.1_f64) {
        let scenario = barriers(&format!("[row.start]\nright = \"{right} m\"\n"));
        let world = driven(&scenario, 0.5, 6.0, 6.0);
        let run = RoverRun { drive: world.drive().unwrap(), distances: &[], latencies: &[] };
        let [whole, first, second] = [(0.0, 4.0), (0.0, cut), (cut, 4.0)]
            .map(|(from, to)| RoverFigures::between(&run, from, to));
        // Between two records, 1 cm apart at most, no way is counted.
        let ways = first.way_m + second.way_m;
        prop_assert!((0.0..0.01).contains(&(whole.way_m - ways + 1e-3)), "{ways}");
        for part in [&first, &second] {
            prop_assert!(part.largest_offset_cm <= whole.largest_offset_cm);
            prop_assert!(part.mean_offset_cm <= part.largest_offset_cm);
        }
    }
}

/// A picture that counts the time at a standstill tells another mean than the report.
#[test]
fn the_picture_has_the_figures_of_the_report() {
    let scenario = barriers("[row.start]\nheading = \"4 deg\"\n");
    let world = driven(&scenario, 0.5, 3.0, 6.0);
    let run = run(&scenario, &world, &[]);
    let figures = RoverFigures::of(run.rover.as_ref().unwrap());
    let (mean, largest) = figures
        .mean_offset_cm
        .zip(figures.largest_offset_cm)
        .unwrap();
    assert!(mean > 1.0 && largest > 1.5 * mean, "{figures:?}");
    let picture = rover_svg(run.rover.as_ref().unwrap(), "a", "b");
    let line = format!(
        "{:.1} m driven, offset from the middle: mean {mean:.1} cm, largest {largest:.1} cm; no contact",
        figures.way_m
    );
    assert!(picture.contains(&line), "{line}");
}

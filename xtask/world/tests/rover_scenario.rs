//! Scenarios of a vehicle with a rover: what their tables do, and which ones are refused.

mod boards_in_row;
mod uagv;

use boards_in_row::{MOTORS, POLES, REMOTE, SENSORS, refused, scenario, vehicle};
use world::distance::{Fault, metres};
use world::rover::Side;
use world::time::{at, from_seconds};
use world::{Analog, Effect, Input, Scenario, SimTime, World};

fn time(seconds: f64) -> SimTime {
    at(from_seconds(seconds))
}

#[test]
fn the_robot_is_the_manifests() {
    let setting = scenario("").row.unwrap();
    let rover = &setting.rover;
    assert_eq!(
        (rover.length, rover.width, rover.track, rover.axle_spacing),
        (0.45, 0.3, 0.25, 0.16)
    );
    assert_eq!(
        (rover.top_speed, rover.friction, rover.lag),
        (1.8, 0.06, 0.1)
    );
    assert_eq!((setting.mount.ahead, setting.mount.right), (0.26, 0.14));
    assert_eq!(setting.mount.yaw, -std::f64::consts::FRAC_PI_4);
    assert_eq!(setting.terrain, world::rover::Terrain::default());
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table of mistakes")]
fn every_mistake_has_its_sentence() {
    let more = |text: &str| format!("{POLES}{text}");
    let mistakes = [
        ("no row", String::new()),
        ("a row without sections", "[row]".into()),
        (
            "an unknown kind",
            "[[row.section]]\nkind = \"trees\"\nlength = \"9 m\"".into(),
        ),
        ("no length", "[[row.section]]\nkind = \"poles\"".into()),
        (
            "a row that the robot does not fit in",
            "[[row.section]]\nkind = \"poles\"\nlength = \"9 m\"\nwidth = \"30 cm\"".into(),
        ),
        (
            "a row out of the sensors' range",
            "[[row.section]]\nkind = \"barriers\"\nlength = \"9 m\"\nwidth = \"6 m\"".into(),
        ),
        (
            "a start in the plants",
            more("[row.start]\nright = \"40 cm\""),
        ),
        (
            "a start behind the row",
            more("[row.start]\nstation = \"21 m\""),
        ),
        (
            "a gap behind the row",
            more("[[row.gap]]\nfrom = \"19 m\"\nto = \"22 m\""),
        ),
        (
            "leaves from nowhere",
            more(
                "[[row.leaves]]\nside = \"above\"\nfrom = \"1 m\"\nto = \"2 m\"\ndensity = \"1 /m\"",
            ),
        ),
        (
            "a bend that cannot be driven",
            more("[[row.bend]]\nfrom = \"1 m\"\nto = \"2 m\"\nradius = \"50 cm\"\nturn = \"left\""),
        ),
        ("too steep", more("[terrain]\nslope = \"40 deg\"")),
        ("an unknown ground", more("[terrain]\nmud = \"deep\"")),
        (
            "too many drop-outs",
            more("[distance]\ndrop_outs = \"101 %\""),
        ),
        ("a sensor too slow", more("[distance]\nperiod = \"2 s\"")),
        (
            "a distance that is none",
            more("[distance]\nspot_near = \"4 kg\""),
        ),
        (
            "an unknown fault",
            more("[[distance_fault]]\nfault = \"stolen\"\nat = \"1 s\""),
        ),
        (
            "a sensor in the middle",
            more("[[distance_fault]]\nside = \"middle\"\nfault = \"open\"\nat = \"1 s\""),
        ),
        (
            "a fault that ends before it begins",
            more("[[distance_fault]]\nfault = \"open\"\nat = \"2 s\"\nuntil = \"1 s\""),
        ),
        (
            "two faults at once",
            more(
                "[[distance_fault]]\nfault = \"open\"\nat = \"1 s\"\n\
                 [[distance_fault]]\nside = \"left\"\nfault = \"frozen\"\nat = \"3 s\"\n",
            ),
        ),
        (
            "a button that is not there",
            more("[[press]]\nat = \"1 s\"\nbutton = \"C\""),
        ),
        (
            "barriers without room",
            "[[row.section]]\nkind = \"barriers\"\nlength = \"9 m\"\nwidth = \"33 cm\"".into(),
        ),
        (
            "a press after the end",
            more(
                "[[press]]\nat = \"1 s\"\nbutton = \"run\"\n[[press]]\nat = \"60 s\"\nbutton = \"stop\"",
            ),
        ),
        (
            "a frame after the end",
            format!(
                "duration = \"5 s\"\n{}",
                more("[[bus]]\nwhat = \"dominant\"\nat = \"6 s\"\nhold = \"1 ms\"")
            ),
        ),
        (
            "a start across the row",
            more("[row.start]\nheading = \"90 deg\""),
        ),
        ("a machine's start", more("[start]\nspeed = \"1 m/s\"")),
    ];
    let sentences: String = mistakes
        .iter()
        .map(|(what, text)| format!("{what}:\n    {}\n", refused(text)))
        .collect();
    insta::assert_snapshot!("rover_sentences", sentences);
    assert_eq!(
        sentences.lines().count(),
        2 * mistakes.len(),
        "each in one line"
    );
}

#[test]
fn the_example_of_the_description_reads() {
    let text = include_str!("../SCENARIOS.md");
    let examples = text.split("```toml\n").skip(1);
    let examples = examples.map(|rest| rest.split("```").next().unwrap());
    let example = examples.last().unwrap();
    let read = Scenario::parse(&vehicle(), "example", "SCENARIOS.md", example).unwrap();
    let setting = read.row.unwrap();
    // Where the description states a default value, the parser uses the same one.
    let default = scenario("").row.unwrap();
    let (found, expected) = (&setting.distance, &default.distance);
    assert_eq!(
        (found.exposure, found.edges, found.guard),
        (expected.exposure, expected.edges, expected.guard)
    );
    let section = &setting.row.section[0];
    assert_eq!((section.along(), section.across()), (0.03, 0.015));
    assert_eq!((setting.row.section.len(), read.press.len()), (2, 1));
    assert!(!setting.row.leaves.is_empty() && !setting.row.bend.is_empty());
}

#[test]
fn vehicles_without_a_rover_have_no_terrain() {
    // Its manifest has a guidance by rows, so it may have rows beside its line.
    let rows = Scenario::parse(&uagv::vehicle(), "t", "t", POLES).unwrap();
    assert!(rows.row.is_none() && rows.crop.is_some());
    for (text, table) in [("[terrain]", "terrain"), ("[distance]", "distance")] {
        let refused = Scenario::parse(&uagv::vehicle(), "t", "t", text).unwrap_err();
        let expected = format!("scenario t, {table}: vehicle \"uagv\" is without a rover");
        assert_eq!(refused.to_string(), expected);
    }
    let fault = "[[distance_fault]]\nfault = \"open\"\nat = \"1 s\"";
    let refused = Scenario::parse(&uagv::vehicle(), "t", "t", fault).unwrap_err();
    let expected = "is without a device \"distance-sensors\"";
    assert!(refused.to_string().ends_with(expected), "{refused}");
}

#[test]
fn a_button_of_another_vehicle_is_refused_with_those_that_there_are() {
    let press = |button: &str| format!("[[press]]\nat = \"1 s\"\nbutton = {button:?}\n");
    let (run, a) = (press("run"), press("A"));
    let refused = Scenario::parse(&uagv::vehicle(), "t", "t", &(a.clone() + &run)).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "scenario t, press[1].button: vehicle \"uagv\" has no button run, it takes A, B, C, D, J"
    );
    let refused = Scenario::parse(&vehicle(), "t", "t", &(POLES.to_owned() + &a)).unwrap_err();
    assert!(
        refused
            .to_string()
            .ends_with("has no button A, it takes run, stop"),
        "{refused}"
    );
}

#[test]
fn a_row_without_a_width_has_that_of_the_manifest() {
    let own = uagv::vehicle();
    let crop = Scenario::parse(&own, "t", "t", POLES)
        .unwrap()
        .crop
        .unwrap();
    let wanted = own.manifest().row_guidance.as_ref().unwrap().rows.width;
    assert_eq!(crop.row.section[0].width(), wanted);
    assert_ne!(wanted.get(), 0.762);
    let own = vehicle();
    let wanted = own.manifest().rover.as_ref().unwrap().rows.width;
    let of = |text: &str| {
        let scenario = Scenario::parse(&own, "t", "t", text).unwrap();
        scenario.row.unwrap().row.section[0].width()
    };
    assert_eq!(of(POLES), wanted);
    let wide = format!("{POLES}width = \"1.2 m\"\n");
    assert_eq!(of(&wide).get(), 1.2);
}

#[test]
fn stalks_without_a_diameter_are_those_of_the_manifest() {
    let own = vehicle();
    let of = |kind: &str| {
        let text = format!("[[row.section]]\nkind = {kind:?}\nlength = \"20 m\"\n");
        let scenario = Scenario::parse(&own, "t", "t", &text).unwrap();
        scenario.row.unwrap().row.section[0].diameter()
    };
    let wanted = own.manifest().rover.as_ref().unwrap().rows.stalk.get();
    assert_eq!((of("stalks"), of("poles")), (wanted, 0.042));
    assert_ne!(wanted, 0.022);
}

#[test]
fn faults_that_follow_each_other_are_no_overlap() {
    let faults = "[[distance_fault]]\nfault = \"open\"\nat = \"2 s\"\n\
                  [[distance_fault]]\nside = \"right\"\nfault = \"frozen\"\nat = \"1 s\"\nuntil = \"2 s\"\n\
                  [[distance_fault]]\nside = \"left\"\nfault = \"blind\"\nat = \"1.5 s\"\nuntil = \"1.6 s\"\n";
    let scenario = scenario(faults);
    assert_eq!(scenario.distance_fault[0].fault, Fault::Open);
    assert_eq!(scenario.distance_fault[2].until.unwrap().get(), 1.6);
    assert_eq!(Scenario::uneventful(&vehicle(), "t").distance_fault, []);
}

#[test]
fn the_world_has_the_sensors_voltages_and_their_faults() {
    let text = "[[distance_fault]]\nside = \"left\"\nfault = \"open\"\nat = \"1 s\"\nuntil = \"2 s\"\n\
                [[distance_fault]]\nside = \"left\"\nfault = \"shorted-to-supply\"\nat = \"2 s\"\nuntil = \"3 s\"\n\
                [[distance_fault]]\nside = \"right\"\nfault = \"blind\"\nat = \"2.5 s\"\n";
    let mut world = World::new(&vehicle(), &scenario(text), 3);
    let [left, right] = [Side::Left, Side::Right].map(Analog::Distance);
    assert_eq!(world.analogs(), [(SENSORS, left), (SENSORS, right)]);
    let mut read = |seconds: f64| {
        world.advance_to(time(seconds));
        let found = [left, right].map(|line| world.adc(line, time(seconds)));
        // The next instants are predicted from what is planned.
        let soon = [left, right].map(|line| world.adc(line, time(seconds + 0.02)));
        (found, soon)
    };
    let plausible = |count: u16| (0.3..3.0).contains(&metres(f64::from(count) / 4095.0 * 3.3));
    let ([left, right], _) = read(0.5);
    assert!(plausible(left) && plausible(right), "{left} {right}");
    let ([before, _], [after, _]) = read(0.99);
    assert!(plausible(before) && after < 6, "{before} {after}");
    let ([left, right], _) = read(1.0);
    assert!(left < 6 && plausible(right), "{left} {right}");
    let ([before, _], [after, _]) = read(1.99);
    assert!(before < 6 && after == 4095, "{before} {after}");
    let ([left, right], _) = read(2.0);
    assert!(left == 4095 && plausible(right), "{left} {right}");
    let ([left, right], _) = read(3.2);
    assert!(plausible(left) && right == 4095, "{left} {right}");
}

#[test]
fn the_pin_remote_toggles_its_lines() {
    let press =
        |button: &str, at: f64| format!("[[press]]\nat = \"{at} s\"\nbutton = \"{button}\"\n");
    let text = press("run", 1.0) + &press("stop", 2.0) + &press("run", 3.0);
    let mut world = World::new(&vehicle(), &scenario(&text), 1);
    assert_eq!(world.input_node(Input::PinRun), Some(REMOTE));
    assert_eq!(world.input_node(Input::RemoteA), None);
    world.advance_to(time(5.0));
    let outputs = std::iter::from_fn(|| world.poll());
    let levels: Vec<_> = outputs
        .map(|output| match output.what {
            Effect::Level { node, input, high } => (output.at, node, input, high),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(
        levels,
        [
            (time(1.0), REMOTE, Input::PinRun, true),
            (time(2.0), REMOTE, Input::PinStop, true),
            (time(3.0), REMOTE, Input::PinRun, false),
        ]
    );
}

#[test]
fn servo_pulses_move_the_robot() {
    let mut world = World::new(&vehicle(), &scenario(""), 1);
    assert_eq!(vehicle().node_of(world::Device::DriveMotors), Some(MOTORS));
    for i in 0..400 {
        let begin = 0.005 * f64::from(i);
        world.advance_to(time(begin));
        for side in [Side::Left, Side::Right] {
            world.servo_edge(side, time(begin), true);
            world.servo_edge(side, time(begin + 1.625e-3), false);
        }
    }
    world.advance_to(time(2.0));
    let drive = world.drive().unwrap();
    // The drivers' own clocks are off by up to 1 % of the 1.6 ms.
    for effort in drive.efforts() {
        assert!((effort - 0.25).abs() < 0.035 && effort != 0.25, "{effort}");
    }
    let last = drive.samples().last().unwrap();
    assert!((0.4..0.9).contains(&last.station), "{last:?}");
    assert_eq!(drive.rests().len(), 2);
    assert_eq!(
        (drive.rests()[0], drive.rests()[1].1),
        ((time(0.0), true), false)
    );
    world.advance_to(time(3.0));
    let (rested, rest) = *world.drive().unwrap().rests().last().unwrap();
    assert!(rest && rested > time(2.0) && rested < time(2.1));
}

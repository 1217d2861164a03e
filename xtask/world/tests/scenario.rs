//! Scenario files: which ones are rejected, and with which error message.

mod uagv;

use proptest::prelude::*;
use vehicle_model::{Protocol, Vehicle};
use world::time::{at, from_seconds};
use world::units::Angle;
use world::vehicle::Parameters;
use world::{Analog, Device, Scenario, World};

fn machine(scenario: &Scenario) -> &Parameters {
    scenario.vehicle.as_ref().unwrap()
}

fn receiver(scenario: &Scenario) -> &world::receiver::Parameters {
    scenario.receiver.as_ref().unwrap()
}

fn sentence(text: &str) -> String {
    Scenario::parse(&uagv::vehicle(), "field", "field.toml", text)
        .unwrap_err()
        .to_string()
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table of mistakes")]
fn every_mistake_has_its_sentence() {
    let mistakes = [
        ("a wrong unit", "[start]\nspeed = \"1 deg\""),
        ("a negative speed", "[start]\nspeed = \"-1 m/s\""),
        (
            "a speed above the vehicle's",
            "[start]\nspeed = \"2.5 m/s\"",
        ),
        ("no unit", "[start]\n\neast = 1"),
        ("no unit, broken number", "[start]\neast = 1.5"),
        ("no blank", "duration = \"10s\""),
        ("not a number", "duration = \"ten s\""),
        ("no time at all", "duration = \"0 s\""),
        ("less than a millisecond", "duration = \"0.9 ms\""),
        ("an unknown field", "[vehicle]\nwheels = \"4\""),
        ("an unknown table", "[weather]\nrain = true"),
        ("a wrong type", "[lcd]\nacknowledges = \"yes\""),
        (
            "an unknown button",
            "[[press]]\nat = \"1 s\"\nbutton = \"E\"",
        ),
        (
            "an unknown node",
            "[[reset]]\nnode = \"motor\"\nat = \"1 s\"",
        ),
        ("an unknown fix", "[[fix]]\nat = \"1 s\"\nstate = \"rtk\""),
        (
            "an unknown state of roll and pitch",
            "[[inertial]]\nat = \"1 s\"\nstate = \"lost\"",
        ),
        ("a missing field", "[[press]]\nbutton = \"C\""),
        (
            "the second press",
            "[[press]]\nat = \"1 s\"\nbutton = \"C\"\n[[press]]\nat = \"-1 s\"\nbutton = \"C\"",
        ),
        (
            "an end before the beginning",
            "[[reset]]\nnode = \"gps\"\nat = \"5 s\"\nuntil = \"4 s\"",
        ),
        (
            "a bounce longer than the press",
            "[[press]]\nat = \"1 s\"\nbutton = \"C\"\nhold = \"1 ms\"",
        ),
        ("too steep", "[ground]\nslope = \"45 deg\""),
        ("a roll too wrong", "[receiver]\nroll_error = \"-11 deg\""),
        (
            "an identifier too large",
            "[[bus]]\nwhat = \"frame\"\nat = \"1 s\"\nid = 2048",
        ),
        (
            "too many bytes",
            "[[bus]]\nwhat = \"frame\"\nat = \"1 s\"\nid = 1\ndata = [0,0,0,0,0,0,0,0,0]",
        ),
        (
            "a byte too large",
            "[[bus]]\nwhat = \"frame\"\nat = \"1 s\"\nid = 1\ndata = [256]",
        ),
        (
            "an unknown bus event",
            "[[bus]]\nwhat = \"noise\"\nat = \"1 s\"",
        ),
        (
            "a babbler without an end",
            "[[babble]]\nnode = \"drive\"\nat = \"1 s\"",
        ),
        (
            "a babbler for too long",
            "[[babble]]\nnode = \"drive\"\nat = \"1 s\"\nuntil = \"12 s\"",
        ),
        (
            "a babbler that no node is",
            "[[babble]]\nnode = \"radio\"\nat = \"1 s\"\nuntil = \"2 s\"",
        ),
        (
            "a babbler with too large an identifier",
            "[[babble]]\nnode = \"drive\"\nat = \"1 s\"\nuntil = \"2 s\"\nid = 2048",
        ),
        ("a crystal too bad", "[nodes.gps]\ncrystal = \"150 ppm\""),
        (
            "a hidden steering angle",
            "[vehicle]\npot_slope = \"0 counts/deg\"",
        ),
        (
            "one waypoint",
            "[line]\nfrom = { north = \"1 m\", east = \"1 m\" }\nto = { north = \"1 m\", east = \"1 m\" }",
        ),
        (
            "half a line",
            "[line]\nfrom = { north = \"1 m\", east = \"1 m\" }",
        ),
        ("a value without a key", "set = [\"thesis\"]"),
        ("an empty value", "set = [\"\"]"),
        (
            "a key twice",
            "set = [\"machine.cruise=1\", \"machine.cruise=2\"]",
        ),
        ("not TOML", "[start\neast = \"1 m\""),
        ("twice", "duration = \"1 s\"\nduration = \"1 s\""),
    ];
    let sentences: String = mistakes
        .iter()
        .map(|(what, text)| format!("{what}:\n    {}\n", sentence(text)))
        .collect();
    insta::assert_snapshot!("sentences", sentences);
    assert!(sentences.lines().all(|line| !line.ends_with('.')));
    assert_eq!(
        sentences.lines().count(),
        2 * mistakes.len(),
        "each in one line"
    );
}

/// A scenario with a dip from 21 s to 21.1 s and another one.
fn two_dips(node: &str, at: &str, until: &str) -> Result<Scenario, String> {
    let dip = |node: &str, at: &str, until: &str| {
        format!("[[brownout]]\nnode = {node:?}\nat = {at:?}\nuntil = {until:?}\n")
    };
    let text = dip("gps", "21 s", "21.1 s") + &dip(node, at, until);
    let scenario = Scenario::parse(&uagv::vehicle(), "field", "field.toml", &text);
    scenario.map_err(|error| error.to_string())
}

#[test]
fn dips_of_one_supply_that_overlap_are_refused() {
    for (at, until) in [
        ("21.05 s", "21.2 s"),
        ("20.9 s", "21.05 s"),
        ("20.9 s", "21.2 s"),
        ("21 s", "21.1 s"),
        // The supply has not risen yet.
        ("21.1005 s", "21.2 s"),
        ("20.9 s", "20.9995 s"),
    ] {
        assert_eq!(
            two_dips("gps", at, until).unwrap_err(),
            "scenario field.toml, brownout[1] and brownout[0] of one node overlap: a dip begins 1 ms \
             after the end of the one before, or later",
            "{at} to {until}"
        );
    }
    for (node, at, until) in [
        ("gps", "21.101 s", "21.2 s"),
        ("gps", "20.9 s", "20.999 s"),
        ("drive", "21.05 s", "21.2 s"),
    ] {
        assert!(two_dips(node, at, until).is_ok(), "{node}: {at} to {until}");
    }
}

#[test]
fn names_and_files_that_are_not_there() {
    let sentence = |name: &str| {
        Scenario::find(&uagv::vehicle(), name)
            .unwrap_err()
            .to_string()
    };
    assert!(
        sentence("straight").contains("senses/side-slope, "),
        "{}",
        sentence("straight")
    );
    // The others, in folders, are many.
    let shown = |name: &str| {
        let all = sentence(name);
        let (shown, _) = all.split_once("; in folders it has ").unwrap();
        shown.to_owned()
    };
    insta::assert_snapshot!(shown("one-metre-off"), @r#"there is no scenario "one-metre-off" of vehicle "uagv": name one of thesis-7/one-metre-off, thesis-machine/one-metre-off, babbler, calibration, canopy, five-metres-off, gps-lost, master-dead, mission, straight-line or the path of a TOML file"#);
    insta::assert_snapshot!(shown("straight"), @r#"there is no scenario "straight" of vehicle "uagv": name one of babbler, calibration, canopy, five-metres-off, gps-lost, master-dead, mission, straight-line or the path of a TOML file"#);
    // It may be another vehicle's.
    let poles = sentence("poles");
    assert!(
        poles.ends_with("; --vehicle row-follower has one"),
        "{poles}"
    );
    insta::assert_snapshot!(sentence("no/such.toml"), @"scenario no/such.toml cannot be read: there is no such file");
}

#[test]
fn a_file_is_named_after_its_stem() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("headland.toml");
    std::fs::write(&path, "duration = \"2 min\"\n").unwrap();
    let scenario = Scenario::find(&uagv::vehicle(), path.to_str().unwrap()).unwrap();
    assert_eq!(
        (scenario.name.as_str(), scenario.duration.get()),
        ("headland", 120.0)
    );
    std::fs::write(&path, [0xFF, 0xFE]).unwrap();
    let error = Scenario::find(&uagv::vehicle(), path.to_str().unwrap())
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("cannot be read: it is not text in UTF-8"),
        "{error}"
    );
}

#[test]
fn an_empty_file_is_the_manifests_vehicle_at_rest() {
    let scenario = Scenario::parse(&uagv::vehicle(), "empty", "empty", "").unwrap();
    assert_eq!(machine(&scenario).wheelbase(), 1.10);
    assert_eq!(scenario.line.unwrap().length(), 243.0);
    assert_eq!(scenario.start.speed.get(), 0.0);
}

#[test]
fn the_loaded_vehicle_of_the_experiments_can_be_described() {
    let text = r#"
        [vehicle]
        actuator_gain = "60 %"
        steering_bias = "2 deg"
        [ground]
        slope = "3 deg"
        downhill = "90 deg"
        [receiver]
        heading_bias = "1 deg"
    "#;
    let scenario = Scenario::parse(&uagv::vehicle(), "loaded", "loaded", text).unwrap();
    assert_eq!(machine(&scenario).actuator_gain.get(), 0.6);
    assert!((scenario.ground.slope.get().to_degrees() - 3.0).abs() < 1e-12);
}

#[test]
fn the_example_of_the_description_reads() {
    let text = include_str!("../SCENARIOS.md");
    let example = text
        .split("```toml\n")
        .nth(1)
        .unwrap()
        .split("```")
        .next()
        .unwrap();
    let scenario = Scenario::parse(&uagv::vehicle(), "example", "SCENARIOS.md", example).unwrap();
    // Where the description states a default value, the parser uses the same one.
    let default = Scenario::parse(&uagv::vehicle(), "empty", "empty", "").unwrap();
    assert_eq!(machine(&scenario).drive_lag, machine(&default).drive_lag);
    assert_eq!(scenario.ground.rear_slip, default.ground.rear_slip);
    assert_eq!(receiver(&scenario).base, receiver(&default).base);
    assert_eq!(receiver(&scenario).latency, receiver(&default).latency);
    assert_eq!(
        (scenario.line, scenario.lcd.clone()),
        (default.line, default.lcd.clone())
    );
    assert_eq!((scenario.press.len(), scenario.bus.len()), (1, 3));
    assert_eq!(scenario.expect.len(), 7);
}

#[test]
fn an_expectation_that_cannot_be_judged_is_refused() {
    let of = |expect: &str| {
        let text = format!("duration = \"10 s\"\n[[expect]]\n{expect}");
        let read = Scenario::parse(&uagv::vehicle(), "any", "any", &text);
        read.map(|_| ()).map_err(|error| error.to_string())
    };
    let wrong = [
        ("what = \"luck\"", "unknown variant `luck`"),
        ("what = \"mode\"\nat = \"1 s\"", "missing field `mode`"),
        (
            "what = \"mode\"\nat = \"1 s\"\nmode = \"Flying\"",
            "expect[0].mode: Mode has no value \"Flying\": ",
        ),
        (
            "what = \"mode\"\nat = \"11 s\"\nmode = \"Idle\"",
            "expect[0]: it is judged at 11 s only, and the run ends at 10 s",
        ),
        (
            "what = \"error\"\nfrom = \"2 s\"\nuntil = \"1 s\"\nbelow = \"1 cm\"",
            "expect[0].until: 1 s is out of range, it takes above 2 s to 86400 s",
        ),
        (
            "what = \"error\"\nfrom = \"2 s\"\nbelow = \"0 cm\"",
            "expect[0].below: 0 m is out of range",
        ),
        (
            "what = \"stop\"\nafter = \"8 s\"\nwithin = \"3 s\"",
            "it is judged at 11 s only",
        ),
        (
            "what = \"frames\"\nmessage = \"Comand\"\nleast = 1",
            "expect[0].message: there is no message \"Comand\": TimeReference, ",
        ),
        (
            "what = \"frames\"\nmessage = \"Command\"",
            "expect[0]: any number of frames would do",
        ),
        (
            "what = \"frames\"\nmessage = \"Command\"\nleast = 2\nmost = 1",
            "expect[0].most: 1 is out of range",
        ),
        (
            "what = \"signal\"\nmessage = \"Command\"\nsignal = \"Speed\"\nvalue = \"1\"",
            "expect[0].signal: Command has no signal \"Speed\" with names for its values: Mode",
        ),
        (
            "what = \"signal\"\nmessage = \"Heading\"\nsignal = \"Heading\"\nvalue = \"1\"",
            "no signal of it has",
        ),
        (
            "what = \"signal\"\nmessage = \"DriveStatus\"\nsignal = \"Fault\"\nvalue = \"no\"",
            "expect[0].signal: Fault has no value \"no\": ",
        ),
        (
            "what = \"count\"\nof = \"sheep\"",
            "unknown variant `sheep`",
        ),
        ("what = \"clean-bus\"\nmost = 1", "unknown field `most`"),
    ];
    for (expect, sentence) in wrong {
        let error = of(expect).unwrap_err();
        assert!(error.contains(sentence), "{expect}: {error}");
    }
    assert_eq!(of("what = \"clean-bus\""), Ok(()));
}

#[test]
fn every_scenario_of_a_vehicle_expects_something() {
    let vehicles = uagv::vehicle();
    let vehicles = vehicles.folder().parent().unwrap();
    let mut count = 0;
    for folder in Vehicle::folders(vehicles).unwrap().into_values() {
        let vehicle = Vehicle::read(&folder).unwrap();
        // A variant may have none of its own.
        let folder = Some(folder.join("scenarios")).filter(|folder| folder.is_dir());
        let mut folders: Vec<_> = folder.into_iter().collect();
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                    continue;
                }
                let scenario = Scenario::find(&vehicle, path.to_str().unwrap()).unwrap();
                assert!(!scenario.expect.is_empty(), "{}", path.display());
                count += 1;
            }
        }
    }
    assert!(count >= 30, "{count} scenarios");
}

#[test]
fn every_scenario_of_the_folder_reads_and_says_what_it_shows() {
    let listed = Scenario::list(&uagv::vehicle());
    assert_eq!(listed.len(), 31);
    assert_eq!(listed[6].name, "mission");
    assert_eq!(listed[7].name, "straight-line");
    assert_eq!(listed[8].name, "departures/drive-dead");
    for scenario in listed {
        let found = uagv::find(&scenario.name);
        // In a folder, the file's name alone is that of the scenario.
        let name = scenario.name.rsplit('/').next().unwrap();
        assert_eq!(
            (found.name.as_str(), Ok(found.summary.clone())),
            (name, scenario.summary)
        );
        assert!(!found.summary.is_empty());
    }
    assert_eq!(uagv::find("thesis-7/loaded").name, "loaded");
}

#[test]
fn what_the_file_leaves_out_is_the_manifests() {
    let changed = uagv::changed(&[
        (
            "rear_to_antenna = \"0.255 m\"",
            "rear_to_antenna = \"0.5 m\"",
        ),
        ("antenna_right = \"0 m\"", "antenna_right = \"-0.2 m\""),
        ("full_speed = \"2 m/s\"", "full_speed = \"3 m/s\""),
        ("lag = \"300 ms\"", "lag = \"500 ms\""),
        (
            "full_byte_is_forward = true",
            "full_byte_is_forward = false",
        ),
        ("latency = \"40 ms\"", "latency = \"60 ms\""),
        ("period = \"100 ms\"", "period = \"200 ms\""),
        (
            "north = \"243 m\"\neast = \"0 m\"",
            "north = \"0 m\"\neast = \"50 m\"",
        ),
    ]);
    let text = "vehicle = { antenna_right = \"0.1 m\" }";
    let scenario = Scenario::parse(&changed, "t", "t", text).unwrap();
    let machine = machine(&scenario);
    assert_eq!(machine.rear_to_antenna.get(), 0.5);
    assert_eq!(machine.antenna_right.get(), 0.1);
    assert_eq!(machine.top_speed.get(), 3.0);
    assert_eq!(machine.drive_lag.get(), 0.5);
    assert!(machine.steering_reversed && machine.drive_reversed);
    let receiver = receiver(&scenario);
    assert_eq!((receiver.latency.get(), receiver.period.get()), (0.06, 0.2));
    let line = scenario.line.unwrap();
    assert_eq!((line.length(), line.direction().to_degrees()), (50.0, 90.0));
    assert_eq!(scenario.start.heading.get().to_degrees(), 90.0);
}

#[test]
fn the_receiver_measures_roll_and_pitch_where_the_manifest_says_so() {
    let on = uagv::changed(&[("[tilt]\nenabled = false", "[tilt]\nenabled = true")]);
    let text =
        "ground = { slope = \"8 deg\", leans = true }\nreceiver = { roll_error = \"1 deg\" }";
    for (vehicle, inertial) in [(uagv::vehicle(), false), (on, true)] {
        let scenario = Scenario::parse(&vehicle, "t", "t", text).unwrap();
        let receiver = receiver(&scenario);
        assert_eq!(receiver.inertial, inertial);
        let errors = [
            receiver.roll_error,
            receiver.pitch_error,
            receiver.tilt_noise,
        ];
        assert_eq!(errors, [1.0, 0.3, 0.2].map(Angle::degrees));
        assert!(scenario.ground.leans);
    }
    assert!(
        !Scenario::parse(&uagv::vehicle(), "t", "t", "")
            .unwrap()
            .ground
            .leans
    );
}

/// Two boards without a machine, in the UAGV's network.
fn boards() -> vehicle_model::Vehicle {
    let network = std::fs::read_to_string(uagv::vehicle().network_file()).unwrap();
    let node = |name: &str, board: &str, wiring: &str| {
        format!("[[node]]\nname = {name:?}\nboard = {board:?}\nwiring = {{ {wiring} }}\n")
    };
    let manifest = [
        "summary = \"boards\"\n".to_owned(),
        node("gps", "f446", ""),
        node("controller", "f446", ""),
        node("steering", "f303", "pot = \"knob\""),
        node("drive", "f303", "motor = \"bench-motor\""),
    ];
    vehicle_model::Vehicle::parse("boards", "boards".as_ref(), &manifest.concat(), &network)
        .unwrap()
}

#[test]
fn a_table_for_what_the_vehicle_lacks_is_refused() {
    let sentence = |text: &str| {
        let refused = Scenario::parse(&boards(), "t", "t", text).unwrap_err();
        refused.to_string()
    };
    for (text, expected) in [
        (
            "[start]\neast = \"1 m\"",
            "start: vehicle \"boards\" is without a machine",
        ),
        (
            "[vehicle]",
            "vehicle: vehicle \"boards\" is without a machine",
        ),
        ("[receiver]", "without a satellite receiver"),
        (
            "[[fix]]\nat = \"1 s\"\nstate = \"float\"",
            "fix: vehicle \"boards\" is without",
        ),
        (
            "[[inertial]]\nat = \"1 s\"\nstate = \"silent\"",
            "inertial: vehicle \"boards\" is without",
        ),
        (
            "[[press]]\nat = \"1 s\"\nbutton = \"C\"",
            "press[0].button: vehicle \"boards\" has no button C, nor another one, leave it out",
        ),
        (
            "[[knob]]\nnode = \"drive\"\nat = \"1 s\"\nposition = \"10 %\"",
            "knob[0].node: no knob is wired to \"drive\"",
        ),
        (
            "[[knob]]\nnode = \"steering\"\nat = \"1 s\"\nposition = \"110 %\"",
            "knob[0].position",
        ),
    ] {
        let told = sentence(text);
        assert!(told.contains(expected), "{told}");
    }
    let scenario = Scenario::parse(&boards(), "t", "t", "").unwrap();
    assert_eq!((scenario.line, scenario.vehicle), (None, None));
}

#[test]
fn a_key_on_a_bus_without_a_system_time_is_refused() {
    let folder = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../firmware/vehicles/two-boards"
    );
    let vehicle = |protocol| {
        let overrides = vehicle_model::Overrides::default().on(protocol);
        vehicle_model::Vehicle::read_with(folder.as_ref(), &overrides).unwrap()
    };
    let [timed, at_once] =
        ["time-triggered", "event-triggered"].map(|name| Protocol::named(name).unwrap());
    assert!(Scenario::parse(&vehicle(timed), "t", "t", "key = true").is_ok());
    let refused = Scenario::parse(&vehicle(at_once), "t", "t", "key = true").unwrap_err();
    assert!(refused.to_string().contains("key: "), "{refused}");
}

#[test]
fn boards_without_a_machine_have_a_world() {
    let text = "[[knob]]\nnode = \"steering\"\nat = \"1 s\"\nposition = \"100 %\"";
    let scenario = Scenario::parse(&boards(), "t", "t", text).unwrap();
    let mut world = World::new(&boards(), &scenario, 1);
    assert_eq!(
        world.analogs(),
        [(uagv::STEERING, Analog::Knob(uagv::STEERING))]
    );
    let second = |time: f64| at(from_seconds(time));
    let before = world.adc(Analog::Knob(uagv::STEERING), second(0.5));
    let after = world.adc(Analog::Knob(uagv::STEERING), second(1.5));
    assert!(
        before.abs_diff(2048) < 10 && after > 4085,
        "{before} {after}"
    );
    world.relay(uagv::DRIVE, true, second(0.1));
    let end = second(0.1 + 10.0 / 38_400.0);
    world.serial(uagv::DRIVE, Device::BenchMotor, 255, second(0.1), end);
    world.advance_to(second(1.0));
    assert_eq!(world.effort(uagv::DRIVE), 1.0);
    assert_eq!(world.efforts().len(), 1);
    assert!(world.states().is_empty() && world.machine().is_none());
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in "(\\PC|\n){0,200}") {
        let vehicle = uagv::vehicle();
        if let Err(error) = Scenario::parse(&vehicle, "any", "any", &text) {
            prop_assert!(!error.to_string().contains('\n'), "one sentence");
        }
    }
}

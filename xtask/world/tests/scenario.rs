//! Scenario files: what is refused, and with which sentence.

use proptest::prelude::*;
use world::Scenario;

fn sentence(text: &str) -> String {
    Scenario::parse("field", "field.toml", text)
        .unwrap_err()
        .to_string()
}

#[test]
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

#[test]
fn names_and_files_that_are_not_there() {
    let sentence = |name: &str| Scenario::find(name).unwrap_err().to_string();
    insta::assert_snapshot!(sentence("straight"), @r#"there is no scenario "straight": name one of straight-line, five-metres-off, calibration, gps-lost, master-dead or the path of a TOML file"#);
    insta::assert_snapshot!(sentence("no/such.toml"), @"scenario no/such.toml cannot be read: there is no such file");
}

#[test]
fn a_file_is_named_after_its_stem() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("headland.toml");
    std::fs::write(&path, "duration = \"2 min\"\n").unwrap();
    let scenario = Scenario::find(path.to_str().unwrap()).unwrap();
    assert_eq!(
        (scenario.name.as_str(), scenario.duration.get()),
        ("headland", 120.0)
    );
    std::fs::write(&path, [0xFF, 0xFE]).unwrap();
    let error = Scenario::find(path.to_str().unwrap())
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("cannot be read: it is not text in UTF-8"),
        "{error}"
    );
}

#[test]
fn an_empty_file_is_the_thesiss_vehicle_at_rest() {
    let scenario = Scenario::parse("empty", "empty", "").unwrap();
    assert_eq!(scenario.vehicle.wheelbase(), 1.10);
    assert_eq!(scenario.line.length(), 243.0);
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
    let scenario = Scenario::parse("loaded", "loaded", text).unwrap();
    assert_eq!(scenario.vehicle.actuator_gain.get(), 0.6);
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
    let scenario = Scenario::parse("example", "SCENARIOS.md", example).unwrap();
    // Where the description states a default it is the default.
    let default = Scenario::parse("empty", "empty", "").unwrap();
    assert_eq!(scenario.vehicle.drive_lag, default.vehicle.drive_lag);
    assert_eq!(scenario.ground.rear_slip, default.ground.rear_slip);
    assert_eq!(scenario.receiver.base, default.receiver.base);
    assert_eq!(scenario.receiver.latency, default.receiver.latency);
    assert_eq!((scenario.line, scenario.lcd), (default.line, default.lcd));
    assert_eq!((scenario.press.len(), scenario.bus.len()), (1, 3));
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in "(\\PC|\n){0,200}") {
        if let Err(error) = Scenario::parse("any", "any", &text) {
            prop_assert!(!error.to_string().contains('\n'), "one sentence");
        }
    }
}

//! The file of a plan: what is accepted, what is refused and how, and that nothing is lost on the way.

mod common;

use common::plans;
use mission::place::Local;
use mission::plan::{End, Join, Outputs, Plan, Shape};
use proptest::prelude::*;

/// The line of the UAGV's manifest as a mission.
const LINE: &str = r#"
name = "243 m line"

[origin]
latitude = "40.83 deg"
longitude = "-96.66 deg"
height = "330 m"

[[leg]]
from = [0, 0]
to = { north = "243 m", east = "0 m" }
speed = "1 m/s"
"#;

fn refused(text: &str) -> String {
    Plan::read(text, "field.toml").unwrap_err().to_string()
}

#[test]
fn a_line_is_a_mission() {
    let plan = Plan::read(LINE, "line.toml").unwrap();
    assert_eq!(plan.name, "243 m line");
    assert_eq!(plan.end, End::Stop);
    let [leg] = &plan.legs[..] else { panic!() };
    let (from, to) = leg.shape.ends();
    assert_eq!((from, to), (Local::new(0.0, 0.0), Local::new(243.0, 0.0)));
    assert_eq!((leg.speed, leg.reverse), (1.0, false));
    assert_eq!((leg.outputs, leg.join), (Outputs(0), Join::Turn));
    assert_eq!(plan.length(), 243.0);
}

#[test]
fn the_line_is_the_default_mission_of_the_uagv() {
    let vehicles = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/vehicles");
    let vehicle = |name| vehicle_model::Vehicle::find(&vehicles, name).unwrap();
    let plan = Plan::read(LINE, "line.toml").unwrap();
    let uagv = vehicle("uagv");
    let default = Plan::of_manifest("243 m line", plan.origin, uagv.manifest());
    assert_eq!(default, Some(plan.clone()));
    let boards = vehicle("two-boards");
    assert_eq!(
        Plan::of_manifest("none", plan.origin, boards.manifest()),
        None
    );
}

#[test]
fn the_example_of_the_page_is_a_mission() {
    let page = include_str!("../MISSIONS.md");
    let (_, example) = page.split_once("```toml\n").unwrap();
    let (example, _) = example.split_once("```").unwrap();
    let plan = Plan::read(example, "example").unwrap();
    assert_eq!(plan.legs.len(), 3);
    assert_eq!(plan.legs[1].outputs, Outputs(0b11));
    assert_eq!(plan.legs[2].join, Join::Continue);
    // The ranges of the page are those of the crate.
    use mission::plan::{FASTEST, GAP, LONGEST_NAME, MOST_LEGS, MOST_POINTS, SHORTEST};
    for fact in [
        format!("1 to {LONGEST_NAME} characters"),
        format!("1 to {MOST_LEGS} legs"),
        format!("2 to {MOST_POINTS} points"),
        format!("above 0 to {FASTEST} m/s"),
        format!("{SHORTEST} m or longer"),
        format!("within {} cm", GAP * 100.0),
    ] {
        assert!(page.contains(&fact), "{fact}");
    }
}

#[test]
fn places_in_degrees_are_those_in_metres() {
    let plan = Plan::read(LINE, "").unwrap();
    let there = plan.frame().geodetic(Local::new(243.0, 0.0));
    let text = LINE.replace(
        "{ north = \"243 m\", east = \"0 m\" }",
        &format!(
            "{{ latitude = \"{} deg\", longitude = \"{} deg\" }}",
            there.latitude, there.longitude
        ),
    );
    let (_, to) = Plan::read(&text, "").unwrap().legs[0].shape.ends();
    assert!(to.distance(Local::new(243.0, 0.0)) < 1e-7, "{to:?}");
}

#[test]
fn outputs_are_bits() {
    assert_eq!(Outputs::of(&[1, 8, 3]), Some(Outputs(0b1000_0101)));
    assert_eq!(Outputs::of(&[0]), None);
    assert_eq!(Outputs::of(&[9]), None);
    assert_eq!(
        Outputs(0b1000_0101).sections().collect::<Vec<_>>(),
        [1, 3, 8]
    );
}

/// A text of the line's file, what stands there instead, and how the refusal begins.
const WRONG: &[(&str, &str, &str)] = &[
    (
        "speed = \"1 m/s\"",
        "speed = \"1 kn\"",
        "mission field.toml, line 12, leg 1, speed: \"1 kn\" is not a speed: write a number, a blank and the unit m/s, cm/s, mm/s or km/h, such as \"1 m/s\"",
    ),
    (
        "speed = \"1 m/s\"",
        "speed = \"0 m/s\"",
        "mission field.toml, line 9, leg 1, speed: 0 m/s is out of range, it takes above 0 m/s to 10 m/s",
    ),
    (
        "speed = \"1 m/s\"",
        "",
        "mission field.toml, line 9, leg 1: missing field `speed`",
    ),
    (
        "speed =",
        "spede =",
        "mission field.toml, line 12, leg 1, spede: unknown field `spede`, expected one of `from`, `to`, `points`, `speed`, `reverse`, `outputs`, `join`",
    ),
    (
        "from = [0, 0]",
        "from = [0, 0, 0]",
        "mission field.toml, line 10, leg 1, from: invalid length 3, expected a place: [north, east] in metres, { north = \"1 m\", east = \"2 m\" } or { latitude = \"40.83 deg\", longitude = \"-96.66 deg\" }",
    ),
    (
        "from = [0, 0]",
        "from = [0, 20000]",
        "mission field.toml, line 9, leg 1, from, east: 20000 m is out of range, it takes -10000 to 10000 m",
    ),
    (
        "from = [0, 0]",
        "",
        "mission field.toml, line 9, leg 1, from: a leg has from and to, or points; one of the two is accepted",
    ),
    (
        "from = [0, 0]",
        "from = [243, 0]",
        "mission field.toml, line 9, leg 1, to: the leg is 0.000 m long, 0.1 m or more is accepted",
    ),
    (
        "from = [0, 0]",
        "from = { north = \"1 m\" }",
        "mission field.toml, line 10, leg 1, from: write a place: [north, east] in metres, { north = \"1 m\", east = \"2 m\" } or { latitude = \"40.83 deg\", longitude = \"-96.66 deg\" }",
    ),
    (
        "from = [0, 0]",
        "from = { latitude = \"91 deg\", longitude = \"0 deg\" }",
        "mission field.toml, line 10, leg 1, from: 91 deg, 0 deg is no place of the earth: latitudes from -90 to 90 deg and longitudes from -180 to 180 deg are accepted",
    ),
    (
        "latitude = \"40.83 deg\"",
        "latitude = \"95 deg\"",
        "mission field.toml, line 5, origin.latitude: 95 deg is out of range, it takes -89 to 89 deg",
    ),
    (
        "latitude = \"40.83 deg\"",
        "latitude = \"40.83\"",
        "mission field.toml, line 5, origin.latitude: \"40.83\" is not an angle: write a number, a blank and the unit deg, such as \"40.83 deg\"",
    ),
    (
        "name = \"243 m line\"",
        "name = \"\"",
        "mission field.toml, line 2, name: 0 characters, 1 to 64 without line breaks are accepted",
    ),
    (
        "name = \"243 m line\"",
        "name = \"a\"\nwidth = \"0 m\"",
        "mission field.toml, line 3, width: 0 m is out of range, it takes above 0 to 50 m",
    ),
    (
        "name = \"243 m line\"",
        "name = \"a\"\nend = \"park\"",
        "mission field.toml, line 3, end: unknown variant `park`, expected `stop` or `repeat`",
    ),
    (
        "name = \"243 m line\"",
        "name = \"a\"\nfence = [[0, 0], [9, 9], [9, 0], [0, 9]]",
        "mission field.toml, line 3, fence: the side from corner 1 meets the side from corner 3, a polygon without crossings is accepted",
    ),
    (
        "name = \"243 m line\"",
        "name = \"a\"\nfence = [[-1, -1], [9, -1], [9, 9], [-1, 9]]",
        "mission field.toml, line 10, leg 1, to: 243.00 m north, 0.00 m east is outside the fence, every point inside is accepted",
    ),
    (
        "[[leg]]",
        "[[obstacle]]\ncorners = [[9, 9], [8, 9], [8, 8]]\n[[obstacle]]\ncorners = [[0, 0], [1, 1]]\n[[leg]]",
        "mission field.toml, line 11, obstacle 2: 2 corners, 3 to 20000 are accepted",
    ),
    (
        "[[leg]]",
        "[[obstacle]]\ncorners = [[242, -1], [245, -1], [245, 1], [242, 1]]\n[[leg]]",
        "mission field.toml, line 11, leg 1, to: 243.00 m north, 0.00 m east is inside obstacle 1, a point outside the obstacles is accepted",
    ),
    (
        "speed = \"1 m/s\"",
        "speed = \"1 m/s\"\noutputs = [1, 9]",
        "mission field.toml, line 9, leg 1, outputs: there is no section 9, 1 to 8 are accepted",
    ),
    (
        "speed = \"1 m/s\"",
        "speed = \"1 m/s\"\n[[leg]]\npoints = [[243, 1], [250, 1]]\nspeed = \"1 m/s\"\njoin = \"continue\"",
        "mission field.toml, line 13, leg 2, join: the leg begins 1.000 m from the end of the leg before, \"continue\" accepts up to 0.01 m, \"turn\" any distance",
    ),
    (
        "[[leg]]",
        "[leg",
        "mission field.toml, line 9, is not TOML: ",
    ),
];

#[test]
fn wrong_files_are_refused_with_their_line() {
    for (what, instead, expected) in WRONG {
        assert!(LINE.contains(what), "{what}");
        let refusal = refused(&LINE.replacen(what, instead, 1));
        assert!(
            refusal.starts_with(expected),
            "{what} -> {instead}\nfound    {refusal}\nexpected {expected}"
        );
        assert!(!refusal.contains('\n'), "{refusal}");
    }
    let (head, _) = LINE.split_once("[[leg]]").unwrap();
    assert_eq!(
        refused(head),
        "mission field.toml, line 1, leg: there are 0, 1 to 10000 are accepted"
    );
}

#[test]
fn a_repeated_mission_continues_from_its_last_leg() {
    let square = r#"
name = "square"
end = "repeat"
[origin]
latitude = "51 deg"
longitude = "7 deg"
[[leg]]
points = [[0, 0], [0, 30], [30, 30], [30, 0], [0, 0]]
speed = "1 m/s"
join = "continue"
"#;
    assert!(Plan::read(square, "").is_ok());
    let open = square.replace("[30, 0], [0, 0]", "[30, 0]");
    assert!(refused(&open).contains("leg 1, join: the leg begins 30.000 m"));
    // What stops after its last leg does not come back to its first one.
    assert!(Plan::read(&open.replace("repeat", "stop"), "").is_ok());
}

proptest! {
    #[test]
    fn what_is_written_reads_back_to_the_bit(plan in plans()) {
        let text = plan.write();
        let again = Plan::read(&text, "again.toml");
        prop_assert_eq!(again.as_ref(), Ok(&plan), "{}", text);
        prop_assert_eq!(again.unwrap().write(), text);
    }

    #[test]
    fn every_cut_of_a_file_is_a_plan_or_one_sentence(plan in plans(), cut in any::<prop::sample::Index>()) {
        let text = plan.write();
        let at = cut.index(text.len());
        let text = text.get(..at).unwrap_or_default();
        if let Err(refusal) = Plan::read(text, "cut.toml") {
            let refusal = refusal.to_string();
            prop_assert!(refusal.starts_with("mission cut.toml, line "), "{}", refusal);
            prop_assert!(!refusal.contains('\n'), "{}", refusal);
        }
    }

    #[test]
    fn a_point_outside_the_fence_is_found(plan in plans(), east in 600.0_f64..9000.0) {
        let mut plan = plan;
        plan.fence = vec![
            Local::new(-9999.0, -9999.0), Local::new(9999.0, -9999.0), Local::new(9999.0, 599.0), Local::new(-9999.0, 599.0),
        ];
        let inside = plan.check();
        prop_assert!(inside.is_ok(), "{:?}", inside);
        plan.legs.truncate(1);
        plan.end = End::Stop;
        if let Shape::Line { to, .. } = &mut plan.legs[0].shape {
            to.east = east;
            prop_assert_eq!(plan.check().unwrap_err().leg, Some(0));
        }
    }
}

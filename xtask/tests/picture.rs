//! The picture in the README, drawn again and compared.

use std::{env, fs, path::Path};

use vehicle_model::manifest::Law;
use world::{
    Scenario,
    report::{Summary, track_svg},
};
use xtask::{
    Workspace,
    experiment::quick::{self, Numbers},
    vehicle,
};

/// The picture, from the root of the workspace.
const PICTURE: &str = "xtask/world/pictures/straight-line.svg";

/// The firmware's control law drives the virtual vehicle without images and bus, which takes a
/// second. Set `PICTURES=renew` to write the picture instead of comparing it.
#[test]
fn the_picture_of_the_readme_is_the_run_it_shows() {
    let workspace = Workspace::find().unwrap();
    let vehicle = vehicle::find(&workspace, vehicle::DEFAULT).unwrap();
    let scenario = Scenario::find(&vehicle, "straight-line").unwrap();
    let numbers = Numbers::of(&vehicle).unwrap();
    let mut law = numbers.law(Law::Furrow).unwrap();
    let record = quick::drive(&vehicle, &numbers, &scenario, 1, &mut *law, |_, _, _| ());
    let run = record.run();
    let drawn = track_svg(&run, &Summary::of(&run)).unwrap();
    let path = workspace.root().join(PICTURE);
    if env::var("PICTURES").is_ok_and(|value| value == "renew") {
        fs::write(path, drawn).unwrap();
        return;
    }
    let kept = fs::read_to_string(Path::new(&path)).unwrap();
    // Not `assert_eq!`, which would print both pictures.
    assert!(
        drawn == kept,
        "{PICTURE} shows another run: PICTURES=renew draws it anew"
    );
}

//! `cargo xtask calibrate` on a drive of the emulated nodes: what it finds is what the
//! simulated vehicle was made of, and what a log lacks is said in one sentence.

use std::{ffi::OsString, fs, path::Path};

use vehicle_model::Vehicle;
use xtask::{Workspace, calibrate::Calibration, vehicle};

/// Messages 200, 206 and 300 of the scenario `calibration` with the release images of the
/// default vehicle file, on a vehicle with other numbers:
///
/// ```toml
/// [vehicle]
/// dead_band_right = "7 %"
/// dead_band_left = "15 %"
/// pot_centre = "2080 counts"
/// pot_slope = "37.5 counts/deg"
/// actuator_gain = "88 %"   # of 25 deg/s
/// ```
const DRIVE: &str = include_str!("data/calibration.candump.log");

fn uagv() -> Vehicle {
    vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap()
}

fn calibrate(log: &str) -> Result<Calibration, String> {
    xtask::calibrate::calibrate(&uagv(), log)
}

fn lines(keep: impl Fn(f64, &str) -> bool) -> String {
    let time = |line: &str| line[1..18].parse::<f64>().unwrap();
    let kept = DRIVE.lines().filter(|line| keep(time(line), line));
    kept.flat_map(|line| [line, "\n"]).collect()
}

#[test]
fn the_vehicles_numbers_are_found() {
    let found = calibrate(DRIVE).unwrap();
    assert!((found.centre - 2080.0).abs() < 6.0);
    assert!((found.counts_per_degree - 37.5).abs() < 0.4);
    assert!(found.angle_residual < 0.15);
    for (side, band) in [(&found.right, 0.07), (&found.left, 0.15)] {
        assert!((side.dead_band - band).abs() < 0.01);
        assert!((side.full_rate - 22.0).abs() < 0.4);
        assert!(side.residual < 0.3);
    }
    assert!(found.circles.len() >= 4);
}

/// For a search whose time grows with the square of the log's length this test takes minutes.
#[test]
fn a_vehicle_that_stands_for_an_hour_has_driven_no_circle() {
    let standing: String = (0..36_000)
        .map(|tenth| {
            let (second, tenth) = (tenth / 10, tenth % 10);
            format!(
                "({second}.{tenth}00000) can0 0C8#EAFFFFFF36000000\n\
                 ({second}.{tenth}10000) can0 0CE#3C03\n\
                 ({second}.{tenth}20000) can0 12C#0000060000000000\n"
            )
        })
        .collect();
    let error = calibrate(&standing).unwrap_err();
    assert!(error.contains("0 circles to the right"), "{error}");
}

#[test]
fn a_log_with_the_time_of_day_gives_the_same() {
    let later: String = DRIVE
        .lines()
        .map(|line| format!("(1{}\n", &line[2..]))
        .collect();
    assert_eq!(calibrate(&later), calibrate(DRIVE));
}

#[test]
fn what_a_drive_lacks_is_said() {
    let command = |line: &str| line.contains(" 12C#").then(|| line[29..33].to_owned());
    let rate = |line: &str| {
        let bytes = command(line)?;
        let raw = u16::from_str_radix(&format!("{}{}", &bytes[2..], &bytes[..2]), 16);
        Some(raw.unwrap().cast_signed())
    };
    for (log, named) in [
        (lines(|time, _| time < 40.0), "0 circles to the right"),
        (
            lines(|_, line| rate(line).is_none_or(|rate| rate >= 0)),
            "no motion of the steering to the left",
        ),
        (
            lines(|_, line| rate(line).is_none_or(|rate| rate <= 0)),
            "no motion of the steering to the right",
        ),
        (lines(|_, line| !line.contains(" 0CE#")), "no message 206"),
        (format!("{DRIVE}(12"), "line 3"),
    ] {
        let error = calibrate(&log).unwrap_err();
        assert!(error.contains(named), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

/// Runs the command on a log of a workspace; the sentence when it is refused.
fn run(workspace: &Workspace, log: &Path, more: &[&str]) -> String {
    let words = ["xtask", "calibrate"].map(OsString::from).into_iter();
    let words = words.chain([log.into()]);
    let words = words.chain(more.iter().map(OsString::from));
    let Ok(xtask::cli::Request::Run(xtask::cli::Command::Calibrate(options))) =
        xtask::cli::parse(words)
    else {
        panic!("not read");
    };
    match xtask::calibrate::run(workspace, &options) {
        Ok(()) => String::new(),
        Err(failure) => {
            assert_eq!(failure.exit_code(), 2);
            failure.to_string()
        }
    }
}

/// A workspace with a copy of the vehicles' manifests, networks and nodes.
fn copy() -> (tempfile::TempDir, Workspace) {
    let folder = tempfile::tempdir().unwrap();
    let workspace = Workspace::at(folder.path());
    for name in ["uagv", "two-boards"] {
        let own = vehicle::find(&Workspace::find().unwrap(), name).unwrap();
        let to = workspace.vehicles().join(name);
        fs::create_dir_all(to.join("nodes")).unwrap();
        let mut files = vec![own.manifest_file(), own.network_file()];
        files.extend(own.nodes().map(|node| own.source(node)));
        for file in files {
            let inside = file.strip_prefix(own.folder()).unwrap().to_owned();
            fs::copy(file, to.join(inside)).unwrap();
        }
    }
    (folder, workspace)
}

#[test]
fn the_manifest_is_changed_in_place_and_only_when_asked() {
    let (folder, workspace) = copy();
    let log = folder.path().join("bus.log");
    fs::write(&log, DRIVE).unwrap();
    let path = workspace.vehicles().join("uagv/vehicle.toml");
    let before = fs::read_to_string(&path).unwrap();
    assert_eq!(run(&workspace, &log, &[]), "");
    assert_eq!(fs::read_to_string(&path).unwrap(), before);

    assert_eq!(run(&workspace, &log, &["--write"]), "");
    let after = fs::read_to_string(&path).unwrap();
    let changed: Vec<_> = before
        .lines()
        .zip(after.lines())
        .filter(|(before, after)| before != after)
        .collect();
    assert_eq!(before.lines().count(), after.lines().count());
    let names = [
        "centre",
        "slope",
        "dead_band",
        "full_rate",
        "dead_band",
        "full_rate",
    ];
    assert_eq!(changed.len(), names.len(), "{changed:?}");
    for ((_, after), name) in changed.iter().zip(names) {
        assert!(after.starts_with(&format!("{name} = \"")), "{after}");
    }

    let vehicle = vehicle::find(&workspace, "uagv").unwrap();
    let machine = vehicle.manifest().machine.as_ref().unwrap();
    assert!((machine.potentiometer.centre.get() - 2080.0).abs() < 6.0);
    assert!((machine.steering.right.dead_band.get() - 0.07).abs() < 0.01);
    assert!((machine.steering.left.full_rate.get().to_degrees() - 22.0).abs() < 0.4);
    let folder = fs::read_dir(path.parent().unwrap()).unwrap();
    // Manifest, network file and the folder of the nodes: no file was left beside them.
    assert_eq!(folder.count(), 3);
}

/// The images of the drive had the manifest's values before the first time.
#[test]
fn a_log_is_written_once() {
    let (folder, workspace) = copy();
    let log = folder.path().join("bus.log");
    fs::write(&log, DRIVE).unwrap();
    let path = workspace.vehicles().join("uagv/vehicle.toml");
    assert_eq!(run(&workspace, &log, &["--write"]), "");
    let after = fs::read_to_string(&path).unwrap();
    let error = run(&workspace, &log, &["--write"]);
    assert!(error.contains("would now drift"), "{error}");
    assert!(!error.contains('\n'), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), after);
    // Without --write the report says so.
    assert_eq!(run(&workspace, &log, &[]), "");
}

#[test]
fn line_ends_and_byte_order_mark_stay() {
    let (folder, workspace) = copy();
    let log = folder.path().join("bus.log");
    fs::write(&log, DRIVE).unwrap();
    let path = workspace.vehicles().join("uagv/vehicle.toml");
    let plain = fs::read_to_string(&path).unwrap();
    let before = format!("\u{feff}{}", plain.replace('\n', "\r\n"));
    fs::write(&path, &before).unwrap();
    assert_eq!(run(&workspace, &log, &["--write"]), "");
    let after = fs::read_to_string(&path).unwrap();
    let changed = before
        .split('\n')
        .zip(after.split('\n'))
        .filter(|(before, after)| before != after);
    assert_eq!(changed.count(), 6);
    assert!(after.starts_with('\u{feff}'));
}

#[test]
fn a_manifest_stays_when_there_is_nothing_to_write() {
    let (folder, workspace) = copy();
    let log = folder.path().join("bus.log");
    let path = workspace.vehicles().join("uagv/vehicle.toml");
    let before = fs::read_to_string(&path).unwrap();
    let error = run(&workspace, &log, &["--write"]);
    assert!(error.contains("bus.log: it cannot be read"), "{error}");
    fs::write(&log, lines(|time, _| time < 40.0)).unwrap();
    let error = run(&workspace, &log, &["--write"]);
    assert!(error.contains("0 circles to the right"), "{error}");
    fs::write(&log, DRIVE).unwrap();
    let error = run(&workspace, &log, &["--vehicle", "two-boards", "--write"]);
    assert!(
        error.contains("\"two-boards\" has nothing to calibrate"),
        "{error}"
    );
    assert_eq!(fs::read_to_string(&path).unwrap(), before);
}

/// A variant gets the values of its own into its manifest; that of the other vehicle stays.
#[test]
fn the_manifest_of_a_variant_is_completed() {
    let (folder, workspace) = copy();
    let log = folder.path().join("bus.log");
    fs::write(&log, DRIVE).unwrap();
    let uagv = workspace.vehicles().join("uagv/vehicle.toml");
    let variant = workspace.vehicles().join("uagv/variants/second");
    fs::create_dir_all(&variant).unwrap();
    let path = variant.join("vehicle.toml");
    let text = "summary = \"a second one\"\n\n[machine.potentiometer]\n# As measured.\ncentre = \"2040 counts\"\n";
    fs::write(&path, text).unwrap();
    let before = fs::read_to_string(&uagv).unwrap();
    let options = ["--vehicle", "second", "--write"];
    assert_eq!(run(&workspace, &log, &options), "");
    assert_eq!(fs::read_to_string(&uagv).unwrap(), before);
    let after = fs::read_to_string(&path).unwrap();
    assert!(after.contains("# As measured.\ncentre = \"20"), "{after}");
    assert!(!after.contains("2040"), "{after}");
    let machine = |name: &str| {
        let vehicle = vehicle::find(&workspace, name).unwrap();
        vehicle.manifest().machine.clone().unwrap()
    };
    let (second, first) = (machine("second"), machine("uagv"));
    assert!((second.potentiometer.centre.get() - 2080.0).abs() < 6.0);
    assert!((second.steering.left.full_rate.get().to_degrees() - 22.0).abs() < 0.4);
    assert_eq!(second.steering.travel, first.steering.travel);
    assert!((first.potentiometer.centre.get() - 2048.0).abs() < 1e-9);
}

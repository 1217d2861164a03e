//! `cargo xtask calibrate` on a drive of the emulated nodes: what it finds is what the
//! simulated vehicle was made of, and what a log lacks is said in one sentence.

use std::{ffi::OsString, fs, path::Path};

use xtask::calibrate::calibrate;

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

fn run(log: &Path, out: &Path) -> String {
    let words = ["xtask", "calibrate"].map(OsString::from).into_iter();
    let words = words.chain([log.into(), "--out".into(), out.into()]);
    let Ok(xtask::cli::Request::Run(xtask::cli::Command::Calibrate(options))) =
        xtask::cli::parse(words)
    else {
        panic!("not read");
    };
    match xtask::calibrate::run(&options) {
        Ok(()) => String::new(),
        Err(failure) => {
            assert_eq!(failure.exit_code(), 2);
            failure.to_string()
        }
    }
}

#[test]
fn the_vehicle_file_is_written_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("bus.log"), folder.path().join("v.toml"));
    let error = run(&log, &out);
    assert!(error.contains("bus.log: it cannot be read"), "{error}");
    fs::write(&log, lines(|time, _| time < 40.0)).unwrap();
    fs::write(&out, "what was there").unwrap();
    assert!(!run(&log, &out).is_empty());
    assert_eq!(fs::read_to_string(&out).unwrap(), "what was there");
    fs::write(&log, DRIVE).unwrap();
    assert_eq!(run(&log, &out), "");
    let written = fs::read_to_string(&out).unwrap();
    for part in ["[potentiometer]", "[steering.right]", "[steering.left]"] {
        assert!(written.contains(part), "{written}");
    }
    let error = run(&log, &folder.path().join("none/v.toml"));
    assert!(error.contains("it cannot be written"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

//! `cargo xtask figures`, as a user calls it: two figures that are drawn from one short run.

use std::{fs, process::Command};

use serde_json::Value;
use xtask::Workspace;

#[test]
fn figures_are_drawn_beside_the_numbers_of_the_thesis() {
    let root = Workspace::find().unwrap().root().to_owned();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("figures");
    let done = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["figures", "6.22", "6.30", "--json", "--out"])
        .arg(&out)
        .current_dir(root)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{said}");

    let printed: Value = serde_json::from_slice(&done.stdout).unwrap();
    let written = fs::read_to_string(out.join("figures.json")).unwrap();
    assert_eq!(printed, serde_json::from_str::<Value>(&written).unwrap());
    let number = |figure: usize, number: usize| -> (f64, f64) {
        let number = &printed[figure]["numbers"][number];
        let value = |key: &str| number[key].as_f64().unwrap();
        (value("thesis"), value("furrow"))
    };
    // The text of the display, the control step, and the basic cycle.
    let (thesis, furrow) = number(0, 0);
    assert_eq!(thesis, 400.0);
    assert!((1.0..400.0).contains(&furrow), "{furrow}");
    let (thesis, control) = number(0, 1);
    assert_eq!(thesis, 8.0);
    assert!((1.0..40.0).contains(&control), "{control}");
    // As they are printed.
    assert_eq!((furrow * 10.0).round() / 10.0, furrow);
    let (thesis, furrow) = number(1, 0);
    assert_eq!(thesis, 100.0);
    assert!((furrow - 100.0).abs() < 0.02, "{furrow}");

    let page = fs::read_to_string(out.join("figures.html")).unwrap();
    for text in [
        "Figure 6.22",
        "Figure 6.30",
        "display_tick",
        "straight-line --seconds 8",
    ] {
        assert!(page.contains(text), "{text}");
    }
    for text in ["Figure 7.15", "NaN", "inf", "src=", "href=\"http"] {
        assert!(!page.contains(text), "{text}");
    }
    for name in ["figure-6.22.svg", "figure-6.30.svg"] {
        let picture = fs::read_to_string(out.join(name)).unwrap();
        assert!(picture.starts_with("<svg xmlns="), "{picture}");
        assert!(picture.ends_with("</svg>"), "{name}");
        assert!(picture.matches("<rect").count() > 5, "{name}");
    }
}

//! Drives the thesis's law along its rows, and prints its measure beside the true offset.
//!
//! `cargo run -p world --example thesis_row -- [SEEDS] [FOLDER]`. With a folder it writes a picture of
//! the first seed of each row there.

use std::path::PathBuf;

use world::report::{RoverRun, rover_svg};
use world::rover::{Mount, Parameters, Terrain};
use world::row_drive::RowDrive;
use world::scenario::{Limits, Row};

#[path = "../tests/thesis_law/mod.rs"]
mod thesis_law;

use thesis_law::{FIELD, Law, Outcome, POLES, STEP, drive, leaves};

/// One line of the table.
struct Case {
    name: &'static str,
    row: Row,
    terrain: Terrain,
    law: Law,
    speed: f64,
    /// Stations that count.
    span: (f64, f64),
}

fn row(text: &str) -> Row {
    let row: Row = toml::from_str(text).expect("the rows of this example are right");
    let limits = Limits::of(&Parameters::default(), &Mount::right());
    row.check(&limits)
        .expect("the rows of this example are right");
    row
}

fn cases() -> Vec<Case> {
    let hall = Terrain::default();
    // The wider part of the barriers is 113 cm away along a beam.
    let wide = Law {
        plausible: (50.0, 140.0),
        ..Law::default()
    };
    let integral = Law {
        integral: 0.0004,
        ..wide
    };
    let poles = |name, text: &str, speed| Case {
        name,
        row: row(text),
        terrain: hall.clone(),
        law: Law::default(),
        speed,
        span: (2.0, 6.572),
    };
    let step = |name, law| Case {
        name,
        row: row(STEP),
        terrain: hall.clone(),
        law,
        speed: 0.4,
        span: (4.0, 12.0),
    };
    let field = |name, speed| Case {
        name,
        row: row(FIELD),
        terrain: Terrain::field(),
        law: Law::default(),
        speed,
        span: (0.0, 30.0),
    };
    let one_sided = leaves("left");
    vec![
        step("barriers, step 100 to 130 cm, P", wide),
        step("barriers, step 100 to 130 cm, PI", integral),
        poles("poles", POLES, 0.4),
        poles("poles", POLES, 0.8),
        poles("poles, leaves on the left", &one_sided, 0.4),
        poles("poles, leaves on the left", &one_sided, 0.8),
        poles("poles, leaves on both sides", &leaves("both"), 0.4),
        field("field", 0.4),
        field("field", 0.8),
    ]
}

fn picture(case: &Case, drive: &RowDrive) -> String {
    let run = RoverRun {
        drive,
        distances: &[],
        latencies: &[],
    };
    let about = format!("the thesis's law at {} m/s", case.speed);
    rover_svg(&run, case.name, &about)
}

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let seeds = arguments.next().and_then(|text| text.parse().ok());
    let seeds: u64 = seeds.unwrap_or(20);
    let folder = arguments.next().map(PathBuf::from);
    println!(
        "{:34} {:>5} {:>9} {:>9} {:>9} {:>9} {:>7} {:>9}",
        "", "m/s", "|mean| cm", "mean || cm", "offset cm", "largest", "way m", "contacts"
    );
    for (number, case) in cases().iter().enumerate() {
        let mut outcomes: Vec<Outcome> = Vec::new();
        let mut way = 0.0;
        for seed in 1..=seeds {
            let (run, outcome) = drive(
                &case.row,
                &case.terrain,
                &case.law,
                case.speed,
                seed,
                case.span,
            );
            way += run.samples().last().map_or(0.0, |last| last.station) - run.start();
            if seed == 1
                && let Some(folder) = &folder
            {
                std::fs::write(
                    folder.join(format!("row-{number}.svg")),
                    picture(case, &run),
                )?;
            }
            outcomes.push(outcome);
        }
        let mean = |value: fn(&Outcome) -> f64| {
            outcomes.iter().map(value).sum::<f64>() / seeds.max(1) as f64
        };
        println!(
            "{:34} {:>5} {:>9.1} {:>9.1} {:>9.1} {:>9.1} {:>7.1} {:>6}/{seeds}",
            case.name,
            case.speed,
            mean(|run| run.difference.abs()),
            mean(|run| run.magnitude),
            mean(|run| run.offset),
            mean(|run| run.largest),
            way / seeds.max(1) as f64,
            outcomes.iter().filter(|run| run.touched).count(),
        );
    }
    Ok(())
}

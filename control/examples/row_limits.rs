//! Drives simulated rows that get harder, and prints where it fails: in each cell
//! the runs that touched a stalk or did not reach the row's end, and the mean
//! offset from the middle. `cargo run -p control --example row_limits -- 20` takes 20
//! seeds for each cell.

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/common/rows.rs"]
mod rows;

use control::row::RowRobot;
use rows::{Crop, Field, Ground, Stretch, furrow_of, robot};

const LEAVES: [f64; 6] = [0.0, 1.5, 3.0, 4.5, 6.0, 8.0];
const SPEED: f64 = 0.4;

fn main() {
    let seeds = std::env::args()
        .nth(1)
        .and_then(|seeds| seeds.parse().ok())
        .unwrap_or(20);
    println!("failures of {seeds} runs, mean offset in cm; columns: leaves for a metre and face");
    print!("{:34}", "");
    for leaves in LEAVES {
        print!("{leaves:>10}");
    }
    println!();
    let stretch = |side, from, to| Stretch { side, from, to };
    for gap in [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0] {
        line(
            &format!("gap of {gap} m in both rows"),
            gap,
            seeds,
            &|crop| {
                crop.gaps = vec![stretch(0, 6.0, 6.0 + gap), stretch(0, 14.0, 14.0 + gap)];
            },
        );
    }
    for thicket in [10.0, 25.0, 50.0, 100.0] {
        line(
            &format!("{thicket} leaves/m on one side, 3.5 m"),
            1.0,
            seeds,
            &|crop| {
                crop.thicket = thicket;
                crop.leafy = vec![stretch(1, 3.0, 6.5), stretch(-1, 13.0, 16.5)];
            },
        );
    }
    for length in [6.0, 10.0] {
        line(
            &format!("25 leaves/m on one side, {length} m"),
            1.0,
            seeds,
            &|crop| {
                crop.leafy = vec![stretch(1, 3.0, 3.0 + length)];
            },
        );
    }
    for missing in [0.1, 0.2, 0.4] {
        line(
            &format!("{missing} of all plants missing"),
            1.0,
            seeds,
            &|crop| {
                crop.missing = missing;
            },
        );
    }
    for radius in [30.0, 15.0, 10.0, 5.0] {
        line(
            &format!("hard, radius of {radius} m"),
            1.0,
            seeds,
            &|crop| {
                *crop = Crop {
                    leaves: crop.leaves,
                    curvature: 1.0 / radius,
                    ..Crop::hard()
                };
            },
        );
    }
}

fn line(name: &str, gap: f64, seeds: u64, change: &dyn Fn(&mut Crop)) {
    print!("{name:34}");
    for leaves in LEAVES {
        let mut crop = Crop {
            leaves,
            ..Crop::corn()
        };
        change(&mut crop);
        let robot = RowRobot {
            gap: f64::max(gap, 1.0),
            ..robot(SPEED)
        };
        let (mut failed, mut mean) = (0, 0.0);
        for seed in 1..=seeds {
            let field = Field::new(&crop, seed);
            let run = furrow_of(&robot, &field, Ground::rough(seed), seed);
            failed += u32::from(run.touched || run.end < crop.length);
            mean += run.mean * 100.0 / seeds as f64;
        }
        print!("{:>10}", format!("{failed} {mean:.1}"));
    }
    println!();
}

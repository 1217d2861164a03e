//! Drives Furrow's row controller along field rows, and prints how far from the middle it was.
//!
//! `cargo run -p world --example furrow_row -- [FIRST SEED] [LAST SEED]`. The settings of the controller
//! were fitted on the seeds 1 to 320, 3001 to 3150, 10001 to 10300, 20001 to 20150, 30001 to 30200, 40001 to
//! 40150, 50001 to 50250 and 70001 to 70200; others tell how well it drives.

#[path = "../tests/furrow_law/mod.rs"]
mod furrow_law;

use furrow_law::{Field, drive};
use world::row_drive::Followed;

fn main() {
    let mut seeds = std::env::args().skip(1).map_while(|text| text.parse().ok());
    let first: u64 = seeds.next().unwrap_or(1001);
    let last: u64 = seeds.next().unwrap_or(first + 99);
    println!(
        "{:44} {:>5} {:>9} {:>9} {:>7} {:>9} {:>6}",
        "", "m/s", "offset cm", "largest", "way m", "failures", "v m/s"
    );
    let full = Field::FULL;
    let fields = [
        (
            "without gaps and long leaves",
            Field {
                gaps: false,
                leaves: 0.0,
                ..full
            },
        ),
        (
            "leaves on one side over 3.5 m",
            Field {
                gaps: false,
                ..full
            },
        ),
        ("and gaps of 1 m", full),
        (
            "all on a bend to the left",
            Field {
                turn: "left",
                ..full
            },
        ),
        (
            "all on a bend to the right",
            Field {
                turn: "right",
                ..full
            },
        ),
    ];
    for (name, field) in fields {
        let row = field.row();
        for speed in [0.4, 0.8] {
            let runs: Vec<Followed> = (first..=last)
                .map(|seed| drive(&row, speed, seed))
                .collect();
            let sum = |value: fn(&Followed) -> f64| runs.iter().map(value).sum::<f64>();
            println!(
                "{name:44} {speed:>5} {:>9.2} {:>9.1} {:>7.0} {:>9} {:>6.2}",
                100.0 * sum(|run| run.offset) / runs.len().max(1) as f64,
                100.0
                    * runs
                        .iter()
                        .fold(0.0, |most: f64, run| most.max(run.largest)),
                sum(|run| run.way),
                runs.iter().filter(|run| run.failed()).count(),
                sum(|run| run.way) / sum(|run| run.time),
            );
        }
    }
}

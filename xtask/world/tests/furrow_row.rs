//! Furrow's row controller on the field rows of the virtual robot.

mod furrow_law;

use furrow_law::{Field, drive};
use world::row_drive::Followed;

/// Seeds that the settings were not fitted on.
const SEEDS: std::ops::RangeInclusive<u64> = 1001..=1020;

/// Outcomes of all seeds at both speeds.
fn runs(field: &Field) -> Vec<Followed> {
    let row = field.row();
    let speeds = [0.4, 0.8].into_iter();
    let runs = speeds.flat_map(|speed| SEEDS.map(move |seed| (speed, seed)));
    runs.map(|(speed, seed)| drive(&row, speed, seed)).collect()
}

fn offset(runs: &[Followed]) -> f64 {
    runs.iter().map(|run| run.offset).sum::<f64>() / runs.len() as f64
}

fn failed(runs: &[Followed]) -> usize {
    runs.iter().filter(|run| run.failed()).count()
}

#[test]
fn leaves_on_one_side_over_3_m_are_driven_within_2_cm_of_the_middle() {
    let runs = runs(&Field {
        gaps: false,
        ..Field::FULL
    });
    assert!(offset(&runs) <= 0.02, "{}", offset(&runs));
    assert!(failed(&runs) <= 1, "{} of {}", failed(&runs), runs.len());
}

/// In a gap of both rows the robot is blind for a metre, and the ground turns it.
#[test]
fn gaps_of_1_m_are_bridged_by_nearly_all() {
    let runs = runs(&Field::FULL);
    assert!(offset(&runs) <= 0.03, "{}", offset(&runs));
    assert!(failed(&runs) <= 4, "{} of {}", failed(&runs), runs.len());
}

#[test]
fn bent_rows_are_driven_too() {
    for turn in ["left", "right"] {
        let runs = runs(&Field {
            turn,
            ..Field::FULL
        });
        assert!(offset(&runs) <= 0.033, "{turn}: {}", offset(&runs));
        assert!(failed(&runs) <= 4, "{turn}: {}", failed(&runs));
    }
}

//! The vehicle's states as a table.

use super::{Cell, Column, Run, Table, mission};
use crate::time::seconds;
use crate::vehicle::wrap;

/// One row for each recorded state, every 10 ms; `None` without a machine. Positions are the true
/// ones of the point on the centre line beside the antenna, not the receiver's measurements. With a mission, way and errors are
/// those of the rear axle against its path.
#[must_use]
pub fn states(run: &Run) -> Option<Table> {
    let line = run.scenario.line.as_ref()?;
    let direction = line.direction();
    let row = |(index, state): (usize, &crate::record::StateSample)| {
        let (along, error) = line.locate(state.north, state.east);
        let against = wrap(state.heading - direction);
        let (along, error, against) = run
            .located(index)
            .map_or((along, error, against), |located| {
                (located.along, located.right, located.heading_error)
            });
        let heading = state.heading.to_degrees().rem_euclid(360.0);
        let numbers = [
            seconds(state.at),
            state.north,
            state.east,
            heading,
            state.steering.to_degrees(),
            state.speed,
            along,
            error,
            against.to_degrees(),
            state.steering_effort,
            state.drive_effort,
        ];
        let numbers = numbers.map(Cell::Number).into_iter();
        numbers.chain([Cell::Word(state.fix.name())]).collect()
    };
    let mut table = Table {
        columns: columns(),
        rows: run.states.iter().enumerate().map(row).collect(),
    };
    for (column, cells) in run.mission.iter().flat_map(mission::columns) {
        table.columns.push(column);
        for (row, cell) in table.rows.iter_mut().zip(cells) {
            row.push(cell);
        }
    }
    Some(table)
}

fn columns() -> Vec<Column> {
    vec![
        Column::new("time_s", "s", 2, "time from power-on"),
        Column::new("north_m", "m", 4, "true northing beside the antenna"),
        Column::new("east_m", "m", 4, "true easting beside the antenna"),
        Column::new(
            "heading_deg",
            "deg",
            3,
            "true heading, clockwise from north",
        ),
        Column::new(
            "steering_angle_deg",
            "deg",
            3,
            "steering angle, positive right",
        ),
        Column::new("speed_m_s", "m/s", 4, "speed of the rear wheels"),
        Column::new(
            "along_m",
            "m",
            4,
            "way along the line, or along the path of a mission",
        ),
        Column::new(
            "cross_track_error_m",
            "m",
            4,
            "true cross-track error, positive right of the line or of the path",
        ),
        Column::new(
            "heading_error_deg",
            "deg",
            3,
            "heading against the line or the path",
        ),
        Column::new(
            "steering_effort",
            "",
            4,
            "effort of the steering motor, -1 to 1",
        ),
        Column::new("drive_effort", "", 4, "effort of the drive motor, -1 to 1"),
        Column::new("fix", "", 0, "quality of the receiver's solution"),
    ]
}

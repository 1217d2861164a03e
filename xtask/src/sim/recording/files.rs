//! The recordings as text: consoles, logs, display and motors.

use std::fmt::Write;

use twin::NodeOutcome;
use vehicle_model::Vehicle;
use world::report::{Cell, Column, Table};
use world::{ScreenChange, SimTime, time::seconds};

use super::super::Finished;
use crate::analyse::guidance::{Guidance, Position};
use crate::network::decode::Decoder;

/// A line of a console.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ConsoleLine {
    /// When its first byte ended.
    pub at: SimTime,
    /// Its text, without what ends it.
    pub text: String,
}

/// The lines that a node wrote to its console.
pub(crate) fn console_lines(node: &NodeOutcome) -> Vec<ConsoleLine> {
    lines(&node.console, &node.console_times)
}

/// The lines of a console's bytes, which ended at `times`; empty ones are left out.
fn lines(bytes: &[u8], times: &[SimTime]) -> Vec<ConsoleLine> {
    let mut lines = Vec::new();
    let mut begin = 0;
    for line in bytes.split_inclusive(|&byte| byte == b'\n') {
        let at = times.get(begin).copied();
        begin += line.len();
        let text = String::from_utf8_lossy(line);
        let text: String = text.chars().filter(|one| !one.is_control()).collect();
        if let Some(at) = at.filter(|_| !text.is_empty()) {
            lines.push(ConsoleLine { at, text });
        }
    }
    lines
}

/// Lines with their times, one a line.
fn timed<'a>(lines: impl Iterator<Item = (SimTime, &'a str)>) -> String {
    let mut text = String::new();
    for (at, line) in lines {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{:10.3} {line}", seconds(at));
    }
    text
}

/// What the display showed, one screen below the other.
fn display(screens: &[ScreenChange]) -> String {
    let mut text = String::new();
    for screen in screens {
        let _ = writeln!(text, "{:.2} s", seconds(screen.at));
        for row in screen.text.lines() {
            let _ = writeln!(text, "    {row}");
        }
    }
    text
}

/// Whether a file of that name is one of a run.
pub(crate) fn is_of_run(name: &str) -> bool {
    let text = |begin: &str| name.starts_with(begin) && name.ends_with(".txt");
    let names = [
        "display.txt",
        "motors.csv",
        "states.csv",
        "track.svg",
        "row.svg",
        "field.svg",
    ];
    names.contains(&name) || text("console-") || text("log-")
}

/// A measurement that is older than this is not shown beside the truth, s.
const STALE: f64 = 0.25;

/// The names and contents of the files; those without content are left out.
pub(crate) fn texts(finished: &Finished<'_>) -> Vec<(String, String)> {
    let mut files = Vec::new();
    for (node, recording) in finished.outcome.nodes.iter().zip(&finished.recordings) {
        let console = console_lines(node);
        let lines = console.iter().map(|line| (line.at, line.text.as_str()));
        files.push((format!("console-{}.txt", node.name), timed(lines)));
        let lines = recording
            .log
            .iter()
            .map(|line| (line.at, line.text.as_str()));
        files.push((format!("log-{}.txt", node.name), timed(lines)));
    }
    let world = &finished.outcome.world;
    files.push(("display.txt".to_owned(), display(world.screens())));
    files.push(("motors.csv".to_owned(), motors(finished)));
    files.retain(|(_, text)| !text.is_empty());
    files
}

/// The bytes that changed something at the motor drivers, and the relays in the motors' leads.
fn motors(finished: &Finished<'_>) -> String {
    let world = &finished.outcome.world;
    let name = |node| finished.node_name(node);
    let bytes = world.efforts().iter().map(|change| {
        let line = format!("byte,{},{:.4}", change.byte, change.effort);
        (change.at, name(change.node), line)
    });
    let relays = world.relays().iter().map(|change| {
        let state = if change.closed { "closed" } else { "open" };
        (change.at, name(change.node), format!("relay,{state},"))
    });
    let mut lines: Vec<_> = bytes.chain(relays).collect();
    lines.sort_by_key(|(at, ..)| *at);
    if lines.is_empty() {
        return String::new();
    }
    let mut text = "time_s,node,what,value,effort\n".to_owned();
    for (at, node, line) in lines {
        let _ = writeln!(text, "{:.6},{node},{line}", seconds(at));
    }
    text
}

/// The true states with what was measured and estimated beside them.
pub(crate) fn states(finished: &Finished<'_>) -> Option<Table> {
    let mut table = world::report::table(&finished.run())?;
    let vehicle = finished.vehicle;
    let decoder = Decoder::new(vehicle.network());
    let mut guidance = Guidance::new(vehicle, &decoder);
    // The positions of a mission are not those of a line.
    guidance.line = finished
        .scenario
        .line
        .filter(|_| finished.mission.is_none());
    for frame in finished
        .log
        .frames
        .iter()
        .filter(|frame| frame.is_message())
    {
        let known = decoder.message(frame.id);
        if known.is_some_and(|message| message.accepts(usize::from(frame.dlc))) {
            guidance.take(seconds(frame.end), frame.id, &frame.data);
        }
    }
    let measured = |value: fn(&Position) -> f64| -> Vec<(f64, f64)> {
        let positions = guidance.positions.iter();
        positions.map(|one| (one.at, value(one))).collect()
    };
    let errors = errors(&table, &guidance.positions, vehicle);
    if !guidance.positions.is_empty() {
        let columns = [
            (
                "measured_north_m",
                "northing of the antenna, as received on the bus",
                measured(|one| one.north),
            ),
            (
                "measured_east_m",
                "easting of the antenna, as received on the bus",
                measured(|one| one.east),
            ),
            (
                "measured_cross_track_error_m",
                "cross-track error beside the measured antenna, with the true heading",
                errors,
            ),
        ];
        for (name, what, values) in columns {
            table.join(Column::new(name, "m", 4, what), &values, STALE);
        }
    }
    if !guidance.estimates.is_empty() {
        let column = Column::new(
            "estimated_cross_track_error_m",
            "m",
            4,
            "the controller's estimate, as received on the bus",
        );
        table.join(column, &guidance.estimates, STALE);
    }
    Some(table)
}

/// Cross-track errors of the centre line beside measured antennas, with their times. A log of the bus has
/// no heading that is as sure as the true one, so the guidance takes the vehicle to point along the line.
fn errors(table: &Table, positions: &[Position], vehicle: &Vehicle) -> Vec<(f64, f64)> {
    let machine = vehicle.manifest().machine.as_ref();
    let right = machine.map_or(0.0, |machine| machine.antenna_right.get());
    let place = table.place("heading_error_deg");
    let heading = |at: f64| {
        let known = table.rows.partition_point(|row| Table::seconds(row) <= at);
        let row = table.rows.get(known.max(1) - 1)?;
        match row.get(place?)? {
            Cell::Number(degrees) => Some(degrees.to_radians()),
            _ => None,
        }
    };
    let error = |one: &Position| {
        let along = heading(one.at).unwrap_or(0.0).cos();
        (one.at, one.error + right * (1.0 - along))
    };
    positions.iter().map(error).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_time_of_its_first_byte() {
        let bytes = b"ab\r\n\r\nc\n\x1b[1md";
        let times: Vec<_> = (0..)
            .map(|i| SimTime::from_ticks(i * 10))
            .take(bytes.len())
            .collect();
        let lines = lines(bytes, &times);
        let seen: Vec<_> = lines
            .iter()
            .map(|line| (line.at.as_ticks(), line.text.as_str()))
            .collect();
        assert_eq!(seen, [(0, "ab"), (60, "c"), (80, "[1md")]);
    }
}

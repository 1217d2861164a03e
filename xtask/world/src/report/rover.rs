//! A rover's way along its row: figures and states.

use serde::Serialize;

use super::figures::rounded;
use super::{Cell, Column, RowPicture, Table};
use crate::row_drive::{RowDrive, RowSample, Touch};
use crate::rows::Rows;
use crate::time::{SimDuration, SimTime, seconds, span_seconds};

/// A rover that is slower than this stands, metres per second.
const STANDS: f64 = 0.01;

/// What a rover recorded in a run.
#[derive(Clone, Copy, Debug)]
pub struct RoverRun<'a> {
    /// The rover in its row.
    pub drive: &'a RowDrive,
    /// Distances to both rows that its nodes tell on the bus, filtered as in the thesis (2.2.5.3), in
    /// order of time; empty if they tell none.
    pub distances: &'a [DistancePair],
    /// Pulses of its motors: when they began, and how long after the last burst of samples of its
    /// distance sensors; in order of time.
    pub latencies: &'a [(SimTime, SimDuration)],
}

/// Distances of a rover to both rows, filtered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistancePair {
    /// When they were sent.
    pub at: SimTime,
    /// To the left row, metres along the beam.
    pub left: f64,
    /// To the right row, metres along the beam.
    pub right: f64,
}

/// How a rover drove along its row. The figures are those of the time from its first movement to its
/// last one or to its first contact, without the times at which it stood or was outside the row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RoverFigures {
    /// Length of the row along its middle.
    pub row_length_m: f64,
    /// Station at which the rover's middle was at the end of the run; the row begins at 0.
    pub end_station_m: f64,
    /// When that time began; `null` if the rover never moved within the row.
    pub from_seconds: Option<f64>,
    /// When it ended.
    pub until_seconds: Option<f64>,
    /// Way along the row in that time.
    pub way_m: f64,
    /// Mean speed.
    pub mean_speed_m_s: Option<f64>,
    /// Largest speed.
    pub largest_speed_m_s: Option<f64>,
    /// Mean distance of the rover's middle from that of the row.
    pub mean_offset_cm: Option<f64>,
    /// The largest such distance.
    pub largest_offset_cm: Option<f64>,
    /// Mean of the filtered distance to the right row minus that to the left one: the error of the thesis
    /// (2.2.2, 2.3); `null` if no message carries distances.
    pub mean_difference_cm: Option<f64>,
    /// Mean of the magnitude of that difference.
    pub mean_absolute_difference_cm: Option<f64>,
    /// Time from the begin of a burst of distance samples to the begin of the next pulses of the motors,
    /// the smallest; `null` without pulses.
    pub least_latency_us: Option<f64>,
    /// Its mean.
    pub mean_latency_us: Option<f64>,
    /// The largest.
    pub largest_latency_us: Option<f64>,
    /// Contacts with something solid, in the whole run. The rover drives on: what a plant does to it is
    /// not simulated.
    pub contacts: Vec<ContactFigures>,
}

/// A contact of a rover or a machine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContactFigures {
    /// When it began.
    pub at_seconds: f64,
    /// What was touched.
    pub with: String,
    /// Station of the rover's middle, or of the machine's rear axle.
    pub station_m: f64,
    /// How far to the right of the row's middle the touched thing stands.
    pub right_cm: f64,
}

/// Mean of some values; `None` without any.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_u32);
    for value in values {
        sum += value;
        count += 1;
    }
    (count > 0).then(|| sum / f64::from(count))
}

fn largest(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.reduce(f64::max)
}

impl RoverFigures {
    /// The figures of a run.
    #[must_use]
    pub fn of(run: &RoverRun) -> Self {
        Self::between(run, 0.0, run.drive.rows().length())
    }

    /// The same for a part of the row: only times at which the rover's middle is between two stations,
    /// metres, count.
    #[must_use]
    pub fn between(run: &RoverRun, from: f64, to: f64) -> Self {
        let drive = run.drive;
        let touched = drive.contact().map(|touch| touch.at);
        let counts = |sample: &&RowSample| {
            sample.state.speed.abs() >= STANDS
                && (from..=to).contains(&sample.station)
                && touched.is_none_or(|touched| sample.at <= touched)
        };
        let driven: Vec<&RowSample> = drive.samples().iter().filter(counts).collect();
        let ends = driven.first().zip(driven.last());
        let differences = |magnitude: fn(f64) -> f64| {
            let (first, last) = ends?;
            let pairs = run.distances.iter();
            let pairs = pairs.filter(|pair| (first.at..=last.at).contains(&pair.at));
            mean(pairs.map(|pair| magnitude(pair.right - pair.left)))
        };
        let latencies: Vec<f64> = ends.map_or_else(Vec::new, |(first, last)| {
            let pulses = run.latencies.iter();
            let pulses = pulses.filter(|(at, _)| (first.at..=last.at).contains(at));
            pulses
                .map(|(_, after)| span_seconds(*after) * 1e6)
                .collect()
        });
        let us = |value: Option<f64>| value.map(|value| rounded(value, 3));
        let latencies = || latencies.iter().copied();
        let driven = || driven.iter();
        let cm = |metres: Option<f64>| metres.map(|metres| rounded(metres * 100.0, 3));
        let figure = |value: Option<f64>| value.map(|value| rounded(value, 4));
        let when = |sample: &RowSample| rounded(seconds(sample.at), 6);
        Self {
            row_length_m: rounded(drive.rows().length(), 3),
            end_station_m: rounded(
                drive.samples().last().map_or(drive.start(), |s| s.station),
                3,
            ),
            from_seconds: ends.map(|(first, _)| when(first)),
            until_seconds: ends.map(|(_, last)| when(last)),
            way_m: ends.map_or(0.0, |(first, last)| {
                rounded(last.station - first.station, 3)
            }),
            mean_speed_m_s: figure(mean(driven().map(|s| s.state.speed))),
            largest_speed_m_s: figure(largest(driven().map(|s| s.state.speed.abs()))),
            mean_offset_cm: cm(mean(driven().map(|s| s.right.abs()))),
            largest_offset_cm: cm(largest(driven().map(|s| s.right.abs()))),
            mean_difference_cm: cm(differences(|difference| difference)),
            mean_absolute_difference_cm: cm(differences(f64::abs)),
            least_latency_us: us(latencies().reduce(f64::min)),
            mean_latency_us: us(mean(latencies())),
            largest_latency_us: us(largest(latencies())),
            contacts: contacts(drive.rows(), drive.touches()),
        }
    }

    /// Way, offsets and contact in a line.
    fn line(&self) -> String {
        let way = match self.mean_offset_cm.zip(self.largest_offset_cm) {
            Some((mean, largest)) => format!(
                "{:.1} m driven, offset from the middle: mean {mean:.1} cm, largest {largest:.1} cm",
                self.way_m
            ),
            None => "did not move in the row".into(),
        };
        format!("{way}; {}", touched(&self.contacts))
    }
}

/// Whether there was a contact, as part of a line.
pub(super) fn touched(contacts: &[ContactFigures]) -> String {
    match contacts.first() {
        Some(first) => format!("touched a {}", first.with),
        None => "no contact".into(),
    }
}

pub(super) fn contacts(rows: &Rows, touches: &[Touch]) -> Vec<ContactFigures> {
    let figures = |touch: &Touch| {
        let (x, y) = (touch.contact.x, touch.contact.y);
        let (_, right) = rows.line().locate(x, y, touch.station);
        ContactFigures {
            at_seconds: rounded(seconds(touch.at), 6),
            with: touch.contact.what.name().to_owned(),
            station_m: rounded(touch.station, 3),
            right_cm: rounded(right * 100.0, 1),
        }
    };
    touches.iter().map(figures).collect()
}

/// One row for each recorded state of a rover, every 10 ms. Stations, offsets and headings are the true
/// ones; distances are those that the sensors measured last, empty without a target.
#[must_use]
pub fn rover_states(run: &RoverRun) -> Table {
    let row = |sample: &RowSample| {
        let numbers = [
            seconds(sample.at),
            sample.state.x,
            sample.state.y,
            sample.station,
            sample.right,
            sample.heading.to_degrees(),
            sample.state.speed,
            sample.efforts[0],
            sample.efforts[1],
        ];
        let numbers = numbers.map(Cell::Number).into_iter();
        numbers.chain(sample.distances.map(Cell::from)).collect()
    };
    let columns = [
        ("time_s", "s", 2, "time from power-on"),
        ("x_m", "m", 4, "place of the middle, along the first row"),
        ("y_m", "m", 4, "place of the middle, to the right of that"),
        ("station_m", "m", 4, "way along the row"),
        (
            "right_m",
            "m",
            4,
            "offset from the middle of the row, positive right",
        ),
        ("heading_error_deg", "deg", 3, "heading against the row"),
        ("speed_m_s", "m/s", 4, "speed"),
        ("left_effort", "", 4, "effort of the left motors, -1 to 1"),
        ("right_effort", "", 4, "effort of the right motors, -1 to 1"),
        (
            "left_sensor_m",
            "m",
            4,
            "what the left sensor measured last",
        ),
        (
            "right_sensor_m",
            "m",
            4,
            "what the right sensor measured last",
        ),
    ];
    let column = |(name, unit, digits, what)| Column::new(name, unit, digits, what);
    Table {
        columns: columns.map(column).into(),
        rows: run.drive.samples().iter().map(row).collect(),
    }
}

/// `row.svg` of a rover: the row, its path and the first contact.
#[must_use]
pub fn rover_svg(run: &RoverRun, name: &str, about: &str) -> String {
    let drive = run.drive;
    let path: Vec<_> = drive.samples().iter().map(|sample| sample.state).collect();
    super::row_svg(&RowPicture {
        name,
        about,
        figures: &RoverFigures::of(run).line(),
        rows: drive.rows(),
        start: drive.start(),
        path: &path,
        beams: drive.beams(),
        contact: drive.contact().map(|touch| (touch.contact, touch.chassis)),
    })
}

//! A machine's way between the rows of a crop: figures and picture.

use serde::Serialize;

use super::figures::rounded;
use super::rover::{ContactFigures, contacts, touched};
use super::{ModeChange, RowPicture};
use crate::crop::{Crop, CropSample};
use crate::time::{SimTime, seconds};

/// A machine that is slower than this stands, metres per second.
const STANDS: f64 = 0.01;

/// The guide of a machine of which no message tells what guides it.
pub(super) const UNKNOWN: &str = "unknown";

/// Most guides of which the picture has figures.
const SHOWN: usize = 4;

/// What a machine between rows recorded in a run.
#[derive(Clone, Copy, Debug)]
pub struct CropRun<'a> {
    /// The rows and the machine's place in them.
    pub crop: &'a Crop,
    /// What guided the machine, in order of time; empty if no message tells it.
    pub guides: &'a [ModeChange],
}

/// How a machine drove between the rows of a crop. Offsets are those of its rear axle, while it is
/// within the row and moves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CropFigures {
    /// Length of the row along its middle.
    pub row_length_m: f64,
    /// Station of the rear axle at the end of the run; the row begins at 0.
    pub end_station_m: f64,
    /// One entry for each time that one thing guided.
    pub guides: Vec<GuideFigures>,
    /// Contacts with something solid, in the whole run.
    pub contacts: Vec<ContactFigures>,
}

/// A time in which one thing guided the machine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GuideFigures {
    /// What guided, by its name in the network file; "unknown" without a message that tells it.
    pub guide: String,
    /// When it began.
    pub from_seconds: f64,
    /// When it ended.
    pub until_seconds: f64,
    /// Way along the row in that time.
    pub way_m: f64,
    /// Mean speed.
    pub mean_speed_m_s: Option<f64>,
    /// Mean distance from the middle of the row.
    pub mean_offset_cm: Option<f64>,
    /// Largest distance from the middle of the row.
    pub largest_offset_cm: Option<f64>,
}

impl CropFigures {
    /// The figures of a run.
    #[must_use]
    pub fn of(run: &CropRun) -> Self {
        let crop = run.crop;
        let end = SimTime::from_ticks(u64::MAX);
        let unknown = ModeChange {
            at: SimTime::from_ticks(0),
            mode: UNKNOWN.into(),
            autonomous: false,
        };
        let all = if run.guides.is_empty() {
            core::slice::from_ref(&unknown)
        } else {
            run.guides
        };
        let ends = all.iter().skip(1).map(|next| next.at).chain([end]);
        let guides = all.iter().zip(ends);
        Self {
            row_length_m: rounded(crop.rows().length(), 3),
            end_station_m: rounded(crop.samples().last().map_or(0.0, |last| last.station), 3),
            guides: guides
                .filter_map(|(guide, until)| stretch(crop, guide, until))
                .collect(),
            contacts: contacts(crop.rows(), crop.touches()),
        }
    }

    /// Mean offsets under each guide, and the contact, in a line that is no wider than the picture.
    fn line(&self) -> String {
        let offset = |one: &GuideFigures| {
            let mean = one.mean_offset_cm.unwrap_or_default();
            format!("{} {mean:.1} cm", one.guide)
        };
        let mut offsets: Vec<String> = self.guides.iter().take(SHOWN).map(offset).collect();
        if self.guides.len() > SHOWN {
            offsets.push(format!("{} more", self.guides.len() - SHOWN));
        }
        let offsets = match offsets.as_slice() {
            [] => "did not move in the row".into(),
            offsets => format!("mean offset from the middle: {}", offsets.join(", ")),
        };
        format!("{offsets}; {}", touched(&self.contacts))
    }
}

/// The figures of one guide; `None` if the machine did not move within the row.
fn stretch(crop: &Crop, guide: &ModeChange, until: SimTime) -> Option<GuideFigures> {
    let row = 0.0..=crop.rows().length();
    let counts = |sample: &&CropSample| {
        (guide.at..until).contains(&sample.at)
            && row.contains(&sample.station)
            && sample.state.speed.abs() >= STANDS
    };
    let samples: Vec<&CropSample> = crop.samples().iter().filter(counts).collect();
    let (first, last) = samples.first().zip(samples.last())?;
    let mean = |value: fn(&CropSample) -> f64| {
        let sum: f64 = samples.iter().map(|sample| value(sample)).sum();
        Some(sum / samples.len() as f64)
    };
    let cm = |metres: f64| rounded(metres * 100.0, 3);
    let offsets = samples.iter().map(|sample| sample.right.abs());
    Some(GuideFigures {
        guide: guide.mode.clone(),
        from_seconds: rounded(seconds(first.at), 6),
        until_seconds: rounded(seconds(last.at), 6),
        way_m: rounded(last.station - first.station, 3),
        mean_speed_m_s: mean(|sample| sample.state.speed).map(|speed| rounded(speed, 4)),
        mean_offset_cm: mean(|sample| sample.right.abs()).map(cm),
        largest_offset_cm: offsets.reduce(f64::max).map(cm),
    })
}

/// `row.svg` of a machine: the row, the way of its rear axle and the first contact.
#[must_use]
pub fn crop_svg(run: &CropRun, name: &str, about: &str) -> String {
    let crop = run.crop;
    let length = crop.rows().length();
    let samples = crop.samples().iter();
    let within = samples.filter(|sample| (-1.0..=length + 1.0).contains(&sample.station));
    let path: Vec<_> = within.map(|sample| sample.state).collect();
    let first = crop.touches().first();
    super::row_svg(&RowPicture {
        name,
        about,
        figures: &CropFigures::of(run).line(),
        rows: crop.rows(),
        start: 0.0,
        path: &path,
        beams: crop.beams(),
        contact: first.map(|touch| (touch.contact, touch.chassis)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_the_picture_has_room_for_any_number_of_guides() {
        let guide = |number: usize| GuideFigures {
            guide: "Satellites".into(),
            from_seconds: 0.0,
            until_seconds: 1.0,
            way_m: 1.0,
            mean_speed_m_s: None,
            mean_offset_cm: Some(10.0 + number as f64),
            largest_offset_cm: None,
        };
        let line = |count: usize| {
            let figures = CropFigures {
                row_length_m: 1.0,
                end_station_m: 1.0,
                guides: (0..count).map(guide).collect(),
                contacts: Vec::new(),
            };
            figures.line()
        };
        assert_eq!(line(0), "did not move in the row; no contact");
        assert_eq!(
            line(2),
            "mean offset from the middle: Satellites 10.0 cm, Satellites 11.0 cm; no contact"
        );
        // A character of 13 px takes 7 px on average; there are 896 px.
        for count in 0..40 {
            assert!(line(count).len() <= 128, "{}", line(count));
        }
        assert!(line(40).ends_with("Satellites 13.0 cm, 36 more; no contact"));
    }
}

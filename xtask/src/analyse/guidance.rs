//! The vehicle's mode and positions, and its cross-track error.

use vehicle_model::Vehicle;
use vehicle_model::manifest::SignalPath;
use vehicle_model::units::{LengthKind, factor};
use world::report::{approached, settled};
use world::scenario::{Line, Point};

use super::{
    figures::{GuidanceFigures, HistogramFigures, ModeFigures, RunFigures, rounded},
    series::Spread,
};
use crate::network::decode::{Decoder, Field, Known};

/// A measured position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Position {
    /// Time from the first frame, s.
    pub(crate) at: f64,
    /// Of the antenna from the base station, m.
    pub(crate) north: f64,
    /// The same.
    pub(crate) east: f64,
    /// Distance along the line, m.
    pub(crate) along: f64,
    /// Cross-track error of the centre line beside the antenna, m, positive to the right.
    pub(crate) error: f64,
}

/// A signal of a message.
pub(crate) struct Place {
    pub(crate) id: u16,
    pub(crate) field: Field,
    /// Factor to the base unit.
    pub(crate) factor: f64,
}

impl Place {
    /// The signal of that path; `None` if the network has no such signal, or its unit is
    /// not one of that kind.
    pub(crate) fn find(
        decoder: &Decoder,
        path: &SignalPath,
        factor: fn(&str) -> Option<f64>,
    ) -> Option<Self> {
        let message: &Known = decoder.named(&path.message)?;
        let field = message.field(&path.signal)?.clone();
        Some(Self {
            id: message.id,
            factor: factor(&field.unit)?,
            field,
        })
    }

    /// Its value in the base unit.
    pub(crate) fn value(&self, data: &[u8; 8]) -> f64 {
        self.field.value(data) * self.factor
    }
}

/// The mode's signal.
struct Mode {
    id: u16,
    field: Field,
    autonomous: String,
}

/// Modes, positions and cross-track errors of a log.
pub(crate) struct Guidance {
    mode: Option<Mode>,
    north: Option<Place>,
    east: Option<Place>,
    /// Where a node tells its estimate of the cross-track error.
    estimate: Option<Place>,
    /// The line of the vehicle file.
    pub(crate) line: Option<Line>,
    /// From the centre line to the antenna, m.
    antenna_right: f64,
    last_mode: Option<i64>,
    modes: Vec<(f64, String)>,
    pub(crate) positions: Vec<Position>,
    /// Estimates of the cross-track error: seconds, metres to the right.
    pub(crate) estimates: Vec<(f64, f64)>,
}

/// Name of a signal with an estimate of the cross-track error.
const ESTIMATE: &str = "CrossTrackError";

/// Name of the mode while no frame tells it.
pub(crate) const UNKNOWN: &str = "not known";

/// Width of a bar of the histogram, cm.
const BAR: f64 = 0.5;
/// Most bars to either side.
const BARS: i64 = 40;

impl Guidance {
    pub(crate) fn new(vehicle: &Vehicle, decoder: &Decoder) -> Self {
        let manifest = vehicle.manifest();
        let mode = manifest.mode.as_ref().and_then(|mode| {
            let message = decoder.named(&mode.message)?;
            Some(Mode {
                id: message.id,
                field: message.field(&mode.signal)?.clone(),
                autonomous: mode.autonomous.clone(),
            })
        });
        let signals = manifest.calibration.as_ref();
        let place = |path: &SignalPath| Place::find(decoder, path, factor::<LengthKind>);
        let line = match manifest.waypoints.as_slice() {
            [from, to] => {
                let point = |one: &vehicle_model::manifest::Waypoint| Point {
                    north: one.north,
                    east: one.east,
                };
                Some(Line {
                    from: point(from),
                    to: point(to),
                })
            }
            _ => None,
        };
        Self {
            mode,
            north: signals.and_then(|signals| place(&signals.north)),
            east: signals.and_then(|signals| place(&signals.east)),
            estimate: decoder.messages().iter().find_map(|message| {
                let path = SignalPath {
                    message: message.name.clone(),
                    signal: ESTIMATE.to_owned(),
                };
                place(&path)
            }),
            line,
            antenna_right: manifest
                .machine
                .as_ref()
                .map_or(0.0, |machine| machine.antenna_right.get()),
            last_mode: None,
            modes: Vec::new(),
            positions: Vec::new(),
            estimates: Vec::new(),
        }
    }

    /// Takes a data frame of the network.
    pub(crate) fn take(&mut self, at: f64, id: u16, data: &[u8; 8]) {
        if let Some(mode) = &self.mode
            && mode.id == id
        {
            let raw = mode.field.raw(data);
            if self.last_mode != Some(raw) {
                self.last_mode = Some(raw);
                let name = mode.field.named(data);
                let name = name.map_or_else(|| format!("mode {raw}"), str::to_owned);
                self.modes.push((at, name));
            }
        }
        if let Some(estimate) = &self.estimate
            && estimate.id == id
        {
            self.estimates.push((at, estimate.value(data)));
        }
        if let (Some(north), Some(east)) = (&self.north, &self.east)
            && north.id == id
        {
            let (north, east) = (north.value(data), east.value(data));
            let (along, error) = self
                .line
                .map_or((0.0, 0.0), |line| line.locate(north, east));
            self.positions.push(Position {
                at,
                north,
                east,
                along,
                // The vehicle points along the line, nearly.
                error: error - self.antenna_right,
            });
        }
    }

    /// From `at` on the mode is not known, until it is told again.
    pub(crate) fn interrupt(&mut self, at: f64) {
        if self.last_mode.take().is_some() {
            self.modes.push((at, UNKNOWN.to_owned()));
        }
    }

    /// The modes until the end of the log.
    pub(crate) fn modes(&self, end: f64) -> Vec<ModeFigures> {
        let ends = self.modes.iter().skip(1).map(|(at, _)| *at).chain([end]);
        let modes = self.modes.iter().zip(ends);
        let autonomous = self.mode.as_ref().map(|mode| mode.autonomous.as_str());
        modes
            .map(|((from, mode), until)| ModeFigures {
                from_seconds: rounded(*from, 6),
                until_seconds: rounded(until, 6),
                autonomous: Some(mode.as_str()) == autonomous,
                mode: mode.clone(),
            })
            .collect()
    }

    /// The figures; `None` without a position.
    pub(crate) fn figures(&self, modes: &[ModeFigures]) -> Option<GuidanceFigures> {
        let (first, last) = (self.positions.first()?, self.positions.last()?);
        let point = |position: &Position| [rounded(position.north, 2), rounded(position.east, 2)];
        let autonomous = modes.iter().filter(|mode| mode.autonomous);
        let spans: Vec<&[Position]> = autonomous
            .filter(|_| self.line.is_some())
            .map(|mode| self.between(mode.from_seconds, mode.until_seconds))
            .filter(|positions| !positions.is_empty())
            .collect();
        let steady: Vec<&[Position]> = spans.iter().filter_map(|all| steady(all)).collect();
        let shown = if steady.is_empty() { &spans } else { &steady };
        let errors: Vec<f64> = shown
            .iter()
            .copied()
            .flatten()
            .map(|one| one.error)
            .collect();
        let runs = modes.iter().filter(|mode| mode.autonomous);
        Some(GuidanceFigures {
            positions: self.positions.len() as u64,
            first_m: point(first),
            last_m: point(last),
            runs: runs.filter_map(|mode| self.run(mode)).collect(),
            histogram: histogram(&errors),
        })
    }

    /// The positions of a time span.
    fn between(&self, from: f64, until: f64) -> &[Position] {
        let begin = self.positions.partition_point(|one| one.at < from);
        let end = self.positions.partition_point(|one| one.at <= until);
        self.positions.get(begin..end).unwrap_or_default()
    }

    fn run(&self, mode: &ModeFigures) -> Option<RunFigures> {
        self.line?;
        let all = self.between(mode.from_seconds, mode.until_seconds);
        let first = all.first()?;
        let steady = steady(all);
        let errors: Spread = steady.unwrap_or(all).iter().map(|one| one.error).collect();
        let settling = steady.and_then(|steady| steady.first());
        let settling = settling.map(|one| (one.at - mode.from_seconds).max(0.0));
        let shown = steady.unwrap_or(all);
        let timed: Vec<(f64, f64)> = shown.iter().map(|one| (one.at, one.error)).collect();
        let over = steady.map_or(0, |_| approached(&timed));
        let after = timed.get(over..).unwrap_or_default().iter();
        let largest = after.map(|(_, error)| error.abs()).fold(0.0, f64::max);
        let cm = |metres: f64| rounded(metres * 100.0, 3);
        let from = steady.and_then(|steady| steady.first()).unwrap_or(first).at;
        let begin = self.estimates.partition_point(|(at, _)| *at < from);
        let end = self
            .estimates
            .partition_point(|(at, _)| *at <= mode.until_seconds);
        let same = self.estimates.get(begin..end).unwrap_or_default();
        let estimates: Spread = same.iter().map(|(_, error)| *error).collect();
        Some(RunFigures {
            from_seconds: mode.from_seconds,
            until_seconds: mode.until_seconds,
            positions: all.len() as u64,
            initial_cross_track_error_cm: cm(first.error),
            settling_seconds: settling.map(|seconds| rounded(seconds, 3)),
            mean_cross_track_error_cm: cm(errors.mean()?),
            standard_deviation_cm: cm(errors.deviation()?),
            largest_cross_track_error_cm: cm(largest),
            estimated_mean_cm: estimates.mean().map(cm),
            estimated_deviation_cm: estimates.deviation().map(cm),
        })
    }
}

/// The positions from which the error stays within the band, as in the report of a simulated run.
fn steady(all: &[Position]) -> Option<&[Position]> {
    let errors: Vec<(f64, f64)> = all.iter().map(|one| (one.at, one.error)).collect();
    all.get(settled(&errors)?..)
}

/// Bars of [`BAR`] centimetres; errors beyond the last ones are in these.
fn histogram(errors: &[f64]) -> Option<HistogramFigures> {
    let bar = |error: &f64| ((error * 100.0 / BAR).floor() as i64).clamp(-BARS, BARS - 1);
    let (least, most) = (errors.iter().map(bar).min()?, errors.iter().map(bar).max()?);
    let mut positions = vec![0; usize::try_from(most - least + 1).ok()?];
    for error in errors {
        let index = usize::try_from(bar(error) - least).ok()?;
        if let Some(count) = positions.get_mut(index) {
            *count += 1;
        }
    }
    Some(HistogramFigures {
        from_cm: least as f64 * BAR,
        width_cm: BAR,
        positions,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_histogram_counts_every_error_once() {
        let errors = [0.0, 0.0049, 0.0051, -0.0001, 3.0];
        let bars = histogram(&errors).unwrap();
        assert_eq!((bars.from_cm, bars.width_cm), (-0.5, 0.5));
        assert_eq!(bars.positions[..3], [1, 2, 1]);
        assert_eq!(bars.positions.iter().sum::<u64>(), 5);
        assert_eq!(bars.positions.last(), Some(&1));
        assert_eq!(histogram(&[]), None);
    }
}
